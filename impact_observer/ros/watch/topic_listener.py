# SPDX-License-Identifier: Apache-2.0
"""Collects the topics of a running plant and its observers, in constant memory; no ROS.

Messages arrive as bytes, as from a bag. Of a state only the stamp is read on arrival; the newest
state is decoded when a snapshot is made, so that a fast plant costs no more than a slow one.
"""

import struct
from collections import Counter, deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from impact_observer.draw.observer_topics import ObserverTopics
from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import Verdict
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface, interface
from impact_observer.io.measured_samples import SENSOR_STATUS
from impact_observer.io.messages import (
    AnyMessage,
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
from impact_observer.ros.watch.buffers import Arrivals, HistoryBuffer, RecentMessages
from impact_observer.ros.watch.snapshot import (
    ObserverSnapshot,
    SensorLine,
    Snapshot,
    StateLine,
)
from impact_observer.stamps import NS_PER_S, seconds_between
from impact_observer.states import Estimate, Vector

_VERDICTS = 16
_HEADED = (interfaces.OBSERVER_STATE, interfaces.JOINT_STATE, interfaces.ESTIMATE_ERROR)
"""Types that begin with a header, and of which only the newest message is shown."""


@dataclass(slots=True)
class _ObserverRecord:
    """What was received from one observer."""

    observed: ObserverTopics
    distances: HistoryBuffer
    convergences: HistoryBuffer
    states: RecentMessages = field(default_factory=RecentMessages)
    joints: RecentMessages = field(default_factory=RecentMessages)
    errors: RecentMessages = field(default_factory=RecentMessages)
    bound: float | None = None
    verdicts: deque[tuple[Verdict, float]] = field(
        default_factory=partial(deque, maxlen=_VERDICTS)
    )
    counts: Counter[str] = field(default_factory=Counter)
    health: tuple[int, str] | None = None
    obstacle: str = ""
    sensors: dict[str, SensorLine] = field(default_factory=dict)

    def clear(self, seconds: float) -> None:
        """Forget everything but the diagnostics, after a backward jump of time."""
        self.distances, self.convergences = HistoryBuffer(seconds), HistoryBuffer(seconds)
        self.states, self.joints, self.errors = (
            RecentMessages(),
            RecentMessages(),
            RecentMessages(),
        )
        self.bound = None
        self.verdicts.clear()
        self.counts.clear()


class TopicListener:
    """Keeps what was received so far.

    Topics are those of ``io/interfaces.py`` in any namespace; the plant and the monitor of an
    observer are those of its own namespace.
    """

    def __init__(
        self,
        observers: Collection[str] | None = None,
        system: System | None = None,
        *,
        seconds: float = 60.0,
    ) -> None:
        """Listen to all observers, or some.

        Args:
            observers: only these nodes, relative or absolute names; None for all.
            system: for V; None for the model that the plant publishes.
            seconds: length of the histories, s.

        Raises:
            UsageError: a name cannot be a node's.
        """
        named = None if observers is None else [ObserverTopics.of_node(name) for name in observers]
        self._wanted = None if named is None else {each.prefix for each in named}
        self._system = system
        self._systems: dict[str, System] = {}
        self._seconds = seconds
        self._arrivals: dict[str, Arrivals] = {}
        self._observers: dict[str, _ObserverRecord] = {}
        self._truth: dict[str, RecentMessages] = {}
        self._simulated: int | None = None
        self._epochs: dict[str, int] = {}
        self._impacts = 0
        self._last_impact: tuple[int, str] | None = None
        self._unreadable = ""
        self._merged = set[str]()
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
        """Whether the messages of a topic are used."""
        kind = interface(topic)
        if kind is None or kind.type != type_name or not self._can_take(kind):
            return False
        if self._wanted is None:
            return True
        if kind == interfaces.MONITOR_ERROR:
            return any(
                ObserverTopics.of_node(name).topic(interfaces.MONITOR_ERROR) == topic
                for name in self._wanted
            )
        return not kind.name.startswith("observer/") or _owner(topic) in self._wanted

    def receive(self, topic: str, data: bytes, arrived: float, wall: int) -> None:
        """Take in a message of a wanted topic.

        Args:
            topic: the absolute name.
            data: the message (CDR).
            arrived: monotonic time, s.
            wall: the system's clock, ns.
        """
        kind = interface(topic)
        if kind is None or not self._can_take(kind):
            return
        latency = None
        try:
            if kind not in self._handlers:
                stamp = _stamp(data)
                self._keep(kind, topic, stamp, data)
                latency = seconds_between(stamp, self._now(wall))
            else:
                self._handlers[kind](topic, _message(kind, data))
        except Exception as error:  # noqa: BLE001 (rosbags raises many kinds; a view must go on)
            self._unreadable = f"{topic}: {str(error) or type(error).__name__}"
        self._arrivals.setdefault(topic, Arrivals()).add(arrived, latency)

    def note_publishers(self, topic: str, count: int) -> None:
        """So many nodes publish on a wanted topic; of a plant or an observer it should be one."""
        is_shared = interface(topic) in {interfaces.SIMULATED_CLOCK, interfaces.DIAGNOSTIC_ARRAYS}
        (self._merged.add if count > 1 and not is_shared else self._merged.discard)(topic)

    def snapshot(self, now: float, wall: int) -> Snapshot:
        """Everything at one moment.

        Args:
            now: monotonic time, s.
            wall: the system's clock, ns.
        """
        seen = tuple(
            self._observer_snapshot(self._observers[name], now) for name in sorted(self._observers)
        )
        epochs = set(self._epochs.values())
        owned = {flow.topic for each in seen for flow in each.flows}
        systems = [*self._systems.values(), *([self._system] if self._system else [])]
        return Snapshot(
            clock=self._now(wall),
            simulated=self._simulated is not None,
            epoch=epochs.pop() if len(epochs) == 1 else 0,
            model=systems[0].name if systems else "",
            truth=bool(self._truth),
            impacts=self._impacts,
            last_impact=self._last_impact,
            observers=seen,
            flows=tuple(
                self._arrivals[topic].rate(topic, now)
                for topic in sorted(self._arrivals.keys() - owned)
            ),
            trouble=self._unreadable,
            merged=tuple(sorted(self._merged)),
        )

    def _can_take(self, kind: Interface) -> bool:
        """Whether messages of an interface are used."""
        return kind in self._handlers or kind.type in _HEADED

    def _now(self, wall: int) -> int:
        """The clock that stamps follow."""
        return wall if self._simulated is None else self._simulated

    def _observer(self, prefix: str) -> _ObserverRecord:
        """The record of an observer."""
        if prefix not in self._observers:
            self._observers[prefix] = _ObserverRecord(
                ObserverTopics.of_node(prefix),
                HistoryBuffer(self._seconds),
                HistoryBuffer(self._seconds),
            )
        return self._observers[prefix]

    def _keep(self, kind: Interface, topic: str, stamp: int, data: bytes) -> None:
        """Keep a state for the next snapshot."""
        if kind == interfaces.PLANT_JOINT_STATES:
            self._truth.setdefault(topic, RecentMessages()).add(stamp, data)
        elif kind == interfaces.OBSERVER_STATES:
            self._observer(_owner(topic)).states.add(stamp, data)
        elif kind == interfaces.OBSERVER_JOINT_STATES:
            self._observer(_owner(topic)).joints.add(stamp, data)
        else:
            for each in self._observers.values():
                if each.observed.topic(interfaces.MONITOR_ERROR) == topic:
                    each.errors.add(stamp, data)

    def _on_event(self, topic: str, message: AnyMessage) -> None:
        event = read_event(message)
        self._impacts += 1
        if event.epoch:
            self._epochs[topic] = event.epoch
        contacts = ", ".join(switch.contact for switch in event.switches)
        self._last_impact = (event.stamp, contacts)

    def _on_model(self, topic: str, message: AnyMessage) -> None:
        self._systems[topic] = parse_model(message.data, topic).system

    def _on_verdict(self, topic: str, message: AnyMessage) -> None:
        verdict, latency = read_verdict(message)
        record = self._observer(_owner(topic))
        record.verdicts.appendleft((verdict, latency))
        record.counts[verdict.ruling.name.lower().replace("_", " ")] += not verdict.revises

    def _on_bound(self, topic: str, message: AnyMessage) -> None:
        self._observer(_owner(topic)).bound = float(message.v)

    def _on_clock(self, _: str, message: AnyMessage) -> None:
        stamp = read_stamp("Clock.clock", message.clock, earliest=0)
        if self._simulated is not None and stamp < self._simulated:
            self._truth.clear()
            self._impacts, self._last_impact = 0, None
            for each in self._observers.values():
                each.clear(self._seconds)
        self._simulated = stamp

    def _on_diagnostics(self, _: str, message: Any) -> None:  # noqa: ANN401 (DiagnosticArray)
        for status in message.status:
            for each in self._observers.values():
                if status.name == f"{each.observed.prefix}: impacts":
                    each.health = (int(status.level), str(status.message))
                    values = {value.key: str(value.value) for value in status.values}
                    each.obstacle = values.get(interfaces.NOT_SYNCHRONIZED, "")
                elif (sensor := _sensor_of(str(status.name), each.observed.prefix)) is not None:
                    line = SensorLine(sensor, int(status.level), str(status.message))
                    each.sensors[sensor] = line

    def _observer_snapshot(self, record: _ObserverRecord, now: float) -> ObserverSnapshot:
        """One observer at present."""
        observed = record.observed
        monitor = observed.topic(interfaces.MONITOR_ERROR)
        topics = [t for t in self._arrivals if _owner(t) == observed.prefix or t == monitor]
        seen = ObserverSnapshot(
            observed.prefix,
            epoch=self._epochs.get(observed.topic(interfaces.IMPACTS), 0),
            bound=record.bound,
            verdicts=tuple(record.verdicts),
            counts=tuple(sorted(record.counts.items())),
            health=record.health,
            sensors=tuple(line for _, line in sorted(record.sensors.items())),
            flows=tuple(self._arrivals[topic].rate(topic, now) for topic in sorted(topics)),
        )
        try:
            return self._with_state(seen, record)
        except Exception as error:  # noqa: BLE001 (as above)
            self._unreadable = f"{observed.prefix}: {str(error) or type(error).__name__}"
            return seen

    def _with_state(self, seen: ObserverSnapshot, record: _ObserverRecord) -> ObserverSnapshot:
        """``seen`` with the newest state, and the truth at its stamp if there is one."""
        truths = self._truth.get(record.observed.topic(interfaces.PLANT_JOINT_STATES))
        kept = record.joints if record.states.last() is None else record.states
        common = None if truths is None else kept.last(truths)
        stamp = kept.last() if common is None else common
        if stamp is None:
            return replace(seen, distance=record.distances.history())
        truth = None if truths is None or common is None else _joints(truths.data(common))
        if kept is record.joints:
            names, estimate = _as_estimate(_joints(kept.data(stamp)))
        else:
            message = _message(interfaces.OBSERVER_STATES, kept.data(stamp))
            names, estimate = read_estimate(message)
        true = _ordered(truth, names)
        source = self._measure(record, names, estimate, true)
        if estimate.convergence >= 0:
            record.convergences.add(stamp, estimate.convergence)
        convergence = record.convergences.history()
        return replace(
            seen,
            law=estimate.law,
            stamp=stamp,
            lines=_lines(names, estimate, true),
            distance=record.distances.history(),
            source=source,
            convergence=convergence
            if estimate.convergence >= 0
            else replace(convergence, now=-1.0),
            synchronized=estimate.synchronized if estimate.law else None,
            obstacle="" if estimate.synchronized else record.obstacle,
            closed=estimate.closed,
            learned=estimate.parameters,
        )

    def _measure(
        self,
        record: _ObserverRecord,
        names: tuple[str, ...],
        estimate: Estimate,
        true: tuple[Vector, Vector] | None,
    ) -> str:
        """Keep V from the monitor, else computed here; returns who computed it."""
        stamp = record.errors.last()
        if stamp is not None:
            message = _message(interfaces.MONITOR_ERROR, record.errors.data(stamp))
            record.distances.add(stamp, read_estimate_error(message).v)
            return "monitor"
        model = record.observed.topic(interfaces.PLANT_MODEL)
        system = self._system or self._systems.get(model)
        if true is None or system is None or sorted(system.coordinates) != sorted(names):
            return ""
        order = [names.index(name) for name in system.coordinates]
        q, u = estimate.q - true[0], estimate.u - true[1]
        record.distances.add(estimate.stamp, float(distance(system, q[order], u[order])))
        return "here"


def _sensor_of(status: str, observer: str) -> str | None:
    """The sensor of a status of this name, by the prefix of its observer; None for others."""
    start = f"{observer}: {SENSOR_STATUS}"
    return status.removeprefix(start) if status.startswith(start) else None


def _owner(topic: str) -> str:
    """The node of a topic."""
    return topic.rpartition("/")[0]


def _stamp(data: bytes) -> int:
    """The stamp of a serialized message that begins with a header, ns; the rest is not read."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def _message(kind: Interface, data: bytes) -> object:
    """The message in serialized data."""
    return deserialize(typestore(), data, kind.type)


def _joints(data: bytes) -> JointState:
    """The state in a serialized ``JointState``."""
    message = _message(interfaces.OBSERVER_JOINT_STATES, data)
    return read_joint_state(message)


def _as_estimate(state: JointState) -> tuple[tuple[str, ...], Estimate]:
    """An estimate with nothing but the state."""
    return state.names, Estimate(state.stamp, "", state.q, state.u)


def _ordered(truth: JointState | None, names: tuple[str, ...]) -> tuple[Vector, Vector] | None:
    """The truth in the order of ``names``; None where there is none, or with other names."""
    if truth is None:
        return None
    try:
        found = truth.ordered(names)
    except MessageError:
        return None
    return found.q, found.u


def _lines(
    names: tuple[str, ...], estimate: Estimate, true: tuple[Vector, Vector] | None
) -> tuple[StateLine, ...]:
    """Coordinates, then velocities."""
    size = 2 * len(names)
    values = np.concatenate([estimate.q, estimate.u])
    truth = [None] * size if true is None else np.concatenate(true).tolist()
    variances = np.diag(estimate.covariance) if estimate.covariance.size else None
    deviations = [None] * size if variances is None else np.sqrt(variances.clip(0.0)).tolist()
    return tuple(
        StateLine(
            name, "m" if i < len(names) else "m/s", float(values[i]), truth[i], deviations[i]
        )
        for i, name in enumerate((*names, *names))
    )
