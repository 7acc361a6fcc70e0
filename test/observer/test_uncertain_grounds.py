# SPDX-License-Identifier: Apache-2.0
"""Grounds whose motion is uncertain: learned on line, or considered; against the plant."""

from functools import cache

import numpy as np
import pytest
from systems import EPOCH, run

from impact_observer.model import Model, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.measurement import Measurement
from impact_observer.observer import make_observer, replay_batches
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.plant.simulation import Run
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimates

NUMBERS = {"amplitude": 0.1, "frequency": 5.0, "phase": 0.3}
WRONG = {"amplitude": 0.103, "frequency": 5.002, "phase": 0.35}
SECONDS, SETTLED = 12, 8


def shaken(**changed: object) -> Model:
    """Two bodies on a table, one of which strikes it and the other body."""
    motion = ", ".join(f"{name}: {value}" for name, value in (NUMBERS | changed).items())
    return parse_model(
        f"""\
name: shaken
bodies: [{{name: x, mass: 1}}, {{name: y, mass: 1}}]
grounds: [{{name: table, motion: {{harmonics: [{{{motion}}}]}}}}]
springs:
  - {{between: [table, x], stiffness: 40, damping: 0.3}}
  - {{between: [x, y], stiffness: 30, damping: 0.2}}
stops:
  - {{name: plate, between: [table, x], gap: 0.05, restitution: 0.7}}
  - {{name: top, between: [y, x], gap: 0.05, restitution: 0.6}}
initial_state: {{position: [0.1, 0.1], velocity: [0.1, 0.2]}}
""",
        "shaken",
    )


@cache
def plant() -> Run:
    """The plant's run."""
    model = shaken()
    return run(model.system, *model.initial_state(), seconds=SECONDS, rate=20)


def errors(model: Model, **options: object) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the settled estimates, and their deviations, shape (samples, 4) each."""
    given = {"law": "minimum-variance", "clock_error": 1e-5, "history": 100.0, **options}
    observer = make_observer(model, Options(**given))  # type: ignore[arg-type]
    for event in plant().events:
        observer.receive(event)
    own = plant().stamps >= EPOCH + SETTLED * NS_PER_S
    made = [observer.estimate(int(stamp)) for stamp in plant().stamps[own]]
    found = np.array([np.concatenate([each.q, each.u]) for each in made])
    deviations = np.sqrt([np.diag(each.covariance) for each in made])
    return found - plant().states[own], deviations


@pytest.mark.slow
@pytest.mark.parametrize("kind", NUMBERS)
def test_the_motion_of_a_ground_is_learned_by_impacts(kind: str) -> None:
    """The published coordinates, which are not relative to the ground, are those of the plant."""
    deviation = 2 * abs(WRONG[kind] - NUMBERS[kind])
    deviation /= NUMBERS[kind] if kind == "amplitude" else 1.0
    model = shaken(**{kind: WRONG[kind]})
    found, deviations = errors(model, estimate_parameters=(f"ground-{kind}={deviation}",))
    assert np.abs(found).max() < 1e-3
    assert np.mean(np.abs(found) < 2 * deviations) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("kind", NUMBERS)
def test_deviations_of_the_motion_of_a_ground_are_considered(kind: str) -> None:
    """Of a number that is off by its deviation errors are within two deviations, and not tiny."""
    deviation = abs(WRONG[kind] - NUMBERS[kind])
    number = f"{{value: {WRONG[kind]}, deviation: {deviation}}}"
    found, deviations = errors(shaken(**{kind: number}))
    size = np.sqrt(np.mean((found / deviations) ** 2))
    assert 0.3 < size < 1.2
    assert np.mean(np.abs(found) < 2 * deviations) > 0.9


@pytest.mark.slow
def test_samples_of_absolute_positions_agree_with_a_phase_that_is_learned() -> None:
    """An encoder that stands on the floor: nearly all of its samples are accepted."""
    encoder = Measurement("e", "/e", field="data", position={"x": 1.0}, deviation=1e-3)
    options = Options(
        "minimum-variance", clock_error=1e-5, estimate_parameters=("ground-phase=0.1",)
    )
    observer = make_observer(shaken(phase=0.35), options, measurements=[encoder])
    rng, run_ = np.random.default_rng(1), plant()
    pairs = zip(run_.stamps[1:].tolist(), run_.states[1:, 0].tolist(), strict=True)
    samples = [SensorSample(0, at, q + 1e-3 * rng.normal()) for at, q in pairs]
    items = replay_batches(observer, run_.events, run_.stamps[-1:], samples=samples)
    *_, last = (each for each in items if isinstance(each, Estimates))
    judged = observer.samples.take()
    assert np.mean([each.accepted for each in judged]) > 0.98
    assert np.sqrt(np.mean([each.normalized**2 for each in judged])) < 1.5
    assert np.abs(last.x[-1] - run_.states[-1]).max() < 1e-3


def test_derivatives_of_the_motion_of_grounds_are_differences_of_systems() -> None:
    """By amplitude, phase and frequency, of position and speed, at an instant long after zero."""
    names = [f"ground-{kind}" for kind in NUMBERS]
    family = parametric_family(shaken().system, names)
    at, values = 100 * NS_PER_S + 12_345_678, family.nominal + np.array([0.1, 0.002, 0.2])

    def moved(theta: np.ndarray) -> np.ndarray:
        stamps = np.array([at], dtype=np.int64)
        return np.ravel(family.system_at(theta).from_frame(stamps, np.zeros((1, 4))))

    found, slopes = family.ground_motion(values, at)
    np.testing.assert_allclose(found[:2].ravel(), moved(values), atol=1e-12)
    for j, step in enumerate(1e-6 * np.eye(3)):
        wanted = (moved(values + step) - moved(values - step)) / 2e-6
        np.testing.assert_allclose(slopes[j, :2].ravel(), wanted, rtol=1e-5, atol=1e-7)
