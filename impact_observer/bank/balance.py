# SPDX-License-Identifier: Apache-2.0
"""Speeds, impulse and energy of an impact, with deviations, at its own instant.

Deviations are of first order: by the errors of the instant and of the state, by those of
parameters, such as a restitution, and by an error of the impulse.
"""

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.bank import Hypotheses, ImpactState
from impact_observer.bank.correct import Hit, at_impact
from impact_observer.bank.predict import Flights
from impact_observer.dynamics.contact.impact_balance import ImpactBalance, uncertain_balance
from impact_observer.dynamics.mechanism import Mechanism
from impact_observer.states import Vector


def reported_impact(
    row: Hypotheses, hit: Hit, flights: Flights, considered: NDArray[np.intp]
) -> tuple[ImpactState, float]:
    """The state of a hypothesis at an impact that a stamp tells, and how early that is, s.

    Args:
        row: one hypothesis at the stamp, before the impact.
        hit: the impact.
        flights: near its parameters.
        considered: numbers of the state that are not estimated.
    """
    stamped = at_impact(row, hit, flights, considered)
    d, mechanism, v = flights.d, flights.mechanism, float(stamped.v[0])
    back = flights.images([hit.t], stamped.x, -stamped.v, hit.held)
    root, x = stamped.root[0], stamped.x[0].copy()
    rate = mechanism.rates([hit.t + -v], back.x, hit.held)[0]
    errors = back.Phi[0] @ root[:d] + back.Gamma[0] @ root[d:-1] - np.outer(rate, root[-1])
    x[:d] = back.x[0]
    seen = np.vstack([mechanism.gaps(x[:d]).W @ errors[d // 2 :], root[d : d + flights.p]])
    scatter = float(flights.ladders.kicks[row.r[0]])
    return ImpactState(hit.contacts, hit.held, x, seen, scatter), v


def balance_of(state: ImpactState, mechanism: Mechanism, least: Vector) -> ImpactBalance:
    """The balance of the contacts that hit.

    Args:
        state: at the instant of the impact.
        mechanism: near its parameters.
        least: standard deviations of (q, u) beside its own, shape (2n,).

    Raises:
        ImpactLawError: the impact law has no solution.
    """
    n, p = mechanism.system.n, mechanism.theta.size
    own, theta = state.x[: 2 * n], state.x[2 * n : 2 * n + p]
    active, gaps = tuple(sorted({*state.held, *state.contacts})), mechanism.gaps(own)
    W, gamma = gaps.W[list(active)], gaps.gamma[list(active)]
    m = mechanism.system.m
    values, deviations = uncertain_balance(
        lambda theta: mechanism.near(own, theta),
        active,
        mechanism.pressed(own, active, state.contacts),
        gamma=gamma,
        theta=theta,
        root=np.block(
            [[state.root[list(active)], W * least[n:]], [state.root[m:], np.zeros((p, n))]]
        ),
        scatter=state.scatter * np.abs(gamma),
    )
    rows = [active.index(i) for i in state.contacts]
    return ImpactBalance(values[rows], deviations[rows])
