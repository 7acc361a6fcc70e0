# SPDX-License-Identifier: Apache-2.0
"""A picture of observability: singular values over time, and the rank."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from impact_observer.draw.pictures import mark_rows
from impact_observer.model.system import unit_of
from impact_observer.observability.rank import Observability
from impact_observer.states import Vector

_STYLES = ("-", (0, (6, 2)), (0, (4, 1, 1, 1)), (0, (1, 1)), "-", (0, (3, 3)))
_NAMED = 6
"""Most singular values, and most contacts, with a label of their own."""


def rank_picture(observed: Observability, *, title: str) -> Figure:
    """Singular values over time on a logarithmic axis with the tolerance, the rank below."""
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (3, 1)})
    t = observed.seconds
    _draw_values(upper, observed, t)
    _mark_impacts(upper, observed, t)
    unit = unit_of("m", observed.system.unit)
    upper.set_ylabel(f"gaps moved by an initial\nerror of one standard deviation [{unit}]")
    upper.set_title(title)
    upper.grid(visible=True, which="major", color="0.9")
    upper.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small", frameon=False)
    lower.step(np.append(0.0, t), np.append(0, observed.rank), where="post", color="black")
    lower.axhline(observed.size, color="0.5", linewidth=0.9, linestyle="--")
    lower.set_ylim(0, observed.size * 1.15)
    lower.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    lower.set_ylabel(f"rank of {observed.size}")
    lower.set_xlabel("time since the start [s]")
    lower.grid(visible=True, which="major", color="0.9")
    upper.margins(x=0.02)
    return figure


def _draw_values(axes: Axes, observed: Observability, t: Vector) -> None:
    """One line a singular value, from the impact on at which it rises above the tolerance."""
    size = observed.size
    labels = ["largest", *(f"number {k + 1}" for k in range(1, size - 1)), "smallest"]
    for k, values in enumerate(observed.singular.T):
        named = size <= _NAMED or k in {0, size - 1}
        axes.semilogy(
            t,
            # Values below the rank are rounding, and zero has no logarithm.
            np.where(observed.rank > k, values, np.nan),
            color=str(0.55 * k / max(size - 1, 1)),
            linewidth=1.3 if named else 0.6,
            linestyle=_STYLES[k % len(_STYLES)] if size <= _NAMED else "-",
            drawstyle="steps-post",
            marker="." if np.count_nonzero(observed.rank > k) == 1 else "",
            label=labels[k] if named and observed.rank[-1] > k else None,
        )
    least = np.where(observed.rank > 0, observed.tolerance * observed.singular[:, 0], np.nan)
    style = {"color": "0.3", "linewidth": 0.9, "linestyle": ":", "drawstyle": "steps-post"}
    axes.semilogy(t, least, label="tolerance", **style)


def _mark_impacts(axes: Axes, observed: Observability, t: Vector) -> None:
    """A row of marks a contact along the upper edge, or one for many; one for releases."""
    hit = ~observed.released
    names = sorted({name for names in observed.contacts for name in names})
    rows = {
        f"impacts at {name}": t[hit & [name in each for each in observed.contacts]]
        for name in names
    }
    if len(rows) > _NAMED:
        rows = {"impacts": t[hit]}
    if observed.released.any():
        rows["releases"] = t[observed.released]
    if (top := float(observed.singular[-1, 0])) > 0:
        # Values below the tolerance are rounding.
        axes.set_ylim(top * observed.tolerance / 30.0, 2.0 * top)
    mark_rows(axes, rows)
