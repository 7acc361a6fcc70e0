# SPDX-License-Identifier: Apache-2.0
"""Samples of sensors beside the impacts, as further rows of a fit.

Between two moments a motion depends on the state after the first of them, its instant, and the
parameters. So all samples of a flight become a few rows on these unknowns, triangulated (Golub
and Van Loan, Matrix computations, section 5.3), and a sum of squares that no unknown changes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.errors import UsageError
from impact_observer.filter.readings import DeclaredSensor, sensors_of
from impact_observer.model.measurement import Measurement
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.samples import SensorSample
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Vector
from impact_observer.trajectory.linearised_system import LinearisedSystem, TangentState
from impact_observer.trajectory.sample_rows import SampleRows

_USUAL = 1.4826
"""Standard deviation over median of the magnitudes of normal numbers."""


class CountedSamples(NamedTuple):
    """Samples of one sensor that count in a fit.

    Attributes:
        sensor: its declaration.
        t: s since the epoch, ascending, shape (samples,).
        values: as measured, less what moving grounds add, shape (samples,).
        near: how many were left out near impacts.
        rejected: how many were left out by the gate.
    """

    sensor: Measurement
    t: Vector
    values: Vector
    near: int = 0
    rejected: int = 0

    @property
    def deviation(self) -> float:
        """Of its noise, in the unit of the values."""
        return self.sensor.deviation

    def which(self, kept: NDArray[np.bool_]) -> "CountedSamples":
        """The samples that ``kept`` selects."""
        return self._replace(t=self.t[kept], values=self.values[kept])

    def away_from(self, impacts: Vector, margin: float) -> "CountedSamples":
        """The samples farther than ``margin``, s, from ``impacts``."""
        after = max(margin, self.sensor.blanking)
        i = np.searchsorted(impacts, self.t, side="right")
        ago = self.t - np.append(-np.inf, impacts)[i]
        until = np.append(impacts, np.inf)[i] - self.t
        kept = (ago > after) & (until > margin)
        return self.which(kept)._replace(near=self.near + int(np.sum(~kept)))

    def within_gate(self, errors: Vector) -> "CountedSamples":
        """The samples whose ``errors`` are within the gate or not much above the usual."""
        usual = max(self.deviation, _USUAL * float(np.median(np.abs(errors))))
        kept = np.abs(errors) <= self.sensor.gate * usual
        return self.which(kept)._replace(rejected=self.rejected + int(np.sum(~kept)))


class Rows(NamedTuple):
    """The samples of one sensor, linearised about a motion; in units of its deviation.

    Attributes:
        by_start: derivatives of what is expected by initial state and parameters, (k, 2n + p).
        by_instant: by the instants of the moments, shape (k, moments).
        residual: samples less what is expected, in the directions of the rows, shape (k,).
        rest: sum of the squares that no unknown changes.
        errors: of all samples, less what is expected, in the unit of the sensor, (samples,).
    """

    by_start: Matrix
    by_instant: Matrix
    residual: Vector
    rest: float
    errors: Vector

    @property
    def squares(self) -> float:
        """Sum of the squares of all errors."""
        return float(self.residual @ self.residual) + self.rest

    @property
    def alone(self) -> int:
        """Number of errors that no unknown changes."""
        return self.errors.size - self.residual.size


def used_samples(
    family: ParametricFamily,
    measurements: Sequence[Measurement],
    samples: Sequence[SensorSample],
    epoch: int,
    within: tuple[int, int],
) -> tuple[CountedSamples, ...]:
    """The samples of each sensor ``within`` two stamps (ns), for a fit of ``family``.

    Raises:
        UsageError: a sensor or a parameter is of a kind that does not go with the other; the
            system does not have what is measured; a sensor is declared to be exact.
    """
    counted = []
    for i, sensor in enumerate(sensors_of(measurements, family.system)):
        given = sensor.measurement
        _check(family, sensor)
        own = [s for s in samples if s.sensor == i and within[0] <= s.stamp <= within[1]]
        own.sort(key=lambda s: s.stamp)
        instants = np.array([s.stamp - epoch for s in own], dtype=np.int64)
        values = np.array([s.value for s in own], dtype=float)
        finite = np.isfinite(values)
        values = values[finite] - sensor.shifts(instants[finite])
        counted.append(CountedSamples(given, instants[finite] / NS_PER_S, values))
    return tuple(counted)


def _check(family: ParametricFamily, sensor: DeclaredSensor) -> None:
    given = sensor.measurement
    if not given.deviation:
        raise given.wrong("deviation", "0 found; identify needs a positive number")
    grounds = [name for name in family.names if name.startswith("ground-")]
    if grounds and not given.gap:
        raise UsageError(
            f"parameter {grounds[0]!r}: moves the coordinates that {given.name} measures; expected"
            " others, or sensors of gaps alone"
        )


class RowMaker:
    """Collects the rows of samples while a motion is made, flight by flight."""

    def __init__(
        self, system: LinearisedSystem, every: Sequence[CountedSamples], moments: Vector
    ) -> None:
        """Rows of a ``system``; ``moments`` are where flights end, s since the epoch."""
        self._every, self._p = every, system.family.size
        self._first = 2 * system.family.system.n + self._p
        self._samples = SampleRows(system, [each.sensor for each in every])
        times = [self._samples.late(each.t) for each in every]
        self._place = [np.searchsorted(moments, each, side="right") for each in times]
        self._flights: list[list[tuple[Matrix, Vector, float]]] = [[] for _ in every]
        self._errors = [np.zeros(each.t.size) for each in every]

    def flight(self, k: int, at: TangentState) -> None:
        """Collect the samples of the flight before the moment ``k``, which begins at a state."""
        places = [np.flatnonzero(place == k) for place in self._place]
        if not any(place.size for place in places):
            return
        size = at.x.size
        times = [each.t[place] for each, place in zip(self._every, places, strict=True)]
        rows = self._samples.rows(at, times)
        for s, (each, place, row) in enumerate(zip(self._every, places, rows, strict=True)):
            if not place.size:
                continue
            errors = each.values[place] - row[0]
            self._errors[s][place] = errors
            table = np.column_stack([row[1], errors])
            table, rest = _triangular(table / each.deviation)
            by = table[:, :size] @ at.X
            by[:, size : size + self._p] += table[:, size:-1]
            self._flights[s].append((by, table[:, -1], rest))

    def rows(self, moments: int) -> tuple[Rows, ...]:
        """The triangulated rows of each sensor."""
        rows, first = [], self._first
        for parts, errors in zip(self._flights, self._errors, strict=True):
            table, rest = np.zeros((0, first + moments + 1)), 0.0
            if parts:
                table = np.vstack([np.column_stack([by, left]) for by, left, _ in parts])
                table, rest = _triangular(table)
                rest += sum(each for *_, each in parts)
            by_instant = table[:, first:-1]
            rows.append(Rows(table[:, :first], by_instant, table[:, -1], rest, errors))
        return tuple(rows)


def _triangular(table: Matrix) -> tuple[Matrix, float]:
    """At most as many rows as unknowns, and the sum of squares of the rest."""
    unknowns = table.shape[1] - 1
    if len(table) <= unknowns:
        return table, 0.0
    factor = linalg.qr(table, mode="r", check_finite=False)[0]
    return factor[:unknowns], float(factor[unknowns, -1] ** 2)
