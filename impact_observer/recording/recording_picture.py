# SPDX-License-Identifier: Apache-2.0
"""The picture of a fitted recording: signal, motion and the energy of each hit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from impact_observer.detector import Source
from impact_observer.detector.peak import RINGING
from impact_observer.detector.sensors import SignalTrace
from impact_observer.draw.pictures import BAND, BandCurve, draw_bands, extremes
from impact_observer.events import ImpactEstimate, Ruling
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Stamps, Vector

_COLOURS = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
"""Colours of coordinates and contacts (Okabe and Ito)."""
_LAGS = np.linspace(0.0, 4.0, 17)
"""Times after an impact at which the threshold above the ringing is drawn, over its decay."""
_THRESHOLD: Mapping[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": "--"}
"""How thresholds are drawn."""
_DETAIL = 8
"""Impacts in the part that is drawn larger."""


@dataclass(frozen=True, slots=True, eq=False)
class PlottedSignal:
    """A signal in which impacts were found, as it is drawn.

    Attributes:
        source: the sensor.
        trace: the signal as its threshold sees it.
        refused: stamps of peaks that are no impacts, ns.
    """

    source: Source
    trace: SignalTrace
    refused: Stamps


@dataclass(frozen=True, slots=True, eq=False)
class PlottedMotion:
    """The smoothed motion as it is drawn.

    Attributes:
        names: of the coordinates.
        stamps: ns, shape (k,).
        positions: m or rad, shape (k, n).
        deviations: standard deviations of the positions, shape (k, n).
    """

    names: Sequence[str]
    stamps: Stamps
    positions: Matrix
    deviations: Matrix


def recording_picture(
    signals: Sequence[PlottedSignal],
    motion: PlottedMotion,
    impacts: Sequence[ImpactEstimate],
    *,
    zero: int,
    units: tuple[str, str],
    title: str,
) -> Figure:
    """Rows of signals, positions and energies: the whole recording, and a part of it.

    Args:
        signals: none where impacts were not found in a signal.
        motion: the smoothed motion.
        impacts: the estimates of all impacts.
        zero: stamp of the time zero of the axis, ns.
        units: of positions and of energies.
        title: above all rows.
    """
    figure, grid = _rows(len(signals) + 2, title)
    contacts = [*dict.fromkeys(each.contact for each in impacts if each.contact)]
    for column in grid.T:
        _draw_motion(column[-2], motion, zero)
        _draw_energy(column[-1], impacts, contacts, zero)
    labels = [f"position [{units[0]}]", f"energy lost [{units[1]}]"]
    _finish(grid, signals, labels, [each.stamp for each in impacts], zero)
    return figure


def signal_picture(signals: Sequence[PlottedSignal], *, zero: int, title: str) -> Figure:
    """Rows of signals alone, as :func:`recording_picture` has them.

    Args:
        signals: one at least.
        zero: stamp of the time zero of the axis, ns.
        title: above all rows.
    """
    figure, grid = _rows(len(signals), title)
    _finish(grid, signals, [], [at for each in signals for at in each.trace.impacts], zero)
    return figure


def _rows(count: int, title: str) -> tuple[Figure, NDArray[np.object_]]:
    """Return a figure and its axes, shape (count, 2): of the whole recording and of a part."""
    figure = Figure(figsize=(11.0, 2.3 * count), layout="constrained")
    figure.suptitle(title)
    return figure, figure.subplots(count, 2, sharex="col", squeeze=False, width_ratios=(3, 2))


def _finish(
    grid: NDArray[np.object_],
    signals: Sequence[PlottedSignal],
    labels: Sequence[str],
    stamps: Sequence[int],
    zero: int,
) -> None:
    """Draw the signals in the first rows, name all rows, and choose the part around ``stamps``."""
    for column in grid.T:
        for axes, signal in zip(column, signals, strict=False):
            _draw_signal(axes, signal, zero)
        column[-1].set_xlabel("time [s]")
    for axes, signal in zip(grid[:, 1], signals, strict=False):
        if signal.source.decay and signal.trace.impacts:
            _draw_ringing(axes, signal, zero)
    names = [f"{signal.source.contact}: {signal.source.topic}" for signal in signals]
    for axes, label in zip(grid[:, 0], [*names, *labels], strict=True):
        axes.set_ylabel(label)
        axes.legend(loc="upper right", fontsize="small", ncols=3)
    if stamps:
        grid[0, 1].set_xlim(*_detail(stamps, zero))


def _draw_signal(axes: Axes, drawn: PlottedSignal, zero: int) -> None:
    """Draw a signal with its threshold, its impacts and the peaks that are none."""
    source, trace = drawn.source, drawn.trace
    stamps, signal = np.array(trace.stamps, dtype=np.int64), np.array(trace.signal)
    kept = extremes(signal)
    axes.plot(_seconds(stamps[kept], zero), signal[kept], color="0.55", linewidth=0.5)
    if source.threshold is not None:
        axes.axhline(source.threshold, **_THRESHOLD)
    for at, colour, label in (
        (drawn.refused, "0.7", "refused"),
        (np.array(trace.impacts, dtype=np.int64), _COLOURS[0], "impacts"),
    ):
        heights = np.interp(at, stamps, signal) if stamps.size else np.zeros(at.size)
        axes.plot(_seconds(at, zero), heights, "v", color=colour, markersize=4, label=label)


def _draw_ringing(axes: Axes, drawn: PlottedSignal, zero: int) -> None:
    """Draw the threshold above the ringing after each impact."""
    source, trace = drawn.source, drawn.trace
    tops, gap = np.array(trace.impacts, dtype=np.int64), np.nan
    heights = np.interp(tops, np.array(trace.stamps, dtype=np.int64), trace.signal)
    ringing = RINGING * heights[:, None] * np.append(np.exp(-_LAGS), gap)
    t = _seconds(tops, zero)[:, None] + source.number("decay") * np.append(_LAGS, gap)
    threshold = np.hypot(source.number("threshold"), ringing)
    axes.plot(t.ravel(), threshold.ravel(), **_THRESHOLD)


def _draw_motion(axes: Axes, motion: PlottedMotion, zero: int) -> None:
    """Draw all positions with bands of their deviations."""
    t = _seconds(motion.stamps, zero)
    styles = [{"color": colour, "linewidth": 0.9} for colour in _COLOURS]
    columns = zip(motion.names, motion.positions.T, motion.deviations.T, styles, strict=False)
    draw_bands(
        axes, [BandCurve(t, q, d, {**style, "label": name}) for name, q, d, style in columns]
    )


def _draw_energy(
    axes: Axes, impacts: Sequence[ImpactEstimate], contacts: Sequence[str], zero: int
) -> None:
    """Draw the energy that each impact takes, with two deviations."""
    for contact, colour in zip(contacts, _COLOURS * len(contacts), strict=False):
        own = [e for e in impacts if e.contact == contact and e.ruling is not Ruling.REJECTED]
        t = _seconds(np.array([each.stamp for each in own], dtype=np.int64), zero)
        energy = [each.energy_loss for each in own]
        error = [max(BAND * each.energy_loss_deviation, 0.0) for each in own]
        axes.vlines(t, 0.0, energy, color=colour, linewidth=0.8)
        axes.errorbar(
            t, energy, error, fmt="o", color=colour, markersize=3, linewidth=0.8, label=contact
        )
    axes.set_ylim(bottom=0.0)


def _detail(stamps: Sequence[int], zero: int) -> tuple[float, float]:
    """Return the ends of the part with the middle impacts, s."""
    middle = max(len(stamps) - _DETAIL, 0) // 2
    part = np.array(sorted(stamps)[middle : middle + _DETAIL], dtype=np.int64)
    t = _seconds(part, zero)
    margin = 0.05 * float(np.ptp(t)) or 1.0
    return float(t[0]) - margin, float(t[-1]) + margin


def _seconds(stamps: Stamps, zero: int) -> Vector:
    return np.asarray((stamps - zero) / NS_PER_S)
