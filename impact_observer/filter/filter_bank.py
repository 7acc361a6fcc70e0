# SPDX-License-Identifier: Apache-2.0
"""A bank of hypotheses on what the events were, of which one filter corrects each state.

Multiple hypothesis tracking (Blackman and Popoli, Design and Analysis of Modern Tracking Systems,
1999, chapter 16), as ``docs/theory/filter.md`` describes.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from impact_observer.events import Ruling
from impact_observer.filter.between_events import BetweenEvents
from impact_observer.filter.branching import Branching, Extent
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.correcting import Correcting
from impact_observer.filter.error_accounts import ErrorAccounts
from impact_observer.filter.hypotheses import Hypothesis, log_sum, normalised
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.ledger import Ledger
from impact_observer.filter.pruning import Pruning, likeliest_first
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.filter.weighing import Branch

RESTART = "restart: "
"""Prefix of the reason of a verdict after which the filter goes on from another estimate."""
Restarts: TypeAlias = Callable[[], Sequence[Hypothesis]]
"""Makes the hypotheses of a restart; their probabilities add up to one."""


class FilterBank:
    """Hypotheses of one system from event to event.

    Attributes:
        filter: predicts and corrects the state of each of them.
        errors: that the model may have; None where none is learned.
        between: predicts hypotheses from one event to the next.
        branching: what an event may have been.
        pruning: which hypotheses are kept.
        trusts_events: whether every event is what it is reported to be.
        trusts_estimate: whether nothing makes its covariance wrong.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        uncertainty: Uncertainty,
        clocks: Sequence[float] = (),
        most: int = TUNING.most_hypotheses,
    ) -> None:
        """A bank for the ``uncertainty``.

        ``clocks`` are standard deviations of stamps, s; ``most`` hypotheses are kept at most.
        """
        self.filter = filter_
        self.trusts_events = uncertainty.trusts_events
        self.trusts_estimate = uncertainty.trusts_estimate
        learns_error = uncertainty.model_error is None and clocks
        self.errors = ErrorAccounts(filter_, clocks) if learns_error else None
        keeps_exact = self.errors is not None and not uncertainty.estimates_parameters
        self.pruning = Pruning(filter_.system, most, keeps_exact=keeps_exact)
        self.between = BetweenEvents(
            filter_,
            self.errors,
            trusts_events=self.trusts_events,
            missed=uncertainty.missed,
            dead_time=uncertainty.dead_time,
            most=self.pruning.most,
            keeps_exact=keeps_exact,
        )
        self.branching = Branching(
            filter_, uncertainty, clocks, self.errors, keeps_exact=keeps_exact
        )
        self._correcting = Correcting(filter_, self.errors)

    def update(
        self,
        change: ContactChange,
        predicted: Sequence[Hypothesis],
        restarts: Restarts,
        extent: Extent,
    ) -> tuple[Hypothesis, ...]:
        """The hypotheses after an event, the likeliest first; their probabilities add to one."""
        return normalised(self.weighed(change, predicted, restarts, extent))

    def weighed(
        self,
        change: ContactChange,
        predicted: Sequence[Hypothesis],
        restarts: Restarts,
        extent: Extent,
    ) -> list[Hypothesis]:
        """The same, with probabilities that add to the density of the event, 1/s.

        Args:
            change: the event.
            predicted: the hypotheses at its stamp, made by ``between.predict``.
            restarts: makes the hypotheses of a restart.
            extent: of the motion.
        """
        if change.disorder:
            predicted = [h.disordered(change.disorder) for h in predicted]
        branches = likeliest_first(self.branching.branches(change, predicted, extent))
        likely = self.pruning.likely_branches(branches)
        distinct = self.pruning.distinct_branches(change, likely)
        kept = self._correcting.posteriors(change, distinct, extent)
        if self.pruning.compares_states or self.filter.is_of_robot:
            kept = self.pruning.distinct(kept)
        if not self.trusts_estimate:
            kept = [*kept, *self._restarted(change, branches, kept, restarts)]
        return likeliest_first(kept)

    def _restarted(
        self,
        change: ContactChange,
        branches: Sequence[Branch],
        kept: Sequence[Hypothesis],
        restarts: Restarts,
    ) -> Iterator[Hypothesis]:
        """Restarts beside those with an exact model, and the others, that did not expect it."""
        if not kept:
            yield from _weighed_beside(change, kept, restarts())
        for exact in (True, False):
            first = next((b for b in branches if b.before.is_exact is exact), None)
            if first is None or self.branching.is_expected(first):
                continue
            if own := [h for h in kept if h.is_exact is exact]:
                yield from _weighed_beside(change, own, restarts())


def _weighed_beside(
    change: ContactChange, made: Sequence[Hypothesis], restarts: Sequence[Hypothesis]
) -> Iterator[Hypothesis]:
    """``restarts`` after an event, weighed beside the hypotheses ``made`` of it."""
    total = log_sum([h.weight for h in made]) if made else 0.0
    ruling = (Ruling.APPLIED, f"{RESTART}the estimate before it is rejected")
    before = made[0].ledger.without_event(change) if made else Ledger()
    ledger = before._replace(settled={}).with_event(change, ruling, {})
    jump_error = made[0].jump_error if made else None
    for h in restarts:
        weight = h.weight + total + TUNING.log_restart
        yield Hypothesis(h.state, h.clock, weight, ledger, jump_error=jump_error)
