# SPDX-License-Identifier: Apache-2.0
"""Speeds, impulse and energy of an impact, with deviations, at its own instant.

Deviations are of first order: by the errors of the instant and of the state, by those of
parameters, such as a restitution, and by an error of the impulse.
"""

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.bank import Hypotheses
from impact_observer.bank.correct import Hit, at_impact
from impact_observer.bank.predict import Flights
from impact_observer.dynamics.contact.impact_balance import ImpactBalance, uncertain_balance
from impact_observer.states import Vector


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
    stamped = at_impact(row, hit, flights, considered)
    d, p, mechanism = flights.d, flights.p, flights.mechanism
    back = flights.images([hit.t], stamped.x, -stamped.v, hit.held)
    root, own = stamped.root[0], back.x[0]
    rate = mechanism.rates([hit.t + -float(stamped.v[0])], back.x, hit.held)[0]
    errors = back.Phi[0] @ root[:d] + back.Gamma[0] @ root[d:-1] - np.outer(rate, root[-1])
    active, n = tuple(sorted({*hit.held, *hit.contacts})), d // 2
    gaps = mechanism.gaps(own)
    W, gamma = gaps.W[list(active)], gaps.gamma[list(active)]
    values, deviations = uncertain_balance(
        lambda theta: mechanism.near(own, theta),
        active,
        mechanism.pressed(own, active, hit.contacts),
        gamma=gamma,
        theta=stamped.x[0, d : d + p],
        root=np.block([[W @ errors[n:], W * least[n:]], [root[d : d + p], np.zeros((p, n))]]),
        scatter=float(flights.ladders.kicks[row.r[0]]) * np.abs(gamma),
    )
    rows = [active.index(i) for i in hit.contacts]
    return ImpactBalance(values[rows], deviations[rows], float(stamped.v[0]))
