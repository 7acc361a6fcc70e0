# SPDX-License-Identifier: Apache-2.0
"""The curves that plotting tools show of a plant and its observers.

The rows of ``layouts/curves.yaml`` are filled in with the names of a model and of the observers of
a bag, or of observer nodes. The layouts of :mod:`impact_observer.draw.layouts` show the curves.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any, TypeAlias

from ruamel.yaml import YAML

from impact_observer.draw.observer_topics import ObserverTopics, observers_in
from impact_observer.errors import UnfitBagError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import model_of
from impact_observer.model import System, read_model
from impact_observer.model.free_parameters import with_unit
from impact_observer.model.system import UNKNOWN_UNIT
from impact_observer.resources import shared
from impact_observer.robots.robot import Robot, simulated

TABS = (
    "positions",
    "velocities",
    "errors",
    "distance",
    "standard deviations",
    "events",
    "learned",
    "diagnostics",
)
"""Titles of the tabs, in their order."""
PLANT = "plant"
"""The source of curves of a plant."""
_Names: TypeAlias = Mapping[str, object]
"""Values that are filled into a template, by its words."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A number in the messages of a topic, over the messages' stamps.

    Attributes:
        tab: in which the curve is shown.
        plot: title of the axes that curves share, with the unit.
        name: for the legend.
        source: ``plant`` or an observer's name; curves of one source have one colour.
        topic: the absolute name.
        path: of the number in Foxglove's message path syntax, such as ``/monitor/error.v.@log10``.
        series: name of PlotJuggler's series before its transform, such as ``/monitor/error/v``.
        transform: the function that is drawn, ``log10`` or ``sqrt``; empty for the number itself.
        is_state: whether the number is one of a few states, not a quantity.
    """

    tab: str
    plot: str
    name: str
    source: str
    topic: str
    path: str
    series: str
    transform: str
    is_state: bool


def curves(
    system: System | Robot,
    observers: Sequence[ObserverTopics],
    topics: Iterable[str] | None = None,
) -> tuple[Curve, ...]:
    """The curves of observers, and of the plant in the namespace of each observer.

    Args:
        system: of the plant; names coordinates and contacts.
        observers: whose estimates are drawn.
        topics: only curves of these absolute names, such as the topics of a bag; None for all.

    Returns:
        Curves in the order in which they are shown.

    Raises:
        UsageError: there is no observer, or a name that Foxglove's paths cannot express.
    """
    if not observers:
        raise UsageError("no observer: there is nothing to draw beside the plant; name one")
    rows = YAML(typ="safe").load(shared("layouts/curves.yaml").read_text(encoding="utf-8"))
    every = list[Curve]()
    plants = dict.fromkeys(_namespace(each) for each in observers)
    for namespace in plants:
        rig = f"{namespace}/".lstrip("/") if len(plants) > 1 else ""
        names = {"namespace": namespace, "rig": rig, "source": f"{rig}{PLANT}"}
        every += _filled_in(rows["plant"], PLANT, names, system, ())
    for each in observers:
        lacking = {"bound": not each.bounded, "covariance": not each.filters}
        own = [row for row in rows["observer"] if not lacking.get(row.get("needs", ""), False)]
        names = {
            "observer": each.prefix,
            "monitor": each.topic(interfaces.MONITOR_ERROR).removesuffix("/error"),
            "source": each.name,
        }
        every += _filled_in(own, each.name, names, system, each.learned)
    wanted = None if topics is None else set(topics)
    return tuple(
        sorted(
            (each for each in every if wanted is None or each.topic in wanted),
            key=lambda each: TABS.index(each.tab),
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
    return curves(simulated(read_model(model)), list(topics))


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
        UsageError, ModelError: an observer that is not in the bag, or the model cannot be read.
    """
    with BagReader(bag) as reader:
        system, present = simulated(model_of(reader, model)), observers_in(reader)
        if not present:
            raise UnfitBagError(
                f"{bag}: has no estimates; make them with observe, or name a model"
            )
        by_prefix = {each.prefix: each for each in present}
        names = by_prefix if observers is None else observers
        wanted = dict.fromkeys(ObserverTopics.of_node(name).prefix for name in names)
        if missing := [prefix for prefix in wanted if prefix not in by_prefix]:
            raise UsageError(
                f"{bag}: no observer {missing[0]}; in the bag: {', '.join(by_prefix)}"
            )
        topics = tuple(name for name, topic in reader.topics.items() if topic.count)
    return curves(system, [by_prefix[prefix] for prefix in wanted], topics), topics


def _namespace(observer: ObserverTopics) -> str:
    """The namespace of an observer and of the plant beside it; empty for the root."""
    return observer.prefix.rpartition("/")[0]


def _filled_in(
    rows: Sequence[Mapping[str, Any]],
    source: str,
    names: _Names,
    system: System | Robot,
    learned: Sequence[str],
) -> Iterator[Curve]:
    """The curves of some rows of the template."""
    # The unit of a model of matrices is not known; titles are short and say m.
    unit = "m" if system.unit == UNKNOWN_UNIT else system.unit
    for row in rows:
        for repeated in _repeated(row.get("each"), system, learned):
            given = {**names, "unit": unit, "model": system.name, **repeated}
            filled = {
                key: Template(value).substitute(given)
                for key, value in row.items()
                if isinstance(value, str) and key != "each"
            }
            path = filled.get("foxglove", filled.get("field"))
            series = filled.get("plotjuggler", filled.get("field"))
            transform = filled.get("transform", "")
            yield Curve(
                tab=filled["tab"],
                plot=filled["plot"],
                name=filled["name"],
                source=source,
                topic=filled["topic"],
                path=f"{filled['topic']}.{path}" + (f".@{transform}" if transform else ""),
                series=f"{filled['topic']}/{series}",
                transform=transform,
                is_state=bool(row.get("state")),
            )


def _repeated(each: object, system: System | Robot, learned: Sequence[str]) -> Iterator[_Names]:
    """The names that differ from one curve of a row to the next."""
    if each == "coordinate":
        n = system.n
        for i, name in enumerate(system.coordinates):
            variances = {"variance_q": i * (2 * n + 1), "variance_u": (n + i) * (2 * n + 1)}
            own = {"unit": system.units[i]} if isinstance(system, Robot) else {}
            yield {"coordinate": name, "i": i, **variances, **own}
    elif each == "contact":
        for name in system.contact_names:
            yield {"contact": name, "quoted": _quoted(name)}
    elif each == "parameter":
        for i, name in enumerate(learned):
            words = name.replace("_", " ")
            yield {
                "parameter": name,
                "words": words,
                "titled": with_unit(name, system.unit),
                "i": i,
            }
    elif isinstance(each, list):
        for word in each:
            yield {"word": word}
    else:
        yield {}


def _quoted(name: str) -> str:
    """A name in quotes, as Foxglove's message paths need them.

    Raises:
        UsageError: the name holds both kinds of quotes, which the syntax cannot express.
    """
    quote = "'" if '"' in name else '"'
    if quote in name:
        raise UsageError(f"{name}: has both kinds of quotes; a message path can hold one only")
    return f"{quote}{name}{quote}"
