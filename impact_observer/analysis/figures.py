"""Pictures: readable in grey, units on every axis."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from impact_observer.analysis.comparison import Comparison
from impact_observer.errors import UsageError
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps

mpl.use("Agg", force=False)

_STYLES = {
    "geometric": {"color": "black", "linewidth": 1.3, "linestyle": "-"},
    "kinematic": {"color": "0.55", "linewidth": 1.3, "linestyle": "-"},
    "open-loop": {"color": "0.3", "linewidth": 0.9, "linestyle": ":"},
}
_OTHERS = ("--", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
_MARKS = "|^v<>dxs"


def lyapunov_figure(
    comparisons: Mapping[str, Comparison],
    impacts: Mapping[str, Stamps],
    *,
    title: str,
    epoch: int,
) -> Figure:
    """``V`` over time on a logarithmic axis, after Figure 2 of Baumann and Leine.

    Args:
        comparisons: one curve each, by label.
        impacts: stamps of the impacts (ns), by contact.
        title: of the picture.
        epoch: stamp at which the time axis begins, ns.
    """
    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    others = iter(_OTHERS * len(comparisons))
    for label, comparison in comparisons.items():
        style = _STYLES.get(comparison.law)
        if style is None:
            style = {"color": "0.2", "linewidth": 1.1, "linestyle": next(others)}
        # Zero has no logarithm: a gap says that the estimate is exact there.
        V = np.where(comparison.V > 0, comparison.V, np.nan)
        axes.semilogy((comparison.stamps - epoch) / NS_PER_S, V, label=label, **style)
    axes.set_xlabel("time since the epoch [s]")
    axes.set_ylabel("Lyapunov distance V [J]")
    axes.set_title(title)
    axes.grid(visible=True, which="major", color="0.9")
    _mark_impacts(axes, impacts, epoch)
    axes.legend(loc="lower left", fontsize="small")
    axes.margins(x=0.01)
    return figure


def _mark_impacts(axes: Axes, impacts: Mapping[str, Stamps], epoch: int) -> None:
    """A row of marks a contact along the upper edge."""
    for row, (contact, stamps) in enumerate(impacts.items()):
        axes.plot(
            (stamps - epoch) / NS_PER_S,
            np.full(stamps.size, 0.975 - 0.045 * row),
            linestyle="none",
            marker=_MARKS[row % len(_MARKS)],
            markersize=6,
            markerfacecolor="white",
            color="0.25",
            label=f"impacts at {contact}",
            transform=axes.get_xaxis_transform(),
        )


def save(figure: Figure, path: Path) -> None:
    """Write ``figure`` to ``path``; the ending says how: PNG, SVG or PDF.

    Raises:
        UsageError: another ending, or a folder that does not exist.
    """
    check_picture(path)
    try:
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def check_picture(path: Path, endings: Sequence[str] = (".png", ".svg", ".pdf")) -> None:
    """Raise unless a picture can be written to ``path``.

    Raises:
        UsageError: its ending is none of ``endings``, or its folder does not exist.
    """
    if path.suffix.lower() not in endings:
        raise UsageError(f"{path}: expected a picture's name that ends in {', '.join(endings)}")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: no folder {path.parent}; make it first")
