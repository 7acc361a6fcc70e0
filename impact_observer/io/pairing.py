"""Truth and estimates in pairs of equal stamps, read block by block."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S, text
from impact_observer.states import Stamps

HOLD = 10 * NS_PER_S
"""By how much a state may be stamped before the latest one, ns: an observer publishes an estimate
again when a late event corrects it."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """States at stamps.

    Attributes:
        stamps: ns, shape (samples,).
        x: states (q, u), shape (samples, 2n).
        last_event: stamp of the last event that each estimate contains, ns, 0 for none, shape
            (samples,); None where every estimate contains all events before it.
    """

    stamps: Stamps
    x: NDArray[np.float64]
    last_event: Stamps | None = None

    def part(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> "Series":
        """Some of the states."""
        last_event = None if self.last_event is None else self.last_event[rows]
        return Series(self.stamps[rows], self.x[rows], last_event)

    def by_stamp(self) -> "Series":
        """The same in order of the stamps; of states with equal stamps the last one."""
        if (np.diff(self.stamps) > 0).all():
            return self
        _, from_behind = np.unique(self.stamps[::-1], return_index=True)
        return self.part(self.stamps.size - 1 - from_behind)


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Truth and estimate at the same stamps.

    Attributes:
        stamps: ns, ascending, shape (pairs,).
        truth: states (q, u), shape (pairs, 2n).
        estimate: states (q, u), shape (pairs, 2n).
        last_event: as of ``Series``.
    """

    stamps: Stamps
    truth: NDArray[np.float64]
    estimate: NDArray[np.float64]
    last_event: Stamps | None

    def part(self, rows: slice) -> "Pairs":
        """Some of the pairs."""
        last_event = None if self.last_event is None else self.last_event[rows]
        return Pairs(self.stamps[rows], self.truth[rows], self.estimate[rows], last_event)

    def followed_by(self, later: "Pairs") -> "Pairs":
        """These and ``later`` pairs."""
        return Pairs(
            np.concatenate([self.stamps, later.stamps]),
            np.concatenate([self.truth, later.truth]),
            np.concatenate([self.estimate, later.estimate]),
            _concatenated([self.last_event, later.last_event]),
        )


def _concatenated(several: Sequence[Stamps | None]) -> Stamps | None:
    present = [each for each in several if each is not None]
    return np.concatenate(present) if len(present) == len(several) else None


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
            truth.stamps, estimates.stamps, assume_unique=True, return_indices=True
        )
        if not common.size:
            return None
        estimates = estimates.part(of_estimates)
        return Pairs(common, truth.x[of_truth], estimates.x, estimates.last_event)

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
        self._waiting: list[Series] = []

    def add(self, block: Series) -> None:
        """Add the next states."""
        if not block.stamps.size:
            return
        first, last = int(block.stamps.min()), int(block.stamps.max())
        self._oldest = first if self._oldest is None else min(first, self._oldest)
        self.newest = max(self.newest, last)
        if first <= self._taken:
            fresh = block.stamps > self._taken
            self.stale += int(np.count_nonzero(~fresh))
            block = block.part(fresh)
        self._waiting.append(block)

    def take(self, horizon: int) -> Series | None:
        """The states up to ``horizon`` (ns), by stamp, each stamp once; None if there are none."""
        if horizon <= self._taken or not self._waiting:
            return None
        waiting = _joined(self._waiting).by_stamp()
        due = int(np.searchsorted(waiting.stamps, horizon, side="right"))
        self._waiting = [waiting.part(slice(due, None))]
        self._taken = horizon
        return waiting.part(slice(0, due)) if due else None

    def range(self) -> str:
        """The first and the last stamp, in words."""
        return "none" if self._oldest is None else f"{text(self._oldest)} to {text(self.newest)} s"


def _joined(several: Sequence[Series]) -> Series:
    return Series(
        np.concatenate([each.stamps for each in several]),
        np.concatenate([each.x for each in several]),
        _concatenated([each.last_event for each in several]),
    )


def arrived(stamps: Stamps, last_event: Stamps | None, reported: Stamps) -> NDArray[np.bool_]:
    """Which estimates contain all events before them; the others were published too early.

    Args:
        stamps: of the estimates, ns, shape (samples,).
        last_event: as of ``Series``.
        reported: stamps of the reported events that the observer used, ns, ascending, shape
            (reported,).
    """
    if last_event is None:
        return np.ones(stamps.size, dtype=np.bool_)
    due = np.concatenate([[0], reported])
    return np.asarray(last_event >= due[np.searchsorted(due, stamps, side="right") - 1])
