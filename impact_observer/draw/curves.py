# SPDX-License-Identifier: Apache-2.0
"""The list of curves worth plotting of a plant and its observers, for every plotting tool.

It is made for the observers of a bag, or for the names of observer nodes. The layouts of
:mod:`impact_observer.draw.layouts` are written from it.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import product
from pathlib import Path

from impact_observer.draw.observer_topics import ObserverTopics, observers_in
from impact_observer.errors import UnfitBagError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import system_of
from impact_observer.model import System, read_model
from impact_observer.model.free_parameters import with_unit
from impact_observer.model.system import UNKNOWN_UNIT


class CurveGroup(Enum):
    """Groups of curves; the values are titles of tabs."""

    POSITIONS = "positions"
    VELOCITIES = "velocities"
    ERRORS = "errors"
    DISTANCE = "distance"
    DEVIATIONS = "standard deviations"
    EVENTS = "events"
    LEARNED = "learned"
    DIAGNOSTICS = "diagnostics"


class Transform(Enum):
    """The function of a value that is drawn; plotting tools have no logarithmic axis."""

    NONE = ""
    LOGARITHM = "log10"
    ROOT = "sqrt"


@dataclass(frozen=True, slots=True)
class FieldStep:
    """One step of the path from a message to a number in it.

    Attributes:
        field: its name.
        index: of the element of an array; None if the field is none, or ``where`` chooses.
        where: name and value of a field by which elements are chosen; empty for no choice.
    """

    field: str
    index: int | None = None
    where: tuple[str, str] = ("", "")


@dataclass(frozen=True, slots=True)
class Curve:
    """A number in the messages of a topic, over their stamps.

    Attributes:
        name: for the legend.
        source: ``plant`` or an observer's name; curves of one source have one colour.
        topic: the absolute name.
        steps: the path from the message to the number.
        group: the tab in which it is shown.
        plot: title of the axes that it shares with others, with the unit.
        element: the coordinate, or the model that diagnostics are of; empty for neither.
        transform: the function of the value that is drawn.
        is_state: whether it is one of a few states, not a quantity.
    """

    name: str
    source: str
    topic: str
    steps: tuple[FieldStep, ...]
    group: CurveGroup
    plot: str
    element: str = ""
    transform: Transform = Transform.NONE
    is_state: bool = False


_V = "V and its bound: log10 of J"
_VERDICT = "verdict: 0 applied, 1 rejected, 2 inserted, 3 and more refused"
_DISTANCES = (
    ("V", interfaces.MONITOR_ERROR, "v", _V),
    ("bound of V", interfaces.OBSERVER_BOUND, "v", _V),
    ("convergence", interfaces.OBSERVER_STATES, "convergence", "convergence: log10 of J"),
)
"""V and what bounds it: name, interface, field, plot."""
_OF_SAMPLES = "innovation of samples [standard deviations]"
_EVENTS = (
    ("verdict", interfaces.OBSERVER_VERDICTS, _VERDICT, True),
    ("synchronized", interfaces.OBSERVER_STATES, "synchronized: 0 or 1", True),
    ("latency", interfaces.OBSERVER_VERDICTS, "latency [s]", False),
    ("innovation", interfaces.OBSERVER_VERDICTS, "innovation [standard deviations]", False),
    ("normalized", interfaces.OBSERVER_MEASUREMENTS, _OF_SAMPLES, False),
)
"""What observers publish of events: field, interface, plot, and whether it is a state."""
_DIAGNOSTICS = (
    "events applied",
    "events rejected",
    "impacts inserted",
    "missing sequence numbers",
    "estimates corrected",
    "estimates passed over",
    "large innovations",
    "largest latency [s]",
)
"""Keys of an observer's diagnostics whose values are always numbers."""
_MOTION = (
    (CurveGroup.POSITIONS, "position", ""),
    (CurveGroup.VELOCITIES, "velocity", "/s"),
)
"""Fields of joint states with their groups, and what follows the unit of the coordinates."""


def curves(
    system: System, observers: Sequence[ObserverTopics], topics: Iterable[str] | None = None
) -> tuple[Curve, ...]:
    """The list.

    Args:
        system: names coordinates and contacts, and itself in the diagnostics.
        observers: whose estimates are drawn, each with the plant in its namespace.
        topics: only curves of these absolute names, such as those of a bag; None for all.

    Returns:
        Curves in the order in which they are shown.

    Raises:
        UsageError: there is no observer.
    """
    if not observers:
        raise UsageError("no observer: there is nothing to draw beside the plant; name one")
    every = [*_plants(system, observers)]
    for each in observers:
        every += [*_motion(system, each), *_accuracy(system, each), *_events(system, each)]
    wanted = None if topics is None else set(topics)
    order = [*CurveGroup]
    return tuple(
        sorted(
            (each for each in every if wanted is None or each.topic in wanted),
            key=lambda each: order.index(each.group),
        )
    )


def curves_of_model(model: str, observers: Sequence[str]) -> tuple[Curve, ...]:
    """The curves of a model and of observer nodes with the given names.

    Args:
        model: a model file or a sample's name.
        observers: names of nodes, which may be given twice.

    Raises:
        UsageError, ModelError: a name that no node can have, or the model cannot be read.
    """
    topics = dict.fromkeys(ObserverTopics.of_node(name) for name in observers)
    return curves(read_model(model).system, list(topics))


def curves_of_bag(
    bag: Path, observers: Sequence[str] | None, model: str | None
) -> tuple[tuple[Curve, ...], tuple[str, ...]]:
    """The curves that a bag has messages for, and all topics that have messages.

    Args:
        bag: with estimates.
        observers: names of nodes; None for all in the bag.
        model: a model file or a sample's name; None for the model in the bag.

    Raises:
        BagError: the bag cannot be read, or has no estimates.
        UsageError, ModelError: an observer that is not in it, or the model cannot be read.
    """
    with BagReader(bag) as reader:
        system, found = system_of(reader, model), observers_in(reader)
        if not found:
            raise UnfitBagError(
                f"{bag}: has no estimates; make them with observe, or name a model"
            )
        by_prefix = {each.prefix: each for each in found}
        names = by_prefix if observers is None else observers
        wanted = dict.fromkeys(ObserverTopics.of_node(name).prefix for name in names)
        if missing := [prefix for prefix in wanted if prefix not in by_prefix]:
            present = ", ".join(by_prefix)
            raise UsageError(f"{bag}: no observer {missing[0]}; in the bag: {present}")
        topics = tuple(name for name, topic in reader.topics.items() if topic.count)
    return curves(system, [by_prefix[prefix] for prefix in wanted], topics), topics


def _plants(system: System, observers: Sequence[ObserverTopics]) -> Iterator[Curve]:
    """True motion, and how each contact switches, of each plant once; of several by namespace."""
    joints = interfaces.PLANT_JOINT_STATES
    rigs = {each.topic(joints): each for each in observers}
    for topic, observer in rigs.items():
        rig = topic.removesuffix(joints.name).lstrip("/") if len(rigs) > 1 else ""
        yield from _coordinates(system, "plant", f"{rig}plant", topic)
        for name in system.contact_names:
            yield Curve(
                f"{rig}{name}",
                "plant",
                observer.topic(interfaces.IMPACTS),
                (FieldStep("switches", where=("contact", name)), FieldStep("kind")),
                CurveGroup.EVENTS,
                "kind: 0 impact, 1 close, 2 open",
                is_state=True,
            )


def _coordinates(system: System, source: str, label: str, topic: str) -> Iterator[Curve]:
    """Positions and velocities in joint states; those of all sources share a plot."""
    for (group, field, per), (i, name) in product(_MOTION, enumerate(system.coordinates)):
        steps, plot = (FieldStep(field, i),), f"{name} {field} [{_unit(system)}{per}]"
        yield Curve(f"{name} {label}", source, topic, steps, group, plot, element=name)


def _of_observer(
    observer: ObserverTopics,
    label: str,
    interface: Interface,
    group: CurveGroup,
    plot: str,
    *steps: FieldStep,
) -> Curve:
    """A curve of an observer; its name is the label and the observer's name."""
    name = observer.name
    return Curve(f"{label} {name}", name, observer.topic(interface), steps, group, plot)


def _motion(system: System, observer: ObserverTopics) -> Iterator[Curve]:
    """Estimates, and their difference from the truth by the monitor."""
    name = observer.name
    yield from _coordinates(system, name, name, observer.topic(interfaces.OBSERVER_JOINT_STATES))
    error, group = interfaces.MONITOR_ERROR, CurveGroup.ERRORS
    for (_, field, per), (i, name) in product(_MOTION, enumerate(system.coordinates)):
        step, plot = FieldStep(f"{field}_error", i), f"{name} {field} error [{_unit(system)}{per}]"
        yield _of_observer(observer, name, error, group, plot, step)


def _unit(system: System) -> str:
    """Of the coordinates; m where it is not known, as titles are short."""
    return "m" if system.unit == UNKNOWN_UNIT else system.unit


def _accuracy(system: System, observer: ObserverTopics) -> Iterator[Curve]:
    """V, its bound, the distance of the replicas; standard deviations; learned parameters."""
    states, n = interfaces.OBSERVER_STATES, system.n
    for label, interface, field, plot in _DISTANCES:
        if observer.bounded or interface is not interfaces.OBSERVER_BOUND:
            step, group = FieldStep(field), CurveGroup.DISTANCE
            curve = _of_observer(observer, label, interface, group, plot, step)
            yield replace(curve, transform=Transform.LOGARITHM)
    for k in range(2 * n if observer.filters else 0):
        step, group = FieldStep("covariance", k * (2 * n + 1)), CurveGroup.DEVIATIONS
        of, per = ("velocities", "/s") if k >= n else ("positions", "")
        plot = f"standard deviations of {of} [{_unit(system)}{per}]"
        curve = _of_observer(observer, system.coordinates[k % n], states, group, plot, step)
        yield replace(curve, transform=Transform.ROOT)
    for i, parameter in enumerate(observer.learned):
        words, plot = parameter.replace("_", " "), with_unit(parameter)
        for field, label in (
            ("parameter", words),
            ("parameter_deviation", f"{words} standard deviation"),
        ):
            step, group = FieldStep(field, i), CurveGroup.LEARNED
            yield _of_observer(observer, label, states, group, plot, step)


def _events(system: System, observer: ObserverTopics) -> Iterator[Curve]:
    """Verdicts, latency, innovations; level and values of the diagnostics."""
    for field, interface, plot, is_state in _EVENTS:
        if observer.filters or field not in {"innovation", "normalized"}:
            step, group = FieldStep(field), CurveGroup.EVENTS
            curve = _of_observer(observer, field, interface, group, plot, step)
            yield replace(curve, is_state=is_state)
    interface, group = interfaces.DIAGNOSTIC_ARRAYS, CurveGroup.DIAGNOSTICS
    status = FieldStep("status", where=("name", f"{observer.prefix}: impacts"))
    plot = "level: 0 ok, 1 warning, 2 error"
    level = _of_observer(observer, "level", interface, group, plot, status, FieldStep("level"))
    yield replace(level, element=system.name)
    for key in _DIAGNOSTICS:
        steps = (status, FieldStep("values", where=("key", key)), FieldStep("value"))
        curve = _of_observer(observer, key, interface, group, key, *steps)
        yield replace(curve, element=system.name)
