"""A forcing given by samples: held, or linear in between."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_observer.errors import DynamicsError, ModelError
from impact_observer.model.document import finite
from impact_observer.states import Matrix, Vector, frozen

HOLDS = ("previous", "linear")
SHORTEST_STEP = 1e-9
"""Least time between two samples, s: one stamp."""
_SAME = 1e-14
"""Largest difference of two instants by rounding, s."""
_SLACK = 1e-9
"""How far beyond the last sample an instant may lie by rounding, s: one stamp."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Forces at instants; between them the previous one is held, or the force is linear.

    Attributes:
        time: s since the epoch, shape (k,), ascending, k >= 2; the first not after 0.
        force: shape (k, n), N or Nm.
        hold: ``previous`` or ``linear``.
        steps: between the samples, shape (k - 1,), s; exactly equal where they differ by rounding
            only. Derived.
        slope: of the force from each sample on, shape (k, n), N/s; at the last one as before it.
            Derived.
        rounding: difference below which an instant counts as that of a sample, s. Derived.

    Raises:
        ModelError: naming the key of the model file and what is wrong with it.
    """

    time: Vector
    force: Matrix
    hold: str
    steps: Vector = field(init=False)
    slope: Matrix = field(init=False)
    rounding: float = field(init=False)

    def __post_init__(self) -> None:
        """Copy, freeze and check everything; derive steps and slopes."""
        if self.hold not in HOLDS:
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
        slope = np.zeros(force.shape)
        if self.hold == "linear":
            slope[:-1] = np.diff(force, axis=0) / steps[:, None]
            slope[-1] = slope[-2]
        derived = {
            "time": time,
            "force": force,
            "steps": frozen(steps),
            "slope": frozen(slope),
            "rounding": min(max(4 * rounding, _SAME), float(np.min(steps)) / 4),
        }
        for key, value in derived.items():
            object.__setattr__(self, key, value)

    @property
    def end(self) -> float:
        """The last sample, s since the epoch."""
        return float(self.time[-1])

    def index(self, t: Vector) -> NDArray[np.intp]:
        """The sample that holds from each ``t`` (s since the epoch) on, shape (samples,).

        An instant within rounding of a sample's counts as the sample's.

        Raises:
            DynamicsError: an instant before the first or beyond the last sample.
        """
        self.check(t)
        found = np.searchsorted(self.time, t + self.rounding, side="right") - 1
        return np.asarray(np.maximum(found, 0))

    def values(self, t: Vector) -> Matrix:
        """Forces at ``t`` (s since the epoch), from the right where they jump, (samples, n).

        Raises:
            DynamicsError: an instant before the first or beyond the last sample.
        """
        j = self.index(t)
        return np.asarray(self.force[j] + self.slope[j] * (t - self.time[j])[:, None])

    def check(self, t: Vector) -> None:
        """Check that there are samples at ``t``, s since the epoch.

        Raises:
            DynamicsError: an instant before the first or beyond the last sample.
        """
        first, last = (np.min(t), np.max(t)) if t.size else (self.end, self.end)
        if last > self.end + _SLACK:
            raise DynamicsError(
                f"forcing.sampled: the samples end at t = {self.end:.9g} s, but the force at"
                f" t = {last:.9g} s is needed; give longer samples or stop before"
            )
        if first < self.time[0] - _SLACK:
            raise DynamicsError(
                f"forcing.sampled: the samples begin at t = {self.time[0]:.9g} s, but the force at"
                f" t = {first:.9g} s is needed; give earlier samples or start later"
            )

    def knots(self, start: float, stop: float) -> Vector:
        """Samples strictly between ``start`` and ``stop``, both s since the epoch."""
        first, last = np.searchsorted(
            self.time, [start + self.rounding, stop - self.rounding], side="right"
        )
        return np.asarray(self.time[first:last])

    def mapped(self, T: Matrix) -> "Samples":
        """The samples of ``T f``, for ``T`` of shape (r, n)."""
        return Samples(self.time, self.force @ T.T, self.hold)


def _checked_time(values: ArrayLike) -> Vector:
    """Instants of samples, frozen and checked.

    Raises:
        ModelError: fewer than two, not ascending, or none at the epoch or before.
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
