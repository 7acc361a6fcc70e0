"""Sums and maxima of errors over pairs of truth and estimate that are added block by block."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.mismatch import REACH, Impact, Window, window
from impact_observer.dynamics.lyapunov import distance
from impact_observer.io.pairing import Pairs, arrived
from impact_observer.model import System
from impact_observer.stamps import seconds_between
from impact_observer.states import Stamps, Vector

MOST_ROWS = 2**16
"""Rows of a curve that are kept, twice as many at most; of longer curves the peaks."""
_TOGETHER = 4096
"""Rows that are thinned out together."""


class ErrorRows(NamedTuple):
    """Errors at some stamps.

    Attributes:
        stamps: ns, ascending, shape (rows,).
        error: estimate minus truth, shape (rows, 2n).
        V: J, shape (rows,).
    """

    stamps: Stamps
    error: NDArray[np.float64]
    V: Vector

    def at(self, rows: slice | NDArray[np.intp]) -> "ErrorRows":
        """Some of them."""
        return ErrorRows(self.stamps[rows], self.error[rows], self.V[rows])


class ErrorTally:
    """Sums up errors; its memory does not grow with the number of pairs.

    Attributes:
        samples: pairs that count.
        late: pairs left out because their event had not arrived at the estimate.
        between: pairs left out because they lie between the jumps of truth and estimate.
        windows: impacts with such pairs.
        longest: the longest time between two jumps, s.
        peak: largest V between two jumps, J.
        squares: sums of squared errors, shape (2n,).
        largest: largest absolute errors, shape (2n,).
        rise: largest rise of V from one sample to the next, J.
        settled: stamp from which on V is below the threshold, ns; None while it is not.
    """

    def __init__(
        self,
        system: System,
        reported: Stamps,
        impacts: list[Impact],
        threshold: float,
        keep: Callable[[ErrorRows], None],
    ) -> None:
        """Begin without any pair.

        Args:
            system: gives M and K for V.
            reported: stamps of the reported events that the observer used, ns, ascending,
                shape (reported,).
            impacts: all that the observer used, inserted ones too, by stamp.
            threshold: V over V at the start below which an estimate has settled.
            keep: receives the rows that count, in order.
        """
        self.samples = self.late = self.between = self.windows = 0
        self.longest = self.peak = self.rise = 0.0
        self.squares, self.largest = np.zeros(2 * system.n), np.zeros(2 * system.n)
        self.settled: int | None = None
        self._keep = keep
        self._system = system
        self._reported = reported
        self._impacts = impacts
        self._of_contact = [[i.stamp for i in impacts if i.contact == c] for c in range(system.m)]
        self._threshold = threshold
        self._first = self._last = -1.0
        self._searched = 0
        self._windows: list[Window] = []
        self._carried: Pairs | None = None
        self._counted = 0

    def add(self, pairs: Pairs | None, *, done: bool = False) -> None:
        """Add pairs that are later than all before.

        A pair counts once all windows that may contain it have been found, which needs the pairs
        ``2 REACH`` around it. Until then it is carried over to the next call.

        Args:
            pairs: None for none.
            done: these are the last.
        """
        if pairs is not None:
            self._carried = pairs if self._carried is None else self._carried.followed_by(pairs)
        rows = self._carried
        if rows is None or not rows.stamps.size:
            return
        last = int(rows.stamps[-1])
        self._find_windows(rows, last + 1 if done else last - REACH)
        due = rows.stamps.size
        if not done:
            due = int(np.searchsorted(rows.stamps, last - 2 * REACH, side="right"))
        if due > self._counted:
            self._count(rows.part(slice(self._counted, due)))
        # A jump shows against the two samples before it.
        kept = max(min(due, rows.stamps.size) - 2, 0)
        self._carried, self._counted = rows.part(slice(kept, None)), due - kept

    def _find_windows(self, rows: Pairs, until: int) -> None:
        """Find the windows of all impacts before ``until`` (ns)."""
        end = bisect_left(self._impacts, until, key=lambda impact: impact.stamp)
        speeds: dict[int, tuple[Vector, Vector]] = {}
        n = self._system.n
        for impact in self._impacts[self._searched : end]:
            c = impact.contact
            if c not in speeds:
                w = self._system.W[:, c]
                speeds[c] = (rows.truth[:, n:] @ w, rows.estimate[:, n:] @ w)
            own = self._of_contact[c]
            before, after = bisect_left(own, impact.stamp), bisect_right(own, impact.stamp)
            others = [*own[max(before - 1, 0) : before], *own[after : after + 1]]
            if (found := window(rows.stamps, *speeds[c], impact, others)) is not None:
                self._windows.append(found)
                self.windows += 1
                self.longest = max(self.longest, seconds_between(*found))
        self._searched = max(self._searched, end)

    def _count(self, pairs: Pairs) -> None:
        """Count pairs whose windows are all found."""
        n, stamps = self._system.n, pairs.stamps
        error = pairs.estimate - pairs.truth
        V = distance(self._system, error[:, :n], error[:, n:])
        punctual = arrived(stamps, pairs.last_event, self._reported)
        between = punctual & self._is_between(stamps)
        self.late += int(np.count_nonzero(~punctual))
        self.between += int(np.count_nonzero(between))
        self.peak = max(self.peak, float(np.max(V[between], initial=0.0)))
        kept = punctual & ~between
        if kept.any():
            self._sum_up(ErrorRows(stamps[kept], error[kept], V[kept]))

    def _is_between(self, stamps: Stamps) -> NDArray[np.bool_]:
        """Which samples lie in a window; windows that are over are dropped."""
        between = np.zeros(stamps.size, dtype=np.bool_)
        for each in self._windows:
            between |= (each.begin <= stamps) & (stamps < each.end)
        last = int(stamps[-1])
        self._windows = [each for each in self._windows if each.end > last]
        return between

    def _sum_up(self, rows: ErrorRows) -> None:
        stamps, error, V = rows
        if not self.samples:
            self._first = self._last = float(V[0])
        self.samples += stamps.size
        self.squares += np.sum(error**2, axis=0)
        self.largest = np.maximum(self.largest, np.max(np.abs(error), axis=0))
        self.rise = max(self.rise, float(np.max(np.diff(V, prepend=self._last))))
        self._last = float(V[-1])
        above = np.flatnonzero(self._threshold * self._first < V)
        after = int(above[-1]) + 1 if above.size else 0
        if above.size or self.settled is None:
            self.settled = int(stamps[after]) if after < stamps.size else None
        self._keep(rows)


class ErrorCurve:
    """Keeps all rows that are added, or where these are too many the peaks of V.

    The first and the last row are always kept.
    """

    def __init__(self, width: int) -> None:
        """Keep rows with ``width`` errors."""
        nothing = ErrorRows(np.empty(0, dtype=np.int64), np.empty((0, width)), np.empty(0))
        self._kept, self._raw = nothing, [nothing]
        self._waiting = 0
        self._stride = 1
        self._ends: tuple[ErrorRows, ErrorRows] | None = None

    def add(self, rows: ErrorRows) -> None:
        """Add rows, at least one and later than all before."""
        first = rows.at(slice(0, 1)) if self._ends is None else self._ends[0]
        self._ends = first, rows.at(slice(-1, None))
        self._raw.append(rows)
        self._waiting += rows.stamps.size
        if self._waiting >= max(_TOGETHER, self._stride):
            raw = _joined(self._raw)
            whole = raw.stamps.size - raw.stamps.size % self._stride
            self._kept = _joined([self._kept, _peaks(raw.at(slice(0, whole)), self._stride)])
            self._raw = [raw.at(slice(whole, None))]
            self._waiting = raw.stamps.size - whole
        while self._kept.stamps.size > 2 * MOST_ROWS:
            self._kept = _peaks(self._kept, 2)
            self._stride *= 2

    def rows(self) -> ErrorRows:
        """The rows that are kept."""
        rows = _joined([self._kept, _peaks(_joined(self._raw), self._stride)])
        if self._ends is None:
            return rows
        first, last = self._ends
        before = [first] if rows.stamps[0] != first.stamps[0] else []
        after = [last] if rows.stamps[-1] != last.stamps[0] else []
        return _joined([*before, rows, *after])


def _joined(several: Sequence[ErrorRows]) -> ErrorRows:
    return ErrorRows(*(np.concatenate(columns) for columns in zip(*several, strict=True)))


def _peaks(rows: ErrorRows, stride: int) -> ErrorRows:
    """Of every ``stride`` rows the one with the largest V, and that of the rest at the end."""
    whole = rows.V.size - rows.V.size % stride
    at = np.arange(0, whole, stride) + np.argmax(rows.V[:whole].reshape(-1, stride), axis=1)
    if whole < rows.V.size:
        at = np.append(at, whole + np.argmax(rows.V[whole:]))
    return rows.at(at)
