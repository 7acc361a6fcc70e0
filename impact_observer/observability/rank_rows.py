# SPDX-License-Identifier: Apache-2.0
"""The rows of the observability matrix: gaps, speeds, loads and samples by the initial errors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_observer.batch.sample_rows import measured_rows
from impact_observer.dynamics import ImpactLaw
from impact_observer.dynamics.tangent import Tangent
from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.readings import DeclaredSensor
from impact_observer.model import Forcing, System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.rebounds.constant_restitution import ConstantRestitution
from impact_observer.states import Matrix, Vector, frozen


class RankRows:
    """The rows that events and samples add, on the errors of the initial state.

    Speeds are unknown without a motion: restitutions are slopes at nominal speeds. Errors of the
    initial state do not depend on forces.

    Attributes:
        X: the present errors, SI units, as derivatives by initial errors in standard deviations,
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
        self._tangent = Tangent(ParametricFamily(errors, ()))
        self._newton, self._phases = ImpactLaw(system), self._tangent.phases
        self._timescale = self._phases.scales.timescale
        self._sensors = [measured_rows(each.measurement, system) for each in sensors]
        self._t: float = 0.0
        self._closed: Contacts = ()
        self.X = np.diag(scale)[:, scale > 0]

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
        tangent, closed, n = self._tangent, change.closed, self._tangent.n
        still = np.zeros(2 * n)
        if change.t > self._t:
            self.X = self._moved(change.t - self._t) @ self.X
        if change.hit:
            rows = [tangent.gaps(change.hit).by_x @ self.X]
            pressed = change.pressed(self._newton, -np.ones(len(change.hit)))
            self.X = tangent.impact(still, pressed).Phi @ self.X
        else:
            opened = self.informative(change)
            phase = tangent.phase(self._closed)
            pushed = np.sum(self._phases.B[:, list(opened)] ** 2, axis=0)[:, None]
            loads = phase.loads[[phase.held.index(i) for i in opened]]
            pulls = np.hstack([tangent.system.K, tangent.system.C])
            rows = [self._timescale**2 * pushed * (loads @ pulls @ self.X)]
        if closed:
            W = tangent.system.W[:, list(closed)].T
            rows.append(self._timescale * W @ self.X[n:])
            # From here on both motions are on the stop: only errors along it remain.
            self.X[:n] -= self._phases.projection.jump(closed) @ (W @ self.X[:n])
            self.X = tangent.rest(still, closed).Phi @ self.X
        self._t, self._closed = change.t, closed
        return np.vstack(rows)

    def sampled(self, samples: Sequence[tuple[float, int]]) -> Matrix:
        """One row for each sample since the last event, scaled to gaps in m, (samples, size).

        ``samples`` are instants, s since the start, and indices of sensors.
        """
        rows, n = [np.zeros((0, self.X.shape[1]))], self._tangent.n
        rates = self._tangent.rate_slope(self._closed)[n:]
        for t, index in samples:
            by_x, by_acceleration, _ = self._sensors[index]
            order = 2 if np.any(by_acceleration) else 1 if np.any(by_x[n:]) else 0
            row = (by_x + by_acceleration @ rates) @ self._moved(t - self._t) @ self.X
            rows.append(self._timescale**order * row[None])
        return np.vstack(rows)

    def _moved(self, s: float) -> Matrix:
        """Return the transition matrix of ``s`` seconds from the last event on."""
        return np.asarray(self._tangent.flights([0.0], np.array([s]), self._closed).Phi[0])
