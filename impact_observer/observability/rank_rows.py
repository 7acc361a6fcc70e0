# SPDX-License-Identifier: Apache-2.0
"""The rows of the observability matrix: gaps, speeds, loads and samples by the initial errors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_observer.dynamics import ImpactLaw
from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.readings import DeclaredSensor
from impact_observer.model import Forcing, System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.rebounds.constant_restitution import ConstantRestitution
from impact_observer.states import Matrix, Vector, frozen
from impact_observer.trajectory.linearised_system import (
    FlightEnd,
    LinearisedSystem,
    TangentState,
)
from impact_observer.trajectory.sample_rows import SampleRows


class RankRows:
    """The rows that events and samples add, on the errors of the initial state.

    Speeds are unknown without a motion: restitutions are slopes at nominal speeds. Errors of the
    initial state do not depend on forces.

    Attributes:
        at: the present errors, SI units, as derivatives by initial errors in standard deviations,
            shape (2n, size).
    """

    def __init__(
        self, system: System, scale: Vector, sensors: Sequence[DeclaredSensor] = ()
    ) -> None:
        """Start with errors of one standard deviation, ``scale``, shape (2n,), 0 where certain."""
        linear = [ConstantRestitution(law.nominal_slope) for law in system.rebounds]
        errors = system.unchecked(
            contacts=tuple(
                replace(c, restitution=law.restitution, rebound=None)
                for c, law in zip(system.contacts, linear, strict=True)
            ),
            rebounds=tuple(linear),
            special=frozenset(),
            eps=frozen([law.restitution for law in linear]),
            forcing=Forcing.none(system.n),
        )
        self._system = LinearisedSystem(ParametricFamily(errors, ()), np.zeros(0))
        self._newton, self._phases = ImpactLaw(system), self._system.moving.phases
        self._timescale = self._phases.scales.timescale
        declared = [each.measurement for each in sensors]
        self._samples = SampleRows(self._system, declared)
        orders = [2 if each.acceleration else 1 if each.velocity else 0 for each in declared]
        self._scales = [self._timescale**order for order in orders]
        self.at = TangentState(0.0, np.zeros(scale.size), np.diag(scale)[:, scale > 0])

    def informative(self, change: ContactChange) -> Contacts:
        """The contacts that add rows: those that hit, or a single one that opens by itself."""
        return change.informative(self._phases.independent(change.before), self._newton.system)

    def cross(self, change: ContactChange) -> Matrix:
        """Propagate to ``change`` and across it.

        Returns:
            One row for each gap, speed or load that is zero, on the initial error, scaled to gaps
            in m, shape (rows, size).

        Raises:
            ImpactLawError: the impact law has no solution.
        """
        system, closed = self._system, change.closed
        at = system.flight(self.at, change.t) if change.t > self.at.t else self.at
        if change.hit:
            rows = [system.gaps(at, change.hit)[1]]
            end = FlightEnd.of_change(change, self._newton, self._phases)
            jump = system.impact(at.x, end.pressed) if closed else system.jump(at, end)[0]
            at = at.mapped(jump, change.t, closed)
        else:
            opened = self.informative(change)
            pushed = np.sum(self._phases.B[:, list(opened)] ** 2, axis=0)[:, None]
            rows = [self._timescale**2 * pushed * system.guard(at, opened, hit=False).rows]
        if closed:
            rows.append(self._timescale * system.speeds(at, closed))
            # From here on both motions are on the stop: only errors along it remain.
            for rest in (system.on_stops, system.at_rest):
                at = at.mapped(rest(at.x, closed), change.t, closed)
        self.at = at._replace(closed=closed)
        return np.vstack(rows)

    def sampled(self, samples: Sequence[tuple[float, int]]) -> Matrix:
        """One row for each sample since the last event, scaled to gaps in m, (samples, size).

        ``samples`` are instants, s since the start, and indices of sensors.
        """
        rows = [np.zeros((0, self.at.X.shape[1]))]
        times = [np.array([t for t, i in samples if i == k]) for k in range(len(self._scales))]
        found = self._samples.rows(self.at, times) if samples else []
        for scale, (_, table) in zip(self._scales, found, strict=False):
            rows.append(scale * table @ self.at.X)
        return np.vstack(rows)
