# SPDX-License-Identifier: Apache-2.0
"""A picture of how well a model explains the stamps of impacts."""

import numpy as np
from matplotlib.figure import Figure

from impact_observer.identify.identification import Identification
from impact_observer.io.bag_part import TimeZero
from impact_observer.stamps import seconds_between

_MARKERS = "o^sDvx+*"


def fit_picture(fitted: Identification, *, title: str, zero: TimeZero) -> Figure:
    """Errors of the stamps over time, with a band of two standard deviations of the clock.

    Rejected and inserted impacts have no error, so their instants are on the axis of time.

    Args:
        fitted: the fit.
        title: of the picture.
        zero: time zero of the fit.
    """
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    names = sorted({name for each in fitted.contacts for name in each})
    for k, name in enumerate(names):
        own = np.array([name in each for each in fitted.contacts])
        axes.plot(
            fitted.stamps[own],
            fitted.shifts[own],
            linestyle="",
            marker=_MARKERS[k % len(_MARKERS)],
            color=str(0.6 * k / max(len(names) - 1, 1)),
            label=name,
        )
    axes.axhspan(
        -2 * fitted.clock, 2 * fitted.clock, color="0.9", label="2 standard deviations", zorder=0
    )
    recording = fitted.recording
    for hits, marker, colour, label in (
        (recording.rejected_events, "x", "#D55E00", "rejected"),
        (recording.inserted, "o", "#0072B2", "inserted"),
    ):
        if hits:
            axes.plot(
                [seconds_between(recording.episode.epoch, stamp) for stamp, _ in sorted(hits)],
                [0.0] * len(hits),
                linestyle="",
                marker=marker,
                markerfacecolor="none",
                color=colour,
                label=label,
                transform=axes.get_xaxis_transform(),
                clip_on=False,
                zorder=3,
            )
    axes.set_xlabel(zero.axis)
    axes.set_ylabel("model's impact minus stamp [s]")
    axes.set_title(title, fontsize="medium", loc="left", pad=20)
    axes.grid(visible=True, which="major", color="0.85")
    axes.legend(
        fontsize="small", ncols=4, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0)
    )
    return figure
