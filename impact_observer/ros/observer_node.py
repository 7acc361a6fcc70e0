# SPDX-License-Identifier: Apache-2.0
"""The observer node: impact events in, the estimated state out.

An event passes through ``_on_impact``, ``EventIntake``, ``_apply`` and ``_publish`` in this order.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, partial

from diagnostic_msgs.msg import DiagnosticArray
from impact_observer_msgs.srv import SetState
from numpy.typing import ArrayLike
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.events import ImpactEvent, Ruling, Verdict
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Quality
from impact_observer.io.messages import MessageLimits
from impact_observer.model import read_model
from impact_observer.model.measurements_file import read_measurements
from impact_observer.observer import (
    LARGEST_INNOVATION,
    initial_state,
    make_observer,
)
from impact_observer.options import Options, Value
from impact_observer.plain_text import printable
from impact_observer.ros import parameters
from impact_observer.ros.event_intake import EventIntake
from impact_observer.ros.introduction import introduce
from impact_observer.ros.live_intake import LiveIntake
from impact_observer.ros.log_lines import LogLines
from impact_observer.ros.message_classes import message_class, ros_messages
from impact_observer.ros.observer_diagnostics import MisfitNews, ObserverDiagnostics
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.sensor_intake import SensorIntake
from impact_observer.ros.serialized import EstimateSerializer
from impact_observer.ros.subscribing import EventsSeldom, slice_of_waiting
from impact_observer.stamps import MAX_STAMP, NS_PER_S, from_seconds, seconds_between
from impact_observer.states import Estimate

_SIMULATED_BACKLOG = 20
"""Overdue estimates published after a jump of simulated time; older ones are skipped."""
_BACKLOG = 8
"""Overdue estimates published in real time, less than the depth of their topics, 10."""
_POLL_PERIOD = 0.05
"""How long live samples wait at most, s; they are taken before every estimate, too."""
_DISCOVERY_PERIOD = 0.1
"""How often the graph is searched for the topics of sensors, s."""
_LONGEST = 100
"""Characters of a reason that are logged; its verdict has all of them."""
_ACKNOWLEDGE_TIMEOUT = Duration(seconds=0.01)
"""How long to wait for subscribers within a backlog."""


class ObserverNode(Node):
    """Runs one observer; every estimate is stamped ``epoch + k / rate``.

    Estimates are published when the clock is ``lag`` past their stamps. When an event arrives
    after an estimate that should contain it, that estimate is corrected and published again
    immediately. The node never subscribes to the true state.
    """

    def __init__(self) -> None:
        super().__init__("observer")
        values = parameters.declare(self, parameters.OBSERVER)
        options, lag = values.options(), values.number("lag")
        _check_lag(options, {"lag": lag})
        model = read_model(values.text("model"))
        system = model.system
        self._initial = initial_state(options.initial_state, system, options.initial_deviation)
        sensors = read_measurements(values.text("measurements"))
        self._observer = make_observer(system, options, model.elements, measurements=sensors)
        self._restarts = 0
        self._serializer = EstimateSerializer(system.coordinates)
        self._rate = values.number("rate")
        self._lag = from_seconds(lag)
        self._make = ros_messages()
        self._states = self._publisher(interfaces.OBSERVER_STATES)
        self._joint_states = self._publisher(interfaces.OBSERVER_JOINT_STATES)
        self._verdicts = self._publisher(interfaces.OBSERVER_VERDICTS)
        self._bounds = self._publisher(interfaces.OBSERVER_BOUND)
        self._samples = self._publisher(interfaces.OBSERVER_MEASUREMENTS)
        self._diagnostics_topic = self.create_publisher(
            DiagnosticArray, "/diagnostics", qos_profile(interfaces.DIAGNOSTIC_ARRAYS.quality)
        )
        self._diagnostics = ObserverDiagnostics(self.get_fully_qualified_name(), self._observer)
        self._counts: Counter[str] = self._diagnostics.counts
        limits = MessageLimits(*(values.integer(each) for each in MessageLimits._fields))
        future = from_seconds(values.number("future"))
        self._intake = EventIntake(self._observer, self._now, future, limits, self._counts)
        self._lines = LogLines(self.get_logger())
        self._inputs = LiveIntake(
            self,
            self._observer.live,
            self._lines.error,
            (self._now, values.number("future")),
            polled=True,
            on_samples=self._correct_by_samples,
            on_pulse=self._observer.take_pulse
            if system.depends_on_time and not options.epoch
            else None,
        )
        self._sensors = self._sensor_intake(values, options)
        self._diagnostics.inputs = self._inputs
        self._diagnostics.input_timeout = values.number("input_timeout")
        self._go_on = self.create_guard_condition(self._apply_events)
        self._forget_estimates()
        durability = values.text("events_durability")
        events = Quality(transient_local=durability == "transient_local", depth=2000)
        self._impacts = self.create_subscription(
            message_class(interfaces.IMPACTS.type),
            "impacts",
            self._on_impact,
            qos_profile(events),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_mismatch),
            raw=True,
        )
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetState, "~/set_state", self._on_set_state)
        self._timer = self.create_timer(1.0 / self._rate, self._on_timer)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._takes_samples = system.live is not None or bool(self._sensors.topics)
        if self._takes_samples:
            self.create_timer(_POLL_PERIOD, self._apply_events, clock=steady)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        backwards = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jump = self.get_clock().create_jump_callback(
            backwards, post_callback=self._on_clock_back
        )
        parameters.on_change(self, parameters.OBSERVER, partial(_check_lag, options), self._change)
        known = f", epoch {options.epoch} ns" if options.epoch else ""
        live = f" and samples of {', '.join(self._inputs.ages(0))}" if system.live else ""
        topics = f" and publishers of {', '.join(t)}" if (t := self._sensors.topics) else ""
        introduce(
            self,
            f"model {system.name}, law {options.law}{known}",
            f"events on impacts{live}{topics}",
        )

    @cached_property
    def default_callback_group(self) -> EventsSeldom:
        """Of all that the node waits for."""
        return EventsSeldom()

    def _sensor_intake(self, values: parameters.Values, options: Options) -> SensorIntake:
        """The subscriptions to sensors, made as their topics appear."""
        intake = SensorIntake(
            self,
            self._observer,
            clock=(self._now, options.history, values.number("future")),
            reliable=values.text("measurements_reliability") == "reliable",
            verdicts=values.text("measurement_verdicts"),
            on_samples=self._on_samples,
            on_problem=self._lines.error,
        )
        names = ", ".join(each.name for each in self._observer.samples.sensors)
        if names:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(_DISCOVERY_PERIOD, intake.discover, clock=steady)
        if names and not self._observer.law.uses_measurements:
            line = f"{options.law} uses no measurements: {names} change nothing"
            self.get_logger().warning(printable(line))
        return intake

    def _publisher(self, interface: interfaces.Interface) -> Publisher:
        topic = f"~/{interface.name.rpartition('/')[2]}"
        return self.create_publisher(
            message_class(interface.type), topic, qos_profile(interface.quality)
        )

    def _forget_estimates(self) -> None:
        """Return to the state before the first estimate."""
        self._last_sample: int | None = None
        self._last_stamp = 0
        self._last: Estimate | None = None
        self._is_held = False
        self._misfit_news = MisfitNews()

    def _change(self, values: Mapping[str, Value]) -> None:
        """Use parameters that were set while the node runs; stamps never go back."""
        given = {name: float(str(value)) for name, value in values.items()}
        self._lag = from_seconds(given.get("lag", self._lag / NS_PER_S))
        self._observer.agreed = given.get("agreed", self._observer.agreed)
        if (rate := given.get("rate", self._rate)) == self._rate:
            return
        self._rate = rate
        if self._last_sample is not None:
            epoch = self._observer.epoch or self._observer.start or 0
            self._last_sample = math.floor(seconds_between(epoch, self._last_stamp) * rate)
        self.destroy_timer(self._timer)
        self._timer = self.create_timer(1.0 / rate, self._on_timer)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_impact(self, message: bytes) -> None:
        """Take an event and apply it; then those that wait behind it."""
        self._take(message)
        self._apply_events()
        is_done = not self._intake.is_busy
        self._take_waiting()
        if is_done and self._intake.is_busy:
            self._apply_events()

    def _take(self, message: bytes) -> None:
        if problem := self._intake.add(message):
            self._diagnostics.note_refusal(problem)
            self._lines.error(f"impacts: {problem}")

    def _take_waiting(self) -> None:
        """Take the events that have arrived already, if there is room."""
        for message in slice_of_waiting(self._impacts, self._intake.room):
            self._take(message)

    def _apply_events(self) -> None:
        """Apply events for some milliseconds, and go on after others had their turn."""
        more = self._take_samples()
        self._apply(self._intake.slice())
        if more or self._intake.is_busy:
            self._go_on.trigger()

    def _take_samples(self) -> bool:
        """Take the samples of inputs and sensors that have arrived; whether more may wait."""
        if not self._takes_samples:
            return False
        more = self._inputs.take_waiting()
        return self._sensors.take_waiting() or more

    def _apply(self, received: Iterable[tuple[ImpactEvent, tuple[Verdict, ...]]]) -> None:
        """Publish the estimate that events correct, then their verdicts."""
        pending, is_corrected = [], False
        for event, verdicts in received:
            if (restarts := self._observer.restarts) > self._restarts:
                self._restarts, is_corrected = restarts, False
                self._forget_estimates()
                self._lines.warning(
                    f"the plant restarted: episode {event.episode}, epoch {event.epoch} ns"
                )
            late = event.stamp <= self._last_stamp
            is_corrected |= late and any(each.ruling is Ruling.APPLIED for each in verdicts)
            pending.append((event, verdicts, late))
        if is_corrected:
            self._publish(self._last_stamp)
            self._counts["corrected"] += 1
        for event, verdicts, late in pending:
            self._publish_verdicts(event, self._with_lag_reason(verdicts) if late else verdicts)
        if self._observer.samples.sensors:
            self._use_waiting_samples()

    def _use_waiting_samples(self) -> None:
        """Use samples that came while events were inserted, and publish what became of them."""
        waiting = self._observer.samples.waiting
        since = min((each.stamp for each in waiting), default=MAX_STAMP)
        self._on_samples(since, self._observer.measure(()))

    def _correct_by_samples(self, stamp: int) -> None:
        """Publish the last estimate again where a sample at ``stamp`` (ns) came after it."""
        if self._last is not None and stamp <= self._last_stamp:
            self._publish(self._last_stamp)
            self._counts["corrected"] += 1

    def _on_samples(self, stamp: int, revised: Sequence[Verdict]) -> None:
        """Publish what samples from ``stamp`` (ns) on change, and what became of them."""
        self._correct_by_samples(stamp)
        for each in revised:
            self._diagnostics.count(each, large=each.innovation > LARGEST_INNOVATION)
            self._log(each)
            self._verdicts.publish(self._make.verdict(each, 0.0))
        published = {
            each.name
            for each in self._observer.samples.sensors
            if self._sensors.is_published(each.index)
        }
        for verdict in self._observer.samples.take():
            if verdict.name in published:
                self._samples.publish(self._make.measurement_verdict(verdict))

    def _publish_verdicts(self, event: ImpactEvent, verdicts: Iterable[Verdict]) -> None:
        latency = max(seconds_between(event.stamp, self._now()), 0.0)
        for verdict in verdicts:
            if verdict.ruling is Ruling.APPLIED:
                self._diagnostics.note_latency(latency)
            self._diagnostics.count(verdict, large=verdict.innovation > LARGEST_INNOVATION)
            self._log(verdict)
            self._verdicts.publish(self._make.verdict(verdict, latency))

    def _with_lag_reason(self, verdicts: tuple[Verdict, ...]) -> tuple[Verdict, ...]:
        """``verdicts`` on a late event; where there is a lag, lateness is a reason."""
        first, *others = verdicts
        if not self._lag or first.ruling is not Ruling.APPLIED:
            return verdicts
        later = "later than lag: the last estimate is published again"
        return (first._replace(reason="; ".join(filter(None, (first.reason, later)))), *others)

    def _log(self, verdict: Verdict) -> None:
        """Log a verdict other than a plain application."""
        if verdict.ruling is Ruling.APPLIED and not verdict.reason:
            return
        ruling, reason = verdict.ruling.name.lower(), verdict.reason
        short = reason if len(reason) <= _LONGEST else f"{reason[:_LONGEST]} ..."
        line = f"event {verdict.sequence} {verdict.contact}: {ruling}, {short}"
        first = re.split(r"[:;,]", re.sub(r"[\d.e+-]*\d", "N", reason), maxsplit=1)[0]
        kind = f"{verdict.contact}: {ruling}, {first}"
        if verdict.ruling is not Ruling.APPLIED:
            self._lines.warning(line, kind)
        else:
            self._lines.info(line, kind)

    def _on_timer(self) -> None:
        """Publish the estimates that are due, and take events that have arrived meanwhile."""
        more = self._take_samples()
        self._publish_due()
        self._take_waiting()  # sooner than by the executor, which waits again first
        if more or not self._intake.is_empty:
            self._apply_events()

    def _publish_due(self) -> None:
        """Publish the estimates that are at least ``lag`` old."""
        start, now = self._observer.start, self._now() - self._lag
        if start is None or now < start:
            return
        epoch = self._observer.epoch or start
        newest = int(seconds_between(epoch, now) * self._rate) + 1
        beginning = math.ceil(seconds_between(epoch, start) * self._rate)
        last = beginning - 1 if self._last_sample is None else self._last_sample
        simulated = newest - last >= _BACKLOG and self.get_clock().ros_time_is_active
        first = max(last + 1, newest - (_SIMULATED_BACKLOG if simulated else _BACKLOG))
        due = [*range(first, newest + 1)]
        # The first estimate is never skipped: ratios of V refer to it.
        if self._last_sample is None and beginning < first:
            due.insert(0, beginning)
        for k in due:
            stamp = epoch + round(k * NS_PER_S / self._rate)
            if stamp > now:
                break
            if self._last_sample is not None:
                self._counts["passed_over"] += k - self._last_sample - 1
            self._last_sample = k
            if stamp < start:
                self._counts["passed_over"] += 1
            else:
                self._last_stamp = self._intake.passed = stamp
                self._publish(stamp)
            if simulated and (k - first) % _BACKLOG == _BACKLOG - 1:
                self._states.wait_for_all_acked(_ACKNOWLEDGE_TIMEOUT)
                self._joint_states.wait_for_all_acked(_ACKNOWLEDGE_TIMEOUT)

    def _publish(self, stamp: int) -> None:
        """Publish the estimate at ``stamp`` (ns)."""
        estimate = self._observer.estimate(stamp)
        messages = self._serializer.messages(estimate)
        self._states.publish(next(messages))
        self._joint_states.publish(next(messages))
        if estimate.bound != (-1.0 if self._last is None else self._last.bound):
            self._bounds.publish(self._make.bound(estimate))
        if news := self._misfit_news.of(estimate):
            if estimate.misfit:
                self._lines.warning(news, "misfit")
            else:
                self._lines.info(news, "end of a misfit")
        self._warn_of_held_forces(stamp)
        self._last = estimate

    def _warn_of_held_forces(self, stamp: int) -> None:
        epoch = self._observer.epoch
        held = self._observer.system.held_force((stamp - epoch) / NS_PER_S) if epoch else ""
        if held and not self._is_held:
            self.get_logger().warning(printable(held))
        self._is_held = bool(held)

    def _on_clock_back(self, _: TimeJump) -> None:
        """Restart the observer after a backward jump of the clock, as of a looped bag."""
        self._intake.clear()
        self._take_samples()
        self._inputs.clear()
        self._sensors.clear()
        if self._observer.live is not None:
            self._observer.live.clear()
        self._observer.restart("the clock jumped back")
        self._forget_estimates()
        self._counts["clock_jumps"] += 1

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Set the initial state, at the last estimate."""
        response.success, response.message = self._set_state(*self._initial)
        return response

    def _on_set_state(
        self, request: SetState.Request, response: SetState.Response
    ) -> SetState.Response:
        """Set a state, at the last estimate."""
        response.success, response.message = self._set_state(
            request.position, request.velocity, request.covariance
        )
        return response

    def _set_state(
        self, position: ArrayLike, velocity: ArrayLike, covariance: Sequence[float] = ()
    ) -> tuple[bool, str]:
        """Set the state at the last estimate's stamp, or as the initial one before that.

        Later events act on it; with a lag these may include events received already.
        """
        self._take_samples()
        self._apply(self._intake.finish())
        try:
            given = covariance if len(covariance) else None
            self._observer.set_state(self._last_stamp, position, velocity, given)
        except ImpactObserverError as error:
            return False, str(error)
        start = self._observer.start
        return True, "holds at the start" if start is None else f"holds at {start} ns"

    def _on_mismatch(self, info: QoSRequestedIncompatibleQoSInfo) -> None:
        """A publisher of impacts can never connect."""
        self._diagnostics.mismatch = (
            f"a publisher of impacts offers an incompatible quality of service"
            f" ({info.last_policy_kind}); set events_durability: volatile"
        )
        self.get_logger().error(printable(self._diagnostics.mismatch))

    def _publish_diagnostics(self) -> None:
        """Publish counts and faults to ``/diagnostics``."""
        self._lines.restore()
        if news := self._diagnostics.note_backlog(*self._intake.backlog()):
            (self._lines.warning if self._diagnostics.behind else self._lines.info)(news)
        if news := self._diagnostics.note_epoch():
            self._lines.warning(news)
        now = self._now()
        self._observer.forget_silence(now)
        status = [self._diagnostics.status(now, self._last), *self._sensors.statuses(now)]
        array = DiagnosticArray(status=status)
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics_topic.publish(array)


def _check_lag(options: Options, values: Mapping[str, Value]) -> None:
    """Raise unless the lag among some parameters is within the history."""
    lag = float(str(values.get("lag", 0.0)))
    if lag > options.history:
        found = f"parameter lag: {lag:g} found"
        raise UsageError(f"{found}; expected at most history, {options.history:g}")
