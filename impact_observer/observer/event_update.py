# SPDX-License-Identifier: Apache-2.0
"""Applies one event: interpret, predict the belief to the stamp, correct the belief by the law."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite

from impact_observer.errors import DynamicsError, ImpactLawError
from impact_observer.filter.clock_steps import SensorClock
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.readings import (
    DeclaredSensor,
    Reading,
    SampleOutcome,
)
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.event_order import EventKey, Superseding, disorder, interpret
from impact_observer.observer.laws.law import Law
from impact_observer.observer.synchronization import SynchronizationTest
from impact_observer.observer.timeline import Entry
from impact_observer.stamps import Elapsed, seconds_between, text
from impact_observer.states import Vector
from impact_observer.turns import give_turn


class EventUpdate:
    """Makes the entries of a timeline, each from the entry before.

    Attributes:
        law: the law that corrects and predicts the belief.
        test: the test of the replicas' synchronization.
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
        sensors: the sensors beside the impacts.
    """

    def __init__(
        self,
        law: Law,
        test: SynchronizationTest,
        epoch: int,
        sensors: Sequence[DeclaredSensor] = (),
    ) -> None:
        """Use ``law`` and ``test``."""
        self.law = law
        self.test = test
        self.epoch = epoch
        self.sensors = sensors

    def apply(self, previous: Entry, event: EventKey, superseding: Superseding) -> Entry:
        """The entry of ``event``, from the ``previous`` entry.

        Raises:
            ImpactLawError: the impact law has no solution.
            DynamicsError: the loads of closed contacts cannot be found, or the estimate is not
                finite.
        """
        give_turn()
        last = event.stamp, event.sequence
        meaning = interpret(event, previous.closed, previous.latest, superseding)
        if not meaning.switches:
            latest, overruled = meaning.latest, meaning.overruled
            return replace(
                previous, key=event, latest=latest, overruled=overruled, last=last, outcome=None
            )
        stamp = event.stamp - previous.belief.clock.late
        s = max(seconds_between(previous.since, stamp), 0.0)
        change = ContactChange.of(
            Elapsed(stamp - (self.epoch or stamp)),
            previous.closed,
            meaning.switches,
            stamp=event.stamp,
            sequence=event.sequence,
            flown=s,
            flight=seconds_between(previous.last[0], event.stamp) if previous.last[0] else s,
            disorder=disorder(event, meaning, previous.latest),
        )
        try:
            posterior, x = self._corrected(previous, change)
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(stamp)} s: {error}") from None
        stamp = event.stamp - posterior.clock.late
        result = self.test.after_event(previous.synchronization, change, x, posterior)
        if not isfinite(result.energy):
            raise DynamicsError(f"at {text(stamp)} s: the estimate is not finite any more")
        return Entry(
            event,
            stamp,
            posterior,
            result,
            change.closed,
            meaning.latest,
            meaning.overruled,
            last,
            stamp if change.hit else previous.impact,
            rejected=previous.rejected,
        )

    def _corrected(self, previous: Entry, change: ContactChange) -> tuple[Belief, Vector]:
        """The belief after a change of contacts, and the estimate just before it, shape (2n,)."""
        s, belief = change.flown, previous.belief
        if s > 0:
            belief = self.prediction(previous).belief(s)
        if self.sensors:  # their samples are stamped by a clock that has not stepped
            belief = belief._replace(clock=SensorClock())
        return self.law.correct(change, belief), belief.x

    def measured(self, previous: Entry, samples: Sequence[EventKey]) -> list[Entry]:
        """The entries of ``samples`` of one stamp, from the ``previous`` entry.

        Raises:
            DynamicsError: the estimate is not finite.
        """
        give_turn()
        stamp = samples[0].stamp
        since, s = self._since(previous, stamp), seconds_between(previous.since, stamp)
        readings = [self._reading(previous, each) for each in samples]
        if not any(each.is_blanked for each in readings):
            made = self.law.followed(readings, previous.belief, since, s)
            if made is not None:
                return _entries(previous, samples, *made)
        if len(samples) == 1:
            return [self._measured_alone(previous, samples[0], readings[0])]
        entries = list[Entry]()
        for each in samples:
            entries += self.measured(entries[-1] if entries else previous, [each])
        return entries

    def _measured_alone(self, previous: Entry, event: EventKey, reading: Reading) -> Entry:
        """The entry of a sample; a sample that is not used leaves the motion unchanged."""
        if reading.is_blanked:
            ago, blanking = reading.since_impact, reading.sensor.measurement.blanking
            reason = f"blanking: an impact was {ago:.3g} s ago; {blanking:g} s are left out"
            outcome = SampleOutcome(0.0, -1.0, False, reason)
            return replace(previous, key=event, overruled=(), outcome=outcome)
        s = seconds_between(previous.since, event.stamp)
        prior = self.prediction(previous).belief(s) if s > 0 else previous.belief
        posterior, outcome = self.law.measure(reading, prior)
        if posterior is prior:
            now = _rejected_after(previous, [event], [outcome])
            return replace(previous, key=event, overruled=(), outcome=outcome, rejected=now)
        return _entries(previous, [event], posterior, [outcome])[0]

    def _since(self, entry: Entry, stamp: int) -> float:
        """When the belief of ``entry`` holds, s since the epoch; by default ``stamp`` (ns)."""
        return seconds_between(self.epoch or stamp, entry.since)

    def _reading(self, previous: Entry, event: EventKey) -> Reading:
        """A sample, after the ``previous`` entry."""
        (value,), stamp, index, impact = event.sample, event.stamp, event.sensor, previous.impact
        ns = stamp - (self.epoch or stamp)
        return Reading(
            self.sensors[index],
            value,
            Elapsed(ns),
            ns,
            seconds_between(impact, stamp) if impact else math.inf,
            previous.closed,
            previous.rejected.get(index, 0),
        )

    def prediction(self, entry: Entry) -> Prediction:
        """The prediction from the belief of ``entry``, made at the first call."""
        if entry.prediction is None:
            t = Elapsed(entry.since - (self.epoch or entry.since))
            entry.prediction = self.law.predict(t, entry.belief, entry.closed)
        return entry.prediction


def _entries(
    previous: Entry,
    samples: Sequence[EventKey],
    posterior: Belief,
    outcomes: Sequence[SampleOutcome],
) -> list[Entry]:
    """The entries of ``samples`` of one stamp; all have the ``posterior`` after the last one.

    Raises:
        DynamicsError: it is not finite.
    """
    stamp = samples[0].stamp
    if not isfinite(posterior.x.dot(posterior.x)):
        raise DynamicsError(f"at {text(stamp)} s: the estimate is not finite any more")
    rejected = _rejected_after(previous, samples, outcomes)
    return [
        Entry(
            event,
            stamp,
            posterior,
            previous.synchronization,
            previous.closed,
            previous.latest,
            (),
            previous.last,
            previous.impact,
            outcome,
            rejected,
        )
        for event, outcome in zip(samples, outcomes, strict=True)
    ]


def _rejected_after(
    previous: Entry, samples: Sequence[EventKey], outcomes: Sequence[SampleOutcome]
) -> Mapping[int, int]:
    """How many samples in a row of each sensor were rejected, after ``samples``.

    A sample without an innovation in deviations says nothing.
    """
    rejected = dict(previous.rejected)
    for event, outcome in zip(samples, outcomes, strict=True):
        if outcome.accepted:
            rejected.pop(event.sensor, None)
        elif outcome.normalized >= 0:
            rejected[event.sensor] = rejected.get(event.sensor, 0) + 1
    return rejected
