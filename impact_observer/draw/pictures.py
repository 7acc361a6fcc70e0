# SPDX-License-Identifier: Apache-2.0
"""The common style of pictures: readable in grey and for colour-blind people."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from impact_observer.output_files import check_output, replacing
from impact_observer.states import Vector

mpl.use("Agg", force=False)

Style: TypeAlias = dict[str, Any]
"""Properties of a matplotlib line."""

# The two laws of the paper as in its Figure 2: grey and black. Blue and vermilion are those of
# Okabe and Ito, for people who see no red or no green; in grey, dashes and markers differ.
STYLES: Mapping[str, Style] = {
    "open-loop": {"color": "0.45", "linewidth": 1.1, "linestyle": ":"},
    "kinematic": {"color": "0.58", "linewidth": 2.0, "linestyle": "-"},
    "geometric": {"color": "black", "linewidth": 1.3, "linestyle": "-"},
    "unilateral": {"color": "#0072B2", "linewidth": 1.3, "linestyle": "--", "marker": "o"},
    "minimum-variance": {"color": "#D55E00", "linewidth": 1.1, "linestyle": "-", "marker": "D"},
    "measured-position": {"color": "#009E73", "linewidth": 1.3, "linestyle": "-."},
}
"""Line styles of the built-in laws."""
_OTHER_DASHES = ("-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
_OTHER_MARKERS = "sv*Xph"
_ROW_MARKERS = "|^x<>d+v"
MOST_ROWS = len(_ROW_MARKERS)
"""Most rows of marks: each row has another marker."""
_ROW = 0.05
"""Height of a row of marks, over the height of the axes."""
BAND = 2.0
"""Half the width of a band, in standard deviations."""
MOST_SAMPLES = 20_000
"""Samples of a curve that are drawn one by one; of more, least and largest of each part."""


class BandCurve(NamedTuple):
    """A curve over time with a band of its deviations.

    Attributes:
        t: time, s, ascending, shape (N,).
        y: values, shape (N,).
        deviations: standard deviations of the values, shape (N,); NaN without.
        style: of the line.
    """

    t: Vector
    y: Vector
    deviations: Vector
    style: Style


def draw_bands(axes: Axes, curves: Sequence[BandCurve]) -> None:
    """Draw curves, each in a band; the axis has the range of the curves, not of the bands."""
    drawn = []
    for curve in curves:
        kept = extremes(curve.y)
        t, y, width = (each[kept] for each in (curve.t, curve.y, BAND * curve.deviations))
        (line,) = axes.plot(t, y, **curve.style)
        drawn.append((t, y - width, y + width, line.get_color()))
    ends = axes.get_ylim()
    for t, low, high, colour in drawn:
        if np.isfinite(low).any():
            axes.fill_between(t, low, high, color=colour, alpha=0.22, linewidth=0, zorder=1)
    axes.set_ylim(ends)
    axes.grid(visible=True, which="major", color="0.92")


def extremes(y: Vector) -> NDArray[np.intp]:
    """The places of all values, or where they are very many of the extremes of equal parts."""
    if y.size <= MOST_SAMPLES:
        return np.arange(y.size)
    parts = np.array_split(np.arange(y.size), MOST_SAMPLES // 2)
    pairs = [sorted((part[np.argmin(y[part])], part[np.argmax(y[part])])) for part in parts]
    return np.array(pairs).ravel()


def styles(laws: Sequence[str]) -> list[Style]:
    """A style for each curve; curves of the same law differ in their markers.

    Args:
        laws: name of each curve's law.
    """
    chosen: list[Style] = []
    seen: Counter[str] = Counter()
    others, markers = count(), count()
    for law in laws:
        style = STYLES.get(law)
        if style is None:
            style = {"color": "0.2", "linewidth": 1.1}
            style["linestyle"] = _OTHER_DASHES[next(others) % len(_OTHER_DASHES)]
        if seen[law] or law not in STYLES:
            style = {**style, "marker": _OTHER_MARKERS[next(markers) % len(_OTHER_MARKERS)]}
        seen[law] += 1
        chosen.append({"markersize": 4.5, "markerfacecolor": "white", **style})
    return chosen


def mark_rows(axes: Axes, rows: Mapping[str, Vector]) -> None:
    """Rows of marks along the upper edge of logarithmic axes, above all curves.

    Args:
        axes: axes that have all curves.
        rows: positions of the marks, s, by label; at most ``MOST_ROWS``.
    """
    below, above = axes.get_ylim()
    room = _ROW * (len(rows) + 0.1)
    if rows:
        axes.set_ylim(below, above * (above / below) ** (room / (1 - room)))
    for row, (label, at) in enumerate(rows.items()):
        axes.plot(
            at,
            np.full(at.size, 1 - _ROW * (row + 0.6)),
            linestyle="none",
            marker=_ROW_MARKERS[row],
            markersize=5,
            markerfacecolor="white",
            color="0.25",
            label=label,
            transform=axes.get_xaxis_transform(),
        )


def save(figure: Figure, path: Path, *, about: str = "") -> None:
    """Write ``figure`` to ``path`` as PNG, SVG or PDF, by the suffix.

    Args:
        figure: of matplotlib.
        path: of the file; an existing file is replaced, but not one that was read.
        about: title in the metadata of the file.

    Raises:
        UsageError: another suffix, a folder that does not exist, or the file may not be written.
        OutputError: the disk is full or gone.
    """
    check_output(path)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=150, metadata={"Title": about} if about else None)
