# SPDX-License-Identifier: Apache-2.0
"""The command ``check-model``: properties of a model that matter to an observer."""

import argparse
import json
import math
from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli import check_model
from impact_observer.dynamics import mechanism_of
from impact_observer.model import read_model

CORNER = """
name: corner
coordinates: [x, y]
mass: [[1, 0], [0, 1]]
damping: [[0, 0], [0, 0]]
stiffness: [[1, 0], [0, 1]]
forcing: {harmonics: [{frequency: 1, cosine: [1, 0]}]}
contacts:
  - {name: "wall[1]", direction: [1, 0], gap: 1, restitution: 1}
  - {name: ramp, direction: [0.9, 0.436], gap: 1, restitution: 0}
initial_state: {position: [0, 0], velocity: [0, 0]}
"""


def parsed(*words: str) -> argparse.Namespace:
    """The command line ``words``."""
    parser = argparse.ArgumentParser()
    check_model.add_arguments(parser)
    return parser.parse_args(words)


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Output of the command without line ends."""
    assert check_model.run(parsed(*words)) == 0
    return " ".join(capsys.readouterr().out.split())


def written(folder: Path, text: str) -> str:
    """A model file."""
    path = folder / "model.yaml"
    path.write_text(text)
    return str(path)


def rows(count: int, restitution: str = "0.5") -> str:
    """A model of so many equal masses, each before a wall of its own."""
    bodies = ", ".join(f"{{name: x{i}, mass: 1}}" for i in range(count))
    springs = ", ".join(
        f"{{between: [{f'x{i - 1}' if i else 'ground'}, x{i}], stiffness: 9}}"
        for i in range(count)
    )
    stops = ", ".join(
        f"{{name: s{i}, body: x{i}, limit: 1, side: above, restitution: {restitution}}}"
        for i in range(count)
    )
    zeros = [0] * count
    return (
        f"name: row\nbodies: [{bodies}]\nsprings: [{springs}]\nstops: [{stops}]\n"
        f"initial_state: {{position: {zeros}, velocity: {zeros}}}\n"
    )


def test_a_sample_fits_on_one_screen_and_is_fine(capsys: pytest.CaptureFixture[str]) -> None:
    """Tables of forces, modes and contacts, and three findings, none a warning."""
    assert check_model.run(parsed("two_mass")) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 24
    words = [line.split() for line in lines]
    assert ["force", "on", "x2", "4", "2.5", "0.397887"] in words
    assert ["5.11667", "5.115", "0.0255834", "0.130902"] in words
    assert ["stop", "0.5", "0.7", "1", "0.5", "1.13475"] in words
    assert [line[0] for line in words[-3:]] == ["ok", "ok", "ok"]


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball"])
def test_no_sample_has_a_warning(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No impact of a sample model raises V."""
    output = printed(capsys, name)
    assert "ok No impact raises V" in output
    assert "warning" not in output


def test_grounds_have_their_amplitude_and_frequency(capsys: pytest.CaptureFixture[str]) -> None:
    """Amplitude, rad/s and Hz, so that a wrong unit is seen."""
    output = printed(capsys, "ball_on_table")
    assert "ground table 0.003 62.8319 10" in output
    assert "force on height -9.81" in output


def test_json_has_all_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command prints nothing but JSON; contacts are called by their names."""
    assert check_model.run(parsed(written(tmp_path, CORNER), "--json")) == 0
    found = json.loads(capsys.readouterr().out)
    (raising,) = found.pop("expansive")
    assert raising["contacts"] == ["wall[1]", "ramp"]
    assert raising["factor"] == pytest.approx(1.000096 / 0.436**2, rel=1e-9)
    kinds = [finding["kind"] for finding in found.pop("findings")]
    assert kinds == ["warning", "note", "ok"]
    mode = {"natural_frequency": 1, "damped_frequency": 1, "damping_ratio": 0, "decay": 0}
    assert found.pop("modes") == [pytest.approx(mode)] * 2
    wall, ramp = found.pop("contacts")
    assert wall == {
        "name": "wall[1]",
        "gap": 1,
        "restitution": 1,
        "effective_mass": 1,
        "gap_under_load": 1,
        "swing": None,  # at a resonance
    }
    assert ramp["effective_mass"] == pytest.approx(1 / 1.000096)
    assert found.pop("undamped_frequencies") == pytest.approx([1, 1])
    assert found == {
        "name": "corner",
        "n": 2,
        "m": 2,
        "real_eigenvalues": [],
        "rigid_modes": [],
        "excitations": [
            {"name": "force on x", "amplitude": 1.0, "frequency": 1.0, "hertz": 0.5 / math.pi}
        ],
        "unseen": [],
        "nonexpansive": False,
        "deviations": [],
    }


def test_a_long_table_shows_its_ends(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A line tells the number and place of the rows that are left out; JSON has every row."""
    path = written(tmp_path, rows(30))
    output = printed(capsys, path)
    assert output.count("... 22 more in --json") == 2
    assert " s3 " in output
    assert " s4 " not in output
    assert " s29 " in output
    assert check_model.run(parsed(path, "--json")) == 0
    assert len(json.loads(capsys.readouterr().out)["modes"]) == 30


def test_a_mode_that_no_contact_sees_is_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mode, or all of them."""
    output = printed(capsys, written(tmp_path, CORNER.replace("[0.9, 0.436]", "[2, 0]")))
    assert "warning No contact moves in the mode at 1 rad/s, (y 1)" in output
    silent = CORNER[: CORNER.index("contacts:")] + "contacts: []\n" + CORNER.splitlines()[-1]
    assert "warning Without contacts" in printed(capsys, written(tmp_path, silent))


def test_declared_deviations_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In SI units of the parameter, and whether an observer takes it for uncertain."""
    text = rows(1).replace("limit: 1", "limit: {value: 1, deviation: 0.02}")
    path = written(tmp_path, text.replace("mass: 1", "mass: {value: 1, deviation: 0}"))
    output = printed(capsys, path)
    assert "gap.s0 1 0.02 m True" in output
    assert "mass.x0 1 0 kg False" in output
    assert check_model.run(parsed(path, "--json")) == 0
    found = {each["name"]: each for each in json.loads(capsys.readouterr().out)["deviations"]}
    known = {"name": "gap.s0", "value": 1.0, "deviation": 0.02, "unit": "m"}
    assert found["gap.s0"] == {**known, "observed": True}
    assert found["mass.x0"]["deviation"] == 0.0


@pytest.mark.filterwarnings("error")
def test_next_to_no_stiffness_is_computed_in_silence(tmp_path: Path) -> None:
    """The least number above zero, under a constant load: numpy says nothing."""
    text = rows(1).replace("stiffness: 9", "stiffness: 5.0e-324")
    path = written(tmp_path, f"{text}forces: [{{body: x0, constant: 1}}]\n")
    assert check_model.run(parsed(path)) == 0
    size, pushed = mechanism_of(read_model(path).system).forced()
    assert not np.any(np.isnan([*size, *pushed]))
