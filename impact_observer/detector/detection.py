# SPDX-License-Identifier: Apache-2.0
"""Detector of all sensors of a rig: messages in, numbered events out."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from impact_observer.detector.peak import PeakSensor
from impact_observer.detector.sensors import (
    ArrivalSensor,
    DetectedSwitch,
    Sample,
    SampleTime,
    Sensor,
    SensorCounts,
    SignalTrace,
)
from impact_observer.detector.source import ARRIVAL, PEAK, SWITCH, Source
from impact_observer.detector.switch import SwitchSensor
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.message_fields import FieldPath, header_stamp, numbers_at
from impact_observer.stamps import MAX_STAMP, from_seconds

_SENSORS: dict[str, type[Sensor]] = {
    SWITCH: SwitchSensor,
    PEAK: PeakSensor,
    ARRIVAL: ArrivalSensor,
}


class Detection(NamedTuple):
    """An event, and when it was certain, ns on the clock of reception; these times ascend."""

    decided: int
    event: ImpactEvent


class Detector:
    """Turns messages into events, in the order in which the messages are received.

    The events are a function of the messages and of the times of reception. Calls of
    :meth:`advance` in between change no event, as long as each message is fed within ``MAX_DELAY``
    of its reception. Memory is constant.

    Attributes:
        sources: the sensors.
        counts: one for each source.
        traces: one for each source, if the signals are kept.
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

        ``traced`` says whether to keep the signals, for a picture.
        """
        self._is_traced = traced
        self.sources: list[Source] = []
        self.counts: list[SensorCounts] = []
        self.traces: list[SignalTrace] = []
        self.episode, self.epoch, self.first_event = 0, epoch, 0
        self._sensors: list[Sensor] = []
        self._paths: list[FieldPath] = []
        self._newest: list[int] = []
        self._sequence, self._now = int(joins_late), 0
        for source in sources:
            self.add_source(source)

    def add_source(self, source: Source) -> int:
        """Take a complete source; returns the index that :meth:`feed` needs."""
        self.sources.append(source)
        self.counts.append(SensorCounts())
        if self._is_traced:
            self.traces.append(SignalTrace())
        self._sensors.append(self._sensor(len(self.counts) - 1))
        self._paths.append(source.path() if source.field else ())
        self._newest.append(0)
        return len(self.sources) - 1

    def change_source(self, index: int, source: Source) -> None:
        """Go on with another complete source of the same contact, such as of another type."""
        if source != self.sources[index]:
            self.sources[index] = source
            self._sensors[index] = self._sensor(index)
            self._paths[index] = source.path() if source.field else ()

    def _sensor(self, index: int) -> Sensor:
        source, trace = self.sources[index], self.traces[index] if self._is_traced else None
        return _SENSORS[source.kind or ""](source, self.counts[index], trace)

    def restart(self) -> None:
        """Begin a new episode, for example after the clock has jumped back."""
        self.episode += 1
        self._sensors = [*map(self._sensor, range(len(self.sources)))]
        self._newest = [0] * len(self.sources)
        self._sequence = self._now = 0

    def feed(self, index: int, message: object, received: int) -> list[Detection]:
        """Returns the events that a message of source ``index`` decides; ``received`` is in ns.

        Raises:
            UsageError: a message has no such field, or has no stamp in a header although the
                source declares ``stamp: header``, and no message before could be used.
        """
        try:
            sample = self._sample(index, message, received)
        except UsageError:
            counts = self.counts[index]
            counts.messages += 1
            counts.invalid += 1
            if counts.invalid >= counts.messages:
                raise
            return self.advance(received)
        return self.take(index, sample)

    def take(self, index: int, sample: Sample) -> list[Detection]:
        """Returns the events that a sample of a source decides."""
        counts, (received, stamp) = self.counts[index], sample.time
        counts.messages += 1
        detections = self.advance(received)
        if not all(map(math.isfinite, sample.values)) or stamp > MAX_STAMP:
            counts.invalid += 1
        elif stamp < self._newest[index]:
            counts.out_of_order += 1
        else:
            self._newest[index] = stamp
            switches = self._sensors[index].feed(sample)
            detections += self._events((switch, index) for switch in switches)
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
