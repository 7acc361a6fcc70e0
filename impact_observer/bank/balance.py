# SPDX-License-Identifier: Apache-2.0
"""Speeds, impulse and energy of an impact, with deviations, at its own instant.

Deviations are of first order: by the errors of the instant and of the state, by those of
parameters, such as a restitution, and by an error of the impulse.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.contact.impact_balance import ImpactBalance, uncertain_balance
from impact_observer.dynamics.mechanism import Mechanism
from impact_observer.events import Contacts
from impact_observer.states import Matrix, Vector

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ImpactState:
    """What a hypothesis knows of an impact at its own instant, before the jump.

    Attributes:
        mechanism: of the hypothesis, near its parameters.
        contacts: those that hit.
        held: contacts that are closed before.
        x: (q, u), shape (2n,).
        z: speeds of all contacts, and parameters of the model, shape (m + p,).
        root: of the covariance of ``z``, shape (m + p, any).
        scatter: relative error of the impulse.
        early: how much before the stamp of an event the instant is, s.
    """

    mechanism: Mechanism
    contacts: Contacts
    held: Contacts
    x: Vector
    z: Vector
    root: Matrix
    scatter: float
    early: float


def impact_states(
    mechanism: Mechanism,
    contacts: Contacts,
    states: Array,
    roots: Array,
    *,
    held: Sequence[Contacts],
    scatter: Vector,
    early: Vector | float = 0.0,
) -> list[ImpactState]:
    """What H hypotheses know of an impact.

    Args:
        mechanism: near their parameters.
        contacts: those that hit.
        states: at its instant, shape (H, N).
        roots: of their covariances there, shape (H, N, any).
        held: contacts that each holds closed before.
        scatter: relative errors of the impulse, shape (H,).
        early: how much before the stamp of an event each has it, s, shape (H,).
    """
    d, p = 2 * mechanism.system.n, mechanism.theta.size
    x, gaps = states[:, :d], mechanism.gaps(states[:, :d])
    z = np.hstack([gaps.gamma, states[:, d : d + p]])
    root = np.concatenate([gaps.W @ roots[:, d // 2 : d], roots[:, d : d + p]], axis=1)
    when = np.broadcast_to(early, len(x)).tolist()
    each = zip(held, x, z, root, scatter.tolist(), when, strict=True)
    return [ImpactState(mechanism, contacts, *own) for own in each]


def mixed(states: Sequence[ImpactState], weights: Vector) -> ImpactState:
    """The likeliest of H ``states`` with the covariance of all about it, by ``weights``, (H,)."""
    best = states[int(np.argmax(weights))]
    parts = [
        np.column_stack([each.root, each.z - best.z]) * weight
        for each, weight in zip(states, np.sqrt(weights / weights.sum()), strict=True)
    ]
    return replace(best, root=np.hstack(parts))


def balance_of(state: ImpactState, least: Vector) -> ImpactBalance:
    """The balance of the contacts that hit.

    Args:
        state: at the instant of the impact.
        least: standard deviations of (q, u) beside its own, shape (2n,).

    Raises:
        ImpactLawError: the impact law has no solution.
    """
    mechanism = state.mechanism
    n, m, p = mechanism.system.n, mechanism.system.m, mechanism.theta.size
    active = tuple(sorted({*state.held, *state.contacts}))
    own, gamma = list(active), state.z[list(active)]
    W = mechanism.gaps(state.x).W[own]
    beside = np.vstack([W * least[n:], np.zeros((p, n))])
    values, deviations = uncertain_balance(
        lambda theta: mechanism.near(state.x, theta),
        active,
        mechanism.pressed(state.x, active, state.contacts),
        gamma=gamma,
        theta=state.z[m:],
        root=np.hstack([state.root[[*own, *range(m, m + p)]], beside]),
        scatter=state.scatter * np.abs(gamma),
    )
    rows = [active.index(i) for i in state.contacts]
    return ImpactBalance(values[rows], deviations[rows], state.early)
