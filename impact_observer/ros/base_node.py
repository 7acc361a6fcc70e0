# SPDX-License-Identifier: Apache-2.0
"""The base class of the nodes: parameters, topics, timers, log and diagnostics."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType, JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_parameters
from rclpy.timer import Timer

from impact_observer.io.interfaces import DIAGNOSTIC_ARRAYS, SIMULATED_CLOCK, Interface
from impact_observer.io.messages import AnyMessage, MessageError
from impact_observer.options import Option
from impact_observer.plain_text import printable
from impact_observer.process_end import one_line
from impact_observer.ros import parameters
from impact_observer.ros.log_lines import LogLines
from impact_observer.ros.message_classes import message_class, ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.statuses import diagnostic_status
from impact_observer.ros.subscribing import waiting_messages

_MOST_CLOCKS = 100
"""Messages of the clock that are taken at once."""
_OF_ROS = {"/rosout", "/parameter_events", "/clock", DIAGNOSTIC_ARRAYS.name}
"""Topics that every node has."""
_LOOK_PERIOD = 5.0
"""Time between two looks at the simulated time and at the other nodes, s."""
_ERRORS = "errors"
"""Key of the number of errors that did not end the node."""
_NOTED = 10.0
"""How long the status of a node is not OK after it has taken note of something, s."""


class BaseNode(Node):
    """A node of the package.

    Attributes:
        values: the parameters of the node.
        lines: the log of the node.
        make: makes ROS messages of our values.
        doubts: what is wrong with the node from its start on, for ``/diagnostics``.
        ends_by: the errors that end the node.
    """

    ends_by: tuple[type[Exception], ...] = ()

    def __init__(self, name: str, table: tuple[Option, ...]) -> None:
        """Declare the parameters of ``table``.

        Raises:
            UsageError: a parameter is of the wrong type, out of range, or missing.
        """
        super().__init__(name)
        self._lasting = set[object]()
        self._jump: JumpHandle | None = None
        self.values = parameters.declare(self, table)
        self.lines = LogLines(self.get_logger())
        self.make = ros_messages()
        self.doubts = ""
        self._noted, self._last_note, self._last_kind = Counter[str](), "", ""
        self._noted_at = -_NOTED
        self.diagnose(tuple)
        self._status_topic = self.publisher(DIAGNOSTIC_ARRAYS)
        self.repeat(1.0, self._end_second)
        self.repeat(_LOOK_PERIOD, self.warn_of_surroundings)

    def stamp_now(self) -> int:
        """The time of the node's clock, ns; 0 under simulated time that has not begun."""
        return int(self.get_clock().now().nanoseconds)

    def publisher(self, interface: Interface) -> Publisher:
        """A publisher of a topic; a topic of the node itself is named relative to the node."""
        owner, _, last = interface.name.rpartition("/")
        topic = f"~/{last}" if owner else interface.name
        return self.create_publisher(
            message_class(interface.type), topic, qos_profile(interface.quality)
        )

    def publish(
        self, publisher: Publisher, convert: Callable[..., AnyMessage], *values: object
    ) -> AnyMessage | None:
        """Publish ``convert(*values)``; log an error if no message may carry the values.

        So neither a number that is not finite leaves a node, nor does the node end.

        Returns:
            The message that is published; None if none is.
        """
        try:
            message = convert(*values)
        except MessageError as error:
            self.lines.error(f"{publisher.topic_name}: not published: {error}")
            return None
        publisher.publish(message)
        return message

    def serve(self, kind: type, name: str, callback: Callable[..., object]) -> None:
        """Offer a service, which keeps as many requests as those of parameters."""
        self.create_service(kind, name, callback, qos_profile=qos_profile_parameters)

    def repeat(self, period: float, callback: Callable[[], None]) -> Timer:
        """Call ``callback`` every ``period`` seconds of a steady clock."""
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def take_clock(self) -> None:
        """Set the node's clock by what has come on ``/clock``, while nothing is spun."""
        for each in self.subscriptions:
            if each.topic_name == SIMULATED_CLOCK.name:
                for message, _ in waiting_messages(each, _MOST_CLOCKS):
                    with suppress(ValueError, OverflowError):  # a time that is none
                        each.callback(message)

    def when_clock_jumps_back(self, callback: Callable[[], None]) -> None:
        """Call ``callback`` after a backward jump of the clock, as of a bag that is looped."""
        backwards = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jump = self.get_clock().create_jump_callback(
            backwards, post_callback=lambda _: callback()
        )

    def note(self, kind: str, line: str) -> None:
        """Count what is wrong by its ``kind``, and tell ``line`` in log and diagnostics."""
        self._noted[kind] += 1
        self._last_kind, self._last_note, self._noted_at = kind, line, time.monotonic()
        self.lines.error(line)

    def note_error(self, error: Exception) -> None:
        """Note an error that does not end the node."""
        self.note(_ERRORS, one_line(error))

    def diagnose(self, statuses: Callable[[], Sequence[DiagnosticStatus]]) -> None:
        """Publish ``statuses()`` to ``/diagnostics`` every second, before that of every node."""
        self._reports = statuses

    def _end_second(self) -> None:
        """Publish the diagnostics of a second, and log how often lines were repeated."""
        self.lines.end_second()
        array = DiagnosticArray(status=[*self._reports(), self._own_status()])
        array.header.stamp = self.get_clock().now().to_msg()
        self._status_topic.publish(array)

    def _own_status(self) -> DiagnosticStatus:
        """The status that every node has: of messages that were refused, and of errors."""
        level, message = DiagnosticStatus.OK, "no message was refused, and no error has come"
        if count := sum(self._noted.values()):
            message = f"the last of {count}: {self._last_note}"
        if time.monotonic() < self._noted_at + _NOTED:
            is_error = self._last_kind == _ERRORS
            level = DiagnosticStatus.ERROR if is_error else DiagnosticStatus.WARN
        elif self.doubts:
            level, message = DiagnosticStatus.WARN, self.doubts
        name = self.get_fully_qualified_name()
        return diagnostic_status(f"{name}: node", level, message, self._noted, hardware=name)

    def warn_of_surroundings(self) -> None:
        """Warn of simulated time that has not begun, and of another node of the same name."""
        own = (self.get_name(), self.get_namespace())
        if (count := self.get_node_names_and_namespaces().count(own)) > 1:
            found = f"{count} nodes are called {self.get_fully_qualified_name()}"
            remedy = "start one with another name (-r __node:=NAME) or ROS_DOMAIN_ID"
            self.lines.warning(f"{found}: their messages are merged; {remedy}")
        if self.get_parameter("use_sim_time").value and self.stamp_now() == 0:
            self.lines.warning(
                "use_sim_time is set, but no /clock has come: nothing is published until it does"
            )

    def _entities(self) -> dict[Any, Any]:
        """Topics, services and timers of the node, but no ``/clock``: how each is destroyed."""
        own = (each for each in self.subscriptions if each.topic_name != SIMULATED_CLOCK.name)
        return {
            **dict.fromkeys(self.publishers, self.destroy_publisher),
            **dict.fromkeys(own, self.destroy_subscription),
            **dict.fromkeys(self.services, self.destroy_service),
            **dict.fromkeys(self.timers, self.destroy_timer),
            **dict.fromkeys(self.guards, self.destroy_guard_condition),
        }

    def introduce(self, what: str, waits_for: str) -> None:
        """Log what the node runs, its topics, and what the node waits for."""
        parts = [what]
        for verb, owners in (("receives", self.subscriptions), ("publishes", self.publishers)):
            if topics := sorted({each.topic_name for each in owners} - _OF_ROS):
                parts.append(f"{verb} {', '.join(topics)}")
        self.get_logger().info(printable("; ".join([*parts, f"waits for {waits_for}"])))
