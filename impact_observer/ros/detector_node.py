# SPDX-License-Identifier: Apache-2.0
"""The detector node: sensor messages in, impact events out."""

from collections.abc import Sequence
from functools import partial
from typing import TypeAlias

from diagnostic_msgs.msg import DiagnosticStatus

from impact_observer.detector import Detection, Detector, SensorCounts, Source, read_sources
from impact_observer.detector.source import SWITCH
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface, Quality
from impact_observer.io.messages import AnyMessage, read_pulse
from impact_observer.ros import parameters
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.intake import MOST_TOGETHER, Receiver
from impact_observer.ros.topics import MessageInfo, message_class
from impact_observer.stamps import text

_TICK = 0.01
"""How often the present time is given to the detector, s."""
_DEPTH = 5000
"""Messages of a sensor that may wait: half a second at 10 kHz."""
_Taken: TypeAlias = tuple[AnyMessage, MessageInfo]


class DetectorNode(BaseNode):
    """Runs one :class:`Detector` on the topics of its sources.

    A message without a stamp in its header gets the middleware's time of publication. Under
    simulated time, which the middleware does not know, the message gets the time of arrival. The
    past messages of a latched switch are received too, but not under simulated time, where they
    would get the present time.
    """

    def __init__(self) -> None:
        super().__init__("detector", parameters.DETECTOR)

    def configure(self) -> None:
        """Implement ``BaseNode``."""
        self._detector = Detector(epoch=self.values["epoch"])
        self._sources: dict[str, list[Source]] = {}
        for each in read_sources(self.values["sources"]):
            self._sources.setdefault(self.resolve_topic_name(each.topic), []).append(each)
        self._indices: dict[str, list[int]] = {}
        self._last_counts: dict[int, tuple[int, int]] = {}
        self._unstamped = 0
        self._impacts = self.publisher(interfaces.IMPACTS)
        self._receivers = {topic: self._receiver(topic) for topic in self._sources}
        if not self._detector.epoch:
            Receiver(
                self,
                interfaces.PHASE_REFERENCE,
                self._on_pulses,
                read=lambda message, _: [read_pulse(message)],
            )
        self.repeat(_TICK, self._on_tick)
        self.when_clock_jumps_back(self._detector.restart)
        contacts = sorted({each.contact for own in self._sources.values() for each in own})
        topics = ", ".join(sorted(self._sources))
        self.introduce(f"contacts {', '.join(contacts)}", f"publishers of {topics}")

    def _receiver(self, topic: str) -> Receiver[_Taken]:
        """The receiver of a topic, whose messages keep their time of publication."""
        # Under simulated time the others wait for the clock, which stamps them.
        most = 1 if self.get_clock().ros_time_is_active else MOST_TOGETHER
        return Receiver(
            self,
            Interface(topic, "", Quality(depth=_DEPTH)),
            partial(self._on_messages, topic),
            read=lambda *message_and_info: [message_and_info],
            choose=partial(self._choose, topic),
            most_together=most,
        )

    def _choose(self, topic: str, type_name: str, offer: Quality) -> Quality:
        """What all publishers offer, if the sources of a topic suit the type.

        Raises:
            UsageError: they do not, or the type is not installed.
        """
        sources = [each.complete(type_name) for each in self._sources[topic]]
        message_class(type_name)
        if topic not in self._indices:
            self._indices[topic] = [*map(self._detector.add_source, sources)]
        for index, source in zip(self._indices[topic], sources, strict=True):
            self._detector.change_source(index, source)
        # Of use are past messages of a switch, where their times are known.
        has_times = not self.get_clock().ros_time_is_active
        wants_past = has_times and any(each.kind == SWITCH for each in sources)
        is_latched = offer.reliable and offer.transient_local and wants_past
        return Quality(offer.reliable, is_latched, _DEPTH)

    def _on_messages(self, topic: str, taken: Sequence[_Taken]) -> None:
        """Publish the events in messages, unless simulated time has not begun."""
        for message, info in taken:
            arrival = self.stamp_now()
            if not self.get_clock().ros_time_is_active:
                arrival = info["source_timestamp"] or arrival
            if arrival == 0:
                self._unstamped += 1
                continue
            for index in self._indices[topic]:
                self._publish_events(self._detector.feed(index, message, arrival))

    def _publish_events(self, detections: list[Detection]) -> None:
        for _, event in detections:
            self.publish(self._impacts, self.make.event, event)

    def _on_pulses(self, pulses: Sequence[int]) -> None:
        """Take the first pulse of a drive as the epoch of all events from now on."""
        if not self._detector.epoch:
            self._detector.epoch = pulses[0]
            self.lines.info(f"epoch {text(pulses[0])} s, by the first pulse of the drive")

    def _on_tick(self) -> None:
        """Let time pass: a switch without messages may stay closed."""
        if now := self.stamp_now():
            self._publish_events(self._detector.advance(now))

    def statuses(self) -> list[DiagnosticStatus]:
        """The state of each sensor."""
        return [
            *(
                self.status(each.contact, *self._fault(topic), {}, each.contact)
                for topic, own in self._sources.items()
                if topic not in self._indices
                for each in own
            ),
            *(self._sensor_status(t, i) for t, own in self._indices.items() for i in own),
        ]

    def _fault(self, topic: str) -> tuple[bytes, str]:
        """Level and message of what is wrong with the publishers of a topic."""
        receiver = self._receivers[topic]
        level = DiagnosticStatus.ERROR if receiver.offers else DiagnosticStatus.WARN
        return level, receiver.fault

    def _sensor_status(self, topic: str, index: int) -> DiagnosticStatus:
        """The status of a sensor that has had a publisher."""
        source, counts = self._detector.sources[index], self._detector.counts[index]
        messages, unusable = self._last_counts.get(index, (0, 0))
        now_unusable = counts.invalid + counts.out_of_order
        self._last_counts[index] = (counts.messages, now_unusable)
        level, message = DiagnosticStatus.OK, f"{counts.impacts} impacts"
        if now_unusable > unusable or not counts.messages:
            level, message = DiagnosticStatus.WARN, self._detector.problem(index)
        if self._unstamped and not self.stamp_now():
            level, message = DiagnosticStatus.WARN, "use_sim_time is set, but no /clock has come"
        if (fault := self._fault(topic))[1]:
            level, message = fault
        values = _values(source, counts, messages)
        return self.status(source.contact, level, message, values, source.contact)


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
