# SPDX-License-Identifier: Apache-2.0
"""A recording that a motion is to explain, and the motion that explains the recording."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.events import Contacts
from impact_observer.identify.fit_progress import FitProgress
from impact_observer.identify.prior import prior_covariance, prior_rows
from impact_observer.identify.scatter import Deviations
from impact_observer.identify.sensor_rows import CountedSamples
from impact_observer.identify.shooting import Shot, has_impulse, shoot
from impact_observer.model.parameter_uncertainty import ParameterUncertainty
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector
from impact_observer.trajectory.linearised_system import FlightEnd

LEAST = 1e-9
"""Smallest scale of gaps, m, and of shifts, s, in a robust fit."""
ROUNDED = 1e-9 / np.sqrt(12)
"""Standard deviation of a stamp that is wrong by its rounding only, s."""
_KNOWN = 0.02
"""Change of a deviation that is small, relative to itself."""
Instants: TypeAlias = Mapping[tuple[float, Contacts], float]
"""By stamp (s since the epoch) and contacts that hit: when a moment was, s since the epoch."""
AT_STAMPS: Instants = MappingProxyType({})
"""No instants: only the stamps are known."""


class Problem(NamedTuple):
    """A recording and the systems that may explain it.

    Attributes:
        family: the systems.
        moments: the recorded impacts, closings and openings, in order.
        start: where the initial state holds, s since the epoch.
        sensors: samples of what is measured beside the impacts.
        clock: standard deviation of a stamp, s, by which samples and the prior are weighed.
        is_declared: whether ``clock`` is declared; else the shifts show the deviation.
        instants: of the moments, about, as a smoothed motion has them; others are at their stamps.
        report: receives how far a fit is, and counts its flights.
        prior: how well the given values of parameters are known; None if unknown.
        least_clock: least deviation that the shifts may show, s.
        scatter: standard deviation of the relative error of an impulse; 0 for none.
    """

    family: ParametricFamily
    moments: Sequence[FlightEnd]
    start: float
    sensors: tuple[CountedSamples, ...] = ()
    clock: float = 0.0
    is_declared: bool = True
    instants: Instants = AT_STAMPS
    report: FitProgress = FitProgress()
    prior: ParameterUncertainty | None = None
    least_clock: float = LEAST
    scatter: float = 0.0

    @property
    def unknowns(self) -> int:
        """Number of unknowns: initial state and parameters."""
        return 2 * self.family.system.n + self.family.size

    @property
    def stamps(self) -> Vector:
        """The recorded stamps, s since the epoch, shape (moments,)."""
        return np.array([each.t for each in self.moments])

    @property
    def has_closings(self) -> bool:
        """Whether a contact stays closed after some moment."""
        return any(each.held for each in self.moments)

    @property
    def begin(self) -> Vector:
        """The instants with which a fit begins, s since the epoch, shape (moments,)."""
        return np.array([self.instants.get((each.t, each.hit), each.t) for each in self.moments])

    @property
    def interval(self) -> float:
        """Median of the time between two moments, s."""
        return float(np.median(np.diff(self.stamps, prepend=self.start)))

    @property
    def usual_flight(self) -> float:
        """The time between two moments by which errors of the stamps are judged, s.

        The median; the mean where bounces settle, since there the median is one bounce.
        """
        if not self.instants:
            return self.interval
        return (self.moments[-1].t - self.start) / len(self.moments)

    @property
    def counted(self) -> NDArray[np.int64]:
        """Indices of the moments whose stamps are compared: measured impacts and closings."""
        return np.array([k for k, m in enumerate(self.moments) if m.measured and m.hit])

    @property
    def impulses(self) -> NDArray[np.int64]:
        """Indices of the moments whose impulses may have errors; none without scatter."""
        moments = self.moments if self.scatter else ()
        return np.array([k for k, m in enumerate(moments) if has_impulse(m)], dtype=np.int64)

    @property
    def impulse_unit(self) -> float:
        """The relative error of an impulse that is as likely as an error of a stamp of 1 s."""
        return self.scatter / self.clock if self.scatter else 0.0

    @property
    def is_weighed(self) -> bool:
        """Whether anything is weighed against the stamps: samples, a prior, or impulses."""
        return bool(self.sensors) or self.has_prior or self.scatter > 0

    @property
    def has_prior(self) -> bool:
        """Whether a parameter of the family has a prior."""
        return bool(prior_covariance(self.prior, self.family)[0])

    @property
    def by_prior(self) -> Matrix:
        """Derivatives of the errors of the prior by initial state and parameters, (k, 2n + p).

        Errors of the prior are in units of one standard deviation.
        """
        rows = prior_rows(self.prior, self.family)
        return np.hstack([np.zeros((len(rows), 2 * self.family.system.n)), rows])

    def prior_errors(self, y: Vector) -> Vector:
        """Given values less those of ``y``, in units of the prior, shape (k,)."""
        by_prior = self.by_prior
        nominal = np.concatenate([np.zeros(2 * self.family.system.n), self.family.nominal])
        return np.asarray(by_prior @ (nominal - y))

    def shot(self, y: Vector, t: Vector | None = None, impulses: Vector | None = None) -> Shot:
        """The motion of ``y`` switched at ``t``, by default at the stamps.

        ``impulses`` are relative errors of the impulses, shape (moments,). A shorter ``t``
        switches at the first moments alone, with the samples until the next one.

        Raises:
            IdentificationError: the search may compute no more flights.
        """
        t, sensors = self.stamps if t is None else t, self.sensors
        self.report.spend(t.size)
        if t.size < len(self.moments):
            end = self.moments[t.size].t
            sensors = tuple(each.which(each.t < end) for each in sensors)
        moments, start = self.moments[: t.size], self.start
        return shoot(self.family, y, moments, t, start, samples=sensors, impulses=impulses)

    def moved(self, shot: Shot) -> float:
        """How far contacts move in one standard deviation of the clock, m."""
        return self.clock * (float(np.sqrt(np.mean(shot.speeds**2))) or 1.0)

    def gaps_of(self, shot: Shot, usual: float) -> tuple[Vector, Matrix]:
        """The residuals in m, and their derivatives by initial state and parameters.

        Gaps come first, then errors of samples: one standard deviation is a gap of ``usual``, m.
        """
        values = [shot.gaps, *(-usual * rows.residual for rows in shot.sensors)]
        by_start = [shot.by_start, *(usual * rows.by_start for rows in shot.sensors)]
        return np.concatenate(values), np.vstack(by_start)

    def with_prior(self, prior: ParameterUncertainty, first_clock: float) -> "Problem":
        """The problem with a ``prior``, weighed at first by an error of the clock, s.

        The prior is weighed by the clock error that the shifts show, at least the declared one:
        shifts that no motion explains are no reason to trust the impacts more than the prior.
        """
        least = self.clock if self.is_declared else ROUNDED
        clock = max(first_clock, least)
        return self._replace(prior=prior, clock=clock, is_declared=False, least_clock=least)

    def weighed_by(self, solution: "Solution") -> "Problem":
        """The problem with the error of the clock, or of impulses, that a solution has shown."""
        if solution.scattered is not None:
            return self.scattering(solution.scattered.shown)
        clock = self.clock if self.is_declared else max(solution.rms, self.least_clock)
        return self._replace(clock=clock)

    def scattering(self, shown: Deviations) -> "Problem":
        """The problem with the deviations that gaps have shown."""
        return self._replace(clock=shown.clock, scatter=shown.scatter)

    def is_like(self, other: "Problem") -> bool:
        """Whether the deviations are nearly those of another problem."""
        mine, theirs = (np.array([p.clock, p.scatter]) for p in (self, other))
        return bool(np.all(np.abs(mine - theirs) <= _KNOWN * theirs))


class Solution(NamedTuple):
    """A motion that explains the recorded instants.

    Attributes:
        y: initial state (q, u) and parameters, shape (2n + p,).
        t: instants, s since the epoch, shape (moments,).
        shot: the motion.
        shifts: instants minus stamps, s, of the moments that count, shape (counted,).
        counted: indices of these moments.
        freedom: degrees of freedom of the shifts.
        root: how far an error of each stamp, and of samples and prior in its unit, moves ``y``,
            shape (2n + p, any): ``root root^T`` times the variance of a stamp is the covariance
            of ``y``. The stamps come first.
        converged: whether the steps converged.
        errors: estimated standard deviations of the noise of the sensors, each in its unit.
        cost: sum of the squared shifts, and of the squared errors of samples, prior and impulses
            as those of the clock, s^2.
        scattered: what the impulses are; None if none of these has an error.
    """

    y: Vector
    t: Vector
    shot: Shot
    shifts: Vector
    counted: NDArray[np.int64]
    freedom: float
    root: Matrix
    converged: bool
    errors: tuple[float, ...] = ()
    cost: float = 0.0
    scattered: "Scattered | None" = None

    @property
    def is_outside(self) -> bool:
        """Whether most contacts approach where they hit.

        The mirror image of a motion has the same impacts, from the inside of all stops.
        """
        return bool(np.median(self.shot.speeds) < 0.0)

    @property
    def rms(self) -> float:
        """Estimated standard deviation of a stamp, s."""
        return deviation(self.shifts, self.freedom)

    @property
    def residuals(self) -> Vector:
        """What should be independent errors of the clock, s: shifts, or innovations."""
        return self.shifts if self.scattered is None else self.scattered.innovations

    @property
    def redundancy(self) -> float:
        """Degrees of freedom of the residuals."""
        return self.freedom if self.scattered is None else self.scattered.freedom


class Scattered(NamedTuple):
    """Errors of the impulses of a motion.

    Attributes:
        impulses: relative errors, shape (moments,).
        innovations: of the gaps, as errors of stamps, s, shape (counted,).
        freedom: degrees of freedom of the innovations.
        shown: the deviations that the gaps show.
    """

    impulses: Vector
    innovations: Vector
    freedom: float
    shown: Deviations


def deviation(shifts: Vector, freedom: float) -> float:
    """The estimated standard deviation of ``shifts`` with so many degrees of freedom."""
    return float(np.sqrt(np.sum(shifts**2) / max(freedom, 1)))
