# SPDX-License-Identifier: Apache-2.0
"""The observer node: impact events in, the estimated state out.

An event passes through ``_on_impacts``, ``EventIntake``, ``_apply`` and ``_publish``.
"""

import re
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticStatus
from impact_observer_msgs.srv import SetState
from numpy.typing import ArrayLike
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.events import Ruling, Verdict
from impact_observer.io import interfaces
from impact_observer.io.live_inputs import efforts_on
from impact_observer.io.messages import AnyMessage
from impact_observer.model import read_model
from impact_observer.model.measurements_file import read_measurements
from impact_observer.observer import initial_state, make_observer
from impact_observer.observer.misfit import EXPLAINED
from impact_observer.options import Options, Value
from impact_observer.ros import parameters
from impact_observer.ros.base_node import FOLLOWING, BaseNode, Receiver, without_numbers
from impact_observer.ros.estimate_times import EstimateTimes
from impact_observer.ros.event_intake import MOST_WAITING, EventIntake, Judged
from impact_observer.ros.live_intake import LiveIntake
from impact_observer.ros.observer_diagnostics import ObserverDiagnostics
from impact_observer.ros.sensor_intake import SensorIntake
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between
from impact_observer.states import Estimate
from impact_observer.turns import turns_given_to

_DISCOVERY_PERIOD = 0.1
"""How often the graph is searched for the topics of sensors, s."""
_POLL_PERIOD = 0.05
"""How often the messages of a robot's sensors are taken, s; they are before estimates, too."""
_TURN = 0.05
"""How long an event may take to be applied until predictions are published meanwhile, s.

The same processor time is for the predictions that are due together.
"""
_LARGE_INNOVATION = 6.0
"""Innovation, in standard deviations, up to which the declared uncertainty explains an event."""
_BRIEF = 0.01
"""Time that estimates may take without a rest after them, s."""
_LONGEST_REST = 0.25
"""Longest time without an estimate after slow ones, s."""
_LONGEST = 100
"""Characters of a reason that are logged; the published verdict has all of them."""


class ObserverNode(BaseNode):
    """Runs one observer; every estimate is stamped ``epoch + k / rate``.

    Estimates are published when the clock is ``lag`` past their stamps. If an event arrives after
    an estimate that should contain the event, that estimate is corrected and published again at
    once. The node never subscribes to the true state.

    Attributes:
        observer: the observer.
        intake: the events that wait for the observer.
    """

    def __init__(self) -> None:
        super().__init__("observer", parameters.OBSERVER)
        parameters.on_change(self, parameters.OBSERVER, self._check_lag, self._change)

    def configure(self) -> None:
        """Implement ``BaseNode``."""
        values, options = self.values, self.values.options()
        self._check_lag({"lag": values.number("lag")})
        model = self.with_urdf_of_topic(read_model(values.text("model")))
        sensors = read_measurements(values.text("measurements"))
        self.observer = make_observer(model, options, measurements=sensors)
        for doubt in model.doubts:
            self.lines.warning(doubt)
        self._say_torques()
        self._sensor_topics = {self.resolve_topic_name(each.topic) for each in sensors}
        system = self.observer.system
        self._initial = initial_state(options.initial_state, system)
        self._names = system.coordinates
        self._restarts = 0
        self._lag = from_seconds(values.number("lag"))
        self._times = EstimateTimes(values.number("rate"))
        self._forget_estimates()
        self._states = self.publisher(interfaces.OBSERVER_STATES)
        self._joint_states = self.publisher(interfaces.OBSERVER_JOINT_STATES)
        self._verdicts = self.publisher(interfaces.OBSERVER_VERDICTS)
        self._bounds = self.publisher(interfaces.OBSERVER_BOUND)
        self._samples = self.publisher(interfaces.OBSERVER_MEASUREMENTS)
        self._diagnostics = ObserverDiagnostics(self.status, self.observer)
        self._counts: Counter[str] = self._diagnostics.counts
        self._inputs = self._live_intake(options)
        self._diagnostics.inputs = self._inputs
        self._diagnostics.input_timeout = values.number("input_timeout")
        self._sensors = self._sensor_intake(options)
        future = values.number("future")
        self.intake = EventIntake(self.observer, self.stamp_now, future, self._counts)
        self._go_on = self.create_guard_condition(self._apply_events)
        name = interfaces.IMPACTS.name
        self._impacts = Receiver(self, name, self._on_impacts, event_callbacks=FOLLOWING)
        self._impacts.connect(interfaces.IMPACT_EVENT, interfaces.EVENTS)
        self.repeat(_DISCOVERY_PERIOD, self._discover)
        self._next_turn = self._rests_until = 0.0
        self._is_turn = self._went_back = self._is_due = False
        self._waits_for: tuple[str, ...] = ()
        self.serve(Trigger, "~/reset", self._on_reset)
        self.serve(SetState, "~/set_state", self._on_set_state)
        self._timer = self.create_timer(1.0 / self._times.rate, self._on_timer)
        self.diagnose(self._statuses)
        self.when_clock_jumps_back(self._on_clock_back)
        known = f", epoch {options.epoch} ns" if options.epoch else ""
        live = f" and samples of {', '.join(self._inputs.ages(0))}" if system.live else ""
        topics = f" and publishers of {', '.join(t)}" if (t := self._sensors.topics) else ""
        self.introduce(
            f"model {system.name}, law {options.law}{known}",
            f"events on impacts{live}{topics}",
        )

    def _live_intake(self, options: Options) -> LiveIntake:
        """The subscriptions to live forces and grounds, and to a drive that says the epoch."""
        robot = self.observer.robot
        needs_epoch = self.observer.system.depends_on_time and not (options.epoch or robot)
        self._efforts = None
        if robot is not None and robot.description.forces is not None:
            self._efforts = efforts_on(self.resolve_topic_name(robot.description.forces[0]))
        return LiveIntake(
            self,
            self.observer.live,
            now=self.stamp_now,
            future=self.values.number("future"),
            on_problem=self.lines.error,
            on_samples=self._correct_from,
            on_pulse=self.observer.take_pulse if needs_epoch else None,
            efforts=self._efforts,
            subscribes=self._efforts is None or self._efforts.name not in self._sensor_topics,
        )

    def _sensor_intake(self, options: Options) -> SensorIntake:
        """The subscriptions to sensors, made as their topics appear."""
        intake = SensorIntake(
            self,
            self.observer,
            now=self.stamp_now,
            past=options.history,
            future=self.values.number("future"),
            on_samples=self._on_samples,
            on_problem=self.lines.error,
            before={}
            if self._efforts is None
            else {self._efforts.name: self._inputs.take_efforts},
        )
        names = ", ".join(each.name for each in self.observer.samples.sensors)
        if names and self.observer.robot is not None:
            self.repeat(_POLL_PERIOD, intake.take_arrived)
        if names and not self.observer.law.uses_measurements:
            self.lines.warning(f"{options.law} uses no measurements: {names} change nothing")
        return intake

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish from now on, if each sensor has had a sample or need not have had one."""
        wanted = self.values.flag("wait_for_measurements")
        if missing := self._sensors.without_sample() if wanted else ():
            return self._wait_for(missing)
        self._waits_for = ()
        return super().on_activate(state)

    def _wait_for(self, missing: tuple[str, ...]) -> TransitionCallbackReturn:
        """Stay inactive, and name the ``missing`` sensors."""
        line = f"no measurement yet of {', '.join(missing)}"
        if self.values.flag("autostart"):
            self._waits_for = missing
            self.lines.warning(f"not active: {line}")
        return self.refuse(UsageError(line))

    def _discover(self) -> None:
        """Look at all publishers; try again to be active once a sensor has had a sample."""
        if self._impacts.look():
            self._follow_publishers()
        self._sensors.discover()
        if self._waits_for and self._sensors.without_sample() != self._waits_for:
            self.trigger_activate()

    def _follow_publishers(self) -> None:
        """Ask for past events if all publishers of impacts keep these; report the others."""
        receiver, fault = self._impacts, ""
        if (offer := receiver.offers.get(interfaces.IMPACT_EVENT)) is not None:
            wanted = replace(interfaces.EVENTS, transient_local=offer.transient_local)
            receiver.connect(interfaces.IMPACT_EVENT, wanted)
            if not offer.reliable:
                fault = f"a publisher of {receiver.topic} is best effort; expected reliable"
        self._diagnostics.mismatch = receiver.fault if receiver.offers and not fault else fault
        if self._diagnostics.mismatch:
            self.lines.error(self._diagnostics.mismatch)

    @property
    def _last_stamp(self) -> int:
        """Stamp of the last estimate that was published, ns; 0 before the first one."""
        return self._last.stamp if self._last is not None else 0

    def _say_torques(self) -> None:
        """Log what the observer of a robot does not know of torques, or not from the model."""
        robot = self.observer.robot
        if robot is not None and self.observer.law.has_covariance:
            say = {"warning": self.lines.warning, "note": self.lines.info}
            for kind, text in robot.description.torque_remarks:
                say[kind](text)

    def _forget_estimates(self) -> None:
        """Return to the state before the first estimate."""
        self._times.restart()
        self._last: Estimate | None = None
        self._is_held = False

    def _check_lag(self, values: Mapping[str, Value]) -> None:
        """Raise a UsageError if the lag in ``values`` is longer than the history."""
        lag, most = float(str(values.get("lag", 0.0))), self.values.number("history")
        if lag > most:
            raise UsageError(f"parameter lag: {lag:g} found; expected at most history, {most:g}")

    def _change(self, values: Mapping[str, Value]) -> None:
        """Use a rate or lag that was set while the node runs; stamps never go back."""
        self.values.change(values)
        if not self.is_configured:
            return
        self._lag = from_seconds(self.values.number("lag"))
        if (rate := self.values.number("rate")) != self._times.rate:
            epoch = self.observer.epoch or self.observer.start or 0
            self._times.change_rate(rate, epoch, self._last_stamp)
            self.destroy_timer(self._timer)
            self._timer = self.create_timer(1.0 / rate, self._on_timer)

    def _on_impacts(self, messages: Sequence[AnyMessage]) -> None:
        """Take the messages that wait, and apply their events, after samples that have come."""
        self._take_impacts(messages)
        self._sensors.take_arrived()
        self._apply_events()

    def _take_impacts(self, messages: Iterable[AnyMessage]) -> None:
        for message in messages:
            if problem := self.intake.take_message(message):
                self._diagnostics.note_refusal(problem)
                self.lines.error(f"impacts: {problem}")

    def _apply_events(self) -> None:
        """Apply events for some milliseconds, and go on after others had their turn."""
        self._apply(self.intake.apply_waiting())
        if self._went_back:
            self._went_back = False
            self._on_clock_back()
        if self.intake.is_busy:
            self._go_on.trigger()

    def _apply(self, received: Iterable[Judged]) -> None:
        """Publish the estimate that events correct, then their verdicts."""
        pending, is_corrected = [], False
        self._next_turn = time.monotonic() + _TURN
        with turns_given_to(self._meanwhile):
            for event, verdicts in received:
                if (restarts := self.observer.restarts) > self._restarts:
                    self._restarts, is_corrected = restarts, False
                    self._forget_estimates()
                    self.lines.warning(
                        f"the plant restarted: episode {event.episode}, epoch {event.epoch} ns"
                    )
                late = event.stamp <= self._last_stamp
                is_corrected |= late and any(each.ruling is Ruling.APPLIED for each in verdicts)
                pending.append((event, verdicts, late))
        if is_corrected:
            self._correct_from(0)
        for event, verdicts, late in pending:
            latency = max(seconds_between(event.stamp, self.stamp_now()), 0.0)
            if any(each.ruling is Ruling.APPLIED for each in verdicts):
                self._diagnostics.note_latency(latency)
            self._publish_verdicts(self._with_lag_reason(verdicts) if late else verdicts, latency)
        if self.observer.samples.sensors:  # samples that came while events were inserted
            self._sensors.use_waiting()

    def _meanwhile(self) -> None:
        """Take messages and publish predictions while an event takes long to be applied."""
        begin = time.monotonic()
        if begin < self._next_turn:
            return
        self._is_turn = True
        self.take_clock()
        self._take_impacts(self._impacts.waiting(MOST_WAITING))
        self._publish_due()
        self._is_turn = False
        end = time.monotonic()
        self._next_turn = end + max(_TURN, end - begin)  # at least half of the time is for events

    def _correct_from(self, stamp: int) -> None:
        """Publish the last estimate again if knowledge has changed from ``stamp`` (ns) on."""
        if self._last is not None and stamp <= self._last_stamp:
            self._publish(self._last_stamp)
            self._counts["corrected"] += 1

    def _on_samples(self, stamp: int, revised: Sequence[Verdict]) -> None:
        """Publish the estimates after ``stamp`` (ns) that samples change, and verdicts."""
        if not self._is_due and time.monotonic() >= self._rests_until:  # else the next has them
            self._correct_from(stamp)
        self._publish_verdicts(revised, latency=0.0)
        published = {
            each.name
            for each in self.observer.samples.sensors
            if self._sensors.is_published(each.index)
        }
        for verdict in self.observer.samples.take():
            if verdict.name in published:
                self.publish(self._samples, self.make.measurement_verdict, verdict)

    def _publish_verdicts(self, verdicts: Iterable[Verdict], latency: float) -> None:
        for verdict in verdicts:
            self._diagnostics.count(verdict, large=verdict.innovation > _LARGE_INNOVATION)
            self._log(verdict)
            self.publish(self._verdicts, self.make.verdict, verdict, latency)

    def _with_lag_reason(self, verdicts: tuple[Verdict, ...]) -> tuple[Verdict, ...]:
        """``verdicts`` on an event that is late in spite of a lag, with the lag as reason."""
        first, *others = verdicts
        if not self._lag or first.ruling is not Ruling.APPLIED:
            return verdicts
        later = "later than lag: the last estimate is published again"
        return (first._replace(reason="; ".join(filter(None, (first.reason, later)))), *others)

    def _log(self, verdict: Verdict) -> None:
        """Log a verdict, but not that an event was applied without a remark."""
        if verdict.ruling is Ruling.APPLIED and not verdict.reason:
            return
        ruling, reason = verdict.ruling.name.lower(), verdict.reason
        short = reason if len(reason) <= _LONGEST else f"{reason[:_LONGEST]} ..."
        line = f"event {verdict.sequence} {verdict.contact}: {ruling}, {short}"
        first = re.split(r"[:;,]", without_numbers(reason), maxsplit=1)[0]
        kind = f"{verdict.contact}: {ruling}, {first}"
        if verdict.ruling is not Ruling.APPLIED:
            self.lines.warning(line, kind)
        else:
            self.lines.info(line, kind)

    def _on_timer(self) -> None:
        """Use inputs that were ahead of the clock, and publish the estimates that are due."""
        self._inputs.take_what_was_ahead()
        self._sensors.take_what_was_ahead()
        self._is_due = True
        self._sensors.take_arrived()
        self._is_due = False
        self._publish_due()
        if not self.intake.is_empty:
            self._apply_events()

    def _publish_due(self) -> None:
        """Publish the estimates that are at least ``lag`` old.

        Estimates that are slow leave half of the time to what waits: long predictions would keep
        samples waiting, which makes the next predictions longer.
        """
        start, now = self.observer.start, self.stamp_now() - self._lag
        begin = time.monotonic()
        if start is None or now < start or begin < self._rests_until:
            return
        due = self._times.due(self.observer.epoch or start, start, now)
        self._counts["passed_over"] += due.skipped
        end = time.thread_time() + _TURN
        for i, stamp in enumerate(due.stamps, start=1):
            if time.thread_time() < end or i in {1, len(due.stamps)}:
                self._publish(stamp)
            else:
                self._counts["passed_over"] += 1
        spent = time.monotonic() - begin
        if spent > max(1.0 / self._times.rate, _BRIEF):
            self._rests_until = begin + spent + min(spent, _LONGEST_REST)

    def _publish(self, stamp: int) -> None:
        """Publish the estimate at ``stamp`` (ns)."""
        try:
            estimate, last = self.observer.estimate(stamp), self._last
        except ImpactObserverError as error:
            self._diagnostics.failure = f"no estimate: {error}"
            self.lines.error(self._diagnostics.failure)
            return
        self._diagnostics.failure = ""
        if self.intake.is_behind:
            estimate = replace(estimate, synchronized=False)
        self._last = estimate
        state = self.publish(self._states, self.make.estimate, estimate, self._names)
        if state is not None:
            self.publish(self._joint_states, self.make.joint_state_of, state)
        if estimate.bound != (-1.0 if last is None else last.bound):
            self.publish(self._bounds, self.make.bound, estimate)
        if estimate.misfit != (last.misfit if last is not None else ""):
            if estimate.misfit:
                self.lines.warning(estimate.misfit)
            else:
                self.lines.info(EXPLAINED)
        self._warn_of_held_forces(stamp)

    def _warn_of_held_forces(self, stamp: int) -> None:
        """Warn once of sampled forces that are held after their last sample."""
        epoch = self.observer.epoch
        held = self.observer.system.held_force((stamp - epoch) / NS_PER_S) if epoch else ""
        if held and not self._is_held:
            self.lines.warning(held)
        self._is_held = bool(held)

    def _on_clock_back(self) -> None:
        """Restart the observer after a backward jump of the clock, as of a looped bag."""
        if self._is_turn:  # once the event is applied
            self._went_back = True
            return
        self.intake.clear()
        self._inputs.clear()
        self._sensors.clear()
        if self.observer.live is not None:
            self.observer.live.clear()
        self.observer.restart("the clock jumped back")
        self._forget_estimates()
        self._counts["clock_jumps"] += 1

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Set the initial state, at the last estimate; a robot may start at its encoders again."""
        if self.observer.encoders is None:
            response.success, response.message = self._set_state(*self._initial)
            return response
        self._apply(self.intake.finish())
        self.observer.restart("a reset was asked for")
        self._forget_estimates()
        response.success, response.message = True, "holds at the next samples of the encoders"
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

        Later events act on the state; with a lag these may include events received already.
        """
        self._apply(self.intake.finish())
        try:
            given = covariance if len(covariance) else None
            self.observer.set_state(self._last_stamp, position, velocity, given)
        except ImpactObserverError as error:
            return False, str(error)
        start = self.observer.start
        return True, "holds at the start" if start is None else f"holds at {start} ns"

    def _statuses(self) -> list[DiagnosticStatus]:
        """Counts and faults of the observer, and of each sensor."""
        if behind := self._diagnostics.note_backlog(*self.intake.backlog()):
            self.lines.warning(behind)
        now = self.stamp_now()
        try:
            self.observer.forget_silence(now)
        except ImpactObserverError as error:
            self.lines.error(f"samples of inputs: {error}")
        return [self._diagnostics.status(now, self._last), *self._sensors.statuses(now)]
