# SPDX-License-Identifier: Apache-2.0
"""Errors of samples that are correlated, and what they do to the deviations of an estimate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Vector

_SIGNIFICANT = 5.0
"""Standard errors of an autocorrelation from which on it counts: of white errors one in a million
does.
"""
_STRONG = 0.3
"""Autocorrelation that counts where others are significant, whatever its standard error."""
_NEARLY = 0.9
"""Share of the largest autocorrelation that is nearly that."""
_FEWEST, _SHARE = 30, 0.1
"""Least number of pairs of samples at a lag, and least share of all samples."""
_ROUNDS = 20
"""Most rounds in which the significant autocorrelations are chosen."""
_LONGEST = 2**21
"""Most periods of sampling from the first to the last sample."""
_WIDER = 1.05
"""Factor of the deviations from which on a warning is due."""
_ROUNDED, _WHOLE = 1e-6, 0.05
"""Difference of values that is rounding, relative to their range, and distance of a difference
from a multiple of the count, relative to the count.
"""
_OF_COUNTS = 1.5
"""Largest size of errors that quantisation explains, relative to count / sqrt(12)."""


@dataclass(frozen=True, slots=True)
class ErrorCorrelation:
    """By how much correlated errors of samples make an estimate less certain than white ones.

    Least squares with independent errors of the variance ``s^2`` gives an unknown the error ``sum
    a_i e_i``, of the variance ``s^2 sum a_i^2``. Errors with the autocorrelations ``rho_k`` give
    the variance ``s^2 (sum a_i^2 + 2 sum_k rho_k sum_i a_i a_{i+k})``. So the deviation is larger
    by the root of ``1 + 2 sum_k rho_k c_k``, where ``c_k = sum_i a_i a_{i+k} / sum a_i^2``. The
    weights ``a_i`` follow the motion: those of an unknown that scales the motion are the values
    less their mean, those of an unknown that shifts the motion are equal. The larger factor counts
    for all unknowns.

    The errors of a coarse encoder repeat themselves on a periodic motion, if so does the sampling:
    ``rho_k`` and ``c_k`` are near 1 at each repetition, and their sum is the number of
    repetitions. Errors of neighbours that are alike have ``c_k`` near 1, and the sum is the
    usual time of autocorrelation.

    All ``rho_k`` of residuals add up to nothing, as residuals are orthogonal to the weights. So
    only significant ones count, above five of their standard errors ``sqrt((1 + 2 sum rho_j^2) /
    n_k)``, where ``n_k`` pairs of samples have this lag (Bartlett, On the theoretical
    specification and sampling properties of autocorrelated time-series, 1946), or above 0.3:
    errors that repeat exactly have no end of large ``rho_j``. White errors have none.

    Attributes:
        factor: of the deviations, 1 for white errors.
        lag: the least with nearly the largest autocorrelation, s; 0 for white errors.
        count: distance of the sensor's values, in its unit, where quantisation explains the size
            of the errors; else 0.
    """

    factor: float = 1.0
    lag: float = 0.0
    count: float = 0.0

    @staticmethod
    def of_errors(t: Vector, errors: Vector, values: Vector) -> "ErrorCorrelation":
        """The correlation of the ``errors`` of samples at ``t`` (s, ascending), of these values.

        Lags are multiples of the usual period of sampling.
        """
        size, power = errors.size, float(errors @ errors)
        period = float(np.median(np.diff(t))) if size > _FEWEST else 0.0
        if not power or period <= 0.0 or t[-1] - t[0] > _LONGEST * period:
            return WHITE
        places = np.rint((t - t[0]) / period).astype(np.int64)
        pairs = np.rint(_products(places, np.ones(size)))
        about = values - np.mean(values)
        alike = [pairs / size]
        alike += [_products(places, about) / float(about @ about)] if np.any(about) else []
        rho = _products(places, errors) / np.maximum(pairs, 1.0) * size / power
        enough = pairs >= max(_FEWEST, _SHARE * size)
        enough[0] = False
        chosen, spread, strong = np.zeros(rho.size, dtype=np.bool_), 1.0, _STRONG * np.sqrt(pairs)
        for _ in range(_ROUNDS):
            before = chosen
            least = np.minimum(_SIGNIFICANT * np.sqrt(spread), np.maximum(_SIGNIFICANT, strong))
            chosen = enough & (np.abs(rho) * np.sqrt(pairs) > least)
            if np.array_equal(chosen, before):
                break
            spread = 1.0 + 2.0 * float(rho[chosen] ** 2 @ pairs[chosen]) / size
        if not chosen.any():
            return ErrorCorrelation(count=_count(errors, values))
        sums = [1.0 + 2.0 * float(rho[chosen] @ each[chosen]) for each in alike]
        factor = float(np.sqrt(max(*sums, 1.0)))
        strengths = np.where(chosen, np.abs(rho), 0.0)
        lag = int(np.argmax(strengths >= _NEARLY * np.max(strengths))) * period
        return ErrorCorrelation(factor, lag, _count(errors, values))

    def warning(self, name: str) -> str:
        """The warning that the deviations are widened; empty where they hardly are."""
        if self.factor < _WIDER:
            return ""
        widened = f"deviations are widened by a factor of {self.factor:.2g}"
        if not self.count:
            return (
                f"errors of {name} are correlated, most after {self.lag:.3g} s: {widened}; see"
                " docs/measurements.md"
            )
        return (
            f"errors of {name} repeat with the motion, most after {self.lag:.3g} s, as those of a"
            f" coarse encoder do (count {self.count:.3g} / sqrt(12)): {widened}; a finer encoder,"
            " another rate of sampling or dither helps, see docs/measurements.md"
        )


WHITE = ErrorCorrelation()
"""The correlation of errors that have none."""


def _products(places: NDArray[np.int64], numbers: Vector) -> Vector:
    """The sums of products of ``numbers`` at these places, by the distance of two places."""
    row = np.zeros(int(places[-1]) + 1)
    np.add.at(row, places, numbers)
    long = 1 << (2 * row.size - 1).bit_length()
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(row, long)) ** 2, long)[: row.size])


def _count(errors: Vector, values: Vector) -> float:
    """The count of a sensor whose values are multiples of one, if this explains the errors."""
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > _ROUNDED * np.ptp(values)]
    if not gaps.size:
        return 0.0
    count = float(np.min(gaps))
    is_whole = bool(np.all(np.abs(gaps / count - np.rint(gaps / count)) < _WHOLE))
    rms = float(np.sqrt(np.mean(errors**2)))
    return count if is_whole and rms <= _OF_COUNTS * count / np.sqrt(12.0) else 0.0
