# SPDX-License-Identifier: Apache-2.0
"""``watch`` on running processes, and the diagnostics of an observer node."""

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from plotting_tools import DIAGNOSTICS, message_path, plotjuggler_series, resolved
from processes import PATIENCE, ros_arguments, running_node

from impact_observer.draw.curves import curves
from impact_observer.draw.observer_topics import ObserverTopics
from impact_observer.io.typestores import deserialize, typestore
from impact_observer.model import read_model
from impact_observer.ros.watch.snapshot import Snapshot
from impact_observer.ros.watch.topic_listener import TopicListener
from impact_observer.ros.watch.watch_session import watch

pytestmark = pytest.mark.ros
WATCH = [sys.executable, "-m", "impact_observer", "watch"]
IN_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)  # so that the keys are for it
os.execv(sys.argv[1], sys.argv[1:])
"""


@contextmanager
def system(environment: dict[str, str]) -> Iterator[None]:
    """A plant, its observer and its monitor, as processes."""
    simulated = {"model": "two_mass", "use_sim_time": True}
    with ExitStack() as stack:
        observer = ros_arguments(
            {
                **simulated,
                "initial_state": "'random:1'",
                "rate": 20.0,
                "events_durability": "transient_local",
            }
        )
        plant = ros_arguments({"model": "two_mass", "rate": 20.0, "publish_clock": True})
        for module, arguments in (
            ("observer", observer),
            ("monitor", ros_arguments(simulated)),
            ("plant", plant),
        ):
            stack.enter_context(running_node(module, arguments, environment))
        yield


class Keeping(TopicListener):
    """Keeps what is received on ``/diagnostics`` as it came, too."""

    def __init__(self) -> None:
        super().__init__()
        self.diagnostics: list[bytes] = []

    def receive(self, topic: str, data: bytes, arrived: float, wall: int) -> None:
        """Take in a message."""
        if topic == "/diagnostics":
            self.diagnostics.append(data)
        super().receive(topic, data, arrived, wall)


def started(arguments: list[str], environment: dict[str, str]) -> "subprocess.Popen[str]":
    """``watch`` whose output is no terminal."""
    return subprocess.Popen(
        [*WATCH, *arguments],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def screen_of(environment: dict[str, str]) -> tuple[int, str, bool]:
    """Run in a terminal, freeze, go on, end by q: exit code, output, terminal as before."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 80, 0, 0))
    before = termios.tcgetattr(theirs)
    process = subprocess.Popen(
        [sys.executable, "-c", IN_TERMINAL, *WATCH],
        env={**environment, "TERM": "xterm-256color"},
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    output = b""
    try:
        for sought, key in ((b"certified", b" "), (b"FROZEN", b" "), (b"space freezes", b"q")):
            start, end = len(output), time.monotonic() + PATIENCE
            while output.find(sought, start) < 0:
                assert time.monotonic() < end, output[-2000:]
                output += received(ours)
            assert not termios.tcgetattr(theirs)[3] & termios.ICANON
            os.write(ours, key)
        while process.poll() is None:
            output += received(ours)
        output += received(ours)
        return process.returncode, output.decode(), termios.tcgetattr(theirs) == before
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)


def received(terminal: int) -> bytes:
    """What has been written to a terminal, within a tenth of a second."""
    return os.read(terminal, 65536) if select.select([terminal], [], [], 0.1)[0] else b""


def test_watch_shows_running_processes(ros_environment: dict[str, str]) -> None:
    """In this process, in a terminal by keys, as lines until Ctrl-C, and once as JSON."""
    seen: list[Snapshot] = []
    listener = Keeping()

    def is_known() -> bool:
        """Processes find each other one by one, the plant not always before its observer."""
        if not seen or not seen[-1].observers:
            return False
        whole, own = seen[-1], seen[-1].observers[0]
        plant = whole.model and whole.truth and whole.simulated and own.source == "monitor"
        # Diagnostics may be older than the first estimate.
        diagnosed = own.health and b"synchronized" in listener.diagnostics[-1]
        return bool(plant and diagnosed and own.verdicts and own.bound is not None)

    with system(ros_environment), ExitStack() as stack:
        lines = stack.enter_context(started([], ros_environment))
        stack.callback(lines.kill)
        once = ["--once", "--json", "--observers", "observer", "--duration", f"{PATIENCE}"]
        look = stack.enter_context(started(once, ros_environment))
        stack.callback(look.kill)
        watch(
            listener,
            seen.append,
            rate=10.0,
            keep_on=lambda: not is_known(),
            duration=PATIENCE,
        )
        check_snapshot(seen[-1])
        check_diagnostics(listener.diagnostics)
        code, text, restored = screen_of(ros_environment)
        assert (code, restored) == (0, True)
        assert text.count("\x1b[?1049h") == text.count("\x1b[?1049l") == 1
        assert text.rfind("\x1b[?25h") > text.rfind("\x1b[?25l")
        written, errors = look.communicate(timeout=PATIENCE)
        assert (look.returncode, errors) == (0, "")
        assert json.loads(written)["observers"][0]["law"] == "geometric"
        lines.send_signal(signal.SIGINT)
        written, errors = lines.communicate(timeout=PATIENCE)
        assert (lines.returncode, errors) == (0, "")
        assert re.search(r"^t = .* impacts, last .*; observer: V \S+ J", written, re.MULTILINE)
        assert "\x1b" not in written


def check_snapshot(seen: Snapshot) -> None:
    """The estimate against the truth, by the clock of the stamps."""
    (observer,) = seen.observers
    assert (seen.model, seen.truth, seen.simulated, seen.trouble) == ("two_mass", True, True, "")
    assert (observer.name, observer.law, observer.source) == ("/observer", "geometric", "monitor")
    assert observer.lines[0].truth is not None
    assert observer.distance.now is not None
    assert observer.distance.now > 0
    assert observer.bound is not None
    topics = {flow.topic for flow in (*observer.flows, *seen.flows)}
    assert {"/observer/state", "/monitor/error", "/plant/joint_states", "/clock"} <= topics


def check_diagnostics(data: list[bytes]) -> None:
    """The diagnostics that layouts draw are published by a node, as numbers."""
    name = "diagnostic_msgs/msg/DiagnosticArray"
    message = deserialize(typestore(), data[-1], name)
    found = curves(read_model("two_mass").system, [ObserverTopics.of_node("observer")])
    own = [curve for curve in found if curve.tab == "diagnostics"]
    assert len(own) > 5
    flat = plotjuggler_series("/diagnostics", message)
    for curve in own:
        (value,) = resolved(message_path(curve.path), message)
        assert float(value) >= 0  # type: ignore[arg-type]
        assert isinstance(flat[curve.series], float)
    said = {key.rpartition("/")[2] for key in flat}
    assert DIAGNOSTICS.keys() <= said


def test_watch_names_a_missing_observer(ros_environment: dict[str, str], tmp_path: Path) -> None:
    """In words, and by exit code 1 with --once."""
    done = subprocess.run(
        [*WATCH, "--once", "--duration", "0.5"],
        env=ros_environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    assert (done.returncode, done.stderr) == (1, "")
    assert "nothing received yet: no plant, no observer" in done.stdout
    assert "waiting for observers" in done.stdout
