"""Listening to a running plant and its observers, in constant memory; no ROS.

Messages come as bytes, as from a bag. Of states only the stamp is read when they come, and the
whole of the newest when somebody looks, so that a fast plant costs no more than a slow one.
"""

import struct
from collections import Counter, deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

import numpy as np

from impact_observer.draw.observer_topics import ObserverTopics
from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import Verdict
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface, interface
from impact_observer.io.message_types import (
    ClockMessage,
    ErrorMessage,
    EstimateMessage,
    EventMessage,
    JointStateMessage,
    StringMessage,
    VerdictMessage,
)
from impact_observer.io.messages import (
    JointState,
    MessageError,
    read_estimate,
    read_estimate_error,
    read_event,
    read_joint_state,
    read_stamp,
    read_verdict,
)
from impact_observer.io.typestores import deserialize, typestore
from impact_observer.model import System, parse_model
from impact_observer.ros.buffers import Arrivals, Newest, ValueBuffer
from impact_observer.ros.snapshot import Glance, Line, ObserverGlance
from impact_observer.stamps import NS_PER_S, seconds_between
from impact_observer.states import Estimate, Vector

_VERDICTS = 16
_HEADED = (interfaces.OBSERVER_STATE, interfaces.JOINT_STATE, interfaces.ESTIMATE_ERROR)
"""Types that begin with a header, and of which the newest alone matters."""


@dataclass(slots=True)
class _Heard:
    """What was heard of one observer."""

    observed: ObserverTopics
    distances: ValueBuffer
    convergences: ValueBuffer
    states: Newest = field(default_factory=Newest)
    joints: Newest = field(default_factory=Newest)
    errors: Newest = field(default_factory=Newest)
    bound: float | None = None
    verdicts: deque[tuple[Verdict, float]] = field(
        default_factory=partial(deque, maxlen=_VERDICTS)
    )
    counts: Counter[str] = field(default_factory=Counter)
    health: tuple[int, str] | None = None

    def forget(self, seconds: float) -> None:
        """Time has jumped back: what was, is not yet."""
        self.distances, self.convergences = ValueBuffer(seconds), ValueBuffer(seconds)
        self.states, self.joints, self.errors = Newest(), Newest(), Newest()
        self.bound = None
        self.verdicts.clear()
        self.counts.clear()


class Listening:
    """What was heard so far.

    Topics are those of ``bag.interfaces`` in any namespace; an observer's plant and monitor are
    looked for in its own.
    """

    def __init__(
        self,
        observers: Collection[str] | None = None,
        system: System | None = None,
        *,
        seconds: float = 60.0,
    ) -> None:
        """Begin.

        Args:
            observers: only these nodes, relative or absolute names; None for all.
            system: what V is computed with; None for the model that the plant publishes.
            seconds: how far back courses go, s.

        Raises:
            UsageError: a name is none of a node.
        """
        named = None if observers is None else [ObserverTopics.of_node(name) for name in observers]
        self._wanted = None if named is None else {each.prefix for each in named}
        self._system = system
        self._systems: dict[str, System] = {}
        self._seconds = seconds
        self._arrivals: dict[str, Arrivals] = {}
        self._heard: dict[str, _Heard] = {}
        self._truth: dict[str, Newest] = {}
        self._simulated: int | None = None
        self._epochs: dict[str, int] = {}
        self._impacts = 0
        self._last_impact: tuple[int, str] | None = None
        self._trouble = ""
        for each in named or ():
            self._observer(each.prefix)
        self._handlers: dict[Interface, Callable[[str, Any], None]] = {
            interfaces.IMPACTS: self._on_event,
            interfaces.PLANT_MODEL: self._on_model,
            interfaces.OBSERVER_VERDICTS: self._on_verdict,
            interfaces.OBSERVER_BOUND: self._on_bound,
            interfaces.SIMULATED_CLOCK: self._on_clock,
            interfaces.DIAGNOSTIC_ARRAYS: self._on_diagnostics,
        }

    def wants(self, topic: str, type_name: str) -> bool:
        """Whether a topic is one to be heard."""
        known = interface(topic)
        if known is None or known.type != type_name or not self._can_take(known):
            return False
        if self._wanted is None:
            return True
        if known == interfaces.MONITOR_ERROR:
            return any(
                ObserverTopics.of_node(name).topic(interfaces.MONITOR_ERROR) == topic
                for name in self._wanted
            )
        return not known.name.startswith("observer/") or _owner(topic) in self._wanted

    def hear(self, topic: str, data: bytes, arrived: float, wall: int) -> None:
        """Take in a message of a topic that is wanted.

        Args:
            topic: the absolute name.
            data: the message (CDR).
            arrived: monotonic time, s.
            wall: the system's clock, ns.
        """
        known = interface(topic)
        if known is None or not self._can_take(known):
            return
        latency = None
        try:
            if known not in self._handlers:
                stamp = _stamp(data)
                self._keep(known, topic, stamp, data)
                latency = seconds_between(stamp, self._now(wall))
            else:
                self._handlers[known](topic, _message(known, data))
        except Exception as error:  # noqa: BLE001 (rosbags raises many kinds; a view must go on)
            self._trouble = f"{topic}: {str(error) or type(error).__name__}"
        self._arrivals.setdefault(topic, Arrivals()).add(arrived, latency)

    def glance(self, now: float, wall: int) -> Glance:
        """What there is to see.

        Args:
            now: monotonic time, s.
            wall: the system's clock, ns.
        """
        seen = tuple(self._look(self._heard[name], now) for name in sorted(self._heard))
        epochs = set(self._epochs.values())
        owned = {flow.topic for each in seen for flow in each.flows}
        systems = [*self._systems.values(), *([self._system] if self._system else [])]
        return Glance(
            clock=self._now(wall),
            simulated=self._simulated is not None,
            epoch=epochs.pop() if len(epochs) == 1 else 0,
            model=systems[0].name if systems else "",
            truth=bool(self._truth),
            impacts=self._impacts,
            last_impact=self._last_impact,
            observers=seen,
            flows=tuple(
                self._arrivals[topic].flow(topic, now)
                for topic in sorted(self._arrivals.keys() - owned)
            ),
            trouble=self._trouble,
        )

    def _can_take(self, known: Interface) -> bool:
        """Whether messages of an interface say something here."""
        return known in self._handlers or known.type in _HEADED

    def _now(self, wall: int) -> int:
        """The clock that stamps follow."""
        return wall if self._simulated is None else self._simulated

    def _observer(self, prefix: str) -> _Heard:
        """What is heard of an observer."""
        if prefix not in self._heard:
            self._heard[prefix] = _Heard(
                ObserverTopics.of_node(prefix),
                ValueBuffer(self._seconds),
                ValueBuffer(self._seconds),
            )
        return self._heard[prefix]

    def _keep(self, known: Interface, topic: str, stamp: int, data: bytes) -> None:
        """Keep a state until somebody looks."""
        if known == interfaces.PLANT_JOINT_STATES:
            self._truth.setdefault(topic, Newest()).add(stamp, data)
        elif known == interfaces.OBSERVER_STATES:
            self._observer(_owner(topic)).states.add(stamp, data)
        elif known == interfaces.OBSERVER_JOINT_STATES:
            self._observer(_owner(topic)).joints.add(stamp, data)
        else:
            for each in self._heard.values():
                if each.observed.topic(interfaces.MONITOR_ERROR) == topic:
                    each.errors.add(stamp, data)

    def _on_event(self, topic: str, message: EventMessage) -> None:
        event = read_event(message)
        self._impacts += 1
        if event.epoch:
            self._epochs[topic] = event.epoch
        contacts = ", ".join(switch.contact for switch in event.switches)
        self._last_impact = (event.stamp, contacts)

    def _on_model(self, topic: str, message: StringMessage) -> None:
        self._systems[topic] = parse_model(message.data, topic).system

    def _on_verdict(self, topic: str, message: VerdictMessage) -> None:
        verdict, latency = read_verdict(message)
        heard = self._observer(_owner(topic))
        heard.verdicts.appendleft((verdict, latency))
        heard.counts[verdict.ruling.name.lower().replace("_", " ")] += not verdict.revises

    def _on_bound(self, topic: str, message: ErrorMessage) -> None:
        self._observer(_owner(topic)).bound = float(message.v)

    def _on_clock(self, _: str, message: ClockMessage) -> None:
        stamp = read_stamp("Clock.clock", message.clock, earliest=0)
        if self._simulated is not None and stamp < self._simulated:
            self._truth.clear()
            self._impacts, self._last_impact = 0, None
            for each in self._heard.values():
                each.forget(self._seconds)
        self._simulated = stamp

    def _on_diagnostics(self, _: str, message: Any) -> None:  # noqa: ANN401 (DiagnosticArray)
        for status in message.status:
            for each in self._heard.values():
                if status.name == f"{each.observed.prefix}: impacts":
                    each.health = (int(status.level), str(status.message))

    def _look(self, heard: _Heard, now: float) -> ObserverGlance:
        """One observer as it is now."""
        observed = heard.observed
        topics = [
            t
            for t in self._arrivals
            if _owner(t) == observed.prefix or t == observed.topic(interfaces.MONITOR_ERROR)
        ]
        seen = ObserverGlance(
            observed.prefix,
            epoch=self._epochs.get(observed.topic(interfaces.IMPACTS), 0),
            bound=heard.bound,
            verdicts=tuple(heard.verdicts),
            counts=tuple(sorted(heard.counts.items())),
            health=heard.health,
            flows=tuple(self._arrivals[topic].flow(topic, now) for topic in sorted(topics)),
        )
        try:
            return self._with_state(seen, heard)
        except Exception as error:  # noqa: BLE001 (as above)
            self._trouble = f"{observed.prefix}: {str(error) or type(error).__name__}"
            return seen

    def _with_state(self, seen: ObserverGlance, heard: _Heard) -> ObserverGlance:
        """The same with the newest state, and the truth of its stamp if there is one."""
        truths = self._truth.get(heard.observed.topic(interfaces.PLANT_JOINT_STATES))
        kept = heard.joints if heard.states.last() is None else heard.states
        stamp = None if truths is None else kept.last(truths)
        known = stamp is not None
        stamp = kept.last() if stamp is None else stamp
        if stamp is None:
            return replace(seen, distance=heard.distances.course())
        truth = _joints(truths.data(stamp)) if known and truths else None
        if kept is heard.joints:
            names, estimate = _as_estimate(_joints(kept.data(stamp)))
        else:
            message = _message(interfaces.OBSERVER_STATES, kept.data(stamp))
            names, estimate = read_estimate(cast("EstimateMessage", message))
        true = _ordered(truth, names)
        source = self._measure(heard, names, estimate, true)
        if estimate.convergence >= 0:
            heard.convergences.add(stamp, estimate.convergence)
        differences = heard.convergences.course()
        return replace(
            seen,
            law=estimate.law,
            stamp=stamp,
            lines=_lines(names, estimate, true),
            distance=heard.distances.course(),
            source=source,
            convergence=differences
            if estimate.convergence >= 0
            else replace(differences, now=-1.0),
            synchronized=estimate.synchronized if estimate.law else None,
            closed=estimate.closed,
            parameters=estimate.parameters,
        )

    def _measure(
        self,
        heard: _Heard,
        names: tuple[str, ...],
        estimate: Estimate,
        true: tuple[Vector, Vector] | None,
    ) -> str:
        """Note V as the monitor tells it, else as it is computed here; who told it."""
        stamp = heard.errors.last()
        if stamp is not None:
            message = _message(interfaces.MONITOR_ERROR, heard.errors.data(stamp))
            heard.distances.add(stamp, read_estimate_error(cast("ErrorMessage", message)).v)
            return "monitor"
        model = heard.observed.topic(interfaces.PLANT_MODEL)
        system = self._system or self._systems.get(model)
        if true is None or system is None or sorted(system.coordinates) != sorted(names):
            return ""
        order = [names.index(name) for name in system.coordinates]
        q, u = estimate.q - true[0], estimate.u - true[1]
        heard.distances.add(estimate.stamp, float(distance(system, q[order], u[order])))
        return "here"


def _owner(topic: str) -> str:
    """The node whose topic it is."""
    return topic.rpartition("/")[0]


def _stamp(data: bytes) -> int:
    """The stamp of a serialized message that begins with a header, ns; the rest is not read."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def _message(known: Interface, data: bytes) -> object:
    """The message in serialized data."""
    return deserialize(typestore(), data, known.type)


def _joints(data: bytes) -> JointState:
    """The state in a serialized ``JointState``."""
    message = _message(interfaces.OBSERVER_JOINT_STATES, data)
    return read_joint_state(cast("JointStateMessage", message))


def _as_estimate(state: JointState) -> tuple[tuple[str, ...], Estimate]:
    """An estimate of which only the state is known."""
    return state.names, Estimate(state.stamp, "", state.q, state.u)


def _ordered(truth: JointState | None, names: tuple[str, ...]) -> tuple[Vector, Vector] | None:
    """The truth in the order of ``names``; None where there is none, or it has others."""
    if truth is None:
        return None
    try:
        found = truth.ordered(names)
    except MessageError:
        return None
    return found.q, found.u


def _lines(
    names: tuple[str, ...], estimate: Estimate, true: tuple[Vector, Vector] | None
) -> tuple[Line, ...]:
    """Coordinates, then velocities."""
    size = 2 * len(names)
    values = np.concatenate([estimate.q, estimate.u])
    truth = [None] * size if true is None else np.concatenate(true).tolist()
    variances = np.diag(estimate.covariance) if estimate.covariance.size else None
    deviations = [None] * size if variances is None else np.sqrt(variances.clip(0.0)).tolist()
    return tuple(
        Line(name, "m" if i < len(names) else "m/s", float(values[i]), truth[i], deviations[i])
        for i, name in enumerate((*names, *names))
    )
