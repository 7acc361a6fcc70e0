# SPDX-License-Identifier: Apache-2.0
"""Samples of sensors beside the impacts, as rows of the flights in which they lie."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.batch.linearised_motion import LinearisedMotion
from impact_observer.batch.moments import Moments
from impact_observer.batch.passes import MeasuredRow
from impact_observer.dynamics.tangent import Tangent
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.observer.samples import SensorSample, sensors_of
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_HUBER = 3.0
"""Deviations of a sample up to which its square counts, and beyond which its size counts."""
_LEAST = 1e-9
"""Deviation of a sample that is declared to be exact, in its unit."""


@dataclass(frozen=True, slots=True, eq=False)
class FlightSamples:
    """Samples of one sensor.

    Attributes:
        measurement: the declaration of the sensor.
        by_x: coefficients of (q, u), shape (2n,).
        by_acceleration: coefficients of the accelerations, shape (n,).
        contact: index of the contact whose gap is measured; -1 for none.
        values: less offset and the motion of grounds, shape (S,).
        t: when the samples hold, s since the epoch, S times.
    """

    measurement: Measurement
    by_x: Vector
    by_acceleration: Vector
    contact: int
    values: Vector
    t: Sequence[Elapsed]

    @property
    def deviation(self) -> float:
        """Standard deviation of the noise."""
        return max(self.measurement.deviation, _LEAST)


def flight_samples(
    system: System,
    measurements: Sequence[Measurement],
    samples: Sequence[SensorSample],
    epoch: int,
    within: tuple[int, int],
) -> tuple[FlightSamples, ...]:
    """The samples of all sensors between two stamps.

    Raises:
        UsageError: the system does not have what is measured.
    """
    found = []
    for i, sensor in enumerate(sensors_of(measurements, system)):
        given = sensor.measurement
        own_samples = [
            s
            for s in samples
            if s.sensor == i and within[0] <= s.stamp <= within[1] and np.isfinite(s.value)
        ]
        instants = np.array([s.stamp - epoch for s in own_samples], dtype=np.int64)
        values = np.array([s.value for s in own_samples]) - given.offset
        if instants.size:
            values = values - sensor.shifts(instants)
        t = [Elapsed(int(ns)) for ns in instants.tolist()]
        found.append(FlightSamples(given, *measured_rows(given, system), values, t))
    return tuple(found)


def measured_rows(measurement: Measurement, system: System) -> tuple[Vector, Vector, int]:
    """Coefficients of (q, u), (2n,), and accelerations, (n,); the contact of a gap, or -1."""
    rows, contact = np.zeros((3, system.n)), -1
    given = measurement.position, measurement.velocity, measurement.acceleration
    for row, own in zip(rows, given, strict=True):
        for name, value in own.items():
            row[system.coordinates.index(name)] += value
    if measurement.gap:
        contact = system.contact_names.index(measurement.gap)
        rows[0] = system.W[:, contact]
    return np.concatenate([rows[0], rows[1]]), rows[2], contact


@dataclass(frozen=True, slots=True, eq=False)
class SampleRows:
    """Samples as linear functions of the unknown after the moments.

    Attributes:
        node: number of the moment before each sample, 0 for the start, shape (S,).
        h: derivatives of ``predicted - measured`` by the unknown, shape (S, N).
        value: predicted minus measured, shape (S,).
        deviation: of the noise, shape (S,).
        sensor: index of the sensor, shape (S,).
    """

    node: np.ndarray[tuple[int], np.dtype[np.intp]]
    h: Matrix
    value: Vector
    deviation: Vector
    sensor: np.ndarray[tuple[int], np.dtype[np.intp]]

    def errors(self, after: Matrix) -> Vector:
        """Predicted minus measured at unknowns after the moments, (K + 1, N): shape (S,)."""
        return np.asarray(self.value + np.einsum("sn,sn->s", self.h, after[self.node]))

    def inflation(self, errors: Vector) -> Vector:
        """Factors of the deviations of samples that are far off by ``errors``, shape (S,)."""
        return np.asarray(np.sqrt(np.maximum(np.abs(errors) / self.deviation / _HUBER, 1.0)))

    def compressed(self, inflation: Vector, nodes: int) -> list[list[MeasuredRow]]:
        """At most as many rows after each of ``nodes`` moments as there are unknowns."""
        table = np.column_stack([self.h, self.value]) / (self.deviation * inflation)[:, None]
        found: list[list[MeasuredRow]] = []
        for k in range(nodes):
            own = table[self.node == k]
            if len(own) > own.shape[1]:
                own = np.linalg.qr(own, mode="r")[: own.shape[1] - 1]
            rows = [MeasuredRow(row[:-1], float(row[-1]), 1.0, is_instant=False) for row in own]
            found.append(rows)
        return found


def sample_rows(
    tangent: Tangent,
    moments: Moments,
    motion: LinearisedMotion,
    samples: Sequence[FlightSamples],
    near: float,
) -> SampleRows:
    """The samples that lie farther than ``near`` s from all impacts, linearised."""
    n, d, p = tangent.n, 2 * tangent.n, tangent.p
    ends = np.array([float(each.t) for each in moments.each])
    parts: list[tuple[Vector, ...]] = []
    for index, sensor in enumerate(samples):
        t = np.array([float(each) for each in sensor.t])
        node = np.searchsorted(ends, t, side="right")
        since = np.where(node > 0, t - np.append(0.0, ends)[node], np.inf)
        until = np.append(ends, np.inf)[node] - t
        kept = (since > max(near, sensor.measurement.blanking)) & (until > near)
        for k in np.unique(node[kept]).tolist():
            own = np.flatnonzero(kept & (node == k))
            held = moments.each[k - 1].switching.held if k else ()
            begin = moments.each[k - 1].t if k else moments.start
            times = [sensor.t[i] for i in own.tolist()]
            s = np.array([each - begin for each in times])
            maps, after = tangent.flights([begin], s, held), motion.after[k]
            x, Phi, Gamma = maps.of(after), maps.Phi, maps.Gamma(after)
            value, by_theta = x @ sensor.by_x, np.zeros((own.size, p))
            by_x = np.einsum("i,kij->kj", sensor.by_x, Phi)
            by_theta = np.einsum("i,kip->kp", sensor.by_x, Gamma)
            if sensor.contact >= 0:
                gap = tangent.gaps((sensor.contact,))
                value, by_theta = value + gap.rest[0], by_theta + gap.rest_slopes[0]
            if np.any(sensor.by_acceleration):
                first, slope = tangent.rates(times, x, held)[0], tangent.rate_slope(held)
                value = value + first[:, n:] @ sensor.by_acceleration
                row = sensor.by_acceleration @ slope[n:]
                by_x = by_x + np.einsum("i,kij->kj", row, Phi)
                by_theta = by_theta + np.einsum("i,kip->kp", row, Gamma)
                direct = tangent.by_rates(times, x, held)[:, n:]
                by_theta = by_theta + np.einsum("i,kip->kp", sensor.by_acceleration, direct)
            columns = np.hstack([by_x, by_theta])
            deviation = np.full(own.size, sensor.deviation)
            parts.append(
                (
                    np.full(own.size, k),
                    columns,
                    value - sensor.values[own],
                    deviation,
                    np.full(own.size, index),
                )
            )
    if not parts:
        nothing = np.zeros(0, dtype=np.intp)
        return SampleRows(nothing, np.zeros((0, d + p)), np.zeros(0), np.zeros(0), nothing)
    return SampleRows(*(np.concatenate(each) for each in zip(*parts, strict=True)))
