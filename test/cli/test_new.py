# SPDX-License-Identifier: Apache-2.0
"""new: from a few words to a rig that is simulated, detected and observed."""

import builtins
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.io import BagReader
from impact_observer.io.live_inputs import read_pulse
from impact_observer.io.recordings import events_in
from impact_observer.model import read_model
from impact_observer.plant import Plant, simulate
from impact_observer.resources import shared

EPOCH = 1_000_000_000

HAMMER = (
    *("--mass", "x1,1", "--mass", "x2,1"),
    *("--spring", "ground,x1,10,0.1", "--spring", "x1,x2,10,0.1"),
    *("--force", "x2,4,2.5", "--stop", "anvil,x2,above,0.5,0.7", "--sensor", "anvil,/switch"),
)
"""The rig of README, which is two_mass."""
FILES = ("hammer.yaml", "hammer_sensors.yaml", "hammer.launch.py")


def answers(monkeypatch: pytest.MonkeyPatch, *lines: str) -> list[str]:
    """Give these answers, as in a terminal, and return the questions."""
    left, asked = iter(lines), list[str]()

    def answer(question: str) -> str:
        asked.append(question)
        try:
            return next(left)
        except StopIteration:
            raise EOFError from None

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(builtins, "input", answer)
    return asked


@pytest.mark.usefixtures("in_tmp_path")
def test_what_is_written_is_checked_and_explained(capsys: pytest.CaptureFixture[str]) -> None:
    """The command itself ends with check-model, and says how to go on."""
    assert main(["new", "hammer", *HAMMER]) == 0
    out = capsys.readouterr().out
    assert f"{', '.join(FILES)}: written" in out
    assert "hammer: 2 coordinates, 1 contact, forcing: 1 harmonic" in out
    assert "-p sources:=hammer_sensors.yaml -p epoch:=NANOSECONDS" in out
    assert "ros2 launch hammer.launch.py epoch:=NANOSECONDS " in out
    assert main(["check-model", "hammer.yaml"]) == 0
    assert capsys.readouterr().out in out


@pytest.mark.parametrize(
    ("name", "parts", "impacts"),
    [
        ("ball", "--mass ball,0.05 --force ball,-0.4905 --stop floor,ball,below,0,0.8", 20),
        (
            "shaker",
            (
                "--mass part,0.3 --ground table,0.003,75 --spring table,part,600,0.5"
                " --stop wire,table,part,0.004,0.6"
            ),
            5,
        ),
        (
            "drill",
            (
                "--mass housing,5 --mass bit,1 --spring ground,housing,2e4,60"
                " --spring housing,bit,2e4,20 --force housing,400,140"
                " --stop rock,bit,above,0.008,0.5"
            ),
            30,
        ),
    ],
)
@pytest.mark.usefixtures("in_tmp_path")
def test_a_new_rig_moves_and_hits(name: str, parts: str, impacts: int) -> None:
    """The written model can be simulated without a change."""
    assert main(["new", name, *parts.split()]) == 0
    model = read_model(f"{name}.yaml")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, np.array([EPOCH, 3 * EPOCH]))
    assert len(run.impacts) >= impacts


@pytest.mark.usefixtures("in_tmp_path")
def test_a_drive_has_an_order_and_its_pulses_are_simulated(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An observer takes the epoch from the pulses, one a revolution; no epoch is asked for."""
    parts = "--mass h,2 --spring ground,h,2000,8 --force h,60,28,0,2 --stop a,h,above,0.01,0.6"
    assert main(["new", "drill", *parts.split()]) == 0
    assert "epoch" not in capsys.readouterr().out
    assert main(["simulate", "drill.yaml", "--duration", "2", "-o", "bag"]) == 0
    with BagReader(Path("bag")) as bag:
        pulses = [read_pulse(message) for _, message in bag.messages("/phase_reference")]
    turns = np.arange(int(2 / (2 * np.pi / 14)) + 1)
    np.testing.assert_allclose(pulses, EPOCH + turns * 2 * np.pi / 14 * 1e9, atol=1)
    assert main(["observe", "bag", "--initial", "drawn:1", "-o", "estimates"]) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_the_files_go_all_the_way_to_an_estimate(capsys: pytest.CaptureFixture[str]) -> None:
    """A simulation; and a recorded switch of the same rig, with the sensors file."""
    assert main(["new", "hammer", *HAMMER]) == 0
    assert main(["simulate", "hammer.yaml", "--duration", "10", "-o", "simulated"]) == 0
    with BagReader(Path("simulated")) as bag:
        assert len(list(events_in(bag))) == 5
    recorded = str(shared("bags/switch"))
    files = ["--sources", "hammer_sensors.yaml", "--model", "hammer.yaml", "--epoch", "1"]
    assert main(["detect", recorded, *files, "-o", "detected"]) == 0
    assert "anvil: 22 impacts" in capsys.readouterr().out
    assert main(["observe", "detected", "--law", "minimum-variance", "-o", "observed"]) == 0
    assert "22 applied" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_the_commands_that_come_next_run_as_they_are_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The rig is one of millimetres, and the commands have its deviation."""
    parts = (
        "--mass a,0.05 --mass b,0.02 --spring ground,a,2000,0.3 --spring a,b,1500,0.2"
        " --force b,3,180 --stop anvil,b,above,0.001,0.6"
    )
    assert main(["new", "small", *parts.split()]) == 0
    out = capsys.readouterr().out
    commands = re.findall(r"^    impact-observer (.*)$", out, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["simulate", "observe"]
    assert "--deviation 0.003,0.003,0.5,0.5" in commands[1]
    assert "-p initial_deviation:=0.003,0.003,0.5,0.5" in out
    short = commands[0].replace("--duration 30", "--duration 0.5")
    assert [main(command.split()) for command in (short, commands[1])] == [0, 0]
    assert "applied" in capsys.readouterr().out


@pytest.mark.parametrize("there", FILES)
@pytest.mark.usefixtures("in_tmp_path")
def test_nothing_is_overwritten(there: str, capsys: pytest.CaptureFixture[str]) -> None:
    """An existing file stays, and no other file is left."""
    Path(there).write_text("mine")
    assert main(["new", "hammer", *HAMMER]) == 2
    assert f"{there}: is there already; choose another name" in capsys.readouterr().err
    assert Path(there).read_text() == "mine"
    assert [path.name for path in Path.cwd().iterdir()] == [there]


@pytest.mark.usefixtures("in_tmp_path")
def test_in_a_terminal_it_asks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A wrong answer is explained and asked again; the files are those of the arguments."""
    typed: Iterator[str] = iter(HAMMER)
    pairs = list(zip(typed, typed, strict=True))
    lines = {kind: [text for key, text in pairs if key == f"--{kind}"] for kind in ("mass",)}
    asked = answers(
        monkeypatch,
        *("cm", "", "x1,heavy", *lines["mass"], "", ""),
        *("ground,x1,10,0.1", "x1,x2,10,0.1", ""),
        *("x2,4,2.5", "", "anvil,x2,above,0.5,0.7", "", "/switch"),
    )
    assert main(["new", "asked"]) == 0
    assert "'heavy' is no number; expected NAME,MASS" in capsys.readouterr().out
    assert (
        asked[0]
        == asked[1]
        == ("unit: m of what moves along a line, rad or deg of what turns (m): ")
    )
    assert asked[2:5] == ["mass 1 (empty: no more): "] * 2 + ["mass 2 (empty: no more): "]
    assert asked[-1] == "sensor of anvil (/anvil): "
    assert main(["new", "hammer", *HAMMER]) == 0
    for name in FILES:
        other = Path(name.replace("hammer", "asked")).read_text()
        assert other.replace("asked", "hammer") == Path(name).read_text()


@pytest.mark.usefixtures("in_tmp_path")
def test_questions_and_comments_of_what_turns_have_its_units(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The model is that of radians, and its start is outside the stops, in degrees."""
    answers(
        monkeypatch,
        *("deg", "arm,0.02", "", "", "ground,arm,0.5,0.002", "", "arm,0.4,6", ""),
        *("left,arm,below,30,0.6", "", "/switch"),
    )
    assert main(["new", "pendulum"]) == 0
    printed = capsys.readouterr().out
    assert "mass: a body that turns, kg m^2" in printed
    assert "N m/rad, N m s/rad" in printed
    assert "reaches it at LIMIT, deg" in printed
    text = Path("pendulum.yaml").read_text(encoding="utf-8")
    assert "unit: deg" in text
    assert "# Stiffness in N m/rad, damping in N m s/rad." in text
    model = read_model("pendulum.yaml")
    assert model.system.q_r[0] == pytest.approx(-np.pi / 6)
    assert model.system.gap(model.initial_state()[0])[0] > 0


@pytest.mark.usefixtures("in_tmp_path")
def test_an_end_of_the_input_leaves_no_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The input ends with Ctrl-D in the middle of the questions."""
    answers(monkeypatch, "m", "x1,1")
    assert main(["new", "hammer"]) == 2
    assert "the input has ended: nothing is written" in capsys.readouterr().err
    assert not list(Path.cwd().iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--mass: none given"),
        (["--mass", "x1,1"], "--stop: none given"),
        (["--stop", "anvil,x1,above,1,1"], "hammer.yaml: bodies"),
    ],
)
@pytest.mark.usefixtures("in_tmp_path")
def test_without_a_terminal_parts_are_needed(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line shows one."""
    assert main(["new", "hammer", *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.usefixtures("in_tmp_path")
def test_a_rig_may_lie_in_a_folder_that_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    """The error names a missing folder."""
    assert main(["new", "rigs/hammer", *HAMMER]) == 2
    assert "rigs/hammer.yaml: cannot be written: No such file" in capsys.readouterr().err
    Path("rigs").mkdir()
    assert main(["new", "rigs/hammer", *HAMMER]) == 0
    assert sorted(path.name for path in Path("rigs").iterdir()) == sorted(FILES)
