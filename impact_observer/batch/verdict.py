# SPDX-License-Identifier: Apache-2.0
"""Whether a model explains a recording: what is left is a clock, a scatter, or the model."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from impact_observer.batch.motion_fit import MotionFit
from impact_observer.batch.noise_sizes import LARGEST_CLOCK
from impact_observer.batch.passes import NoiseSizes
from impact_observer.states import Vector

UNLIKELY = 1e-6
"""Probability of what is left under the model below which the model is rejected."""
LARGEST_MODEL_ERROR = 1e-3
"""Largest error of accelerations with which a model fits, over the usual ones."""
_NEVER = 10.0
"""Error of accelerations, over the largest one, with which no model fits, however unsure."""
_LARGEST_SCATTER = 0.06
"""Largest scatter of rebounds with which a model fits: rigs have 0.01 to 0.05."""
_OF_FLIGHTS = 0.005
"""Part of the mean flight above which no error of stamps is one of a clock."""
_LAGS = 10
"""Most lags of the tested autocorrelations."""
_INSERTED = 0.25
"""Part of the impacts of a motion above which inserted ones speak against a model."""
_REJECTED = 0.5
"""Part of the reported impacts above which rejected ones speak against a model."""


@dataclass(frozen=True, slots=True)
class FitVerdict:
    """Whether a model explains a recording.

    Attributes:
        reasons: why it does not, a line each; none where it fits.
        clock: standard deviation of the stamps that the recording shows, s.
        declared: the declared one, s; None without.
        scatter: standard deviation of a rebound over the speed of approach.
        model: error of accelerations, over the usual ones.
        size: probability of residuals of this size under the declared clock; 1 without one.
        white: probability of autocorrelations of this size of independent residuals.
        has_outliers: whether too many impacts had to be rejected or inserted.
    """

    reasons: tuple[str, ...]
    clock: float
    declared: float | None
    scatter: float
    model: float
    size: float
    white: float
    has_outliers: bool

    @property
    def fits(self) -> bool:
        """Whether nothing speaks against the model."""
        return not self.reasons


def verdict_on(fit: MotionFit, rejected: int = 0) -> FitVerdict:
    """Judge a motion and the sizes of its noises; the account has ``rejected`` impacts."""
    clock, scatter, model = fit.sizes
    declared, nu = fit.problem.clock, fit.innovations[0]
    size = 1.0
    if declared is not None and nu.size:
        size = float(special.chdtrc(nu.size, np.sum(nu**2)))
    # shifts that are small beside the clock error are no evidence, and may repeat themselves
    least, late = max(2 * fit.problem.least_clock, (declared or 0.0) / 2), np.abs(fit.predicted)
    white = whiteness(nu * np.maximum(late - least, 0.0) / np.maximum(late, least))
    moments = fit.problem.moments
    inserted = int(np.sum(fit.problem.errors.has_sensor[fit.problem.missed]))
    reported = rejected + moments.row_moment.size
    has_outliers = inserted > _INSERTED * moments.count or rejected > _REJECTED * reported
    found = FitVerdict((), clock, declared, scatter, model, size, white, has_outliers)
    return replace(found, reasons=tuple(_reasons(fit, found)))


def whiteness(values: Vector) -> float:
    """Ljung and Box's probability of the autocorrelations of ``values`` (Biometrika 65, 1978)."""
    K, power = values.size, float(np.sum(values**2))
    lags = max(1, min(_LAGS, K // 3))
    if power == 0.0 or lags >= K:
        return 1.0
    lag = np.arange(1, lags + 1)
    rho = np.array([float(values[k:] @ values[:-k]) for k in lag]) / power
    return float(special.chdtrc(lags, K * (K + 2) * np.sum(rho**2 / (K - lag))))


def _reasons(fit: MotionFit, found: FitVerdict) -> Iterator[str]:
    """Yield what speaks against a model, a line each."""
    moments = fit.problem.moments
    flight = float(np.mean(moments.flights[1:])) if moments.count > 1 else np.inf
    limits = NoiseSizes(found.clock, _LARGEST_SCATTER, LARGEST_MODEL_ERROR)
    is_large = found.model > _NEVER * limits.model
    is_large = is_large or not fit.density.allows(limits, fit.sizes, found.declared)
    if not fit.is_settled:
        yield "the search for a motion has not settled"
    if is_large and found.model > limits.model:
        yield f"flights miss by {found.model:.2g} of the accelerations"
    if is_large and found.scatter > limits.scatter:
        yield f"rebounds scatter by {found.scatter:.2g} of the speed of approach"
    if found.declared is None and found.clock > min(0.9 * LARGEST_CLOCK, _OF_FLIGHTS * flight):
        yield f"stamps differ by {found.clock:.2g} s, and no --clock-error is declared"
    if found.size < UNLIKELY:
        yield f"stamps differ by more than the declared clock error (chance {found.size:.1g})"
    if found.white < UNLIKELY:
        yield f"what is left at successive stamps is correlated (chance {found.white:.1g})"
    if fit.misses_impacts:
        yield f"the motion does not reach {fit.unreached} of {fit.residuals.size} impacts"
    if fit.is_behind_stops:
        yield "contacts open where they should close: the motion is on the other side of a stop"
    yield from _of_sensors(fit)
    if found.has_outliers:
        yield "too many of the impacts had to be rejected or inserted"


def _of_sensors(fit: MotionFit) -> Iterator[str]:
    """Yield the sensors whose errors are too large."""
    for index, sensor in enumerate(fit.problem.samples):
        own = fit.samples.sensor == index
        errors = fit.sample_errors[own] / sensor.deviation
        if own.any() and special.chdtrc(own.sum(), np.sum(errors**2)) < UNLIKELY:
            ratio = float(np.sqrt(np.mean(errors**2)))
            yield f"errors of {sensor.measurement.name} are {ratio:.2g} times the declared ones"
