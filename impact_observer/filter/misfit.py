# SPDX-License-Identifier: Apache-2.0
"""Whether the model explains the impacts, from the innovations of the published account.

Innovations of a model that fits are independent. Those of one that does not have one sign, or
alternate: the portmanteau test (Ljung and Box, On a measure of lack of fit in time series models,
1978), without subtracting the mean. In a periodic motion they repeat, however small they are
beside the error of a clock that is not declared: a likelihood ratio that their scale does not
change.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.filter.tuning import TUNING
from impact_observer.kernel._kernel import TINY
from impact_observer.model import System
from impact_observer.robots.robot import Robot
from impact_observer.states import Vector

MISFIT = (
    "the model does not explain the impacts: restitution, stiffness, damping, forces or gaps are"
    " not the plant's, or the stamps are late or drift; see docs/troubles.md"
)
ROBOT_MISFIT = (
    "the model does not explain the impacts: {}, or restitution or planes are not the"
    " robot's, or the stamps are late or drift; see docs/troubles.md"
)
CONTRADICTION = (
    "an impact came {:.3g} standard deviations or more from its prediction, which the declared"
    " errors of sensor and model exclude: declare larger ones, or leave clock_error, missed,"
    " spurious, mislabelled and model_error at their defaults; see docs/troubles.md"
)
SILENCE = (
    "not reported: the sensor or its line may be dead, or the"
    " plant has stopped; see docs/troubles.md"
)
STEP = (
    "the sensor's clock has stepped by {:.4g} s: stamps since then are taken for as late; see"
    " docs/troubles.md"
)
JUMPS = (
    "the velocities after hits do not follow from the impact law: the tip rubs, or covers or"
    " joints are soft; encoders alone tell these velocities; see docs/robots.md"
)
EXPLAINED = "the model explains the impacts again"
"""What is said when a misfit has ended."""
_BY_REPLICA = "; the estimate is the geometric replica's, which is nearer to the impacts"


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
        errors: events in a row with an error of the model (``Tuning.established_error``).
        by_clock: whether that account explains the innovations by errors of the clock.
        statistic: of the test; 0 while there are too few innovations.
        repetition: logarithm of the odds that innovations repeat to those that they are white;
            0 before the state may be known.
        periodicity: logarithm of the odds that innovations have a harmonic of some frequency to
            those that they are white; 0 before the state may be known.
        evidence: logarithm of the odds of an error of the model to none, which one event
            raises by ``Tuning.evidence_step`` at most.
        instants: of the innovations, in time scales of the model since the epoch.
        residuals: at the latest impacts.
        is_refuted: whether other parameters explain the latest impacts better.
        contradictions: the latest innovations as far as they contradict what is declared, in
            standard deviations; 0 where they do not.
        was_misfit: whether the model did not explain the impacts up to the event before.
        is_misfit: whether the model does not explain the impacts.
        step: by which the sensor's clock has stepped before the first of the events, s.
        strange_jumps: whether the impact law does not explain the jumps of a robot.
    """

    innovations: tuple[float, ...] = ()
    as_reported: tuple[bool, ...] = ()
    explained: tuple[bool, ...] = ()
    errors: int = 0
    by_clock: bool = False
    statistic: float = 0.0
    repetition: float = 0.0
    periodicity: float = 0.0
    evidence: float = 0.0
    instants: tuple[float, ...] = ()
    residuals: tuple[Residual, ...] = ()
    is_refuted: bool = False
    contradictions: tuple[float, ...] = ()
    was_misfit: bool = False
    is_misfit: bool = False
    step: float = 0.0
    strange_jumps: bool = False

    def after(
        self,
        innovation: float | None,
        *,
        instant: float = 0.0,
        in_error: bool = False,
        by_clock: bool = False,
        as_reported: bool = True,
        exact: float = 1.0,
        is_trusted: bool = False,
        considered: float = 0.0,
        strange_jumps: bool = False,
    ) -> "Fit":
        """The fit after an event; ``innovation`` is None where it measured nothing.

        ``exact`` is the probability that the model has been exact. The event ``is_trusted`` if the
        sensor is declared without faults. The part ``considered`` of the innovation's deviation
        is that of considered parameters, whose errors are the same at all events: what three
        deviations of these errors explain is no evidence.
        """
        in_error &= considered <= TUNING.least_considered
        exact = exact if considered <= TUNING.least_considered else 1.0
        evidence = min(self.evidence + TUNING.evidence_step, -math.log(max(exact, TINY)))
        innovations, errors = self.innovations, self.errors
        statistic, repetition = self.statistic, self.repetition
        instants, periodicity = self.instants, self.periodicity
        size = abs(innovation or 0.0)
        far = size if is_trusted and size > TUNING.contradiction else 0.0
        if innovation is None:
            by_clock = self.by_clock
        else:
            left = max(size - TUNING.considered_deviations * considered, 0.0)
            clipped = math.copysign(min(left, TUNING.clipping), innovation)
            innovations = (*innovations[-(TUNING.window - 1) :], clipped)
            errors = errors + 1 if in_error else 0
            instants = (*instants[-(TUNING.window - 1) :], instant)
            statistic, repetition = _statistic(innovations), repetition_of(innovations)
            periodicity = periodicity_of(instants, innovations)
        after = Fit(
            innovations,
            (*self.as_reported[-(TUNING.window - 1) :], as_reported),
            (*self.explained[-(TUNING.window - 1) :], as_reported and not in_error),
            errors,
            by_clock,
            statistic,
            repetition if len(self.as_reported) >= TUNING.first_events else 0.0,
            periodicity if len(self.as_reported) >= TUNING.first_events else 0.0,
            evidence if len(self.as_reported) >= TUNING.first_events else 0.0,
            instants,
            self.residuals,
            self.is_refuted,
            (*self.contradictions[-(TUNING.window - 1) :], far),
            was_misfit=self.is_misfit,
            step=self.step if len(self.as_reported) < TUNING.window else 0.0,
            strange_jumps=strange_jumps,
        )
        return _judged(after)

    def contradicted(self) -> "Fit":
        """The same after an impact that was missed, of a sensor that is declared to miss none."""
        latest = self.contradictions[-(TUNING.window - 1) :]
        return _judged(self._replace(contradictions=(*latest, TUNING.contradiction)))

    def compared(self, latest: Residual) -> "Fit":
        """The same with the ``latest`` residual."""
        return self._replace(residuals=(*self.residuals[-(TUNING.compared - 1) :], latest))

    def beside(self, change: float) -> "Fit":
        """The same beside an account with other parameters.

        ``change`` of the parameters is that of all together, in standard deviations.
        """
        is_refuted = False
        if change >= TUNING.notable_change and len(self.residuals) >= TUNING.recent:
            by_filter, by_replica, _, by_account = self._sizes(TUNING.recent)
            is_significant = change > TUNING.significant_change
            is_clear = is_significant and by_account < TUNING.clearly_nearer * by_filter
            is_nearer = by_account < TUNING.nearer * min(by_filter, by_replica)
            is_refuted = is_clear or (self.is_in_error and is_nearer)
        if is_refuted is self.is_refuted:
            return self
        return _judged(self._replace(is_refuted=is_refuted))

    @property
    def is_in_error(self) -> bool:
        """Whether an error of the model is established, at the latest events in a row."""
        return self.errors >= TUNING.established_events

    @property
    def is_doubted(self) -> bool:
        """Whether the model may not explain the impacts: parameters are worth an estimate."""
        fewest, latest = TUNING.fewest, self.explained[-TUNING.fewest :]
        is_excused = len(latest) == fewest and sum(latest) < TUNING.doubted_explained * fewest
        is_correlated = self.statistic > TUNING.doubted_statistic
        is_correlated = is_correlated or self.periodicity > TUNING.doubted_periodicity
        is_improbable = self.evidence > TUNING.doubted_evidence
        is_in_doubt = is_excused or is_correlated or is_improbable
        return self.is_misfit or is_in_doubt or self.errors >= TUNING.doubted_events

    @property
    def is_explained(self) -> bool:
        """Whether the model explains nearly all of the latest events, without any doubt."""
        n, explained = len(self.explained), sum(self.explained)
        if self.errors or self.statistic > TUNING.doubtful_statistic or n < TUNING.fewest:
            return False
        return explained >= TUNING.mostly_explained * n

    @property
    def is_established(self) -> bool:
        """Whether the model fits, and errors of the clock would be the errors of a clock."""
        return not (self.doubt or self.untested)

    @property
    def doubt(self) -> str:
        """That the model is doubted, in words; empty while it is not."""
        most = TUNING.doubtful_statistic if self.by_clock else TUNING.doubted_statistic
        is_doubted = self.is_misfit or self.is_in_error or self.statistic > most
        is_doubted = is_doubted or self.repetition > TUNING.doubted_repetition
        is_doubted = is_doubted or self.periodicity > TUNING.doubted_periodicity
        if self.step and not is_doubted:
            return "the sensor's clock has stepped"
        return "the model is doubted" if is_doubted else ""

    @property
    def untested(self) -> str:
        """That there are too few innovations to test a model, in words; else empty."""
        n, fewest = len(self.innovations), TUNING.fewest
        return f"{n} of {fewest} innovations" if self.by_clock and n < fewest else ""

    def message(self, account: str = "", misfit: str = MISFIT) -> str:
        """The warning of a misfit; empty while the model fits.

        ``account`` is what explains the impacts instead, if that is published, and ``misfit`` the
        warning of a model that does not fit.
        """
        if not self.is_misfit:
            return STEP.format(self.step) if self.step else ""
        if self.strange_jumps:
            return JUMPS
        if (far := max(self.contradictions, default=0.0)) and not account:
            return CONTRADICTION.format(far)
        return misfit + (account or (_BY_REPLICA if self.prefers_replica else ""))

    @property
    def is_compared(self) -> bool:
        """Whether the model does not fit, and filter and replica have been compared."""
        return self.is_misfit and bool(self.residuals)

    def shares(self, *, with_account: bool) -> Vector:
        """The weights of filter, replica and perhaps account in what is published.

        Their posterior probabilities, if the k residuals compared are independent and normal with
        a deviation that is unknown: ``(sum r^2)^(-k/2)`` (Jeffreys' prior).
        """
        compared = min(TUNING.recent if with_account else TUNING.compared, len(self.residuals))
        by = np.array(self._sizes(compared))[[0, 1, 3][: 2 + with_account]]
        shares = (by / by.min()) ** -float(compared)
        return np.asarray(shares / shares.sum())

    @property
    def prefers_replica(self) -> bool:
        """Whether the model does not fit, and the geometric replica is nearer to the impacts."""
        if not self.is_compared:
            return False
        by_filter, by_replica, *_ = self._sizes()
        return by_replica < TUNING.nearer * by_filter

    @property
    def replica_level(self) -> float:
        """White accelerations that explain the residuals of the replica, m/s^1.5."""
        _, by_replica, unit, _ = self._sizes()
        return by_replica / unit

    @property
    def prefers_account(self) -> bool:
        """Whether the model does not fit, and an account with other parameters is the nearest."""
        if not (self.is_misfit and len(self.residuals) >= TUNING.recent):
            return False
        by_filter, by_replica, _, by_account = self._sizes(TUNING.recent)
        return by_account < TUNING.nearer * min(by_filter, by_replica)

    def _sizes(self, latest: int = TUNING.compared) -> tuple[float, ...]:
        """The ``latest`` residuals as root sums of squares, each positive."""
        each = zip(*self.residuals[-latest:], strict=True)
        return tuple(math.hypot(TINY, *some) for some in each)


def misfit_of(system: System | Robot) -> str:
    """The warning that the model of a ``system`` does not explain the impacts."""
    if isinstance(system, Robot):
        return ROBOT_MISFIT.format(system.description.larger_errors)
    return MISFIT


def _judged(fit: Fit) -> Fit:
    """``fit`` with ``is_misfit`` as its other fields say.

    An error of the model that is established is no proof while an exact model may have explained
    all events: it may be that of a clock. But while it is, a warning does not end.
    """
    n = len(fit.as_reported)
    is_excused = n >= TUNING.fewest_excused and sum(fit.as_reported) < TUNING.least_explained * n
    is_correlated = fit.statistic > TUNING.largest_statistic
    is_correlated = is_correlated or fit.repetition > TUNING.largest_repetition
    is_correlated = is_correlated or fit.periodicity > TUNING.largest_repetition
    lasts = fit.was_misfit and fit.is_in_error
    is_improbable = fit.is_in_error and fit.evidence > TUNING.largest_evidence
    is_contradicted = any(fit.contradictions)
    is_misfit = is_excused or is_correlated or is_improbable or fit.is_refuted or lasts
    is_misfit = is_misfit or is_contradicted or fit.strange_jumps
    return fit if is_misfit is fit.is_misfit else fit._replace(is_misfit=is_misfit)


def _statistic(innovations: tuple[float, ...]) -> float:
    """Of the test on ``innovations``: large where neighbours have one sign, or alternate.

    Zeros are rounding, which says nothing: they do not count.
    """
    n = len(innovations) - innovations.count(0.0)
    if n < TUNING.fewest:
        return 0.0
    nu, lags = np.array(innovations), range(1, TUNING.lags + 1)
    rho = [float(nu[k:] @ nu[:-k] / (nu @ nu)) for k in lags]
    return n * (n + 2) * sum(r * r / (n - k) for r, k in zip(rho, lags, strict=True))


def repetition_of(innovations: Sequence[float]) -> float:
    """Logarithm of the odds that the latest ``innovations`` repeat to those that they are white.

    If they repeat, each is that some events before, one to ``Tuning.lags``, plus a share
    ``Tuning.repeated`` of their scale, of which both know nothing (Jeffreys' prior). All numbers
    of latest innovations count alike. White ones pass ``x`` with a probability of at most
    ``exp(-x)`` (Markov). Zeros do not count, nor do outliers, which are cut off.
    """
    nu, least = np.array(innovations), TUNING.fewest_repeated
    nu = nu[(nu != 0) & (np.abs(nu) < TUNING.clipping)]
    squares = np.cumsum(nu[::-1] ** 2)
    shares, odds = np.array(TUNING.repeated)[:, None], [np.zeros(0)]
    for lag in range(1, min(TUNING.lags, nu.size - least) + 1):
        number = np.arange(least + lag, nu.size + 1)
        steps = np.cumsum((nu[lag:] - nu[:-lag])[::-1] ** 2)[number - lag - 1]
        whole = squares[number - 1]
        sizes = whole - squares[number - lag - 1] + steps / shares**2
        each = (lag - number) * np.log(shares) - number / 2 * np.log(sizes / whole)
        odds.append(each.ravel())
    found = np.concatenate(odds)
    return float(np.logaddexp.reduce(found) - math.log(found.size)) if found.size else 0.0


def periodicity_of(instants: Sequence[float], innovations: Sequence[float]) -> float:
    """Logarithm of the odds that the latest ``innovations`` have a harmonic to none.

    A force of a frequency that the model does not have makes innovations that are nearly harmonic
    in time: at ``instants``, in time scales. All frequencies up to ``Tuning.highest_frequency``
    and some numbers of latest innovations count alike; of scale and amplitudes both know nothing,
    or one unit of information (Zellner's g prior). White ones pass ``x`` with a probability of
    at most ``exp(-x)`` (Markov). Zeros are rounding, which says nothing.
    """
    t, nu, odds = np.array(instants), np.array(innovations), []
    t, nu = t[nu != 0], nu[nu != 0]
    for n in TUNING.harmonic_windows:
        if nu.size < n:
            break
        since, latest = t[-n:] - t[-n], nu[-n:]
        step = math.pi / max(float(since[-1]), TINY)
        count = math.ceil(TUNING.highest_frequency / step - 0.5)
        wave, apart = np.exp(0.5j * step * since)[None], np.exp(1j * step * since)
        while len(wave) < count:  # an exponential function of each would take twice as long
            wave, apart = np.concatenate([wave, wave * apart]), apart * apart
        wave = wave[:count]
        # The least squares of cosine and sine, by the normal equations of each frequency.
        seen, twice = wave @ latest, np.sum(wave * wave, axis=1)
        explained = 2 * (n * np.abs(seen) ** 2 - (twice.conj() * seen**2).real)
        explained /= np.maximum(n * n - np.abs(twice) ** 2, 1e-6 * n * n)
        left = np.maximum(1 - explained / (latest @ latest), 0.0)
        odds.append((n - 2) / 2 * math.log1p(n) - n / 2 * np.log1p(n * left))
    found = np.concatenate(odds) if odds else np.zeros(0)
    return float(np.logaddexp.reduce(found) - math.log(found.size)) if found.size else 0.0
