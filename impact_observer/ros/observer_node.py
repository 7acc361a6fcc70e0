"""The observer node: impact events in, the estimated state out."""

import math
import time
from collections import Counter
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from impact_observer_msgs.srv import SetState
from numpy.typing import ArrayLike
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.events import ImpactEvent, Remark, Ruling, Verdict
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Quality
from impact_observer.io.messages import MessageError
from impact_observer.model import Model, read_model
from impact_observer.model.free_parameters import with_unit
from impact_observer.observer import (
    COMPILING,
    LARGEST_INNOVATION,
    Observer,
    Options,
    initial_state,
    make_observer,
    needs_compiling,
)
from impact_observer.ros import parameters
from impact_observer.ros.message_classes import message_class, ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.serialized import Serialized, read_impact
from impact_observer.ros.session import interruptible
from impact_observer.ros.subscribing import waiting
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between
from impact_observer.states import Estimate

_BACKLOG = 20
"""Estimates made up for when simulated time has jumped; older ones are passed over."""
_BURST = 8
"""The same when the node was late: to make up for more would make it later. So many fit into the
history of their topics, of 10, before somebody must hear them."""
_AT_ONCE = 100
"""Events taken one after the other, at most, before estimates have their turn."""
_TURN = 5_000_000
"""For so long they are, ns: services and signals wait meanwhile."""
_PATIENCE = Duration(seconds=0.01)
"""How long a burst waits to be heard."""
_LONG = 2.0
"""Time to compile that is told, s: less where it is only read again."""
_STALE = 60 * NS_PER_S
"""Silence after which the diagnostics suspect that stamps and clock disagree, ns."""


class ObserverNode(Node):
    """Runs one observer; every estimate is stamped ``epoch + k / rate``.

    Estimates are published when the clock is ``lag`` past their stamps. When an event arrives
    after an estimate that should contain it, that estimate is published again, corrected, at
    once. Ground truth is never subscribed to.

    In real time the last event is run again after a tick, for a share of the time: a node that
    hears of an event now and then would find that its code and data have left the caches.
    """

    def __init__(self) -> None:
        super().__init__("observer")
        values = parameters.declare(self, parameters.OBSERVER)
        options, lag = values.options(), values.number("lag")
        if lag > options.history:
            found = f"parameter lag: {lag:g} found"
            raise UsageError(f"{found}; expected at most history, {options.history:g}")
        model = read_model(values.text("model"))
        system = model.system
        self._initial = initial_state(options.initial_state, system)
        self._observer = self._made(options, model)
        self._serialized = Serialized(system.coordinates)
        self._rate = values.number("rate")
        self._lag = from_seconds(lag)
        self._future = from_seconds(values.number("future"))
        self._rehearsal = 0.0
        self._next_rehearsal = 0
        self._make = ros_messages()
        self._states = self._publisher(interfaces.OBSERVER_STATES)
        self._joint_states = self._publisher(interfaces.OBSERVER_JOINT_STATES)
        self._verdicts = self._publisher(interfaces.OBSERVER_VERDICTS)
        self._bounds = self._publisher(interfaces.OBSERVER_BOUND)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "/diagnostics", qos_profile(interfaces.DIAGNOSTIC_ARRAYS.quality)
        )
        self._counts: Counter[str] = Counter()
        self._told: Counter[str] = Counter()
        self._latency = 0.0
        self._mismatch = ""
        self._forget()
        durability = values.text("events_durability")
        events = Quality(transient_local=durability == "transient_local", depth=2000)
        self._impacts = self.create_subscription(
            message_class(interfaces.IMPACTS.type),
            "impacts",
            self._on_events,
            qos_profile(events),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_mismatch),
            raw=True,
        )
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetState, "~/set_state", self._on_set_state)
        self.create_timer(1.0 / self._rate, self._on_timer)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._diagnose, clock=steady)
        backwards = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jump = self.get_clock().create_jump_callback(
            backwards, post_callback=self._on_clock_back
        )

    def _made(self, options: Options, model: Model) -> Observer:
        """The observer; what takes long is told."""
        if not needs_compiling(options):
            return make_observer(model.system, options, model.elements)
        self.get_logger().info(COMPILING)
        begun = time.monotonic()
        with interruptible():
            made = make_observer(model.system, options, model.elements)
        if (took := time.monotonic() - begun) > _LONG:
            self.get_logger().info(f"compiled in {took:.0f} s")
        return made

    def _publisher(self, interface: interfaces.Interface) -> Publisher:
        topic = f"~/{interface.name.rpartition('/')[2]}"
        return self.create_publisher(
            message_class(interface.type), topic, qos_profile(interface.quality)
        )

    def _forget(self) -> None:
        """Nothing has been published yet."""
        self._last_sample: int | None = None
        self._last_stamp = 0
        self._last: Estimate | None = None

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_events(self, *messages: bytes) -> None:
        """Apply what has come, and what has come behind it meanwhile."""
        end = time.monotonic_ns() + _TURN
        for message in messages:
            self._on_event(message)
        behind = waiting(self._impacts, _AT_ONCE, raw=True)
        while time.monotonic_ns() < end and (more := next(behind, None)) is not None:
            self._on_event(more[0])

    def _on_event(self, message: bytes) -> None:
        """Apply an event and say what became of it."""
        try:
            event = read_impact(message)
        except MessageError as error:
            self._counts["invalid"] += 1
            self.get_logger().error(f"impacts: {error}")
            return
        restarts = self._observer.restarts
        verdicts = self._judge(event)
        if self._observer.restarts > restarts:
            self._forget()
            self.get_logger().warning(
                f"the plant began again: episode {event.episode}, epoch {event.epoch} ns"
            )
        late = event.stamp <= self._last_stamp
        applied = any(verdict.ruling is Ruling.APPLIED for verdict in verdicts)
        if applied and late:
            self._publish(self._last_stamp)
            self._counts["corrected"] += 1
        latency = max(seconds_between(event.stamp, self._now()), 0.0)
        if applied:
            self._latency = max(self._latency, latency)
        for verdict in self._beside_lag(verdicts) if late else verdicts:
            self._counts[verdict.ruling.name.lower()] += not verdict.revises
            self._counts["surprising"] += verdict.innovation > LARGEST_INNOVATION
            self._log(verdict)
            self._verdicts.publish(self._make.verdict(verdict, latency))

    def _log(self, verdict: Verdict) -> None:
        """Tell what is not as usual."""
        ruling = verdict.ruling.name.lower()
        line = f"event {verdict.sequence} {verdict.contact}: {ruling}, {verdict.reason}"
        if verdict.ruling is not Ruling.APPLIED:
            self.get_logger().warning(line)
        elif verdict.reason:
            self.get_logger().info(line)

    def _beside_lag(self, verdicts: tuple[Verdict, ...]) -> tuple[Verdict, ...]:
        """``verdicts`` on an event that is late; without a lag every event is."""
        first, *others = verdicts
        if not self._lag or first.ruling is not Ruling.APPLIED:
            return verdicts
        later = "later than lag: the last estimate is published again"
        return (first._replace(reason="; ".join(filter(None, (first.reason, later)))), *others)

    def _judge(self, event: ImpactEvent) -> tuple[Verdict, ...]:
        """What the observer makes of an event, unless its stamp or epoch cannot be used."""
        reason = self._future_of(event)
        if not reason:
            try:
                return self._observer.receive(event)
            except ImpactObserverError as error:  # a message must not end the node
                reason = str(error)
        return (Verdict(event.stamp, Ruling.REJECTED, event.sequence, reason=reason),)

    def _future_of(self, event: ImpactEvent) -> str:
        """Why an event is too far ahead of the clock; empty where it is not."""
        latest = max(event.stamp, event.epoch)
        if latest <= self._last_stamp:  # that is past by any clock
            return ""
        now = self._now()
        ahead = latest - now
        if not now or ahead <= self._future:
            return ""
        self._counts["future"] += 1
        what = "stamped" if event.stamp - now > self._future else "its epoch is"
        most = self._future / NS_PER_S
        return f"{what} {ahead / NS_PER_S:.3f} s after the clock; future allows {most:g} s"

    def _on_timer(self) -> None:
        """Publish the estimates whose stamps are ``lag`` ago."""
        start, now = self._observer.start, self._now() - self._lag
        if start is None or now < start:
            return
        epoch = self._observer.epoch or start
        newest = int(seconds_between(epoch, now) * self._rate) + 1
        simulated = self.get_clock().ros_time_is_active
        beginning = math.ceil(seconds_between(epoch, start) * self._rate)
        last = beginning - 1 if self._last_sample is None else self._last_sample
        first = max(last + 1, newest - (_BACKLOG if simulated else _BURST))
        due = [*range(first, newest + 1)]
        # Where it began is told in any case: what is said of V is relative to that.
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
                self._last_stamp = stamp
                self._publish(stamp)
            if simulated and (k - first) % _BURST == _BURST - 1:
                self._states.wait_for_all_acked(_PATIENCE)
                self._joint_states.wait_for_all_acked(_PATIENCE)
        self._on_events()  # not one turn of the executor later
        if self._rehearsal and not simulated:
            self._rehearse()

    def _rehearse(self) -> None:
        """Run the last event again, unless the share of the time for that is used up.

        What takes longer than a tick is rehearsed the more rarely: others wait for it meanwhile,
        and warm caches gain it little.
        """
        begun = time.monotonic_ns()
        if begun < self._next_rehearsal:
            return
        self._observer.rehearse()
        took = time.monotonic_ns() - begun
        ticks = max(took * self._rate / NS_PER_S, 1.0)
        self._next_rehearsal = begun + math.ceil(took * ticks / self._rehearsal)

    def _publish(self, stamp: int) -> None:
        estimate = self._observer.estimate(stamp)
        publishers = self._states, self._joint_states
        for publisher, message in zip(publishers, self._serialized.of(estimate), strict=True):
            publisher.publish(message)
        if estimate.bound != (-1.0 if self._last is None else self._last.bound):
            self._bounds.publish(self._make.bound(estimate))
        self._last = estimate

    def _on_clock_back(self, _: TimeJump) -> None:
        """The clock jumped back (a bag loop, say): begin again."""
        self._observer.restart("the clock jumped back")
        self._forget()
        self._counts["clock_jumps"] += 1

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Put the replica back to its initial state, at the last estimate."""
        response.success, response.message = self._set_state(*self._initial)
        return response

    def _on_set_state(
        self, request: SetState.Request, response: SetState.Response
    ) -> SetState.Response:
        """Put the replica into a state, at the last estimate."""
        response.success, response.message = self._set_state(
            request.position, request.velocity, request.covariance
        )
        return response

    def _set_state(
        self, position: ArrayLike, velocity: ArrayLike, covariance: Sequence[float] = ()
    ) -> tuple[bool, str]:
        """The state holds from the last estimate's stamp on, or as the initial one.

        Events since then act on it: with a lag those are already known that estimates still to
        come must contain.
        """
        try:
            given = covariance if len(covariance) else None
            self._observer.set_state(self._last_stamp, position, velocity, given)
        except ImpactObserverError as error:
            return False, str(error)
        start = self._observer.start
        return True, "holds at the start" if start is None else f"holds at {start} ns"

    def _on_mismatch(self, info: QoSRequestedIncompatibleQoSInfo) -> None:
        """A publisher of impacts will never be heard."""
        self._mismatch = (
            f"a publisher of impacts offers an incompatible quality of service"
            f" ({info.last_policy_kind}); set events_durability: volatile"
        )
        self.get_logger().error(self._mismatch)

    def _diagnose(self) -> None:
        """Publish counts and what is wrong to ``/diagnostics``."""
        level, message = self._health()
        observer = self._observer
        figures = {
            "law": observer.law.name,
            "events applied": self._counts["applied"],
            "events rejected": self._counts["rejected"],
            "impacts inserted": self._counts["inserted"],
            **{remark.value: observer.remarks[remark] for remark in Remark},
            "from the future": self._counts["future"],
            "invalid messages": self._counts["invalid"],
            "missing sequence numbers": observer.missing,
            "estimates corrected": self._counts["corrected"],
            "estimates passed over": self._counts["passed_over"],
            "clock jumps back": self._counts["clock_jumps"],
            "restarts": observer.restarts,
            "largest latency [s]": f"{self._latency:.6f}",
            "surprising events": self._counts["surprising"],
            **self._known(),
        }
        status = DiagnosticStatus(
            level=level,
            name=f"{self.get_fully_qualified_name()}: impacts",
            message=message,
            hardware_id=observer.system.name,
            values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _known(self) -> dict[str, object]:
        """What the last estimate says of its own error."""
        if self._last is None:
            return {}
        bound, differences = self._last.bound, self._last.convergence
        without = "refuted" if self._last.inconsistent else "none"
        learnt = {
            with_unit(name): f"{value:.6g} +- {deviation:.2g}"
            for name, value, deviation in self._last.parameters
        }
        return {
            **learnt,
            "synchronized": self._last.synchronized,
            "convergence [J]": f"{differences:.6g}" if differences >= 0 else "one replica only",
            "certified bound of V [J]": f"{bound:.6g}" if bound >= 0 else without,
        }

    def _health(self) -> tuple[bytes, str]:
        """Level and message of the diagnostics: the worst that is true."""
        observer = self._observer
        if self._mismatch:
            return DiagnosticStatus.ERROR, self._mismatch
        if not self._now():
            return DiagnosticStatus.WARN, "use_sim_time is set, but no /clock has come"
        if observer.start is None:
            return DiagnosticStatus.WARN, "no impact has come yet"
        silence = self._now() - max(observer.last_event, observer.start)
        if silence > _STALE:
            ago = f"the last impact was {silence / NS_PER_S:.0f} s ago by this clock"
            return DiagnosticStatus.WARN, f"{ago}; is use_sim_time missing?"
        return self._events_health()

    def _events_health(self) -> tuple[bytes, str]:
        """The same as far as the events tell."""
        observer = self._observer
        if self._last is not None and self._last.inconsistent:
            return DiagnosticStatus.WARN, "events contradict the model or initial_deviation"
        fine = (Ruling.APPLIED, Ruling.INSERTED)
        refused = sum(self._counts[each.name.lower()] for each in Ruling if each not in fine)
        refused += self._counts["invalid"]
        trouble = {
            "are missing": observer.missing,
            "were missed by the sensor, and inserted": self._counts["inserted"],
            "were not applied": refused,
            "surprised the law (is clock_error too small?)": self._counts["surprising"],
        }
        # What is old news stands among the values only.
        fresh = [f"{n} events {what}" for what, n in trouble.items() if n > self._told[what]]
        self._told = Counter(trouble)
        if fresh:
            return DiagnosticStatus.WARN, ", ".join(fresh)
        return DiagnosticStatus.OK, f"{self._counts['applied']} impacts applied"
