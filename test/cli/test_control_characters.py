# SPDX-License-Identifier: Apache-2.0
"""Names with control characters: refused in models, escaped where they are shown.

For commands with ROS see test_interrupted.
"""

import ast
from pathlib import Path

import pytest

pytest.importorskip("rosbags")
from workloads import HOSTILE, OFFLINE, make_inputs

import impact_observer
from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagWriter
from impact_observer.io.messages import bag_messages
from impact_observer.plain_text import printable_lines
from impact_observer.resources import shared


def shown(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Output of a command on both streams."""
    main(arguments)
    return "".join(capsys.readouterr())


@pytest.mark.parametrize("command", ["check", "observe"])
def test_names_in_a_bag_do_not_control_the_terminal(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The names are those of contacts and of the bag itself."""
    make, bag = bag_messages(), tmp_path / f"bag{HOSTILE}"
    with BagWriter(bag) as writer:
        text = shared("config/two_mass.yaml").read_text("utf-8")
        writer.write("/plant/model", 1, make.model(text))
        for k in range(1, 4):
            event = ImpactEvent(k * 1_000_000_000, (Switch(HOSTILE),), k, 1, 1_000_000_000)
            writer.write("/impacts", event.stamp, make.event(event))
    arguments = [command, str(bag)]
    if command == "observe":
        arguments += ["--rate", "10", "-o", str(tmp_path / f"out{HOSTILE}")]
    text = shown(arguments, capsys)
    assert "\x1b" not in text
    assert "\x07" not in text
    assert "\\x1b[2J" in text


@pytest.mark.parametrize("key", ["name: two_mass", "coordinates: [x1, x2]", "name: stop"])
def test_a_model_with_a_name_that_cannot_be_printed_is_refused(
    key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No log, XML or HTML gets an unprintable name."""
    text = shared("config/two_mass.yaml").read_text("utf-8")
    assert key in text
    hostile = key.replace("two_mass", '"a\\eb"').replace("x1", '"a\\eb"')
    hostile = hostile.replace("stop", '"a\\eb"')
    (tmp_path / "model.yaml").write_text(text.replace(key, hostile, 1), "utf-8")
    found = shown(["check-model", str(tmp_path / "model.yaml")], capsys)
    assert found.count("\n") == 1
    assert "'a\\x1bb' found" in found


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Inputs of the commands, in a folder with a hostile name."""
    return make_inputs(tmp_path_factory.mktemp(f"inputs{HOSTILE}"))


@pytest.mark.slow
@pytest.mark.parametrize("command", OFFLINE)
def test_no_command_shows_or_writes_control_characters(
    command: str,
    inputs: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Names of files are escaped on the terminal and in written text."""
    monkeypatch.chdir(tmp_path)
    given = [each.format(**inputs) for each in OFFLINE[command]]
    given = [HOSTILE + each if each.startswith("out") else each for each in given]
    assert main([command, *given]) == 0
    text = "".join(capsys.readouterr())
    assert printable_lines(text) == text
    for file in tmp_path.rglob("*"):
        if file.suffix in {".html", ".svg", ".xml", ".yaml", ".json"}:
            written = file.read_text("utf-8")
            assert printable_lines(written) == written


def test_nodes_log_nothing_but_what_can_be_printed() -> None:
    """Each logged line is a constant, or goes through ``printable``."""
    found = []
    for file in (Path(impact_observer.__file__).parent / "ros").rglob("*.py"):
        for call in ast.walk(ast.parse(file.read_text("utf-8"))):
            if not (isinstance(call, ast.Call) and ".get_logger()." in ast.unparse(call.func)):
                continue
            (line,) = call.args
            if not isinstance(line, ast.Constant) and ast.unparse(line)[:10] != "printable(":
                found.append(f"{file.name}: {ast.unparse(call)}")
    assert found == []
