"""Truth and estimates in pairs of equal stamps, while both go by."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S, text
from impact_observer.states import Stamps

HOLD = 10 * NS_PER_S
"""By which a state may come after one that is stamped later, ns: a live estimate is published
again when a late event corrects it."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """States at stamps, or a part of them.

    Attributes:
        stamps: ns, shape (samples,).
        x: states (q, u), shape (samples, 2n).
        last_event: for each estimate the stamp of the last event it contains, ns, 0 for none,
            shape (samples,); None where every estimate contains the events before it.
    """

    stamps: Stamps
    x: NDArray[np.float64]
    last_event: Stamps | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Truth and estimate at the same stamps.

    Attributes:
        stamps: ns, ascending, shape (pairs,).
        truth: states (q, u), shape (pairs, 2n).
        estimate: likewise.
        last_event: as of ``Series``.
    """

    stamps: Stamps
    truth: NDArray[np.float64]
    estimate: NDArray[np.float64]
    last_event: Stamps | None

    def part(self, rows: slice | NDArray[np.bool_]) -> "Pairs":
        """Some of the pairs."""
        last_event = None if self.last_event is None else self.last_event[rows]
        return Pairs(self.stamps[rows], self.truth[rows], self.estimate[rows], last_event)

    def before(self, later: "Pairs") -> "Pairs":
        """These and ``later`` ones."""
        last_event = None
        if self.last_event is not None and later.last_event is not None:
            last_event = np.concatenate([self.last_event, later.last_event])
        return Pairs(
            np.concatenate([self.stamps, later.stamps]),
            np.concatenate([self.truth, later.truth]),
            np.concatenate([self.estimate, later.estimate]),
            last_event,
        )


class Pairing:
    """Pairs two series that come block by block.

    What is kept in memory is what one series is ahead of the other, and ``HOLD``. Of states
    with the same stamp the last one counts.
    """

    def __init__(self) -> None:
        self.truth = Stream()
        self.estimates = Stream()

    def settled(self, *, done: bool = False) -> Pairs | None:
        """The pairs of which nothing more can come; None where there are none.

        Args:
            done: both series have come to their ends.
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
        last_event = None if estimates.last_event is None else estimates.last_event[of_estimates]
        return Pairs(common, truth.x[of_truth], estimates.x[of_estimates], last_event)

    def ranges(self) -> str:
        """From when to when both series are, in words."""
        return f"truth {self.truth.range()}, estimate {self.estimates.range()}"


class Stream:
    """One of two series, waiting for the other.

    Attributes:
        newest: the latest stamp so far, ns; 0 before the first.
        stale: states that came more than ``HOLD`` after later ones, and are left out.
    """

    def __init__(self) -> None:
        self.newest = 0
        self.stale = 0
        self._oldest: int | None = None
        self._gone = 0
        self._waiting: list[Series] = []

    def add(self, block: Series) -> None:
        """Add the next states."""
        if not block.stamps.size:
            return
        first, last = int(block.stamps.min()), int(block.stamps.max())
        self._oldest = first if self._oldest is None else min(first, self._oldest)
        self.newest = max(self.newest, last)
        if first <= self._gone:
            fresh = block.stamps > self._gone
            self.stale += int(np.count_nonzero(~fresh))
            block = _part(block, fresh)
        self._waiting.append(block)

    def take(self, horizon: int) -> Series | None:
        """The states up to ``horizon`` (ns), by stamp, each stamp once; None if there are none."""
        if horizon <= self._gone or not self._waiting:
            return None
        whole = _by_stamp(_joined(self._waiting))
        due = int(np.searchsorted(whole.stamps, horizon, side="right"))
        self._waiting = [_part(whole, slice(due, None))]
        self._gone = horizon
        return _part(whole, slice(0, due)) if due else None

    def range(self) -> str:
        """From when to when, in words."""
        return "none" if self._oldest is None else f"{text(self._oldest)} to {text(self.newest)} s"


def _part(series: Series, rows: slice | NDArray[np.bool_]) -> Series:
    last_event = None if series.last_event is None else series.last_event[rows]
    return Series(series.stamps[rows], series.x[rows], last_event)


def _joined(several: list[Series]) -> Series:
    if len(several) == 1:
        return several[0]
    events = [each.last_event for each in several if each.last_event is not None]
    return Series(
        np.concatenate([each.stamps for each in several]),
        np.concatenate([each.x for each in several]),
        np.concatenate(events) if events else None,
    )


def _by_stamp(series: Series) -> Series:
    """In order of the stamps; the last of those with the same."""
    stamps = series.stamps
    if (np.diff(stamps) > 0).all():
        return series
    _, from_behind = np.unique(stamps[::-1], return_index=True)
    order = stamps.size - 1 - from_behind
    last_event = None if series.last_event is None else series.last_event[order]
    return Series(stamps[order], series.x[order], last_event)


def arrived(stamps: Stamps, last_event: Stamps | None, told: Stamps) -> NDArray[np.bool_]:
    """Which estimates contain the events before them; the others were published too early.

    Args:
        stamps: of the estimates, ns, shape (samples,).
        last_event: as of ``Series``.
        told: stamps of the events that the observer used, ns, ascending, shape (told,).
    """
    if last_event is None:
        return np.ones(stamps.size, dtype=np.bool_)
    due = np.concatenate([[0], told])
    return np.asarray(last_event >= due[np.searchsorted(due, stamps, side="right") - 1])
