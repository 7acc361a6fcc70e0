# SPDX-License-Identifier: Apache-2.0
"""A motion switched at given instants, of systems whose flights are no single linear phase.

Guides stick, slip and turn at instants that depend on the motion, and samples of a force change
the motion anywhere. The derivative by the state is that of the observer's own motions, with the
saltation of guides. The derivative by a parameter is a difference of motions.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from impact_observer.estimation.moving_system import MovingSystem
from impact_observer.events import Contacts
from impact_observer.identify.motion import EquationsOfMotion, FlightEnd
from impact_observer.model import System
from impact_observer.model.parametric_family import Coefficients, ParametricFamily
from impact_observer.states import Matrix, Vector

_STEP = 1e-6
"""Step of a difference by a parameter, relative to its size."""


def is_general(system: System) -> bool:
    """Whether flights of a ``system`` are no single linear phase under harmonics."""
    return bool(system.guides) or system.forcing.sampled is not None


class GeneralMotion(EquationsOfMotion):
    """Motions of any system, for certain values of its parameters; ``z`` is the state (q, u)."""

    def __init__(self, family: ParametricFamily, numbers: Coefficients, values: Vector) -> None:
        """Prepare the motion for parameter ``values``, shape (p,), with these coefficients."""
        super().__init__(family, numbers)
        self._family, self._values = family, values
        self._moments: Sequence[FlightEnd] = ()

    @cached_property
    def _moving(self) -> MovingSystem:
        return MovingSystem(self._family.system_at(self._values))

    @cached_property
    def _aside(self) -> list[tuple[int, MovingSystem, MovingSystem, float]]:
        """Index, systems with more and with less of each parameter, and their difference."""
        pairs = []
        for j, each in enumerate(self._family.parameters):
            if not each.moves:
                continue
            step = _STEP * each.size
            more, less = (
                float(np.clip(self._values[j] + d, each.low, each.high)) for d in (step, -step)
            )
            pair = [np.array(self._values) for _ in range(2)]
            pair[0][j], pair[1][j] = more, less
            one, other = (MovingSystem(self._family.system_at(values)) for values in pair)
            pairs.append((j, one, other, more - less))
        return pairs

    def start(
        self, x: Vector, moments: Sequence[FlightEnd], t: Vector, t0: float
    ) -> tuple[Vector, Matrix]:
        """The initial state, and its derivatives by itself, parameters and instants."""
        self._moments, self._t = moments, np.append(t, t0)
        return np.array(x), np.eye(x.size, x.size + self._family.size + len(moments))

    def rate(self, k: int, z: Vector, after: float = 0.0) -> Vector:
        """``dz/dt`` before the jump at moment ``k``, or ``after`` s later without the jump."""
        return self._moving.rate_of(float(self._t[k]) + after, z, self._before(k))

    def flown(self, k: int, z: Vector, Z: Matrix) -> tuple[Vector, Matrix, Vector]:
        """``z`` and its derivatives from moment ``k - 1`` to just before moment ``k``.

        The third value is the derivative of ``z`` by the instant of moment ``k - 1``.
        """
        start, closed = float(self._t[k - 1]), self._before(k)
        begun = self._moving.rate_of(start, z, closed)
        columns = np.column_stack([Z, -begun])
        z, derivatives = self._from(start, z, columns, float(self._t[k]) - start, closed)
        return z, derivatives[:, :-1], derivatives[:, -1]

    def moved(self, k: int, z: Vector, Z: Matrix, s: float, after: float) -> tuple[Vector, Matrix]:
        """``z`` and its derivatives ``s`` seconds later than ``after`` a moment."""
        start = float(self._t[k]) + after
        columns = np.column_stack([Z, self._moving.rate_of(start, z, ())])
        z, derivatives = self._from(start, z, columns, s, ())
        own = z.size + self._family.size + k  # both ends move with the instant
        derivatives[:, own] += self._moving.rate_of(start + s, z, ()) - derivatives[:, -1]
        return z, derivatives[:, :-1]

    def _from(
        self, t: float, z: Vector, Z: Matrix, s: float, closed: Contacts
    ) -> tuple[Vector, Matrix]:
        x, map_ = self._moving.moved(t, z, s, closed)
        moved = map_ @ Z
        for j, more, less, difference in self._aside:
            change = more.moved(t, z, s, closed)[0] - less.moved(t, z, s, closed)[0]
            moved[:, z.size + j] += change / difference
        return x, moved

    def _before(self, k: int) -> Contacts:
        return self._moments[k - 1].held if k else ()
