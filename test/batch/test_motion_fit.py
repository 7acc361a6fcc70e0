# SPDX-License-Identifier: Apache-2.0
"""Parameters, states and sizes of noises from simulated recordings."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import sample

from impact_observer.batch.identification import Identification, identify
from impact_observer.batch.linearised_motion import linearised
from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.batch.smoothing import smoothed_runs
from impact_observer.dynamics.tangent import Tangent
from impact_observer.events import ImpactEvent
from impact_observer.model import Model
from impact_observer.model.contact_sensors import NO_SENSORS, ContactErrors, ContactSensor
from impact_observer.model.free_parameters import parametric_family
from impact_observer.observer import Options
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S

EPOCH = 5 * NS_PER_S
EXACT = ContactErrors.of(NO_SENSORS, ("stop",), 0.0)
FREE = ("restitution", "gap", "stiffness-scale")
WRONG = {
    "two_mass": {"restitution.stop": 0.66, "stiffness-scale": 1.05},
    "three_mass": {"restitution.left": 0.7, "stiffness-scale": 1.05},
}
"""Parameters of the plants that are not those of the models."""


def recorded(
    name: str, seconds: float, jitter: float, seed: int, **change: float
) -> tuple[Model, list[ImpactEvent], NDArray[np.float64]]:
    """Return a model, events of a plant with changed parameters, and its states each 20 ms."""
    model, rng = sample(name), np.random.default_rng(seed)
    family = parametric_family(model.system, tuple(change), model.elements)
    plant = Plant(
        family.system_at(np.array(list(change.values()))), *model.initial_state(), epoch=EPOCH
    )
    run = simulate(plant, np.arange(EPOCH, EPOCH + round(seconds * NS_PER_S), NS_PER_S // 50))
    moved = [round(each * jitter * NS_PER_S) for each in rng.normal(size=len(run.events))]
    events = [replace(e, stamp=e.stamp + by) for e, by in zip(run.events, moved, strict=True)]
    return model, sorted(events, key=lambda e: e.stamp), run.states


def identified(
    name: str, jitter: float, seed: int, free: tuple[str, ...] = FREE, seconds: float = 60.0
) -> Identification:
    """Identify parameters from a recording of a plant that is not the model."""
    model, events, _ = recorded(name, seconds, jitter, seed, **WRONG[name])
    return identify(parametric_family(model.system, free, model.elements), events)


def relative_errors(name: str, found: Identification) -> NDArray[np.float64]:
    """Return errors of the values over their standard errors."""
    pairs = zip(found.family.names, found.family.nominal.tolist(), strict=True)
    true = np.array([WRONG[name].get(each, value) for each, value in pairs])
    return np.asarray((found.values - true) / found.errors)


@pytest.mark.parametrize(
    ("jitter", "draws"),
    [(1e-5, 3), *(pytest.param(j, 20, marks=pytest.mark.long) for j in (1e-5, 1e-4, 1e-3))],
)
@pytest.mark.parametrize("name", WRONG)
def test_errors_of_parameters_are_as_large_as_their_standard_errors(
    name: str, jitter: float, draws: int
) -> None:
    """From a start of which nothing is known; the clock's error is not declared."""
    every = [identified(name, jitter, seed) for seed in range(draws)]
    assert all(each.verdict.fits for each in every)
    ratios = np.array([relative_errors(name, each) for each in every])
    limits = (0.7, 1.45) if draws > 3 else (0.2, 2.5)
    assert limits[0] < np.sqrt(np.mean(ratios**2)) < limits[1]
    assert np.median([each.verdict.clock for each in every]) == pytest.approx(jitter, rel=0.5)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_false_and_missing_events_do_not_spoil_parameters(seed: int) -> None:
    """One event of ten is missing, and as many are invented."""
    model, events, _ = recorded("two_mass", 60.0, 1e-5, seed, **WRONG["two_mass"])
    rng = np.random.default_rng(100 + seed)
    kept = [each for each in events if rng.random() > 0.1]
    for stamp in rng.integers(events[0].stamp, events[-1].stamp, size=4).tolist():
        kept.append(replace(kept[0], stamp=stamp))
    kept = sorted(kept, key=lambda each: each.stamp)
    kept = [replace(each, sequence=k) for k, each in enumerate(kept, start=1)]
    found = identify(parametric_family(model.system, FREE, model.elements), kept)
    assert found.verdict.fits
    assert np.all(np.abs(found.values - [0.66, 0.5, 1.05]) < 1e-4)


def test_a_wrong_number_that_is_not_free_is_named_and_covered() -> None:
    """The stiffness is 5 % off: the verdict names a misfit, its size and the cause."""
    found = identified("two_mass", 1e-5, 0, ("restitution",), 30.0)
    assert not found.verdict.fits
    assert found.verdict.model > 1e-3
    (cause,) = [each for each in found.causes if each.fits]
    assert cause.name == "stiffness-scale"
    assert cause.value == pytest.approx(1.05, abs=1e-4)
    assert abs(found.values[0] - 0.66) < 3 * found.errors[0]


def test_an_unknown_phase_of_the_drive_is_found() -> None:
    """Whatever it is: searches begin all around."""
    phase = -2.5
    change = {"forcing-phase.1": phase}
    model, events, _ = recorded("two_mass", 30.0, 1e-5, 3, **change)
    family = parametric_family(model.system, ("forcing-phase",), model.elements)
    found = identify(family, events)
    assert found.verdict.fits
    assert abs(np.remainder(found.values[0] - phase + np.pi, 2 * np.pi) - np.pi) < 1e-3


def test_smoothed_states_are_within_their_deviations() -> None:
    """Jitter of 0.1 ms is declared; squared errors over variances are about 1 in the mean."""
    nees = []
    for seed in range(6):
        model, events, states = recorded("two_mass", 20.0, 1e-4, seed)
        options = Options(clock_error=1e-4, epoch=EPOCH)
        (run,) = smoothed_runs(model.system, events, options)
        assert not run.misfit
        stamps = np.arange(EPOCH, EPOCH + 20 * NS_PER_S, NS_PER_S // 50)
        for k, each in enumerate(run.estimates(stamps[3:-200:40])):
            error = np.append(each.first.q, each.first.u) - states[3 + 40 * k]
            covariance = np.asarray(each.first.covariance)
            nees.append(error @ np.linalg.pinv(covariance, rcond=1e-9) @ error / 4)
    assert 0.4 < np.mean(nees) < 2.0


def test_a_jump_has_the_derivatives_of_differences() -> None:
    """At its own instant, by the state before and by parameters; saltation included."""
    model, events, _ = recorded("two_mass", 20.0, 1e-3, 0)
    family = parametric_family(model.system, FREE, model.elements)
    moments = RecordedRun.of(model.system, events).reported()
    (run,) = smoothed_runs(model.system, events, Options(clock_error=1e-3, epoch=EPOCH))
    x, step = run.fit.states[0], 1e-6
    own = linearised(Tangent(family), moments, x, EXACT)
    for i, one in enumerate(np.eye(4)):
        more, less = (
            linearised(Tangent(family), moments, x + s * step * one, EXACT) for s in (1, -1)
        )
        slope = (more.after - less.after) / (2 * step)
        np.testing.assert_allclose(own.jump[1:, :, i], slope[1:], atol=2e-6)
        late = (more.late - less.late) / (2 * step)
        np.testing.assert_allclose(own.late_by_x[:, i], late, atol=2e-6)
    for j, one in enumerate(np.eye(family.size)):
        more, less = (
            linearised(Tangent(family, family.nominal + s * step * one), moments, x, EXACT)
            for s in (1, -1)
        )
        slope = (more.after - less.after) / (2 * step)
        np.testing.assert_allclose(own.jump_by_theta[1:, :, j], slope[1:], atol=2e-6)


@pytest.mark.parametrize("is_scattered", [False, True])
def test_own_instants_stay_near_their_stamps_wherever_a_search_is(*, is_scattered: bool) -> None:
    """States are off by some times the motion: the gaps have roots far away, or none."""
    model, events, _ = recorded("two_mass", 20.0, 1e-3, 0)
    moments = RecordedRun.of(model.system, events).reported()
    tangent = Tangent(parametric_family(model.system, FREE, model.elements))
    x = np.random.default_rng(7).normal(scale=5.0, size=(moments.count + 1, 4))
    for some in (x, 1e-4 * x):
        own = linearised(tangent, moments, some, EXACT, is_scattered=is_scattered)
        assert np.all(np.isfinite(own.after))
        assert np.all(np.abs(own.own_late) <= moments.flights)


def test_each_contact_has_a_clock_of_its_own() -> None:
    """Of one stamps jitter by 0.01 ms and are 2 ms late, of the other by 0.3 and 0.5 ms."""
    model, events, _ = recorded("three_mass", 60.0, 0.0, 1)
    jitter, late = {"left": 1e-5, "right": 3e-4}, {"left": 0.002, "right": 0.0005}
    rng, moved = np.random.default_rng(1), list[ImpactEvent]()
    for each in events:
        name = each.switches[0].contact
        by = late[name] + jitter[name] * rng.normal()
        moved.append(replace(each, stamp=each.stamp + round(by * NS_PER_S)))
    moved = [
        replace(each, sequence=k)
        for k, each in enumerate(sorted(moved, key=lambda each: each.stamp), start=1)
    ]
    sensors = {name: ContactSensor(each) for name, each in jitter.items()}
    family = parametric_family(model.system, ("restitution", "latency"), model.elements)
    found = identify(family, moved, sensors=sensors)
    assert found.verdict.fits
    true = np.array([0.6, 0.8, late["right"], late["left"]])
    assert family.names == (
        "restitution.right",
        "restitution.left",
        "latency.right",
        "latency.left",
    )
    assert np.all(np.abs(found.values - true) < 3.5 * found.errors)
    assert found.errors[3] < 3e-5 < found.errors[2]


def test_a_model_that_does_not_fit_is_published_with_twice_its_error() -> None:
    """Errors of models persist from flight to flight; of a model that fits nothing is added."""
    wrong = identified("two_mass", 1e-5, 0, ("restitution",), 30.0).found.fit
    assert wrong.published(fits=False).sizes.model >= 2 * wrong.sizes.model > 0
    right = identified("two_mass", 1e-5, 0, seconds=30.0).found.fit
    assert right.published(fits=True) is right
