"""Pictures of comparisons of any number of bags, each over the time since its own epoch."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from impact_observer.compare.bag_comparison import BagComparison
from impact_observer.compare.comparison import Comparison
from impact_observer.draw.pictures import MOST_ROWS, mark_rows, styles
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps

MOST_COORDINATES = 8
"""Most coordinates whose errors are drawn."""
_MARKERS_A_CURVE = 9
_SIZE, _PAPER_SIZE = (8.0, 5.0), (3.46, 3.0)
"""Inches; a column of a printed page is 88 mm wide."""
_FONT, _PAPER_FONT = 10.0, 7.5
_ROOM, _PAPER_ROOM = 108, 54
"""Letters of a legend side by side above the axes."""
_HANDLE = 11
"""Letters that the line before a legend's label takes, with the room about it."""


def distance_figure(
    labelled: dict[str, Comparison], results: Sequence[tuple[Path, BagComparison]]
) -> Figure:
    """V of all estimates in one picture.

    Args:
        labelled: every estimate, by its label.
        results: the bags and what came out of each.
    """
    since = {label: each for _, _, those in _by_bag(labelled, results) for label, each in those}
    names = ", ".join(dict.fromkeys(result.system.name for _, result in results))
    title = f"{names}: distance of the estimates from the truth"
    return lyapunov_figure(since, _impacts(results), title=title, epoch=0)


def error_figures(
    labelled: dict[str, Comparison], results: Sequence[tuple[Path, BagComparison]]
) -> Iterator[tuple[list[Path], int, Figure]]:
    """Sizes of the errors: bags, number of coordinates, and one picture a kind of system.

    Args:
        labelled: every estimate, by its label.
        results: the bags and what came out of each.
    """
    alike: dict[tuple[str, ...], tuple[list[Path], dict[str, Comparison]]] = {}
    for bag, result, those in _by_bag(labelled, results):
        bags, comparisons = alike.setdefault(result.system.coordinates, ([], {}))
        bags.append(bag)
        comparisons.update(those)
    for coordinates, (bags, comparisons) in alike.items():
        yield bags, len(coordinates), error_figure(comparisons, epoch=0)


def _by_bag(
    labelled: dict[str, Comparison], results: Sequence[tuple[Path, BagComparison]]
) -> Iterator[tuple[Path, BagComparison, list[tuple[str, Comparison]]]]:
    """The estimates of each bag, with stamps since its epoch."""
    rest = iter(labelled.items())
    for bag, result in results:
        those = [next(rest) for _ in result.comparisons]
        since = [(name, replace(c, stamps=c.stamps - result.epoch)) for name, c in those]
        yield bag, result, since


def _impacts(results: Sequence[tuple[Path, BagComparison]]) -> dict[str, Stamps]:
    """Stamps of impacts since the epoch, by contact; by bag too where bags are not of one run.

    None where these would be too many to be told apart.
    """
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


def _same(one: dict[str, Stamps], other: dict[str, Stamps]) -> bool:
    """Whether two runs have the same impacts."""
    return one.keys() == other.keys() and all(
        one[contact].tolist() == other[contact].tolist() for contact in one
    )


def lyapunov_figure(
    comparisons: Mapping[str, Comparison],
    impacts: Mapping[str, Stamps],
    *,
    title: str,
    epoch: int,
    paper: bool = False,
) -> Figure:
    """``V`` over time on a logarithmic axis, after Figure 2 of Baumann and Leine.

    Args:
        comparisons: one curve each, by label.
        impacts: stamps of the impacts (ns), by contact.
        title: of the picture.
        epoch: stamp at which the time axis begins, ns.
        paper: as wide as a column and without a title, which a caption replaces.
    """
    room = _PAPER_ROOM if paper else _ROOM
    with mpl.rc_context({"font.size": _PAPER_FONT if paper else _FONT}):
        figure = Figure(figsize=_PAPER_SIZE if paper else _SIZE, layout="constrained")
        axes = figure.add_subplot()
        for (label, comparison), style in zip(
            comparisons.items(), styles([c.law for c in comparisons.values()]), strict=True
        ):
            # Zero has no logarithm: a gap says that the estimate is exact there.
            V = np.where(comparison.V > 0, comparison.V, np.nan)
            shown = _shortened(label, room - _HANDLE)
            axes.semilogy((comparison.stamps - epoch) / NS_PER_S, V, label=shown, **style)
            _space_markers(axes, len(comparisons))
        axes.set_xlabel("time since the epoch [s]")
        axes.set_ylabel("Lyapunov distance V [J]")
        axes.grid(visible=True, which="major", color="0.9")
        axes.margins(x=0.01)
        _mark_impacts(axes, impacts, epoch, room - _HANDLE)
        _legend(axes, room)
        if not paper:
            figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    return figure


def error_figure(comparisons: Mapping[str, Comparison], *, epoch: int) -> Figure:
    """The size of each state's error over time, coordinates at the left, velocities at the right.

    Of more than ``MOST_COORDINATES`` those are shown whose errors are the largest.

    Args:
        comparisons: one curve a panel each, by label; of one system.
        epoch: stamp at which the time axis begins, ns.
    """
    first = next(iter(comparisons.values()))
    names, n = first.system.coordinates, first.system.n
    rms = np.sum([np.square(each.rms[:n]) for each in comparisons.values()], axis=0)
    shown = np.sort(np.argsort(-rms, kind="stable")[:MOST_COORDINATES])
    height = 0.6 + 1.5 * shown.size
    with mpl.rc_context({"font.size": _FONT}):
        figure = Figure(figsize=(_SIZE[0], height), layout="constrained")
        grid = figure.subplots(shown.size, 2, sharex=True, squeeze=False)
        drawn = styles([each.law for each in comparisons.values()])
        for row, i in enumerate(shown):
            for axes, column, label in (
                (grid[row, 0], i, f"|Δ{names[i]}| [m or rad]"),
                (grid[row, 1], n + i, f"|Δd{names[i]}/dt| [m/s or rad/s]"),
            ):
                for (name, each), style in zip(comparisons.items(), drawn, strict=True):
                    size = np.abs(each.error[:, column])
                    size = np.where(size > 0, size, np.nan)  # zero has no logarithm
                    axes.semilogy((each.stamps - epoch) / NS_PER_S, size, label=name, **style)
                    _space_markers(axes, len(comparisons))
                axes.set_ylabel(label, fontsize="small")
                axes.grid(visible=True, which="major", color="0.9")
                axes.margins(x=0.01)
        for axes in grid[-1]:
            axes.set_xlabel("time since the epoch [s]")
        labels = [_shortened(label, _ROOM - _HANDLE) for label in comparisons]
        figure.legend(
            grid[0, 0].lines[: len(labels)],
            labels,
            loc="outside upper left",
            ncol=min(max(_ROOM // (max(map(len, labels)) + _HANDLE), 1), 4),
            fontsize="small",
            frameon=False,
            handlelength=3.2,
        )
    return figure


def _legend(axes: Axes, room: int) -> None:
    """What the curves are, above the axes: there it covers none, wherever they go."""
    longest = max(map(len, axes.get_legend_handles_labels()[1]), default=0)
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncol=min(max(room // (longest + _HANDLE), 1), 4),
        fontsize="small",
        frameon=False,
        handlelength=3.2,
        borderaxespad=0.2,
    )


def _shortened(label: str, most: int) -> str:
    """``label`` with dots for its middle where it has more than ``most`` letters."""
    kept = (most - 1) // 2
    return label if len(label) <= most else f"{label[:kept]}…{label[-kept:]}"


def _space_markers(axes: Axes, curves: int) -> None:
    """A few markers along the curve drawn last, beside those of the other ``curves``."""
    number, line = len(axes.lines) - 1, axes.lines[-1]
    step = max(np.size(line.get_xdata()) // _MARKERS_A_CURVE, 1)
    line.set_markevery((step * number // curves, step))


def _mark_impacts(axes: Axes, impacts: Mapping[str, Stamps], epoch: int, most: int) -> None:
    """A row of marks a contact; one row for very many contacts."""
    rows = {
        _shortened(f"impacts at {contact}", most): (stamps - epoch) / NS_PER_S
        for contact, stamps in impacts.items()
    }
    if len(rows) > MOST_ROWS:
        rows = {f"impacts at {len(rows)} contacts": np.concatenate(list(rows.values()))}
    mark_rows(axes, rows)
