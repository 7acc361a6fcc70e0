# SPDX-License-Identifier: Apache-2.0
"""Whether the model explains the impacts, from the innovations of the published account.

Innovations of a model that fits are independent. Those of one that does not have one sign, or
alternate: the portmanteau test (Ljung and Box, On a measure of lack of fit in time series models,
1978), without subtracting the mean.
"""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.estimation.hypotheses import FIRST
from impact_observer.states import Vector

LARGEST_STATISTIC = 48.0
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
_NOTABLE = 3.0
"""The same where an error of the model is established, and the account is ``NEARER``."""
_EXPLAINED = 0.8
"""Share of the latest events that other parameters explain, at least, to be the right ones."""
LARGEST_EVIDENCE = 12.0
"""Logarithm of the odds of an error of the model to none, above which the model is refuted."""
_DOUBTED_EVIDENCE = 4.0
"""The same, above which parameters of the model are estimated too."""
_STEP = 3.0
"""Most by which one event may raise that logarithm: one outlier is no misfit."""
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
        as_reported: of the latest events, whether they are explained as they were reported,
            without a spurious or missed impact or a restart.
        explained: the same, and without an error of the model.
        errors: events in a row after which an error of the model has been ``ESTABLISHED``.
        by_clock: whether that account explains the innovations by errors of the clock.
        statistic: of the test; 0 while there are too few innovations.
        evidence: logarithm of the odds of an error of the model to none, at most ``_STEP`` more
            after each event.
        residuals: at the latest impacts.
        is_refuted: whether other parameters explain the latest impacts better.
        was_misfit: whether the model did not explain the impacts up to the event before.
        is_misfit: whether the model does not explain the impacts.
    """

    innovations: tuple[float, ...] = ()
    as_reported: tuple[bool, ...] = ()
    explained: tuple[bool, ...] = ()
    errors: int = 0
    by_clock: bool = False
    statistic: float = 0.0
    evidence: float = 0.0
    residuals: tuple[Residual, ...] = ()
    is_refuted: bool = False
    was_misfit: bool = False
    is_misfit: bool = False

    def after(
        self,
        innovation: float | None,
        *,
        in_error: bool = False,
        by_clock: bool = False,
        as_reported: bool = True,
        exact: float = 1.0,
    ) -> "Fit":
        """The fit after an event; ``innovation`` is None where it measured nothing.

        ``exact`` is the probability that the model has been exact.
        """
        evidence = min(self.evidence + _STEP, -math.log(max(exact, _LEAST)))
        innovations, errors, statistic = self.innovations, self.errors, self.statistic
        if innovation is None:
            by_clock = self.by_clock
        else:
            clipped = min(max(innovation, -_CLIPPED), _CLIPPED)
            innovations = (*innovations[-(LATEST - 1) :], clipped)
            errors, statistic = errors + 1 if in_error else 0, _statistic(innovations)
        after = Fit(
            innovations,
            (*self.as_reported[-(LATEST - 1) :], as_reported),
            (*self.explained[-(LATEST - 1) :], as_reported and not in_error),
            errors,
            by_clock,
            statistic,
            evidence if len(self.as_reported) >= FIRST else 0.0,
            self.residuals,
            self.is_refuted,
            was_misfit=self.is_misfit,
        )
        return _judged(after)

    def compared(self, latest: Residual) -> "Fit":
        """The same with the ``latest`` residual."""
        return self._replace(residuals=(*self.residuals[-(_COMPARED - 1) :], latest))

    def beside(self, change: float) -> "Fit":
        """The same beside an account with other parameters.

        ``change`` of the parameters is the largest, in standard deviations.
        """
        is_refuted = False
        if change >= _NOTABLE and len(self.residuals) >= _RECENT:
            by_filter, by_replica, _, by_account = self._sizes(_RECENT)
            is_clear = change > _SIGNIFICANT and by_account < _CLEARLY * by_filter
            is_nearer = by_account < NEARER * min(by_filter, by_replica)
            is_refuted = is_clear or (self.is_in_error and is_nearer)
        if is_refuted is self.is_refuted:
            return self
        return _judged(self._replace(is_refuted=is_refuted))

    @property
    def is_in_error(self) -> bool:
        """Whether an error of the model is established, at the latest events in a row."""
        return self.errors >= _FEWEST

    @property
    def is_doubted(self) -> bool:
        """Whether the model may not explain the impacts: parameters are worth an estimate."""
        latest = self.explained[-_FEWEST:]
        is_excused = len(latest) == _FEWEST and 2 * sum(latest) < _FEWEST
        is_correlated = self.statistic > _DOUBTED_STATISTIC
        is_improbable = self.evidence > _DOUBTED_EVIDENCE
        is_in_doubt = is_excused or is_correlated or is_improbable
        return self.is_misfit or is_in_doubt or self.errors >= _DOUBTED

    @property
    def is_explained(self) -> bool:
        """Whether the model explains nearly all of the latest events, without any doubt."""
        n = len(self.explained)
        is_doubted = self.errors or self.statistic > DOUBTFUL_STATISTIC
        return not is_doubted and n >= _FEWEST and sum(self.explained) >= _EXPLAINED * n

    @property
    def is_established(self) -> bool:
        """Whether the model fits, and errors of the clock would be the errors of a clock."""
        return not (self.doubt or self.untested)

    @property
    def doubt(self) -> str:
        """That the model is doubted, in words; empty while it is not."""
        most = DOUBTFUL_STATISTIC if self.by_clock else _DOUBTED_STATISTIC
        is_doubted = self.is_misfit or self.is_in_error or self.statistic > most
        return "the model is doubted" if is_doubted else ""

    @property
    def untested(self) -> str:
        """That there are too few innovations to test a model, in words; else empty."""
        n = len(self.innovations)
        return f"{n} of {_FEWEST} innovations" if self.by_clock and n < _FEWEST else ""

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

        Their posterior probabilities, if the k residuals compared are independent and normal with
        a deviation that is unknown: ``(sum r^2)^(-k/2)`` (Jeffreys' prior).
        """
        compared = min(_RECENT if with_account else _COMPARED, len(self.residuals))
        by = np.array(self._sizes(compared))[[0, 1, 3][: 2 + with_account]]
        shares = (by / by.min()) ** -float(compared)
        return np.asarray(shares / shares.sum())

    @property
    def prefers_replica(self) -> bool:
        """Whether the model does not fit, and the geometric replica is nearer to the impacts."""
        if not self.is_compared:
            return False
        by_filter, by_replica, *_ = self._sizes()
        return by_replica < NEARER * by_filter

    @property
    def replica_level(self) -> float:
        """White accelerations that explain the residuals of the replica, m/s^1.5."""
        _, by_replica, unit, _ = self._sizes()
        return by_replica / unit

    @property
    def prefers_account(self) -> bool:
        """Whether the model does not fit, and an account with other parameters is the nearest."""
        if not (self.is_misfit and len(self.residuals) >= _RECENT):
            return False
        by_filter, by_replica, _, by_account = self._sizes(_RECENT)
        return by_account < NEARER * min(by_filter, by_replica)

    def _sizes(self, latest: int = _COMPARED) -> tuple[float, ...]:
        """The ``latest`` residuals as root sums of squares, each positive."""
        each = zip(*self.residuals[-latest:], strict=True)
        return tuple(math.hypot(_LEAST, *some) for some in each)


def _judged(fit: Fit) -> Fit:
    """``fit`` with ``is_misfit`` as its other fields say.

    An error of the model that is established is no proof while an exact model may have explained
    all events: it may be that of a clock. But while it is, a warning does not end.
    """
    n = len(fit.as_reported)
    is_excused = n >= _LATEST_EXCUSED and sum(fit.as_reported) < _LEAST_EXPLAINED * n
    is_correlated = fit.statistic > LARGEST_STATISTIC
    lasts = fit.was_misfit and fit.is_in_error
    is_improbable = fit.is_in_error and fit.evidence > LARGEST_EVIDENCE
    is_misfit = is_excused or is_correlated or is_improbable or fit.is_refuted or lasts
    return fit if is_misfit is fit.is_misfit else fit._replace(is_misfit=is_misfit)


def _statistic(innovations: tuple[float, ...]) -> float:
    """Of the test on ``innovations``: large where neighbours have one sign, or alternate.

    Zeros are rounding, which says nothing: they do not count.
    """
    n = len(innovations) - innovations.count(0.0)
    if n < _FEWEST:
        return 0.0
    nu, lags = np.array(innovations), range(1, _LAGS + 1)
    rho = [float(nu[k:] @ nu[:-k] / (nu @ nu)) for k in lags]
    return n * (n + 2) * sum(r * r / (n - k) for r, k in zip(rho, lags, strict=True))
