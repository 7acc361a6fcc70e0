# SPDX-License-Identifier: Apache-2.0
"""One impact is missing in printed times of a rig whose numbers are guessed."""

from dataclasses import replace

import numpy as np
import pytest

from impact_observer.batch.identification import identify
from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.batch.smoothing import smoothed_runs
from impact_observer.events import ImpactEvent
from impact_observer.model import Model, parse_model, read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.observer import Options
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S

EPOCH, STEP = 5 * NS_PER_S, NS_PER_S // 10_000
GUESSED = {"stiffness": 312, "damping": 0.46, "amplitude": 7.5, "limit": 0.0037, "e": 0.54}
TRUE = {"stiffness": 324, "damping": 0.426, "amplitude": 7.81, "limit": 0.0035, "e": 0.51}
RIG = """name: shaken
bodies: [{{name: mass, mass: 0.35}}]
springs:
  - between: [ground, mass]
    stiffness: {{value: {stiffness}, deviation: 12}}
    damping: {{value: {damping}, deviation: 0.04}}
forces:
  - body: mass
    amplitude: {{value: {amplitude}, deviation: 0.3}}
    frequency: 87.588
    phase: 0
stops:
  - name: stop
    body: mass
    limit: {{value: {limit}, deviation: 0.0002}}
    side: above
    restitution: {{value: {e}, deviation: 0.03}}
initial_state: {{position: [0], velocity: [0]}}
"""


def rig(numbers: dict[str, float]) -> Model:
    """The rig with these numbers."""
    return parse_model(RIG.format(**numbers), "shaken.yaml")


@pytest.fixture(scope="module")
def printed() -> list[ImpactEvent]:
    """The impacts of 12 s of the true rig, with four digits behind the point."""
    true = rig(TRUE)
    plant = Plant(true.system, *true.initial_state(), epoch=EPOCH)
    run = simulate(plant, np.array([EPOCH, EPOCH + 12 * NS_PER_S]))
    return [replace(each, stamp=round(each.stamp / STEP) * STEP) for each in run.events]


@pytest.mark.parametrize("missing", [50, 73])
def test_a_missing_impact_is_inserted_and_the_numbers_are_found(
    missing: int, printed: list[ImpactEvent]
) -> None:
    """Parts of the recording tell the numbers, and these where an impact is missing."""
    true, given = rig(TRUE), rig(GUESSED)
    events = printed[:missing] + printed[missing + 1 :]
    assert given.uncertainty is not None
    names = given.uncertainty.names
    family = parametric_family(given.system, names, given.elements)
    found = identify(family, events, prior=given.uncertainty)
    assert found.verdict.fits
    assert found.found.missed == 1
    wanted = parametric_family(true.system, names, true.elements).nominal
    assert np.max(np.abs(found.values - wanted) / found.errors) < 4
    (smoothed,) = smoothed_runs(given, events, Options(epoch=EPOCH), known=found.found)
    late = smoothed.instants - [each.stamp for each in printed]
    assert np.max(np.abs(late)) < STEP


def test_an_impact_inserted_long_ago_is_in_the_account_of_the_filter(
    printed: list[ImpactEvent],
) -> None:
    """Each impact is in the account, also where more than a hundred events follow."""
    system, missing = rig(TRUE).system, 6
    events = printed[:missing] + printed[missing + 1 :]
    run, family = RecordedRun.of(system, events, EPOCH), parametric_family(system, ())
    options = Options(clock_error=STEP * 1e-9, initial_deviation="1e-3")
    moments = run.by_filter(family, np.zeros(0), np.zeros((0, 0)), options, lambda _: None)
    assert len(events) > 100
    (inserted,) = (each for each in moments.each if not each.is_measured)
    assert abs(inserted.stamp - printed[missing].stamp) < 10 * STEP


def test_a_missing_impact_is_inserted_where_the_reported_ones_nearly_fit() -> None:
    """An error of the accelerations of 7 % would explain the reported impacts."""
    family = parametric_family(read_model("two_mass").system, ("restitution", "stiffness-scale"))
    true, missing = np.array([0.66, 1.05]), 5
    start = np.array([[-0.167, 0.102], [-0.842, -1.734]])
    plant = Plant(family.system_at(true), *start, epoch=EPOCH)
    run = simulate(plant, np.array([EPOCH, EPOCH + 60 * NS_PER_S]))
    found = identify(family, run.events[:missing] + run.events[missing + 1 :])
    assert found.verdict.fits
    assert found.found.missed == 1
    assert np.max(np.abs(found.values - true) / found.errors) < 4
