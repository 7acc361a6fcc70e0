# SPDX-License-Identifier: Apache-2.0
"""A picture of a sweep: settling times against a swept quantity."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from impact_observer.draw.pictures import Style, save, styles
from impact_observer.errors import UsageError
from impact_observer.model import parse_model
from impact_observer.sweep.plan import OFF, SENSOR, Label, Sweep
from impact_observer.sweep.summary import CaseGroup

LAW = "law"
MOST_PANELS = 6
"""Most panels: each has one combination of the swept quantities beside the horizontal axis."""
_WIDE = 20.0
"""Ratio of largest to least value from which the axis is logarithmic."""
_SIZE, _PANEL = (3.0, 5.2), 3.6
"""Margin and height of the picture, and width of a panel, inches."""
_SHADE = 0.15
_ZONE = (1.05, 1.15, 1.25)
"""Lower edge, middle, upper edge of the zone of runs that never settle, over the longest time."""


def against_of(sweep: Sweep, wanted: str | None) -> str:
    """The label of the horizontal axis; ``LAW`` if nothing is swept.

    Args:
        sweep: the sweep.
        wanted: name of the quantity as users write it; None for the first swept quantity.

    Raises:
        UsageError: no such label is swept, or the others have too many values.
    """
    swept = sweep.swept
    names = {each.removeprefix(SENSOR).removeprefix(OFF).replace("_", "-"): each for each in swept}
    names[LAW] = LAW
    label = next(iter(swept), LAW) if wanted is None else names.get(wanted.replace("_", "-"))
    if label is None:
        raise UsageError(
            f"--against {wanted}: has not several values; expected one of {', '.join(names)}"
        )
    panels = math.prod(len(values) for name, values in swept.items() if name != label)
    if panels > MOST_PANELS:
        raise UsageError(
            f"--plot: {panels} combinations of the quantities beside the axis found; expected at"
            f" most {MOST_PANELS}: put another quantity there with --against, or sweep fewer"
        )
    return label


def save_picture(
    sweep: Sweep, groups: Sequence[CaseGroup], path: Path, *, against: str | None = None
) -> None:
    """Draw the settling times into a PNG, SVG or PDF file, as ``sweep_picture``.

    Raises:
        UsageError: as ``against_of``, or the file cannot be written.
    """
    save(sweep_picture(sweep, groups, against=against), path, about=_title(sweep))


def _title(sweep: Sweep) -> str:
    name = parse_model(sweep.plant.text, "model").system.name
    return f"{name}: when estimates settle, medians and quartiles of {sweep.runs} runs"


def sweep_picture(
    sweep: Sweep, groups: Sequence[CaseGroup], *, against: str | None = None
) -> Figure:
    """Settling times above, the share that has not settled below.

    A line is a median, the band about it the quartiles. Each combination of the quantities that
    are not on the horizontal axis has a panel.

    Args:
        sweep: what was swept.
        groups: its outcomes.
        against: see ``against_of``.

    Raises:
        UsageError: as ``against_of``.
    """
    label = against_of(sweep, against)
    panels: dict[tuple[tuple[str, Label], ...], list[CaseGroup]] = {}
    for group in groups:
        others = tuple((name, value) for name, value in group.labels.items() if name != label)
        panels.setdefault(others, []).append(group)
    ceiling, never = _ceiling(groups, sweep.plant.duration)
    with mpl.rc_context({"font.size": 10.0}):
        width = _SIZE[0] + _PANEL * len(panels)
        figure = Figure(figsize=(max(width, 8.0), _SIZE[1]), layout="constrained")
        grid = figure.subplots(
            2,
            len(panels),
            sharex="col",
            sharey="row",
            squeeze=False,
            gridspec_kw={"height_ratios": (3, 1)},
        )
        for column, (others, shown) in enumerate(panels.items()):
            upper, lower = grid[:, column]
            _draw(upper, lower, sweep, shown, label=label, ceiling=ceiling)
            upper.set_title(
                ", ".join(_value_of(sweep, *each) for each in others), fontsize="small"
            )
            lower.set_xlabel("law" if label == LAW else sweep.title(label))
        upper, lower = grid[:, 0]
        upper.set_ylabel(f"settling time (V < {sweep.settled:g} V0) [s]")
        upper.set_ylim(0, (_ZONE[2] if never else _ZONE[0]) * ceiling)
        lower.set_ylabel("not settled [%]")
        lower.set_ylim(-5, 105)
        if never:
            for axes in grid[0]:
                _mark_zone(axes, ceiling)
        if label != LAW:  # its axis names the laws
            figure.legend(
                *upper.get_legend_handles_labels(),
                loc="outside lower left",
                ncol=min(len(sweep.laws), 4),
                fontsize="small",
                frameon=False,
                handlelength=3.2,
            )
        figure.suptitle(_title(sweep), x=0.01, ha="left", fontsize="medium")
    return figure


def _ceiling(groups: Sequence[CaseGroup], duration: float) -> tuple[float, bool]:
    """The largest finite time, s, and whether any is infinite."""
    times = [time for group in groups for time in group.settling_time or ()]
    finite = [time for time in times if math.isfinite(time)]
    return max(finite, default=duration) or duration, len(finite) < len(times)


def _draw(
    upper: Axes,
    lower: Axes,
    sweep: Sweep,
    groups: Sequence[CaseGroup],
    *,
    label: str,
    ceiling: float,
) -> None:
    """Draw one panel, with a curve for each law."""
    for place, (law, style) in enumerate(zip(sweep.laws, styles(sweep.laws), strict=True)):
        own = [group for group in groups if group.law == law]
        x = np.array([place if label == LAW else float(each.labels[label]) for each in own])
        order = np.argsort(x)
        _draw_law(upper, lower, [own[i] for i in order], x[order], style=style, ceiling=ceiling)
    for axes in (upper, lower):
        axes.grid(visible=True, which="major", color="0.9")
        axes.margins(x=0.04)
    if label == LAW:
        lower.set_xticks(range(len(sweep.laws)), sweep.laws)
        lower.set_xlim(-0.5, len(sweep.laws) - 0.5)
    else:
        _scale(lower, sweep.swept[label])


def _draw_law(
    upper: Axes,
    lower: Axes,
    groups: Sequence[CaseGroup],
    x: np.ndarray,
    *,
    style: Style,
    ceiling: float,
) -> None:
    """Draw the curves of one law; a group in which all cases failed is a gap."""
    nothing = (np.nan, np.nan, np.nan)
    times = np.array([group.settling_time or nothing for group in groups])
    low, median, high = np.where(np.isinf(times), _ZONE[1] * ceiling, times).T
    shares = [np.nan if each.not_settled is None else 100 * each.not_settled for each in groups]
    marked = {"marker": "s", **style}
    if len(groups) > 1:
        upper.fill_between(x, low, high, color=style["color"], alpha=_SHADE, linewidth=0)
    else:
        upper.vlines(x, low, high, color=style["color"], linewidth=4, alpha=2 * _SHADE)
    upper.plot(x, median, label=groups[0].law, **marked)
    lower.plot(x, shares, **marked)


def _scale(axes: Axes, values: Sequence[Label]) -> None:
    """Scale the horizontal axis: linear, or logarithmic over decades, also from zero."""
    if any(isinstance(value, bool) for value in values):
        axes.set_xticks([0, 1], ["no", "yes"])
        return
    sizes = sorted(abs(float(value)) for value in values if value)
    if sizes and sizes[-1] / sizes[0] >= _WIDE:
        if all(float(value) > 0 for value in values):
            axes.set_xscale("log")
        else:
            axes.set_xscale("symlog", linthresh=sizes[0])
    elif len(values) <= MOST_PANELS:
        axes.set_xticks([float(value) for value in values])


def _mark_zone(axes: Axes, ceiling: float) -> None:
    """Mark the zone of runs that never settle; the zone has no scale."""
    low, middle, high = (each * ceiling for each in _ZONE)
    axes.axhspan(
        low, high, facecolor="0.96", hatch="////", edgecolor="0.85", linewidth=0, zorder=0
    )
    ticks = [float(tick) for tick in MaxNLocator(6).tick_values(0, ceiling) if 0 <= tick < low]
    axes.set_yticks([*ticks, middle], [*(f"{tick:g}" for tick in ticks), "never"])


def _value_of(sweep: Sweep, label: str, value: Label) -> str:
    """A value with its quantity, such as ``missed 0.1`` or ``jitter 0.001 s``."""
    words, _, unit = sweep.title(label).rstrip("]").partition(" [")
    shown = {True: "yes", False: "no"}[value] if isinstance(value, bool) else f"{value:g}"
    return f"{words} {shown} {unit}".rstrip()
