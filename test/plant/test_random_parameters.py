# SPDX-License-Identifier: Apache-2.0
"""Plants that are drawn from the deviations of a model."""

from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import text_of_model
from impact_observer.model import System, parse_model
from impact_observer.plant import random_plant

RIG = """\
name: rig
bodies: [{name: x1, mass: 1}]
springs: [{between: [ground, x1], stiffness: 10, damping: 0.1}]
forces: [{body: x1, amplitude: 4, frequency: 2.5}]
stops: [{name: stop, body: x1, limit: 0.2, side: above, restitution: 0.7}]
initial_state: {position: [0.1], velocity: [0.5]}
"""
COVARIANCE = np.array([[1e-4, 5e-6, 0.0], [5e-6, 1e-6, 0.0], [0.0, 0.0, 0.0]])
KNOWN = f"""\
uncertainty:
  names: [restitution.stop, gap.stop, stiffness-scale]
  covariance: {COVARIANCE.tolist()}
"""


@pytest.mark.long
def test_drawn_values_have_the_declared_mean_and_covariance() -> None:
    """Of 2000 draws, within five standard errors; what is exact stays exact."""
    model = parse_model(RIG + KNOWN, "rig")
    draws = np.array([[*random_plant(model, seed).values.values()] for seed in range(2000)])
    errors = np.sqrt(np.diag(COVARIANCE) / len(draws))
    assert np.all(np.abs(draws.mean(axis=0) - [0.7, 0.2, 1.0]) <= 5 * errors)
    scale = np.sqrt(np.outer(np.diag(COVARIANCE), np.diag(COVARIANCE)))
    off = np.abs(np.cov(draws.T) - COVARIANCE)
    assert np.all(off <= 5 * scale * np.sqrt(2 / len(draws)))
    assert np.all(draws[:, 2] == 1.0)


def test_a_draw_is_a_plant_with_its_values_outside_its_stops() -> None:
    """A restitution stays in [0, 1], and a start outside, though half of the draws are not."""
    wide = RIG.replace("restitution: 0.7", "restitution: {value: 1, deviation: 0.2}").replace(
        "limit: 0.2", "limit: {value: 0.1, deviation: 0.05}"
    )
    for seed in range(20):
        system, values = random_plant(parse_model(wide, "rig"), seed)
        assert isinstance(system, System)
        assert system.eps[0] == values["restitution.stop"] <= 1
        assert system.q_r[0] == pytest.approx(values["gap.stop"])
        assert values["gap.stop"] >= 0.1 - 1e-9


def test_a_model_without_deviations_is_refused() -> None:
    """In one line that names the model."""
    with pytest.raises(UsageError, match="rig"):
        random_plant(parse_model(RIG, "rig"), 0)


def test_a_bag_has_the_declared_model_and_the_drawn_values(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The impacts are those of the plant with the drawn values."""
    given, plain, bag = tmp_path / "rig.yaml", tmp_path / "plain.yaml", tmp_path / "bag"
    given.write_text(RIG + KNOWN)
    plain.write_text(RIG)
    words = ["--duration", "5", "--random-parameters", "3", "-o"]
    assert main(["simulate", str(given), *words, str(bag)]) == 0
    with BagReader(bag) as reader:
        model = parse_model(*text_of_model(reader, None))
    np.testing.assert_array_equal(model.system.eps, [0.7])
    assert model.uncertainty is not None
    np.testing.assert_array_equal(model.uncertainty.covariance, COVARIANCE)
    drawn = random_plant(parse_model(RIG + KNOWN, "rig"), 3).values
    assert model.provenance["true_parameters"] == pytest.approx(drawn)
    assert main(["simulate", str(plain), *words, str(tmp_path / "none")]) == 2
    assert "plain.yaml: no deviations of parameters found" in capsys.readouterr().err
