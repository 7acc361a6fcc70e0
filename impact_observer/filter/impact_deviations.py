# SPDX-License-Identifier: Apache-2.0
"""The balance of an impact with its standard deviations, from the state just before the impact."""

import numpy as np
from scipy import linalg

from impact_observer.dynamics.contact.impact_balance import ImpactBalance, impact_balance
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.joint import Joint
from impact_observer.filter.members import Members
from impact_observer.filter.square_root import lengths
from impact_observer.kernel._kernel import TINY
from impact_observer.states import Matrix, Vector

_STEP, _LEAST_STEP = 1e-3, 1e-6
"""Step of a finite difference, in standard deviations, and at least so much of the number."""


def balance_at(
    members: Members, change: ContactChange, joint: Joint, least: Vector, kicks: Matrix
) -> ImpactBalance:
    """The balance of the contacts that hit in a ``change``, at its own instant.

    The speeds are those at the estimated instant. Deviations are of first order: by the errors of
    the instant and of the state, by those of parameters, such as a restitution, and by others of
    the jump.

    Args:
        members: the family of the system.
        change: the impact.
        joint: the instant and the state then, as if before the impact.
        least: standard deviations of the state (q, u) beside those of ``joint``, shape (2n,).
        kicks: errors of the velocities after the impact beside those, one a column, shape
            (n, any).

    Raises:
        ImpactLawError: the impact law has no solution.
    """
    member, active, size = members.of_estimate(joint), change.active, joint.size
    moving, k = member.moving, len(active)
    rates = moving.rates_at(joint.t, joint.x, change.before)
    gaps = member.guard(change.before, active, joint.t, joint.x, hit=True)
    _, H, D, E = gaps.expanded(rates, joint.x, moving.forces(joint.t))
    pressed = member.pressed(change, joint.x)
    hit = [active.index(i) for i in change.hit]

    def values(z: Vector) -> Matrix:
        near = members.at(z[2 * k :]).near(joint.x)
        return impact_balance(near, active, pressed, z[:k], z[k : 2 * k])[hit]

    z = np.concatenate([-H[:, 0] - E * joint.e, np.zeros(k), joint.theta])
    beside = member.near(joint.x).W[:, list(active)].T @ kicks
    speeds = np.hstack([-D @ joint.root[1 : 1 + size] - np.outer(E, joint.root[0]), -D * least])
    root = linalg.block_diag(speeds, beside)
    theta = joint.root[joint.of_theta]
    root = np.vstack([root, np.pad(theta, ((0, 0), (0, root.shape[1] - theta.shape[1])))])
    low, high = np.full(z.size, -np.inf), np.full(z.size, np.inf)
    low[2 * k :], high[2 * k :] = members.family.bounds
    moved = np.zeros((len(hit), 4, root.shape[1]))
    for j, deviation in enumerate(lengths(root)):
        if deviation <= TINY:
            continue
        step = max(_STEP * deviation, _LEAST_STEP * abs(z[j]))
        below, above = z.copy(), z.copy()
        below[j], above[j] = max(z[j] - step, low[j]), min(z[j] + step, high[j])
        slope = (values(above) - values(below)) / (above[j] - below[j])
        moved += slope[:, :, None] * root[j]
    early = change.t - (joint.t - joint.e)
    return ImpactBalance(values(z), np.linalg.norm(moved, axis=2), early)
