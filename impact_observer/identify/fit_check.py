"""Whether a model explains recorded impact times as well as their clock allows."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from impact_observer.identify.identification import Identification
from impact_observer.states import Vector

REJECTED = 1e-3
"""Probability of the shifts under the model below which the model is rejected."""


@dataclass(frozen=True, slots=True)
class FitCheck:
    """Tests of the shifts of the stamps against a declared clock.

    Attributes:
        size: probability of shifts this large under the declared clock error; None without one.
        white: probability of autocorrelations this large of independent shifts (Ljung and Box,
            On a measure of lack of fit in time series models, 1978).
        lags: of the autocorrelations.
        by_contact: by name: impacts, mean and rms of their shifts, s.
        worst: the contact of the largest rms.
    """

    size: float | None
    white: float
    lags: int
    by_contact: dict[str, tuple[int, float, float]]
    worst: str

    @property
    def fits(self) -> bool:
        """Whether neither test rejects the model."""
        return self.white >= REJECTED and (self.size is None or self.size >= REJECTED)


def check_fit(found: Identification) -> FitCheck:
    """Check the fitted model.

    Under the right model the shifts are the errors of a clock: independent, and of its size.
    """
    shifts = found.shifts
    names = sorted({name for each in found.contacts for name in each})
    by_contact = {}
    for name in names:
        own = shifts[[name in each for each in found.contacts]]
        by_contact[name] = (own.size, float(np.mean(own)), float(np.sqrt(np.mean(own**2))))
    size = None
    if found.declared:
        weight = float(np.sum((shifts / found.clock) ** 2))
        size = float(stats.chi2.sf(weight, max(found.freedom, 1)))
    lags = max(1, min(10, shifts.size // 3))
    return FitCheck(
        size=size,
        white=_whiteness(shifts, lags),
        lags=lags,
        by_contact=by_contact,
        worst=max(names, key=lambda name: by_contact[name][2]),
    )


def _whiteness(shifts: Vector, lags: int) -> float:
    """Ljung and Box's probability of the autocorrelations of ``shifts``."""
    K, power = shifts.size, float(np.sum(shifts**2))
    if power == 0.0 or lags >= K:
        return 1.0
    lag = np.arange(1, lags + 1)
    rho = np.array([float(shifts[k:] @ shifts[:-k]) for k in lag]) / power
    return float(stats.chi2.sf(K * (K + 2) * np.sum(rho**2 / (K - lag)), lags))
