# SPDX-License-Identifier: Apache-2.0
"""README's story and the tutorial run as typed."""

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stories import ROOT, Python, Run, Save, section, steps

from impact_observer.cli.main import main

RECORDING = section("README.md", "## A recording")
LIVE_RIG = section("README.md", "## Live")
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
PATIENCE = 90.0
"""How long the live system may take, s."""
LIVE = ("watch", "play", "record")
"""Commands that need ROS."""
WATCH = """
import json, sys
from impact_observer.model import read_model
from impact_observer.ros.watcher import Listener, watch

system = read_model(sys.argv[1]).system if sys.argv[1:] else None
watch(Listener(system), lambda view: print(json.dumps(view), flush=True))
"""
"""What ``watch`` shows, as lines; its argument is a model."""


def needs_ros(step: Run) -> bool:
    """Whether it is a node, or a command of the live system."""
    return bool(step.node) or step.words[0] in LIVE


@pytest.fixture
def beside_bags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the recorded bags, as in a clone."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    return tmp_path


@pytest.mark.slow
@pytest.mark.usefixtures("beside_bags")
def test_the_recording_of_the_readme_is_fitted(capsys: pytest.CaptureFixture[str]) -> None:
    """Every command works as typed, and the fit prints what README shows."""
    for step in steps(RECORDING):
        assert isinstance(step, Run)
        assert main(step.words) == 0, step
    (wanted,) = re.findall(r"^```\n(.*?)^```$", RECORDING, re.MULTILINE | re.DOTALL)
    assert capsys.readouterr().out.endswith(wanted)


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_the_tutorial_runs_block_by_block(capsys: pytest.CaptureFixture[str]) -> None:
    """Every file is saved, every command typed; what the page says of the results is so."""
    for step in steps(TUTORIAL):
        if isinstance(step, Save):
            Path(step.name).write_text(step.text, encoding="utf-8")
        elif not (isinstance(step, Run) and needs_ros(step)):
            assert isinstance(step, Run)
            assert main(step.words) == 0, step
    printed = capsys.readouterr().out.splitlines()
    said = {" ".join(line.split()) for line in printed}
    quoted = re.findall(
        r"^ {4}(?!\./dev|impact-observer|detector|observer|plant|monitor|--| )(.*)$",
        TUTORIAL,
        re.MULTILINE,
    )
    assert len(quoted) == 6
    for line in quoted:
        numbers = re.compile(r"(\d\.\d{1,6})\d*")  # the last digits are the processor's
        short = numbers.sub(r"\1", " ".join(line.split()))
        assert short in {numbers.sub(r"\1", each) for each in said}, line
    assert "Full rank after 4 impacts" in " ".join(said)
    assert "ok The model fits." in said


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_the_python_of_the_api_page_prints_what_the_page_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Events of one's own, a simulation, an identification: one program."""
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    for step in steps(page):
        assert isinstance(step, Python)
        exec(step.text, names)
    wanted = re.findall(r"^```text\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert len(wanted) == 2
    assert capsys.readouterr().out == "".join(wanted)


@pytest.mark.ros
def test_the_live_rig_of_the_readme_runs(
    ros_environment: dict[str, str], beside_bags: Path
) -> None:
    """Three terminals and watch, as typed: the estimate comes to the truth, as near as it says."""
    *nodes, play = [step for step in steps(LIVE_RIG) if isinstance(step, Run)]
    assert play.words == ("play", "bags/switch")
    watch = Run("", ("watch", "--model", "two_mass"))
    faster = ("--rate", "2")
    *_, last = watched([*nodes, watch, play], faster, ros_environment, beside_bags)
    (estimate,) = last["observers"]
    assert last["impacts"] >= 22  # and perhaps a false positive
    assert dict(estimate["counts"])["applied"] >= 15  # a busy machine stamps some wrongly
    assert estimate["law"] == "minimum-variance"
    error = np.abs(np.subtract(estimate["estimate"], estimate["truth"]))
    assert np.all(error < np.maximum(0.3, 5 * np.array(estimate["deviation"])))


@pytest.mark.ros
def test_the_tutorial_runs_live(
    ros_environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few seconds of the plant instead of an hour."""
    monkeypatch.chdir(tmp_path)
    for step in steps(TUTORIAL):
        if isinstance(step, Save):
            Path(step.name).write_text(step.text, encoding="utf-8")
    live = [step for step in steps(TUTORIAL) if isinstance(step, Run) and needs_ros(step)]
    live = [step for step in live if step.node != "detector"]  # of a rig that exists
    assert live[-1].node == "plant"
    views = watched(live, ("-p", "duration:=7.0"), ros_environment, tmp_path)
    (estimate,) = views[-1]["observers"]
    first = next(o["v"] for view in views for o in view["observers"] if o["v"] is not None)
    assert 0.4 < first < 2.7  # a busy machine sees the first second late
    assert 0 < estimate["v"] < 2e-3
    assert views[-1]["impacts"] == 4
    assert dict(estimate["counts"]) == {"applied": 4}
    assert estimate["truth"] is not None


def watched(
    live: Sequence[Run], faster: Sequence[str], environment: dict[str, str], folder: Path
) -> Any:  # noqa: ANN401 (JSON)
    """What ``watch`` shows, up to after the last command, which gets more arguments."""
    log, written = folder / "log", folder / "watch.jsonl"
    with ExitStack() as stack:
        out, err = (stack.enter_context(each.open("w")) for each in (written, log))

        def start(step: Run, more: Sequence[str] = ()) -> "subprocess.Popen[bytes]":
            command = [*step.process, *more]
            if step.words[:1] == ("watch",):
                command = [sys.executable, "-c", WATCH, *step.words[2:]]
            process = subprocess.Popen(command, env=environment, stdout=out, stderr=err)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        *others, last = live
        for step in others:
            start(step)
        nodes = sum(bool(step.node) for step in others)
        wait_until(lambda: log.read_text().count("; waits for") == nodes)
        wait_until(lambda: written.read_text().endswith("}\n"))
        assert start(last, faster).wait(timeout=PATIENCE) == 0
        pictures = written.read_text().count("\n")
        wait_until(lambda: written.read_text().count("\n") > pictures + 1)
        lines = written.read_text().splitlines(keepends=True)
        return [json.loads(line) for line in lines if line[-2:] == "}\n"]


def wait_until(condition: Callable[[], bool]) -> None:
    """Or fail, after a long time."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
