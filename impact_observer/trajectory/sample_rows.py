# SPDX-License-Identifier: Apache-2.0
"""What sensors measure in a flight, as functions of its first state and of the parameters.

States of a flight are linear in the first state: a difference of motions is exact, and takes all
samples of the flight at once.
"""

from collections.abc import Sequence

import numpy as np

from impact_observer.filter.readings import sensors_of
from impact_observer.model.free_parameters import OFFSET
from impact_observer.model.measurement import Measurement
from impact_observer.states import Matrix, Vector
from impact_observer.trajectory.linearised_system import LinearisedSystem, TangentState


class SampleRows:
    """The samples of sensors of one system, linearised about its flights."""

    def __init__(self, system: LinearisedSystem, measurements: Sequence[Measurement]) -> None:
        """Samples of ``measurements``.

        Raises:
            UsageError: the system does not have what is measured.
        """
        family = system.family
        self._size, self._here = family.size, _Expected(system, measurements)
        gaps = [family.system.contact_names.index(each.gap) for each in measurements if each.gap]
        self._beside = [
            (j, [_Expected(aside, measurements) for aside in system.beside(j)], system.distance(j))
            for j, each in enumerate(family.parameters)
            if each.moves or np.any(each.effect.gap[gaps])
        ]

    def late(self, times: Vector) -> Vector:
        """``times`` of sensors by the clock of the impacts."""
        return self._here.late(times)

    def rows(self, at: TangentState, times: Sequence[Vector]) -> list[tuple[Vector, Matrix]]:
        """Values at ``times`` in the flight that begins at a state, and their derivatives.

        ``times`` are s since the epoch by the sensors' clock, one array for each sensor. The
        derivatives are by that state and the parameters, shape (samples, 2n + p).
        """
        size, x = at.x.size, at.x
        values = self._here.values(at, x, times)
        tables = [np.zeros((each.size, size + self._size)) for each in times]
        for i, shift in enumerate(np.eye(size)):
            ends = (self._here.values(at, end, times) for end in (x + shift, x - shift))
            for table, more, less in zip(tables, *ends, strict=True):
                table[:, i] = (more - less) / 2
        for j, aside, distance in self._beside:
            ends = (each.values(at, x, times) for each in aside)
            for table, more, less in zip(tables, *ends, strict=True):
                table[:, size + j] = (more - less) / distance
        return list(zip(values, tables, strict=True))


class _Expected:
    """What the sensors of one system measure."""

    def __init__(self, system: LinearisedSystem, measurements: Sequence[Measurement]) -> None:
        self._moving, names = system.moving, system.family.names
        self._sensors = sensors_of(measurements, system.moving.system)
        self._offset = float(system.theta[names.index(OFFSET)]) if OFFSET in names else 0.0

    def late(self, times: Vector) -> Vector:
        """``times`` by the clock of the impacts, whose offset may be among the parameters."""
        return times + self._offset

    def values(self, at: TangentState, x: Vector, times: Sequence[Vector]) -> list[Vector]:
        """Values at ``times`` of the motion that begins with ``x`` instead of the state ``at``."""
        motion, values = self._moving.motion(at.t, x, at.closed), []
        for sensor, each in zip(self._sensors, map(self.late, times), strict=True):
            s = each - at.t
            states = motion.states(s) if s.size else np.zeros((0, x.size))
            values.append(sensor.values(self._moving, each, states, at.closed))
        return values
