# SPDX-License-Identifier: Apache-2.0
"""Parameters from impacts and samples together: against the plant itself, and honest errors."""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize
from systems import EPOCH, run, sample

from impact_observer.errors import IdentificationError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.identify import sensor_rows
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.identification import Identification, identify
from impact_observer.identify.recorded_impacts import Recording
from impact_observer.identify.sensor_rows import used_samples
from impact_observer.model import Model, System, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.measurement import Measurement
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.episode import last_episode
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import Run, SensorModel, simulate_sensor
from impact_observer.stamps import seconds_between

Array = NDArray[np.float64]
NOISE = 1e-3
ENCODER = Measurement("encoder", "/encoder", "x1", "position", deviation=NOISE)
FREE = ("restitution", "stiffness-scale", "gap")
RIG = """
name: rig
bodies: [{name: x1, mass: 1}, {name: x2, mass: 2}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 20, damping: 0.2}
forces: [{body: x2, amplitude: 4, frequency: 2.5}]
stops:
  - {name: above, body: x2, limit: 0.2, side: above, restitution: 0.7}
  - {name: between, between: [x1, x2], gap: 0.3, restitution: 0.5}
initial_state: {position: [0.1, -0.2], velocity: [0.5, 0]}
"""


@lru_cache
def recorded(name: str, seconds: float = 12.0, rate: float = 50.0) -> Run:
    """A run of a sample model, with states at the stamps of an encoder."""
    model = parse_model(RIG, name) if name == "rig" else sample(name)
    return run(model.system, *model.initial_state(), seconds=seconds, rate=rate)


def sensed(
    name: str, seed: int, seconds: float = 12.0, rate: float = 50.0
) -> tuple[list[ImpactEvent], list[SensorSample]]:
    """Impacts that jitter by 1 ms, and the encoder on the first coordinate."""
    made, rng = recorded(name, seconds, rate), np.random.default_rng(seed)
    sensor, last = SensorModel(jitter=1e-3), int(made.stamps[-1])
    system = parse_model(RIG, name).system if name == "rig" else sample(name).system
    given = simulate_sensor(sensor, system, made.switchings, epoch=EPOCH, last=last, seed=seed)
    values = made.states[:, 0] + NOISE * rng.normal(size=made.stamps.size)
    pairs = zip(made.stamps.tolist(), values.tolist(), strict=True)
    events = sorted((each.event for each in given), key=lambda each: each.stamp)
    return events, [SensorSample(0, stamp, value) for stamp, value in pairs]


def wrong(model: System) -> System:
    """Restitutions off by 0.05, stiffness by 3 % and gaps by 2 %."""
    stops = (
        replace(each, gap=1.02 * each.gap, restitution=each.restitution + 0.05)
        for each in model.contacts
    )
    return replace(model, K=1.03 * model.K, contacts=tuple(stops))


def fitted(seed: int, sensor: Measurement = ENCODER, clock: float | None = 1e-3) -> Identification:
    """A wrong two_mass, identified."""
    events, samples = sensed("two_mass", seed)
    family = parametric_family(wrong(sample("two_mass").system), FREE)
    found = {"measurements": [sensor], "samples": samples}
    return identify(family, events, clock=clock, trust_events=True, **found)  # type: ignore[arg-type]


def of_the_plant(
    model: Model, family: ParametricFamily, y: Array, seconds: float, kept: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Instants of impacts, s, and positions of the first coordinate, of the plant itself."""
    n = model.system.n
    made = run(family.system_at(y[2 * n :]), y[:n], y[n : 2 * n], seconds=seconds, rate=50.0)
    instants = [-each.instant.until(EPOCH) for each in made.impacts]
    return np.array(instants), made.states[kept, 0]


@pytest.mark.slow
def test_the_fit_is_the_most_likely_motion_of_the_plant() -> None:
    """Least squares over simulated plants, whose impacts are where they are: values and errors."""
    seconds, model = 6.0, sample("two_mass")
    events, samples = sensed("two_mass", 3, seconds)
    family = parametric_family(model.system, ("restitution", "stiffness-scale"))
    stamps = np.array([seconds_between(EPOCH, each.stamp) for each in events])
    t = np.array([seconds_between(EPOCH, each.stamp) for each in samples])
    kept = (np.min(np.abs(t[:, None] - stamps), axis=1) > 0.01) & (t < stamps[-1])
    kept &= t > 0
    chosen = [each for each, one in zip(samples, kept.tolist(), strict=True) if one]
    found = identify(
        family, events, clock=1e-3, trust_events=True, measurements=[ENCODER], samples=chosen
    )
    values = np.array([each.value for each in chosen])

    def residuals(y: Array) -> Array:
        instants, positions = of_the_plant(model, family, y, seconds, kept)
        shifts = instants[: stamps.size] - stamps
        return np.concatenate([shifts / 1e-3, (positions - values) / NOISE])

    begin = np.concatenate([*model.initial_state(), family.nominal])
    best = optimize.least_squares(residuals, begin, jac="3-point", x_scale=np.full(6, 1e-2))
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    deviations = np.sqrt(np.diag(covariance))
    found_y = np.concatenate([found.start, found.values])
    assert np.max(np.abs(found_y - best.x) / deviations) < 0.02
    np.testing.assert_allclose(found.covariance, covariance, atol=0.02 * np.max(covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), deviations, rtol=0.02)


def test_samples_determine_what_impacts_cannot() -> None:
    """A floor may be lower, by its impacts alone; a range to the ground says how high it is."""
    model = sample("bouncing_ball")
    made = run(model.system, *model.initial_state(), seconds=4.0, rate=50.0)
    guess = replace(model.system.contacts[0], restitution=0.85, gap=0.02)
    family = parametric_family(replace(model.system, contacts=(guess,)), ["restitution", "gap"])
    with pytest.raises(IdentificationError, match="gap"):
        identify(family, list(made.events))
    (name,), rng = model.system.coordinates, np.random.default_rng(2)
    height = made.states[:, 0] + NOISE * rng.normal(size=made.stamps.size)
    samples = [
        SensorSample(0, *pair) for pair in zip(made.stamps.tolist(), height.tolist(), strict=True)
    ]
    laser = Measurement("laser", "/range", field="range", position=((name, 1.0),), deviation=NOISE)
    found = identify(family, list(made.events), clock=1e-6, measurements=[laser], samples=samples)
    assert not found.undetermined
    truth = [model.system.contacts[0].restitution, model.system.contacts[0].gap]
    assert np.all(np.abs(found.values - truth) < 4 * found.errors)
    assert np.all(found.errors < [1e-5, 1e-3])


@pytest.mark.parametrize(
    "sensor",
    [
        ENCODER,
        Measurement("gap", "/gap", field="data", gap="between", deviation=1e-3),
        Measurement(
            "speed", "/speed", field="data", velocity=(("x1", 2.0), ("x2", -1.0)), deviation=0.1
        ),
        Measurement(
            "imu", "/imu", field="x", acceleration=(("x1", 2.0), ("x2", -1.0)), deviation=0.1
        ),
    ],
    ids=lambda each: each.name,
)
def test_rows_are_the_derivatives_of_what_is_expected(
    sensor: Measurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Differences by initial state, parameters and instants; triangulated rows lose nothing."""
    model = parse_model(RIG, "rig")
    free = ("restitution.above", "mass.x2", "gap.between", "forcing-amplitude", "clock-offset")
    family = parametric_family(model.system, free, model.elements)
    events, samples = sensed("rig", 0, 3.0, 40.0)
    episode = last_episode(family.system, events)
    within = episode.start, episode.keys[-1].stamp
    sensors = used_samples(family, [sensor], samples, episode.epoch, within)
    problem = Recording(episode, sensors=sensors, clock=1e-3).problem(family)
    y, t = np.concatenate([*model.initial_state(), family.nominal]), problem.stamps
    (short,) = problem.shot(y, t).sensors
    assert short.residual.size <= y.size + t.size
    monkeypatch.setattr(sensor_rows, "_triangular", lambda table: (table, 0.0))
    (rows,) = problem.shot(y, t).sensors
    assert rows.residual.size == rows.errors.size > 50
    assert short.squares == pytest.approx(rows.squares, rel=1e-12)
    exact = np.hstack([rows.by_start, rows.by_instant])
    rng = np.random.default_rng(4)
    for direction in rng.normal(size=(3, y.size + t.size)):
        more, less = (
            problem.shot(*np.split(np.concatenate([y, t]) + d, [y.size])).sensors[0].residual
            for d in (1e-6 * direction, -1e-6 * direction)
        )
        change = exact @ direction
        np.testing.assert_allclose(
            (less - more) / 2e-6, change, atol=1e-7 * np.max(np.abs(change)) * direction.size
        )


@pytest.mark.slow
def test_wrong_samples_are_rejected() -> None:
    """One in a hundred is wrong by 0.3 m; the error of the clock is not declared."""
    events, samples = sensed("two_mass", 5)
    spoilt = [s._replace(value=s.value + 0.3 * (i % 100 == 7)) for i, s in enumerate(samples)]
    family = parametric_family(sample("two_mass").system, ["restitution"])
    fit = partial(identify, family, events, clock=None, trust_events=True)
    found = fit(measurements=[replace(ENCODER, gate=20.0)], samples=spoilt)
    (sensor,) = found.sensors
    assert sensor.rejected == sum(i % 100 == 7 for i in range(samples_used(found, samples)))
    assert sensor.rms == pytest.approx(NOISE, rel=0.1)
    assert abs(found.values[0] - 0.7) < 4 * found.errors[0]
    assert sensor.fits


def samples_used(found: Identification, samples: list[SensorSample]) -> int:
    """How many there are up to the last impact."""
    last = found.recording.episode.keys[-1].stamp
    return sum(each.stamp <= last for each in samples)


@pytest.mark.slow
def test_a_wrong_model_shows_in_the_samples() -> None:
    """Their errors are larger than declared, and alike: standard errors are widened."""
    events, samples = sensed("two_mass", 1)
    stiff = replace(sample("two_mass").system, K=1.01 * sample("two_mass").system.K)
    family = parametric_family(stiff, ["restitution"])
    found = identify(
        family, events, clock=1e-3, trust_events=True, measurements=[ENCODER], samples=samples
    )
    assert check_fit(found).odd == ("encoder",)
    assert not check_fit(found).fits
    assert found.widened > 2


@pytest.mark.long
def test_standard_errors_with_samples_are_honest_and_smaller() -> None:
    """The squares of 18 normalised errors; impacts alone leave errors twenty times as large."""
    model = sample("two_mass").system
    truth = np.array([model.contacts[0].restitution, model.contacts[0].gap, 1 / 1.03])
    weight, freedom = 0.0, 0
    for seed in range(6):
        found = fitted(seed)
        order = [found.family.names.index(name) for name in ("restitution.stop", "gap.stop")]
        order.append(found.family.names.index("stiffness-scale"))
        error = found.values[order] - truth
        own = found.covariance[found.start.size :, found.start.size :][np.ix_(order, order)]
        weight += float(error @ np.linalg.solve(own, error))
        freedom += error.size
    assert abs(weight / freedom - 1) < 4 * np.sqrt(2 / freedom)
    events, _ = sensed("two_mass", 0)
    alone = identify(parametric_family(wrong(model), FREE), events, clock=1e-3, trust_events=True)
    assert np.all(fitted(0).errors < alone.errors / 20)


def test_sensors_and_parameters_that_do_not_fit_are_named() -> None:
    """One line: an exact sensor."""
    events, samples = sensed("two_mass", 0)
    family = parametric_family(sample("two_mass").system, ["restitution"])
    fit = partial(identify, events=events, samples=samples)
    with pytest.raises(UsageError, match="deviation"):
        fit(family, measurements=[replace(ENCODER, deviation=0.0)])
