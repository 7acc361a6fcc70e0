# SPDX-License-Identifier: Apache-2.0
"""Signals: a command finishes or removes its unfinished work, and prints one line."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from inspect import CO_GENERATOR
from pathlib import Path
from types import CodeType, FrameType

import pytest

pytest.importorskip("rosbags")
from workloads import HOSTILE, OFFLINE, OUT, WITH_ROS, make_inputs

from impact_observer.cli.main import COMMANDS, main
from impact_observer.io.reader import BagReader
from impact_observer.plain_text import printable_lines

pytestmark = pytest.mark.slow
OFTEN = ("simulate", "observe", "fit", "import")
"""Commands that are interrupted in each run of the tests; the others in long ones."""


class Profile:
    """Counts the calls of this package's functions, and sends SIGTERM at one of them.

    Generators are left out: an exception at their start is lost in ``next`` of CPython 3.11.
    """

    def __init__(self, at: int | None = None) -> None:
        self.count = 0
        self.at = at
        self._counted: dict[CodeType, bool] = {}

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Handle a profiling event, as ``sys.setprofile`` passes it."""
        if event != "call":
            return
        code = frame.f_code
        if (counted := self._counted.get(code)) is None:
            room, _, module = frame.f_globals.get("__name__", "").partition(".")
            ours = room == "impact_observer" and module != "process_end"
            counted = self._counted[code] = ours and not code.co_flags & CO_GENERATOR
        if counted:
            self.count += 1
            if self.count == self.at:
                signal.raise_signal(signal.SIGTERM)


@contextlib.contextmanager
def profiling(at: int | None = None) -> Iterator[Profile]:
    """Count the calls in a block."""
    profile = Profile(at)
    sys.setprofile(profile)
    try:
        yield profile
    finally:
        sys.setprofile(None)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Inputs of the commands."""
    return make_inputs(tmp_path_factory.mktemp(f"inputs{HOSTILE}"))


def names(folder: Path) -> set[str]:
    """Names of the files below a folder."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_every_command_is_here() -> None:
    """A new command must be added to one of the two tables."""
    assert OFFLINE.keys() | WITH_ROS.keys() == COMMANDS.keys()


@pytest.mark.parametrize(
    "command", [c if c in OFTEN else pytest.param(c, marks=pytest.mark.long) for c in OFFLINE]
)
def test_sigterm_ends_a_command_in_order_wherever_it_comes(
    command: str,
    inputs: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The exit code is 143, with one line; outputs are whole or not there."""
    monkeypatch.chdir(tmp_path)
    arguments = [command, *(each.format(**inputs) for each in OFFLINE[command])]
    with profiling() as whole:
        assert main(arguments) == 0
    made = names(tmp_path)
    for share in (0.4, 0.97) if OUT in arguments else (0.7,):
        for path in tmp_path.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        capsys.readouterr()
        with profiling(max(1, int(share * whole.count))) as part:
            code = main(arguments)
        if code == 0 and part.count < (part.at or 0):
            continue  # the second run uses caches of the first
        errors = capsys.readouterr().err.splitlines()
        assert code == 143
        assert len(errors) == 1
        assert errors[0].startswith("impact-observer: ended by SIGTERM")
        assert names(tmp_path) <= made
        if (tmp_path / OUT).exists():
            with BagReader(tmp_path / OUT) as reader:
                assert len(list(reader.raw())) == reader.message_count


def is_up(command: str, process: int, folder: Path) -> bool:
    """Whether a command with ROS has begun its work, by a bag or a topic with our messages."""
    if command == "demo":
        return len(descendants(process)) >= 5 and any(folder.rglob("*.mcap"))
    if command == "record":
        return any(folder.rglob("*.mcap"))
    with contextlib.suppress(OSError):
        if command == "watch":  # no message of ours before the first publisher
            files = Path(f"/proc/{process}/fd").iterdir()
            return any("socket:" in str(each.readlink()) for each in files)
        return "impact_observer_msgs__rosidl" in Path(f"/proc/{process}/maps").read_text()
    return False


@pytest.mark.ros
@pytest.mark.parametrize("command", WITH_ROS)
def test_sigterm_ends_a_command_with_ros_in_order(
    command: str, inputs: dict[str, str], tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """No process is left, bags are readable, and only the demonstration was cut short.

    Control characters of names are escaped.
    """
    arguments = [each.format(**inputs) for each in WITH_ROS[command]]
    with (
        (tmp_path / "said").open("w") as said,
        subprocess.Popen(
            [sys.executable, "-m", "impact_observer", command, *arguments],
            env=ros_environment | {"PYTHONUNBUFFERED": "1"},
            cwd=tmp_path,
            text=True,
            stdout=said,
            stderr=subprocess.PIPE,
        ) as process,
    ):
        try:
            wait(lambda: is_up(command, process.pid, tmp_path))
            below = descendants(process.pid)
            process.send_signal(signal.SIGTERM)
            _, errors = process.communicate(timeout=90)
        finally:
            process.kill()
    assert process.returncode == (143 if command == "demo" else 0)
    assert "Traceback" not in errors
    shown = (tmp_path / "said").read_text() + errors
    assert printable_lines(shown) == shown
    wait(lambda: not any(Path(f"/proc/{each}").exists() for each in below))
    for file in tmp_path.rglob("metadata.yaml"):
        with BagReader(file.parent) as reader:
            assert len(list(reader.raw())) == reader.message_count


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag that takes an observer some seconds."""
    folder = tmp_path_factory.mktemp("long") / "plant"
    simulated = ["simulate", "two_mass", "--duration", "12", "--rate", "1000"]
    assert main([*simulated, "-o", str(folder)]) == 0
    return folder


@pytest.mark.parametrize(
    ("number", "code", "how"),
    [
        (signal.SIGINT, 1, "interrupted"),
        pytest.param(signal.SIGTERM, 143, "ended by SIGTERM", marks=pytest.mark.long),
    ],
)
def test_an_observer_that_is_interrupted_leaves_no_bag(
    plant: Path, tmp_path: Path, number: int, code: int, how: str
) -> None:
    """The command prints one line."""
    output = tmp_path / "estimates"
    command = [sys.executable, "-m", "impact_observer", "observe", str(plant), "-o", str(output)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait(lambda: any(each.stat().st_size > 2**20 for each in tmp_path.rglob("*.mcap")))
    process.send_signal(number)
    _, error = process.communicate(timeout=90)
    assert process.returncode == code
    assert error == f"impact-observer: {how}\n"
    assert not [*tmp_path.iterdir()]


def wait(done: Callable[[], object], patience: float = 90.0) -> None:
    """Wait until a condition holds."""
    until = time.monotonic() + patience
    while not done():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.01)


def descendants(process: int) -> set[int]:
    """The processes below one, by the kernel's table."""
    found: set[int] = set()
    for folder in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError, IndexError):
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == process:
                found |= {int(folder.name)} | descendants(int(folder.name))
    return found


def computes(process: int) -> bool:
    """Whether a process has used more of a processor than for its start, which is 0.6 s."""
    with contextlib.suppress(OSError):
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return int(fields[11]) + int(fields[12]) > 1.3 * os.sysconf("SC_CLK_TCK")
    return False


def test_a_sweep_that_is_killed_leaves_no_process_behind(tmp_path: Path) -> None:
    """No worker survives, and no file is made."""
    pytest.importorskip("pyarrow")
    path = tmp_path / "sweep.parquet"
    command = [sys.executable, "-m", "impact_observer", "sweep", "three_mass", "-o", str(path)]
    command += ["--laws", "minimum-variance", "--runs", "2000", "--jobs", "2"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        workers: set[int] = set()
        while sum(map(computes, workers)) < 2:
            workers = descendants(process.pid)
            assert process.poll() is None
            time.sleep(0.05)
        process.kill()
        process.wait(timeout=90)
    wait(lambda: not any(Path(f"/proc/{each}").exists() for each in workers))
    assert not [*tmp_path.iterdir()]
    assert os.getpid() not in workers
