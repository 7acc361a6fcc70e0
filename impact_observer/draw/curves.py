"""The list of curves worth plotting of a plant and its observers, for every plotting tool.

It is made for the observers of a bag, or for the names of observer nodes. The layouts of
:mod:`impact_observer.draw.layouts` are written from it.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from impact_observer.draw.observer_topics import ObserverTopics, observers_in
from impact_observer.errors import BagError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import system_of
from impact_observer.model import System, read_model
from impact_observer.model.free_parameters import with_unit


class CurveGroup(Enum):
    """Groups of curves; the values are titles of tabs."""

    POSITIONS = "positions"
    VELOCITIES = "velocities"
    ERRORS = "errors"
    DISTANCE = "distance"
    DEVIATIONS = "deviations"
    EVENTS = "events"
    LEARNT = "learnt"
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
_DISTANCES = (
    ("V", interfaces.MONITOR_ERROR, "v", _V),
    ("bound of V", interfaces.OBSERVER_BOUND, "v", _V),
    ("convergence", interfaces.OBSERVER_STATES, "convergence", "convergence: log10 of J"),
)
"""V and what bounds it: name, interface, field, plot."""
_VERDICT = "verdict: 0 applied, 1 rejected, 2 inserted, 3 and more refused"
_EVENTS = (
    ("verdict", interfaces.OBSERVER_VERDICTS, _VERDICT, True),
    ("synchronized", interfaces.OBSERVER_STATES, "synchronized: 0 or 1", True),
    ("latency", interfaces.OBSERVER_VERDICTS, "latency [s]", False),
    ("innovation", interfaces.OBSERVER_VERDICTS, "innovation [standard deviations]", False),
)
"""What observers publish of events: field, interface, plot, and whether it is a state."""
_DIAGNOSTICS = (
    "events applied",
    "events rejected",
    "impacts inserted",
    "missing sequence numbers",
    "estimates corrected",
    "estimates passed over",
    "surprising events",
    "largest latency [s]",
)
"""Keys of an observer's diagnostics whose values are always numbers."""


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
    every = [
        *_states(system, observers, CurveGroup.POSITIONS, "position", "m"),
        *_states(system, observers, CurveGroup.VELOCITIES, "velocity", "m/s"),
        *_errors(system, observers, "position", "m"),
        *_errors(system, observers, "velocity", "m/s"),
        *_impacts(system, observers),
    ]
    for curves_of in (_distances, _deviations, _events, _learnt, _diagnostics):
        every += [curve for each in observers for curve in curves_of(system, each)]
    wanted = None if topics is None else set(topics)
    return tuple(each for each in every if wanted is None or each.topic in wanted)


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
            raise BagError(f"{bag}: has no estimates; make them with observe, or name a model")
        by_prefix = {each.prefix: each for each in found}
        names = by_prefix if observers is None else observers
        wanted = dict.fromkeys(ObserverTopics.of_node(name).prefix for name in names)
        if missing := [prefix for prefix in wanted if prefix not in by_prefix]:
            present = ", ".join(by_prefix)
            raise UsageError(f"{bag}: no observer {missing[0]}; in the bag: {present}")
        topics = tuple(name for name, topic in reader.topics.items() if topic.count)
    return curves(system, [by_prefix[prefix] for prefix in wanted], topics), topics


def _states(
    system: System, observers: Sequence[ObserverTopics], group: CurveGroup, field: str, unit: str
) -> Iterator[Curve]:
    """Truth and estimates of each coordinate, in one plot."""
    truths = _plant_topics(observers, interfaces.PLANT_JOINT_STATES)
    sources = [("plant", f"{rig}plant", topic) for rig, topic in truths]
    joints = interfaces.OBSERVER_JOINT_STATES
    sources += [(each.name, each.name, each.topic(joints)) for each in observers]
    for i, name in enumerate(system.coordinates):
        for source, label, topic in sources:
            steps = (FieldStep(field, i),)
            plot = f"{name} {field} [{unit}]"
            yield Curve(f"{name} {label}", source, topic, steps, group, plot, element=name)


def _plant_topics(
    observers: Sequence[ObserverTopics], interface: Interface
) -> Iterator[tuple[str, str]]:
    """Each topic of the plants of observers once, with its namespace if there are several."""
    topics = dict.fromkeys(each.topic(interface) for each in observers)
    for topic in topics:
        rig = topic.removesuffix(interface.name).lstrip("/")
        yield rig if len(topics) > 1 else "", topic


def _of_observer(
    observer: ObserverTopics,
    label: str,
    interface: Interface,
    *steps: FieldStep,
    group: CurveGroup,
    plot: str,
) -> Curve:
    """A curve of an observer; its name is the label and the observer's name."""
    name = observer.name
    return Curve(f"{label} {name}", name, observer.topic(interface), steps, group, plot)


def _errors(
    system: System, observers: Sequence[ObserverTopics], quantity: str, unit: str
) -> Iterator[Curve]:
    """Estimate minus truth of each coordinate, from the monitors."""
    error, group = interfaces.MONITOR_ERROR, CurveGroup.ERRORS
    for i, name in enumerate(system.coordinates):
        step, plot = FieldStep(f"{quantity}_error", i), f"{name} {quantity} error [{unit}]"
        for each in observers:
            yield _of_observer(each, name, error, step, group=group, plot=plot)


def _impacts(system: System, observers: Sequence[ObserverTopics]) -> Iterator[Curve]:
    """How each contact switches: 0 IMPACT, 1 CLOSE, 2 OPEN."""
    plot = "kind of switch: 0 impact, 1 close, 2 open"
    for rig, topic in _plant_topics(observers, interfaces.IMPACTS):
        for name in system.contact_names:
            steps = (FieldStep("switches", where=("contact", name)), FieldStep("kind"))
            label = f"{rig}{name}"
            yield Curve(label, "plant", topic, steps, CurveGroup.EVENTS, plot, is_state=True)


def _distances(_: System, observer: ObserverTopics) -> Iterator[Curve]:
    """V, its bound if the observer has one, and the distance of the replicas."""
    group = CurveGroup.DISTANCE
    for label, interface, field, plot in _DISTANCES:
        if observer.bounded or interface is not interfaces.OBSERVER_BOUND:
            curve = _of_observer(
                observer, label, interface, FieldStep(field), group=group, plot=plot
            )
            yield replace(curve, transform=Transform.LOGARITHM)


def _deviations(system: System, observer: ObserverTopics) -> Iterator[Curve]:
    """Standard deviations: square roots of the covariance's diagonal, if there is one."""
    interface, group, n = interfaces.OBSERVER_STATES, CurveGroup.DEVIATIONS, system.n
    for k in range(2 * n if observer.filters else 0):
        step = FieldStep("covariance", k * (2 * n + 1))
        plot = "velocity deviations [m/s]" if k >= n else "position deviations [m]"
        name = system.coordinates[k % n]
        curve = _of_observer(observer, name, interface, step, group=group, plot=plot)
        yield replace(curve, transform=Transform.ROOT)


def _events(_: System, observer: ObserverTopics) -> Iterator[Curve]:
    """Verdicts, latency, and the innovation if the observer has one."""
    group = CurveGroup.EVENTS
    for field, interface, plot, is_state in _EVENTS:
        if observer.filters or field != "innovation":
            curve = _of_observer(
                observer, field, interface, FieldStep(field), group=group, plot=plot
            )
            yield replace(curve, is_state=is_state)


def _learnt(_: System, observer: ObserverTopics) -> Iterator[Curve]:
    """Value and standard deviation of each parameter that is estimated with the state."""
    interface, group = interfaces.OBSERVER_STATES, CurveGroup.LEARNT
    for i, parameter in enumerate(observer.learnt):
        words, plot = parameter.replace("_", " "), with_unit(parameter)
        for field, label in (("parameter", words), ("parameter_deviation", f"{words} deviation")):
            yield _of_observer(
                observer, label, interface, FieldStep(field, i), group=group, plot=plot
            )


def _diagnostics(system: System, observer: ObserverTopics) -> Iterator[Curve]:
    """The level and the figures of an observer's diagnostics."""
    interface, group = interfaces.DIAGNOSTIC_ARRAYS, CurveGroup.DIAGNOSTICS
    status = FieldStep("status", where=("name", f"{observer.prefix}: impacts"))
    paths: dict[str, tuple[FieldStep, ...]] = {"level": (status, FieldStep("level"))}
    for key in _DIAGNOSTICS:
        paths[key] = (status, FieldStep("values", where=("key", key)), FieldStep("value"))
    for label, steps in paths.items():
        plot = "level: 0 ok, 1 warning, 2 error" if label == "level" else label
        curve = _of_observer(observer, label, interface, *steps, group=group, plot=plot)
        yield replace(curve, element=system.name)
