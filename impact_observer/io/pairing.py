# SPDX-License-Identifier: Apache-2.0
"""Truth and estimates in pairs of equal stamps."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S, text
from impact_observer.states import Stamps

HOLD = 10 * NS_PER_S
"""Longest time by which a state may be older than one before it in the bag, ns: an observer
publishes an estimate again when a late event corrects the state."""
Samples: TypeAlias = NDArray[np.void]
"""States at stamps, as of ``samples_of``."""
Pairs: TypeAlias = NDArray[np.void]
"""Rows with the ``stamp`` (ns), the states ``truth`` and ``estimate``, shape (2n,), and the
``last_event`` and ``deviation`` of the estimate; ascending stamps."""


def samples_of(
    stamps: Stamps,
    x: NDArray[np.float64],
    last_event: Stamps | None = None,
    deviations: NDArray[np.float64] | None = None,
) -> Samples:
    """States as rows of ``stamp``, ``last_event``, ``x`` and ``deviation``.

    Args:
        stamps: ns, shape (samples,).
        x: states (q, u), shape (samples, 2n).
        last_event: stamp of the last event that each contains, ns, 0 for none; None where each
            contains all events before it.
        deviations: standard deviations of ``x``; None for rows without.
    """
    deviations = np.empty((stamps.size, 0)) if deviations is None else deviations
    row = [("stamp", "i8"), ("last_event", "i8"), ("x", "f8", x.shape[1:])]
    samples = np.empty(stamps.size, [*row, ("deviation", "f8", deviations.shape[1:])])
    samples["stamp"], samples["x"], samples["deviation"] = stamps, x, deviations
    samples["last_event"] = np.iinfo(np.int64).max if last_event is None else last_event
    return samples


def fresh(samples: Samples) -> Samples:
    """Samples, in the order of the bag, without those more than ``HOLD`` older than one before."""
    newest = np.maximum.accumulate(samples["stamp"]) if samples.size else samples["stamp"]
    return np.asarray(samples[samples["stamp"] > newest - HOLD])


def paired(truth: Samples, estimates: Samples) -> Pairs:
    """Truth and estimates, in any order, at their common stamps; of equal ones the last counts."""
    true_states, estimated = _last_of_each_stamp(truth), _last_of_each_stamp(estimates)
    common, of_truth, of_estimates = np.intersect1d(
        true_states["stamp"], estimated["stamp"], assume_unique=True, return_indices=True
    )
    state = truth.dtype["x"]
    row = [("stamp", "i8"), ("last_event", "i8"), ("truth", state), ("estimate", state)]
    pairs = np.empty(common.size, [*row, ("deviation", estimates.dtype["deviation"])])
    pairs["stamp"], pairs["truth"] = common, true_states["x"][of_truth]
    pairs["estimate"] = estimated["x"][of_estimates]
    pairs["last_event"] = estimated["last_event"][of_estimates]
    pairs["deviation"] = estimated["deviation"][of_estimates]
    return pairs


def _last_of_each_stamp(samples: Samples) -> Samples:
    """The last sample of each stamp, by stamp."""
    from_behind = np.unique(samples["stamp"][::-1], return_index=True)[1]
    return np.asarray(samples[samples.size - 1 - from_behind])


def stamp_range(samples: Samples) -> str:
    """The first and the last stamp, in words."""
    if not samples.size:
        return "none"
    stamps = samples["stamp"]
    return f"{text(int(stamps.min()))} to {text(int(stamps.max()))} s"


def arrived(stamps: Stamps, last_event: Stamps, reported: Stamps) -> NDArray[np.bool_]:
    """Mask of the estimates that contain all events before them, and came not too early.

    Args:
        stamps: of the estimates, ns, shape (samples,).
        last_event: stamp of the last event that each contains, ns, shape (samples,).
        reported: stamps of the events that the observer used, ns, ascending, shape (reported,).
    """
    due = np.concatenate([[0], reported])
    return np.asarray(last_event >= due[np.searchsorted(due, stamps, side="right") - 1])
