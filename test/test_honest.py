# SPDX-License-Identifier: Apache-2.0
"""The table of wrong plants and sensors: ``./dev bench honest``."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from benchmarks.honest import main
from benchmarks.honest_runs import interval_score


@pytest.mark.parametrize(("row", "visible"), [("exact, two_mass", 0), ("gap 1 mm, two_mass", 1)])
def test_a_row_tells_a_wrong_plant_from_an_exact_one(
    row: str, visible: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One run is synchronized and exact, the other is wrong and not sure."""
    path = tmp_path / "runs.json"
    assert main(["--rows", row, "--runs", "1", "--workers", "1", "--json", str(path)]) == 0
    (found,) = json.loads(path.read_text())["rows"]
    assert found["visible"] == visible
    assert (found["error"] < 1e-9) is (visible == 0)
    assert (found["synchronized"] > 0.9) is (visible == 0)
    assert "two_mass" in capsys.readouterr().out


def test_an_unknown_row_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """The line names those that exist."""
    with pytest.raises(SystemExit):
        main(["--rows", "pres"])
    assert "none is named pres; there are press force 1 %" in capsys.readouterr().err


def test_the_score_of_a_normal_error_is_its_expectation() -> None:
    """80 phi(1.96) deviations: the integral of the interval score over a normal density."""
    errors = 0.3 * np.random.default_rng(1).normal(size=(400_000, 1))
    expected = 0.3 * 80 * stats.norm.pdf(stats.norm.ppf(0.975))
    assert interval_score(errors, np.full(errors.shape, 0.3)) == pytest.approx(expected, rel=5e-3)
