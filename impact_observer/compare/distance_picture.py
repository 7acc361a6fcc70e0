# SPDX-License-Identifier: Apache-2.0
"""V over time of the estimates in any number of bags, each since its own zero."""

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
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps, Vector

_SIZE, _PAPER_SIZE = (8.0, 5.0), (3.46, 3.0)
"""Sizes of pictures, inches; a column of a printed page is 88 mm wide."""
_FONT, _PAPER_FONT = 10.0, 7.5
_ROOM, _PAPER_ROOM = 108, 54
"""Letters of a legend side by side above the axes."""
_HANDLE = 11
"""Width of the line before a legend's label with its margins, in letters."""


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
