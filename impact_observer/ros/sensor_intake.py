# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of an observer node to what sensors measure beside the impacts."""

import time
from collections.abc import Callable, Iterator, Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.subscription import Subscription

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.events import Verdict
from impact_observer.io.interfaces import Quality
from impact_observer.io.measured_samples import SENSOR_STATUS, SILENT_RATE, SensorReader
from impact_observer.io.messages import AnyMessage
from impact_observer.observer import Observer
from impact_observer.observer.samples import MOST_KEPT, SensorSample
from impact_observer.options import AUTO, NONE
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.statuses import diagnostic_status
from impact_observer.ros.subscribing import SLICE, Ahead, Polled, slice_of_waiting
from impact_observer.stamps import NS_PER_S, from_seconds

_DEPTH = 2000
"""Samples of a topic that may wait: those of 2 s at 1 kHz."""
_COUNTED = 20
"""Samples by which the rate of a sensor is known."""


class SensorIntake:
    """Gives the samples that a node receives to its observer.

    A topic is subscribed to once a publisher has given it a type. Messages wait for
    ``take_waiting``, which costs a fraction of taking each when it arrives. Samples that are too
    far ahead of the clock are used once that has come near enough: it may be the clock that is
    late.

    Attributes:
        problems: of each sensor, the last one; empty for none.
    """

    def __init__(
        self,
        node: Node,
        observer: Observer,
        *,
        clock: tuple[Callable[[], int], float, float],
        reliable: bool,
        verdicts: str,
        on_samples: Callable[[int, Sequence[Verdict]], None],
        on_problem: Callable[[str], None],
    ) -> None:
        """Prepare to receive what the sensors of ``observer`` publish.

        Args:
            node: whose subscriptions they are.
            observer: takes the samples.
            clock: the time, ns; and how far before and after it a stamp may be, s.
            reliable: whether lost samples are to be sent again; publishers must offer that.
            verdicts: of which sensors verdicts are published, one of ``options.VERDICTS``.
            on_samples: called after new samples with the least of their stamps, ns, and verdicts
                on events that have changed.
            on_problem: called with a line on samples that cannot be used.
        """
        self._node, self._observer = node, observer
        self._now, self._past, self._future = clock
        self._quality = Quality(reliable=reliable, depth=_DEPTH)
        self._verdicts = verdicts
        self._on_samples, self._on_problem = on_samples, on_problem
        self._sensors = observer.samples.sensors
        self.problems = [""] * len(self._sensors)
        self._waiting = {node.resolve_topic_name(s.measurement.topic) for s in self._sensors}
        self._readers: dict[str, list[SensorReader]] = {}
        self._group = Polled()
        self._subscriptions: dict[str, Subscription] = {}
        self._first: dict[int, tuple[int, int]] = {}
        self._reported = [0] * len(self._sensors)
        self._lost = [0] * len(self._sensors)
        self._ahead = Ahead[SensorSample](_DEPTH)

    @property
    def topics(self) -> tuple[str, ...]:
        """Absolute names of all topics."""
        names = (self._node.resolve_topic_name(s.measurement.topic) for s in self._sensors)
        return tuple(dict.fromkeys(names))

    def discover(self) -> None:
        """Subscribe to the topics that have a publisher by now."""
        for topic in sorted(self._waiting):
            if publishers := self._node.get_publishers_info_by_topic(topic):
                self._waiting.discard(topic)
                self._subscribe(topic, publishers[0].topic_type)

    def _subscribe(self, topic: str, type_name: str) -> None:
        readers = []
        for sensor in self._sensors:
            declared = sensor.measurement
            if self._node.resolve_topic_name(declared.topic) != topic:
                continue
            try:
                readers.append(SensorReader(declared, sensor.index, type_name))
            except UsageError as error:
                self._refuse(sensor.index, str(error))
        if not readers:
            return
        self._readers[topic] = readers
        try:
            self._subscriptions[topic] = self._node.create_subscription(
                message_class(type_name),
                topic,
                _ignore,
                qos_profile(self._quality),
                callback_group=self._group,
            )
        except ImpactObserverError as error:
            for each in readers:
                self._refuse(each.index, str(error))

    def take_waiting(self) -> bool:
        """Take the messages that have arrived; whether more may wait."""
        end, samples = time.monotonic_ns() + SLICE, [*self._no_longer_ahead()]
        for topic, subscription in self._subscriptions.items():
            for message in slice_of_waiting(subscription, _DEPTH):
                samples += self._read(topic, message)
        if samples:
            revised = self._observer.measure(samples)
            self._on_samples(min(each.stamp for each in samples), revised)
        return time.monotonic_ns() >= end

    def _read(self, topic: str, message: AnyMessage) -> list[SensorSample]:
        """The samples in a message; a sensor without its field is given up."""
        now, found = self._now(), list[SensorSample]()
        for reader in tuple(self._readers[topic]):
            try:
                sample = reader.sample(message, now)
            except UsageError as error:
                self._refuse(reader.index, str(error))
                if "[" not in reader.measurement.field:  # an array may be shorter now and then
                    self._readers[topic].remove(reader)
                continue
            if sample is None:
                self.problems[reader.index] = (
                    f"no {reader.measurement.quantity} of {reader.measurement.joint!r} on {topic}"
                )
            elif now and (ahead := (sample.stamp - now) / NS_PER_S) > self._future:
                self._wait(sample, ahead)
            elif now and ahead < -self._past:
                what = f"stamped {-ahead:.3f} s before the clock"
                self._refuse(reader.index, f"{what}; history allows {self._past:g} s")
            else:
                self._note(sample)
                found.append(sample)
        return found

    def _note(self, sample: SensorSample) -> None:
        """Note that a sample is used."""
        self.problems[sample.sensor] = ""
        self._first.setdefault(sample.sensor, (sample.stamp, self._samples(sample.sensor)))

    def _wait(self, sample: SensorSample, ahead: float) -> None:
        """Keep a sample that is too far ahead of the clock (s); the first one is logged."""
        limit = f"future allows {self._future:g} s"
        problem = f"stamped {ahead:.3f} s after the clock; {limit}, and it waits"
        if not self.problems[sample.sensor]:
            self._tell(sample.sensor, problem)
        self.problems[sample.sensor] = problem
        if (last := self._ahead.add(sample.stamp, sample)) is not None:
            self._refuse(last.sensor, f"more than {_DEPTH} samples are ahead of the clock")

    def _no_longer_ahead(self) -> Iterator[SensorSample]:
        """The samples to which the clock has come."""
        latest = self._now() + from_seconds(self._future) if self._ahead else 0
        while (sample := self._ahead.taken(latest)) is not None:
            self._note(sample)
            yield sample

    def clear(self) -> None:
        """Forget what waits for the clock, as when that has jumped back."""
        self._ahead.clear()

    def _refuse(self, index: int, problem: str) -> None:
        self._observer.samples.counts[index]["invalid"] += 1
        self.problems[index] = problem
        self._tell(index, problem)

    def _tell(self, index: int, problem: str) -> None:
        self._on_problem(f"{self._sensors[index].name}: {problem}")

    def _samples(self, index: int) -> int:
        return self._observer.samples.counts[index]["samples"]

    def rate(self, index: int) -> float:
        """The mean rate of a sensor so far, Hz; 0 while it is not known."""
        samples = self._observer.samples
        if index not in self._first:
            return 0.0
        stamp, before = self._first[index]
        count, span = self._samples(index) - before - 1, samples.newest[index] - stamp
        return count * NS_PER_S / span if count >= _COUNTED and span > 0 else 0.0

    def is_published(self, index: int) -> bool:
        """Whether the verdicts on the samples of a sensor are to be published."""
        if self._verdicts != AUTO:
            return self._verdicts != NONE
        return 0 < self.rate(index) <= SILENT_RATE

    def statuses(self, now: int) -> list[DiagnosticStatus]:
        """The state of each sensor."""
        return [self._status(index, now) for index in range(len(self._sensors))]

    def _status(self, index: int, now: int) -> DiagnosticStatus:
        sensor, samples = self._sensors[index], self._observer.samples
        declared, counts, newest = sensor.measurement, samples.counts[index], samples.newest[index]
        topic = self._node.resolve_topic_name(declared.topic)
        age = (now - newest) / NS_PER_S if newest else float("inf")
        rejected = counts["rejected"] + counts["invalid"]
        new, self._reported[index] = rejected - self._reported[index], rejected
        learned = self._observer.learned_deviations
        level, message = DiagnosticStatus.OK, f"{counts['accepted']} samples accepted"
        if self.problems[index]:
            level, message = DiagnosticStatus.WARN, self.problems[index]
        elif topic in self._waiting:
            level, message = DiagnosticStatus.WARN, f"no node publishes {topic}"
        elif age > declared.timeout:
            silence = f"no sample for {age:.3g} s" if newest else "no sample yet"
            level = DiagnosticStatus.WARN
            message = f"{silence}; timeout is {declared.timeout:g} s"
        elif lost := counts["dropped"] - self._lost[index]:
            self._lost[index] += lost
            level = DiagnosticStatus.WARN
            message = f"{lost} samples were dropped: more than {MOST_KEPT} waited to be used"
        elif (shown := learned.get(sensor.name)) and declared.deviation is not None:
            level = DiagnosticStatus.WARN
            message = (
                f"samples err by {shown:.3g} {declared.unit}; {declared.deviation:g} is declared"
            )
        elif new:
            level, message = DiagnosticStatus.WARN, f"{new} samples were rejected"
        values = {
            "topic": topic,
            **{kind: counts[kind] for kind in ("samples", "accepted", "rejected", "unused")},
            **{kind: counts[kind] for kind in ("invalid", "dropped")},
            "rate [Hz]": f"{self.rate(index):.4g}",
            "age [s]": f"{age:.3f}",
        }
        if sensor.name in learned:
            values["learned deviation"] = f"{learned[sensor.name]:.4g}"
        name = f"{self._node.get_fully_qualified_name()}: {SENSOR_STATUS}{sensor.name}"
        return diagnostic_status(name, level, message, values, hardware=sensor.name)


def _ignore(_: AnyMessage) -> None:
    """Nothing is called: messages are taken."""
