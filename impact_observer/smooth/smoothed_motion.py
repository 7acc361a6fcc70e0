# SPDX-License-Identifier: Apache-2.0
"""The smoothed motion at any instant, and the smoothed instants of its impacts."""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache, cached_property, partial
from itertools import chain, takewhile
from typing import NamedTuple

import numpy as np
from scipy import linalg, special

from impact_observer.events import ImpactEstimate, Ruling, SmoothedImpact
from impact_observer.filter.contradiction import Contradiction, contradictions
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_deviations import balance_at
from impact_observer.filter.joint import Joint
from impact_observer.filter.linear import LinearPrediction
from impact_observer.filter.uncertainty import LARGEST_DEVIATION, Uncertainty
from impact_observer.kernel._kernel import TINY
from impact_observer.model.time_shift import TimeShift
from impact_observer.observer.belief import Belief, Parameters, Prediction
from impact_observer.observer.impact_sides import EXACT, REACH, side_error
from impact_observer.smooth.account import EventAccount, Moment, TracedLaw
from impact_observer.smooth.arc import Node
from impact_observer.smooth.chain import Normal
from impact_observer.smooth.linearised import IMPOSSIBLE
from impact_observer.smooth.sensor_summary import SensorSummary, sensor_summaries
from impact_observer.smooth.smoother import Smoothed, at_samples
from impact_observer.stamps import Elapsed
from impact_observer.stamps import text as stamp_text
from impact_observer.states import Estimate, Estimates, Matrix, Stamps, Vector

LAW = "smoother"
"""The name of the law in estimates of the smoother."""


_ONE_START_IN = 1e-6
"""Share of true starts that are so far from the declared start that a warning is due."""
_DOUBTED = (
    "the model may not explain the impacts; `identify BAG --check --clock-error S` tests it, see"
    " docs/troubles.md"
)
_CHANCE_IN = 1e-3
"""Share of true motions that explain the events less well: below this share shifts are excess."""
_BY_FILTER = (
    "the smoothed motion {}: the states are the filter's, from the impacts before each instant;"
    " see docs/troubles.md"
)
_FAR = 5.0
"""Deviations of a stamp beyond which the motion does not explain it."""


class Doubt(NamedTuple):
    """Another account of the first events, nearly as likely.

    Attributes:
        odds: of the other to the chosen one; 0 without another.
        far: distance of the first states, in standard deviations.
        until: stamp from which on both accounts are the same, ns.
    """

    odds: float = 0.0
    far: float = 0.0
    until: int = 0

    @property
    def text(self) -> str:
        """The warning; empty without a doubt."""
        if not self.odds:
            return ""
        return (
            f"another account of the events before {stamp_text(self.until)} s is {self.odds:.2g}"
            f" times as likely, and begins {self.far:.2g} deviations from here; see"
            " docs/troubles.md"
        )


NO_DOUBT = Doubt()


class SmoothedMotion:
    """The motion in one run of the sender, by all of its events.

    Attributes:
        start: stamp of the first state, ns.
        smoothed: its states at the moments.
        account: the meaning of each event.
        doubt: another account of the first events.
    """

    def __init__(
        self,
        smoothed: Smoothed,
        account: EventAccount,
        law: TracedLaw,
        *,
        start: int,
        epoch: int,
        doubt: Doubt = NO_DOUBT,
        filtered: Callable[[Stamps], Iterator[Estimates]] = lambda _: iter(()),
        filtered_impacts: Callable[[], Iterable[ImpactEstimate]] = tuple,
    ) -> None:
        """A motion by ``law``; stamps (ns) of the first state, and of ``t = 0``.

        ``filtered`` gives the filter's estimates at stamps, ``filtered_impacts`` of all impacts.
        """
        self.smoothed, self.account, self.start = smoothed, account, start
        self.doubt, self._filtered, self._filtered_impacts = doubt, filtered, filtered_impacts
        self._law, self._epoch = law, epoch
        self._names = law.system.contact_names
        applied = {
            (each.stamp, each.sequence)
            for each in account.verdicts
            if each.ruling is Ruling.APPLIED
        }
        self._applied = sorted(applied)
        self._instants = np.array([self._instant(k) for k in range(len(account.moments))])
        self._spread, self._kick = cache(self._spread_of), cache(self._kick_of)

    def impacts(self) -> Iterator[SmoothedImpact]:
        """All impacts and releases, in the order of the moments."""
        for k, moment in enumerate(self.account.moments):
            early, deviation = self.smoothed.instant(k)
            if self.fallback:
                deviation = math.hypot(self._widened * deviation, early)
            change = moment.change
            reported, ruling = change.stamp, Ruling.APPLIED
            if moment.is_inserted:
                reported, ruling = 0, Ruling.INSERTED
            for i in change.contacts:
                yield SmoothedImpact(
                    int(self._instants[k]),
                    reported,
                    change.sequence,
                    self._names[i],
                    ruling,
                    deviation,
                )

    def impact_estimates(self) -> Iterator[ImpactEstimate]:
        """The estimates of all impacts, in the order of the moments, by the smoothed motion.

        Where the motion cannot be used, they are those of the filter.
        """
        if self.fallback:
            yield from self._filtered_impacts()
            return
        arc, n = self.smoothed.arc, self._law.system.n
        for k, moment in enumerate(self.account.moments):
            if not (change := moment.change).hit:
                continue
            joint = self._joint(k)
            sizes = self._law.filter.scales.sizes(joint.x)
            least = self._uncertainty.least_deviations(joint.x, sizes)
            # Where contacts rest, the jump has no other error.
            errors = joint.root[:, :0] if change.closed else arc.left(self.smoothed.path, k).N
            balance = balance_at(arc.filter.members, change, joint, least, errors[n : 2 * n])
            stamp, sequence = int(self._instants[k]), change.sequence
            ruling = Ruling.INSERTED if moment.is_inserted else Ruling.APPLIED
            for i, own in zip(change.hit, balance.rows.tolist(), strict=True):
                yield ImpactEstimate(stamp, self._names[i], ruling, sequence, *own)

    def _joint(self, k: int) -> Joint:
        """The smoothed instant of the ``k``-th moment, and the state then, before the jump."""
        arc, z = self.smoothed.arc, self.smoothed.known.state(Node(k))
        t, root, others = arc.instant(self.smoothed.path, k), self._widened * z.root, z.root[:, :0]
        size, parameters = 2 * self._law.system.n, arc.filter.members.family.size
        return Joint(t, z.mean, root, others, size, parameters)

    def estimates(self, stamps: Stamps) -> Iterator[Estimates]:
        """The states at ``stamps`` (ns, ascending, shape (samples,)); none before the start.

        The state at an impact is that just after the impact. Where the motion cannot be used, the
        states are those of the filter.
        """
        stamps = stamps[np.searchsorted(stamps, self.start) :]
        if self.fallback:
            misfit = self.misfit or self.fallback
            for each in self._filtered(stamps):
                first = replace(each.first, law=LAW, synchronized=False, misfit=misfit)
                yield replace(each, first=first)
            return
        order = np.maximum.accumulate(self._instants) if self._instants.size else self._instants
        flights = np.searchsorted(order, stamps, side="right") - 1
        last = len(self.account.moments) - 1
        flown = {k: stamps[flights == k] for k in np.unique(flights).tolist()}
        noisy = {k: here for k, here in flown.items() if k < last and self._is_noisy(k)}
        after = flown.get(last, stamps[:0])
        if self.smoothed.arc.is_of_robot:
            until = int(np.searchsorted(after, self._last_sample, side="right"))
            noisy[last], after = after[:until], after[until:]
        sampled = self._sampled(noisy)
        for k, here in flown.items():
            if k in noisy:
                yield from self._given(k, here, sampled)
            elif k < last:
                yield from self._flown(k, here)
        if after.size:
            yield from self._predicted(last, after)

    @property
    def _last_sample(self) -> int:
        """Stamp of the last sample of a sensor, ns; 0 without one."""
        readings = self.account.samples.readings
        return self._epoch + max((each.instant for each in readings), default=-self._epoch)

    def _instant(self, k: int) -> int:
        """The smoothed instant of a moment, ns."""
        early, _ = self.smoothed.instant(k)
        return max(self.account.moments[k].change.stamp - round(early * 1e9), self.start)

    def _flown(self, k: int, stamps: Stamps) -> Iterator[Estimates]:
        """States in the flight after the ``k``-th moment, which has no noise."""
        t, after = self.smoothed.arc.instant(self.smoothed.path, k), self.smoothed.state_after(k)
        members = self.smoothed.arc.filter.members
        flight = LinearPrediction(t, self._state(after, k), members, 0.0)
        for stamp in stamps.tolist():
            s = Elapsed(stamp - self._epoch) - t
            yield self._estimate(stamp, k, flight.state(s), flight.root(s))

    def _is_noisy(self, k: int) -> bool:
        return self.smoothed.arc.noise_after(k) > 0

    def _sampled(self, stamps: Mapping[int, Stamps]) -> Iterator[Normal]:
        """States at ``stamps`` in flights with process noise, smoothed from both ends."""
        if not stamps:
            return iter(())
        times = {
            k: [Elapsed(stamp - self._epoch) for stamp in here.tolist()]
            for k, here in stamps.items()
        }
        return at_samples(self.smoothed, times)

    def _given(self, k: int, stamps: Stamps, states: Iterator[Normal]) -> Iterator[Estimates]:
        """Estimates of the next ``states``, at ``stamps`` after the ``k``-th moment."""
        size = 2 * self._law.system.n
        for stamp, z in zip(stamps.tolist(), states, strict=False):
            yield self._estimate(stamp, k, z.mean[:size], z.root[:size])

    def _predicted(self, k: int, stamps: Stamps) -> Iterator[Estimates]:
        """Predictions of the filter after the last moment, from the smoothed state."""
        t = self.smoothed.arc.instant(self.smoothed.path, k)
        prediction = self._prediction(k, t)
        for stamp in stamps.tolist():
            s = max(Elapsed(stamp - self._epoch) - t, 0.0)
            closed, root = prediction.closed(s), prediction.root(s)
            assert root is not None, "the law has a covariance"
            yield self._estimate(stamp, k, prediction.state(s), root, closed)

    def _prediction(self, k: int, t: float) -> Prediction:
        state, last = self._state(self.smoothed.state_after(k), k), self._law.last
        if last is None or last.fallback is None:
            belief = Belief(state.ensemble, state.root)
        else:
            moment: Moment = self.account.moments[k]
            best = Hypothesis(state, moment.clock, error=moment.error)
            belief = Belief(state.ensemble, hypotheses=(best,), fallback=last.fallback)
        return self._law.predict(t, belief, state.closed)

    def _state(self, z: Normal, k: int) -> GaussianState:
        """The state ``z`` after the ``k``-th moment as a state of the filter."""
        size, closed = 2 * self._law.system.n, self.smoothed.arc.closed_after(k)
        others = np.zeros((z.mean.size, 0))
        parameters = self._law.filter.members.family.size
        return GaussianState(z.mean[:size], z.mean[size:], z.root, others, closed, parameters)

    def _estimate(
        self, stamp: int, k: int, x: Vector, root: Matrix, closed: tuple[int, ...] | None = None
    ) -> Estimates:
        n, system = self._law.system.n, self.smoothed.arc.filter.system
        last_event, last_sequence = self._last_event(k, stamp)
        sizes = self._law.filter.scales.sizes(x)
        root = np.column_stack([self._widened * root, *self._other_sides(stamp, k)])
        covariance = self._uncertainty.published_covariance(root, x, sizes)
        if system.frame is not None:
            (x,) = system.from_frame(np.array([stamp - self._epoch]), x[None])
        held = self.smoothed.arc.closed_after(k) if closed is None else closed
        warning, until = self.early_doubt
        misfit = self.misfit or (warning if stamp < until else "")
        estimate = Estimate(
            stamp=stamp,
            law=LAW,
            q=x[:n],
            u=x[n:],
            covariance=covariance,
            closed=tuple(self._names[i] for i in held),
            synchronized=self.smoothed.is_settled and not misfit,
            misfit=misfit,
            clock_offset=self._constants.offset,
            parameters=self.parameters,
            last_sequence=last_sequence,
            last_event=last_event,
        )
        return Estimates(estimate, np.array([stamp]), x[None])

    def _other_sides(self, stamp: int, k: int) -> Iterator[Vector]:
        """Errors of a state after the ``k``-th moment, where impacts may be on its other side."""
        near = partial(self._is_near, stamp)
        before, after = range(k, -1, -1), range(k + 1, len(self.account.moments))
        for j in chain(takewhile(near, before), takewhile(near, after)):
            away = abs(stamp - int(self._instants[j])) * 1e-9 / self._spread(j)
            yield side_error(float(special.ndtr(-away)), self._kick(j))

    def _is_near(self, stamp: int, k: int) -> bool:
        """Whether the instant of the ``k``-th moment may be before ``stamp`` or after that."""
        spread = self._spread(k)
        return spread > EXACT and abs(stamp - int(self._instants[k])) * 1e-9 < REACH * spread

    def _spread_of(self, k: int) -> float:
        """The standard deviation of the instant of the ``k``-th moment, s."""
        return self.smoothed.instant(k)[1]

    def _kick_of(self, k: int) -> Vector:
        """By how much the velocities jump at the ``k``-th moment, shape (n,)."""
        n, before = self._law.system.n, self.smoothed.known.state(Node(k)).mean[1:]
        return (self.smoothed.state_after(k).mean - before)[n : 2 * n]

    def _last_event(self, k: int, stamp: int) -> tuple[int, int]:
        """Stamp (ns) and sequence of the last event applied in the flight after a moment."""
        change = self.account.moments[k].change if k >= 0 else None
        own = (change.stamp, change.sequence) if change else (0, 0)
        before = bisect_left(self._applied, (stamp + 1, 0))
        return max(own, self._applied[before - 1]) if before else own

    @cached_property
    def _constants(self) -> GaussianState:
        """The state at the start, of which only the constants matter."""
        return self._state(self.smoothed.first, -1)

    @cached_property
    def sensors(self) -> tuple[SensorSummary, ...]:
        """What became of the samples of each sensor."""
        return tuple(sensor_summaries(self.smoothed))

    @cached_property
    def parameters(self) -> tuple[tuple[str, float, float], ...]:
        """Parameters estimated beside the state: name, value, standard deviation, SI units."""
        names = self._law.filter.members.family.names
        size, theta = 2 * self._law.system.n, self._constants.theta.tolist()
        deviations = self.smoothed.first.deviations[size:].tolist()
        rows = [*zip(names, theta, deviations, strict=False)]
        if len(deviations) > len(names):
            rows.append(("clock_offset", self._constants.offset, deviations[-1]))
        return tuple(rows)

    @cached_property
    def contradictions(self) -> tuple[Contradiction, ...]:
        """Smoothed parameters that are too far from the declared ones.

        The declared deviations count, also where a doubted model has wider ones.
        """
        return contradictions(self.parameters, self._law.uncertainty.declared_constants)

    @property
    def fallback(self) -> str:
        """Why the states are those of the filter, in words; empty if they are smoothed."""
        if self.contradictions:
            return _BY_FILTER.format("needs values that contradict the declared ones")
        return "" if self.smoothed.is_settled else _BY_FILTER.format("has not settled")

    @cached_property
    def early_doubt(self) -> tuple[str, int]:
        """Why the first states are in doubt, and until which stamp (ns); empty without a doubt.

        Another account is nearly as likely; or the smoothed start is as far from the declared one
        as one true start in a million. Most wrong accounts lead to such a start.
        """
        if self.doubt.odds:
            return self.doubt.text, self.doubt.until
        prior, size = self.smoothed.arc.first, 2 * self._law.system.n
        moved, root = self.smoothed.first.mean[:size] - prior.mean[:size], prior.root[:size]
        declared = root.any(axis=1)
        distance = float(np.linalg.norm(linalg.lstsq(root[declared], moved[declared])[0]))
        if distance**2 <= special.chdtri(int(declared.sum()), _ONE_START_IN) or not len(
            self.account.moments
        ):
            return "", 0
        until = self.account.moments[: size + 1][-1].change.stamp
        text = (
            f"the smoothed start is {distance:.2g} standard deviations from the declared one: the"
            " account of the first events or the declared start is wrong; see docs/troubles.md"
        )
        return text, until

    @property
    def is_unexplained(self) -> bool:
        """Whether the motion leaves shifts that no error of the clock explains."""
        return self.unexplained > 0 or self._excess > 0

    @cached_property
    def unexplained(self) -> int:
        """Number of reported instants that are too far from the motion."""
        return sum(
            abs(residual) > _FAR
            or self.smoothed.arc.log_slope(self.smoothed.path, k) <= IMPOSSIBLE
            for k, residual in self._residuals.items()
        )

    @cached_property
    def _residuals(self) -> dict[int, float]:
        """Errors of the stamps of reported moments, in their deviations, by their index."""
        late = self._constants.offset
        return {
            k: (self.smoothed.instant(k)[0] - late) / self._clock(k)
            for k, moment in enumerate(self.account.moments)
            if not moment.is_inserted
        }

    def _clock(self, k: int) -> float:
        """Standard deviation of the stamp of the ``k``-th moment, s."""
        return max(self.account.moments[k].clock, TINY)

    @cached_property
    def _widened(self) -> float:
        """Factor of all deviations, above 1 if the motion does not explain the stamps."""
        squares = [each * each for each in self._residuals.values()]
        rms = math.sqrt(sum(squares) / len(squares)) if self.unexplained else 1.0
        change = 1.0 if self.smoothed.is_settled else self.smoothed.change
        return min(max(rms, change, 1.0), LARGEST_DEVIATION)

    @cached_property
    def _excess(self) -> float:
        """Shifts of the stamps over the declared clock error; 0 where chance explains these.

        Of the error of a stamp the motion takes up the variance of its smoothed instant: all
        together no more than there are unknowns, beside noise that follows no stamp.
        """
        if not self._law.uncertainty.clock_error or len(self._residuals) < 2:
            return 0.0
        taken = [self.smoothed.instant(k)[1] / self._clock(k) for k in self._residuals]
        unknowns = min(float(np.sum(np.square(taken))), self.smoothed.first.mean.size)
        freedom = max(len(taken) - unknowns, 1.0)
        squares = float(np.sum(np.square([*self._residuals.values()])))
        is_chance = special.chdtrc(freedom, squares) >= _CHANCE_IN
        return 0.0 if is_chance else math.sqrt(squares / freedom)

    @cached_property
    def _uncertainty(self) -> Uncertainty:
        """What is declared; where the shifts are larger, with the largest of these."""
        declared = self._law.uncertainty
        if not self._excess:
            return declared
        shifts = [r * self._clock(k) for k, r in self._residuals.items()]
        stamps = [self.account.moments[k].change.stamp - self.start for k in self._residuals]
        shown = TimeShift.of(np.array(shifts), np.array(stamps) * 1e-9)
        return replace(declared, shift=max(declared.shift, shown))

    @cached_property
    def misfit(self) -> str:
        """The warning that the motion does not explain the impacts; empty without a misfit."""
        if self.unexplained:
            return (
                f"{self.unexplained} of {len(self.account.moments)} impacts are more than"
                f" {_FAR:g} deviations of their stamps from the smoothed motion: the account of"
                " the events or the model is wrong; see docs/troubles.md"
            )
        if self._excess:
            return (
                f"shifts of the stamps are {self._excess:.2g} times the declared clock error, and"
                f" deviations contain one of {self._uncertainty.shift.largest:.2g} s: the model or"
                " --clock-error is wrong; see docs/troubles.md"
            )
        return self._filter_misfit

    @property
    def _filter_misfit(self) -> str:
        """The filter's warning, without contradictions by single events: these are smoothed."""
        if (last := self._law.last) is None:
            return ""
        fit = last.fit.uncontradicted
        return last.misfit if fit is last.fit else fit.message(misfit=self._law.misfit)

    @property
    def model_doubt(self) -> str:
        """The filter's doubt of the model, in words; empty without a doubt."""
        last, count = self._law.last, len(self._law.unexplained)
        if count:
            events = "event" if count == 1 else "events"
            return f"at {count} {events} {self._filter_misfit or self._law.misfit}"
        return _DOUBTED if last and last.fit.is_doubted else ""

    @property
    def filtered_parameters(self) -> Parameters:
        """Values from the filter that the smoother has not: noise, and parameters in a misfit."""
        own = {name for name, *_ in self.parameters}
        learned = self._law.last.parameters if self._law.last else ()
        return tuple(each for each in learned if each[0] not in own)
