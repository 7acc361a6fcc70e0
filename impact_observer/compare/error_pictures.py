# SPDX-License-Identifier: Apache-2.0
"""Pictures of comparisons of any number of bags, each over the time since its own zero."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from impact_observer.compare.bag_comparison import BagComparison
from impact_observer.compare.comparison import Comparison
from impact_observer.draw.pictures import MOST_ROWS, Style, mark_rows, styles
from impact_observer.io.bag_part import TimeZero
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps, Vector

MOST_COORDINATES = 8
"""Most coordinates whose errors are drawn."""
_SIZE, _PAPER_SIZE = (8.0, 5.0), (3.46, 3.0)
"""Sizes of pictures, inches; a column of a printed page is 88 mm wide."""
_FONT, _PAPER_FONT = 10.0, 7.5
_ROOM, _PAPER_ROOM = 108, 54
"""Letters of a legend side by side above the axes."""
_HANDLE = 11
"""Width of the line before a legend's label with its margins, in letters."""
_AROUND, _BINS = 0.1, 40
"""Time after a hit of which errors are drawn, s, and the parts in which they are averaged."""


def distance_picture(
    labelled: Mapping[str, Comparison], results: Sequence[tuple[Path, BagComparison]]
) -> Figure:
    """V of all estimates, by their labels, in one picture."""
    since = {label: each for _, _, those in _by_bag(labelled, results) for label, each in those}
    names = ", ".join(dict.fromkeys(result.system.name for _, result in results))
    title = f"{names}: distance of the estimates from the truth"
    zero = TimeZero(0, instants_of(results))
    return lyapunov_picture(since, _impacts(results), title=title, zero=zero)


def instants_of(results: Sequence[tuple[Path, BagComparison]]) -> str:
    """What happens at time zero of the bags, in words."""
    return " or ".join(dict.fromkeys(result.zero.instant for _, result in results))


def error_pictures(
    labelled: Mapping[str, Comparison], results: Sequence[tuple[Path, BagComparison]]
) -> Iterator[tuple[list[Path], int, Figure]]:
    """Yields the bags, number of coordinates and picture of errors of each kind of system."""
    bags: dict[tuple[str, ...], list[Path]] = {}
    alike: dict[tuple[str, ...], dict[str, Comparison]] = {}
    for bag, result, those in _by_bag(labelled, results):
        bags.setdefault(result.system.coordinates, []).append(bag)
        alike.setdefault(result.system.coordinates, {}).update(those)
    for coordinates, comparisons in alike.items():
        picture = _error_picture(comparisons, TimeZero(0, instants_of(results)))
        yield bags[coordinates], len(coordinates), picture


def hits_picture(labelled: Mapping[str, Comparison]) -> Figure | None:
    """The rms error of all velocities over the time since the last hit; None without robots."""
    shown = {k: c for k, c in labelled.items() if isinstance(c.system, Robot) and c.outcomes.hits}
    if not shown:
        return None
    edges = np.linspace(0.0, _AROUND, _BINS + 1)
    drawn = styles([each.law for each in shown.values()])
    with mpl.rc_context({"font.size": _FONT}):
        figure = Figure(figsize=(_SIZE[0], 3.2), layout="constrained")
        axes = figure.add_subplot()
        for each, style in zip(shown.values(), drawn, strict=True):
            size = np.sum(each.error[:, each.system.n :] ** 2, axis=1)
            total, count = (
                np.histogram(each.since_hits, edges, weights=weights)[0]
                for weights in (size, None)
            )
            known = count > 0
            middle = 500.0 * (edges[1:] + edges[:-1])[known]
            _draw_curve(axes, middle, np.sqrt(total[known] / count[known]), len(shown), style)
        axes.set_xlabel("time since the last hit [ms]")
        units = {unit for c in shown.values() for unit in c.system.state_units[c.system.n :]}
        axes.set_ylabel(f"rms error of velocities [{' and '.join(sorted(units))}]")
        axes.grid(visible=True, which="major", color="0.9")
        labels = [_shortened(label, _ROOM - _HANDLE) for label in shown]
        where = _legend_style(labels, _ROOM)
        figure.legend(axes.lines, labels, loc="outside upper left", **where)
    return figure


def _by_bag(
    labelled: Mapping[str, Comparison], results: Sequence[tuple[Path, BagComparison]]
) -> Iterator[tuple[Path, BagComparison, list[tuple[str, Comparison]]]]:
    """The estimates of each bag, with stamps since its time zero."""
    rest = iter(labelled.items())
    for bag, result in results:
        those = [next(rest) for _ in result.comparisons]
        since = [(name, replace(c, stamps=c.stamps - result.zero.stamp)) for name, c in those]
        yield bag, result, since


def _impacts(results: Sequence[tuple[Path, BagComparison]]) -> dict[str, Stamps]:
    """Stamps of impacts since time zero, by contact; also by bag where the bags' runs differ.

    Empty if the rows are too many to distinguish.
    """
    runs = [
        {contact: stamps - result.zero.stamp for contact, stamps in result.impacts.items()}
        for _, result in results
    ]
    instants = [{contact: stamps.tolist() for contact, stamps in run.items()} for run in runs]
    if all(each == instants[0] for each in instants):
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


def lyapunov_picture(
    comparisons: Mapping[str, Comparison],
    impacts: Mapping[str, Stamps],
    *,
    title: str,
    zero: TimeZero,
    paper: bool = False,
) -> Figure:
    """``V`` over time on a logarithmic axis, after Figure 2 of Baumann and Leine.

    Args:
        comparisons: one curve each, by label.
        impacts: stamps of the impacts (ns), by contact.
        title: of the picture.
        zero: of the time axis.
        paper: whether the picture is as wide as a column and has no title.
    """
    room = _PAPER_ROOM if paper else _ROOM
    with mpl.rc_context({"font.size": _PAPER_FONT if paper else _FONT}):
        figure = Figure(figsize=_PAPER_SIZE if paper else _SIZE, layout="constrained")
        axes = figure.add_subplot()
        drawn = styles([each.law for each in comparisons.values()])
        for (label, each), style in zip(comparisons.items(), drawn, strict=True):
            style["label"] = _shortened(label, room - _HANDLE)
            seconds = (each.stamps - zero.stamp) / NS_PER_S
            _draw_curve(axes, seconds, each.V, len(comparisons), style)
        axes.set_xlabel(zero.axis)
        axes.set_ylabel("Lyapunov distance V [J]")
        axes.grid(visible=True, which="major", color="0.9")
        axes.margins(x=0.01)
        _mark_impacts(axes, impacts, zero.stamp, room - _HANDLE)
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),  # above the axes it covers no curve
            borderaxespad=0.2,
            **_legend_style(axes.get_legend_handles_labels()[1], room),
        )
        if not paper:
            figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    return figure


def _error_picture(comparisons: Mapping[str, Comparison], zero: TimeZero) -> Figure:
    """The size of each state's error over time, coordinates at the left, velocities at the right.

    If there are more than ``MOST_COORDINATES``, the coordinates with the largest errors are shown.
    """
    first = next(iter(comparisons.values()))
    names, n, units = first.system.coordinates, first.system.n, first.system.state_units
    rms = np.sum([np.square(each.rms[:n]) for each in comparisons.values()], axis=0)
    shown = np.sort(np.argsort(-rms, kind="stable")[:MOST_COORDINATES])
    drawn = styles([each.law for each in comparisons.values()])
    with mpl.rc_context({"font.size": _FONT}):
        figure = Figure(figsize=(_SIZE[0], 0.6 + 1.5 * shown.size), layout="constrained")
        grid = figure.subplots(shown.size, 2, sharex=True, squeeze=False)
        for row, i in enumerate(shown):
            for axes, column, label in (
                (grid[row, 0], i, f"|Δ{names[i]}| [{units[i]}]"),
                (grid[row, 1], n + i, f"|Δd{names[i]}/dt| [{units[n + i]}]"),
            ):
                for each, style in zip(comparisons.values(), drawn, strict=True):
                    size = np.abs(each.error[:, column])
                    _draw_curve(axes, each.stamps / NS_PER_S, size, len(comparisons), style)
                axes.set_ylabel(label, fontsize="small")
                axes.grid(visible=True, which="major", color="0.9")
                axes.margins(x=0.01)
        for axes in grid[-1]:
            axes.set_xlabel(zero.axis)
        labels = [_shortened(label, _ROOM - _HANDLE) for label in comparisons]
        lines = grid[0, 0].lines[: len(labels)]
        figure.legend(lines, labels, loc="outside upper left", **_legend_style(labels, _ROOM))
    return figure


def _draw_curve(
    axes: Axes, seconds: Vector, values: NDArray[np.float64], curves: int, style: Style
) -> None:
    """Draw one of several ``curves`` with a few markers, beside the markers of the others."""
    # Zero has no logarithm: a gap in the curve means that the estimate is exact there.
    (line,) = axes.semilogy(seconds, np.where(values > 0, values, np.nan), **style)
    step = max(values.size // 9, 1)
    line.set_markevery((step * (len(axes.lines) - 1) // curves, step))


def _legend_style(labels: Sequence[str], room: int) -> Style:
    """Style of a legend with as many columns as have room above the axes."""
    longest = max(map(len, labels), default=0) + _HANDLE
    columns = min(max(room // longest, 1), 4)
    return {"ncol": columns, "fontsize": "small", "frameon": False, "handlelength": 3.2}


def _shortened(label: str, most: int) -> str:
    """``label`` with dots for its middle if the label has more than ``most`` letters."""
    kept = (most - 1) // 2
    return label if len(label) <= most else f"{label[:kept]}…{label[-kept:]}"


def _mark_impacts(axes: Axes, impacts: Mapping[str, Stamps], zero: int, most: int) -> None:
    """A row of marks a contact; one row for very many contacts."""
    rows = {
        _shortened(f"impacts at {contact}", most): (stamps - zero) / NS_PER_S
        for contact, stamps in impacts.items()
    }
    if len(rows) > MOST_ROWS:
        rows = {f"impacts at {len(rows)} contacts": np.concatenate(list(rows.values()))}
    mark_rows(axes, rows)
