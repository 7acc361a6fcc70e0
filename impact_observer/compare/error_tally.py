"""Sums and maxima of errors over pairs of truth and estimate that are added block by block."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.mismatch import REACH, Mismatch, window
from impact_observer.dynamics.lyapunov import distance
from impact_observer.io.pairing import Pairs, arrived
from impact_observer.model import System
from impact_observer.stamps import seconds_between
from impact_observer.states import Stamps, Vector

MOST_ROWS = 2**16
"""Rows of a curve that are kept, twice as many at most; of longer curves the peaks."""
ErrorRows: TypeAlias = NDArray[np.void]
"""Errors at some stamps, rows of ``error_type``."""


def error_type(size: int) -> np.dtype[np.void]:
    """A ``stamp`` (ns), the ``error`` (estimate minus truth) of ``size`` states, and ``V`` (J)."""
    return np.dtype([("stamp", "i8"), ("error", "f8", (size,)), ("V", "f8")])


class ErrorTally:
    """Sums up errors; its memory does not grow with the number of pairs.

    Attributes:
        samples: pairs that count.
        late: pairs left out because their event had not arrived at the estimate.
        mismatch: pairs left out because they lie between the jumps of truth and estimate.
        squares: sums of squared errors, shape (2n,).
        largest: largest absolute errors, shape (2n,).
        rise: largest rise of V from one sample to the next, J.
        settled: stamp from which on V is below the threshold, ns; None while it is not.
    """

    def __init__(
        self,
        system: System,
        reported: Stamps,
        impacts: list[tuple[int, int]],
        threshold: float,
        keep: Callable[[ErrorRows], None],
    ) -> None:
        """Begin without any pair.

        Args:
            system: gives M and K for V.
            reported: stamps of the reported events that the observer used, ns, ascending,
                shape (reported,).
            impacts: stamp (ns) and index of the contact of all that the observer used, inserted
                ones too, by stamp.
            threshold: V over V at the start below which an estimate has settled.
            keep: receives the rows that count, in order.
        """
        self.samples = self.late = 0
        self.mismatch = Mismatch()
        self.squares, self.largest = np.zeros(2 * system.n), np.zeros(2 * system.n)
        self.rise = 0.0
        self.settled: int | None = None
        self._keep = keep
        self._system = system
        self._reported = reported
        self._impacts = impacts
        self._of_contact = [[at for at, c in impacts if c == own] for own in range(system.m)]
        self._threshold = threshold
        self._first = self._last = -1.0
        self._searched = 0
        self._windows: list[tuple[int, int]] = []
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
        rows = [each for each in (self._carried, pairs) if each is not None and each.size]
        if not rows:
            return
        carried = np.concatenate(rows)
        last = int(carried["stamp"][-1])
        self._find_windows(carried, last + 1 if done else last - REACH)
        due = carried.size
        if not done:
            due = int(np.searchsorted(carried["stamp"], last - 2 * REACH, side="right"))
        if due > self._counted:
            self._count(carried[self._counted : due])
        # A jump shows against the two samples before it.
        kept = max(due - 2, 0)
        self._carried, self._counted = carried[kept:], due - kept

    def _find_windows(self, rows: Pairs, until: int) -> None:
        """Find the windows of all impacts before ``until`` (ns)."""
        end = bisect_left(self._impacts, (until,))
        speeds: dict[int, tuple[Vector, Vector]] = {}
        n = self._system.n
        for impact, c in self._impacts[self._searched : end]:
            if c not in speeds:
                w = self._system.W[:, c]
                speeds[c] = (rows["truth"][:, n:] @ w, rows["estimate"][:, n:] @ w)
            own = self._of_contact[c]
            before, after = bisect_left(own, impact), bisect_right(own, impact)
            others = [*own[max(before - 1, 0) : before], *own[after : after + 1]]
            if (found := window(rows["stamp"], *speeds[c], impact, others)) is not None:
                self._windows.append(found)
                self.mismatch.windows += 1
                self.mismatch.longest = max(self.mismatch.longest, seconds_between(*found))
        self._searched = max(self._searched, end)

    def _count(self, pairs: Pairs) -> None:
        """Count pairs whose windows are all found."""
        n, stamps = self._system.n, pairs["stamp"]
        rows = np.empty(pairs.size, error_type(2 * n))
        rows["stamp"], rows["error"] = stamps, pairs["estimate"] - pairs["truth"]
        rows["V"] = distance(self._system, rows["error"][:, :n], rows["error"][:, n:])
        punctual = arrived(stamps, pairs["last_event"], self._reported)
        between = np.zeros(stamps.size, dtype=np.bool_)
        for begin, end in self._windows:
            between |= (begin <= stamps) & (stamps < end)
        self._windows = [each for each in self._windows if each[1] > stamps[-1]]
        between &= punctual
        self.late += int(np.count_nonzero(~punctual))
        self.mismatch.samples += int(np.count_nonzero(between))
        self.mismatch.V = max(self.mismatch.V, float(np.max(rows["V"][between], initial=0.0)))
        kept = rows[punctual & ~between]
        if kept.size:
            self._sum_up(kept)

    def _sum_up(self, rows: ErrorRows) -> None:
        stamps, error, V = rows["stamp"], rows["error"], rows["V"]
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

    def __init__(self) -> None:
        self._ends: list[ErrorRows] = []
        self._kept: list[ErrorRows] = []
        self._stride = 1

    def add(self, rows: ErrorRows) -> None:
        """Add rows, at least one and later than all before."""
        first = self._ends[0] if self._ends else rows[:1]
        self._ends = [first, rows[-1:]]
        self._kept.append(_peaks(rows, self._stride))
        while sum(each.size for each in self._kept) > 2 * MOST_ROWS:
            self._kept = [_peaks(np.concatenate(self._kept), 2)]
            self._stride *= 2

    def rows(self) -> ErrorRows:
        """The rows that are kept, by stamp."""
        rows = np.concatenate([*self._ends, *self._kept])
        return np.asarray(rows[np.unique(rows["stamp"], return_index=True)[1]])


def _peaks(rows: ErrorRows, stride: int) -> ErrorRows:
    """Of every ``stride`` rows the one with the largest V, and that of the rest at the end."""
    whole = rows.size - rows.size % stride
    at = np.arange(0, whole, stride) + np.argmax(rows["V"][:whole].reshape(-1, stride), axis=1)
    if whole < rows.size:
        at = np.append(at, whole + np.argmax(rows["V"][whole:]))
    return np.asarray(rows[at])
