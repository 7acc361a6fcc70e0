# SPDX-License-Identifier: Apache-2.0
"""Pictures of signals in which impacts were detected."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import impact_observer.draw.pictures  # noqa: F401 (the backend that needs no display)
from impact_observer.io.bag_part import TimeZero
from impact_observer.stamps import NS_PER_S, seconds_between

_WIDTH, _HEIGHT = 9.0, 2.6
"""Size of the picture of one sensor, inches."""
_AROUND = 1.5
"""Dead times before and after the one that is drawn larger."""


class Trace(Protocol):
    """The signal of a sensor; stamps in ns."""

    stamps: list[int]
    signal: list[float]
    dead: list[tuple[int, int]]
    impacts: list[int]
    suppressed: list[int]


def detection_picture(
    names: Sequence[str],
    thresholds: Sequence[float | None],
    traces: Sequence[Trace],
    zero: TimeZero,
) -> Figure:
    """A row for each sensor: the whole signal, and its part around a dead time.

    That dead time is the first one in which something was suppressed, else the first.

    Args:
        names: of the sensors.
        thresholds: in the unit of the signal; None for a sensor without one.
        traces: the signals.
        zero: of the axis of time; ``--start`` counts from the same instant.
    """
    figure = Figure(figsize=(_WIDTH, _HEIGHT * max(len(traces), 1)), layout="constrained")
    grid = figure.subplots(len(traces), 2, squeeze=False, width_ratios=(2, 1))
    for row, name, threshold, trace in zip(grid, names, thresholds, traces, strict=True):
        for axes in row:
            _draw(axes, trace, threshold, zero.stamp)
        row[0].set_ylabel(f"{name}\n[unit of the field]")
        row[1].set_xlim(*_part(trace, zero.stamp))
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    figure.supxlabel(zero.axis)
    return figure


def _draw(axes: Axes, trace: Trace, threshold: float | None, zero: int) -> None:
    t = _seconds(trace.stamps, zero)
    axes.plot(t, trace.signal, color="0.4", linewidth=0.8, label="signal")
    if threshold is not None:
        axes.axhline(threshold, color="black", linewidth=0.8, linestyle="--", label="threshold")
    for k, (begin, end) in enumerate(trace.dead):
        span = seconds_between(zero, begin), seconds_between(zero, end)
        axes.axvspan(*span, color="0.9", label=None if k else "dead time")
    for stamps, marker, colour, label in (
        (trace.impacts, "v", "#0072B2", "impacts"),
        (trace.suppressed, "x", "#D55E00", "suppressed"),
    ):
        at = _seconds(stamps, zero)
        y = np.interp(at, t, trace.signal) if trace.stamps else at
        axes.plot(at, y, marker, color=colour, label=label)


def _part(trace: Trace, zero: int) -> tuple[float, float]:
    """The ends of the part that is drawn larger, s; the whole without a dead time."""
    if not trace.dead:
        ends = (trace.stamps[0], trace.stamps[-1]) if trace.stamps else (zero, zero + NS_PER_S)
        return seconds_between(zero, ends[0]), seconds_between(zero, ends[1])
    first = min(trace.suppressed, default=trace.dead[0][0])
    begin, end = max((each for each in trace.dead if each[0] <= first), default=trace.dead[0])
    margin = _AROUND * max(end - begin, 1_000_000)
    return (begin - margin - zero) / NS_PER_S, (end + margin - zero) / NS_PER_S


def _seconds(stamps: Sequence[int], zero: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return (np.array(stamps, dtype=np.int64) - zero) / NS_PER_S
