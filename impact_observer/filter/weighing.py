# SPDX-License-Identifier: Apache-2.0
"""Branches of hypotheses at an event, and their weights: step "weigh" of the filter."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.events import Ruling
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import EventQuery, ImpactFilter
from impact_observer.filter.likelihood import LOG_ROOT_2PI, UNMEASURED, Likelihood
from impact_observer.filter.tuning import TUNING
from impact_observer.kernel._kernel import TINY


class Draft(NamedTuple):
    """A branch whose likelihood is not known yet.

    Attributes:
        weight: logarithm of its prior probability.
        before: the hypothesis before the event, with the clock and the model error of the branch.
        here: what the event was.
        reason: of its notes; empty for an event that is accepted as it was reported.
        is_row: whether a CLOSE began a row of bounces that are not reported.
    """

    weight: float
    before: Hypothesis
    here: ContactChange
    reason: str = ""
    is_row: bool = False


class Branch(NamedTuple):
    """One interpretation of an event.

    Attributes:
        weight: logarithm of its probability.
        before: the hypothesis before the event, with the clock and the model error of the branch.
        here: what the event was; None for a spurious event.
        reason: of its notes.
        likelihood: of ``here``; of a spurious event the likelihood as a true one.
        is_row: whether a CLOSE began a row of bounces that are not reported.
    """

    weight: float
    before: Hypothesis
    here: ContactChange | None = None
    reason: str = ""
    likelihood: Likelihood = UNMEASURED
    is_row: bool = False

    def again(self, weight: float, before: Hypothesis) -> Draft:
        """The same interpretation with another prior ``weight`` and hypothesis ``before``."""
        assert self.here is not None, "an event"
        return Draft(weight, before, self.here, self.reason, self.is_row)

    @property
    def query(self) -> EventQuery:
        """What the filter is asked about the event, which is not spurious."""
        assert self.here is not None, "an event"
        return EventQuery(self.here, self.before.state, self.before.clock, self.likelihood)


def weigh(filter_: ImpactFilter, drafts: Sequence[Draft], root_energy: float) -> list[Branch]:
    """The ``drafts`` with their likelihoods, in their order.

    ``root_energy`` is the root of twice the kinetic energy of the motion, see ``_slowness``.
    """
    if not drafts:
        return []
    likelihoods = filter_.likelihoods(
        [EventQuery(each.here, each.before.state, each.before.clock) for each in drafts]
    )
    return [
        Branch(
            draft.weight
            + likelihood.density
            + _slowness(filter_, draft, root_energy)
            + _haste(filter_, draft, root_energy),
            draft.before,
            draft.here,
            draft.reason,
            likelihood,
            draft.is_row,
        )
        for draft, likelihood in zip(drafts, likelihoods, strict=True)
    ]


def _slowness(filter_: ImpactFilter, draft: Draft, root_energy: float) -> float:
    """Logarithm of the probability that an impact is so slow after the time since the last.

    A body that rests on several stops has gaps of zero, which fit any event. Such a body hits
    nothing. ``root_energy`` is the root of twice the kinetic energy of the geometric replica.
    """
    h, here = draft.before, draft.here
    if len(here.hit) != 1 or here.before:
        return 0.0
    i, moving = here.hit[0], filter_.members.given.moving
    mean = filter_.speed(i, h.state)
    least = TUNING.slow_impact * moving.contact_length(i, h.state.x) * root_energy
    if abs(mean) >= least:
        return 0.0
    applied = (n for n in reversed(h.ledger.notes) if n.ruling is not Ruling.REJECTED)
    if (last := next((n.stamp for n in applied if n.switched == i), None)) is not None:
        flight = (here.stamp - last) / 1e9  # a bouncing contact hits slower, but sooner
        least *= min(flight / (2 * filter_.scales.timescale), 1.0)
    speed = math.hypot(mean, filter_.speed_deviation(i, h.state), TINY)
    return min(math.log(speed / least), 0.0) if least > 0 else 0.0


def begins_row(filter_: ImpactFilter, h: Hypothesis, here: ContactChange) -> bool:
    """Whether a contact that closes would bounce, in flights that the clock resolves."""
    if not _may_bounce(filter_, here):
        return False
    i = here.hit[0]
    speed = -filter_.speed(i, h.state)
    return 2 * float(filter_.system.eps[i]) * speed > _unresolved(filter_, h, here)


def _haste(filter_: ImpactFilter, draft: Draft, root_energy: float) -> float:
    """Logarithm of the probability that a contact of this speed rests after its hit.

    A contact that bounces rests only once it has lost its speed. The density of a speed of zero,
    given a gap of zero, is compared with that of any speed up to the fastest one.
    """
    h, here = draft.before, draft.here
    if not _may_bounce(filter_, here):
        return 0.0
    i, n, root = here.hit[0], filter_.system.n, h.state.root
    w, speed = filter_.near(h.state.x).W[:, i], filter_.speed(i, h.state)
    gap, gamma = w @ root[:n], w @ root[n : 2 * n]
    variance = float(gap @ gap) + (speed * h.clock) ** 2 + TINY
    gain = float(gap @ gamma) / variance
    speed -= gain * filter_.gap(i, h.state)
    unresolved = _unresolved(filter_, h, here) / 2
    spread = math.hypot(
        float(np.linalg.norm(gamma - gain * gap)), gain * speed * h.clock, unresolved, TINY
    )
    length = filter_.members.given.moving.contact_length(i, h.state.x)
    fastest = length * root_energy
    density = -((speed / spread) ** 2) / 2 - math.log(spread) - LOG_ROOT_2PI
    return min(max(density + math.log(max(fastest, spread)), TUNING.log_least_rest), 0.0)


def _may_bounce(filter_: ImpactFilter, here: ContactChange) -> bool:
    """Whether one contact closes that has a restitution."""
    if len(here.hit) != 1 or here.before or here.closed != here.hit:
        return False
    i, system = here.hit[0], filter_.system
    return float(system.eps[i]) > 0


def _unresolved(filter_: ImpactFilter, h: Hypothesis, here: ContactChange) -> float:
    """Twice the speed after a hit of which the next flight is too short to matter, m/s.

    The clock does not resolve such a flight, or a plant rests instead.
    """
    flight = TUNING.unresolved_flight * h.clock
    shortest = TUNING.neglected_flight * filter_.scales.timescale
    return max(flight, shortest) * max(filter_.fall(here.t, here.hit[0], h.state), 0.0)
