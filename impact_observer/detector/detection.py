# SPDX-License-Identifier: Apache-2.0
"""Detector of all sensors of a rig: messages in, numbered events out."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from impact_observer.detector.peak import PeakSensor
from impact_observer.detector.sensors import (
    ArrivalSensor,
    DeadTimes,
    DetectedSwitch,
    Sample,
    SampleTime,
    Sensor,
    SignalTrace,
)
from impact_observer.detector.source import ARRIVAL, PEAK, SWITCH, Source
from impact_observer.detector.switch import SwitchSensor
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.message_fields import FieldPath, header_stamp, numbers_at
from impact_observer.stamps import MAX_STAMP, from_seconds, seconds_between

_SENSORS: dict[str, type[Sensor]] = {
    SWITCH: SwitchSensor,
    PEAK: PeakSensor,
    ARRIVAL: ArrivalSensor,
}


class Detection(NamedTuple):
    """An event, and the time at which the event was certain.

    Attributes:
        decided: on the clock of reception, ns; detections come in this order.
        event: the event.
    """

    decided: int
    event: ImpactEvent


@dataclass(slots=True)
class SensorCounts:
    """Counts of the messages of one source, and of the events detected in them.

    Attributes:
        messages: received.
        impacts: how often the contact closed.
        closings: how often persistent contact began.
        openings: how often persistent contact ended.
        invalid: messages with a number that is not finite, without the field or the stamp, or
            with a stamp that no event may have.
        out_of_order: messages with a stamp before that of an earlier one.
        last_event: stamp of the last event, ns; 0 before the first.
        largest_signal: of a peak source, in the field's own unit.
    """

    messages: int = 0
    impacts: int = 0
    closings: int = 0
    openings: int = 0
    invalid: int = 0
    out_of_order: int = 0
    last_event: int = 0
    largest_signal: float = 0.0


class Detector:
    """Turns messages into events, in the order in which the messages are received.

    The events are a function of the messages and of the times of reception. Calls of
    :meth:`advance` in between change no event, as long as each message is fed within ``MAX_DELAY``
    of its reception. Memory is constant.

    Attributes:
        sources: the sensors.
        counts: one for each source.
        episode: the number of restarts.
        epoch: stamp of ``t = 0`` of the forcing that every event carries, ns; 0 for unknown.
        first_event: stamp of the first event, ns; 0 before it.
    """

    def __init__(
        self,
        sources: Iterable[Source] = (),
        *,
        epoch: int = 0,
        traced: bool = False,
        joins_late: bool = False,
    ) -> None:
        """The first event has sequence number 1, or 2 where the detector joins late.

        Args:
            sources: as for :meth:`add_source`.
            epoch: stamp of ``t = 0`` of the forcing that every event carries, ns; 0 for unknown.
            traced: whether to keep the signals, for a picture.
            joins_late: whether there may have been impacts before the first message.
        """
        self._is_traced = traced
        self.sources: list[Source] = []
        self.counts: list[SensorCounts] = []
        self.episode = 0
        self.epoch = epoch
        self.first_event = 0
        self._sensors: list[Sensor] = []
        self._paths: list[FieldPath] = []
        self._newest: list[int] = []
        self._sequence = int(joins_late)
        self._now = 0
        for source in sources:
            self.add_source(source)

    def add_source(self, source: Source) -> int:
        """Take a complete source; returns the index that :meth:`feed` needs."""
        self.sources.append(source)
        self.counts.append(SensorCounts())
        self._sensors.append(self._sensor(source))
        self._paths.append(source.path() if source.field else ())
        self._newest.append(0)
        return len(self.sources) - 1

    def change_source(self, index: int, source: Source) -> None:
        """Go on with another complete source of the same contact, such as of another type."""
        if source != self.sources[index]:
            self.sources[index], self._sensors[index] = source, self._sensor(source)
            self._paths[index] = source.path() if source.field else ()

    def _sensor(self, source: Source) -> Sensor:
        sensor = _SENSORS[source.kind or ""](source)
        sensor.trace = SignalTrace() if self._is_traced else None
        return sensor

    def restart(self) -> None:
        """Begin a new episode, for example after the clock has jumped back."""
        self.episode += 1
        before = self._sensors
        self._sensors = [self._sensor(source) for source in self.sources]
        for old, new in zip(before, self._sensors, strict=True):
            new.dead_times, new.trace = old.dead_times, old.trace
        self._newest = [0] * len(self.sources)
        self._sequence = 0
        self._now = 0

    def feed(self, index: int, message: object, received: int) -> list[Detection]:
        """Returns the events that a message of source ``index`` decides; ``received`` is in ns.

        Raises:
            UsageError: a message has no such field, or has no stamp in a header although the
                source declares ``stamp: header``, and no message before could be used.
        """
        counts = self.counts[index]
        counts.messages += 1
        try:
            sample = self._sample(index, message, received)
        except UsageError:
            counts.invalid += 1
            if counts.invalid >= counts.messages:
                raise
            return self.advance(received)
        detections = self.advance(received)
        if not all(map(math.isfinite, sample.values)) or sample.time.stamp > MAX_STAMP:
            counts.invalid += 1
        elif sample.time.stamp < self._newest[index]:
            counts.out_of_order += 1
        else:
            self._newest[index] = sample.time.stamp
            sensor = self._sensors[index]
            detections += self._events((switch, index) for switch in sensor.feed(sample))
            counts.largest_signal = max(counts.largest_signal, sensor.largest_signal)
        return detections

    def advance(self, now: int) -> list[Detection]:
        """Returns the events that are decided if no message is received until ``now``, ns."""
        switches = [
            (switch, index)
            for index, sensor in enumerate(self._sensors)
            for switch in sensor.advance(now)
        ]
        detections = self._events(sorted(switches, key=lambda pair: pair[0].decided))
        self._now = max(self._now, now)
        return detections

    @property
    def traces(self) -> list[SignalTrace]:
        """The signals of the sources, if they are kept."""
        return [sensor.trace for sensor in self._sensors if sensor.trace is not None]

    @property
    def dead_times(self) -> list[DeadTimes]:
        """What lay in the dead times of each source."""
        return [sensor.dead_times for sensor in self._sensors]

    def rise(self, index: int) -> float:
        """The mean time from where peaks of a source reached the threshold to their stamps, s."""
        rises = self._sensors[index].dead_times.rises
        return seconds_between(0, rises) / max(self.counts[index].impacts, 1)

    def left_out(self, index: int) -> list[str]:
        """How many messages of a source were left out, of how many, and why, a line each."""
        source, counts = self.sources[index], self.counts[index]
        unusable = "a number that is not finite, no such field or stamp, or one no event may have"
        reasons = (
            (counts.out_of_order, "stamped before an earlier one, as by a clock that steps back"),
            (counts.invalid, f"with {unusable}"),
        )
        return [
            f"{source.contact}: {count} of {counts.messages} messages on {source.topic} left out"
            f" ({100 * count / counts.messages:.2g} %): {why}"
            for count, why in reasons
            if count
        ]

    def problem(self, index: int) -> str:
        """Returns why a source has no events or left out messages; empty if nothing is wrong."""
        source, counts = self.sources[index], self.counts[index]
        problems = [
            f"{count} {what}"
            for count, what in (
                (counts.invalid, "messages not usable"),
                (counts.out_of_order, "stamps out of order"),
            )
            if count
        ]
        problems += [why] if (why := self.no_impact(index)) else []
        return f"{source.contact}: {', '.join(problems)}" if problems else ""

    def no_impact(self, index: int) -> str:
        """Returns why a source has no impacts; empty if it has some."""
        source, counts = self.sources[index], self.counts[index]
        if not counts.messages:
            return f"no message on {source.topic}"
        if counts.impacts:
            return ""
        reason = f"no impact in {counts.messages} messages on {source.topic}"
        if source.threshold is not None:
            most = f"{counts.largest_signal:.3g}"
            reason += f", at most {most} of the threshold {source.threshold:g}"
            if source.kind == PEAK and counts.largest_signal >= source.threshold:
                reason += "; it stays above: declare a baseline, or a higher threshold"
        return reason

    def _sample(self, index: int, message: object, received: int) -> Sample:
        """Returns the time and the values of a message."""
        source = self.sources[index]
        stamp = None if source.stamp == "receive" else header_stamp(message)
        if stamp is None and source.stamp == "header":
            problem = f"header found, but a message of {source.topic} has no stamp in one"
            raise source.wrong("stamp", f"{problem}; expected receive")
        try:
            path = self._paths[index]
            values = numbers_at(message, path) if path else ()
        except ValueError as error:
            raise source.wrong("field", f"{source.topic}: {error}") from None
        if source.is_scalar:
            source.scalar(values)
        return Sample(SampleTime(received, received if stamp is None else stamp), values)

    def _events(self, switches: Iterable[tuple[DetectedSwitch, int]]) -> list[Detection]:
        """Returns the events of detected switches; each switch has the index of its source."""
        detections = []
        for (decided, measured, kind), index in switches:
            source, counts = self.sources[index], self.counts[index]
            stamp = measured - from_seconds(source.latency)
            if stamp <= 0:
                counts.invalid += 1
                continue
            counts.impacts += kind is Kind.IMPACT or (
                kind is Kind.CLOSE and source.min_contact_duration == 0
            )
            counts.closings += kind is Kind.CLOSE
            counts.openings += kind is Kind.OPEN
            counts.last_event = stamp
            self.first_event = self.first_event or stamp
            self._sequence += 1
            switched = (Switch(source.contact, kind),)
            event = ImpactEvent(stamp, switched, self._sequence, self.episode, self.epoch)
            self._now = max(self._now, decided)
            detections.append(Detection(self._now, event))
        return detections
