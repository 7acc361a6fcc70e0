# SPDX-License-Identifier: Apache-2.0
"""Samples of sensors and of live forces, on their way from the topics to an observer."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain, groupby

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.events import Verdict
from impact_observer.io.interfaces import FORCING, Interface, Quality
from impact_observer.io.live_inputs import efforts_on
from impact_observer.io.measured_samples import SENSOR_STATUS, SILENT_RATE, SensorReader
from impact_observer.io.messages import AnyMessage, LiveSample, MessageError, read_efforts
from impact_observer.model.live_signals import LiveSignals
from impact_observer.observer import Observer
from impact_observer.observer.samples import MOST_KEPT, SensorSample
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.intake import Receiver
from impact_observer.stamps import MAX_STAMP, NS_PER_S

_QUALITY = Quality(reliable=False, depth=2000)
"""Of a sensor's topic: the samples of 2 s at 1 kHz may wait."""
_LONGEST = 0.25
"""Time that the samples of one call may take, s; of more samples some are shed."""
_SHARE = 1 / 3
"""The same over the time since the call before: so that a backlog becomes shorter, though
estimates take as long again.
"""
_FEW = 20
"""Instants of a call whose samples are used without a look at their cost."""
_COUNTED = 20
"""Samples from which on the rate of a sensor is known."""


def ages(live: LiveSignals | None, now: int) -> dict[str, float]:
    """Age of the newest sample of each live force at ``now`` (ns), s; infinite without any."""
    newest = {} if live is None else dict(zip(live.inputs, live.newest, strict=True))
    return {name: (now - at) / NS_PER_S if at else math.inf for name, at in newest.items()}


def silence(live: LiveSignals | None, now: int, timeout: float) -> str:
    """The live forces without a sample for longer than ``timeout`` (s), in words; else empty."""
    return ", ".join(
        f"no sample of {name} for {age:.3g} s" if age < math.inf else f"none of {name} yet"
        for name, age in ages(live, now).items()
        if age > timeout
    )


class SampleIntake:
    """Gives the samples of sensors and live forces that a node receives to its observer.

    Messages are polled, as thousands may come in a second. Where those of sensors come faster than
    they can be used, some are shed evenly, so that the newest are used in time.

    Attributes:
        topics: absolute names of the topics.
        counts: ``samples``: samples of forces; ``invalid samples``: those that cannot be used.
        problems: the last problem of each sensor; empty for none.
    """

    def __init__(
        self,
        node: BaseNode,
        observer: Observer,
        on_samples: Callable[[int, Sequence[Verdict]], object],
    ) -> None:
        """Receive the samples of the sensors and live forces of ``observer``.

        Args:
            node: owner of the subscriptions.
            observer: takes the samples.
            on_samples: called after new samples with the least of their stamps, ns, and with the
                verdicts on events that have changed.
        """
        self._node, self._observer, self._on_samples = node, observer, on_samples
        self._past = node.values["history"]
        self._sensors = observer.samples.sensors
        self.counts = Counter[str]()
        self.problems = [""] * len(self._sensors)
        self._readers: dict[str, list[SensorReader]] = {}
        self._first: dict[int, tuple[int, int]] = {}
        self._told = [Counter[str]() for _ in self._sensors]
        self._ended = time.monotonic()
        self._topics = [node.resolve_topic_name(e.measurement.topic) for e in self._sensors]
        self._receivers = {each: self._receiver(each) for each in dict.fromkeys(self._topics)}
        self._forces: Receiver[LiveSample] | None = None
        if observer.live is not None and observer.live.inputs:
            declared = None if observer.robot is None else observer.robot.description.forces
            self._others_count = declared is None  # of a robot other joints may share the topic
            self._forces = Receiver(
                node,
                efforts_on(declared[0]) if declared else FORCING,
                self._use_forces,
                read=self._read_forces,
                stamp=lambda sample: sample.stamp,
                is_polled=True,
            )
        own = [self._forces.topic] if self._forces is not None else []
        self.topics = tuple(dict.fromkeys([*self._receivers, *own]))

    def _receiver(self, topic: str) -> Receiver[SensorSample]:
        """The receiver of a topic of any type that a sensor can read."""
        return Receiver(
            self._node,
            Interface(topic, "", _QUALITY),
            self._use,
            read=lambda message, _: self._read(topic, message),
            stamp=lambda sample: sample.stamp,
            on_ahead=lambda sample, why: self._report(sample.sensor, why),
            choose=partial(self._choose, topic),
            is_polled=True,
        )

    def _choose(self, topic: str, type_name: str, _: Quality) -> Quality:
        """The quality to ask for, if a sensor can read messages of a type.

        Raises:
            UsageError: none can.
        """
        readers, why = list[SensorReader](), ""
        for sensor, own in zip(self._sensors, self._topics, strict=True):
            if own == topic:
                try:
                    readers.append(SensorReader(sensor.measurement, sensor.index, type_name))
                except UsageError as error:
                    why = str(error)
                    self._refuse(sensor.index, why)
        if not readers:
            raise UsageError(why)
        self._readers[topic] = readers
        return _QUALITY

    def take_arrived(self) -> None:
        """Use the samples that have arrived, and those to which the clock has come near."""
        if self._forces is not None:
            self._forces.take_arrived()
        for each in self._receivers.values():
            each.take_arrived()

    def use_waiting(self) -> None:
        """Use the samples that came while the observer inserted events."""
        since = min((s.stamp for s in self._observer.samples.waiting), default=MAX_STAMP)
        self._on_samples(since, self._measured(()))

    def _read_forces(self, message: AnyMessage, _: object) -> list[LiveSample]:
        """The samples of forces in a message, of a robot those of its joints."""
        assert self._observer.live is not None, "only then forces are received"
        try:
            samples = read_efforts(message)
        except MessageError as error:
            self._refuse_force(str(error))
            return []
        known = self._observer.live.inputs
        return [each for each in samples if self._others_count or each.name in known]

    def _use_forces(self, samples: Sequence[LiveSample]) -> None:
        """Give samples of forces to the observer."""
        assert self._observer.live is not None, "only then forces are received"
        for each in samples:
            self.counts["samples"] += 1
            if problem := self._observer.live.add_force(*each):
                self._refuse_force(problem)
        self._on_samples(min(each.stamp for each in samples), ())

    def _refuse_force(self, problem: str) -> None:
        self.counts["invalid samples"] += 1
        assert self._forces is not None
        self._node.lines.error(f"{self._forces.topic}: {problem}")

    def _read(self, topic: str, message: AnyMessage) -> list[SensorSample]:
        """The samples of sensors in a message."""
        now, samples = self._node.stamp_now(), list[SensorSample]()
        for reader in self._readers[topic]:
            try:
                sample = reader.sample(message, now)
            except UsageError as error:
                self._refuse(reader.index, str(error))
                continue
            if sample is None:
                declared = reader.measurement
                missing = f"no {declared.quantity} of {declared.joint!r} on {topic}"
                self.problems[reader.index] = missing
            elif (behind := (now - sample.stamp) / NS_PER_S) > self._past:
                what = f"stamped {behind:.3f} s before the clock"
                self._refuse(reader.index, f"{what}; history allows {self._past:g} s")
            else:
                samples.append(sample)
        return samples

    def _use(self, samples: Sequence[SensorSample]) -> None:
        """Give samples of sensors to the observer; of too many, some."""
        revised = list[Verdict]()
        for some in self._in_time(samples):
            for each in some:
                self.problems[each.sensor] = ""
                self._first.setdefault(each.sensor, (each.stamp, self._count(each.sensor)))
            revised += self._measured(some)
        self._on_samples(min(each.stamp for each in samples), revised)

    def _in_time(self, samples: Sequence[SensorSample]) -> Iterator[Sequence[SensorSample]]:
        """Yields late ``samples``, those of the first new instants, and of others as time allows.

        What counts is the time that passes, as others may use the processor, too.
        """
        newest, ordered = self._observer.newest, sorted(samples, key=lambda each: each.stamp)
        late = [each for each in ordered if each.stamp <= newest]
        if late:
            yield late
        new = groupby(ordered[len(late) :], lambda each: each.stamp)
        instants = [[*some] for _, some in new]
        begin, first, others = time.monotonic(), instants[:_FEW], instants[_FEW:]
        left = max(_SHARE * (begin - self._ended), _LONGEST)
        if first:
            yield [*chain.from_iterable(first)]
        if others:
            spent = max(time.monotonic() - begin, 1e-9)
            most = max(int((left - spent) / spent * len(first)), 1)
            count = min(most, len(others))
            kept = {*np.linspace(len(others) - 1, 0, count).round().astype(int).tolist()}
            for k in {*range(len(others))} - kept:
                for each in others[k]:
                    self._observer.samples.counts[each.sensor]["shed"] += 1
            yield [*chain.from_iterable(others[k] for k in sorted(kept))]
        self._ended = time.monotonic()

    def _measured(self, samples: Sequence[SensorSample]) -> Sequence[Verdict]:
        """Give samples to the observer; verdicts on events that have changed."""
        try:
            return self._observer.measure(samples)
        except ImpactObserverError as error:
            self._node.lines.error(f"samples of sensors: {error}")
            return ()

    def _refuse(self, index: int, problem: str) -> None:
        """Count and report a sample of a sensor that cannot be used."""
        self._observer.samples.counts[index]["invalid"] += 1
        self._report(index, problem)

    def _report(self, index: int, problem: str) -> None:
        self.problems[index] = problem
        self._node.lines.error(f"{self._sensors[index].name}: {problem}")

    def _count(self, index: int) -> int:
        """The samples of a sensor so far."""
        return self._observer.samples.counts[index]["samples"]

    def rate(self, index: int) -> float:
        """The mean rate of a sensor so far, Hz; 0 while the rate is not known."""
        if index not in self._first:
            return 0.0
        stamp, before = self._first[index]
        count, span = self._count(index) - before - 1, self._observer.samples.newest[index] - stamp
        return count * NS_PER_S / span if count >= _COUNTED and span > 0 else 0.0

    def published(self) -> set[str]:
        """Names of the sensors whose verdicts are to be published: slow ones of known rate."""
        return {each.name for each in self._sensors if 0 < self.rate(each.index) <= SILENT_RATE}

    def without_sample(self) -> tuple[str, ...]:
        """Names of the sensors without a sample that could be used."""
        return tuple(each.name for each in self._sensors if each.index not in self._first)

    def values(self, now: int) -> dict[str, object]:
        """Ages of the live forces at ``now`` (ns), and counts of their samples."""
        live = self._observer.live
        if live is None:
            return {}
        return {
            **{f"age of {name} [s]": f"{age:.3f}" for name, age in ages(live, now).items()},
            **{key: self.counts[key] for key in ("samples", "invalid samples")},
            "samples too late": live.late,
        }

    def statuses(self, now: int) -> list[DiagnosticStatus]:
        """The state of each sensor at ``now`` (ns): its values, and the worst of its faults."""
        return [self._status(index, now) for index in range(len(self._sensors))]

    def _status(self, index: int, now: int) -> DiagnosticStatus:
        sensor, samples = self._sensors[index], self._observer.samples
        counts, newest = samples.counts[index], samples.newest[index]
        age = (now - newest) / NS_PER_S if newest else math.inf
        fault = self._fault(index, age)
        kinds = ("samples", "accepted", "rejected", "unused", "invalid", "dropped", "shed")
        values = {
            "topic": self._topics[index],
            **{kind: counts[kind] for kind in kinds},
            "rate [Hz]": f"{self.rate(index):.4g}",
            "age [s]": f"{age:.3f}",
        }
        return self._node.status(
            f"{SENSOR_STATUS}{sensor.name}",
            DiagnosticStatus.WARN if fault else DiagnosticStatus.OK,
            fault or f"{counts['accepted']} samples accepted",
            values,
            hardware=sensor.name,
        )

    def _fault(self, index: int, age: float) -> str:
        """The fault of a sensor since its last status; ``age`` (s) is of its newest sample."""
        counts = self._observer.samples.counts[index]
        timeout = self._sensors[index].measurement.timeout
        new, self._told[index] = counts - self._told[index], Counter(counts)
        if fault := self.problems[index] or self._receivers[self._topics[index]].fault:
            return fault
        if age > timeout:
            silent = f"no sample for {age:.3g} s" if age < math.inf else "no sample yet"
            return f"{silent}; timeout is {timeout:g} s"
        if new["dropped"]:
            most = f"more than {MOST_KEPT} waited to be used"
            return f"{new['dropped']} samples were dropped: {most}"
        if new["shed"]:
            return f"{new['shed']} samples were shed: the observer cannot keep up"
        refused = new["rejected"] + new["invalid"]
        return f"{refused} samples were rejected" if refused else ""
