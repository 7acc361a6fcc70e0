# SPDX-License-Identifier: Apache-2.0
"""Plants that differ from the model in what is not free: the fit says so and names the cause."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from systems import Harmonic, event, forcing, run, sample, system

from impact_observer.events import ImpactEvent
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.fit_report import print_check, print_parameters
from impact_observer.identify.identification import Identification, identify
from impact_observer.model import System
from impact_observer.model.free_parameters import parameters_beside, parametric_family
from impact_observer.plant import Run, SensorModel, simulate_sensor
from impact_observer.stamps import from_seconds

SHAKER = system(
    1.0,
    0.4,
    40.0,
    contacts=[([-1.0], 0.2, 0.6)],
    force=forcing(1, 0.0, [Harmonic(5.1, [5.0], [0.0]), Harmonic(3.3, [3.0], [0.0])]),
)
STEP = from_seconds(5e-3)


@lru_cache
def shaken() -> Run:
    """A minute of a mass that hits a stop."""
    return run(SHAKER, [0.1], [0.5], seconds=60.0, rate=1.0)


def late_by(delays: list[int]) -> list[ImpactEvent]:
    """The impacts of the shaker, stamped so many nanoseconds late."""
    rows = zip(shaken().events, delays, strict=True)
    return [replace(each, stamp=each.stamp + delay) for each, delay in rows]


def late_by_strength() -> list[ImpactEvent]:
    """A sensor that notices an impact later, the softer the impact is: 5 ms at 1 m/s."""
    speeds = [float(each.before[1]) for each in shaken().switchings]
    return late_by([from_seconds(5e-3 / max(abs(speed), 0.02)) for speed in speeds])


def fitted(
    model: System, events: list[ImpactEvent], clock: float | None, free: str = "restitution"
) -> Identification:
    """The fit of one parameter; the published value is the model's own."""
    return identify(parametric_family(model, [free]), events, clock=clock)


def says_no(found: Identification) -> bool:
    """Whether a fit does not fit, and its errors contain the truth within 3."""
    error = np.abs(found.values - found.family.nominal) / found.errors
    return not check_fit(found).fits and found.widened > 1.0 and bool(np.all(error < 3))


@pytest.mark.slow
@pytest.mark.parametrize("clock", [pytest.param(1e-3, marks=pytest.mark.long), None])
def test_a_force_that_is_larger_than_the_models_is_named(clock: float | None) -> None:
    """By a tenth. Freed, it explains stamps to their rounding."""
    model = sample("two_mass")
    force = model.system.forcing
    plant = replace(
        model.system, forcing=replace(force, cosine=1.1 * force.cosine, sine=1.1 * force.sine)
    )
    made = run(plant, *model.initial_state(), seconds=60.0, rate=1.0)
    found = fitted(model.system, list(made.events), clock)
    assert says_no(found)
    named = {each.name: each for each in found.others if each.fits}
    assert named["forcing-amplitude.1"].value == pytest.approx(1.1, rel=1e-6)
    assert named["forcing-amplitude.1"].rms < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("clock", [1e-3, None])
def test_a_latency_is_named(clock: float | None) -> None:
    """All stamps are 4 ms late."""
    found = fitted(SHAKER, late_by([from_seconds(4e-3)] * len(shaken().events)), clock)
    assert says_no(found)
    first = found.others[0]
    assert (first.name, first.fits) == ("clock-offset", True)
    assert first.value == pytest.approx(4e-3, rel=1e-6)


def test_what_to_do_with_a_clock_offset_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    """A model file has no offset of a clock: stamps are 4 ms late."""
    late = late_by([from_seconds(4e-3)] * len(shaken().events))
    found = fitted(SHAKER, late, None, "clock-offset")
    print_parameters(found, check_fit(found))
    out = " ".join(capsys.readouterr().out.split())
    assert "`detect --latency 0.004` takes the offset from the stamps" in out
    assert "`observe --clock-offset-error 0.004` estimates the offset" in out


@pytest.mark.slow
@pytest.mark.parametrize("clock", [1e-3, None])
def test_stamps_of_the_next_five_milliseconds_do_not_fit(clock: float | None) -> None:
    """They are 2.5 ms late on average."""
    found = fitted(SHAKER, late_by([-each.stamp % STEP for each in shaken().events]), clock)
    assert says_no(found)
    offset = next(each for each in found.others if each.name == "clock-offset")
    assert offset.fits
    assert offset.value == pytest.approx(2.5e-3, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("clock", [1e-3, None])
def test_stamps_that_are_late_by_strength_do_not_fit(clock: float | None) -> None:
    """No parameter of the model is the cause."""
    assert says_no(fitted(SHAKER, late_by_strength(), clock))


@pytest.mark.parametrize(
    ("faults", "clock"),
    [
        ({}, None),
        ({}, 1e-4),
        ({"jitter": 1e-3}, 1e-3),
        ({"jitter": 5e-4}, None),
        pytest.param({"jitter": 1e-3, "missed": 0.2}, 1e-3, marks=pytest.mark.slow),
        pytest.param({"jitter": 1e-3, "spurious": 0.04}, 1e-3, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_right_model_fits(faults: dict[str, float], clock: float | None, seed: int) -> None:
    """Whatever the sensor does that was declared, or that is found to be an outlier."""
    model, made = sample("two_mass"), two_mass()
    sensor = SensorModel(**faults)  # type: ignore[arg-type]
    last = int(made.stamps[-1])
    messages = simulate_sensor(
        sensor, model.system, made.switchings, epoch=made.epoch, last=last, seed=seed
    )
    events = sorted((each.event for each in messages), key=lambda each: each.stamp)
    found = fitted(model.system, events, clock)
    assert found.converged
    assert check_fit(found).fits
    assert found.others == ()
    assert np.all(np.abs(found.values - found.family.nominal) < 4 * found.errors)


@pytest.mark.parametrize(("clock", "fits"), [(None, False), (3e-3, True)])
def test_shifts_of_milliseconds_fit_only_a_clock_that_is_declared(
    clock: float | None, fits: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A jitter of 3 ms is nine million times the rounding; the report says what to do."""
    rng = np.random.default_rng(0)
    late = rng.normal(0.0, 3e-3, len(shaken().events))
    found = fitted(SHAKER, late_by([from_seconds(each) for each in late]), clock)
    assert found.converged
    assert check_fit(found).fits == fits
    print_parameters(found, check_fit(found))
    first = capsys.readouterr().out.splitlines()[0]
    assert ("If the sensor jitters so much, declare --clock-error 0.00" in first) != fits


@lru_cache
def two_mass() -> Run:
    """A minute of the sample model."""
    model = sample("two_mass")
    return run(model.system, *model.initial_state(), seconds=60.0, rate=1.0)


def test_what_cannot_stand_beside_the_free_parameters_is_not_tried() -> None:
    """Parameters that are free already, and a contact time of 0."""
    model = sample("two_mass").system
    family = parametric_family(model, ["restitution", "gap"])
    names = {each.name for each in parameters_beside(family)}
    assert names == {
        "stiffness-scale",
        "damping-scale",
        "mass-scale",
        "forcing-amplitude.1",
        "forcing-phase.1",
        "forcing-frequency.1",
        "constant-force.x1",
        "constant-force.x2",
        "clock-offset",
    }


@pytest.mark.slow
def test_hits_that_no_motion_explains_end_the_search(capsys: pytest.CaptureFixture[str]) -> None:
    """A ball on a bat that a hand moves; the 64 took 2600 trial motions without a bound.

    Of many hits the first are searched, and the report says so.
    """
    ball = system(0.0027, 0.0, 0.0, contacts=[([1.0], 0.0, 0.85)], force=forcing(1, -0.0265))
    instants = 2.0 + np.cumsum(np.random.default_rng(1).uniform(0.25, 0.6, 600))
    events = [event(instant, "c1") for instant in instants.tolist()]
    reports = list[str]()
    family = parametric_family(ball, ["restitution"])
    found = identify(family, events, clock=0.005, progress=reports.append)
    assert not found.converged
    assert not check_fit(found).fits
    assert len(reports) < 1500
    assert found.unsearched == 536
    assert found.shifts.size <= 64
    print_check(found, check_fit(found))
    said = " ".join(capsys.readouterr().out.split())
    assert "Only the first 64 impacts were searched. Of the 536 others" in said
