# SPDX-License-Identifier: Apache-2.0
"""Contacts that settle: the last bounces before a rest, which the clock does not resolve.

Each bounce is shorter than the one before, and at last shorter than the error of a stamp. Then a
stamp says nothing of the flight before it, and the order of stamps nothing of that of impacts. A
plastic impact at the first of these bounces leads to the same rest: bounces and rest take the
same impulse.
"""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import EventQuery, ImpactFilter
from impact_observer.filter.likelihood import LOG_ROOT_2PI
from impact_observer.filter.resting import rest_projection
from impact_observer.filter.tuning import TUNING
from impact_observer.states import Matrix


class Rest(NamedTuple):
    """When a contact is predicted to rest.

    Attributes:
        t: the instant, s since the epoch.
        deviation: standard deviation of the stamp of a bounce before it, from that instant, s.
    """

    t: float
    deviation: float

    def log_density(self, t: float) -> float | None:
        """Logarithm of the density of the stamp ``t`` of a bounce, 1/s; None for no bounce."""
        far = (t - self.t) / self.deviation
        density = -far * far / 2 - math.log(self.deviation) - LOG_ROOT_2PI
        return density if abs(far) < TUNING.far_bounce else None


class Settled(NamedTuple):
    """A contact that has settled.

    Attributes:
        change: the event, after which the contact is closed.
        state: then.
        rest: of the contact.
    """

    change: ContactChange
    state: GaussianState
    rest: Rest


def settled(
    filter_: ImpactFilter, query: EventQuery, after: GaussianState, since: float
) -> Settled | None:
    """What follows from an impact if the next flight is one that the clock does not resolve.

    None where the clock resolves it, where nothing presses the contact back onto its stop, where
    that drives it away, and where the state says nothing of that flight.

    Args:
        filter_: of the state.
        query: the event, and the state before it.
        after: the state after it, if the contact leaves its stop.
        since: time since the latest jump of any contact, s.
    """
    change, clock = query.change, query.clock
    is_long = since > TUNING.longest_flight * clock
    if is_long or len(change.hit) != 1 or change.hit[0] in change.closed:
        return None
    contact = change.hit[0]
    speed = filter_.speed(contact, after)
    fall = filter_.fall(change.t, contact, after)
    if not (fall > 0 and 2 * speed < TUNING.unresolved_flight * clock * fall):
        return None
    if 2 * filter_.speed_deviation(contact, after) > TUNING.unknown_flight * clock * fall:
        return None
    flight = max(2 * speed / fall, 0.0)
    closed: Contacts = tuple(sorted({*change.closed, contact}))
    change = change._replace(closed=closed)
    state = filter_.conditioning.posterior(change, query.state, clock, leftover=math.inf)
    state = state.with_error(_neglected(filter_, contact, state, fall, flight + clock))
    return Settled(change, state, rest_after(filter_, contact, change.t, flight, clock))


def _neglected(
    filter_: ImpactFilter, contact: int, state: GaussianState, fall: float, flight: float
) -> Matrix:
    """What the bounces add to a ``state`` at rest, as an error of it, shape (2n, 1).

    They begin with a ``flight`` (s), in which the contact is accelerated back by ``fall``, m/s2.
    The sum of all impulses and their first moment are those of the rest. What differs first is
    the integral of the gap, through the stiffness: ``fall T^3 / 12`` in a flight T, and less by
    the cube of the restitution in the next one.
    """
    system = filter_.near(state.x)
    n, w = system.n, system.W[:, contact]
    inverse = filter_.members.given.moving.inverse(state.x)
    kick = inverse @ w
    raised = fall * flight**3 / 12 / max(1.0 - float(system.eps[contact]) ** 3, TUNING.least_loss)
    added = np.zeros((2 * n, 1))
    added[n:, 0] = inverse @ (system.K @ kick) * (raised / w.dot(kick))
    return np.asarray(rest_projection(filter_.members, state).map_ @ added)


def rest_after(filter_: ImpactFilter, contact: int, t: float, flight: float, clock: float) -> Rest:
    """When a contact rests of which the bounces after ``t`` (s) begin with a ``flight``, s.

    ``clock`` is the standard deviation of a stamp, s.
    """
    left = flight / max(1.0 - float(filter_.system.eps[contact]), TUNING.least_loss)
    return Rest(t + left, math.hypot(clock, left / 2))
