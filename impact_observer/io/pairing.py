# SPDX-License-Identifier: Apache-2.0
"""Truth and estimates in pairs of equal stamps, read block by block."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S, text
from impact_observer.states import Stamps

HOLD = 10 * NS_PER_S
"""By how much a state may be stamped before the latest one, ns: an observer publishes an estimate
again when a late event corrects it."""
Samples: TypeAlias = NDArray[np.void]
"""States at stamps, rows of ``sample_type``."""
Pairs: TypeAlias = NDArray[np.void]
"""Rows with the ``stamp`` (ns), the states ``truth`` and ``estimate``, shape (2n,), and the
``last_event`` of the estimate; ascending stamps."""


def sample_type(size: int) -> np.dtype[np.void]:
    """A ``stamp`` (ns), a state ``x`` (q, u) of ``size`` numbers, and its ``last_event``.

    That is the stamp of the last event that an estimate contains, ns, 0 for none.
    """
    return np.dtype([("stamp", "i8"), ("last_event", "i8"), ("x", "f8", (size,))])


def samples_of(
    stamps: Stamps, x: NDArray[np.float64], last_event: Stamps | None = None
) -> Samples:
    """States ``x``, shape (samples, 2n), at ``stamps`` (ns).

    Without ``last_event`` every estimate contains all events before it.
    """
    samples = np.empty(stamps.size, sample_type(x.shape[1]))
    samples["stamp"], samples["x"] = stamps, x
    samples["last_event"] = np.iinfo(np.int64).max if last_event is None else last_event
    return samples


class Pairing:
    """Pairs two series that come block by block; of states with equal stamps the last one counts.

    Attributes:
        truth: where to add blocks of the true states.
        estimates: where to add blocks of the estimates.
    """

    def __init__(self) -> None:
        self.truth = Stream()
        self.estimates = Stream()

    def ready(self, *, done: bool = False) -> Pairs | None:
        """The pairs that no later block can change, each once; None where there are none.

        Args:
            done: whether both series have ended.
        """
        horizon = min(self.truth.newest, self.estimates.newest)
        if not done:
            horizon -= HOLD
        truth, estimates = self.truth.take(horizon), self.estimates.take(horizon)
        if truth is None or estimates is None:
            return None
        common, of_truth, of_estimates = np.intersect1d(
            truth["stamp"], estimates["stamp"], assume_unique=True, return_indices=True
        )
        state = truth.dtype["x"]
        row = [("stamp", "i8"), ("last_event", "i8"), ("truth", state), ("estimate", state)]
        pairs = np.empty(common.size, row)
        pairs["stamp"], pairs["truth"] = common, truth["x"][of_truth]
        pairs["estimate"] = estimates["x"][of_estimates]
        pairs["last_event"] = estimates["last_event"][of_estimates]
        return pairs

    def ranges(self) -> str:
        """The first and last stamps of both series, in words."""
        return f"truth {self.truth.range()}, estimate {self.estimates.range()}"


class Stream:
    """One of two series, kept as far as it is ahead of the other, and ``HOLD``.

    Attributes:
        newest: the latest stamp so far, ns; 0 before the first.
        stale: states left out because they came more than ``HOLD`` after later ones.
    """

    def __init__(self) -> None:
        self.newest = 0
        self.stale = 0
        self._oldest: int | None = None
        self._taken = 0
        self._waiting: list[Samples] = []

    def add(self, block: Samples) -> None:
        """Add the next states."""
        if not block.size:
            return
        first, last = int(block["stamp"].min()), int(block["stamp"].max())
        self._oldest = first if self._oldest is None else min(first, self._oldest)
        self.newest = max(self.newest, last)
        fresh = block[block["stamp"] > self._taken]
        self.stale += block.size - fresh.size
        self._waiting.append(fresh)

    def take(self, horizon: int) -> Samples | None:
        """The states up to ``horizon`` (ns), by stamp, each stamp once; None if there are none."""
        if horizon <= self._taken or not self._waiting:
            return None
        waiting = np.concatenate(self._waiting)
        if not (np.diff(waiting["stamp"]) > 0).all():
            # Found from behind: of equal stamps the last one counts.
            from_behind = np.unique(waiting["stamp"][::-1], return_index=True)[1]
            waiting = waiting[waiting.size - 1 - from_behind]
        due = int(np.searchsorted(waiting["stamp"], horizon, side="right"))
        self._waiting = [waiting[due:]]
        self._taken = horizon
        return waiting[:due] if due else None

    def range(self) -> str:
        """The first and the last stamp, in words."""
        return "none" if self._oldest is None else f"{text(self._oldest)} to {text(self.newest)} s"


def arrived(stamps: Stamps, last_event: Stamps, reported: Stamps) -> NDArray[np.bool_]:
    """Which estimates contain all events before them; the others were published too early.

    Args:
        stamps: of the estimates, ns, shape (samples,).
        last_event: stamp of the last event that each contains, ns, shape (samples,).
        reported: stamps of the reported events that the observer used, ns, ascending, shape
            (reported,).
    """
    due = np.concatenate([[0], reported])
    return np.asarray(last_event >= due[np.searchsorted(due, stamps, side="right") - 1])
