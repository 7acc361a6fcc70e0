"""Pictures of comparisons of any number of bags, each over the time since its own epoch."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from impact_observer.analysis.comparison import Comparison
    from impact_observer.bag.comparisons import BagComparison
    from impact_observer.states import Stamps


def distance_figure(
    labelled: "dict[str, Comparison]", results: "Sequence[tuple[Path, BagComparison]]"
) -> "Figure":
    """V of all estimates in one picture.

    Args:
        labelled: every estimate, by its label.
        results: the bags and what came out of each.
    """
    from impact_observer.analysis.figures import lyapunov_figure

    since = {label: each for _, _, those in _by_bag(labelled, results) for label, each in those}
    names = ", ".join(dict.fromkeys(result.system.name for _, result in results))
    title = f"{names}: distance of the estimates from the truth"
    return lyapunov_figure(since, _impacts(results), title=title, epoch=0)


def error_figures(
    labelled: "dict[str, Comparison]", results: "Sequence[tuple[Path, BagComparison]]"
) -> "Iterator[tuple[list[Path], int, Figure]]":
    """Sizes of the errors: bags, number of coordinates, and one picture a kind of system.

    Args:
        labelled: every estimate, by its label.
        results: the bags and what came out of each.
    """
    from impact_observer.analysis.figures import error_figure

    alike: dict[tuple[str, ...], tuple[list[Path], dict[str, Comparison]]] = {}
    for bag, result, those in _by_bag(labelled, results):
        bags, comparisons = alike.setdefault(result.system.coordinates, ([], {}))
        bags.append(bag)
        comparisons.update(those)
    for coordinates, (bags, comparisons) in alike.items():
        yield bags, len(coordinates), error_figure(comparisons, epoch=0)


def _by_bag(
    labelled: "dict[str, Comparison]", results: "Sequence[tuple[Path, BagComparison]]"
) -> "Iterator[tuple[Path, BagComparison, list[tuple[str, Comparison]]]]":
    """The estimates of each bag, with stamps since its epoch."""
    rest = iter(labelled.items())
    for bag, result in results:
        those = [next(rest) for _ in result.comparisons]
        since = [(name, replace(c, stamps=c.stamps - result.epoch)) for name, c in those]
        yield bag, result, since


def _impacts(results: "Sequence[tuple[Path, BagComparison]]") -> "dict[str, Stamps]":
    """Stamps of impacts since the epoch, by contact; by bag too where bags are not of one run.

    None where these would be too many to be told apart.
    """
    from impact_observer.analysis.figures import MOST_ROWS

    runs = [
        {contact: stamps - result.epoch for contact, stamps in result.impacts.items()}
        for _, result in results
    ]
    if all(_same(runs[0], run) for run in runs):
        return runs[0]
    paths = [bag for bag, _ in results]
    short = [bag.name for bag in paths]
    names = short if len(set(short)) == len(short) else map(str, paths)
    rows = {
        f"{contact}, {name}": stamps
        for name, run in zip(names, runs, strict=True)
        for contact, stamps in run.items()
    }
    return rows if len(rows) <= MOST_ROWS else {}


def _same(one: "dict[str, Stamps]", other: "dict[str, Stamps]") -> bool:
    """Whether two runs have the same impacts."""
    return one.keys() == other.keys() and all(
        one[contact].tolist() == other[contact].tolist() for contact in one
    )
