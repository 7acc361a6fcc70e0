# SPDX-License-Identifier: Apache-2.0
"""The detector node: sensor messages in, impact events out."""

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.subscription import Subscription

from impact_observer.detector import Detection, Detector, SensorCounts, Source, read_sources
from impact_observer.detector.source import SWITCH
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Quality
from impact_observer.io.live_inputs import read_pulse
from impact_observer.io.messages import AnyMessage, MessageError
from impact_observer.ros import parameters
from impact_observer.ros.managed_node import ManagedNode
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.statuses import diagnostic_status
from impact_observer.ros.subscribing import (
    MOST_TOGETHER,
    MessageInfo,
    common_offer,
    waiting_messages,
)
from impact_observer.stamps import text

_DISCOVERY_PERIOD = 0.1
"""How often the graph is searched for the sensors' topics, s."""
_TICK = 0.01
"""How often the present time is given to the detector, s."""
_DEPTH = 5000
"""Messages of a sensor that may wait: half a second at 10 kHz."""


class DetectorNode(ManagedNode):
    """Runs one :class:`Detector` on the topics of its sources.

    A message without a stamp in its header gets the middleware's time of publication. Under
    simulated time, which the middleware does not know, the message gets the time of arrival. The
    past messages of a latched switch are received too, but not under simulated time, where they
    would get the present time.
    """

    def __init__(self) -> None:
        super().__init__("detector", parameters.DETECTOR)

    def configure(self) -> None:
        """Implement ``ManagedNode``."""
        self._wanted = list(read_sources(self.values.text("sources")))
        self._detector = Detector(epoch=self.values.integer("epoch"))
        self._indices: dict[str, list[int]] = {}
        self._requested: dict[str, Quality] = {}
        self._subscriptions_by_topic: dict[str, Subscription] = {}
        self._last_counts: dict[int, tuple[int, int]] = {}
        self._unstamped = 0
        self._doubts: list[str] = []
        self._impacts = self.publisher(interfaces.IMPACTS)
        if not self._detector.epoch:
            pulses = interfaces.PHASE_REFERENCE
            self.create_subscription(
                message_class(pulses.type),
                pulses.name,
                self._on_pulse,
                qos_profile(pulses.quality),
            )
        self.repeat(_DISCOVERY_PERIOD, self._discover)
        self.repeat(_TICK, self._on_tick)
        self.diagnose(self._statuses)
        self.when_clock_jumps_back(self._detector.restart)
        topics = sorted({self.resolve_topic_name(each.topic) for each in self._wanted})
        contacts = sorted({each.contact for each in self._wanted})
        self.introduce(f"contacts {', '.join(contacts)}", f"publishers of {', '.join(topics)}")

    def _discover(self) -> None:
        """Subscribe to the sensors' topics that have a publisher, and thus a type."""
        for source in tuple(self._wanted):
            topic = self.resolve_topic_name(source.topic)
            if publishers := self.get_publishers_info_by_topic(topic):
                complete = source.complete(publishers[0].topic_type)
                self._indices.setdefault(topic, []).append(self._detector.add_source(complete))
                self._wanted.remove(source)
        for topic in self._indices:
            self._subscribe(topic)

    def _subscribe(self, topic: str) -> None:
        """Subscribe with the quality of service that all publishers of a topic offer."""
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        offered = common_offer(topic, publishers)
        before = self._requested.get(topic)
        reliable = offered.reliable and (before is None or before.reliable)
        latched = reliable and offered.transient_local and self._wants_past_messages(topic)
        wanted = Quality(reliable, latched and (before is None or before.transient_local), _DEPTH)
        if wanted == before:
            return
        if before is not None:
            self.destroy_subscription(self._subscriptions_by_topic.pop(topic))
        self._requested[topic] = wanted
        self._subscriptions_by_topic[topic] = self.create_subscription(
            message_class(publishers[0].topic_type),
            topic,
            lambda message, info: self._on_message(topic, message, info),
            qos_profile(wanted),
        )

    def _wants_past_messages(self, topic: str) -> bool:
        """Whether past messages are useful: messages of a switch with known times."""
        kinds = {self._detector.sources[index].kind for index in self._indices[topic]}
        return SWITCH in kinds and not self.get_clock().ros_time_is_active

    def _on_message(self, topic: str, message: AnyMessage, info: MessageInfo) -> None:
        """Detect events in a message and in the messages that wait behind it.

        Under simulated time the others wait for the clock, which stamps them.
        """
        self._detect(topic, message, info)
        if not self.get_clock().ros_time_is_active:
            subscription = self._subscriptions_by_topic[topic]
            for waiting, its_info in waiting_messages(subscription, MOST_TOGETHER):
                self._detect(topic, waiting, its_info)

    def _detect(self, topic: str, message: AnyMessage, info: MessageInfo) -> None:
        """Publish the events in a message, unless simulated time has not begun."""
        arrival = self.stamp_now()
        if not self.get_clock().ros_time_is_active:
            arrival = info["source_timestamp"] or arrival
        if arrival == 0:
            self._unstamped += 1
            return
        for index in self._indices[topic]:
            self._publish_events(self._detector.feed(index, message, arrival))

    def _publish_events(self, detections: list[Detection]) -> None:
        for _, event in detections:
            self.publish(self._impacts, self.make.event, event)

    def _on_pulse(self, message: AnyMessage) -> None:
        """Take the first pulse of a drive as the epoch of all events from now on."""
        if self._detector.epoch:
            return
        try:
            self._detector.epoch = read_pulse(message)
        except MessageError as error:
            self.lines.error(f"{interfaces.PHASE_REFERENCE.name}: {error}")
            return
        self.lines.info(f"epoch {text(self._detector.epoch)} s, by the first pulse of the drive")

    def _on_tick(self) -> None:
        """Let time pass: a switch without messages may stay closed."""
        if now := self.stamp_now():
            self._publish_events(self._detector.advance(now))

    def _statuses(self) -> list[DiagnosticStatus]:
        """The state of each sensor; new doubts are logged, such as an epoch in another unit."""
        doubts, self._doubts = self._doubts, self._detector.doubts
        for line in self._doubts:
            if line not in doubts:
                self.lines.warning(line)
        return [
            *(self._missing_status(source) for source in self._wanted),
            *(self._sensor_status(index) for index in range(len(self._detector.sources))),
        ]

    def _missing_status(self, source: Source) -> DiagnosticStatus:
        """The status of a sensor without a publisher."""
        topic = self.resolve_topic_name(source.topic)
        return self._status(source, DiagnosticStatus.WARN, f"no node publishes {topic}", {})

    def _sensor_status(self, index: int) -> DiagnosticStatus:
        """The status of a sensor with a publisher."""
        source, counts = self._detector.sources[index], self._detector.counts[index]
        messages, unusable = self._last_counts.get(index, (0, 0))
        now_unusable = counts.invalid + counts.out_of_order
        self._last_counts[index] = (counts.messages, now_unusable)
        level, message = DiagnosticStatus.OK, f"{counts.impacts} impacts"
        if doubt := source.doubt or self._detector.epoch_doubt:
            level, message = DiagnosticStatus.WARN, doubt
        if now_unusable > unusable or not counts.messages:
            level, message = DiagnosticStatus.WARN, self._detector.problem(index)
        if self._unstamped and not self.stamp_now():
            level, message = DiagnosticStatus.WARN, "use_sim_time is set, but no /clock has come"
        return self._status(source, level, message, _values(source, counts, messages))

    def _status(
        self, source: Source, level: bytes, message: str, values: Mapping[str, object]
    ) -> DiagnosticStatus:
        name = f"{self.get_fully_qualified_name()}: {source.contact}"
        return diagnostic_status(name, level, message, values, hardware=source.contact)


def _values(source: Source, counts: SensorCounts, messages: int) -> dict[str, object]:
    """The values of a sensor's diagnostics; ``messages`` is their number a second ago."""
    return {
        "topic": source.topic,
        "kind": source.kind,
        "impacts": counts.impacts,
        "persistent contacts": counts.closings,
        "openings": counts.openings,
        "last event [s]": text(counts.last_event) if counts.last_event else "none",
        "messages": counts.messages,
        "rate [Hz]": counts.messages - messages,
        "messages not usable": counts.invalid,
        "stamps out of order": counts.out_of_order,
        "largest signal": f"{counts.largest_signal:.6g}",
    }
