# SPDX-License-Identifier: Apache-2.0
"""The test for misfit: silent on white innovations, not on those of one sign or of period two."""

import numpy as np
import pytest
from scipy import stats

from impact_observer.filter.misfit import MISFIT, Fit, Residual, periodicity_of, repetition_of
from impact_observer.filter.tuning import TUNING


def fitted(innovations: object, **options: bool) -> Fit:
    """The fit after ``innovations``."""
    fit = Fit()
    for each in np.asarray(innovations, float).tolist():
        fit = fit.after(each, **options)
    return fit


@pytest.mark.long
def test_statistic_of_white_innovations_is_that_of_ljung_and_box() -> None:
    """Its mean is the number of lags, and nothing warns."""
    rng = np.random.default_rng(3)
    fits = [fitted(rng.normal(size=40)) for _ in range(300)]
    assert np.mean([fit.statistic for fit in fits]) == pytest.approx(4.0, rel=0.15)
    assert not any(fit.is_misfit for fit in fits)


def test_repetition_is_the_mean_ratio_of_two_densities() -> None:
    """Of directions of normal vectors: white ones, and sums of steps of the given shares."""
    nu, ratios = np.random.default_rng(8).normal(size=9) + 1.0, []
    for lag in range(1, 5):
        for size in range(5 + lag, 10):
            some = nu[-size:]
            sums = np.array(
                [[i >= j and (i - j) % lag == 0 for j in range(size)] for i in range(size)]
            )
            for share in TUNING.repeated:
                root = sums * np.where(np.arange(size) < lag, 1.0, share)
                inside = some @ np.linalg.solve(root @ root.T, some) / (some @ some)
                ratios.append(inside ** (-size / 2) / np.linalg.det(root))
    assert repetition_of(nu.tolist()) == pytest.approx(np.log(np.mean(ratios)), rel=1e-9)


def test_white_innovations_hardly_repeat() -> None:
    """By Markov's inequality at most ``exp(-3)`` of them are beyond 3; far fewer are."""
    rng = np.random.default_rng(9)
    found = [repetition_of(rng.normal(size=32).tolist()) for _ in range(2000)]
    assert np.mean(np.array(found) > 3.0) < 0.01


@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_innovations_that_repeat_warn_however_small_they_are(scale: float) -> None:
    """A jitter that is learned too large makes them small; eight of them suffice."""
    rng = np.random.default_rng(10)
    first = rng.normal(size=12).tolist()
    later = scale * np.resize([1.0, -0.4], 10) * (1 + 0.03 * rng.normal(size=10))
    fit = fitted(first, by_clock=True)
    assert not fit.doubt
    for each in later.tolist():
        fit = fit.after(each, by_clock=True)
    assert fit.statistic < TUNING.largest_statistic
    assert fit.is_misfit


def test_periodicity_is_the_mean_of_bayes_factors_of_regressions() -> None:
    """With Zellner's g prior, g the number of innovations; least squares by numpy."""
    rng = np.random.default_rng(12)
    t, nu, factors = np.cumsum(rng.uniform(2, 9, 20)), rng.normal(size=20), []
    for n in (12, 16):
        since = t[-n:] - t[-n]
        step = np.pi / since[-1]
        for frequency in np.arange(0.5 * step, TUNING.highest_frequency, step):
            waves = np.column_stack([np.cos(frequency * since), np.sin(frequency * since)])
            left = np.linalg.lstsq(waves, nu[-n:])[1][0] / (nu[-n:] @ nu[-n:])
            factors.append((1 + n) ** ((n - 2) / 2) / (1 + n * left) ** (n / 2))
    found = periodicity_of(t.tolist(), nu.tolist())
    assert found == pytest.approx(np.log(np.mean(factors)), rel=1e-6)


def test_white_innovations_hardly_have_a_harmonic() -> None:
    """By Markov's inequality at most ``exp(-4)`` of them are beyond 4; far fewer are."""
    rng = np.random.default_rng(13)
    t = np.cumsum(rng.uniform(2, 9, (1000, 32)), axis=1)
    found = [periodicity_of(each.tolist(), rng.normal(size=32).tolist()) for each in t]
    assert np.mean(np.array(found) > 4.0) < 0.005


@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_innovations_with_a_harmonic_of_any_frequency_warn(scale: float) -> None:
    """Pairs of impacts in a period of a force, which a force of 2.3 times its frequency disturbs.

    No lag up to four repeats.
    """
    rng = np.random.default_rng(14)
    t = np.add.outer(2.5 * np.arange(16), [0.0, 0.55]).ravel() + 0.02 * rng.normal(size=32)
    nu = scale * (np.cos(5.75 * t + 0.4) + 0.3 * rng.normal(size=32))
    fit = Fit()
    for at, each in zip((5.1 * t).tolist(), nu.tolist(), strict=True):
        fit = fit.after(each, instant=at)
    assert fit.periodicity > TUNING.largest_repetition > fit.repetition
    assert fit.statistic < TUNING.largest_statistic
    assert fit.is_misfit


def test_rounding_is_no_innovation() -> None:
    """Zeros after a few that agree by chance, before the estimate has locked, prove nothing."""
    nu = np.random.default_rng(5).normal(size=14)
    assert fitted([*nu, *np.zeros(18)]).statistic == pytest.approx(fitted(nu).statistic)
    assert not any(fitted([*np.ones(11), *np.zeros(k)]).statistic for k in range(21))


@pytest.mark.parametrize("pattern", [[1.0], [1.0, -1.0], [0.2], [1.0, 1.0, -1.0, -1.0]])
def test_patterns_warn_and_white_innovations_end_the_warning(pattern: list[float]) -> None:
    """One sign, however small, or a period: within 28 impacts; gone 40 impacts later."""
    rng = np.random.default_rng(6)
    fit = fitted(np.resize(pattern, 28) * (1 + 0.1 * rng.normal(size=28)))
    assert fit.is_misfit
    assert fit.message().startswith(MISFIT)
    for each in rng.normal(size=40):
        fit = fit.after(float(each))
    assert not fit.is_misfit
    assert not fit.message()


def test_single_outliers_do_not_warn() -> None:
    """Two false positives in a row among white innovations."""
    nu = np.random.default_rng(7).normal(size=32)
    nu[10:12] = 500.0
    assert not fitted(nu).is_misfit


def test_an_outlier_of_a_sensor_without_faults_warns_for_the_window() -> None:
    """Such a sensor has none: sensor or model are not what is declared."""
    fit = Fit().after(9.0, is_trusted=True)
    assert fit.is_misfit
    assert "9 standard deviations or more" in fit.message()
    for each in np.random.default_rng(7).normal(size=TUNING.window).tolist():
        assert fit.is_misfit
        fit = fit.after(each, is_trusted=True)
    assert not fit.is_misfit
    assert not Fit().after(9.0).is_misfit


def test_events_that_measure_nothing_do_not_count() -> None:
    """The innovations stay as they are."""
    fit = fitted([1.0] * 5)
    assert fit.after(None).innovations == fit.innovations


def test_error_of_the_model_that_lasts_needs_another_account_to_be_a_misfit() -> None:
    """It may be a clock's. Nearer parameters prove it; the warning lasts as long as the error."""
    nu = np.random.default_rng(8).normal(size=12)
    near = Residual(0.02, 0.03, 0.1, 0.015)
    fit = compared(fitted(nu, in_error=True), *[near] * 5)
    assert fit.is_in_error
    assert not fit.is_misfit
    assert not fit.is_established
    assert not fit.beside(2.0).is_misfit
    assert not compared(fitted(nu[:11], in_error=True), *[near] * 5).beside(4.0).is_misfit
    assert not compared(fit, *[near._replace(account=0.019)] * 5).beside(4.0).is_misfit
    refuted = fit.beside(4.0)
    assert refuted.is_misfit
    persistent = refuted.after(0.2, in_error=True).beside(0.0)
    assert persistent.is_misfit
    assert not persistent.after(0.3).beside(0.0).is_misfit


def test_established_error_is_a_misfit_once_an_exact_model_is_improbable() -> None:
    """An exact model of probability 1e-6 is refuted after 12 events with an error, 1e-5 is not."""
    nu = np.random.default_rng(8).normal(size=12).tolist()
    for exact, is_misfit in ((1e-5, False), (1e-6, True)):
        fit = Fit()
        for each in nu:
            fit = fit.after(each, in_error=True, exact=1.0)
        assert not fit.is_misfit
        for each in nu[:6]:
            fit = fit.after(each, in_error=True, exact=exact)
        assert fit.is_misfit is is_misfit
        assert not fit.after(nu[6], in_error=False, exact=1.0).is_misfit


def test_one_event_proves_little() -> None:
    """However improbable the exact model is after it, it takes four of them."""
    nu = np.random.default_rng(9).normal(size=12).tolist()
    fit = Fit()
    for each in nu:
        fit = fit.after(each, in_error=True)
    warned = []
    for each in nu[:6]:
        fit = fit.after(each, in_error=True, exact=0.0)
        warned.append(fit.is_misfit)
    assert warned == [False] * 4 + [True] * 2
    assert fit.after(nu[6], in_error=True, exact=0.9).evidence < 0.2


def test_improbable_exact_model_is_no_misfit_without_an_established_error() -> None:
    """The exact model may have been lost by the search for what early events were."""
    nu = np.random.default_rng(10).normal(size=32).tolist()
    fit = Fit()
    for each in nu:
        fit = fit.after(each, exact=1e-30)
        assert not fit.is_misfit
    assert fit.is_doubted


def test_events_that_need_an_excuse_are_a_misfit() -> None:
    """Spurious, missed and restarted in turn, with few innovations; one in five is no misfit."""
    fit, fair, nu = Fit(), Fit(), np.random.default_rng(10).normal(size=40).tolist()
    for k in range(40):
        fit = fit.after(None if k % 2 else nu[k], as_reported=k % 4 == 0)
        fair = fair.after(nu[k], as_reported=k % 5 > 0)
        assert not fair.is_misfit
        assert fit.is_misfit == (k >= 15)


def test_errors_of_a_clock_must_be_white_to_establish_the_fit() -> None:
    """Fewer than twelve innovations, or correlated ones, do not establish the fit."""
    nu = np.random.default_rng(9).normal(size=30)
    assert fitted(nu[:3]).is_established
    assert not fitted(nu[:3], by_clock=True).is_established
    assert fitted(nu, by_clock=True).is_established
    assert not fitted(np.ones(12), by_clock=True).is_established


def test_nearer_replica_is_preferred_in_a_misfit_only() -> None:
    """By the gaps at the latest impacts; its level explains them."""
    fit, misfit = fitted([0.1, -0.4]), fitted(np.ones(20))
    for each in range(40):
        residual = Residual(0.02, 0.01, 0.1) if each > 10 else Residual(0.0, 5.0, 0.1)
        fit, misfit = fit.compared(residual), misfit.compared(residual)
    assert misfit.prefers_replica
    assert misfit.replica_level == pytest.approx(0.1)
    assert "geometric" in misfit.message()
    assert not fit.prefers_replica


def compared(fit: Fit, *residuals: Residual) -> Fit:
    """The same after so many impacts."""
    for each in residuals:
        fit = fit.compared(each)
    return fit


def test_other_parameters_refute_a_model_if_they_changed_and_are_clearly_nearer() -> None:
    """At five impacts in a row: half the gaps, by parameters five deviations off the model's."""
    near, far = Residual(0.02, 0.03, 0.1, 0.001), Residual(0.02, 0.03, 0.1, 0.015)
    fit = fitted(np.random.default_rng(11).normal(size=12))
    assert not compared(fit, *[near] * 4).beside(50.0).is_misfit
    refuted = compared(fit, *[near] * 5).beside(50.0)
    assert refuted.is_misfit
    assert refuted.prefers_account
    assert not refuted.beside(3.0).is_misfit
    assert not compared(fit, *[far] * 5).beside(50.0).is_misfit
    before = Residual(0.02, 0.03, 0.1)  # the account has only begun
    assert not compared(fit, *[near] * 3, before, near).beside(50.0).is_misfit


def test_nearest_of_three_is_published_with_weights_by_their_gaps() -> None:
    """Likelihoods of the latest five, averaged over deviations; of sixteen without an account."""
    misfit = compared(fitted(np.ones(20)), *[Residual(9.0, 9.1, 1.0)] * 11)
    misfit = compared(misfit, *[Residual(0.2, 0.3, 1.0, 0.1)] * 5)
    assert misfit.prefers_account
    deviations = np.geomspace(1e-3, 1e3, 20_000)
    steps = np.gradient(deviations) / deviations  # any order of magnitude is equally likely

    def likelihood(*residuals: float) -> float:
        densities = stats.norm.pdf(np.array(residuals)[:, None], scale=deviations)
        return float(np.prod(densities, axis=0) @ steps)

    three = np.array([likelihood(*[each] * 5) for each in (0.2, 0.3, 0.1)])
    np.testing.assert_allclose(misfit.shares(with_account=True), three / three.sum(), rtol=1e-6)
    two = np.array([likelihood(*[9.0 + by] * 11, *[0.2 + by] * 5) for by in (0.0, 0.1)])
    np.testing.assert_allclose(misfit.shares(with_account=False), two / two.sum(), rtol=1e-6)


def test_parameters_explain_if_the_latest_events_raise_no_doubt() -> None:
    """Four in five as reported, none of them by an error of the model at last."""
    nu = np.random.default_rng(12).normal(size=40)
    assert not fitted(nu[:9]).is_explained
    assert fitted(nu[:12]).is_explained
    assert not fitted(nu[:12]).after(0.3, in_error=True).is_explained
    assert not fitted(np.ones(20)).is_explained
    rejected = fitted(nu[:20])
    for _ in range(6):
        assert rejected.is_explained == (0.8 * len(rejected.as_reported) <= 20)
        rejected = rejected.after(None, as_reported=False)
    assert not rejected.is_explained


def test_parameters_are_estimated_before_the_warning() -> None:
    """Six events in a row with an error, weakly correlated innovations, many excuses."""
    nu = np.random.default_rng(13).normal(size=20)
    assert not fitted(nu).is_doubted
    assert fitted(nu[:6], in_error=True).is_doubted
    assert not fitted(nu[:6], in_error=True).is_misfit
    excused = fitted(nu[:12])
    for _ in range(7):
        excused = excused.after(None, as_reported=False)
    assert excused.is_doubted
    assert not excused.is_misfit


def test_innovations_that_considered_parameters_explain_are_no_evidence() -> None:
    """Of one sign and up to three of their deviations; larger ones and white parts still are."""
    same = [1.5 + 0.1 * (-1) ** k for k in range(40)]
    fits = {}
    for considered in (0.0, 0.05, 0.8):
        fit = Fit()
        for each in same:
            fit = fit.after(each, in_error=True, exact=1e-9, considered=considered)
        fits[considered] = fit.is_misfit, fit.is_in_error
    assert fits == {0.0: (True, True), 0.05: (True, True), 0.8: (False, False)}
    fit = Fit()
    for each in same:
        fit = fit.after(3.0 * each, considered=0.8)
    assert fit.is_misfit
