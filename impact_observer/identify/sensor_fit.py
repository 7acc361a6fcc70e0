# SPDX-License-Identifier: Apache-2.0
"""How the samples of a sensor fit the motion that explains a recording."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from impact_observer.identify.problem import Problem, Solution
from impact_observer.identify.residuals import DOUBTED, REJECTED, whiteness
from impact_observer.states import Vector

_LAGS = 4.0
"""Number of the autocorrelations that count, at a hundred samples."""


@dataclass(frozen=True, slots=True)
class SensorFit:
    """The samples of one sensor under a fitted motion.

    Attributes:
        name: of the sensor.
        samples: how many were compared.
        near: how many were left out near impacts.
        rejected: how many its gate rejected.
        deviation: of its noise, declared or learned, in its unit.
        is_declared: whether ``deviation`` is declared.
        rms: of the errors over their degrees of freedom, in its unit.
        size: probability of errors this large under the declared deviation; 1 without one.
        white: probability of autocorrelations this large of independent errors (Ljung and Box).
        correlated: factor by which neighbours that are alike make a mean less certain.
    """

    name: str
    samples: int
    near: int
    rejected: int
    deviation: float
    is_declared: bool
    rms: float
    size: float
    white: float
    correlated: float

    @property
    def fits(self) -> bool:
        """Whether neither test rejects the model."""
        return self.size >= REJECTED and self.white >= REJECTED

    @property
    def widening(self) -> float:
        """Factor of the standard errors: 1 where white noise of its size explains the errors."""
        larger = self.rms / self.deviation if self.size < DOUBTED else 1.0
        return larger * (self.correlated if self.white < DOUBTED else 1.0)


def sensor_fits(problem: Problem, solution: Solution) -> tuple[SensorFit, ...]:
    """How the samples of each sensor fit."""
    fits = []
    rows = zip(problem.sensors, solution.shot.sensors, solution.errors, strict=True)
    for each, own, rms in rows:
        errors, size = own.errors, 1.0
        if not each.is_learned and errors.size:
            squares = float(np.sum((errors / each.deviation) ** 2))
            freedom = squares * (each.deviation / rms) ** 2 if rms else 1.0
            size = float(stats.chi2.sf(squares, max(freedom, 1.0)))
        fits.append(
            SensorFit(
                each.sensor.name,
                errors.size,
                each.near,
                each.rejected,
                each.deviation,
                not each.is_learned,
                rms,
                size,
                whiteness(errors),
                _correlated(errors),
            )
        )
    return tuple(fits)


def _correlated(errors: Vector) -> float:
    """Standard deviation of a mean of ``errors``, over that of independent ones of this size.

    Newey and West, A simple, positive semi-definite, heteroskedasticity and autocorrelation
    consistent covariance matrix, 1987.
    """
    power = float(errors @ errors)
    if not power:
        return 1.0
    lags = min(int(_LAGS * (errors.size / 100) ** (2 / 9)) + 1, errors.size - 1)
    total = 1.0
    for k in range(1, lags + 1):
        total += 2 * (1 - k / (lags + 1)) * float(errors[k:] @ errors[:-k]) / power
    return float(np.sqrt(max(total, 1.0)))
