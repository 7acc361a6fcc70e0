# SPDX-License-Identifier: Apache-2.0
"""What a check of a fit says of a model that does not fit."""

from dataclasses import replace

import pytest
from systems import EPOCH, run

from impact_observer.identify.fit_check import check_fit, rejections
from impact_observer.identify.identification import Identification, identify
from impact_observer.model import read_model
from impact_observer.model.free_parameters import parametric_family


@pytest.fixture(scope="module")
def fitted() -> Identification:
    """A fit of the right model."""
    model = read_model("two_mass")
    made = run(model.system, *model.initial_state(), seconds=20.0, rate=1.0)
    events = [replace(each, epoch=EPOCH) for each in made.events]
    return identify(parametric_family(model.system, ("restitution",)), events)


def test_each_test_that_rejects_a_model_is_named(fitted: Identification) -> None:
    """None of a model that fits; of shifts that depend on each other, what was not tried."""
    check = check_fit(fitted)
    assert not [*rejections(fitted, check)]
    (line,) = rejections(fitted, replace(check, white=1e-9))
    assert "1e-09" in line
    assert "scatters" in line
    (line,) = rejections(fitted, replace(check, missed=("gap.stop",)))
    assert "gap.stop" in line
