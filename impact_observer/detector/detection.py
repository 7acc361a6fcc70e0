"""All sensors of a rig together: messages in, numbered events out."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from impact_observer.detector.arrival import ArrivalSensor
from impact_observer.detector.fields import Path, header_stamp, numbers_at
from impact_observer.detector.peak import PeakSensor
from impact_observer.detector.sensors import DetectedInstant, Found, Sample, Sensor
from impact_observer.detector.source import ARRIVAL, PEAK, SWITCH, Source
from impact_observer.detector.switch import SwitchSensor
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.stamps import MAX_STAMP, from_seconds

_SENSORS: dict[str, type[SwitchSensor] | type[PeakSensor] | type[ArrivalSensor]] = {
    SWITCH: SwitchSensor,
    PEAK: PeakSensor,
    ARRIVAL: ArrivalSensor,
}


class Detection(NamedTuple):
    """An event, and when it was known.

    Attributes:
        at: by arrival, ns; never before that of an earlier detection.
        event: what is told.
    """

    at: int
    event: ImpactEvent


@dataclass(slots=True)
class SensorCounts:
    """What became of the messages of one source.

    Attributes:
        messages: that have come.
        hits: that the contact closed.
        lasting: how often it then stayed closed.
        openings: how often it opened after that.
        invalid: messages with a number that is not finite, or a stamp that no event may have.
        disordered: messages with a stamp before that of an earlier one.
        last_event: stamp of the last event, ns; 0 before the first.
        highest: largest signal of a peak source, in the field's own unit.
    """

    messages: int = 0
    hits: int = 0
    lasting: int = 0
    openings: int = 0
    invalid: int = 0
    disordered: int = 0
    last_event: int = 0
    highest: float = 0.0


class Detector:
    """Turns messages into events, in the order of their arrival.

    What it says is a function of the messages and their arrivals alone, however often and whenever
    :meth:`advance` is called in between, as long as each message is heard within ``PATIENCE`` of
    its arrival. Memory is constant.

    Attributes:
        sources: what it listens to.
        tallies: one for each source.
        episode: how often it was restarted.
    """

    def __init__(self, sources: Iterable[Source] = (), *, epoch: int = 0) -> None:
        """Begin with sequence 1.

        Args:
            sources: as for :meth:`add`.
            epoch: stamp of ``t = 0`` of the forcing that every event carries, ns; 0 for unknown.
        """
        self.sources: list[Source] = []
        self.tallies: list[SensorCounts] = []
        self.episode = 0
        self._epoch = epoch
        self._sensors: list[Sensor] = []
        self._paths: list[Path] = []
        self._newest: list[int] = []
        self._sequence = 0
        self._now = 0
        for source in sources:
            self.add(source)

    def add(self, source: Source) -> int:
        """Listen to one more source, a complete one; its number."""
        self.sources.append(source)
        self.tallies.append(SensorCounts())
        self._sensors.append(_SENSORS[source.kind or ""](source))
        self._paths.append(source.path() if source.field else ())
        self._newest.append(0)
        return len(self.sources) - 1

    def restart(self) -> None:
        """Forget what was heard, as when the clock has gone back: a new episode."""
        self.episode += 1
        self._sensors = [_SENSORS[source.kind or ""](source) for source in self.sources]
        self._newest = [0] * len(self.sources)
        self._sequence = 0
        self._now = 0

    def hear(self, index: int, message: object, arrival: int) -> list[Detection]:
        """What a message of source number ``index`` that came at ``arrival`` (ns) tells.

        Raises:
            UsageError: the first message has no such field; or one has no header's stamp though
                that is wanted.
        """
        told = self.advance(arrival)
        tally = self.tallies[index]
        tally.messages += 1
        sample = self._sample(index, message, arrival)
        if not all(map(math.isfinite, sample.values)) or sample.moment.stamp > MAX_STAMP:
            tally.invalid += 1
        elif sample.moment.stamp < self._newest[index]:
            tally.disordered += 1
        else:
            self._newest[index] = sample.moment.stamp
            sensor = self._sensors[index]
            told += self._told((found, index) for found in sensor.feed(sample))
            if isinstance(sensor, PeakSensor):
                tally.highest = max(tally.highest, sensor.highest)
        return told

    def advance(self, now: int) -> list[Detection]:
        """What it tells that nothing else has come until ``now``, ns by arrival."""
        found = [
            (each, index)
            for index, sensor in enumerate(self._sensors)
            if sensor.due is not None
            for each in sensor.silent(now)
        ]
        told = self._told(sorted(found, key=lambda pair: pair[0].at))
        self._now = max(self._now, now)
        return told

    def shortfall(self, index: int) -> str:
        """Why a source has told nothing, or what of it was passed over; empty when all is well."""
        source, tally = self.sources[index], self.tallies[index]
        passed_over = [
            f"{count} {what}"
            for count, what in (
                (tally.invalid, "messages not usable"),
                (tally.disordered, "stamps out of order"),
            )
            if count
        ]
        if not tally.messages:
            passed_over.append(f"no message on {source.topic}")
        elif not tally.hits:
            reason = f"no impact in {tally.messages} messages on {source.topic}"
            if source.kind == PEAK:
                reason += f", at most {tally.highest:.3g} of the threshold {source.threshold:g}"
            passed_over.append(reason)
        return f"{source.contact}: {', '.join(passed_over)}" if passed_over else ""

    def _sample(self, index: int, message: object, arrival: int) -> Sample:
        """What a message says and when."""
        source = self.sources[index]
        stamp = None if source.stamp == "receive" else header_stamp(message)
        if stamp is None and source.stamp == "header":
            problem = f"header found, but a message of {source.topic} has no stamp in one"
            raise source.wrong("stamp", f"{problem}; expected receive")
        try:
            values = numbers_at(message, self._paths[index]) if self._paths[index] else ()
        except ValueError as error:
            if self.tallies[index].messages - 1 <= self.tallies[index].invalid:
                raise source.wrong("field", f"{source.topic}: {error}") from None
            values = (math.nan,)  # an array that is shorter than those before
        return Sample(DetectedInstant(arrival, arrival if stamp is None else stamp), values)

    def _told(self, found: Iterable[tuple[Found, int]]) -> list[Detection]:
        """The events of what sensors have found."""
        told = []
        for (at, measured, kind), index in found:
            source, tally = self.sources[index], self.tallies[index]
            stamp = measured - from_seconds(source.latency)
            if stamp <= 0:
                tally.invalid += 1
                continue
            tally.hits += kind is Kind.IMPACT or (
                kind is Kind.CLOSE and source.min_contact_duration == 0
            )
            tally.lasting += kind is Kind.CLOSE
            tally.openings += kind is Kind.OPEN
            tally.last_event = stamp
            self._sequence += 1
            switches = (Switch(source.contact, kind),)
            event = ImpactEvent(stamp, switches, self._sequence, self.episode, self._epoch)
            self._now = max(self._now, at)
            told.append(Detection(self._now, event))
        return told
