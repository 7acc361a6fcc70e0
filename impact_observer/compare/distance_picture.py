# SPDX-License-Identifier: Apache-2.0
"""V over time of the estimates in any number of bags, each since its own zero."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from impact_observer.compare.bag_comparison import BagComparison
from impact_observer.compare.comparison import Comparison
from impact_observer.draw.pictures import MOST_ROWS, Style, mark_rows, styles
from impact_observer.io.bag_part import TimeZero
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps, Vector

_ROOM, _HANDLE = 108, 11
"""Letters of a legend side by side above the axes; the line before a label takes as many."""
_LONGEST = _ROOM - _HANDLE
"""Letters of the longest label; of longer ones the middle is left out."""


def distance_picture(
    labelled: Mapping[str, Comparison],
    results: Sequence[tuple[Path, BagComparison]],
    part: SubFigure | None = None,
) -> Figure:
    """V of all estimates, by their labels, in one picture, or in a part of one."""
    rest, since = iter(labelled.items()), {}
    for _, result in results:
        for label, each in islice(rest, len(result.comparisons)):
            since[label] = replace(each, stamps=each.stamps - result.zero.stamp)
    instants = " or ".join(dict.fromkeys(result.zero.instant for _, result in results))
    names = ", ".join(dict.fromkeys(result.system.name for _, result in results))
    title = f"{names}: distance of the estimates from the truth"
    zero = TimeZero(0, instants)
    return lyapunov_picture(since, _impacts(results), title=title, zero=zero, part=part)


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
    part: SubFigure | None = None,
) -> Figure:
    """``V`` over time on a logarithmic axis, after Figure 2 of Baumann and Leine.

    A curve for each comparison, by its label; ``impacts`` are stamps (ns) by contact. None draws a
    new picture, else a ``part`` of one.
    """
    figure = cast("Figure", part or Figure(figsize=(8.0, 5.0), layout="constrained"))
    axes = figure.add_subplot()
    drawn = styles([each.law for each in comparisons.values()])
    for (label, each), style in zip(comparisons.items(), drawn, strict=True):
        seconds = (each.stamps - zero.stamp) / NS_PER_S
        style["label"] = _shortened(label)
        _draw_curve(axes, seconds, each.V, len(comparisons), style)
    axes.set_xlabel(zero.axis)
    axes.set_ylabel("Lyapunov distance V [J]")
    axes.grid(visible=True, which="major", color="0.9")
    axes.margins(x=0.01)
    _mark_impacts(axes, impacts, zero.stamp)
    labels = axes.get_legend_handles_labels()[1]
    longest = max(map(len, labels), default=0) + _HANDLE
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),  # above the axes it covers no curve
        borderaxespad=0.2,
        ncol=min(max(_ROOM // longest, 1), 4),
        fontsize="small",
        frameon=False,
        handlelength=3.2,
    )
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


def _shortened(label: str) -> str:
    """``label`` with dots for its middle if the label is too long."""
    kept = (_LONGEST - 1) // 2
    return label if len(label) <= _LONGEST else f"{label[:kept]}…{label[-kept:]}"


def _mark_impacts(axes: Axes, impacts: Mapping[str, Stamps], zero: int) -> None:
    """A row of marks a contact; one row for very many contacts."""
    rows = {
        _shortened(f"impacts at {contact}"): (stamps - zero) / NS_PER_S
        for contact, stamps in impacts.items()
    }
    if len(rows) > MOST_ROWS:
        rows = {f"impacts at {len(rows)} contacts": np.concatenate(list(rows.values()))}
    mark_rows(axes, rows)
