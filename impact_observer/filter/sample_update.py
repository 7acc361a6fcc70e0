# SPDX-License-Identifier: Apache-2.0
"""The hypotheses of a bank, corrected and weighed by samples that are measured beside impacts."""

import math
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy import special

from impact_observer.events import Kind
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.forecast import Dip
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import (
    Hypothesis,
    Jump,
    normalised,
)
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.ledger import MissedSwitch
from impact_observer.filter.missed_switch import insert_switch
from impact_observer.filter.model_error import NO_ERROR
from impact_observer.filter.readings import (
    Place,
    Reading,
    Row,
    SampleOutcome,
)
from impact_observer.filter.settling import rest_after
from impact_observer.filter.tuning import TUNING
from impact_observer.kernel._kernel import measured
from impact_observer.states import Matrix, Vector

_STEPS = 2
"""Most steps of a robot's motion to a sample in which a contact that is open now stayed open."""
_LEAST_RESTITUTION = 1e-3
"""By which a speed after an impact is divided to find the one before."""


class SampleResult(NamedTuple):
    """A state after a sample.

    Attributes:
        state: the state.
        outcome: what became of the sample.
        density: logarithm of the density of the sample, but for a constant.
    """

    state: GaussianState
    outcome: SampleOutcome
    density: float


class _Weighed(NamedTuple):
    """A sample under one hypothesis.

    Attributes:
        hypothesis: after it, with its weight.
        outcome: what became of the sample.
    """

    hypothesis: Hypothesis
    outcome: SampleOutcome

    @property
    def is_finite(self) -> bool:
        """Whether no number of it has overflowed."""
        return math.isfinite(self.hypothesis.weight)  # with the logarithm of a variance in it


_TOO_UNCERTAIN = SampleOutcome(0.0, -1.0, False, "the estimate is too uncertain")


def _is_finite(state: GaussianState) -> bool:
    """Whether no number of a state has overflowed."""
    return math.isfinite(sum(float(each.sum()) for each in state[:4]))


def _judged(innovation: float, normalized: float, gate: float) -> SampleOutcome:
    """Accepted, unless a ``gate`` rejects it."""
    if normalized > gate:
        return _gated(innovation, normalized, gate)
    return SampleOutcome(innovation, normalized)


def _gated(innovation: float, normalized: float, gate: float) -> SampleOutcome:
    reason = f"gate: {normalized:.3g} standard deviations; {gate:g} are allowed"
    return SampleOutcome(innovation, normalized, False, reason)


class SampleFilter:
    """The update of one state by a sample.

    Attributes:
        filter: of the states.
    """

    def __init__(self, filter_: ImpactFilter) -> None:
        """Samples of the system of ``filter_``."""
        self.filter = filter_
        self._sizes = filter_.scales.sizes
        self._parameters = filter_.members.parameters

    def row(self, reading: Reading, state: GaussianState) -> Row:
        """The measured function near a state."""
        sensor, members = reading.sensor, self.filter.members
        at = Place(reading.t, reading.instant, state.x, state.closed)
        if state.parameters:
            row = sensor.row_of(members, state.theta, at)
        else:
            row = sensor.row(members.given.moving, at)
        if period := sensor.period:
            turns = round((reading.value - row.value(state.x)) / period)
            row = row._replace(rest=row.rest + turns * period)
        return row

    def noise(self, row: Row, state: GaussianState, variance: float) -> float:
        """The variance of a sample, with its rounding."""
        if variance > 0:
            return variance
        rounded = row.rounding(self._sizes(state.x))
        return max(variance, 0.0) + rounded * rounded

    def after(self, reading: Reading, state: GaussianState, jump: float = 0.0) -> "SampleResult":
        """A state after a sample, unless its gate rejects that.

        An impact that may have happened already, or not yet, would change the measured function by
        ``jump``.
        """
        row, gate = self.row(reading, state), reading.sensor.measurement.gate
        noise = self.noise(row, state, reading.sensor.variance)
        if not jump:
            about = row.whole, row.rest, reading.value
            found = measured(*state[:4], *about, noise, gate, self._parameters)
            outcome = _judged(found[4], found[5], gate)
            if outcome.accepted:
                state = self._corrected(state, *found[:4])
            return SampleResult(state, outcome, found[6])
        innovation, variance = reading.value - row.value(state.x), row.variance(state.root) + noise
        size = min(abs(innovation), abs(innovation - jump))
        square = min(size * size / variance, gate * gate)
        density = -(square + math.log(variance)) / 2 - math.log(2.0)
        normalized = abs(innovation) / math.sqrt(variance)
        if size > gate * math.sqrt(variance):
            return SampleResult(state, _gated(innovation, normalized, gate), density)
        noise += jump * jump
        about = row.whole, row.rest, reading.value
        found = measured(*state[:4], *about, noise, math.inf, self._parameters)
        reason = "in part: an impact is about to happen, or has just happened"
        outcome = SampleOutcome(innovation, normalized, True, reason)
        return SampleResult(self._corrected(state, *found[:4]), outcome, density)

    def after_together(
        self, readings: Sequence[Reading], state: GaussianState
    ) -> tuple[GaussianState, list[tuple[float, float, float]]]:
        """A state after samples of one instant, unless their gates reject them.

        Returns:
            The state; and of each sample the innovation, its magnitude in standard deviations,
            and the density.
        """
        x, constants, root, others = state[:4]
        numbers = []
        for reading in readings:
            row, gate = self.row(reading, state), reading.sensor.measurement.gate
            about = row.whole, row.rest, reading.value, reading.sensor.variance, gate
            found = measured(x, constants, root, others, *about, self._parameters)
            x, constants, root, others = found[:4]
            numbers.append(found[4:])
        return self._corrected(state, x, constants, root, others), numbers

    def _corrected(
        self, state: GaussianState, x: Vector, constants: Vector, root: Matrix, others: Matrix
    ) -> GaussianState:
        """``state`` with other numbers, and parameters within their bounds."""
        if p := state.parameters:
            z = np.concatenate([x, constants])
            z = self._parameters.bounded(z, root, x.size)
            x, constants = z[: x.size], z[x.size :]
        return GaussianState(x, constants, root, others, state.closed, p)


class SampleUpdate:
    """Corrects and weighs the hypotheses of a bank by samples."""

    def __init__(self, bank: FilterBank) -> None:
        """Samples for the hypotheses of ``bank``."""
        self.bank = bank
        self.one = SampleFilter(bank.filter)

    def after(
        self,
        reading: Reading,
        hypotheses: Sequence[Hypothesis],
        largest: Vector | None = None,
        restart: Callable[[], GaussianState] | None = None,
    ) -> tuple[tuple[Hypothesis, ...], SampleOutcome]:
        """``hypotheses`` after a sample, the likeliest first; the outcome is that of this one.

        Where a sensor contradicts the estimate for long, a covariance is tried that is wider, as
        far as the motion has been ``largest``, and the state of a ``restart``.
        """
        doubt, before = reading.rejected >= TUNING.rejected_samples, len(hypotheses)
        if doubt or any(h.survival for h in hypotheses):
            hypotheses = [
                branch
                for h in hypotheses
                for branch in self._branches(reading, h, largest if doubt else None)
            ]
            if doubt and restart is not None and not self.bank.trusts_estimate:
                best = max(hypotheses, key=attrgetter("weight"))
                begun = best._replace(
                    state=restart(),
                    weight=best.weight + TUNING.log_restart,
                    ledger=best.ledger._replace(missed=()),
                    survival={},
                    error=NO_ERROR,
                    jump=Jump(),
                    jump_error=best.jump_unexplained,
                )
                hypotheses = [*hypotheses, begun]
        with np.errstate(over="ignore", invalid="ignore"):
            finite = [h for h in hypotheses if _is_finite(h.state)]
            weighed = [self._weighed(reading, h) for h in finite]
        weighed = [each for each in weighed if each.is_finite]
        if not weighed:
            return tuple(hypotheses), _TOO_UNCERTAIN
        return self._kept(weighed, new=len(weighed) > before)

    def followed(
        self, readings: Sequence[Reading], hypotheses: Sequence[Hypothesis], since: float, s: float
    ) -> tuple[tuple[Hypothesis, ...], list[SampleOutcome]] | None:
        """``after`` samples of one instant of hypotheses that hold ``s`` seconds before it.

        They hold ``since`` the epoch, s. By one call of the kernel where the system is linear.
        None where anything is in doubt, or not for the kernel: then they are to be predicted
        first, and to be corrected by one sample at a time.
        """
        is_doubted = any(each.rejected >= TUNING.rejected_samples for each in readings)
        if readings[0].closed or is_doubted or not all(h.is_undisturbed for h in hypotheses):
            return None
        if self.bank.filter.is_of_robot:
            return self._followed_together(readings, hypotheses, since, s)
        return None if len(readings) > 1 else self._followed(readings[0], hypotheses, since, s)

    def _followed(
        self, reading: Reading, hypotheses: Sequence[Hypothesis], since: float, s: float
    ) -> tuple[tuple[Hypothesis, ...], list[SampleOutcome]] | None:
        """The same of a sample of a linear system, by the kernel."""
        if not self._is_for_kernel(reading, s):
            return None
        row, gate = self.one.row(reading, hypotheses[0].state), reading.sensor.measurement.gate
        made = self.bank.filter.members.free_gaps.followed(
            since,
            s,
            [h.state for h in hypotheses],
            np.array([h.acceleration_error for h in hypotheses]),
            self.bank.filter.noise,
            row.h,
            row.rest,
            reading.value,
            reading.sensor.variance,
            gate,
            not self.bank.trusts_events,
        )
        if made is None:
            return None
        weighed = []
        for h, found in zip(hypotheses, made, strict=True):
            _, _, _, _, innovation, normalized, density = found
            after, weight = GaussianState(*found[:4]), h.weight + density
            followed = h._replace(state=after, weight=weight, jump=h.jump.later(s))
            weighed.append(_Weighed(followed, _judged(innovation, normalized, gate)))
        goes_on = len(weighed) == 1 and not weighed[0].outcome.accepted  # the state before it
        if goes_on or not all(each.is_finite for each in weighed):
            return None
        kept, outcome = self._kept(weighed, new=False)
        return kept, [outcome]

    def _followed_together(
        self, readings: Sequence[Reading], hypotheses: Sequence[Hypothesis], since: float, s: float
    ) -> tuple[tuple[Hypothesis, ...], list[SampleOutcome]] | None:
        """The same of a robot: one motion, and one step of the bank, for all its encoders."""
        longest = _STEPS * self.bank.filter.members.given.moving.first_window
        if not (all(each.sensor.variance > 0 for each in readings) and 0 <= s <= longest):
            return None
        predicted = self.bank.between.undisturbed(hypotheses, since, s)
        if predicted is None:
            return None
        made = [self.one.after_together(readings, h.state) for h in predicted]
        found = [
            h._replace(state=state, weight=h.weight + sum(each[2] for each in numbers))
            for h, (state, numbers) in zip(predicted, made, strict=True)
        ]
        if not all(math.isfinite(h.weight) for h in found):
            return None
        numbers = made[max(range(len(found)), key=lambda k: found[k].weight)][1]
        outcomes = [
            _judged(innovation, normalized, each.sensor.measurement.gate)
            for each, (innovation, normalized, _) in zip(readings, numbers, strict=True)
        ]
        return self._kept_of(found, new=False), outcomes

    def _is_for_kernel(self, reading: Reading, s: float) -> bool:
        """Whether the kernel can follow a sensor for ``s`` seconds."""
        filter_ = self.bank.filter
        if reading.sensor.variance <= 0 or filter_.members.family.size:
            return False
        return filter_.members.given.moving.is_short(s) and filter_.gaps((), s) is not None

    def _kept(
        self, weighed: Sequence[_Weighed], *, new: bool
    ) -> tuple[tuple[Hypothesis, ...], SampleOutcome]:
        """The likely ones; where some are ``new`` they may have become alike."""
        first = max(weighed, key=lambda each: each.hypothesis.weight)
        return self._kept_of([each.hypothesis for each in weighed], new=new), first.outcome

    def _kept_of(self, found: Sequence[Hypothesis], *, new: bool) -> tuple[Hypothesis, ...]:
        """The likely ones of hypotheses that are weighed."""
        if len(found) == 1:
            return (found[0]._replace(weight=0.0),)
        kept = self.bank.pruning.likely(sorted(found, key=lambda h: -h.weight))
        kept = self.bank.pruning.distinct(kept) if new else kept
        return normalised(self.bank.pruning.settled_jumps(kept))

    def _branches(
        self, reading: Reading, h: Hypothesis, largest: Vector | None
    ) -> Iterator[Hypothesis]:
        """What may have happened before a sample, under one hypothesis."""
        yield from self._settled(reading, h)
        if largest is not None and not self.bank.trusts_estimate:
            row = self.one.row(reading, h.state)
            noise = self.one.noise(row, h.state, reading.sensor.variance)
            variance = row.variance(h.state.root) + noise
            depth = abs(reading.value - row.value(h.state.x)) / math.sqrt(variance)
            if depth > reading.sensor.measurement.gate:
                wider = self.bank.filter.widened(h.state, TUNING.widening * depth, largest)
                yield h._replace(
                    state=wider,
                    weight=h.weight + TUNING.log_restart,
                    jump_error=h.jump_unexplained,
                )

    def _settled(self, reading: Reading, h: Hypothesis) -> Iterator[Hypothesis]:
        """``h``, and what it is if the impacts have happened that it penetrates.

        A sample ends a dip: either the estimate is in error, or an impact was missed.
        """
        yield h
        for contact, unlikely in h.survival.items():
            depth = -float(special.ndtri_exp(unlikely))
            between = self.bank.between
            dead = between.dead(h, contact, Kind.IMPACT, reading.t)
            missed = between.log_missed(dead)
            is_possible = TUNING.possible_depth < depth <= TUNING.confident_depth
            if not is_possible or missed == -math.inf:
                continue
            dip = Dip(contact, Kind.IMPACT, 0, 0.0, 0.0, 0.0, depth, unlikely, False, 0.0)
            if (after := insert_switch(self.bank.filter, reading.t, h.state, dip)) is None:
                continue
            state, kind, flight = after
            weight = h.weight_without((contact,)) + missed + float(special.log_ndtr(depth))
            switch, rest = MissedSwitch(contact, kind, 0.0, depth, dead > TUNING.dead), None
            if kind is Kind.CLOSE:
                rest = rest_after(self.bank.filter, contact, reading.t, flight, h.clock)
            yield h._replace(
                state=state,
                weight=weight,
                ledger=h.ledger.with_missed(switch, rest),
                survival=h.survival_without((contact,)),
                jump=Jump(),
            )

    def _weighed(self, reading: Reading, h: Hypothesis) -> _Weighed:
        result = self.one.after(reading, h.state, self._jump_in_doubt(reading, h))
        state, outcome, density = result
        blanking = reading.sensor.measurement.blanking
        if h.ledger.missed and min(each.ago for each in h.ledger.missed) < blanking:
            # What is not used does not judge: as likely as any sample that is expected.
            density += (min(outcome.normalized, reading.sensor.measurement.gate) ** 2 - 1) / 2
            reason = f"blanking: an impact that was missed is less than {blanking:g} s ago"
            outcome = SampleOutcome(outcome.innovation, outcome.normalized, False, reason)
            return _Weighed(h._replace(weight=h.weight + density), outcome)
        return _Weighed(h._replace(state=state, weight=h.weight + density), outcome)

    def _jump_in_doubt(self, reading: Reading, h: Hypothesis) -> float:
        """By how much an impact changes a sample that may be before it, or after it.

        An impact is stamped early or late by a few deviations of the clock. Meanwhile the estimate
        is inside the stop, or has jumped too early.
        """
        state, system = h.state, self.bank.filter.near(h.state.x)
        gaps, n = system.gap(state.x[: system.n]), system.n
        if not system.m or gaps.min() >= 0:
            return 0.0
        squares, row = 0.0, None
        speeds = system.contact_speed(state.x[n:])
        for i in np.flatnonzero(gaps < 0).tolist():
            if i not in state.closed and -gaps[i] <= TUNING.late * h.clock * abs(speeds[i]):
                row = row or self.one.row(reading, state)
                squares += self._jump(row, state.x, i, float(speeds[i])) ** 2
        return math.sqrt(squares)

    def _jump(self, row: Row, x: Vector, contact: int, speed: float) -> float:
        """By how much an impact changes a measured function of a state."""
        mirror = self.bank.filter.members.given.mirror_about(x, (contact,))
        change = float(row.h.dot(mirror.landed(x) - x))
        eps = max(float(self.bank.filter.system.eps[contact]), _LEAST_RESTITUTION)
        return change / eps if speed > 0 else change  # it has jumped: the state before was faster
