# SPDX-License-Identifier: Apache-2.0
"""The key ``hertz`` of forces, harmonics and grounds: 2 pi times as many rad/s."""

import math

import numpy as np
import pytest

from impact_observer.batch.model_edit import changes
from impact_observer.model import parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.yaml_text import edited, load_yaml

ELEMENTS = """
name: shaker
bodies: [{name: x, mass: 1}]
springs: [{between: [table, x], stiffness: 10}]
forces:
  - {body: x, amplitude: 1, FORCE}
grounds: [{name: table, motion: {harmonics: [{amplitude: 0.003, GROUND}]}}]
"""
MATRICES = """
name: one
coordinates: [x]
mass: [[1]]
damping: [[0]]
stiffness: [[10]]
forcing: {harmonics: [{FORCE, cosine: [4]}]}
contacts: []
"""


def written(text: str, force: str, ground: str = "frequency: 1") -> str:
    """A model file with these frequencies."""
    return text.replace("FORCE", force).replace("GROUND", ground)


@pytest.mark.parametrize("text", [ELEMENTS, MATRICES])
def test_hertz_are_converted_on_reading(text: str) -> None:
    """A model in Hz has the frequencies of the model in rad/s."""
    own = [
        parse_model(written(text, *keys), "model").system
        for keys in (
            (f"frequency: {math.tau * 2.5!r}", f"frequency: {math.tau * 10!r}"),
            ("hertz: 2.5", "hertz: 10"),
        )
    ]
    assert own[0].forcing.frequency.tolist() == own[1].forcing.frequency.tolist()


def test_a_deviation_is_converted_too() -> None:
    """The deviation beside a number in Hz is in Hz."""
    model = parse_model(written(ELEMENTS, "hertz: {value: 2, deviation: 0.1}"), "model")
    assert model.uncertainty is not None
    assert model.uncertainty.names == ("forcing-frequency.1",)
    assert model.uncertainty.deviations == pytest.approx([math.tau * 0.1])


def test_an_identified_frequency_is_written_in_hertz_again() -> None:
    """A file in Hz stays one."""
    text = written(ELEMENTS, "hertz: 2")
    model = parse_model(text, "model")
    family = parametric_family(model.system, ["forcing-frequency.1"])
    document = load_yaml(text)
    assert isinstance(document, dict)
    again = edited(text, changes(document, model.places, family, np.array([12.5])))
    assert "hertz: 2," not in again
    found = parse_model(again, "model").system.own_forcing.frequency
    assert found == pytest.approx([12.5], rel=1e-15)
