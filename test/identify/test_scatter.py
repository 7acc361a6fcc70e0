# SPDX-License-Identifier: Apache-2.0
"""Fits in which a restitution scatters from hit to hit."""

from dataclasses import replace

import numpy as np
import pytest
from drills import DRILL, GAP, RESTITUTION, STIFFNESSES, Drill, events
from scipy import linalg, stats
from systems import EPOCH, run

from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.fit_report import for_json, print_parameters
from impact_observer.identify.identification import Identification, identify
from impact_observer.identify.scatter import (
    innovations,
    log_determinant,
    shown_deviations,
    without_unknowns,
)
from impact_observer.identify.shooting import shoot
from impact_observer.model import Model, parse_model, read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.trajectory.linearised_system import FlightEnd

SCATTER, CLOCK = 0.02, 5e-5
FREE = ["restitution", "gap", "stiffness"]
TRUTH = [RESTITUTION, GAP, *STIFFNESSES.tolist()]


def declared() -> Model:
    """The drill with the numbers of the scale and the calliper right, and no deviations."""
    text = DRILL
    for given, right in [
        ("{value: 1.2, deviation: 0.012}", "1.207"),
        ("{value: 0.8, deviation: 0.008}", "0.795"),
        ("{value: 5, deviation: 3}", "5"),
        ("{value: 20, deviation: 15}", "24"),
        ("{value: 9000, deviation: 450}", "9000"),
        ("{value: 60000, deviation: 3000}", "60000"),
        ("{value: 0.0015, deviation: 0.0002}", "0.0015"),
        ("{value: 0.6, deviation: 0.1}", "0.6"),
        ("phase: -1.570796}", "phase: -1.5707963267948966}"),
    ]:
        assert given in text
        text = text.replace(given, right)
    return parse_model(text, "drill")


def fitted(scatter: float, seed: int, *, clock: float = CLOCK) -> Identification:
    """The fit of gap, restitution and stiffnesses to 1.5 s of a drill, with the model's prior."""
    hits = [replace(e, epoch=EPOCH) for e in events(Drill(scatter).recorded(1.5, seed), clock)]
    model, prior = declared(), parse_model(DRILL, "drill").uncertainty
    family = parametric_family(model.system, FREE, elements=model.elements)
    return identify(family, hits, clock=clock, prior=prior)


@pytest.mark.long
def test_a_restitution_that_scatters_is_found_with_honest_errors() -> None:
    """Draws of the scatter and the clock; 0.02 is the scatter of the restitution."""
    normalised, found = [], []
    for seed in range(1, 6):
        fit = fitted(SCATTER, seed, clock=1e-5)
        assert fit.scatter > 0
        assert check_fit(fit).fits
        assert fit.widened == 1.0
        z = (fit.values - TRUTH) / fit.errors
        normalised.append(z @ linalg.solve(fit.correlation, z) / z.size)
        found.append(for_json(fit, check_fit(fit))["restitution_scatter"])
    assert 0.4 < np.median(normalised) < 1.7  # chi-square of four: 0.84
    scatters = np.array([each["hit"] for each in found])  # type: ignore[index]
    # 67 hits tell a deviation to 9 %
    assert np.all(np.abs(scatters / SCATTER - 1) < 0.35)


@pytest.mark.slow
def test_a_scatter_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    """With its size at the contact; all values are as near the truth as their errors say."""
    fit = fitted(SCATTER, 3)
    assert check_fit(fit).fits
    assert np.all(np.abs(fit.values - TRUTH) < 3 * fit.errors)
    print_parameters(fit, check_fit(fit))
    printed = " ".join(capsys.readouterr().out.split())
    assert "a restitution that scatters from hit to hit, by 0.02" in printed


def test_errors_of_the_clock_alone_are_no_scatter() -> None:
    """The restitution is the same at all hits."""
    fit = fitted(0.0, 5)
    assert fit.scatter == 0
    assert for_json(fit, check_fit(fit))["restitution_scatter"] == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("forcing-amplitude.1", 1.1),
        pytest.param("forcing-frequency.1", 2.501, marks=pytest.mark.long),
    ],
)
def test_a_wrong_number_of_the_model_is_no_scatter(name: str, wrong: float) -> None:
    """The model does not fit, and the wrong number is among those that are named."""
    true = read_model("two_mass").system
    model = parametric_family(true, [name]).system_at(np.array([wrong]))
    made = run(true, [0.1, 0.2], [0.0, 0.0], seconds=90.0)
    random = np.random.default_rng(1)
    hits = [
        replace(each, stamp=each.stamp + round(1e5 * random.standard_normal()), epoch=EPOCH)
        for each in made.events
    ]
    family = parametric_family(model, ["damping-scale"])
    fit = identify(family, hits, clock=1e-4, trust_events=True)
    assert len(hits) > 60
    assert fit.scatter == 0
    assert not check_fit(fit).fits
    named = {each.name for each in fit.others if each.fits}
    assert name in named


def recorded() -> tuple[list[FlightEnd], np.ndarray]:
    """The moments of twelve hits of the drill, and their instants, s."""
    t = np.array([t for t, _ in Drill(0.0).recorded(0.5, 1) if t > 0][:12])
    return [FlightEnd(at, (0,), (0,)) for at in t.tolist()], t


def test_derivatives_by_errors_of_impulses_are_those_of_finite_differences() -> None:
    """Those by initial state, parameters and instants, too, where impulses have errors."""
    moments, t = recorded()
    model = declared()
    family = parametric_family(model.system, FREE, elements=model.elements)
    start = np.concatenate([[-1e-3, 1e-4, 0.1, -0.05], family.nominal])
    eta = 0.01 * np.random.default_rng(2).standard_normal(t.size)

    def gaps(y: np.ndarray, t: np.ndarray, eta: np.ndarray) -> np.ndarray:
        return shoot(family, y, moments, t, 0.0, impulses=eta).gaps

    shot = shoot(family, start, moments, t, 0.0, impulses=eta)
    for table, args, step in [
        (shot.by_start, 0, 1e-6 * np.maximum(np.abs(start), 1e-3)),
        (shot.by_instant, 1, np.full(t.size, 1e-7)),
        (shot.by_impulse, 2, np.full(t.size, 1e-5)),
    ]:
        for k, size in enumerate(step.tolist()):
            at = [start, t, eta]
            ends = []
            for sign in (1, -1):
                moved = at[args].copy()
                moved[k] += sign * size
                ends.append(gaps(*(*at[:args], moved, *at[args + 1 :])))
            slope = (ends[0] - ends[1]) / (2 * size)
            scale = np.max(np.abs(table[:, k])) or 1.0
            assert np.max(np.abs(table[:, k] - slope)) < 1e-5 * scale


def test_an_impulse_without_error_is_that_of_the_impact_law() -> None:
    """States are the same, and without errors there are no derivatives by these."""
    moments, t = recorded()
    family = parametric_family(declared().system, ["gap"])
    start = np.concatenate([[-1e-3, 1e-4, 0.1, -0.05], family.nominal])
    plain = shoot(family, start, moments, t, 0.0)
    with_none = shoot(family, start, moments, t, 0.0, impulses=np.zeros(t.size))
    np.testing.assert_allclose(with_none.states, plain.states, rtol=1e-12, atol=1e-15)
    assert plain.by_impulse.shape == (t.size, 0)


def drawn(seed: int) -> tuple[np.ndarray, ...]:
    """``A``, ``B``, ``C`` and ``d`` with deviations 1e-4 and 0.03 of ``e`` and ``eta``."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((40, 5))
    B = np.tril(0.2 * random.standard_normal((40, 40))) + np.diag(-1 - random.random(40))
    C = 0.01 * np.tril(random.standard_normal((40, 40)), -1)
    e, eta = 1e-4 * random.standard_normal(40), 0.03 * random.standard_normal(40)
    return A, B, C, A @ random.standard_normal(5) + B @ e + C @ eta


def test_shown_deviations_maximise_the_likelihood_of_what_no_unknown_changes() -> None:
    """The likelihood of the left null space of ``A``, by scipy's normal density."""
    A, B, C, d = drawn(4)
    left = linalg.null_space(A.T).T

    def likelihood(clock: float, scatter: float) -> float:
        covariance = clock**2 * B @ B.T + scatter**2 * C @ C.T
        own = left @ covariance @ left.T
        return float(stats.multivariate_normal(cov=own, allow_singular=False).logpdf(left @ d))

    known = shown_deviations(A, B, C, d, clock=1e-4, least=None)
    assert known.clock == 1e-4
    best = likelihood(1e-4, known.scatter)
    assert all(best > likelihood(1e-4, known.scatter * each) for each in (0.97, 1.03))
    assert known.gain == pytest.approx(2 * (best - likelihood(1e-4, 0.0)), rel=1e-6)
    both = shown_deviations(A, B, C, d, clock=1e-4, least=1e-9)
    best = likelihood(both.clock, both.scatter)
    for clock, scatter in [(0.97, 1.0), (1.03, 1.0), (1.0, 0.97), (1.0, 1.03)]:
        assert best > likelihood(both.clock * clock, both.scatter * scatter)


def test_innovations_are_errors_of_the_clock_where_rows_are_triangular() -> None:
    """With errors of impulses, too, innovations of 4000 draws have a unit covariance."""
    _, B, C, _ = drawn(5)
    e = np.random.default_rng(6).standard_normal(40)
    np.testing.assert_allclose(np.abs(innovations(B, B @ e)), np.abs(e), rtol=1e-9)
    draws = np.random.default_rng(7).standard_normal((80, 4000))
    rows = np.hstack([B, 100 * C])
    found = innovations(rows, rows @ draws)
    covariance = found @ found.T / draws.shape[1]
    assert np.max(np.abs(covariance - np.eye(40))) < 0.1


def test_a_determinant_is_that_of_the_covariance_of_the_stamps() -> None:
    """Instants as functions of the errors of impulses have the derivatives ``B^-1 C``."""
    _, B, C, _ = drawn(8)
    J = linalg.inv(B) @ C
    expected = np.sum(np.log(linalg.eigvalsh(np.eye(40) + J @ J.T)))
    assert log_determinant(np.hstack([B, C]), 40) == pytest.approx(expected)


def test_rows_lose_the_unknowns_of_missed_impacts() -> None:
    """Unknowns of a row are eliminated, and the order of the other rows stays."""
    A, B, _, _ = drawn(9)
    rows = without_unknowns(A, B)
    kept = linalg.orth(linalg.null_space(A.T))
    assert rows.shape == (35, 40)
    np.testing.assert_allclose(linalg.subspace_angles(rows.T, (kept.T @ B).T), 0.0, atol=1e-6)
