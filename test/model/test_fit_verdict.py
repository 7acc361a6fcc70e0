# SPDX-License-Identifier: Apache-2.0
"""A motion that is early or late, and the verdict of a fit that says so in a model file."""

import numpy as np
import pytest

from impact_observer.errors import ModelError
from impact_observer.model import Model, parse_model
from impact_observer.model.fit_verdict import NO_SHIFT, TimeShift
from impact_observer.resources import shared

VERDICT = "provenance: {fits: false, residual: 2.0e-5, shift: 1.0e-4, interval: 0.5, seed: 3}"


def two_mass(provenance: str) -> Model:
    """The sample with a provenance."""
    return parse_model(f"{(shared('config') / 'two_mass.yaml').read_text()}\n{provenance}\n", "m")


def test_errors_are_those_of_an_oscillation_that_is_late() -> None:
    """With one turn an interval: of a position at all times, of a speed in root mean square."""
    interval, late = 0.5, 1e-5
    w, t = 2 * np.pi / interval, np.linspace(0, 1, 100, endpoint=False)

    def motion(t: np.ndarray) -> np.ndarray:
        return np.column_stack([np.cos(w * t), -w * np.sin(w * t)])

    error = np.abs(motion(t + late) - motion(t))
    shift = TimeShift(late, 0.5)
    given = np.array([shift.errors(x) for x in motion(t)])
    assert np.all(given[:, 0] >= error[:, 0] * (1 - 1e-3))
    assert np.max(given[:, 0]) <= 1.5 * np.max(error[:, 0])
    ratio = np.sqrt(np.mean(given[:, 1] ** 2) / np.mean(error[:, 1] ** 2))
    assert ratio == pytest.approx(1.0, rel=1e-3)
    assert not NO_SHIFT.errors(motion(t)[3]).any()


def test_a_verdict_stays_with_a_model_that_is_written_anew() -> None:
    """Whoever writes the text: another origin does not make the model fit."""
    model = parse_model(two_mass(VERDICT).text({"seed": 4}), "bag (/plant/model)")
    assert model.provenance["seed"] == 4
    assert model.shift == TimeShift(1e-4, 0.5)
    assert model.misfit.startswith("bag (/plant/model) does not fit")
    assert "2e-05 s rms" in model.misfit
    assert [*model.doubts] == [model.misfit]


@pytest.mark.parametrize("provenance", ["", "provenance: {fits: true, residual: 2.0e-5}"])
def test_a_model_without_a_verdict_against_it_is_not_doubted(provenance: str) -> None:
    """Whether no fit has been made, or one that fits."""
    model = two_mass(provenance)
    assert (model.misfit, model.shift, [*model.doubts]) == ("", NO_SHIFT, [])


def test_keys_of_another_origin_are_no_verdict() -> None:
    """Without ``fits`` they may say anything."""
    model = two_mass("provenance: {shift: night, interval: 0}")
    assert (model.shift, model.provenance["shift"]) == (NO_SHIFT, "night")


@pytest.mark.parametrize(
    ("key", "given", "value"),
    [("fits", "false", "maybe"), ("shift", "1.0e-4", "-1"), ("interval", "0.5", "0")],
)
def test_a_verdict_that_is_none_is_one_line(key: str, given: str, value: str) -> None:
    """It names the key."""
    wrong = VERDICT.replace(f"{key}: {given}", f"{key}: {value}")
    assert wrong != VERDICT
    with pytest.raises(ModelError, match=rf"^m: provenance.{key}"):
        two_mass(wrong)
