# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of an observer node to the sensors beside the impacts."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType

from diagnostic_msgs.msg import DiagnosticStatus

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.events import Verdict
from impact_observer.io.interfaces import JOINT_STATE, Quality
from impact_observer.io.measured_samples import SENSOR_STATUS, SILENT_RATE, SensorReader
from impact_observer.io.messages import AnyMessage
from impact_observer.observer import Observer
from impact_observer.observer.samples import MOST_KEPT, SensorSample
from impact_observer.ros.base_node import (
    MOST_TOGETHER,
    BaseNode,
    ClockGate,
    PolledGroup,
    Receiver,
)
from impact_observer.ros.topics import message_class
from impact_observer.stamps import MAX_STAMP, NS_PER_S

_DEPTH = 2000
"""Samples of a topic that may wait: the samples of 2 s at 1 kHz."""
_QUALITY = Quality(reliable=False, depth=_DEPTH)
_LONGEST = 0.05
"""Time that the messages of one call may take, s; of more messages some are shed."""
_SHARE = 1 / 3
"""The same over the time since the call before: so that a backlog becomes shorter, though
estimates take as long again.
"""
_FEW = 20
"""Messages of a call that are used without a look at their cost."""
_COUNTED = 20
"""Samples from which on the rate of a sensor is known."""


class SensorIntake:
    """Gives the samples that a node receives to its observer.

    A topic is subscribed to with the type that its publishers have, whenever the type changes. A
    sample that is too far ahead of the clock is used once the clock is near: perhaps the clock is
    late. Messages of a robot are polled, as thousands come in a second. Where they come faster
    than they can be used, some are shed, so that the newest are used in time.

    Attributes:
        topics: absolute names of the topics.
        problems: the last problem of each sensor; empty for none.
    """

    def __init__(
        self,
        node: BaseNode,
        observer: Observer,
        *,
        now: Callable[[], int],
        past: float,
        future: float,
        on_samples: Callable[[int, Sequence[Verdict]], None],
        on_problem: Callable[[str], None],
        before: Mapping[str, Callable[[Sequence[AnyMessage]], None]] = MappingProxyType({}),
    ) -> None:
        """Prepare to receive the samples of the sensors of ``observer``.

        Args:
            node: owner of the subscriptions.
            observer: takes the samples.
            now: time of the node's clock, ns; 0 while there is none.
            past: how far before the clock a stamp may be, s.
            future: how far ahead of the clock a stamp may be, s.
            on_samples: called after new samples with the least of their stamps, ns, and with the
                verdicts on events that have changed.
            on_problem: called with a line on samples that cannot be used.
            before: called with messages of joint states on a topic, before their samples are used.
        """
        self._before = before
        self._node, self._observer = node, observer
        self._now, self._past = now, past
        self._on_samples, self._on_problem = on_samples, on_problem
        self._sensors = observer.samples.sensors
        self.problems = [""] * len(self._sensors)
        names = [node.resolve_topic_name(each.measurement.topic) for each in self._sensors]
        self.topics = tuple(dict.fromkeys(names))
        self._is_polled = observer.robot is not None
        self._groups = {each: PolledGroup() for each in self.topics if self._is_polled}
        self._receivers = {
            each: Receiver(
                node, each, partial(self.take_messages, each), group=self._groups.get(each)
            )
            for each in self.topics
        }
        self._readers: dict[str, list[SensorReader]] = {}
        self._first: dict[int, tuple[int, int]] = {}
        self._reported = [0] * len(self._sensors)
        self._dropped = [0] * len(self._sensors)
        self._shed = [0] * len(self._sensors)
        self._ahead = ClockGate[SensorSample](now, future, _DEPTH)
        self._ended = time.monotonic()

    def discover(self) -> None:
        """Look at the publishers of all topics, and subscribe to a type that can be read."""
        for topic, receiver in self._receivers.items():
            if receiver.look() and receiver.type_name not in receiver.offers:
                self._connect(topic, receiver)

    def take_messages(self, topic: str, messages: Sequence[AnyMessage]) -> None:
        """Give the samples in ``messages`` of a topic to the observer; of too many, of some."""
        is_of_joints = self._receivers[topic].type_name == JOINT_STATE
        if is_of_joints and (before := self._before.get(topic)) is not None:
            before(messages)
        since, revised = MAX_STAMP, list[Verdict]()
        for some in self._in_time(topic, messages):
            samples = [*self._no_longer_ahead()]
            for message in some:
                samples += self._read(topic, message)
            since = min((since, *(each.stamp for each in samples)))
            revised += self._measured(samples)
        if since < MAX_STAMP:
            self._on_samples(since, revised)

    def _in_time(
        self, topic: str, messages: Sequence[AnyMessage]
    ) -> Iterator[Sequence[AnyMessage]]:
        """Yields ``messages``; of a robot one by one, and of many those there is time for.

        What counts is the time that passes, as others may use the processor, too.
        """
        if not self._is_polled:
            yield messages
            return
        begin, used, i, last = time.monotonic(), 0, 0, len(messages) - 1
        allowed = max(_SHARE * (begin - self._ended), _LONGEST)
        while True:
            yield [messages[i]]
            used += 1
            self._ended = time.monotonic()
            if i == last:
                break
            spent = max(self._ended - begin, 1e-9)
            most = max((allowed - spent) * used / spent, 1.0) if last >= _FEW else math.inf
            i += math.ceil((last - i) / most) or 1
        for reader in self._readers[topic]:
            self._observer.samples.counts[reader.index]["shed"] += len(messages) - used

    def take_what_was_ahead(self) -> None:
        """Give the samples to the observer to which the clock has come near."""
        if samples := [*self._no_longer_ahead()]:
            self._on_samples(min(each.stamp for each in samples), self._measured(samples))

    def take_arrived(self) -> None:
        """Use the messages of a robot that have arrived."""
        for topic, group in self._groups.items():
            if messages := self._receivers[topic].waiting(MOST_TOGETHER):
                group.has_messages = True
                self.take_messages(topic, messages)

    def use_waiting(self) -> None:
        """Use the samples that came while the observer inserted events."""
        since = min((s.stamp for s in self._observer.samples.waiting), default=MAX_STAMP)
        self._on_samples(since, self._measured(()))

    def clear(self) -> None:
        """Forget the samples that wait for the clock, as after a jump of the clock."""
        self._ahead.clear()

    def rate(self, index: int) -> float:
        """The mean rate of a sensor so far, Hz; 0 while the rate is not known."""
        samples = self._observer.samples
        if index not in self._first:
            return 0.0
        stamp, before = self._first[index]
        count, span = self._count(index) - before - 1, samples.newest[index] - stamp
        return count * NS_PER_S / span if count >= _COUNTED and span > 0 else 0.0

    def is_published(self, index: int) -> bool:
        """Whether the verdicts on the samples of a sensor are to be published."""
        return 0 < self.rate(index) <= SILENT_RATE

    def without_sample(self) -> tuple[str, ...]:
        """Names of the sensors without a sample that could be used."""
        return tuple(each.name for each in self._sensors if each.index not in self._first)

    def statuses(self, now: int) -> list[DiagnosticStatus]:
        """The state of each sensor at ``now`` (ns)."""
        return [self._status(index, now) for index in range(len(self._sensors))]

    def _connect(self, topic: str, receiver: Receiver) -> None:
        """Subscribe to the first type of a topic that a sensor can read."""
        for type_name in receiver.offers:
            if readers := [*self._readers_of(topic, type_name)]:
                self._readers[topic] = readers
                receiver.connect(type_name, _QUALITY)
                return

    def _readers_of(self, topic: str, type_name: str) -> Iterator[SensorReader]:
        """The readers of the sensors on a topic that can read messages of a type."""
        for sensor in self._sensors:
            if self._node.resolve_topic_name(sensor.measurement.topic) == topic:
                try:
                    message_class(type_name)
                    yield SensorReader(sensor.measurement, sensor.index, type_name)
                except UsageError as error:
                    self._refuse(sensor.index, str(error))

    def _measured(self, samples: Sequence[SensorSample]) -> Sequence[Verdict]:
        """Give samples to the observer; verdicts on events that have changed."""
        try:
            return self._observer.measure(samples)
        except ImpactObserverError as error:
            self._on_problem(f"samples of sensors: {error}")
            return ()

    def _read(self, topic: str, message: AnyMessage) -> list[SensorSample]:
        """The samples in a message that can be used now."""
        now, samples = self._now(), list[SensorSample]()
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
            elif reason := self._ahead.reason(sample.stamp):
                self._report(sample.sensor, reason)
                if (last := self._ahead.keep(sample.stamp, sample)) is not None:
                    self._refuse(last.sensor, f"more than {_DEPTH} samples are ahead of the clock")
            elif (behind := (now - sample.stamp) / NS_PER_S) > self._past:
                what = f"stamped {behind:.3f} s before the clock"
                self._refuse(reader.index, f"{what}; history allows {self._past:g} s")
            else:
                self._note_used(sample)
                samples.append(sample)
        return samples

    def _note_used(self, sample: SensorSample) -> None:
        self.problems[sample.sensor] = ""
        self._first.setdefault(sample.sensor, (sample.stamp, self._count(sample.sensor)))

    def _no_longer_ahead(self) -> Iterator[SensorSample]:
        """The samples to which the clock has come near."""
        for sample in self._ahead.near():
            self._note_used(sample)
            yield sample

    def _refuse(self, index: int, problem: str) -> None:
        """Count and report a sample that cannot be used."""
        self._observer.samples.counts[index]["invalid"] += 1
        self._report(index, problem)

    def _report(self, index: int, problem: str) -> None:
        self.problems[index] = problem
        self._on_problem(f"{self._sensors[index].name}: {problem}")

    def _count(self, index: int) -> int:
        """The samples of a sensor so far."""
        return self._observer.samples.counts[index]["samples"]

    def _status(self, index: int, now: int) -> DiagnosticStatus:
        """The status of a sensor: its values, and the worst of its faults."""
        sensor, samples = self._sensors[index], self._observer.samples
        declared, counts, newest = sensor.measurement, samples.counts[index], samples.newest[index]
        topic = self._node.resolve_topic_name(declared.topic)
        age = (now - newest) / NS_PER_S if newest else float("inf")
        fault = self._fault(index, topic, age)
        values = {
            "topic": topic,
            **{kind: counts[kind] for kind in ("samples", "accepted", "rejected", "unused")},
            **{kind: counts[kind] for kind in ("invalid", "dropped", "shed")},
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

    def _fault(self, index: int, topic: str, age: float) -> str:
        """The fault of a sensor; empty without a fault.

        Args:
            index: of the sensor.
            topic: absolute name of its topic.
            age: of its newest sample, s; infinite without any.
        """
        declared, counts = self._sensors[index].measurement, self._observer.samples.counts[index]
        refused = counts["rejected"] + counts["invalid"]
        new, self._reported[index] = refused - self._reported[index], refused
        dropped, self._dropped[index] = (
            counts["dropped"] - self._dropped[index],
            counts["dropped"],
        )
        shed, self._shed[index] = counts["shed"] - self._shed[index], counts["shed"]
        if self.problems[index]:
            return self.problems[index]
        if fault := self._receivers[topic].fault:
            return fault
        if age > declared.timeout:
            silence = f"no sample for {age:.3g} s" if age < float("inf") else "no sample yet"
            return f"{silence}; timeout is {declared.timeout:g} s"
        if dropped or shed:
            why = f"{dropped} samples were dropped: more than {MOST_KEPT} waited to be used"
            return why if dropped else f"{shed} samples were shed: the observer cannot keep up"
        return f"{new} samples were rejected" if new else ""
