# SPDX-License-Identifier: Apache-2.0
"""One impact is missing in printed times of a rig whose numbers are guessed."""

from dataclasses import replace

import numpy as np
import pytest

from impact_observer.batch.identification import identify
from impact_observer.model import Model, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S

EPOCH = 5 * NS_PER_S
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


@pytest.mark.parametrize("missing", [50, 73])
def test_a_missing_impact_is_inserted_and_the_numbers_are_found(missing: int) -> None:
    """Parts of the recording tell the numbers, and these where an impact is missing."""
    true, given = rig(TRUE), rig(GUESSED)
    plant = Plant(true.system, *true.initial_state(), epoch=EPOCH)
    run = simulate(plant, np.array([EPOCH, EPOCH + 12 * NS_PER_S]))
    step = NS_PER_S // 10_000
    printed = [replace(each, stamp=round(each.stamp / step) * step) for each in run.events]
    assert given.uncertainty is not None
    names = given.uncertainty.names
    found = identify(
        parametric_family(given.system, names, given.elements),
        printed[:missing] + printed[missing + 1 :],
        prior=given.uncertainty,
    )
    assert found.verdict.fits
    assert found.found.missed == 1
    wanted = parametric_family(true.system, names, true.elements).nominal
    assert np.max(np.abs(found.values - wanted) / found.errors) < 4
