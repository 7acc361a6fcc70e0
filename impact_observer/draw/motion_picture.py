# SPDX-License-Identifier: Apache-2.0
"""The picture of a recorded motion: coordinates over time with deviations, and impacts."""

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from impact_observer.draw.pictures import BAND, BandCurve, Style, draw_bands, styles
from impact_observer.draw.recorded_motion import RecordedMotion
from impact_observer.errors import UsageError
from impact_observer.events import Ruling

MOST_COORDINATES = 8
"""Most coordinates in a picture for which none are named."""
_WIDTH, _PANEL, _ROW, _REST = 10.0, 1.5, 0.22, 1.2
"""Width of a picture, and heights of a panel, a row of marks and the rest, inches."""
_SPARSE = 3
"""Samples of an estimate for one of the truth, from which on a line through the truth is wrong."""
_IMPACT: Style = {"marker": "|", "color": "0.2", "markersize": 7}
_MARKS: Mapping[Ruling | None, tuple[str, Style]] = {
    None: ("impact", _IMPACT),
    Ruling.APPLIED: ("impact, applied", _IMPACT),
    Ruling.REJECTED: ("rejected", {"marker": "x", "color": "#D55E00", "markersize": 5}),
    Ruling.INSERTED: ("inserted, as missed", {"marker": "^", "color": "#0072B2", "markersize": 5}),
}
"""Name and mark of each verdict on an impact."""


def chosen_coordinates(motion: RecordedMotion, names: Sequence[str] | None) -> list[int]:
    """The places of the named coordinates; without names of those that move most, at most eight.

    Raises:
        UsageError: a name is no coordinate.
    """
    for name in names or ():
        if name not in motion.coordinates:
            known = ", ".join(motion.coordinates)
            raise UsageError(f"--select {name}: no coordinate; expected some of {known}")
    if names is not None:
        return [motion.coordinates.index(name) for name in dict.fromkeys(names)]
    size = np.std(motion.curves[0].x[:, : len(motion.coordinates)], axis=0)
    return sorted(np.argsort(-size, kind="stable")[:MOST_COORDINATES].tolist())


def motion_picture(
    motion: RecordedMotion, coordinates: Sequence[int], part: SubFigure | None = None
) -> Figure:
    """Draw positions at the left and velocities at the right, a row for each coordinate.

    Above is a row of marks for each contact, below are the standard deviations on a logarithmic
    axis, where a narrow band stays visible.

    Args:
        motion: of plant and estimates.
        coordinates: places of the coordinates that are drawn.
        part: of a picture, to draw there; None for a new picture.
    """
    drawn, marks = _styles(motion), motion.marks
    n, banded = len(motion.coordinates), _has_bands(motion)
    strip = [_ROW * (len(marks) + 1)] if marks else []
    heights = [*strip, *[_PANEL] * (len(coordinates) + banded)]
    size = _WIDTH, _REST + sum(heights)
    figure = cast("Figure", part or Figure(figsize=size, layout="constrained"))
    grid = figure.subplots(len(heights), 2, sharex=True, squeeze=False, height_ratios=heights)
    for axes, rows in zip(grid[0], ([*marks], [""] * len(marks)), strict=True) if marks else ():
        _draw_marks(axes, motion, rows)
    for side, name in ((0, "{}"), (n, "d{}/dt")):
        panels = grid[len(strip) :, 1 if side else 0]
        for axes, i in zip(panels, coordinates, strict=False):
            k = side + i
            draw_bands(
                axes,
                [
                    BandCurve(each.seconds, each.x[:, k], each.deviations[:, k], style)
                    for each, style in zip(motion.curves, drawn, strict=True)
                ],
            )
            axes.set_ylabel(f"{name.format(motion.coordinates[i])}\n[{motion.units[k]}]")
        if banded:
            _draw_deviations(panels[-1], motion, [side + i for i in coordinates], drawn)
        panels[-1].set_xlabel(motion.zero.axis)
    figure.legend(
        handles=_handles(motion, drawn), loc="outside upper left", ncols=4, frameon=False
    )
    return figure


def _has_bands(motion: RecordedMotion) -> bool:
    """Whether an estimate has deviations."""
    return any(np.isfinite(each.deviations).any() for each in motion.curves)


def _styles(motion: RecordedMotion) -> list[Style]:
    """The truth wide and pale, as dots where its samples are few; estimates by their laws."""
    laws = [each.law for each in motion.curves if each.law is not None]
    lines, most = iter(styles(laws)), max(each.seconds.size for each in motion.curves)
    drawn = list[Style]()
    for each in motion.curves:
        if each.law is None:
            few = each.seconds.size * _SPARSE <= most
            dots = {"linestyle": "none", "marker": "o", "color": "0.6", "markersize": 4}
            drawn.append(dots if few else {"color": "0.75", "linewidth": 3.2})
        else:
            drawn.append(
                {**next(lines), "markevery": 0.1}
                if len(laws) > 1
                else {**next(lines), "marker": None}
            )
    return drawn


def _draw_marks(axes: Axes, motion: RecordedMotion, names: Sequence[str]) -> None:
    """Draw a row of marks for each contact, with the names of the rows."""
    for k, row in enumerate(motion.marks.values()):
        for ruling, seconds in row.items():
            axes.plot(seconds, [k] * len(seconds), linestyle="none", **_MARKS[ruling][1])
    axes.set_ylim(len(motion.marks) - 0.4, -0.6)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(bottom=False, left=False, labelsize="small")
    axes.spines[:].set_visible(False)


def _draw_deviations(
    axes: Axes, motion: RecordedMotion, columns: Sequence[int], drawn: Sequence[Style]
) -> None:
    """Draw deviations on a logarithmic axis, coloured by coordinate, dashed as their estimate."""
    for place, k in enumerate(columns):
        style: Style = {"color": f"C{place % 10}", "linewidth": 1.0}
        for each, own in zip(motion.curves, drawn, strict=True):
            deviation = each.deviations[:, k]
            if np.isfinite(deviation).any():
                shown = np.where(deviation > 0, deviation, np.nan)
                axes.semilogy(each.seconds, shown, linestyle=own["linestyle"], **style)
        axes.plot([], [], label=motion.coordinates[k % len(motion.coordinates)], **style)
    axes.set_ylabel("standard\ndeviation")
    axes.legend(loc="upper right", fontsize="x-small", ncols=4)


def _handles(motion: RecordedMotion, drawn: Sequence[Style]) -> list[Line2D | Patch]:
    """The legend's entries: curves, the band, and the marks that occur."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], label=each.label, **style)
        for each, style in zip(motion.curves, drawn, strict=True)
    ]
    if _has_bands(motion):
        label = f"± {BAND:g} standard deviations"
        handles.append(Patch(color="0.4", alpha=0.22, label=label))
    present = {ruling for row in motion.marks.values() for ruling in row}
    return handles + [
        Line2D([], [], linestyle="none", label=label, **style)
        for ruling, (label, style) in _MARKS.items()
        if ruling in present
    ]
