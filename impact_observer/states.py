# SPDX-License-Identifier: Apache-2.0
"""States of the plant and of its estimates at a stamp."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Stamps = NDArray[np.int64]


def frozen(values: object) -> NDArray[np.float64]:
    """A read-only float64 copy of ``values``, with no minus zero in it."""
    array = np.array(values, dtype=np.float64) + 0.0
    array = np.asarray(array)
    array.setflags(write=False)
    return array


NO_COVARIANCE = frozen(np.empty((0, 0)))
"""The empty covariance of a law that has no covariance."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """An observer's output at a stamp; mirrors ``impact_observer_msgs/ObserverState``.

    ``bound``, ``inconsistent`` and ``misfit`` are not in that message; bounds have a topic.

    Attributes:
        stamp: when the state holds, ns.
        law: name of the observer's law.
        q: coordinates, shape (n,), m or rad.
        u: velocities, shape (n,), m/s or rad/s.
        covariance: shape (2n, 2n), order (q, u); shape (0, 0) for a law that has none.
        closed: names of the contacts that the replica holds closed.
        convergence: largest V distance between replicas just after the last event, J; it only
            falls until the next one. -1 while there is only one replica.
        synchronized: whether the replicas have agreed at several events in a row.
        bound: certified upper bound of V, J; -1 where nothing is certified.
        inconsistent: whether events have contradicted the declared model or uncertainty.
        misfit: that the model does not explain the latest impacts, in words; empty while it does.
        clock_offset: estimated offset of the sensor's clock, s; 0 unless asked for or stepped.
        parameters: what is estimated besides the state: name, value, standard deviation, SI units.
        last_sequence: sequence number of the last event applied; 0 before the first.
        last_event: stamp of the last event applied, ns; 0 before the first.
    """

    stamp: int
    law: str
    q: Vector
    u: Vector
    covariance: Matrix = field(default_factory=lambda: NO_COVARIANCE)
    closed: tuple[str, ...] = ()
    convergence: float = -1.0
    synchronized: bool = False
    bound: float = -1.0
    inconsistent: bool = False
    misfit: str = ""
    clock_offset: float = 0.0
    parameters: tuple[tuple[str, float, float], ...] = ()
    last_sequence: int = 0
    last_event: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimates between two events that differ in stamp and state only.

    Attributes:
        first: the first estimate.
        stamps: when each holds, ns, ascending, shape (k,), at least one.
        x: states (q, u), shape (k, 2n).
        replicas: states of all replicas where they were asked for, shape (N, k, 2n).
    """

    first: Estimate
    stamps: Stamps
    x: Matrix
    replicas: NDArray[np.float64] | None = None

    def __iter__(self) -> Iterator[Estimate]:
        """Each estimate."""
        n = self.first.q.size
        for stamp, x in zip(self.stamps.tolist(), self.x, strict=True):
            yield replace(self.first, stamp=stamp, q=x[:n], u=x[n:])

    def part(self, begin: int, end: int) -> "Estimates":
        """The estimates from place ``begin`` to before ``end``, at least one."""
        if end - begin == self.stamps.size:
            return self
        n, x = self.first.q.size, self.x[begin]
        first = replace(self.first, stamp=int(self.stamps[begin]), q=x[:n], u=x[n:])
        return Estimates(first, self.stamps[begin:end], self.x[begin:end])
