# SPDX-License-Identifier: Apache-2.0
"""What every node has: life cycle, parameters, topics, log, diagnostics, and its end."""

import faulthandler
import gc
import re
import time
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.srv import ChangeState
from rclpy.clock import Clock, ClockType, JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_parameters
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.wait_for_message import wait_for_message

from impact_observer.errors import UnsetError, UsageError
from impact_observer.io.interfaces import (
    DIAGNOSTIC_ARRAYS,
    LATCHED,
    SIMULATED_CLOCK,
    STRING,
    Interface,
)
from impact_observer.io.messages import AnyMessage, MessageError
from impact_observer.model import Model
from impact_observer.options import Option
from impact_observer.plain_text import printable
from impact_observer.process_end import Stop, one_line
from impact_observer.ros import parameters
from impact_observer.ros.intake import Receiver
from impact_observer.ros.session import refusals_of_ros
from impact_observer.ros.topics import message_class, qos_profile, ros_messages

_PAUSE, _MOST_KINDS, _OTHERS = 10.0, 20, "other lines"
"""How long further log lines of a kind are only counted, s; kinds meanwhile, as strangers may name
contacts; and the kind of the lines for which there is no room."""
_OF_ROS = {"/rosout", "/parameter_events", "/clock", DIAGNOSTIC_ARRAYS.name}
"""Topics that every node has."""
_LOOK_PERIOD = 5.0
"""Time between two looks at the simulated time and at the other nodes, s."""
_ERRORS = "errors"
"""Key of the number of errors that did not end the node."""
_NOTED = 10.0
"""How long the status of a node is not OK after it has taken note of something, s."""
_LONGEST = 40
"""Characters of the name of a transition that are logged."""
_FOLLOW_PERIOD = 0.1
"""Time between two looks at the publishers of the topics that are received, s."""
_URDF_PATIENCE = 10.0
"""How long a node waits for a URDF, s."""
_SHUTDOWN_TIMEOUT = 5.0
"""How long the middleware may take to shut down before the process ends without it, s."""
_OBJECTS = 10_000, 20, 20
"""New objects after which the youngest are searched for garbage, and ratios for older ones."""
_SIGNAL_PERIOD = 0.1
"""Longest time until a signal is noticed, s."""


class BaseNode(LifecycleNode):
    """A node that configures and activates itself, unless ``autostart`` is false.

    An inactive node goes on receiving, and ``publish`` publishes nothing.

    Attributes:
        values: the values of the parameters, by name.
        receivers: the topics that the node receives.
        lines: the log of the node.
        make: makes ROS messages of our values.
        ends_by: the errors that end the node.
        done: whether the node's process is to end.
        is_configured: whether the node is inactive or active.
        is_active: whether the node publishes.
    """

    ends_by: tuple[type[Exception], ...] = ()

    def __init__(self, name: str, table: tuple[Option, ...]) -> None:
        """Declare the parameters of ``table``; configure and activate the node by ``autostart``.

        Raises:
            UsageError: a parameter is of the wrong type, out of range, or missing; or the node
                cannot be configured.
        """
        super().__init__(name)
        self._jump: JumpHandle | None = None
        self.values = parameters.declare(self, table)
        self.lines = LogLines(self.get_logger())
        self.make = ros_messages()
        self.receivers: list[Receiver[Any]] = []
        self._noted, self._last_note, self._last_kind = Counter[str](), "", ""
        self._noted_at = -_NOTED
        self._status_topic = self.publisher(DIAGNOSTIC_ARRAYS)
        self.repeat(1.0, self._end_second)
        self.repeat(_FOLLOW_PERIOD, self._follow_publishers)
        self.repeat(_LOOK_PERIOD, self.warn_of_surroundings)
        self._doubts = "; ".join(self._unknown_parameters())
        if self._doubts:
            self.lines.warning(self._doubts)
        self._lasting = self._entities().keys()
        self.done = self.is_configured = self.is_active = False
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        self._failures: list[Exception] = []
        if self.values["autostart"]:
            self.trigger_configure()
            if self._failures:
                self.destroy_node()
                raise self._failures[0]
            self.trigger_activate()

    @abstractmethod
    def configure(self) -> None:
        """Read the files that parameters name, and make topics, services and timers.

        Raises:
            UsageError: a parameter does not suit the others.
        """

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Begin anew; an error is logged, and the node stays unconfigured."""
        try:
            self.configure()
        except Exception as error:  # noqa: BLE001 (rclpy would hide the error)
            self._forget()
            return self.refuse(error)
        self.is_configured = True
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Publish from now on."""
        self.is_active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Pause: keep the state, and publish nothing."""
        self.is_active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything but the parameters."""
        self._forget()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """End the process."""
        self._forget()
        self.done = True
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Destroy the node, and the state machine, which would keep the node on the graph."""
        super().destroy_node()
        self.__dict__.pop("_state_machine", None)

    def refuse(self, why: Exception) -> TransitionCallbackReturn:
        """Let a transition fail; who asked for it finds the line of ``why`` in the log."""
        self._failures = [why]
        return TransitionCallbackReturn.FAILURE

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
        """Publish ``convert(*values)`` if the node is active.

        An error is logged if no message may carry the values, such as numbers that are not finite.

        Returns:
            The message that is published; None if none is.
        """
        if not self.is_active:
            return None
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

    def statuses(self) -> Sequence[DiagnosticStatus]:
        """The diagnostics of a configured node every second, before the status of every node."""
        return ()

    def status(
        self,
        what: str,
        level: bytes,
        message: str,
        values: Mapping[str, object],
        hardware: str = "",
    ) -> DiagnosticStatus:
        """A status of ``what`` in the node, with the texts of ``values``."""
        name = self.get_fully_qualified_name()
        return DiagnosticStatus(
            level=level,
            name=f"{name}: {what}",
            message=message,
            hardware_id=hardware or name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

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

    def introduce(self, what: str, waits_for: str) -> None:
        """Log what the node runs, its topics, and what the node waits for."""
        parts = [what]
        for verb, owners in (("receives", self.subscriptions), ("publishes", self.publishers)):
            if topics := sorted({each.topic_name for each in owners} - _OF_ROS):
                parts.append(f"{verb} {', '.join(topics)}")
        self.get_logger().info(printable("; ".join([*parts, f"waits for {waits_for}"])))

    def with_urdf_of_topic(self, model: Model) -> Model:
        """The ``model`` with the robot's URDF, which is waited for if a topic has it.

        Raises:
            UsageError: nothing comes on the topic, such as ``robot_description``.
            ModelError: the URDF does not fit the model file.
        """
        robot = model.robot
        if robot is None or robot.urdf is not None:
            return model
        got, message = wait_for_message(
            message_class(STRING),
            self,
            robot.topic,
            qos_profile=qos_profile(LATCHED),
            time_to_wait=_URDF_PATIENCE,
        )
        if not got:
            raise UsageError(
                f"{robot.name}: no URDF came on the topic {self.resolve_topic_name(robot.topic)}"
                f" within {_URDF_PATIENCE:g} s; expected a latched std_msgs/String, as of"
                " robot_state_publisher"
            )
        return model.with_urdf(message.data)

    def _follow_publishers(self) -> None:
        """Let all receivers follow the publishers of their topics."""
        for each in self.receivers:
            each.follow()

    def _end_second(self) -> None:
        """Publish the diagnostics of a second, and log how often lines were repeated."""
        self.lines.end_second()
        own = self.statuses() if self.is_configured else ()
        array = DiagnosticArray(status=[*own, self._own_status()])
        array.header.stamp = self.get_clock().now().to_msg()
        self._status_topic.publish(array)

    def _own_status(self) -> DiagnosticStatus:
        """The status that every node has: of publishers, refused messages, and errors."""
        level, message = DiagnosticStatus.OK, "no message was refused, and no error has come"
        if count := sum(self._noted.values()):
            message = f"the last of {count}: {self._last_note}"
        if time.monotonic() < self._noted_at + _NOTED:
            is_error = self._last_kind == _ERRORS
            level = DiagnosticStatus.ERROR if is_error else DiagnosticStatus.WARN
        elif faults := [each.fault for each in self.receivers if each.offers and each.fault]:
            level, message = DiagnosticStatus.ERROR, "; ".join(faults)
        elif self._doubts:
            level, message = DiagnosticStatus.WARN, self._doubts
        return self.status("node", level, message, self._noted)

    def _unknown_parameters(self) -> Iterator[str]:
        """A line for each parameter that was given, such as a misspelt one, and not declared."""
        for name in sorted(self._parameter_overrides):
            if not self.has_parameter(name) and not name.startswith("qos_overrides."):
                declared = ", ".join(sorted(self.get_parameters_by_prefix("")))
                yield f"parameter {name} does not exist and is ignored; expected {declared}"

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

    def _forget(self) -> None:
        """Destroy what ``configure`` made, and what was made later in its callbacks."""
        self.is_configured = self.is_active = False
        self.receivers.clear()
        if self._jump is not None:
            self._jump.unregister()
            self._jump = None
        for each, destroy in self._entities().items():
            if each not in self._lasting:
                destroy(each)

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Make a transition; rclpy would end the node at one that is not possible."""
        state = self._state_machine.current_state[1]
        self._failures.clear()
        try:
            response = self._change_state(request, response)
        except Exception:  # noqa: BLE001 (a request must not end the node)
            response.success = False
        if not response.success:
            transition = request.transition.label[:_LONGEST] or request.transition.id
            why = one_line(self._failures[0]) if self._failures else f"the node is {state}"
            self.lines.error(f"transition {transition} failed: {why}")
        return response


def spin(stop: Stop, make: Callable[[], BaseNode], args: Sequence[str]) -> None:
    """Make a node with the arguments of its process, and spin it until a signal or its own end.

    Raises:
        UsageError: the node refuses its parameters, or ROS the arguments after ``--ros-args``.
    """
    # Not EventsExecutor: in rclpy 7.1.6 an event of the middleware (incompatible quality of
    # service) ends its spinning with a SystemError.
    node = executor = None
    try:
        with refusals_of_ros("--ros-args: not understood"):
            rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
        with refusals_of_ros():
            node = make()
        gc.collect()  # a search of all that was imported takes 80 ms without a message
        gc.freeze()
        gc.set_threshold(*_OBJECTS)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok() and not stop.requested and not node.done:
            spin_once(executor, node.note_error, node.ends_by)
    except UnsetError as error:
        raise UsageError(f"{error}: give --ros-args -p {error.option}:=FILE") from None
    except ExternalShutdownException:
        return
    finally:
        # Fast DDS was once seen to hang when many nodes left at the same time.
        faulthandler.dump_traceback_later(_SHUTDOWN_TIMEOUT, exit=True)
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()


def spin_once(
    executor: SingleThreadedExecutor,
    note: Callable[[Exception], object],
    ends_by: tuple[type[Exception], ...],
) -> None:
    """Spin until a signal may have come; an error that is none of ``ends_by`` is only noted.

    rclpy converts requests, messages and the time on ``/clock`` outside of callbacks, so that no
    callback could guard against what others send.
    """
    try:
        executor.spin_once(timeout_sec=_SIGNAL_PERIOD)
    except (ExternalShutdownException, *ends_by):
        raise
    except Exception as error:  # noqa: BLE001 (nothing else ends a node)
        note(error)


class LogLines:
    """Logs the first line of each kind, and later the number of further lines of that kind.

    The kind of a line is the line without its numbers, unless it is given. So a flood of messages
    floods no log.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to ``logger``."""
        self._logger = logger
        self._begun: dict[str, float] = {}
        self._repeated = Counter[str]()

    def error(self, line: str, kind: str = "") -> None:
        """Log an error."""
        if self._is_new(line, kind):
            self._logger.error(printable(line))

    def warning(self, line: str, kind: str = "") -> None:
        """Log a warning."""
        if self._is_new(line, kind):
            self._logger.warning(printable(line))

    def info(self, line: str, kind: str = "") -> None:
        """Log a usual event."""
        if self._is_new(line, kind):
            self._logger.info(printable(line))

    def end_second(self) -> None:
        """Log how often a kind was repeated whose pause is over; to be called every second."""
        over = time.monotonic() - _PAUSE
        for kind in [each for each, begun in self._begun.items() if begun <= over]:
            del self._begun[kind]
            if more := self._repeated.pop(kind, 0):
                self._logger.info(printable(f"{kind}: {more} more in {_PAUSE:g} s"))

    def _is_new(self, line: str, kind: str) -> bool:
        """Whether no line of this kind was logged within the pause."""
        kind = kind or without_numbers(line)
        if kind not in self._begun and len(self._begun) >= _MOST_KINDS:
            kind = _OTHERS
        if kind in self._begun:
            self._repeated[kind] += 1
            return False
        self._begun[kind] = time.monotonic()
        return True


def without_numbers(line: str) -> str:
    """The line with N for each number."""
    return re.sub(r"-?\d+(\.\d+)?(e[+-]?\d+)?", "N", line)
