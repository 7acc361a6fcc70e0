# SPDX-License-Identifier: Apache-2.0
"""Hypotheses that the sensor's clock has stepped: later stamps are shifted by one duration.

The plant has not changed, so the state before the step holds on. The next predicted impact of a
contact gives the shift; events that follow decide whether there was a step.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

from impact_observer.events import Kind
from impact_observer.filter.branching import Extent
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis, log_sum, normalised
from impact_observer.filter.missed_switch import insert_switch
from impact_observer.filter.tuning import TUNING
from impact_observer.stamps import NS_PER_S

_ROOT_2PI = math.sqrt(2 * math.pi)


class ClockStep(NamedTuple):
    """Hypotheses by which the clock has stepped before some event.

    Attributes:
        shift: of the stamps since then, ns.
        t: when the hypotheses hold, s since the epoch by the clock before the step.
        hypotheses: the likeliest first; their probabilities add up to one.
        odds: logarithm of the probability of the step over that of no step.
        events: how many have been weighed since the step began.
    """

    shift: int
    t: float
    hypotheses: tuple[Hypothesis, ...]
    odds: float
    events: int = 0


class SensorClock(NamedTuple):
    """Steps of the sensor's clock: the shift so far, and hypotheses on further steps.

    Attributes:
        late: how late stamps are by all steps so far, ns.
        before: the hypotheses after the last event; None where no step is tried.
        possible: further steps that may have been, the likeliest first.
    """

    late: int = 0
    before: ClockStep | None = None
    possible: tuple[ClockStep, ...] = ()


class ClockSteps:
    """Tries steps of the clock at events that the bank of hypotheses did not expect."""

    def __init__(self, bank: FilterBank) -> None:
        """Steps of the clock whose events ``bank`` weighs."""
        self._bank = bank
        self._filter = bank.filter
        self._log_rate = bank.branching.priors.rate

    def after(
        self,
        change: ContactChange,
        clock: SensorClock,
        evidence: float,
        extent: Extent,
    ) -> tuple[ClockStep, ...]:
        """The steps that are possible after an event, the likeliest first.

        Something else may be wrong at an event, as probably as a step: no single one shows it. A
        step explains events that follow far better than no step does, or something else is wrong.

        Args:
            change: the event.
            clock: the shift and the hypotheses before the event.
            evidence: logarithm of the density of the event without a step.
            extent: of the motion.
        """
        anything = TUNING.log_clock_step + self._log_rate
        evidence = max(evidence, anything)
        steps = [self._followed(change, each, extent) for each in clock.possible]
        if clock.before is not None and anything - evidence > TUNING.log_possible_step:
            enough = TUNING.log_possible_step + evidence
            steps += self._begun(change, clock.before, extent, enough)
        steps = [each._replace(odds=each.odds - evidence) for each in steps if each.hypotheses]
        steps = [
            each
            for each in steps
            if each.odds > TUNING.log_possible_step and each.events <= TUNING.step_events
        ]
        return tuple(sorted(steps, key=lambda each: -each.odds)[: TUNING.possible_steps])

    def _followed(self, change: ContactChange, step: ClockStep, extent: Extent) -> ClockStep:
        """The ``step`` after an event, with the density of the event in its odds."""
        t = change.t - step.shift / NS_PER_S
        flown = t - step.t
        if flown < 0:
            return step._replace(hypotheses=())
        shifted = change._replace(t=t, flown=flown)
        predicted = self._bank.between.predict(step.hypotheses, step.t, flown)
        found = self._bank.weighed(shifted, predicted, tuple, extent)
        odds = step.odds + (log_sum([h.weight for h in found]) if found else 0.0)
        return ClockStep(step.shift, t, normalised(found), odds, step.events + 1)

    def _begun(
        self, change: ContactChange, before: ClockStep, extent: Extent, enough: float
    ) -> Iterator[ClockStep]:
        """Steps before an event, each by an impact of its contact that was predicted.

        Odds up to ``enough`` do not count. At most they are those of the impacts that were missed
        on the way, as the event cannot be likelier than at its prediction.
        """
        most = TUNING.log_clock_step + self._log_rate
        exact = [h for h in before.hypotheses if h.is_exact]
        if not (exact and len(change.hit) == 1):
            return
        h = max(exact, key=lambda each: each.weight)
        if h.ledger.events < TUNING.first_events:
            return
        (contact,), latest = change.hit, float(change.t) + TUNING.largest_step
        for t, prior, missed in self._impacts(before.t, h, contact, latest - before.t):
            if most + missed <= enough:
                return
            shift = round((change.t - t) * NS_PER_S)
            if abs(shift) > TUNING.largest_step * NS_PER_S:
                continue
            deviation = self._deviation(contact, prior, h.clock)
            doubted = h._replace(state=h.state.with_offset_error(deviation), weight=0.0)
            odds = TUNING.log_clock_step + self._log_rate + math.log(_ROOT_2PI * deviation)
            yield self._followed(change, ClockStep(shift, before.t, (doubted,), odds), extent)

    def _impacts(
        self, t: float, h: Hypothesis, contact: int, duration: float
    ) -> Iterator[tuple[float, GaussianState, float]]:
        """The next impacts of a contact: instants, s since the epoch, and states before them.

        Beside each stands the logarithm of the probability that the switches before the impact
        were missed, or that the estimate is in error.
        """
        state, level, missed, between = h.state, h.acceleration_error, 0.0, self._bank.between
        for _ in range(TUNING.possible_steps):
            if (dip := between.forecast(t, state, level).first_dip(duration)) is None:
                return
            (prior,) = self._filter.priors(t, dip.began, [state], [level])
            t, duration = t + dip.began, duration - dip.began
            if dip.contact == contact and dip.kind is Kind.IMPACT:
                yield t, prior, missed
            if (inserted := insert_switch(self._filter, t, prior, dip)) is None:
                return
            dead = between.dead(h, dip.contact, dip.kind, t)
            missed += max(between.log_missed(dead), dip.unlikely)
            state = inserted.state

    def _deviation(self, contact: int, prior: GaussianState, clock: float) -> float:
        """Standard deviation of the shift of the stamps, s, well above what the event leaves."""
        speed = abs(self._filter.speed(contact, prior))
        gap = self._filter.gap_deviation(contact, prior.x, prior.root)
        known = math.hypot(clock, gap / speed) if speed else math.inf
        return min(TUNING.step_deviation * known, TUNING.largest_step)
