# SPDX-License-Identifier: Apache-2.0
"""The balance of an impact: contact speeds before and after, impulses, the energy that is lost.

An impulse ``Lambda_i`` on a contact whose relative speed goes from ``gamma_i-`` to ``gamma_i+``
does the work ``1/2 (gamma_i- + gamma_i+) Lambda_i``. The sum over all contacts is the change of
the kinetic energy, in a frame in which the stops rest.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_STEP, _LEAST_STEP = 1e-3, 1e-6
"""Step of a finite difference in standard deviations, and the least one in parts of a number."""


class ImpactBalance(NamedTuple):
    """Speeds, impulses and energies of the contacts that hit at one instant.

    Attributes:
        values: one row a contact: speed of approach before and of separation after, m/s, impulse,
            N s, energy that is lost, J; shape (k, 4).
        deviations: standard deviations of these numbers, shape (k, 4); -1 where there are none.
        early: how much before the stamp of the event the instant is, s.
    """

    values: Matrix
    deviations: Matrix
    early: float = 0.0

    @property
    def rows(self) -> Matrix:
        """The values and then the deviations of each contact, shape (k, 8)."""
        return np.hstack([self.values, self.deviations])

    @classmethod
    def without_deviations(cls, values: Matrix) -> "ImpactBalance":
        """The balance of a law that has no covariance."""
        return cls(values, np.full(values.shape, -1.0))


def impact_balance(
    system: System,
    active: Contacts,
    pressed: Contacts,
    gamma: Vector,
    beside: Vector | None = None,
) -> Matrix:
    """The balance of an impact in which the contacts ``pressed`` take an impulse.

    Args:
        system: the masses, contacts and rebound laws; of a robot those at its state.
        active: contacts that are closed at the instant, ascending.
        pressed: those of ``active`` that take an impulse, whatever the signs of their speeds.
        gamma: relative speeds of ``active`` before, shape (..., k), m/s, positive where a gap
            opens.
        beside: what those of ``pressed`` rebound with beside the law's speeds, shape (..., k),
            m/s; of other contacts it counts for nothing.

    Returns:
        One row of ``active`` each, as ``ImpactBalance.values`` has them, shape (..., k, 4).
    """
    W, taking = system.W[:, list(active)], [active.index(i) for i in pressed]
    G, change = W.T @ np.linalg.solve(system.M, W), np.zeros_like(gamma)
    for k in taking:
        change[..., k] = -gamma[..., k] - system.rebounds[active[k]].rebound(gamma[..., k])
    if beside is not None:
        change += beside
    impulses = np.zeros_like(gamma)
    # Of contacts that depend on each other the least impulses are taken.
    inverse = np.linalg.pinv(G[np.ix_(taking, taking)], hermitian=True)
    impulses[..., taking] = change[..., taking] @ inverse
    after = gamma + impulses @ G
    return np.stack([-gamma, after, impulses, -(gamma + after) / 2 * impulses], axis=-1)


def uncertain_balance(
    near: Callable[[Vector], System],
    active: Contacts,
    pressed: Contacts,
    *,
    gamma: Vector,
    theta: Vector,
    root: Matrix,
    scatter: Vector,
) -> tuple[Matrix, Matrix]:
    """The balance of an impact, and standard deviations of its numbers, by finite differences.

    Args:
        near: the system of parameters ``theta``, else as ``system`` of :func:`impact_balance`.
        active: as of :func:`impact_balance`.
        pressed: as of :func:`impact_balance`.
        gamma: as of :func:`impact_balance`.
        theta: the parameters, shape (p,).
        root: of the covariance of (gamma, theta), shape (k + p, any).
        scatter: standard deviations of what ``active`` rebound with beside the law, (k,), m/s.

    Returns:
        Values and deviations, one row of ``active`` each, shape (k, 4).
    """
    k, p = len(active), theta.size
    roots = linalg.block_diag(root, np.diag(scatter))
    deviations, z = np.linalg.norm(roots, axis=1), np.concatenate([gamma, theta, np.zeros(k)])
    steps = np.maximum(_STEP * deviations, _LEAST_STEP * np.abs(z))
    moved = z + np.stack([np.diag(steps), -np.diag(steps)])
    moved = np.concatenate([moved, np.broadcast_to(z, (1, *moved.shape[1:]))])
    speeds, beside = moved[..., :k], moved[..., k + p :]
    found = impact_balance(near(theta), active, pressed, speeds, beside)
    for j in (k + np.flatnonzero(deviations[k : k + p])).tolist():
        for sign in (0, 1):
            own = near(moved[sign, j, k : k + p])
            found[sign, j] = impact_balance(own, active, pressed, gamma)
    slopes = (found[0] - found[1]) / np.where(deviations, 2 * steps, np.inf)[:, None, None]
    return found[2, 0], np.linalg.norm(np.einsum("jki,jr->kir", slopes, roots), axis=2)
