# SPDX-License-Identifier: Apache-2.0
"""Declared deviations are the prior of a fit."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from systems import EPOCH, run

from impact_observer.errors import IdentificationError
from impact_observer.events import ImpactEvent
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.fit_report import for_json, print_parameters
from impact_observer.identify.identification import Identification, identify
from impact_observer.model import Model, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.plant import SensorModel, simulate_sensor

RIG = """\
name: rig
bodies: [{{name: x1, mass: 1}}, {{name: x2, mass: 1}}]
springs:
  - {{between: [ground, x1], stiffness: {k}, damping: 0.1}}
  - {{between: [x1, x2], stiffness: {k}, damping: 0.1}}
forces: [{{body: x2, amplitude: {a}, frequency: 2.5}}]
stops: [{{name: stop, body: x2, limit: {g}, side: above, restitution: {e}}}]
initial_state: {{position: [0.1, -0.2], velocity: [0.5, 0]}}
"""
TRUE = RIG.format(k=10, a=4, g=0.5, e=0.7)
DRILL = """\
name: drill
bodies: [{{name: hammer, mass: 1.2}}, {{name: bit, mass: 0.8}}]
springs:
  - {{between: [ground, hammer], stiffness: {k1}, damping: 5}}
  - {{between: [ground, bit], stiffness: {k2}, damping: 20}}
forces: [{{body: hammer, amplitude: 60, frequency: 139.0469}}]
stops: [{{name: hit, between: [hammer, bit], gap: {g}, restitution: {e}}}]
initial_state: {{position: [0, 0], velocity: [0, 0]}}
"""


def declared(value: float, deviation: float) -> str:
    """A number of a model file with its deviation."""
    return f"{{value: {value}, deviation: {deviation}}}"


@cache
def recorded(text: str, seconds: float, jitter: float, seed: int = 1) -> tuple[ImpactEvent, ...]:
    """The events of a plant."""
    model = parse_model(text, "true")
    made = run(model.system, *model.initial_state(), seconds=seconds, rate=1.0)
    sensor, last = SensorModel(jitter=jitter), int(made.stamps[-1])
    messages = simulate_sensor(
        sensor, model.system, made.switchings, epoch=EPOCH, last=last, seed=seed
    )
    return tuple(sorted((each.event for each in messages), key=lambda each: each.stamp))


def fitted(
    model: Model,
    free: tuple[str, ...],
    events: tuple[ImpactEvent, ...],
    clock: float | None,
    *,
    has_prior: bool = True,
) -> Identification:
    """A fit with the deviations of the model as prior, or without."""
    family = parametric_family(model.system, free, model.elements)
    prior = model.uncertainty if has_prior else None
    return identify(family, [*events], clock=clock, prior=prior)


def test_a_prior_and_a_fit_combine_as_two_measurements_do() -> None:
    """The oracle is Bayes' rule for Gaussians, applied to the fit without a prior."""
    free = ("restitution", "gap", "stiffness-scale")
    text = RIG.format(k=10, a=4, g=declared(0.5005, 1e-3), e=declared(0.701, 5e-4))
    model, events = parse_model(text, "rig"), recorded(TRUE, 60.0, 1e-3)
    plain, found = (fitted(model, free, events, 1e-3, has_prior=has) for has in (False, True))
    k = plain.start.size
    information = np.linalg.inv(plain.covariance[k:, k:] / plain.widened**2)
    nominal = found.family.nominal
    weights = np.diag([1 / 5e-4**2, 1 / 1e-3**2, 0.0])
    covariance = np.linalg.inv(information + weights)
    expected = covariance @ (information @ plain.values + weights @ nominal)
    assert found.errors / found.widened == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.03)
    assert np.all(np.abs(found.values - expected) < 0.1 * np.sqrt(np.diag(covariance)))
    assert np.all(np.abs(found.values - plain.values)[:2] > 0.2 * found.errors[:2])


def test_a_prior_decides_what_impacts_leave_open() -> None:
    """Mass, stiffness, damping and force in proportion move no impact."""
    free = ("mass-scale", "stiffness-scale", "damping-scale", "forcing-amplitude")
    names, sure = [each.removesuffix(".1") for each in free], 0.02
    text = TRUE + "uncertainty: {names: [%s], covariance: %s}\n"
    every = ", ".join([*names[:3], "forcing-amplitude.1"])
    model = parse_model(text % (every, np.diag([sure**2] * 4).tolist()), "rig")
    events = recorded(TRUE, 30.0, 1e-4)
    with pytest.raises(IdentificationError, match="hold one of them fixed"):
        fitted(model, free, events, 1e-4, has_prior=False)
    found = fitted(model, free, events, 1e-4)
    assert found.converged
    assert not found.undetermined
    # four equal scales are known by four declared deviations, as a mean is
    common = np.ones(4) / 4 @ found.covariance[4:, 4:] @ np.ones(4) / 4
    assert np.sqrt(common) / found.widened == pytest.approx(sure / 2, rel=0.02)
    assert np.all(np.abs(found.values - 1) < 3 * found.errors)


@pytest.mark.slow
@pytest.mark.parametrize("clock", [1e-5, pytest.param(None, marks=pytest.mark.long)])
def test_a_periodic_motion_does_not_end_at_a_restitution_of_zero(clock: float | None) -> None:
    """The hits of a drill that settles on a period are few numbers for five unknowns."""
    free, jitter = ("gap", "stiffness", "restitution"), 1e-5
    truth = np.array([0.00162, 9250.0, 58100.0, 0.55])
    events = recorded(DRILL.format(g=truth[0], k1=truth[1], k2=truth[2], e=truth[3]), 7.0, jitter)
    text = DRILL.format(
        g=declared(0.0015, 0.0002),
        k1=declared(9000, 450),
        k2=declared(60000, 3000),
        e=declared(0.6, 0.1),
    )
    late = tuple(each for each in events if each.stamp - EPOCH > 4_000_000_000)
    assert len(late) > 100
    found = fitted(parse_model(text, "drill"), free, late, clock)
    assert check_fit(found).fits
    assert np.all(np.abs(found.values - truth) < 3 * found.errors)
    assert np.all(found.errors <= found.widened * np.array([0.0002, 450, 3000, 0.1]) * 1.001)


@pytest.mark.slow
def test_a_value_far_beyond_its_deviation_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    """A prior that impacts contradict is a guess, or the model is wrong."""
    text = RIG.format(k=10, a=4, g=0.5, e=declared(0.75, 0.001))
    found = fitted(parse_model(text, "rig"), ("restitution",), recorded(TRUE, 60.0, 1e-3), 1e-3)
    print_parameters(found, check_fit(found))
    out = " ".join(capsys.readouterr().out.split())
    assert abs(found.values[0] - 0.7) < 3 * found.errors[0]
    assert "The model fits without its declared deviations" in out
    assert "restitution.stop is" in out
    (shift,) = found.prior_shifts
    both = np.hypot(0.001, found.errors[0] / found.widened)
    assert shift.innovation == pytest.approx((found.values[0] - 0.75) / both)
    assert "deviations from its declared value" in out


def test_what_impacts_say_little_of_keeps_its_deviation(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The posterior is the prior there."""
    text = RIG.format(k=10, a=4, g=declared(0.5, 1e-5), e=declared(0.72, 0.1))
    found = fitted(
        parse_model(text, "rig"), ("restitution", "gap"), recorded(TRUE, 20.0, 1e-3), 1e-3
    )
    gap = found.family.names.index("gap.stop")
    assert found.errors[gap] == pytest.approx(1e-5 * found.widened, rel=0.05)
    print_parameters(found, check_fit(found))
    out = " ".join(capsys.readouterr().out.split())
    assert "say little of gap.stop." in out
    priors = for_json(found, check_fit(found))["priors"]
    assert isinstance(priors, dict)
    assert priors["restitution.stop"]["deviation"] == 0.1
    assert abs(priors["restitution.stop"]["innovation"]) < 3


def test_a_deviation_of_zero_is_no_prior_of_what_is_free() -> None:
    """Who frees a parameter doubts its value."""
    text = RIG.format(k=10, a=4, g=0.5, e=declared(0.75, 0))
    model, events = parse_model(text, "rig"), recorded(TRUE, 20.0, 1e-4)
    with_it, without = (
        fitted(model, ("restitution",), events, 1e-4, has_prior=has) for has in (True, False)
    )
    assert with_it.values.tolist() == without.values.tolist()
    assert with_it.prior_shifts == ()


def test_correlated_errors_of_the_model_count_as_such() -> None:
    """Of two amplitudes whose errors are opposite only the difference is unknown."""
    text = RIG.format(k=10, a=4.2, g=0.51, e=0.7)
    rho, s = -0.999, np.array([0.05, 0.02])
    model = parse_model(text, "rig")
    covariance = np.outer(s, s) * np.array([[1.0, rho], [rho, 1.0]])
    known = parse_model(
        text
        + "uncertainty: {names: [forcing-amplitude.1, gap.stop], covariance:"
        + f" {covariance.tolist()}}}\n",
        "rig",
    ).uncertainty
    assert known is not None
    family = parametric_family(model.system, ("forcing-amplitude", "gap"), model.elements)
    found = identify(family, [*recorded(TRUE, 20.0, 1e-3)], clock=1e-3, prior=known)
    diagonal = replace(known, covariance=np.diag(np.diag(known.covariance)))
    other = identify(family, [*recorded(TRUE, 20.0, 1e-3)], clock=1e-3, prior=diagonal)
    own = (found.values - family.nominal) / s
    assert abs(own.sum()) < 3 * np.sqrt(2 * (1 + rho))
    assert found.errors[0] < other.errors[0]


@pytest.mark.slow
def test_errors_of_short_recordings_are_those_that_the_posterior_says() -> None:
    """The true numbers are drawn from the prior, of which few impacts tell little."""
    rng, names = np.random.default_rng(7), ("e", "g", "a")
    given, deviations = np.array([0.7, 0.5, 4.0]), np.array([0.08, 0.02, 0.4])
    numbers = [declared(*each) for each in zip(given, deviations, strict=True)]
    model = parse_model(RIG.format(k=10, **dict(zip(names, numbers, strict=True))), "rig")
    squares = []
    for seed, seconds in enumerate((9.0, 11.0, 14.0) * 8):
        true = given + deviations * rng.standard_normal(3)
        plant = RIG.format(k=10, **dict(zip(names, true, strict=True)))
        events = recorded(plant, seconds, 1e-3, seed)
        found = fitted(model, ("restitution", "gap", "forcing-amplitude"), events, 1e-3)
        assert found.converged
        error = found.values - true / [1.0, 1.0, given[2]]
        own = found.covariance[found.start.size :, found.start.size :]
        squares.append(error @ np.linalg.solve(own, error) / 3)
    assert 0.6 < np.mean(squares) < 1.5
