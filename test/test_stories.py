"""README's story and the tutorial run as typed."""

import json
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from stories import ROOT, Run, Save, section, steps

from impact_observer.cli.main import main

OWN_RIG = section("README.md", "## Your own rig")
PATIENCE = 90.0
"""How long the live system may take, s."""
LIVE = ("detector", "observer", "watch", "play")
"""Nodes and commands that need ROS."""


def needs_ros(step: Run) -> bool:
    """Whether it is a node, or a command of the live system."""
    return bool(step.node) or step.words[0] in LIVE


@pytest.fixture
def beside_bags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with README's files and with the recorded bags, as in a clone."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    for step in steps(OWN_RIG):
        if isinstance(step, Save):
            (tmp_path / step.name).write_text(step.text, encoding="utf-8")
    return tmp_path


@pytest.mark.slow
@pytest.mark.usefixtures("beside_bags")
def test_the_recording_of_the_readme_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    """Every command works as typed; the model fits, and the impacts determine the state."""
    typed = [step for step in steps(OWN_RIG) if isinstance(step, Run) and not needs_ros(step)]
    assert [step.words[0] for step in typed][:2] == ["check-model", "detect"]
    for step in typed:
        assert main(step.words) == 0, step
    said = " ".join(capsys.readouterr().out.split())
    for expected in (
        "Every mode moves some contact",
        "anvil: 22 impacts",
        "all 4 numbers of the state are determined",
        "The model fits.",
        "verdicts: 22 applied",
    ):
        assert expected in said
    assert Path("motion.png").stat().st_size > 10_000


@pytest.mark.ros
def test_the_rig_of_the_readme_runs_live(
    ros_environment: dict[str, str], beside_bags: Path
) -> None:
    """Four terminals, as typed, only faster: the estimate comes to the truth."""
    detector, observer, watch, play = (
        step for step in steps(OWN_RIG) if isinstance(step, Run) and needs_ros(step)
    )
    log, written = beside_bags / "log", beside_bags / "watch.jsonl"
    with ExitStack() as stack:
        out, err = (stack.enter_context(each.open("w")) for each in (written, log))

        def start(step: Run, *more: str) -> "subprocess.Popen[bytes]":
            process = subprocess.Popen(
                [*step.process, *more], env=ros_environment, stdout=out, stderr=err
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        for step in (detector, observer):
            start(step)
        start(watch, "--json")
        wait_until(lambda: log.read_text().count("; waits for") == 2 and written.read_text() != "")
        assert start(play, "--rate", "3").wait(timeout=PATIENCE) == 0
        wait_until(lambda: shown(written)["impacts"] >= 22)  # and perhaps a false positive
    (estimate,) = shown(written)["observers"]
    assert estimate["law"] == "minimum-variance"
    assert dict(estimate["counts"])["applied"] >= 20
    assert all(abs(line["estimate"] - line["truth"]) < 0.3 for line in estimate["lines"])


def shown(written: Path) -> Any:  # noqa: ANN401 (JSON)
    """The last picture of ``watch --json``."""
    lines = [line for line in written.read_text().splitlines() if line.endswith("}")]
    return json.loads(lines[-1])


def wait_until(condition: Callable[[], bool]) -> None:
    """Or fail, after a long time."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
