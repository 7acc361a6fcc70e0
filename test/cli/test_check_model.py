# SPDX-License-Identifier: Apache-2.0
"""The command ``check-model``: properties of a model that matter to an observer."""

import argparse
import json
import math
from pathlib import Path

import pytest
from systems import system

from impact_observer.check.model_check import check_model as check
from impact_observer.check.model_findings import findings
from impact_observer.cli import check_model
from impact_observer.errors import ModelError, UsageError
from impact_observer.resources import shared

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
    """Tables of modes and contacts, and three findings, none a warning."""
    assert check_model.run(parsed("two_mass")) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 24
    assert lines[0] == "two_mass: 2 coordinates, 1 contact, forcing: 1 harmonic; SI units"
    words = [line.split() for line in lines]
    assert ["force", "on", "x2", "4", "2.5", "0.397887"] in words
    assert ["1", "1.9544", "0.311052"] in words
    assert ["2", "5.115", "0.814077", "0.02558", "7.639"] in words
    assert ["stop", "0.5", "0.7", "1", "0.5", "1.135", "2.837"] in words
    assert [line[0] for line in words[-3:]] == ["ok", "ok", "ok"]


def hammer(limit: float = 0.5, frequency: float = 2.5) -> str:
    """A model of elements with two numbers that may be of a wrong unit."""
    return (
        "name: hammer\nbodies: [{name: x, mass: 1}]\n"
        "springs: [{between: [ground, x], stiffness: 10, damping: 0.1}]\n"
        f"forces: [{{body: x, amplitude: 4, frequency: {frequency}}}]\n"
        f"stops: [{{name: anvil, body: x, limit: {limit}, side: above, restitution: 0.7}}]\n"
        "initial_state: {position: [0], velocity: [0]}\n"
    )


def test_a_phase_beyond_a_turn_is_doubted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a force and of a ground, with the number in rad; a phase of 6 rad is none of degrees."""
    motion = "{harmonics: [{amplitude: 0.1, frequency: 9, phase: 450}]}"
    text = f"grounds: [{{name: table, motion: {motion}}}]\n{hammer()}".replace("[ground", "[table")
    said = printed(capsys, written(tmp_path, text.replace("2.5}", "2.5, phase: -90}")))
    assert "warning forces[0].phase is -90, more than a turn. Phases are in rad" in said
    assert f"if -90 degrees are meant, write {-math.pi / 2:.6f}." in said
    assert "grounds[0].motion.harmonics[0].phase is 450" in said
    text = text.replace("450", "6").replace("2.5}", "2.5, phase: -6}")
    assert "turn" not in printed(capsys, written(tmp_path, text))


FORCES = "constant and harmonic forces move its gap of 500 m by 1.06 at most"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (hammer(limit=500), f"warning anvil is hardly ever reached: {FORCES}."),
        (hammer(frequency=0.5), "note The excitation of 0.5 rad/s is far below the lowest mode."),
        (hammer(frequency=0.5), "If 0.5 was meant in Hz, write 3.142; if in revolutions a"),
        (hammer(frequency=150), "note The excitation of 150 rad/s is far above the highest mode."),
        (hammer(frequency=150), "write 942.5; if in revolutions a minute, 15.71."),
    ],
)
def test_numbers_of_another_unit_are_named_by_what_follows_from_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    """A force of 4 N at 2.5 rad/s moves 1 kg on 10 N/m by 4/|10 - 6.25 + 0.25i| = 1.064 m."""
    assert said in printed(capsys, written(tmp_path, text))
    good = printed(capsys, written(tmp_path, hammer()))
    assert "anvil 0.5 0.7 1 0.5 1.064 2.661" in good
    assert "warning" not in good
    assert "far" not in good


def test_a_table_in_millimetres_or_hertz_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One table shakes too little to lift the ball, the other faster than any machine."""
    text = Path(shared("config") / "ball_on_table.yaml").read_text(encoding="utf-8")
    slow = text.replace("62.83185307179586", "10")
    assert slow != text
    said = printed(capsys, written(tmp_path, slow))
    assert (
        "A body that rests on plate never leaves plate: constant forces press with 9.81 m/s^2"
        in said
    )
    assert "shake with only 0.3 m/s^2" in said
    large = text.replace("amplitude: 0.003", "amplitude: 3").replace("[0.02]", "[20]")
    said = printed(capsys, written(tmp_path, large))
    assert "Without impacts the gap of plate changes at up to 188 m/s" in said


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball"])
def test_no_sample_has_a_warning(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No impact of a sample model raises V."""
    output = printed(capsys, name)
    assert "ok No impact raises V" in output
    assert "warning" not in output


def test_grounds_have_their_frequency_and_a_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Amplitude, rad/s and Hz, so that a wrong unit is seen; one that moves nothing is named."""
    output = printed(capsys, "ball_on_table")
    assert "ground table 0.003 m 62.8319 10" in output
    assert "force on height" in output
    assert "under load [m] swing [m] at [m/s]" in output
    assert "force on height -9.81" in output
    assert "moves nothing" not in output
    text = Path(shared("config") / "ball_on_table.yaml").read_text(encoding="utf-8")
    still = text.replace("between: [table, height], gap: 0", "body: height, limit: 0, side: below")
    assert still != text
    assert "Ground table moves nothing" in printed(capsys, written(tmp_path, still))


def test_the_ball_is_a_rigid_body(capsys: pytest.CaptureFixture[str]) -> None:
    """The finding has its consequence."""
    output = printed(capsys, "bouncing_ball")
    assert "1 rigid-body mode: (height 1). V is a seminorm" in output
    assert "Without damping: rigid-body motion. V need not vanish" in output


def test_warnings_name_their_consequence_and_the_model_stays_valid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A corner with unequal restitution, forced at an undamped frequency."""
    output = printed(capsys, written(tmp_path, CORNER))
    assert (
        "warning Contacts wall[1] and ramp can close together, with restitution 1 and 0: an impact"
        " of these alone can raise V by a factor of up to 5.261" in output
    )
    assert "Give contacts that close together one restitution." in output
    assert "warning Harmonic 1 of the forcing, 1 rad/s, is at the frequency" in output
    assert "note Without damping: 1 rad/s and 1 rad/s. V need not vanish" in output


def test_json_has_all_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command prints nothing but JSON; contacts are called by their names."""
    assert check_model.run(parsed(written(tmp_path, CORNER), "--json")) == 0
    found = json.loads(capsys.readouterr().out)
    (raising,) = found.pop("expansive")
    assert raising["contacts"] == ["wall[1]", "ramp"]
    assert raising["factor"] == pytest.approx(1.000096 / 0.436**2, rel=1e-9)
    assert [len(speeds) for speeds in raising["contact_speeds"]] == [2, 2]
    kinds = [finding["kind"] for finding in found.pop("findings")]
    assert kinds == ["warning", "note", "warning", "ok"]
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
        "swing_speed": None,
    }
    assert ramp["effective_mass"] == pytest.approx(1 / 1.000096)
    assert found.pop("undamped_frequencies") == pytest.approx([1, 1])
    assert found == {
        "name": "corner",
        "n": 2,
        "m": 2,
        "real_eigenvalues": [],
        "rigid_modes": [],
        "resonances": [{"harmonic": 0, "frequency": 1.0}],
        "excitations": [{"name": "force on x", "amplitude": 1.0, "frequency": 1.0}],
        "unseen": [],
        "redundant": [],
        "redundant_decided": True,
        "nonexpansive": False,
    }


def test_a_long_table_shows_its_ends(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A line tells the number and place of the rows that are left out; JSON has every row."""
    path = written(tmp_path, rows(30))
    output = printed(capsys, path)
    assert output.count("... 22 more in --json") == 3
    assert " s3 " in output
    assert " s4 " not in output
    assert " s29 " in output
    slowest = [6 * math.sin((2 * j + 1) * math.pi / 122) for j in range(3)]
    shown = ", ".join(f"{omega:.4g} rad/s" for omega in slowest)
    assert f"Without damping: {shown} and 27 more" in output
    assert check_model.run(parsed(path, "--json")) == 0
    assert len(json.loads(capsys.readouterr().out)["modes"]) == 30


def test_a_mode_that_no_contact_sees_is_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mode, several, or all of them."""
    one = rows(2).replace("stops: [{name: s0", "stops: [{name: s9")
    text = CORNER.replace("[0.9, 0.436]", "[2, 0]")
    output = printed(capsys, written(tmp_path, text))
    assert "warning No contact moves in the mode at 1 rad/s, (y 1): no impact ever" in output
    assert "note Contacts wall[1] and ramp depend" not in output  # ramp is half as far away
    level = text.replace(
        "name: ramp, direction: [2, 0], gap: 1", "name: ramp, direction: [2, 0], gap: 2"
    )
    output = printed(capsys, written(tmp_path, level))
    assert "note Contacts wall[1] and ramp depend on each other and can close together" in output
    assert "of unequal restitutions the larger counts" in output
    assert "s9" in printed(capsys, written(tmp_path, one))
    silent = CORNER[: CORNER.index("contacts:")] + "contacts: []\n" + CORNER.splitlines()[-1]
    output = printed(capsys, written(tmp_path, silent))
    assert "warning The model has no contacts: no event ever corrects an estimate." in output


def test_stops_without_clearance_are_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two stops are always closed, and two others contradict each other."""
    without_room = CORNER.replace("[0.9, 0.436], gap: 1", "[-1, 0], gap: -1")
    position = without_room.replace("position: [0, 0]", "position: [-1, 0]")
    assert "No position is clear of all stops" in printed(capsys, written(tmp_path, position))
    contacts = [([1.0], -0.1, 0.5), ([-1.0], -0.1, 0.5)]
    contradicting = check(system(1, 1, 1, contacts=contacts))  # no file can: it needs a position
    assert "Every position is inside some stop" in findings(contradicting)[1][1]


def test_an_undecided_question_is_a_warning(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No undecided question is passed silently."""
    from impact_observer.check import model_check
    from impact_observer.check.closing_sets import SearchResult

    monkeypatch.setattr(model_check, "expansive", lambda _: SearchResult((), False))
    monkeypatch.setattr(model_check, "redundant", lambda _: SearchResult((), False))
    output = printed(capsys, "two_mass")
    assert "warning Whether an impact can raise V is not decided" in output
    assert "note Whether more contacts that close together depend on each other" in output
    assert check_model.run(parsed("two_mass", "--json")) == 0
    assert json.loads(capsys.readouterr().out)["nonexpansive"] is None


def test_declared_deviations_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In SI units of the parameter, with what an observer makes of each; in JSON without words."""
    text = rows(1).replace("limit: 1", "limit: {value: 1, deviation: 0.02}")
    path = written(tmp_path, text.replace("mass: 1", "mass: {value: 1, deviation: 0}"))
    output = printed(capsys, path)
    assert "gap.s0 1 0.02 m as uncertain" in output
    assert "mass.x0 1 0 kg as exact" in output
    assert check_model.run(parsed(path, "--json")) == 0
    found = {each["name"]: each for each in json.loads(capsys.readouterr().out)["deviations"]}
    assert found["gap.s0"] == {"name": "gap.s0", "value": 1.0, "deviation": 0.02, "unit": "m"}
    assert found["mass.x0"]["deviation"] == 0.0
    shaken = "{amplitude: {value: 0.1, deviation: 0.001}, frequency: 9}"
    text = f"grounds: [{{name: table, motion: {{harmonics: [{shaken}]}}}}]\n" + rows(1)
    output = printed(capsys, written(tmp_path, text.replace("[ground,", "[table,")))
    assert "ground-amplitude.table.1 1 0.01 as exact: only identify learns it" in output


def test_a_file_that_is_no_model_is_wrong_use(tmp_path: Path) -> None:
    """The error is one line, with exit code 2."""
    with pytest.raises(UsageError, match="no such file") as absent:
        check_model.run(parsed(str(tmp_path / "absent.yaml")))
    with pytest.raises(ModelError, match="restitution: is 7") as broken:
        check_model.run(
            parsed(written(tmp_path, CORNER.replace("restitution: 0", "restitution: 7")))
        )
    assert absent.value.exit_code == broken.value.exit_code == 2


@pytest.mark.parametrize(("force", "warned"), [(-1.0791, False), (1.0791, True)])
def test_a_free_body_that_is_pulled_away_from_its_stop_is_doubted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], force: float, warned: bool
) -> None:
    """Gravity with the wrong sign above a table that moves."""
    path = tmp_path / "ball.yaml"
    path.write_text(
        f"""
        name: ball
        bodies: [{{name: ball, mass: 0.11}}]
        grounds: [{{name: table, motion: {{harmonics: [{{amplitude: 0.004, frequency: 88}}]}}}}]
        forces: [{{body: ball, constant: {force}}}]
        stops: [{{name: plate, between: [table, ball], gap: 0, restitution: 0.6}}]
        """
    )
    assert ("pull away from plate with 9.81 m/s^2" in printed(capsys, str(path))) == warned
