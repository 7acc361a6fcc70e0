# SPDX-License-Identifier: Apache-2.0
"""Samples that change while they are used: who has copies of them follows."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from impact_observer.model.drive import OFF
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.states import Matrix, Vector

NEVER = -(1 << 62)
"""A stamp before all samples, ns."""
_NS = 1e-9
_ROUNDING = 2.5e-10
"""Difference of instants that counts as none, s: a quarter of a stamp."""
Splice = Callable[[int, Vector, NDArray[np.float64], Matrix, float], None]
"""Takes other samples from a number on: instants, jets, phase and rate of the drive, until when
they are final, s."""


class LiveSamples(Samples):
    """Samples that change; who has copies of them follows.

    Attributes:
        dropped: how many samples have been forgotten.
        newest: until when they are final, s since the epoch; infinity where all may change.
        orders: how often each harmonic turns in a revolution of the drive, 0 for one that does
            not turn with it, shape (h,).
        turns: phase (rad) and rate (rad/s) of the drive at each of the samples, shape (2, k).
    """

    dropped: int
    newest: float
    orders: NDArray[np.int64]
    turns: Matrix
    _drives: NDArray[np.bool_]
    _followers: list[tuple[Splice, Callable[[int], None]]]

    def __init__(
        self,
        base: Samples | None,
        drives: NDArray[np.bool_],
        newest: float,
        orders: NDArray[np.int64],
    ) -> None:
        """Begin with those of ``base``, or with none; others ``drive`` these coordinates, too."""
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
            "orders": orders,
            "turns": np.zeros((2, time.size)),
            "_followers": [],
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
        """There is no last sample."""
        return np.inf

    def follow(self, splice: Splice, drop: Callable[[int], None]) -> None:
        """From now on tell of changes, and of the number of the first sample that is kept."""
        self._followers.append((splice, drop))

    def turned(self, t: Vector, rate: Vector, angle: Matrix) -> tuple[Matrix, Matrix]:
        """``rate`` and ``angle`` of harmonics, of which some turn with the drive."""
        if not self.orders.any():
            return rate, angle
        j, turning = self._index(t, self.rounding), self.orders > 0
        speed = self.turns[1, j]
        phase = self.turns[0, j] + speed * (t - self.time[j])
        return (
            np.where(turning, np.outer(speed, self.orders), rate),
            np.where(turning, np.outer(phase, self.orders), angle),
        )

    def fastest(self, frequency: Vector) -> Vector:
        """A drive may be faster than its nominal frequency."""
        return np.where(self.orders > 0, frequency / (1 - OFF), frequency)

    def change(
        self, first: int, time: Vector, jets: NDArray[np.float64], turns: Matrix, newest: float
    ) -> None:
        """Put others from the sample ``first`` on, counted from the very first."""
        kept = first - self.dropped
        assert self.jets is not None, "derived"
        self._set(
            np.concatenate([self.time[:kept], time]),
            np.concatenate([self.jets[:, :kept], jets], axis=1),
            np.hstack([self.turns[:, :kept], turns]),
        )
        object.__setattr__(self, "newest", newest)
        for splice, _ in self._followers:
            splice(first, time, jets, turns, newest)

    def forget(self, first: int) -> None:
        """Forget the samples before ``first``."""
        assert self.jets is not None, "derived"
        old = first - self.dropped
        self._set(self.time[old:], self.jets[:, old:], self.turns[:, old:])
        object.__setattr__(self, "dropped", first)
        for _, drop in self._followers:
            drop(first)

    def _set(self, time: Vector, jets: NDArray[np.float64], turns: Matrix) -> None:
        changed = {"time": time, "jets": jets, "force": jets[0], "turns": turns}
        for name, value in changed.items():
            object.__setattr__(self, name, value)
