# SPDX-License-Identifier: Apache-2.0
"""Branches of hypotheses at an event, and their weights: step "weigh" of the filter."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from impact_observer.events import Ruling
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import EventQuery, ImpactFilter
from impact_observer.filter.likelihood import UNMEASURED, Likelihood
from impact_observer.filter.tuning import TUNING
from impact_observer.kernel._kernel import TINY


class Draft(NamedTuple):
    """A branch whose likelihood is not known yet.

    Attributes:
        weight: logarithm of its prior probability.
        before: the hypothesis before the event, with the clock and the model error of the branch.
        here: what the event was.
        reason: of its notes; empty for an event that is accepted as it was reported.
    """

    weight: float
    before: Hypothesis
    here: ContactChange
    reason: str = ""


class Branch(NamedTuple):
    """One interpretation of an event.

    Attributes:
        weight: logarithm of its probability.
        before: the hypothesis before the event, with the clock and the model error of the branch.
        here: what the event was; None for a spurious event.
        reason: of its notes.
        likelihood: of ``here``; of a spurious event the likelihood as a true one.
    """

    weight: float
    before: Hypothesis
    here: ContactChange | None = None
    reason: str = ""
    likelihood: Likelihood = UNMEASURED

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
            draft.weight + likelihood.density + _slowness(filter_, draft, root_energy),
            draft.before,
            draft.here,
            draft.reason,
            likelihood,
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
    i, phases = here.hit[0], filter_.phases
    mean = filter_.speed(i, h.state)
    least = TUNING.slow_impact * float(phases.length[i]) * root_energy
    if abs(mean) >= least:
        return 0.0
    applied = (n for n in reversed(h.ledger.notes) if n.ruling is not Ruling.REJECTED)
    if (last := next((n.stamp for n in applied if n.switched == i), None)) is not None:
        flight = (here.stamp - last) / 1e9  # a bouncing contact hits slower, but sooner
        least *= min(flight / (2 * phases.scales.timescale), 1.0)
    speed = math.hypot(mean, filter_.speed_deviation(i, h.state), TINY)
    return min(math.log(speed / least), 0.0) if least > 0 else 0.0
