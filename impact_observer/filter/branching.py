# SPDX-License-Identifier: Apache-2.0
"""What an event may have been under each hypothesis: step "branch" of the filter."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from impact_observer.events import MISLABELLED
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.error_accounts import ErrorAccounts
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.likelihood import UNMEASURED, Likelihood
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.filter.weighing import Branch, Draft, begins_row, weigh
from impact_observer.states import Vector

UNREPORTED_ROW = "accepted: the first edge of a row of bounces that are not reported"
"""Reason of a CLOSE at a speed at which the contact does not rest."""


class Extent(NamedTuple):
    """How large the motion is, by a replica that follows the events whatever the filter does.

    Attributes:
        x: its state (q, u) now, shape (2n,).
        largest: magnitude of each component of (q, u) so far, the initial standard deviation
            included, shape (2n,).
    """

    x: Vector
    largest: Vector


class LogPriors(NamedTuple):
    """Logarithms of what is known of an event before it is seen.

    Attributes:
        reported: probability that an impact is reported.
        missed: probability that an impact is not reported.
        spurious: odds of a spurious event, times their rate, 1/s.
        mislabelled: probability that an event is of another contact.
        rate: one event in the model's time scale, 1/s.
    """

    reported: float
    missed: float
    spurious: float
    mislabelled: float
    rate: float

    @classmethod
    def of_sensor(cls, declared: Uncertainty, timescale: float) -> "LogPriors":
        """What is ``declared`` of a sensor, for a model of this ``timescale``, s."""
        rate = -math.log(timescale)
        missed, reported = _logs(declared.missed)
        mislabelled, _ = _logs(declared.mislabelled)
        spurious, true = _logs(declared.spurious)
        odds = spurious - true + math.log(TUNING.spurious_rate) + rate
        return cls(reported, missed, odds, mislabelled, rate)


class Branching:
    """Branches hypotheses at an event.

    Attributes:
        priors: of the event.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        uncertainty: Uncertainty,
        clocks: Sequence[float],
        errors: ErrorAccounts | None,
        *,
        keeps_exact: bool,
    ) -> None:
        """Branches under the ``uncertainty``.

        Args:
            filter_: weighs the branches.
            uncertainty: what the user declares.
            clocks: possible standard deviations of stamps, s, in their order.
            errors: of the model; None where no error is learned.
            keeps_exact: whether the likeliest hypotheses with an exact model lead, too.
        """
        self.priors = LogPriors.of_sensor(uncertainty, filter_.scales.timescale)
        self._filter = filter_
        self._errors = errors
        self._keeps_exact = keeps_exact
        self._trusts_estimate = uncertainty.trusts_estimate
        self._inserts_bounces = not uncertainty.trusts_events
        self._next_clocks = {
            clock: tuple(clocks[i + k] for k in TUNING.clock_steps if 0 <= i + k < len(clocks))
            for i, clock in enumerate(clocks)
        }

    def branches(
        self, change: ContactChange, hypotheses: Sequence[Hypothesis], extent: Extent
    ) -> list[Branch]:
        """The interpretations of an event, weighed; more of them under hypotheses that lead."""
        root_energy = self._filter.members.given.moving.root_energy(extent.x)
        found, true, clocks, leads = [], list[Draft](), list[Draft](), []
        for h, is_leading in zip(hypotheses, self._leading(change, hypotheses), strict=True):
            here = change.from_closed(h.state.closed)
            if bounce := self._bounce(change, h):
                found.append(bounce)
            elif here.is_nothing:
                found.append(self._spurious(change, h, "its contact is not closed"))
            else:
                drafts = [*self._as_reported(h, here)]
                true += drafts
                leads += [is_leading] * len(drafts)
                for clock in self._next_clocks.get(h.clock, ()) if is_leading else ():
                    other = h._replace(clock=clock)
                    clocks += [
                        Draft(each.weight + TUNING.log_clock_change, other, *each[2:])
                        for each in drafts
                    ]
        weighed = weigh(self._filter, [*true, *clocks], root_energy)
        others = list[Draft]()
        for each, is_leading in zip(weighed, leads, strict=False):
            others += self._errors_of_model(each) if is_leading else ()
            others += self._wider(each, extent.largest) if is_leading else ()
            others += self._other_contacts(change, each)
        if self.priors.spurious > -math.inf:
            found += [
                self._spurious(change, each.before, likelihood=each.likelihood)
                for each in weighed[: len(true)]
                if not each.is_row
            ]
        return [*found, *weighed, *weigh(self._filter, others, root_energy)]

    def _as_reported(self, h: Hypothesis, here: ContactChange) -> Iterator[Draft]:
        """The event happened, and a contact that closes rests, or began a row of bounces."""
        yield Draft(self._prior(h, here), h, here)
        if self._inserts_bounces and begins_row(self._filter, h, here):
            bounced = here._replace(closed=tuple(i for i in here.closed if i not in here.hit))
            prior = self._prior(h, here, is_row=True)
            yield Draft(prior, h, bounced, UNREPORTED_ROW, is_row=True)

    def is_expected(self, branch: Branch) -> bool:
        """Whether the event came about when it was predicted."""
        if branch.here is None:
            return False
        likelihood = branch.likelihood
        soon = likelihood.density >= max(len(branch.here.contacts), 1) * self.priors.rate
        return soon and max(likelihood.innovations.values(), default=0.0) < TUNING.surprise

    def _leading(self, change: ContactChange, hypotheses: Sequence[Hypothesis]) -> list[bool]:
        """Whether each is near the likeliest one, or the likeliest one with an exact model."""
        weights = [each.weight_without(change.contacts) for each in hypotheses]
        enough, enough_exact = max(weights) + TUNING.log_leading, math.inf
        if self._keeps_exact:
            exact = (w for w, h in zip(weights, hypotheses, strict=True) if h.is_exact)
            enough_exact = max(exact, default=math.inf) + TUNING.log_leading
        return [
            weight >= enough or (weight >= enough_exact and h.is_exact)
            for weight, h in zip(weights, hypotheses, strict=True)
        ]

    def _errors_of_model(self, true: Branch) -> Iterator[Draft]:
        """The model began to err before the event of the branch ``true``, or its error ended."""
        if self._errors is None or true.here is None:
            return
        prior = self._prior(true.before, true.here, is_row=true.is_row)
        for other in self._errors.others(true.before, true.here, true.likelihood):
            yield true.again(prior + TUNING.log_error_change, other)

    def _wider(self, true: Branch, largest: Vector) -> Iterator[Draft]:
        """The covariance before a surprising event of the branch ``true`` was too small."""
        depth = max(true.likelihood.innovations.values(), default=-1.0)
        if depth <= TUNING.surprise or self._trusts_estimate or true.here is None:
            return
        h, part = true.before, self._filter.part_of(true.here.contacts, true.before.state.x)
        prior = self._prior(h, true.here, is_row=true.is_row)
        for factor in (TUNING.widening, TUNING.large_widening):
            wider = h._replace(state=self._filter.widened(h.state, factor * depth, largest, part))
            reason = f"accepted: the covariance is made {factor * depth:.3g} times wider"
            weight = prior + TUNING.log_restart
            yield Draft(weight, wider, true.here, reason, is_row=true.is_row)

    def _prior(self, h: Hypothesis, here: ContactChange, *, is_row: bool = False) -> float:
        """Logarithm of the prior probability that the event was ``here``, or began a row."""
        row = TUNING.log_unreported_row if is_row else 0.0
        return self.priors.reported + h.weight_without(here.contacts) + row

    def _other_contacts(self, change: ContactChange, true: Branch) -> Iterator[Draft]:
        """An unexpected impact of the branch ``true`` was of another contact."""
        here, h = true.here, true.before
        is_impact = here is not None and len(change.hit) == 1 and here.before == here.closed
        is_impact = is_impact and not true.is_row
        if not is_impact or self.priors.mislabelled == -math.inf or self.is_expected(true):
            return
        closed, system = h.state.closed, self._filter.system
        others = [i for i in range(system.m) if i not in (*change.hit, *closed)]
        for i in others:
            other_contact = change._replace(before=closed, hit=(i,), closed=closed)
            prior = self.priors.reported + h.weight_without((i,))
            weight = prior + self.priors.mislabelled - math.log(len(others))
            reason = f"{MISLABELLED}{system.contact_names[i]}"
            yield Draft(weight, h, other_contact, reason)

    def _bounce(self, change: ContactChange, h: Hypothesis) -> Branch | None:
        """The event was one of the last bounces of a contact that has settled, or None."""
        if not (h.ledger.settled and len(change.contacts) == len(change.hit) == 1):
            return None
        contact, closed = change.hit[0], h.state.closed
        rest = h.ledger.settled.get(contact) if contact in closed else None
        density = None if rest is None else rest.log_density(change.t)
        if density is None:
            return None
        here = change._replace(before=closed, hit=(), closed=closed)
        weight = h.weight_without(change.contacts) + self.priors.reported + density
        return Branch(weight, h, here, "", Likelihood(density, {}))

    def _spurious(
        self,
        change: ContactChange,
        h: Hypothesis,
        reason: str = "",
        likelihood: Likelihood = UNMEASURED,
    ) -> Branch:
        """The event was spurious, for a ``reason`` or as its ``likelihood`` is small."""
        # An event that can be nothing else is as likely as any in the model's time scale.
        odds = self.priors.spurious if self.priors.spurious > -math.inf else self.priors.rate
        weight = h.weight + len(change.contacts) * odds
        return Branch(weight, h, None, reason, likelihood)


def _logs(probability: float) -> tuple[float, float]:
    """The logarithms of a probability and of its complement."""
    return (math.log(probability) if probability else -math.inf), math.log1p(-probability)
