# SPDX-License-Identifier: Apache-2.0
"""The picture of a recording: quantities over time with their deviations, and impacts."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from impact_observer.draw.pictures import Style, styles
from impact_observer.draw.plot.series import DENSE, PlotContent
from impact_observer.events import Ruling
from impact_observer.states import Vector

WIDTH = 10.0
"""Default width of a picture, inches."""
_TWO_COLUMNS = 6.5
"""Least width with two columns of panels, inches."""
_PANEL, _ROW, _REST = 1.45, 0.2, 1.2
"""Height of a panel, of a row of marks and of the rest, inches."""
_NAMED_ROW = 0.34
"""Height of a row of marks with its name above, inches, in a picture with one column of panels."""
_SHORT = 3.0
"""Width below which the axis of time has a short name, inches."""
MOST_ROWS = 8
"""Most rows of marks; beyond this number the contacts of an estimate share a row."""
BAND = 2.0
"""Half the width of a band, in standard deviations."""
_TAIL = 5.0
"""Percentage of values at either end that do not count for an estimate without a band."""
_NARROW = 0.25
"""Width of a band up to which an estimate is known, over the range of the motion."""
_FARTHER = 2.0
"""Range of all lines above which lines are cut off, over the range of all known values."""
_MARGIN = 0.06
"""Space above and below the curves, over their range."""
_TRUTH: Style = {"color": "0.75", "linewidth": 3.2}
_SPARSE: Style = {
    "color": "0.6",
    "linestyle": "none",
    "marker": "o",
    "markersize": 4.5,
    "markevery": 1,
}
"""Style of a truth whose samples are too few for a line."""
_IMPACT: Style = {"marker": "|", "color": "0.2", "markersize": 7}
MARKS: Mapping[Ruling | None, tuple[str, Style]] = {
    None: ("impact", _IMPACT),
    Ruling.APPLIED: ("impact, applied", _IMPACT),
    Ruling.REJECTED: ("rejected", {"marker": "x", "color": "#D55E00", "markersize": 5}),
    Ruling.INSERTED: (
        "inserted, as missed",
        {"marker": "^", "color": "#0072B2", "markerfacecolor": "white", "markersize": 5},
    ),
}
"""Name and mark of each verdict on an impact."""
_DOTS: dict[str, Any] = {
    "linestyle": "none",
    "marker": ".",
    "markersize": 1.5,
    "color": "0.1",
    "zorder": 20,
}
"""Style of the samples of sensors."""


def styles_of_recording(recording: PlotContent) -> list[Style]:
    """A line style for each series: the truth wide and pale, estimates by their laws.

    A truth with few samples beside an estimate is dots: lines between them would be wrong.
    """
    series = recording.series
    laws = [each.law for each in series if each.law]
    lines = iter(styles(laws))
    most = max((each.samples for each in series), default=0)
    alone = {"marker": None} if len(laws) < 2 else {}  # markers distinguish curves
    drawn = []
    for each in series:
        if each.law:
            drawn.append({**next(lines), **alone})
        else:
            drawn.append(dict(_SPARSE if each.samples * DENSE <= most else _TRUTH))
    return drawn


def mark_rows_of(recording: PlotContent) -> dict[str, dict[Ruling | None, Vector]]:
    """Rows of marks by their label: a row for each contact, and for each of several estimates."""
    estimates = {mark.estimate for mark in recording.marks}
    contacts = {mark.contact for mark in recording.marks}
    shared = len(contacts) * len(estimates) > MOST_ROWS
    rows: dict[str, dict[Ruling | None, list[Vector]]] = {}
    for mark, seconds in sorted(recording.marks.items(), key=lambda item: item[0][:2]):
        contact = "impacts" if shared else mark.contact
        label = f"{contact}, {mark.estimate}" if len(estimates) > 1 else contact
        rows.setdefault(label, {}).setdefault(mark.ruling, []).append(seconds)
    return {
        label: {ruling: np.sort(np.concatenate(parts)) for ruling, parts in row.items()}
        for label, row in rows.items()
    }


def recording_picture(recording: PlotContent, *, width: float = WIDTH) -> Figure:
    """Draw a recording, in two columns of panels if the picture is wide enough.

    Where an estimate has deviations, a panel below has these over time on a logarithmic scale.

    Args:
        recording: content of the picture.
        width: of the picture, inches.
    """
    count = len(recording.quantities)
    columns = 2 if count > 1 and width >= _TWO_COLUMNS else 1
    height = -(-count // columns)
    rows = mark_rows_of(recording)
    above = width < _TWO_COLUMNS
    strip = (_NAMED_ROW if above else _ROW) * (len(rows) + 0.6) if rows else 0.0
    banded = any(np.isfinite(each.deviations).any() for each in recording.series)
    heights = [*([strip] if rows else []), *[_PANEL] * (height + banded)]
    drawn = styles_of_recording(recording)
    time = "time [s]" if width < _SHORT else recording.zero.axis
    with mpl.rc_context({"font.size": 9.0}):
        figure = Figure(figsize=(width, _REST + sum(heights)), layout="constrained")
        grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
        first = len(heights) - height - banded
        panels: list[Axes] = []
        for column, quantity in enumerate(recording.quantities):
            place = grid[first + column % height, column // height]
            axes = figure.add_subplot(place, sharex=panels[0] if panels else None)
            _draw(axes, recording, column, drawn)
            axes.set_ylabel(quantity.label.replace(" [", "\n["), fontsize="small")
            last = column % height == height - 1 or column == count - 1
            axes.tick_params(labelbottom=last)
            if last and not banded:
                axes.set_xlabel(time)
            panels.append(axes)
        if banded:
            axes = figure.add_subplot(grid[-1, :], sharex=panels[0])
            _draw_deviations(axes, recording, drawn)
            axes.set_xlabel(time)
        panels[0].set_xlim(recording.start, recording.end)
        for k in range(columns if rows else 0):
            axes = figure.add_subplot(grid[0, k], sharex=panels[0])
            _draw_marks(axes, rows, named=k == 0, above=above)
        handles = [*_handles(recording, drawn), *_mark_handles(rows), *_dot_handles(recording)]
        longest = max(len(str(each.get_label())) for each in handles)
        room = max(int(13 * width) // (longest + 8), 1)
        figure.legend(
            handles=handles, loc="outside upper left", ncol=room, frameon=False, fontsize="small"
        )
        if recording.left_out:
            text = f"{recording.left_out} coordinates that move less are not drawn"
            figure.supxlabel(text, fontsize="small", color="0.35")
    return figure


def _draw(axes: Axes, recording: PlotContent, column: int, drawn: Sequence[Style]) -> None:
    """Draw one quantity of all series, with bands of deviations, within the range of the lines."""
    count = len(recording.series)
    for k, (each, style) in enumerate(zip(recording.series, drawn, strict=True)):
        t, y, deviation = (a[:, column] for a in (each.seconds, each.values, each.deviations))
        step = max(y.size // 9, 1)
        every: Style = {"markevery": (step * k // count, step)}
        axes.plot(t, y, zorder=2 + k, **every | style)
        if np.isfinite(deviation).any():
            axes.fill_between(
                t,
                y - BAND * deviation,
                y + BAND * deviation,
                color=style["color"],
                alpha=0.22,
                linewidth=0,
                zorder=1,
            )
    for dots in recording.dots.get(recording.quantities[column].name, ()):
        axes.plot(dots.seconds, dots.values, **_DOTS)
    low, high, cut_off = limits(recording, column)
    if cut_off:
        where: Style = {"transform": axes.transAxes, "ha": "right", "va": "top"}
        axes.text(0.99, 0.97, cut_off, fontsize="x-small", color="0.35", **where)
    axes.set_ylim(low, high)
    axes.grid(visible=True, which="major", color="0.92")


def _draw_deviations(axes: Axes, recording: PlotContent, drawn: Sequence[Style]) -> None:
    """Draw the standard deviations of all quantities, coloured by quantity, with a log scale."""
    handles = []
    for column, quantity in enumerate(recording.quantities):
        style: Style = {"color": f"C{column % 10}", "linewidth": 1.0}
        for each, own in zip(recording.series, drawn, strict=True):
            deviation = each.deviations[:, column]
            if np.isfinite(deviation).any():
                shown = np.where(deviation > 0, deviation, np.nan)
                style["linestyle"] = own.get("linestyle", "-")
                axes.plot(each.seconds[:, column], shown, **style)
        handles.append(Line2D([], [], **style | {"linestyle": "-", "label": quantity.label}))
    axes.set_yscale("log")
    axes.set_ylabel("standard\ndeviation", fontsize="small")
    axes.grid(visible=True, which="major", color="0.92")
    axes.legend(handles=handles, loc="upper right", fontsize="x-small", ncol=len(handles) // 5 + 1)


def limits(recording: PlotContent, column: int) -> tuple[float, float, str]:
    """The range of an axis, and a note if the range cuts off a long way from a wrong start.

    The range is that of all lines, unless the lines go twice as far as the truth and the known
    values of the estimates. Values with a narrow band beside the motion are known. If
    estimates have no band beside a truth, all values but a twentieth at either end are known.

    Args:
        recording: content of the picture.
        column: index of the quantity.

    Returns:
        Lower end, upper end, and a text that is empty if nothing is cut off.
    """
    parts, whole = list[Vector](), list[Vector]()
    for each in recording.series:
        y, deviation = each.values[:, column], each.deviations[:, column]
        spread = np.percentile(y, [_TAIL, 100 - _TAIL])
        known = BAND * deviation <= _NARROW * (spread[1] - spread[0])
        if np.count_nonzero(known) < y.size / 2:
            known = np.ones(y.size, dtype=np.bool_)
            if each.law and not recording.series[0].law and not np.isfinite(deviation).any():
                known = (spread[0] <= y) & (y <= spread[1])
        parts.append(y[known])
        whole.append(y)
    low, high = (float(f(np.concatenate(parts))) for f in (np.min, np.max))
    least, largest = (float(f(np.concatenate(whole))) for f in (np.min, np.max))
    cut_off = ""
    if largest - least <= _FARTHER * (high - low):
        low, high = least, largest
    else:
        cut_off = f"cut off: {least:.3g} to {largest:.3g}"
    room = _MARGIN * (high - low) or 0.5 * max(abs(high), 1e-9)
    return low - room, high + room, cut_off


def _draw_marks(
    axes: Axes, rows: Mapping[str, Mapping[Ruling | None, Vector]], *, named: bool, above: bool
) -> None:
    """Draw a row of marks for each contact, with its name beside or ``above`` the marks."""
    for k, (label, row) in enumerate(rows.items()):
        for ruling, seconds in row.items():
            at = np.full(seconds.size, k)
            axes.plot(seconds, at, linestyle="none", clip_on=False, **MARKS[ruling][1])
        if named and above:
            place = axes.get_yaxis_transform()
            axes.text(0.0, k - 0.3, label, transform=place, fontsize="small", in_layout=False)
    axes.set_ylim(len(rows) - 0.4, -1.0 if above else -0.6)
    axes.set_yticks(range(len(rows)), list(rows) if named and not above else [""] * len(rows))
    axes.tick_params(labelbottom=False, bottom=False, left=False, labelsize="small")
    for side in axes.spines.values():
        side.set_visible(False)


def _handles(recording: PlotContent, drawn: Sequence[Style]) -> list[Line2D | Patch]:
    """The legend's entries of the series and of the bands."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], label=each.label, **style)
        for each, style in zip(recording.series, drawn, strict=True)
    ]
    banded = [
        style["color"]
        for each, style in zip(recording.series, drawn, strict=True)
        if np.isfinite(each.deviations).any()
    ]
    if banded:
        colour = banded[0] if len(banded) == 1 else "0.4"
        label = f"± {BAND:g} standard deviations"
        handles.append(Patch(color=colour, alpha=0.22, label=label))
    return handles


def _dot_handles(recording: PlotContent) -> list[Line2D]:
    """The legend's entry of samples of sensors; empty without samples of a drawn quantity."""
    shown = {each.name for each in recording.quantities}
    names = [each.name for k, some in recording.dots.items() if k in shown for each in some]
    if not names:
        return []
    return [Line2D([], [], label=f"samples: {', '.join(names)}", **{**_DOTS, "markersize": 4.0})]


def _mark_handles(rows: Mapping[str, Mapping[Ruling | None, Vector]]) -> list[Line2D]:
    """The legend's entries of the marks that occur."""
    present = {ruling for row in rows.values() for ruling in row}
    return [
        Line2D([], [], linestyle="none", label=label, **style)
        for ruling, (label, style) in MARKS.items()
        if ruling in present
    ]
