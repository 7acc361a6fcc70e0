# SPDX-License-Identifier: Apache-2.0
"""Speeds, impulse and energy of an impact, with deviations, at its own instant.

Deviations are of first order: by the errors of the instant and of the state, by those of
parameters, such as a restitution, and by an error of the impulse.
"""

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.bank import Array, Hypotheses
from impact_observer.bank.correct import Hit, corrected
from impact_observer.bank.predict import Flights
from impact_observer.dynamics.contact.impact_balance import ImpactBalance, impact_balance
from impact_observer.states import Vector

_STEP = 1e-3
"""Step of a finite difference, in standard deviations."""


def balance_of(
    row: Hypotheses, hit: Hit, flights: Flights, considered: NDArray[np.intp], least: Vector
) -> ImpactBalance:
    """The balance of the contacts of a ``hit``.

    Args:
        row: one hypothesis at the stamp, before the impact.
        hit: the impact.
        flights: near its parameters.
        considered: numbers of the state that are not estimated.
        least: standard deviations of (q, u) beside its own, shape (2n,).

    Raises:
        ImpactLawError: the impact law has no solution.
    """
    _, stamped = corrected(row, hit, flights, considered)
    d, p, mechanism = flights.d, flights.p, flights.mechanism
    back = flights.images([hit.t], stamped.x, -stamped.v, hit.held)
    root, own = stamped.root[0], back.x[0]
    rate = mechanism.rates([hit.t + -float(stamped.v[0])], back.x, hit.held)[0]
    errors = back.Phi[0] @ root[:d] + back.Gamma[0] @ root[d:-1] - np.outer(rate, root[-1])
    errors = np.hstack([errors, np.diag(least)])
    active = tuple(sorted({*hit.held, *hit.contacts}))
    gaps = mechanism.gaps(own)
    gamma, theta = gaps.gamma[list(active)], stamped.x[0, d : d + p]
    pressed = mechanism.pressed(own, active, hit.contacts)
    rows = [active.index(i) for i in hit.contacts]

    def values(z: Vector) -> Array:
        system = mechanism.near(own, z[2 * len(active) :])
        beside = z[len(active) : 2 * len(active)][[active.index(i) for i in pressed]]
        found: Array = impact_balance(system, active, pressed, z[: len(active)], beside)[rows]
        return found

    kicks = np.diag(float(flights.ladders.kicks[row.r[0]]) * np.abs(gamma))
    wide = np.zeros((2 * len(active) + p, errors.shape[1] + len(active)))
    W = gaps.W[list(active)]
    wide[: len(active), : errors.shape[1]] = W @ errors[d // 2 :]
    wide[len(active) : 2 * len(active), errors.shape[1] :] = kicks
    wide[2 * len(active) :, : root.shape[1]] = root[d : d + p]
    z = np.concatenate([gamma, np.zeros(len(active)), theta])
    moved = np.zeros((len(rows), 4, wide.shape[1]))
    for j, deviation in enumerate(np.linalg.norm(wide, axis=1).tolist()):
        if deviation <= 0:
            continue
        step = np.zeros(z.size)
        step[j] = max(_STEP * deviation, 1e-6 * abs(z[j]))
        slope = (values(z + step) - values(z - step)) / (2 * step[j])
        moved += slope[:, :, None] * wide[j]
    deviations = np.linalg.norm(moved, axis=2)
    return ImpactBalance(values(z), deviations, float(stamped.v[0]))
