"""The one list of curves: what is worth plotting of a plant and its observers.

A curve is said in no tool's language: the writers of :mod:`impact_observer.draw.layouts` translate
it. What the list is made from is a bag, or the names that observer nodes go by.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice
from typing import cast

from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface
from impact_observer.io.messages import EstimateMessage
from impact_observer.io.reader import BagReader
from impact_observer.model import System
from impact_observer.model.free_parameters import with_unit
from impact_observer.stamps import NS_PER_S

_BOUNDED = ("geometric", "unilateral")
"""Laws that certify a bound of V."""
_FILTERS = ("minimum-variance",)
"""Laws that carry a covariance and learn the accuracy of the clock."""
_TAIL = 2 * NS_PER_S
"""How much of the end of a bag is looked at to see what an observer says, ns."""
_FIGURES = (
    "events applied",
    "events rejected",
    "impacts inserted",
    "missing sequence numbers",
    "estimates corrected",
    "estimates passed over",
    "surprising events",
    "largest latency [s]",
)
"""Figures of an observer's diagnostics that are always numbers."""


class CurveGroup(Enum):
    """What curves tell of together; the values are titles."""

    POSITIONS = "positions"
    VELOCITIES = "velocities"
    ERRORS = "errors"
    DISTANCE = "distance"
    DEVIATIONS = "deviations"
    EVENTS = "events"
    LEARNT = "learnt"
    DIAGNOSTICS = "diagnostics"


class Shown(Enum):
    """What is done to a value before it is drawn; plotting tools have no logarithmic axis."""

    AS_IT_IS = ""
    LOGARITHM = "log10"
    ROOT = "sqrt"


@dataclass(frozen=True, slots=True)
class CurveStep:
    """One step into a message.

    Attributes:
        field: its name.
        index: of the element of an array; None where the field is none, or ``where`` chooses.
        where: name and value of a field of the elements that are meant; empty for no choice.
    """

    field: str
    index: int | None = None
    where: tuple[str, str] = ("", "")


@dataclass(frozen=True, slots=True)
class Curve:
    """A number in the messages of a topic, over their stamps.

    Attributes:
        name: for the legend.
        source: whose it is: ``plant``, an observer's name; curves of one source look alike.
        topic: the absolute name.
        steps: from the message to the number.
        group: what it tells of.
        plot: title of the axes that it shares with others, with the unit.
        element: the coordinate, or the model that diagnostics are of; empty for neither.
        shown: what is drawn of the value.
        states: whether it is one of a few states, not a quantity.
    """

    name: str
    source: str
    topic: str
    steps: tuple[CurveStep, ...]
    group: CurveGroup
    plot: str
    element: str = ""
    shown: Shown = Shown.AS_IT_IS
    states: bool = False


@dataclass(frozen=True, slots=True)
class Observed:
    """An observer by its topics, and those of the plant and the monitor beside it.

    Attributes:
        prefix: the node's absolute name, such as ``/rig/observer_geometric``.
        bounded: whether it certifies a bound of V.
        filters: whether it carries a covariance, and weighs events by it.
        learnt: names of what it learns besides the state.
    """

    prefix: str
    bounded: bool = True
    filters: bool = False
    learnt: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The node's name, below its namespace if it has one."""
        return self.prefix.lstrip("/")

    @property
    def monitor(self) -> str:
        """The absolute name of its monitor: ``monitor_<law>`` beside ``observer_<law>``."""
        name = self.prefix.rpartition("/")[2]
        own = f"monitor{name.removeprefix('observer')}"
        return self.beside(own if name.startswith("observer") else f"monitor_{name}")

    def beside(self, name: str) -> str:
        """The absolute form of a ``name`` in the observer's namespace."""
        return name if name.startswith("/") else f"{self.prefix.rpartition('/')[0]}/{name}"

    def own(self, interface: Interface) -> str:
        """The observer's topic of an interface such as ``observer/state``."""
        return interface.of(self.prefix)

    @property
    def error(self) -> str:
        """The topic of its distance from the truth."""
        return interfaces.MONITOR_ERROR.of(self.monitor)

    @classmethod
    def named(cls, name: str) -> "Observed":
        """What a node called ``name`` publishes; ``observer_<law>`` runs that law.

        Raises:
            UsageError: no node can have that name.
        """
        prefix = name if name.startswith("/") else f"/{name}"
        if not all(part.isidentifier() and part.isascii() for part in prefix[1:].split("/")):
            raise UsageError(f"observer {name!r}: no name of a node; expected such as observer")
        last = prefix.rpartition("/")[2]
        law = last.removeprefix("observer").lstrip("_").replace("_", "-") or _BOUNDED[0]
        filters = law in _FILTERS
        return cls(prefix, law in _BOUNDED, filters, ("clock_error",) if filters else ())


def observed_in(reader: BagReader) -> tuple[Observed, ...]:
    """The observers of a bag, with what each of them says.

    Raises:
        BagError: the bag is damaged.
    """
    return tuple(_observed(reader, prefix) for prefix in reader.observers())


def _observed(reader: BagReader, prefix: str) -> Observed:
    """One observer; its last state tells what it carries."""
    bound = interfaces.OBSERVER_BOUND.of(prefix)
    bounded = bound in reader.topics and reader.topics[bound].count > 0
    state = interfaces.OBSERVER_STATES.of(prefix)
    if state not in reader.topics:
        return Observed(prefix, bounded)
    tail = deque(reader.raw([state], max(reader.end - _TAIL, 0)), maxlen=1)
    said = tail or list(islice(reader.raw([state]), 1))
    if not said:
        return Observed(prefix, bounded)
    message = cast("EstimateMessage", reader.decoder(state)(said[0].data))
    return Observed(prefix, bounded, len(message.covariance) > 0, tuple(message.parameter_name))


def curves(
    system: System, observers: Sequence[Observed], topics: Iterable[str] | None = None
) -> tuple[Curve, ...]:
    """The list.

    Args:
        system: names coordinates and contacts, and itself in the diagnostics.
        observers: whose estimates are to be seen, each with the plant beside it.
        topics: only curves of these absolute names, such as those of a bag; None for all.

    Returns:
        Curves in the order in which they are to be shown.

    Raises:
        UsageError: there is no observer.
    """
    if not observers:
        raise UsageError("no observer: there is nothing to draw beside the plant; name one")
    every = (
        *_states(system, observers, CurveGroup.POSITIONS, "position", "m"),
        *_states(system, observers, CurveGroup.VELOCITIES, "velocity", "m/s"),
        *_errors(system, observers),
        *(curve for each in observers for curve in _distances(each)),
        *(curve for each in observers if each.filters for curve in _deviations(system, each)),
        *_impacts(system, observers),
        *(curve for each in observers for curve in _verdicts(each)),
        *(curve for each in observers for curve in _learnt(each)),
        *(curve for each in observers for curve in _diagnostics(system, each)),
    )
    wanted = None if topics is None else set(topics)
    return tuple(each for each in every if wanted is None or each.topic in wanted)


def _states(
    system: System, observers: Sequence[Observed], group: CurveGroup, field: str, unit: str
) -> Iterator[Curve]:
    """Truth and estimates of each coordinate, in one plot."""
    truths = _beside(observers, interfaces.PLANT_JOINT_STATES)
    places = [("plant", f"{rig}plant", topic) for rig, topic in truths]
    joints = interfaces.OBSERVER_JOINT_STATES
    places += [(each.name, each.name, each.own(joints)) for each in observers]
    for i, name in enumerate(system.coordinates):
        for source, label, topic in places:
            steps = (CurveStep(field, i),)
            plot = f"{name} {field} [{unit}]"
            yield Curve(f"{name} {label}", source, topic, steps, group, plot, element=name)


def _beside(observers: Sequence[Observed], interface: Interface) -> Iterator[tuple[str, str]]:
    """Each topic of the plants beside observers once, with what tells several plants apart."""
    topics = dict.fromkeys(each.beside(interface.name) for each in observers)
    for topic in topics:
        rig = topic.removesuffix(interface.name).lstrip("/")
        yield rig if len(topics) > 1 else "", topic


def _errors(system: System, observers: Sequence[Observed]) -> Iterator[Curve]:
    """Estimate minus truth of each coordinate, as monitors tell it."""
    for field, unit in (("position_error", "m"), ("velocity_error", "m/s")):
        for i, name in enumerate(system.coordinates):
            for each in observers:
                plot = f"{name} {field.replace('_', ' ')} [{unit}]"
                label = f"{name} {each.name}"
                yield Curve(
                    label, each.name, each.error, (CurveStep(field, i),), CurveGroup.ERRORS, plot
                )


def _distances(observer: Observed) -> Iterator[Curve]:
    """V, what bounds it, and how far replicas are apart."""
    name = observer.name
    places = [("V", observer.error, "v", "V and its bound: log10 of J")]
    if observer.bounded:
        topic = observer.own(interfaces.OBSERVER_BOUND)
        places.append(("bound of V", topic, "v", "V and its bound: log10 of J"))
    state = observer.own(interfaces.OBSERVER_STATES)
    places.append(("convergence", state, "convergence", "convergence: log10 of J"))
    for what, topic, field, plot in places:
        steps = (CurveStep(field),)
        yield Curve(
            f"{what} {name}", name, topic, steps, CurveGroup.DISTANCE, plot, shown=Shown.LOGARITHM
        )


def _deviations(system: System, observer: Observed) -> Iterator[Curve]:
    """Standard deviations: roots of the covariance's diagonal."""
    topic, n = observer.own(interfaces.OBSERVER_STATES), system.n
    for k, name in enumerate((*system.coordinates, *system.coordinates)):
        what, unit = ("velocity", "m/s") if k >= n else ("position", "m")
        yield Curve(
            f"{name} {observer.name}",
            observer.name,
            topic,
            (CurveStep("covariance", k * (2 * n + 1)),),
            CurveGroup.DEVIATIONS,
            f"{what} deviations [{unit}]",
            shown=Shown.ROOT,
        )


def _impacts(system: System, observers: Sequence[Observed]) -> Iterator[Curve]:
    """How each contact switches: 0 IMPACT, 1 CLOSE, 2 OPEN."""
    plot = "kind of switch: 0 impact, 1 close, 2 open"
    for rig, topic in _beside(observers, interfaces.IMPACTS):
        for name in system.contact_names:
            steps = (CurveStep("switches", where=("contact", name)), CurveStep("kind"))
            label = f"{rig}{name}"
            yield Curve(label, "plant", topic, steps, CurveGroup.EVENTS, plot, states=True)


def _verdicts(observer: Observed) -> Iterator[Curve]:
    """What became of events: the number of the verdict, the innovation, the latency."""
    verdicts = observer.own(interfaces.OBSERVER_VERDICTS)
    places = [
        (verdicts, "verdict", "verdict: 0 applied, 1 rejected, 2 inserted, 3 and more refused"),
        (observer.own(interfaces.OBSERVER_STATES), "synchronized", "synchronized: 0 or 1"),
        (verdicts, "latency", "latency [s]"),
    ]
    if observer.filters:
        places.append((verdicts, "innovation", "innovation [standard deviations]"))
    for topic, field, plot in places:
        yield Curve(
            f"{field} {observer.name}",
            observer.name,
            topic,
            (CurveStep(field),),
            CurveGroup.EVENTS,
            plot,
            states=field in {"verdict", "synchronized"},
        )


def _learnt(observer: Observed) -> Iterator[Curve]:
    """What is known besides the state: value and deviation of each parameter."""
    topic, name = observer.own(interfaces.OBSERVER_STATES), observer.name
    for i, parameter in enumerate(observer.learnt):
        what = parameter.replace("_", " ")
        for field, label in (("parameter", what), ("parameter_deviation", f"{what} deviation")):
            steps = (CurveStep(field, i),)
            plot = with_unit(parameter)
            yield Curve(f"{label} {name}", name, topic, steps, CurveGroup.LEARNT, plot)


def _diagnostics(system: System, observer: Observed) -> Iterator[Curve]:
    """The level and the figures of an observer's diagnostics."""
    topic, name = interfaces.DIAGNOSTIC_ARRAYS.topic, observer.name
    status = CurveStep("status", where=("name", f"{observer.prefix}: impacts"))
    level: tuple[CurveStep, ...] = (status, CurveStep("level"))
    places = [("level", level, "level: 0 ok, 1 warning, 2 error")]
    places += [
        (key, (status, CurveStep("values", where=("key", key)), CurveStep("value")), key)
        for key in _FIGURES
    ]
    for what, steps, plot in places:
        label = f"{what} {name}"
        yield Curve(label, name, topic, steps, CurveGroup.DIAGNOSTICS, plot, element=system.name)
