# SPDX-License-Identifier: Apache-2.0
"""A forcing given by samples: constant, linear or cubic from each sample to the next."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_observer.errors import DynamicsError, ModelError
from impact_observer.model.document import finite
from impact_observer.states import Matrix, Vector, frozen

HOLDS = ("previous", "linear")
JETS = 4
"""Number of coefficients of a cubic: the value and three derivatives."""
SHORTEST_STEP = 1e-9
"""Least time between two samples, s: one stamp."""
_SAME = 1e-14
"""Largest difference of two instants by rounding, s."""
_SLACK = 1e-9
"""How far before the first sample an instant may lie by rounding, s: one stamp."""
_NO_JETS = frozen(np.empty((JETS, 0, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Forces at instants; the last force is held after the last instant.

    Attributes:
        time: s since the epoch, shape (k,), ascending, k >= 2; the first instant is 0 or before.
        force: shape (k, n), N or Nm.
        hold: ``previous`` or ``linear``; ``cubic`` where ``jets`` are given.
        jets: force and first three time derivatives just after each sample, shape (4, k, n);
            the last sample has zero derivatives. Given for ``cubic`` only, otherwise derived.
        steps: time between samples, shape (k - 1,), s; exactly equal if all differences are
            rounding. Derived.
        rounding: largest difference of two instants that counts as zero, s. Derived.

    Raises:
        ModelError: naming the key of the model file and what is wrong with it.
    """

    time: Vector
    force: Matrix
    hold: str
    jets: NDArray[np.float64] = field(default_factory=lambda: _NO_JETS)
    steps: Vector = field(init=False)
    rounding: float = field(init=False)

    def __post_init__(self) -> None:
        """Copy, freeze and check all fields, and derive the others."""
        if self.hold not in HOLDS and not self.jets.size:
            raise ModelError("forcing.hold", f"{self.hold!r} found; expected {' or '.join(HOLDS)}")
        time = _checked_time(self.time)
        n = np.shape(self.force)[-1] if np.ndim(self.force) == 2 else 1
        force = finite(
            "forcing.sampled.force", self.force, (time.size, n), f"{time.size} rows, one a sample"
        )
        steps = np.diff(time)
        mean = (time[-1] - time[0]) / steps.size
        rounding = float(4 * np.spacing(np.max(np.abs(time))))
        if np.max(np.abs(steps - mean)) <= rounding:
            steps = np.full(steps.size, mean)
        jets = np.zeros((JETS, *force.shape))
        if self.jets.size:
            jets[:, :-1] = self.jets[:, :-1]
        elif self.hold == "linear":
            jets[1, :-1] = np.diff(force, axis=0) / steps[:, None]
        jets[0] = force
        derived = {
            "time": time,
            "force": force,
            "jets": frozen(jets),
            "steps": frozen(steps),
            "rounding": min(max(4 * rounding, _SAME), float(np.min(steps)) / 4),
        }
        for key, value in derived.items():
            object.__setattr__(self, key, value)

    @classmethod
    def of_jets(cls, time: Vector, jets: NDArray[np.float64]) -> "Samples":
        """Cubics from each instant on, by value and derivatives ``jets``, shape (4, k, n)."""
        return cls(time, jets[0], "cubic", jets)

    @property
    def drives(self) -> NDArray[np.bool_]:
        """Which coordinates have a force at some time, shape (n,)."""
        return np.asarray(np.any(self.jets != 0, axis=(0, 1)))

    @property
    def end(self) -> float:
        """Instant of the last sample, s since the epoch."""
        return float(self.time[-1])

    def index(self, t: Vector, slack: float | None = None) -> NDArray[np.intp]:
        """Index of the latest sample at each ``t``, s since the epoch, shape (samples,).

        A ``t`` less than ``slack`` before a sample, by default ``rounding``, is its instant.

        Raises:
            DynamicsError: an instant before the first sample.
        """
        self.check(t)
        at = t + (self.rounding if slack is None else slack)
        return np.asarray(np.maximum(np.searchsorted(self.time, at, side="right") - 1, 0))

    def derivatives(self, t: Vector, *, slack: float | None = None) -> NDArray[np.float64]:
        """Forces at ``t`` (s since the epoch) and their derivatives, shape (4, samples, n).

        At a jump the values are those after the jump; ``slack`` and errors as of ``index``.
        """
        j = self.index(t, slack)
        return shifted(self.jets[:, j], np.asarray(t - self.time[j]))

    def check(self, t: Vector | float) -> None:
        """Check that no ``t``, s since the epoch, is before the first sample.

        Raises:
            DynamicsError: an instant before the first sample.
        """
        first = np.min(t, initial=np.inf)
        if first < self.time[0] - _SLACK:
            raise DynamicsError(
                f"forcing.sampled: the samples begin at t = {self.time[0]:.9g} s, but the force at"
                f" t = {first:.9g} s is needed; give earlier samples or start later"
            )

    def knots(self, start: float, stop: float) -> Vector:
        """Instants of samples strictly between ``start`` and ``stop``, s since the epoch."""
        first, last = np.searchsorted(
            self.time, [start + self.rounding, stop - self.rounding], side="right"
        )
        return np.asarray(self.time[first:last])

    def derivative(self) -> "Samples":
        """The rate of change of the samples."""
        return Samples.of_jets(self.time, np.concatenate([self.jets[1:], 0 * self.jets[:1]]))

    def plus(self, other: "Samples") -> "Samples":
        """The sum with samples at other instants; the sum begins at the later of both starts."""
        start = max(self.time[0], other.time[0])
        time = np.union1d(self.time, other.time)
        time = np.append(start, time[time > start])
        time = time[np.append(True, np.diff(time) >= SHORTEST_STEP)]
        each = [part.derivatives(time, slack=SHORTEST_STEP) for part in (self, other)]
        return Samples.of_jets(time, each[0] + each[1])


def shifted(jets: NDArray[np.float64], s: Vector) -> NDArray[np.float64]:
    """Value and derivatives of cubics ``s`` seconds later, shape (4, samples, n).

    Args:
        jets: value and derivatives now, shape (4, samples, n).
        s: time from now, s, shape (samples,).
    """
    later, s = np.array(jets), s[:, None]
    for k in range(JETS - 1):
        for order in range(JETS - 2, k - 1, -1):
            rest = later[k] if order < JETS - 2 else jets[-1]
            later[k] = jets[order] + s / (order - k + 1) * rest
    return np.asarray(later)


def _checked_time(values: ArrayLike) -> Vector:
    """Instants of samples, frozen and checked.

    Raises:
        ModelError: fewer than two instants, instants that do not ascend, or none at the epoch or
            before.
    """
    key, k = "forcing.sampled.time", np.size(np.asarray(values))
    time = finite(key, values, (k,), "a list of instants, s since the epoch")
    if k < 2:
        raise ModelError(key, f"{k} samples found; expected at least two")
    for i in np.flatnonzero(np.diff(time) < SHORTEST_STEP)[:1]:
        raise ModelError(
            key,
            f"{float(time[i + 1])!r} follows {float(time[i])!r}; expected times that ascend by"
            f" {SHORTEST_STEP:g} s at least",
        )
    if time[0] > 0:
        raise ModelError(
            key,
            f"begins at {float(time[0])!r}; expected a first time of 0 or before, in s since the"
            " epoch: subtract the epoch or add a row at 0",
        )
    return time
