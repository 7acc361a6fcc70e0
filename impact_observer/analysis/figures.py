"""Pictures: readable in grey and for colour-blind people, units on every axis."""

from collections import Counter
from collections.abc import Mapping, Sequence
from io import StringIO
from itertools import count
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from impact_observer.analysis.comparison import Comparison
from impact_observer.errors import UsageError
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps, Vector

mpl.use("Agg", force=False)

Style: TypeAlias = dict[str, Any]
"""What matplotlib calls the properties of a line."""

# The paper's own two as in its Figure 2: grey and black. Blue and vermilion are those of Okabe and
# Ito, for eyes that see no red or no green; in grey the dashes and the marks tell them apart.
STYLES: Mapping[str, Style] = {
    "open-loop": {"color": "0.45", "linewidth": 1.1, "linestyle": ":"},
    "kinematic": {"color": "0.58", "linewidth": 2.0, "linestyle": "-"},
    "geometric": {"color": "black", "linewidth": 1.3, "linestyle": "-"},
    "unilateral": {"color": "#0072B2", "linewidth": 1.3, "linestyle": "--", "marker": "o"},
    "minimum-variance": {"color": "#D55E00", "linewidth": 1.1, "linestyle": "-", "marker": "D"},
}
"""How the built-in laws are drawn."""
_OTHER_DASHES = ("-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
_OTHER_MARKERS = "sv*Xph"
_ROW_MARKERS = "|^x<>d+v"
MOST_ROWS = len(_ROW_MARKERS)
"""Most rows of marks that are told apart."""
MOST_COORDINATES = 8
"""Most coordinates whose errors are drawn."""
_MARKERS_A_CURVE = 9
_ROW = 0.05
"""Height of a row of impacts, of that of the axes."""
_SIZE, _PAPER_SIZE = (8.0, 5.0), (3.46, 3.0)
"""Inches; a column of a printed page is 88 mm wide."""
_FONT, _PAPER_FONT = 10.0, 7.5
_ROOM, _PAPER_ROOM = 108, 54
"""Letters of a legend side by side above the axes."""
_HANDLE = 11
"""Letters that the line before a legend's label takes, with the room about it."""


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


def styles(laws: Sequence[str]) -> list[Style]:
    """A style for each curve; where a law comes again, marks tell its curves apart.

    Args:
        laws: name of each curve's law.
    """
    found: list[Style] = []
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
        found.append({"markersize": 4.5, "markerfacecolor": "white", **style})
    return found


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


def mark_rows(axes: Axes, rows: Mapping[str, Vector]) -> None:
    """Rows of marks along the upper edge of logarithmic axes, above all curves.

    Args:
        axes: with everything else in it.
        rows: where the marks stand, s, by label; at most ``MOST_ROWS``.
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
    """Write ``figure`` to ``path``; the ending says how: PNG, SVG or PDF.

    Args:
        figure: what to write.
        path: where; a picture that is there is replaced.
        about: what it shows, kept in the file beside the picture itself.

    Raises:
        UsageError: another ending, or a folder that does not exist.
    """
    check_picture(path)
    try:
        figure.savefig(path, dpi=150, metadata={"Title": about} if about else None)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def svg(figure: Figure) -> str:
    """``figure`` as SVG, to be put into a page."""
    file = StringIO()
    # Names that do not depend on chance: the same figure makes the same text.
    with mpl.rc_context({"svg.hashsalt": "impact_observer"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    return text[text.index("<svg") :]


def check_picture(path: Path, endings: Sequence[str] = (".png", ".svg", ".pdf")) -> None:
    """Raise unless a picture can be written to ``path``.

    Raises:
        UsageError: its ending is none of ``endings``, or its folder does not exist.
    """
    if path.suffix.lower() not in endings:
        raise UsageError(f"{path}: expected a name that ends in {', '.join(endings)}")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: no folder {path.parent}; make it first")
