# SPDX-License-Identifier: Apache-2.0
"""A missed switch: an impact, a rest or a release that was predicted and not reported."""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.errors import ImpactLawError
from impact_observer.events import Contacts, Kind
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.forecast import Dip
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.joint import Joint
from impact_observer.filter.square_root import lengths, triangular
from impact_observer.filter.tuning import TUNING
from impact_observer.kernel._kernel import TINY


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
        after = posterior_of_missed(filter_, change, state)
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
    rested = posterior_of_missed(filter_, resting, state, max(speed, 0.0))
    return Inserted(rested, Kind.CLOSE, max(flight, 0.0))


def _missed(t: float, closed: Contacts, dip: Dip) -> ContactChange:
    """What happens at ``t`` where a ``dip`` begins while contacts are ``closed``."""
    if dip.kind is Kind.OPEN:
        return ContactChange(t, closed, (), tuple(i for i in closed if i != dip.contact))
    return ContactChange(t, closed, (dip.contact,), closed)


def posterior_of_missed(
    filter_: ImpactFilter, change: ContactChange, state: GaussianState, leftover: float = 0.0
) -> GaussianState:
    """The state after a missed event, at the instant of ``change``.

    The instant is the root of the estimate's own guard. It measures nothing, and its error follows
    from that of the state. A contact that closes may neglect the speed ``leftover``, m/s.
    """
    if filter_.is_alone(change) and not leftover:
        impact = filter_.members.free_impact(change.hit[0])
        return filter_.free_state(impact.missed(np.array([change.t]), [state])[0])
    x, root, member = state.x, state.root, filter_.member(state)
    contacts = change.contacts[:1]
    hit = bool(change.hit)
    _, jet = member.guard_at(change.t, x, change.before, contacts, hit=hit)
    value, H, D, E = jet.expanded(x, member.moving.forces(change.t))
    sensitivity = filter_.measured_sensitivity(member, change, contacts, x, change.t)
    seen = np.hstack([H[:, 1:], sensitivity])
    late, bend = -float(value[0]), float(E[0])
    deviation = lengths(seen.dot(root[: seen.size]))[0]
    # Near grazing the acceleration decides the instant: s = sqrt(2 g / a), not g / gamma.
    falling = math.sqrt(abs(bend) * (deviation + abs(late)))
    # A gap that stands still tells no instant: the error of it stays one that can be followed.
    farthest = filter_.farthest(change)
    slope = max(float(H[0, 0]), falling, (deviation + abs(late)) / farthest, TINY)
    row, e, deviation = -seen / slope, late / slope, deviation / slope
    nonlinear = deviation * lengths(D.dot(root[: x.size]))[0] / slope
    nonlinear += bend / slope * deviation**2 / 2
    nonlinear = min(max(nonlinear, -farthest), farthest)
    differences = Joint.differences_of(state)
    differences[:1] = row.dot(differences[1 : 1 + row.size])
    whole = np.zeros((1 + len(root), 1 + root.shape[1]))
    whole[0, 0], whole[0, 1:], whole[1:, 1:] = nonlinear, row.dot(root[: row.size]), root
    joint = Joint.of(change.t, e, state, triangular(whole), differences)
    return filter_.posterior(change, joint, leftover)


def _comes_to_rest(
    filter_: ImpactFilter, contact: int, state: GaussianState, speed: float, flight: float
) -> bool:
    """Whether ``contact`` rests after an impact that leaves it a ``speed`` (m/s).

    It does if its next ``flight`` (s) is one that a plant may neglect, or short and not higher
    than the deviation of its gap; it does not on a stop that drives it.
    """
    if filter_.system.rebounds[contact].drives:
        return False
    seen = filter_.system.W[:, contact].dot(state.root[: filter_.system.n])
    deviation = math.sqrt(seen.dot(seen))
    brief = TUNING.resting_flight * filter_.phases.scales.timescale
    return flight <= filter_.short or (speed * flight / 4 <= deviation and flight <= brief)
