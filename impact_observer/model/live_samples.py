# SPDX-License-Identifier: Apache-2.0
"""Samples of forces that change while a run goes on, and a memory of what has changed."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from impact_observer.model.force_samples import JETS, Samples
from impact_observer.states import Vector

NEVER = -(1 << 62)
"""A stamp before all samples, ns."""
_NS = 1e-9
_ROUNDING = 2.5e-10
"""Largest difference of two instants that counts as zero, s: a quarter of a stamp."""
_Rows = NDArray[np.float64]
_REMEMBERED = 1024
"""Changes that motions can follow; a motion that has seen fewer computes all windows anew."""


class _Tail:
    """An array whose last rows change, with room for more: to append one copies no others.

    Attributes:
        rows: the array; arrays that were its ``rows`` before do not change.
    """

    def __init__(self, rows: _Rows) -> None:
        """Start with some ``rows``."""
        self.rows, self._room = rows, rows[:0]

    def change(self, first: int, rows: _Rows) -> None:
        """Replace the rows from the ``first`` on."""
        last, again = first + len(rows), self.rows[first:]
        is_new = len(again) <= len(rows) and np.array_equal(again, rows[: len(again)])
        if not is_new or last > len(self._room):
            self._room = np.empty((2 * last, *rows.shape[1:]))
            self._room[:first] = self.rows[:first]
        self._room[first:last] = rows
        self.rows = self._room[:last]

    def forget(self, first: int) -> None:
        """Forget the rows before the ``first``."""
        self.rows, self._room = self.rows[first:], self._room[first:]


class LiveSamples(Samples):
    """Samples that change.

    Attributes:
        changes: number of changes up to now.
        dropped: number of forgotten samples.
        newest: samples before this instant are final, s since the epoch.
    """

    changes: int
    dropped: int
    newest: float
    _drives: NDArray[np.bool_]
    _since: deque[float]
    _tails: tuple[_Tail, _Tail]

    def __init__(self, base: Samples | None, drives: NDArray[np.bool_], newest: float) -> None:
        """Begin with the samples of ``base``, or with zero forces.

        Args:
            base: known samples; None without any.
            drives: which coordinates live signals drive, shape (n,).
            newest: as the attribute.
        """
        n = drives.size
        time, jets = np.array([NEVER * _NS, 0.0]), np.zeros((JETS, 2, n))
        if base is not None and base.jets is not None:
            time, jets = base.time, base.jets
        super().__init__(time, jets[0], "cubic", jets)
        used = drives if base is None else drives | base.drives
        for name, value in {
            "_drives": used,
            "dropped": 0,
            "newest": newest,
            "changes": 0,
            "_since": deque(maxlen=_REMEMBERED),
            "_tails": (_Tail(time), _Tail(jets.swapaxes(0, 1))),
            "jumps": True,
            "rounding": _ROUNDING,
        }.items():
            object.__setattr__(self, name, value)

    @property
    def drives(self) -> NDArray[np.bool_]:
        """Which coordinates may have a force, shape (n,)."""
        return self._drives

    @property
    def end(self) -> float:
        """Infinity: a live signal has no last sample."""
        return np.inf

    def changed_since(self, changes: int) -> float:
        """The first instant of samples that differ since ``changes``, s since the epoch."""
        count = self.changes - changes
        recent = list(self._since)
        return -np.inf if count > len(recent) else min(recent[-count:], default=np.inf)

    def change(self, first: int, time: Vector, jets: NDArray[np.float64], newest: float) -> None:
        """Replace the samples from number ``first`` on; forgotten samples count."""
        for tail, each in zip(self._tails, (time, jets.swapaxes(0, 1)), strict=True):
            tail.change(first - self.dropped, each)
        self._use_tails()
        self._since.append(float(self.time[max(first - self.dropped - 1, 0)]))
        object.__setattr__(self, "changes", self.changes + 1)
        object.__setattr__(self, "newest", newest)

    def forget(self, first: int) -> None:
        """Forget the samples before number ``first``."""
        for tail in self._tails:
            tail.forget(first - self.dropped)
        self._use_tails()
        object.__setattr__(self, "dropped", first)

    def _use_tails(self) -> None:
        """Set what is derived."""
        time, jets = (tail.rows for tail in self._tails)
        jets = jets.swapaxes(0, 1)
        for name, value in {"time": time, "jets": jets, "force": jets[0]}.items():
            object.__setattr__(self, name, value)
