# SPDX-License-Identifier: Apache-2.0
"""The key ``hertz`` of forces, harmonics and grounds: 2 pi times as many rad/s."""

import math
from pathlib import Path

import pytest

from impact_observer.errors import ModelError
from impact_observer.model import parse_model
from impact_observer.model.model_file import edited, model_text

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


@pytest.mark.parametrize(
    ("force", "place"),
    [
        ("hertz: 2, frequency: 12", r"forces\[0\]\.hertz: .*frequency"),
        ("hertz: two", r"forces\[0\]\.hertz: 'two'"),
    ],
)
def test_two_keys_or_no_number_are_errors(force: str, place: str) -> None:
    """The line names the key."""
    with pytest.raises(ModelError, match=place):
        parse_model(written(ELEMENTS, force), "model")


def test_a_file_in_hertz_is_edited_in_rad_per_s(tmp_path: Path) -> None:
    """As ``identify`` writes a frequency; the text of the file has no ``hertz`` any more."""
    path = tmp_path / "model.yaml"
    path.write_text(written(ELEMENTS, "hertz: 2"), "utf-8")
    text = edited(model_text(path).text, {("forces", 0, "frequency"): 12.5})
    assert "hertz" not in text
    assert parse_model(text, "model").system.own_forcing.frequency.tolist() == [12.5]
