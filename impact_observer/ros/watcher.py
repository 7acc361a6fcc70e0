# SPDX-License-Identifier: Apache-2.0
"""A live view of a running plant and its observers in the terminal.

Messages go into a :class:`Listener`, whose :meth:`Listener.view` is an immutable :class:`View` of
one moment; :func:`screen` and :func:`line` say what is shown of a view.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from rich.console import Console, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from impact_observer.compare.energy_of_errors import energies, errors_of
from impact_observer.draw.observer_topics import ObserverTopics
from impact_observer.draw.reports import figure, literal_text
from impact_observer.errors import ImpactObserverError
from impact_observer.events import Verdict
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface, interface
from impact_observer.io.measured_samples import SENSOR_STATUS
from impact_observer.io.messages import (
    AnyMessage,
    JointState,
    MessageError,
    read_estimate,
    read_event,
    read_joint_state,
    read_stamp,
    read_verdict,
)
from impact_observer.model import System, parse_model
from impact_observer.model.free_parameters import with_unit
from impact_observer.model.system import per_second, unit_of
from impact_observer.process_end import Stop
from impact_observer.robots.robot import Robot, simulated
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.session import ros_node
from impact_observer.ros.subscribing import common_offer, waiting_messages
from impact_observer.stamps import NS_PER_S, seconds_between
from impact_observer.states import Estimate, Vector

_T = TypeVar("_T")
_STATES = 2000
"""States kept of each topic, to find the truth at the stamp of an estimate."""
_WAITING = 200
"""States of a topic that may wait to be taken: older ones are dropped."""
_EVENTS = 2000
"""Messages of topics of events that may wait."""
_TAKING_PERIOD = 0.05
"""How often messages are taken, s."""
_VERDICTS = 8
"""Verdicts kept and shown of each observer."""
_DISCOVERY_PERIOD = 0.25
"""How often the graph is searched for new topics, s."""
_SETTLING_TIME = 3.5
"""Time without a new topic after which the topics are complete, s.

Fast DDS announces a node every 3 s, should the first announcements be lost.
"""
_HEALTH_TIME = 2.5
"""Time after all else that a single view waits for the health of observers, s of wall time."""
_NARROWEST = 58
"""Least columns of an observer beside another one."""
_BLOCKS, _ASCII = " ▁▂▃▄▅▆▇█", " .:-=+*#@"
_LEVELS = ("ok", "warning", "error", "stale")
_STYLES = ("", "bold yellow", "bold red", "bold red")
_SHARED = {interfaces.SIMULATED_CLOCK, interfaces.DIAGNOSTIC_ARRAYS}
"""Topics on which several nodes may publish."""


@dataclass(frozen=True, slots=True)
class StateLine:
    """A coordinate or a velocity.

    Attributes:
        name: name of the coordinate.
        unit: m or m/s.
        estimate: the estimate.
        truth: the true value at the same stamp; None where no plant publishes one.
        deviation: standard deviation of the estimate; None for a law without covariance.
    """

    name: str
    unit: str
    estimate: float
    truth: float | None = None
    deviation: float | None = None


@dataclass(frozen=True, slots=True)
class ObserverView:
    """An observer as the screen shows it.

    Attributes:
        name: the node's absolute name.
        law: the law; empty before the first state.
        epoch: stamp of ``t = 0`` of the events, ns; 0 before an event with an epoch.
        stamp: stamp of the lines, ns; 0 before the first state.
        lines: coordinates, then velocities.
        v: Lyapunov distance from the truth, J; None where V is not available.
        history: V over the window, J, oldest first.
        convergence: largest V distance between replicas, J; -1 for a single replica.
        synchronized: whether the replicas have converged; None before the first state.
        obstacle: why the replicas have not converged, by the last diagnostics; empty if unknown.
        bound: certified bound of V, J; -1 where no bound is certified, None before a message.
        closed: contacts that the replica holds closed.
        learned: estimated parameters: name, value, standard deviation, SI units.
        unit: of the coordinates; ``m`` where no model says otherwise.
        verdicts: the last verdicts with the latency of each, s, newest first.
        counts: number of verdicts so far, by ruling.
        health: level (0 ok, 1 warning, 2 error, 3 stale) and message of the diagnostics; None
            before the first.
        sensors: level and message of each sensor beside the impacts, by its name.
    """

    name: str
    law: str = ""
    epoch: int = 0
    stamp: int = 0
    lines: tuple[StateLine, ...] = ()
    v: float | None = None
    history: tuple[float, ...] = ()
    convergence: float | None = None
    synchronized: bool | None = None
    obstacle: str = ""
    bound: float | None = None
    closed: tuple[str, ...] = ()
    learned: tuple[tuple[str, float, float], ...] = ()
    unit: str = "m"
    verdicts: tuple[tuple[Verdict, float], ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    health: tuple[int, str] | None = None
    sensors: Mapping[str, tuple[int, str]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class View:
    """The plant and all observers at one moment.

    Attributes:
        clock: now, by the clock of the stamps, ns.
        simulated: whether ``/clock`` is that clock.
        epoch: stamp of ``t = 0``, ns; 0 before an event with an epoch, or if plants differ.
        model: name of the model; empty if no plant publishes one and none was given.
        truth: whether a plant publishes true states.
        impacts: events so far.
        last_impact: stamp, ns, and contacts of the last event; None before the first.
        observers: the observers, by name.
        warnings: what makes the view doubtful, one line each.
    """

    clock: int
    simulated: bool = False
    epoch: int = 0
    model: str = ""
    truth: bool = False
    impacts: int = 0
    last_impact: tuple[int, str] | None = None
    observers: tuple[ObserverView, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Whether every observer has an estimate, and where a plant is, the truth and V."""
        return bool(self.observers) and all(
            each.lines
            and (not self.truth or each.lines[0].truth is not None)
            and (not self.truth or not self.model or each.v is not None)
            for each in self.observers
        )


class Listener:
    """Keeps the last messages of plants and observers.

    Topics are those of ``io/interfaces.py`` in any namespace. The plant of an observer is in the
    namespace of the observer.

    Attributes:
        received: topics on which a message has arrived.
    """

    def __init__(
        self,
        observers: Collection[str] | None = None,
        system: System | Robot | None = None,
        *,
        window: float = 60.0,
    ) -> None:
        """Listen to all observers, or some.

        Args:
            observers: only these nodes, relative or absolute names; None for all.
            system: for V; None for the model that the plant publishes.
            window: time over which V is kept, s.

        Raises:
            UsageError: a name cannot be a node's.
        """
        names = [ObserverTopics.of_node(name).prefix for name in observers or ()]
        self.received: set[str] = set()
        self._wanted = None if observers is None else set(names)
        self._system, self._systems = system, dict[str, System | Robot]()
        self._window = round(window * NS_PER_S)
        self._observers = {name: ObserverView(name) for name in names}
        self._estimates: dict[str, dict[int, tuple[tuple[str, ...], Estimate]]] = {}
        self._truths: dict[str, dict[int, JointState]] = {}
        self._histories: dict[str, dict[int, float]] = {}
        self._simulated: int | None = None
        self._epochs: dict[str, int] = {}
        self._impacts = 0
        self._last_impact: tuple[int, str] | None = None
        self._warnings: dict[str, str] = {}
        self._handlers: dict[Interface, Callable[[str, AnyMessage], None]] = {
            interfaces.IMPACTS: self._on_event,
            interfaces.PLANT_MODEL: self._on_model,
            interfaces.PLANT_JOINT_STATES: self._on_truth,
            interfaces.OBSERVER_STATES: self._on_state,
            interfaces.OBSERVER_VERDICTS: self._on_verdict,
            interfaces.OBSERVER_BOUND: self._on_bound,
            interfaces.SIMULATED_CLOCK: self._on_clock,
            interfaces.DIAGNOSTIC_ARRAYS: self._on_diagnostics,
        }

    def wants(self, topic: str, type_name: str) -> bool:
        """Whether the messages of a topic are used."""
        kind = interface(topic)
        if kind not in self._handlers or kind.type != type_name:
            return False
        if self._wanted is None:
            return True
        return not kind.name.startswith("observer/") or _node(topic) in self._wanted

    def receive(self, topic: str, message: AnyMessage) -> None:
        """Take in a message, of ROS or of ``rosbags``, of a wanted topic."""
        self.received.add(topic)
        try:
            if (kind := interface(topic)) in self._handlers:
                self._handlers[kind](topic, message)
        except ImpactObserverError as error:
            self._warnings["message"] = f"not understood: {topic}: {error}"

    def note_publishers(self, counts: Mapping[str, int]) -> None:
        """Note how many nodes publish on each topic: of a plant or an observer only one."""
        shared = [
            topic for topic, n in counts.items() if n > 1 and interface(topic) not in _SHARED
        ]
        self._warnings.pop("shared", None)
        if shared:
            self._warnings["shared"] = (
                f"several nodes publish {', '.join(sorted(shared))}, and what is shown is a"
                " mixture: start one with another name (-r __node:=NAME), or on another"
                " ROS_DOMAIN_ID"
            )

    def view(self, wall: int) -> View:
        """Everything at the present time ``wall`` of the system's clock, ns."""
        epochs = set(self._epochs.values())
        systems = [*self._systems.values(), *([self._system] if self._system else [])]
        return View(
            clock=wall if self._simulated is None else self._simulated,
            simulated=self._simulated is not None,
            epoch=epochs.pop() if len(epochs) == 1 else 0,
            model=systems[0].name if systems else "",
            truth=bool(self._truths),
            impacts=self._impacts,
            last_impact=self._last_impact,
            observers=tuple(map(self._observer_view, sorted(self._observers))),
            warnings=tuple(self._warnings.values()),
        )

    def _update(self, name: str, **changes: Any) -> None:  # noqa: ANN401 (fields of a view)
        """Change the view of an observer."""
        self._observers[name] = replace(self._observers.get(name) or ObserverView(name), **changes)

    def _on_truth(self, topic: str, message: AnyMessage) -> None:
        state = read_joint_state(message)
        _keep(self._truths.setdefault(topic, {}), state.stamp, state)

    def _on_state(self, topic: str, message: AnyMessage) -> None:
        names, estimate = read_estimate(message)
        self._update(_node(topic))
        _keep(self._estimates.setdefault(_node(topic), {}), estimate.stamp, (names, estimate))

    def _on_event(self, topic: str, message: AnyMessage) -> None:
        event = read_event(message)
        self._impacts += 1
        if event.epoch:
            self._epochs[topic] = event.epoch
        self._last_impact = event.stamp, ", ".join(each.contact for each in event.switches)

    def _on_model(self, topic: str, message: AnyMessage) -> None:
        self._systems[topic] = simulated(parse_model(message.data, topic))

    def _on_verdict(self, topic: str, message: AnyMessage) -> None:
        verdict, latency = read_verdict(message)
        before = self._observers.get(_node(topic)) or ObserverView(_node(topic))
        counts = Counter(before.counts)
        counts[_ruling(verdict)] += not verdict.revises
        verdicts = ((verdict, latency), *before.verdicts[: _VERDICTS - 1])
        self._update(_node(topic), verdicts=verdicts, counts=dict(counts))

    def _on_bound(self, topic: str, message: AnyMessage) -> None:
        self._update(_node(topic), bound=float(message.v))

    def _on_clock(self, _: str, message: AnyMessage) -> None:
        stamp = read_stamp("Clock.clock", message.clock, earliest=0)
        if self._simulated is not None and stamp < self._simulated:  # a bag that begins again
            for each in (self._truths, self._estimates, self._histories):
                each.clear()
            self._impacts, self._last_impact = 0, None
            for name in self._observers:
                self._update(name, verdicts=(), counts={}, bound=None)
        self._simulated = stamp

    def _on_diagnostics(self, _: str, message: AnyMessage) -> None:
        for status in message.status:
            name, _, what = status.name.partition(": ")
            if name not in self._observers:
                continue
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            health = level, str(status.message)
            if what == "impacts":
                values = {each.key: str(each.value) for each in status.values}
                obstacle = values.get(interfaces.NOT_SYNCHRONIZED, "")
                self._update(name, health=health, obstacle=obstacle)
            elif what.startswith(SENSOR_STATUS):
                sensors = self._observers[name].sensors
                sensor = what.removeprefix(SENSOR_STATUS)
                self._update(name, sensors={**sensors, sensor: health})

    def _observer_view(self, name: str) -> ObserverView:
        """View of an observer: its newest estimate, and the truth at the same stamp."""
        epoch = self._epochs.get(_beside(name, interfaces.IMPACTS), 0)
        view = replace(self._observers[name], epoch=epoch)
        if not (estimates := self._estimates.get(name)):
            return view
        truths = self._truths.get(_beside(name, interfaces.PLANT_JOINT_STATES), {})
        newest = next(reversed(estimates))
        stamp = next((each for each in reversed(estimates) if each in truths), newest)
        names, estimate = estimates[stamp]
        truth = _ordered(truths[stamp], names) if stamp in truths else None
        v, system = self._distance(name, names, estimate, truth), self._system_of(name)
        unit = "m" if system is None else unit_of("m", system.unit)
        return replace(
            view,
            law=estimate.law,
            stamp=stamp,
            lines=_state_lines(names, _units(system, unit, names), estimate, truth),
            v=v,
            history=tuple(self._histories.get(name, {}).values()),
            convergence=estimate.convergence,
            synchronized=estimate.synchronized,
            obstacle="" if estimate.synchronized else view.obstacle,
            closed=estimate.closed,
            learned=estimate.parameters,
            unit=unit,
        )

    def _system_of(self, name: str) -> System | Robot | None:
        """The system of an observer; None if no model of it is known."""
        return self._system or self._systems.get(_beside(name, interfaces.PLANT_MODEL))

    def _distance(
        self,
        name: str,
        names: tuple[str, ...],
        estimate: Estimate,
        truth: tuple[Vector, Vector] | None,
    ) -> float | None:
        """V of an estimate, J; None without a truth or a model of the same coordinates."""
        system = self._system_of(name)
        if truth is None or system is None or sorted(system.coordinates) != sorted(names):
            return None
        order = [names.index(each) for each in system.coordinates]
        pairs = (truth, (estimate.q, estimate.u))
        x, estimated = (np.concatenate([q[order], u[order]])[None] for q, u in pairs)
        history = self._histories.setdefault(name, {})
        v = float(energies(system, x, errors_of(system, x, estimated))[0])
        history[estimate.stamp] = v
        for old in [each for each in history if each < estimate.stamp - self._window]:
            del history[old]
        return v


def _node(topic: str) -> str:
    """The absolute name of the node of a topic."""
    return topic.rpartition("/")[0]


def _beside(observer: str, kind: Interface) -> str:
    """The topic of the plant beside an observer."""
    return ObserverTopics.of_node(observer).topic(kind)


def _keep(states: dict[int, _T], stamp: int, state: _T) -> None:
    """Keep a state by its stamp, ns, as the newest, and drop the oldest."""
    states.pop(stamp, None)
    states[stamp] = state
    if len(states) > _STATES:
        del states[next(iter(states))]


def _ruling(verdict: Verdict) -> str:
    """The ruling in words."""
    return verdict.ruling.name.lower().replace("_", " ")


def _ordered(truth: JointState, names: tuple[str, ...]) -> tuple[Vector, Vector] | None:
    """The truth in the order of ``names``; None if the truth has other coordinates."""
    try:
        state = truth.ordered(names)
    except MessageError:
        return None
    return state.q, state.u


def _units(system: System | Robot | None, unit: str, names: tuple[str, ...]) -> list[str]:
    """The unit of each coordinate: ``unit``, unless joints of a robot have their own."""
    own = (
        dict(zip(system.coordinates, system.units, strict=True))
        if isinstance(system, Robot)
        else {}
    )
    return [own.get(name, unit) for name in names]


def _state_lines(
    names: tuple[str, ...],
    units: list[str],
    estimate: Estimate,
    truth: tuple[Vector, Vector] | None,
) -> tuple[StateLine, ...]:
    """Coordinates in their ``units``, then velocities."""
    size = 2 * len(names)
    values = np.concatenate([estimate.q, estimate.u]).tolist()
    true = [None] * size if truth is None else np.concatenate(truth).tolist()
    variances = np.diag(estimate.covariance) if estimate.covariance.size else None
    deviations = [None] * size if variances is None else np.sqrt(variances.clip(0.0)).tolist()
    units = [*units, *map(per_second, units)]
    return tuple(
        StateLine(*each)
        for each in zip((*names, *names), units, values, true, deviations, strict=True)
    )


def line(view: View) -> str:
    """A view in one line, for a file or a pipe."""
    parts = [f"{_time(view)}, {_impacts(view)}"]
    for each in view.observers:
        words = [f"V {_distance(each, view)}"]
        if each.convergence is not None and each.convergence >= 0:
            words.append(f"convergence {each.convergence:.2e} J")
        if each.synchronized is not None:
            words.append(_agreement(each))
        if each.health is not None and each.health[0]:
            words.append(_health(each))
        parts.append(f"{each.name.lstrip('/')}: {', '.join(words)}")
    if not view.observers:
        parts.append("no estimate yet")
    return "; ".join([*parts, *(f"warning: {each}" for each in view.warnings)])


def screen(view: View, console: Console, height: int | None = None) -> RenderableType:
    """A view as a picture for the terminal.

    Verdicts, then observers, are left out until the picture fits.

    Args:
        view: one moment.
        console: the terminal.
        height: rows of the terminal; None for as many as the picture needs.
    """
    head = _head(view)
    if not view.observers:
        waiting = "waiting for observers: no node publishes observer/state or observer_<law>/state"
        return Group(*head, Panel(Text(waiting)))
    levels = _ASCII if console.options.ascii_only else _BLOCKS
    columns = max(min(len(view.observers), console.width // _NARROWEST), 1)
    shown, verdicts = len(view.observers), _VERDICTS
    while True:
        grid = Table.grid(expand=True)
        for _ in range(columns):
            grid.add_column(ratio=1)
        panels = [_panel(each, view, verdicts, levels) for each in view.observers[:shown]]
        for k in range(0, shown, columns):
            grid.add_row(*panels[k : k + columns])
        hidden = ", ".join(each.name.lstrip("/") for each in view.observers[shown:])
        foot = [literal_text(f"shown with --observers: {hidden}", "dim")] if hidden else []
        picture = Group(*head, grid, *foot)
        if height is None or len(console.render_lines(picture, pad=False)) <= height:
            return picture
        if verdicts:
            verdicts //= 2
        elif shown > 1:
            shown -= 1
        else:
            return picture  # the terminal cuts the end of the panel


def _head(view: View) -> list[RenderableType]:
    """The plant, and warnings."""
    clock = "/clock" if view.simulated else "system clock"
    words = [view.model or "no model", f"{_time(view)} ({clock})", _impacts(view)]
    if not view.truth:
        words.append("no truth")
    warnings = [literal_text(each, "bold yellow") for each in view.warnings]
    return [literal_text("   ".join(words), "bold"), *warnings]


def _panel(view: ObserverView, whole: View, verdicts: int, levels: str) -> Panel:
    """A framed panel of one observer."""
    parts: list[RenderableType] = [Text(f"V  {_distance(view, whole)}")]
    if view.history:
        parts.append(Text(_chart(view.history, levels), "cyan", no_wrap=True, overflow="crop"))
    parts += map(literal_text, _own_error(view))
    level = 0 if view.health is None else min(view.health[0], len(_STYLES) - 1)
    parts.append(literal_text(f"health  {_health(view)}", _STYLES[level]))
    parts += [literal_text(f"sensor  {name}: {text}") for name, (_, text) in view.sensors.items()]
    parts.append(_table(view.lines) if view.lines else Text("no estimate yet"))
    counts = [f"{n} {ruling}" for ruling, n in sorted(view.counts.items())]
    parts.append(Text(f"events  {', '.join(counts) or 'waiting for impacts ...'}"))
    epoch = view.epoch or whole.epoch
    parts += [_verdict(*each, epoch) for each in view.verdicts[:verdicts]]
    law = f" ({view.law})" if view.law else ""
    title = literal_text(f"{view.name.lstrip('/')}{law}")
    return Panel(Group(*parts), title=title, title_align="left")


def _own_error(view: ObserverView) -> list[str]:
    """The observer's own report of its error."""
    rows = []
    if view.convergence is not None:
        single = view.convergence < 0
        spread = "one replica" if single else f"{view.convergence:.2e} J between replicas"
        rows.append(f"convergence  {spread}, {_agreement(view)}")
    if view.bound is not None:
        bound = f"V <= {view.bound:.3g} J" if view.bound >= 0 else "none"
        rows.append(f"bound  {bound} certified")
    rows += [
        f"learned  {with_unit(name, view.unit)} {figure(value, deviation=deviation)}"
        for name, value, deviation in view.learned
    ]
    if view.closed:
        rows.append(f"closed  {', '.join(view.closed)}")
    return rows


def _agreement(view: ObserverView) -> str:
    """Whether the replicas have converged, and why not."""
    if view.synchronized:
        return "synchronized"
    return f"not synchronized: {view.obstacle}" if view.obstacle else "not synchronized"


def _table(lines: Sequence[StateLine]) -> Table:
    """Estimates against the truth."""
    columns = {
        "": [each.name for each in lines],
        " ": [each.unit for each in lines],
        "estimate": [_value(each.estimate) for each in lines],
        "truth": ["" if each.truth is None else _value(each.truth) for each in lines],
        "error": [
            "" if each.truth is None else f"{each.estimate - each.truth:+.1e}" for each in lines
        ],
        "std. dev.": ["" if each.deviation is None else f"{each.deviation:.1e}" for each in lines],
    }
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    columns = {heading: cells for heading, cells in columns.items() if any(cells)}
    for heading in columns:
        table.add_column(heading, justify="right" if heading.strip() else "left", no_wrap=True)
    for cells in zip(*columns.values(), strict=True):
        table.add_row(*map(literal_text, cells))
    return table


def _value(value: float) -> str:
    """A number of constant width below 1e4."""
    return f"{value:+.6f}" if abs(value) < 1e4 else f"{value:+.5e}"


def _chart(values: Sequence[float], levels: str, width: int = 32) -> str:
    """Positive values over time as bars on a logarithmic scale, with the least and the largest."""
    step = max(len(values) / width, 1.0)
    logarithms = [
        math.log10(max(values[int(k * step)], 1e-300)) for k in range(min(len(values), width))
    ]
    low, high = min(logarithms), max(logarithms)
    most = len(levels) - 1
    bars = "".join(
        levels[1 + round((each - low) / max(high - low, 1e-9) * (most - 1))] for each in logarithms
    )
    return f"{bars}  {10**low:.0e} to {10**high:.0e} J"


def _distance(view: ObserverView, whole: View) -> str:
    """V at present, or why V is missing."""
    if view.v is not None:
        return f"{view.v:.2e} J"
    if not whole.truth:
        return "unknown: no truth"
    if not view.stamp:
        return "unknown: no estimate yet"
    if all(each.truth is None for each in view.lines):
        return "unknown: no truth at the stamp of the estimate"
    return "unknown: no model of the plant; give --model"


def _verdict(verdict: Verdict, latency: float, epoch: int) -> Text:
    """A verdict as a line of text."""
    words = [
        f"{seconds_between(epoch, verdict.stamp):>13.6f} s",
        verdict.contact or "all",
        _ruling(verdict),
        f"{verdict.innovation:.1f} std. dev." if verdict.innovation >= 0 else "",
        verdict.reason,
        f"{latency * 1e3:.1f} ms" if latency > 0 else "",
    ]
    shown = literal_text("  ".join(filter(None, words)))
    shown.no_wrap, shown.overflow = True, "ellipsis"
    return shown


def _health(view: ObserverView) -> str:
    """Level and message of the diagnostics."""
    if view.health is None:
        return "no diagnostics yet"
    level, message = view.health
    return f"{_LEVELS[min(level, len(_LEVELS) - 1)]}: {message}"


def _impacts(view: View) -> str:
    """Number of impacts, and the last one."""
    if view.last_impact is None:
        return "waiting for impacts ..."
    stamp, contacts = view.last_impact
    ago = seconds_between(stamp, view.clock)
    return f"{view.impacts} impacts, last {ago:.1f} s ago ({contacts})"


def _time(view: View) -> str:
    """The present time since the epoch, as text."""
    return f"t = {seconds_between(view.epoch, view.clock):.2f} s"


class Watcher:
    """Hands the messages of wanted topics to a :class:`Listener`.

    A topic is subscribed to when its first publisher appears, with the quality of service that
    all its publishers offer, so that earlier events and the model are received too.
    """

    def __init__(self, node: Node, listener: Listener) -> None:
        """Subscribe with ``node``, which is not spun: :meth:`take` takes the messages."""
        self._node = node
        self._listener = listener
        self._subscriptions: dict[str, Subscription] = {}
        self._changed = time.monotonic()

    def has_all(self) -> bool:
        """Whether no new topic appears, and all but the bounds have brought a message."""
        waiting = self._subscriptions.keys() - self._listener.received
        settled = time.monotonic() > self._changed + _SETTLING_TIME
        return settled and all(interface(each) == interfaces.OBSERVER_BOUND for each in waiting)

    def discover(self) -> None:
        """Subscribe to the topics that have appeared since the last call; count publishers."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic not in self._subscriptions and self._listener.wants(topic, types[0]):
                self._subscribe(topic, types[0])
        self._listener.note_publishers(
            {topic: self._node.count_publishers(topic) for topic in self._subscriptions}
        )

    def take(self) -> None:
        """Hand over the messages that have arrived since the last call."""
        for topic, subscription in self._subscriptions.items():
            for message, _ in waiting_messages(subscription, _EVENTS):
                self._listener.receive(topic, message)

    def _subscribe(self, topic: str, type_name: str) -> None:
        """Receive the messages of a topic, if the topic has a publisher."""
        if not (publishers := self._node.get_publishers_info_by_topic(topic)):
            return
        self._changed = time.monotonic()
        offer = common_offer(topic, publishers)
        depth = _EVENTS if offer.transient_local else _WAITING
        self._subscriptions[topic] = self._node.create_subscription(
            message_class(type_name),
            topic,
            lambda _: None,
            qos_profile(replace(offer, depth=depth)),
        )


def watch(
    listener: Listener,
    show: Callable[[View], None],
    *,
    rate: float,
    duration: float = math.inf,
    once: bool = False,
) -> View:
    """Receive until SIGINT, SIGTERM or the end of ``duration``.

    Args:
        listener: receives the messages.
        show: called with each view.
        rate: rate of views, Hz.
        duration: how long, s of wall time.
        once: whether to end as soon as every topic has brought a message and the view is
            complete, with the health of observers if that comes within seconds.

    Returns:
        The last view.
    """
    with Stop() as stop, ros_node("watch") as (node, _):
        watcher = Watcher(node, listener)
        begin = due = search = time.monotonic()
        given_up = math.inf
        while not stop.requested and (now := time.monotonic()) < begin + duration:
            if now >= search:
                search = now + _DISCOVERY_PERIOD
                watcher.discover()
            watcher.take()
            if now >= due:
                due = now + 1.0 / rate
                view = listener.view(time.time_ns())
                show(view)
                if once and view.is_complete and watcher.has_all():
                    given_up = min(given_up, now + _HEALTH_TIME)
                    if now >= given_up or all(each.health for each in view.observers):
                        break
            time.sleep(_TAKING_PERIOD)
        return listener.view(time.time_ns())
