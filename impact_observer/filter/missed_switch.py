# SPDX-License-Identifier: Apache-2.0
"""A missed switch: an impact, a rest or a release that was predicted and not reported."""

import math
from typing import NamedTuple

from impact_observer.errors import ImpactLawError
from impact_observer.events import Contacts, Kind
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.forecast import Dip
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.tuning import TUNING


class Inserted(NamedTuple):
    """A switch that is inserted.

    Attributes:
        state: after it.
        kind: how the contact switches.
        flight: of a contact that rests, the one that counts as none, s.
    """

    state: GaussianState
    kind: Kind
    flight: float = 0.0


def insert_switch(
    filter_: ImpactFilter, t: float, state: GaussianState, dip: Dip
) -> Inserted | None:
    """The switch that a ``dip`` predicts.

    The dip begins at ``t``, s since the epoch, with ``state``. A contact that would leave its stop
    by less than the deviation of its gap rests on it. None where the impact law has no solution,
    as of a body that is closed at its other stop.
    """
    change = _missed(t, state.closed, dip)
    try:
        after = filter_.posterior_of_missed(change, state)
    except ImpactLawError:
        return None
    if dip.kind is Kind.OPEN:
        return Inserted(after, Kind.OPEN)
    speed = filter_.speed(dip.contact, after)
    fall = filter_.fall(t, dip.contact, after)
    flight = 2 * speed / fall if fall > 0 else math.inf
    if not _comes_to_rest(filter_, dip.contact, after, speed, flight):
        return Inserted(after, Kind.IMPACT)
    resting = change._replace(closed=tuple(sorted({*state.closed, dip.contact})))
    rested = filter_.posterior_of_missed(resting, state, max(speed, 0.0))
    return Inserted(rested, Kind.CLOSE, max(flight, 0.0))


def _missed(t: float, closed: Contacts, dip: Dip) -> ContactChange:
    """What happens at ``t`` where a ``dip`` begins while contacts are ``closed``."""
    if dip.kind is Kind.OPEN:
        return ContactChange(t, closed, (), tuple(i for i in closed if i != dip.contact))
    return ContactChange(t, closed, (dip.contact,), closed)


def _comes_to_rest(
    filter_: ImpactFilter, contact: int, state: GaussianState, speed: float, flight: float
) -> bool:
    """Whether ``contact`` rests after an impact that leaves it a ``speed`` (m/s).

    It does if its next ``flight`` (s) is one that a plant may neglect, or short and not higher
    than the deviation of its gap.
    """
    deviation = filter_.gap_deviation(contact, state.x, state.root)
    brief = TUNING.resting_flight * filter_.scales.timescale
    is_low = speed * flight / 4 <= deviation and flight <= brief
    return is_low or flight <= filter_.conditioning.short
