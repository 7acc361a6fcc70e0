# SPDX-License-Identifier: Apache-2.0
"""Errors of an estimate over time: all rows of a short curve, the peaks of a long one."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

MOST_ROWS = 2**16
"""Rows of a curve that are kept, twice as many at most; of longer curves the peaks."""
ErrorRows: TypeAlias = NDArray[np.void]
"""Errors at some stamps, rows of ``error_type``."""


def error_type(size: int) -> np.dtype[np.void]:
    """A ``stamp`` (ns), the ``error`` (estimate minus truth) of ``size`` states, and ``V`` (J)."""
    return np.dtype([("stamp", "i8"), ("error", "f8", (size,)), ("V", "f8")])


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
