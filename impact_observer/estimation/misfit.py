"""Whether the model explains the impacts, from the innovations of the published account.

Innovations of a model that fits are independent. Those of one that does not have one sign, or
alternate: the portmanteau test (Ljung and Box, On a measure of lack of fit in time series models,
1978), without subtracting the mean.
"""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.states import Vector

LARGEST_STATISTIC = 32.0
"""Of the test; above it the model does not explain the impacts."""
DOUBTFUL_STATISTIC = 16.0
"""Of the test; above it errors of the clock are no good explanation."""
LATEST = 32
"""Innovations that are tested, the latest."""
_FEWEST = 12
"""Innovations from which on they are tested, and events from which on an error is established."""
ESTABLISHED = 0.8
"""Probability of an error of the model from which on an event counts as one with an error."""
_LATEST_EXCUSED = 16
"""Events from which on those that need an excuse are counted: a spurious or missed impact, a
restart."""
_LEAST_EXPLAINED = 0.375
"""Share of events that an exact model explains as they were reported, at least."""
_DOUBTED = 6
"""Events in a row with an established error of the model, from which on parameters of the model
are estimated too."""
_DOUBTED_STATISTIC = 24.0
"""Of the test; above it they are estimated as well. An exact model seldom gets there."""
_RECENT = 5
"""Impacts at which an account with other parameters is compared, the latest."""
_CLEARLY = 0.5
"""Most that the residuals of that account may be, over those of the filter, if it refutes the
model."""
_SIGNIFICANT = 5.0
"""Change of a parameter, in standard deviations, that refutes the model then."""
_EXPLAINED = 0.8
"""Share of the latest events that other parameters explain, at least, to be the right ones."""
_LAGS = 4
_CLIPPED = 3.0
"""Innovation, in standard deviations, beyond which it counts as this: an outlier is no misfit."""
MISFIT = (
    "the model does not explain the impacts: restitution, stiffness, damping, forces or gaps are"
    " not the plant's, or the stamps are late or drift; see docs/misfit.md"
)
_BY_REPLICA = "; the estimate is the geometric replica's, which is nearer to the impacts"
NEARER = 0.9
"""Most that the residuals of the replica may be, over those of the filter, to prefer it."""
_LEAST = 1e-150
_COMPARED = 16
"""Impacts at which the estimate and the geometric replica are compared, the latest."""


class Residual(NamedTuple):
    """The estimated gaps at an impact, where the plant's is zero.

    Attributes:
        filter: of the account that the filter publishes, m.
        replica: of the geometric replica beside it, m.
        unit: standard deviation of that, if accelerations were white noise of 1 m/s^1.5, s^1.5.
        account: of the account that estimates parameters, m; NaN while there is none.
    """

    filter: float
    replica: float
    unit: float
    account: float = math.nan


class Fit(NamedTuple):
    """How the model has explained the latest impacts.

    Attributes:
        innovations: the latest, in standard deviations, with their signs, clipped.
        as_reported: of the latest events, whether an exact model explains them as they were
            reported, without a spurious or missed impact or a restart.
        errors: events in a row after which an error of the model has been ``ESTABLISHED``.
        by_clock: whether that account explains the innovations by errors of the clock.
        statistic: of the test; 0 while there are too few innovations.
        residuals: at the latest impacts.
        is_refuted: whether other parameters explain the latest impacts clearly better.
    """

    innovations: tuple[float, ...] = ()
    as_reported: tuple[bool, ...] = ()
    errors: int = 0
    by_clock: bool = False
    statistic: float = 0.0
    residuals: tuple[Residual, ...] = ()
    is_refuted: bool = False

    def after(
        self,
        innovation: float | None,
        *,
        in_error: bool = False,
        by_clock: bool = False,
        as_reported: bool = True,
    ) -> "Fit":
        """The fit after an event; ``innovation`` is None where it measured nothing."""
        explained = (*self.as_reported[-(LATEST - 1) :], as_reported and not in_error)
        if innovation is None:
            return self._replace(as_reported=explained)
        clipped = min(max(innovation, -_CLIPPED), _CLIPPED)
        latest = (*self.innovations[-(LATEST - 1) :], clipped)
        errors = self.errors + 1 if in_error else 0
        statistic = _statistic(latest)
        return self._replace(
            innovations=latest,
            as_reported=explained,
            errors=errors,
            by_clock=by_clock,
            statistic=statistic,
        )

    def compared(self, latest: Residual) -> "Fit":
        """The same with the ``latest`` residual."""
        return self._replace(residuals=(*self.residuals[-(_COMPARED - 1) :], latest))

    def beside(self, change: float) -> "Fit":
        """The same beside an account with other parameters.

        ``change`` of the parameters is the largest, in standard deviations.
        """
        is_refuted = change > _SIGNIFICANT and len(self.residuals) >= _RECENT
        if is_refuted:
            by_filter, *_, by_account = self._recent
            is_refuted = by_account < _CLEARLY * by_filter
        return self._replace(is_refuted=is_refuted)

    @property
    def is_misfit(self) -> bool:
        """Whether the model does not explain the impacts."""
        n = len(self.as_reported)
        is_excused = n >= _LATEST_EXCUSED and sum(self.as_reported) < _LEAST_EXPLAINED * n
        is_correlated = self.statistic > LARGEST_STATISTIC
        return is_excused or is_correlated or self.errors >= _FEWEST or self.is_refuted

    @property
    def is_doubted(self) -> bool:
        """Whether the model may not explain the impacts: parameters are worth an estimate."""
        latest = self.as_reported[-_FEWEST:]
        is_excused = len(latest) == _FEWEST and 2 * sum(latest) < _FEWEST
        is_correlated = self.statistic > _DOUBTED_STATISTIC
        return self.is_misfit or is_excused or is_correlated or self.errors >= _DOUBTED

    @property
    def is_explained(self) -> bool:
        """Whether the model explains nearly all of the latest events, without any doubt."""
        n = len(self.as_reported)
        is_doubted = self.errors or self.statistic > DOUBTFUL_STATISTIC
        return not is_doubted and n >= _FEWEST and sum(self.as_reported) >= _EXPLAINED * n

    @property
    def is_established(self) -> bool:
        """Whether the model fits, and errors of the clock would be the errors of a clock."""
        if not self.by_clock:
            return not self.is_misfit
        tested = len(self.innovations) >= _FEWEST and self.statistic <= DOUBTFUL_STATISTIC
        return tested and not self.is_misfit

    def message(self, account: str = "") -> str:
        """The warning of a misfit; empty while the model fits.

        ``account`` is what explains the impacts instead, if that is published.
        """
        if not self.is_misfit:
            return ""
        return MISFIT + (account or (_BY_REPLICA if self.prefers_replica else ""))

    @property
    def is_compared(self) -> bool:
        """Whether the model does not fit, and filter and replica have been compared."""
        return self.is_misfit and bool(self.residuals)

    def shares(self, *, with_account: bool) -> Vector:
        """The weights of filter, replica and perhaps account in what is published.

        By the inverse squares of their residuals.
        """
        sizes = self._recent if with_account else self._sizes
        shares = np.array(sizes)[[0, 1, 3][: 2 + with_account]] ** -2.0
        return np.asarray(shares / shares.sum())

    @property
    def prefers_replica(self) -> bool:
        """Whether the model does not fit, and the geometric replica is nearer to the impacts."""
        if not self.is_compared:
            return False
        by_filter, by_replica, *_ = self._sizes
        return by_replica < NEARER * by_filter

    @property
    def replica_level(self) -> float:
        """White accelerations that explain the residuals of the replica, m/s^1.5."""
        _, by_replica, unit, _ = self._sizes
        return by_replica / unit

    @property
    def prefers_account(self) -> bool:
        """Whether the model does not fit, and an account with other parameters is the nearest."""
        if not (self.is_misfit and len(self.residuals) >= _RECENT):
            return False
        by_filter, by_replica, _, by_account = self._recent
        return by_account < NEARER * min(by_filter, by_replica)

    @property
    def _recent(self) -> tuple[float, ...]:
        """The same of the latest few."""
        return tuple(math.hypot(_LEAST, *p) for p in zip(*self.residuals[-_RECENT:], strict=True))

    @property
    def _sizes(self) -> tuple[float, ...]:
        """The residuals as root sums of squares, each positive."""
        return tuple(math.hypot(_LEAST, *each) for each in zip(*self.residuals, strict=True))


def _statistic(innovations: tuple[float, ...]) -> float:
    """Of the test on ``innovations``: large where neighbours have one sign, or alternate."""
    n = len(innovations)
    if n < _FEWEST or not any(innovations):
        return 0.0
    nu, lags = np.array(innovations), range(1, _LAGS + 1)
    whole = nu.dot(nu)
    rho = [float(nu[k:].dot(nu[:-k]) / whole) for k in lags]
    return n * (n + 2) * sum(r * r / (n - k) for r, k in zip(rho, lags, strict=True))
