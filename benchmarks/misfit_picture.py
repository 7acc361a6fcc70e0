# SPDX-License-Identifier: Apache-2.0
"""Error and standard deviation on a wrong plant, without and with a learned model error."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.impacts import energy
from benchmarks.misfit_motion import EPOCH, Array, Recording
from benchmarks.misfit_runs import EVERY, FILTER, Followed, expected_energy, followed
from impact_observer import Options
from impact_observer.draw.pictures import save
from impact_observer.model import System
from impact_observer.stamps import NS_PER_S

CASES: tuple[tuple[str, Options], ...] = (
    (
        "model and sensor declared to be without faults",
        Options(law=FILTER, epoch=EPOCH, model_error=0, missed=0, spurious=0, mislabelled=0),
    ),
    ("defaults", Options(law=FILTER, epoch=EPOCH)),
)
"""Titles, with options."""

LIMITS = (1e-5, 5.0)
"""Of the vertical axis."""


def draw(system: System, recording: Recording, path: Path) -> None:
    """Write the picture of one run of a plant beside the model ``system``.

    Errors are square roots of V over the mean energy of the motion.

    Raises:
        UsageError: the picture cannot be written there.
    """
    figure = Figure(figsize=(8.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, (title, options) in zip((left, right), CASES, strict=True):
        _draw(axes, system, recording, followed(system, recording, options))
        axes.set_title(title, fontsize="medium")
        axes.set_xlabel("time in s")
    left.set_ylabel("error over size of the motion")
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save(figure, path, about="Error and two standard deviations on a plant that is not the model")


def _draw(axes: Axes, system: System, recording: Recording, found: Followed) -> None:
    away = recording.away()[::EVERY]
    truth = recording.states[::EVERY][away]
    times = (recording.sample_stamps[::EVERY][away] - EPOCH) / NS_PER_S
    size = np.mean(energy(system, truth))
    error = _root(energy(system, found.states[away] - truth) / size)
    band = 2 * _root(expected_energy(system, found.covariances[away]) / size)
    axes.fill_between(times, 1e-30, band, color="0.85", label="two standard deviations")
    axes.semilogy(times, error, color="black", linewidth=1.0, label="error")
    axes.set_xlim(0, times[-1])
    axes.set_ylim(LIMITS)
    if found.warned is not None:
        at = (recording.stamps[found.warned - 1] - EPOCH) / NS_PER_S
        axes.axvline(at, color="#D55E00", linestyle="--", label="warning: the model does not fit")


def _root(values: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(values, 0.0)))
