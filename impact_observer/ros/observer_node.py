# SPDX-License-Identifier: Apache-2.0
"""The observer node: impact events in, the estimated state out.

An event passes through ``Receiver``, ``_on_impacts``, ``EventIntake``, ``_apply``, ``_publish``.
"""

import math
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
from impact_observer.events import ImpactEvent, Ruling, Verdict
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage, MessageError, read_event, read_pulse
from impact_observer.model import read_model
from impact_observer.model.measurement import read_measurements
from impact_observer.observer import initial_state, make_observer
from impact_observer.observer.verdicts import Judged
from impact_observer.options import OBSERVER_OPTIONS, Options, Value
from impact_observer.ros import parameters
from impact_observer.ros.base_node import BaseNode, without_numbers
from impact_observer.ros.event_intake import EventIntake
from impact_observer.ros.intake import Receiver
from impact_observer.ros.observer_diagnostics import ObserverDiagnostics
from impact_observer.ros.sample_intake import SampleIntake, silence
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between
from impact_observer.states import Estimate

MOST_DUE = 20
"""Estimates that are published together, such as after a jump of simulated time."""
_POLL_PERIOD = 0.05
"""How often samples are taken, s; they are before estimates and events, too."""
_TURN = 0.05
"""Processor time for the predictions that are due together, s."""
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
        values = self.values
        self._check_lag(values)
        options = Options(**{each.name: values[each.name] for each in OBSERVER_OPTIONS})
        model = self.with_urdf_of_topic(read_model(values["model"]))
        sensors = read_measurements(values["measurements"])
        self.observer = make_observer(model, options, measurements=sensors)
        for doubt in model.doubts:
            self.lines.warning(doubt)
        system, robot = self.observer.system, self.observer.robot
        if robot is not None and self.observer.law.has_covariance:
            for kind, text in robot.description.torque_remarks:
                (self.lines.warning if kind == "warning" else self.lines.info)(text)
        self._initial = initial_state(options.initial_state, system)
        self._restarts = 0
        self._forget_estimates()
        self._states = self.publisher(interfaces.OBSERVER_STATES)
        self._joint_states = self.publisher(interfaces.OBSERVER_JOINT_STATES)
        self._verdicts = self.publisher(interfaces.OBSERVER_VERDICTS)
        self._estimated_impacts = self.publisher(interfaces.OBSERVER_IMPACTS)
        self._bounds = self.publisher(interfaces.OBSERVER_BOUND)
        self._judged_samples = self.publisher(interfaces.OBSERVER_MEASUREMENTS)
        self._diagnostics = ObserverDiagnostics(self.status, self.observer)
        self._counts: Counter[str] = self._diagnostics.counts
        self.intake = EventIntake(self.observer, self._counts)
        self._go_on = self.create_guard_condition(self._apply_events)
        self._receive()
        self._rests_until = 0.0
        self._is_due = False
        self._waits_for: tuple[str, ...] = ()
        self.serve(Trigger, "~/reset", self._on_reset)
        self.serve(SetState, "~/set_state", self._on_set_state)
        self._timer = self.create_timer(1.0 / values["rate"], self._on_timer)
        self.when_clock_jumps_back(self._on_clock_back)
        known = f", epoch {options.epoch} ns" if options.epoch else ""
        topics = f" and samples on {', '.join(t)}" if (t := self._samples.topics) else ""
        self.introduce(
            f"model {system.name}, law {options.law}{known}", f"events on impacts{topics}"
        )

    def _receive(self) -> None:
        """Receive impacts, samples, and where nothing else says the epoch, pulses of a drive."""
        observer, names = self.observer, [s.name for s in self.observer.samples.sensors]
        self._impacts = Receiver(
            self,
            interfaces.IMPACTS,
            self._on_impacts,
            read=self._read_event,
            stamp=lambda event: max(event.stamp, event.epoch),
            on_ahead=self._on_ahead,
        )
        self._samples = SampleIntake(self, observer, self._on_samples)
        if self._samples.topics:
            self.repeat(_POLL_PERIOD, self._samples.take_arrived)
        if names and not observer.law.uses_measurements:
            line = f"uses no measurements: {', '.join(names)} change nothing"
            self.lines.warning(f"{observer.law.name} {line}")
        self._pulses: Receiver[int] | None = None
        if observer.system.depends_on_time and not (observer.given_epoch or observer.robot):
            self._pulses = Receiver(
                self,
                interfaces.PHASE_REFERENCE,
                self._on_pulses,
                read=lambda message, _: [read_pulse(message)],
                stamp=int,
            )

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish from now on, if each sensor has had a sample or need not have had one."""
        wanted = self.values["wait_for_measurements"]
        missing = self._samples.without_sample() if wanted else ()
        self._waits_for = missing if self.values["autostart"] else ()
        if not missing:
            return super().on_activate(state)
        line = f"no measurement yet of {', '.join(missing)}"
        if self._waits_for:
            self.lines.warning(f"not active: {line}")
        return self.refuse(UsageError(line))

    @property
    def _last_stamp(self) -> int:
        """Stamp of the last estimate that was published, ns; 0 before the first one."""
        return self._last.stamp if self._last is not None else 0

    def _forget_estimates(self) -> None:
        """Return to the state before the first estimate."""
        self._last: Estimate | None = None
        self._due_until: int | None = None
        self._is_held = False

    def _check_lag(self, values: Mapping[str, Value]) -> None:
        """Raise a UsageError if the lag in ``values`` is longer than the history."""
        lag, most = float(str(values.get("lag", 0.0))), self.values["history"]
        if lag > most:
            raise UsageError(f"parameter lag: {lag:g} found; expected at most history, {most:g}")

    def _change(self, values: Mapping[str, Value]) -> None:
        """Use a rate or lag that was set while the node runs; stamps never go back."""
        self.values = {**self.values, **values}
        if self.is_configured and "rate" in values:
            self.destroy_timer(self._timer)
            self._timer = self.create_timer(1.0 / self.values["rate"], self._on_timer)

    def _read_event(self, message: AnyMessage, _: object) -> list[ImpactEvent]:
        """The event in a message; one that is invalid is counted."""
        try:
            return [read_event(message)]
        except MessageError as error:
            self._counts["invalid messages"] += 1
            self._diagnostics.note_refusal(str(error))
            raise

    def _on_ahead(self, event: ImpactEvent, why: str) -> None:
        """Reject an event until the clock is near its stamp and its epoch."""
        self._counts["from the future"] += 1
        if event.epoch > event.stamp:
            why = why.replace("stamped", "its epoch is")
        self.intake.reject(event, why)
        self._go_on.trigger()

    def _on_impacts(self, events: Sequence[ImpactEvent]) -> None:
        """Apply events, after samples that have come."""
        for each in events:
            self.intake.take(each)
        self._samples.take_arrived()
        self._apply_events()

    def _on_pulses(self, pulses: Sequence[int]) -> None:
        """Take the pulses of a drive; the first one is the epoch."""
        for each in pulses:
            self._samples.counts["samples"] += 1
            self.observer.take_pulse(each)

    def _apply_events(self) -> None:
        """Apply events for some milliseconds, and go on after others had their turn."""
        for each in self._impacts.no_longer_ahead():
            self.intake.take(each, was_ahead=True)
        if not self.intake.is_busy:
            return
        self._apply(self.intake.apply_waiting())
        if self.intake.is_busy:
            self._go_on.trigger()

    def _apply(self, received: Iterable[Judged]) -> None:
        """Publish the estimate that events correct, then their verdicts."""
        pending, is_corrected = [], False
        for event, verdicts in received:
            if (restarts := self.observer.restarts) > self._restarts:
                self._restarts, is_corrected = restarts, False
                self._forget_estimates()
                self.lines.warning(
                    f"the plant restarted: episode {event.episode}, epoch {event.epoch} ns"
                )
            is_applied = any(each.ruling is Ruling.APPLIED for each in verdicts)
            is_corrected |= is_applied and event.stamp <= self._last_stamp
            pending.append((event, verdicts))
        if is_corrected:
            self._correct_from(0)
        for event, verdicts in pending:
            latency = max(seconds_between(event.stamp, self.stamp_now()), 0.0)
            self._publish_verdicts(verdicts, latency)
        if self.observer.samples.sensors:  # samples that came while events were inserted
            self._samples.use_waiting()

    def _correct_from(self, stamp: int) -> None:
        """Publish the last estimate again if knowledge has changed from ``stamp`` (ns) on."""
        if self._last is not None and stamp <= self._last_stamp:
            self._publish(self._last_stamp)
            self._counts["estimates corrected"] += 1

    def _on_samples(self, stamp: int, revised: Sequence[Verdict]) -> None:
        """Publish the estimates after ``stamp`` (ns) that samples change, and verdicts."""
        if not self._is_due and time.monotonic() >= self._rests_until:  # else the next has them
            self._correct_from(stamp)
        self._publish_verdicts(revised, latency=0.0)
        published = self._samples.published()
        for verdict in self.observer.samples.take():
            if verdict.name in published:
                self.publish(self._judged_samples, self.make.measurement_verdict, verdict)
        if self._waits_for and self._samples.without_sample() != self._waits_for:
            self.trigger_activate()

    def _publish_verdicts(self, verdicts: Iterable[Verdict], latency: float) -> None:
        """Publish verdicts, and the estimates of the impacts that they apply, insert or reject."""
        for verdict in verdicts:
            self._diagnostics.count(verdict, latency)
            self._log(verdict)
            self.publish(self._verdicts, self.make.verdict, verdict, latency)
            try:
                impact = self.observer.impact(verdict)
            except Exception as error:  # noqa: BLE001 (the node goes on without this estimate)
                self.lines.error(f"no estimate of an impact of {verdict.contact}: {error}")
                continue
            if impact is not None:
                self.publish(self._estimated_impacts, self.make.impact_estimate, impact)

    def _log(self, verdict: Verdict) -> None:
        """Log a verdict, but not that an event was applied without a remark."""
        if verdict.ruling is Ruling.APPLIED and not verdict.reason:
            return
        what, reason = f"{verdict.contact}: {verdict.ruling.name.lower()}", verdict.reason
        short = reason if len(reason) <= _LONGEST else f"{reason[:_LONGEST]} ..."
        kind = re.split(r"[:;,]", without_numbers(reason), maxsplit=1)[0]
        log = self.lines.info if verdict.ruling is Ruling.APPLIED else self.lines.warning
        log(f"event {verdict.sequence} {what}, {short}", f"{what}, {kind}")

    def _on_timer(self) -> None:
        """Use what has arrived, and publish the estimates that are due."""
        if self._pulses is not None:
            self._pulses.take_arrived()
        self._is_due = True
        self._samples.take_arrived()
        self._is_due = False
        self._publish_due()
        self._apply_events()

    def _publish_due(self) -> None:
        """Publish the estimates that are at least ``lag`` old.

        Estimates that are slow leave half of the time to what waits: long predictions would keep
        samples waiting, which makes the next predictions longer.
        """
        rate, start = self.values["rate"], self.observer.start
        now, begin = self.stamp_now() - from_seconds(self.values["lag"]), time.monotonic()
        if start is None or now < start or begin < self._rests_until:
            return
        epoch = self.observer.epoch or start
        stamps, skipped = due_stamps(rate, epoch, start, self._due_until, now)
        self._due_until = stamps[-1] if stamps else self._due_until
        self._counts["estimates passed over"] += skipped
        end = time.thread_time() + _TURN
        for i, stamp in enumerate(stamps, start=1):
            if time.thread_time() < end or i in {1, len(stamps)}:
                self._publish(stamp)
            else:
                self._counts["estimates passed over"] += 1
        spent = time.monotonic() - begin
        if spent > max(1.0 / rate, _BRIEF):
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
        self._last, names = estimate, self.observer.system.coordinates
        state = self.publish(self._states, self.make.estimate, estimate, names)
        if state is not None:
            self.publish(self._joint_states, self.make.joint_state_of, state)
        if estimate.bound != (-1.0 if last is None else last.bound):
            self.publish(self._bounds, self.make.bound, estimate)
        if estimate.misfit and (last is None or not last.misfit):
            self.lines.warning(estimate.misfit)
        epoch = self.observer.epoch
        held = self.observer.system.held_force((stamp - epoch) / NS_PER_S) if epoch else ""
        if held and not self._is_held:
            self.lines.warning(held)
        self._is_held = bool(held)

    def _on_clock_back(self) -> None:
        """Restart the observer after a backward jump of the clock, as of a looped bag."""
        self.intake.clear()
        for each in self.receivers:
            each.clear()
        if self.observer.live is not None:
            self.observer.live.clear()
        self.observer.restart("the clock jumped back")
        self._forget_estimates()
        self._counts["clock jumps back"] += 1

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

    def statuses(self) -> list[DiagnosticStatus]:
        """Counts and faults of the observer, and of each sensor."""
        if behind := self._diagnostics.note_backlog(*self.intake.backlog()):
            self.lines.warning(behind)
        now, timeout = self.stamp_now(), self.values["input_timeout"]
        try:
            self.observer.forget_silence(now)
        except ImpactObserverError as error:
            self.lines.error(f"samples of inputs: {error}")
        silent = silence(self.observer.live, now, timeout)
        status = self._diagnostics.status(
            now,
            self._last,
            mismatch=self._impacts.fault if self._impacts.offers else "",
            silent=f"{silent}; input_timeout is {timeout:g} s" if silent else "",
            inputs=self._samples.values(now),
        )
        return [status, *self._samples.statuses(now)]


def due_stamps(
    rate: float, epoch: int, start: int, last: int | None, now: int
) -> tuple[list[int], int]:
    """The stamps ``epoch + k / rate`` at which estimates have become due.

    The first estimate is never skipped, as ratios of distances refer to it.

    Args:
        rate: of the estimates, Hz.
        epoch: stamp of k = 0, ns.
        start: stamp before which there is no estimate, ns.
        last: the last stamp that was due before, ns; None before the first one.
        now: stamp up to which estimates are due, ns.

    Returns:
        The stamps, ascending, ns, at most ``MOST_DUE`` and the first one; and the number of
        older ones that are skipped.
    """

    def stamp_of(k: int) -> int:
        return epoch + round(k * NS_PER_S / rate)

    def number(stamp: int) -> int:
        """The largest k whose stamp is at most ``stamp``."""
        k = math.floor(seconds_between(epoch, stamp) * rate) + 1  # may be rounded by one
        while stamp_of(k) > stamp:
            k -= 1
        return k

    first, newest = number(start - 1) + 1, number(now)
    done = first - 1 if last is None else max(number(last), first - 1)
    numbers = [*range(max(done + 1, newest - MOST_DUE + 1), newest + 1)]
    if last is None and numbers and numbers[0] > first:
        numbers.insert(0, first)
    return [stamp_of(k) for k in numbers], max(newest - done, 0) - len(numbers)
