# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Hypotheses from one event to the next: where they penetrate a stop, an impact was missed."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial

from scipy import special

from impact_observer.estimation.error_accounts import ErrorAccounts
from impact_observer.estimation.forecast import Dip, Flight, Forecast, dips_of
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.hypotheses import NOTHING, Hypothesis, MissedSwitch
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.estimation.missed_switch import insert_switch
from impact_observer.events import Kind

UNLIKELY = -16.0
"""Logarithm of a probability, relative to the largest, below which none is kept before an event:
there they have not paid for what they penetrate.
"""
FORLORN = -40.0
"""The same for hypotheses with an exact model: a misfit shows in how unlikely they are."""
POSSIBLE = 0.5
"""Depth of a dip, in standard deviations, from which on it may have been an impact."""
CONFIDENT = 3.0
"""The same for a dip that is not over yet."""
LATE = 4.0
"""Deviations of a stamp by which an impact may seem to be before an event, and be after it."""
_MOST_MISSED = 256
"""Missed switches that a hypothesis may insert."""
_MOST_FLIGHTS = 256
"""Flights after which none inserts anything: a silence may last for hours."""
_FLIGHTS = 8
"""Flights of which the samples are kept, for hypotheses to share."""


class BetweenEvents:
    """Predicts hypotheses, and inserts switches that the sensor missed.

    Attributes:
        filter: predicts the state of each.
        errors: that a model may have; None where none is learned.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        errors: ErrorAccounts | None,
        *,
        trusts_events: bool,
        missed: float,
        most: int,
        judges: bool,
    ) -> None:
        """For the hypotheses of a bank.

        Args:
            filter_: predicts the state of each.
            errors: that a model may have, or None.
            trusts_events: whether none is spurious and none is missed: then nothing is inserted.
            missed: logarithm of the probability that the sensor misses a switch.
            most: hypotheses of which twice as many are kept.
            judges: whether hypotheses with an exact model are kept for the sake of comparison.
        """
        self.filter = filter_
        self.errors = errors
        self._trusts_events = trusts_events
        self._missed = missed
        self._most = most
        self._judges = judges
        self._flight = Flight if filter_.system.live else lru_cache(_FLIGHTS)(Flight)

    def predict(
        self, hypotheses: Sequence[Hypothesis], t: float, s: float
    ) -> tuple[Hypothesis, ...]:
        """``hypotheses`` of ``t`` (s since the epoch) ``s`` seconds later, the likeliest first.

        One that penetrates a stop branches: the stop was missed by the sensor, or the estimate
        is in error.
        """
        levels = [each.acceleration_error for each in hypotheses]
        if any(each.missed for each in hypotheses):
            hypotheses = [each.later(s) for each in hypotheses]
        if self._trusts_events:
            states = self.filter.priors(t, s, [each.state for each in hypotheses], levels)
            return tuple(
                h._replace(state=state, since=h.since + s)
                for h, state in zip(hypotheses, states, strict=True)
            )
        if len(hypotheses) == 1 and not (dips := self._dips(t, s, hypotheses))[0]:
            return tuple(self._flown(t, s, hypotheses, dips))
        found: list[Hypothesis] = []
        waiting, flights, most = deque([(t, s, hypotheses)]), 0, -math.inf
        while waiting:
            t, s, group = waiting.popleft()
            flights += 1
            dips = self._dips(t, s, group)
            flown = [*self._flown(t, s, group, dips)]
            found += flown
            most = max(most, *(path.weight for path in flown))
            for h, some in zip(group, dips, strict=True):
                if some and flights + len(waiting) < _MOST_FLIGHTS:
                    waiting += self._inserted(h, some, t, s, most + self._least(h))
        if len(found) == 1:
            return tuple(found)
        found.sort(key=lambda each: -each.weight)
        most = found[0].weight
        likely = [h for h in found[: 2 * self._most] if h.weight >= most + self._least(h)]
        return tuple(sorted(likely, key=lambda each: each.penalised_weight, reverse=True))

    def _least(self, h: Hypothesis) -> float:
        """Logarithm of a probability, relative to the largest, below which ``h`` is not kept."""
        return FORLORN if self._judges and h.is_exact else UNLIKELY

    def _dips(self, t: float, s: float, group: Sequence[Hypothesis]) -> list[list[Dip]]:
        """Of each hypothesis the dips in the ``s`` seconds after ``t``."""
        by_kernel = self.filter.gaps((), s) is not None
        free = [each for each in group if by_kernel and not each.state.closed]
        states = [each.state for each in free]
        levels = [each.acceleration_error for each in free]
        found = iter(dips_of(self.filter, t, s, states, levels) or () if free else ())
        return [
            next(found)
            if by_kernel and not h.state.closed
            else self.forecast(t, h.state, h.acceleration_error).dips(s)
            for h in group
        ]

    def _flown(
        self, t: float, s: float, group: Sequence[Hypothesis], dips: Sequence[Sequence[Dip]]
    ) -> Iterator[Hypothesis]:
        """``group`` ``s`` seconds after ``t``; each pays for the dips it goes through."""
        levels = [each.acceleration_error for each in group]
        states = self.filter.priors(t, s, [each.state for each in group], levels)
        for h, state, found in zip(group, states, dips, strict=True):
            some = [dip for dip in found if not self._is_now(dip, s, h.clock)]
            if not some:
                yield h._replace(state=state, penetrating=NOTHING, since=h.since + s)
                continue
            over = sum(dip.unlikely for dip in some if dip.over)
            penetrating = {dip.contact: dip.unlikely for dip in some if not dip.over}
            yield h._replace(
                state=state,
                weight=h.weight + over,
                penetrating=penetrating,
                since=h.since + s,
            )

    def _inserted(
        self, h: Hypothesis, dips: Sequence[Dip], t: float, left: float, enough: float
    ) -> Iterator[tuple[float, float, tuple[Hypothesis, ...]]]:
        """``h`` after its first dip as a missed switch: instant, seconds left, hypothesis.

        None below ``enough``, the logarithm of a probability.
        """
        likely = (
            dip
            for dip in dips
            if dip.depth > (POSSIBLE if dip.over else CONFIDENT)
            and not self._is_now(dip, left, h.clock)
        )
        dip = next(likely, None)
        if dip is None or self._missed == -math.inf or len(h.missed) >= _MOST_MISSED:
            return
        weight = h.weight + self._missed + float(special.log_ndtr(dip.depth))
        if weight < enough:
            return
        at = dip.began
        if at is None:
            at = self.forecast(t, h.state, h.acceleration_error).root(dip)
        t, left = t + at, left - at
        (before,) = self.filter.priors(t - at, at, [h.state], [h.acceleration_error])
        state, kind = insert_switch(self.filter, t, before, dip)
        missed = (*h.missed, MissedSwitch(dip.contact, kind, left, dip.depth))
        h = h._replace(state=state, weight=weight, missed=missed)
        if self.errors is not None:
            hit = (dip.contact,) if kind is Kind.IMPACT and not state.closed else ()
            h = self.errors.kicked(h, before.x, hit)
        yield t, left, (h,)

    def _is_now(self, dip: Dip, now: float, clock: float) -> bool:
        """Whether an impact comes so late that it may be after the event, of which the stamp errs.

        Parameters in doubt leave its instant in doubt: there a dip is now that has just been seen.
        """
        estimates = self.filter.members.family.size > 0
        began = dip.below if dip.began is None or estimates else dip.began
        return not dip.over and now - began <= LATE * clock

    def forecast(self, t: float, state: GaussianState, model_error: float = 0.0) -> Forecast:
        """The prediction of ``state`` from ``t`` (s since the epoch) on, with its penetrations."""
        prediction = self.filter.predict(t, state, model_error)
        flight = partial(self._flight_of, t, state)
        return Forecast(flight, prediction, state, self.filter, t=t, level=model_error)

    def _flight_of(self, t: float, state: GaussianState) -> Flight:
        members = self.filter.members
        member = members.with_given_restitution(self.filter.member(state))
        return self._flight(member, t, state.closed)
