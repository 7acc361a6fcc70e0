# SPDX-License-Identifier: Apache-2.0
"""``watch``: the table of messages, and of running processes over DDS."""

import fcntl
import io
import json
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from arms import PENDULUM, model_of
from processes import PATIENCE, ros_arguments, running_node
from rich.console import Console

from impact_observer.cli.main import main
from impact_observer.events import REVISED, ImpactEvent, Ruling, Switch, Verdict
from impact_observer.io import JointState
from impact_observer.io.messages import AnyMessage, bag_messages
from impact_observer.resources import shared
from impact_observer.ros.watcher import Listener, View, table, watch
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

MAKE, EPOCH = bag_messages(), 5 * NS_PER_S
WATCH = [sys.executable, "-m", "impact_observer", "watch"]


def truth(stamp: int, q: float, names: tuple[str, ...] = ("x1", "x2")) -> AnyMessage:
    """A true state at rest."""
    return MAKE.joint_state(JointState(stamp, names, np.full(len(names), q), np.zeros(len(names))))


def estimate(stamp: int, q: float, names: tuple[str, ...] = ("x1", "x2")) -> AnyMessage:
    """An estimate of a state at rest, with deviations of 0.1."""
    n = len(names)
    covariance = 0.01 * np.eye(2 * n)
    made = Estimate(stamp, "geometric", np.full(n, q), np.zeros(n), covariance=covariance)
    return MAKE.estimate(made, names)


def shown(view: View) -> str:
    """The table on a terminal, without repeated blanks."""
    console = Console(file=io.StringIO(), width=120, force_terminal=True)
    with console.capture() as capture:
        console.print(table(view))
    return " ".join(capture.get().split())


def test_each_rig_has_its_own_truth_epoch_and_v() -> None:
    """V is the energy of the difference, 1/2 dq' K dq: 0.1 m of both masses against 10 N/m."""
    listener = Listener()
    for k, rig in enumerate(("/a", "/b")):
        epoch = EPOCH + k * NS_PER_S
        event = ImpactEvent(epoch + NS_PER_S, (Switch("stop"),), epoch=epoch)
        model = shared("config/two_mass.yaml").read_text("utf-8")
        listener.receive(f"{rig}/plant/model", MAKE.model(model))
        listener.receive(f"{rig}/impacts", MAKE.event(event))
        listener.receive(f"{rig}/plant/joint_states", truth(epoch + NS_PER_S, 0.2 + k))
        for stamp in (epoch + NS_PER_S, epoch + 2 * NS_PER_S):  # the second one has no truth yet
            listener.receive(f"{rig}/observer/state", estimate(stamp, 0.1 + k))
    view = listener.view()
    assert view["impacts"] == 2
    for k, each in enumerate(view["observers"]):
        assert each["time"] == 1.0
        assert each["v"] == pytest.approx(0.5 * 10 * 0.1**2)
        assert each["truth"] == [0.2 + k, 0.2 + k, 0.0, 0.0]
        assert each["deviation"] == pytest.approx([0.1] * 4)
    text = shown(view)
    assert "/a/observer (geometric) t = 1.000 s V = 5.00e-02 J" in text
    assert "x1 m or rad +0.100000 1.0e-01 +0.200000" in text


def test_without_a_truth_or_a_model_there_is_an_estimate_and_no_v() -> None:
    """A truth of other coordinates, or one that is no number, is no truth."""
    listener = Listener()
    listener.receive("/plant/joint_states", truth(EPOCH, 0.0, ("a", "b")))
    broken = truth(EPOCH + 1, 0.0)
    broken.position[0] = np.nan
    listener.receive("/plant/joint_states", broken)
    listener.receive("/observer/state", estimate(EPOCH, 0.3))
    view = listener.view()
    (observer,) = view["observers"]
    assert (observer["v"], observer["truth"]) == (None, None)
    assert "x1 +0.300000 1.0e-01" in shown(view)
    assert "V = unknown" in shown(view)
    assert view["warning"].startswith("/plant/joint_states: not understood")


def test_v_of_a_robot_has_the_mass_at_the_true_position_and_no_turns() -> None:
    """A pendulum of 1 kg m^2: half of the square of what is left beside a whole turn."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    listener, names = Listener(), ("hinge",)
    listener.receive("/plant/model", MAKE.model(model_of(PENDULUM, "hinge").text()))
    listener.receive("/plant/joint_states", truth(EPOCH, 0.5, names))
    listener.receive("/observer/state", estimate(EPOCH, 0.6 + 2 * np.pi, names))
    (view,) = listener.view()["observers"]
    assert view["v"] == pytest.approx(0.1**2 / 2, rel=1e-12)
    assert view["units"] == ["rad", "rad/s"]


def test_verdicts_are_counted_and_words_of_strangers_are_escaped() -> None:
    """The last ones are shown first; one that revises another is not counted again."""
    listener = Listener()
    listener.receive("/rig/observer/state", estimate(EPOCH, 0.0))
    for k, ruling in enumerate((Ruling.APPLIED, Ruling.APPLIED, Ruling.REJECTED)):
        reason = f"{REVISED}\x1b]0;why" if k == 2 else ""
        verdict = Verdict(EPOCH + k, ruling, 1, "\x1b[2Jstop", reason)
        listener.receive("/rig/observer/verdicts", MAKE.verdict(verdict))
    view = listener.view()
    (observer,) = view["observers"]
    assert observer["counts"] == {"applied": 2}
    assert [each["verdict"] for each in observer["verdicts"]] == ["rejected", "applied", "applied"]
    assert "\\x1b[2Jstop rejected revised: \\x1b]0;why" in shown(view)
    kind = "impact_observer_msgs/msg/ObserverState"
    assert listener.wants("/rig/observer/state", kind)
    assert not listener.wants("/rig/observer/state", "std_msgs/msg/String")


@contextmanager
def system(environment: dict[str, str]) -> Iterator[None]:
    """A plant and its observer, as processes."""
    observer = {"model": "two_mass", "initial_state": "'random:1'", "rate": 20.0}
    plant = {"model": "two_mass", "rate": 20.0}
    with ExitStack() as stack:
        for module, parameters in (("observer", observer), ("plant", plant)):
            stack.enter_context(running_node(module, ros_arguments(parameters), environment))
        yield


def on_terminal(environment: dict[str, str]) -> tuple[int, str]:
    """Run in a terminal until an observer is shown, then Ctrl-C: exit code and output."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    environment = {**environment, "TERM": "xterm-256color"}
    process = subprocess.Popen(
        WATCH, env=environment, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    )
    os.close(theirs)
    output = b""
    try:
        while b"dx2/dt" not in output:
            output += os.read(ours, 65536)
        process.send_signal(signal.SIGINT)
        while chunk := os.read(ours, 65536):
            output += chunk
    except OSError:  # Linux: the other end is closed
        pass
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    return process.returncode, output.decode(errors="replace")  # Ctrl-C may cut a character


@pytest.mark.ros
def test_watch_shows_running_processes(ros_environment: dict[str, str]) -> None:
    """In this process with truth and V, and as a table in a terminal until Ctrl-C."""

    def show(view: View) -> None:
        if view["observers"] and view["observers"][0]["v"] is not None:
            signal.raise_signal(signal.SIGINT)

    with system(ros_environment):
        view = watch(Listener(), show, PATIENCE)
        code, text = on_terminal(ros_environment)
    (observer,) = json.loads(json.dumps(view))["observers"]
    assert (observer["name"], observer["law"]) == ("/observer", "geometric")
    error = np.array(observer["estimate"]) - observer["truth"]
    K = np.array([[20, -10], [-10, 10]])
    assert observer["v"] == pytest.approx(
        error[:2] @ K @ error[:2] / 2 + error[2:] @ error[2:] / 2
    )
    assert code == 0
    assert "/observer (geometric)" in text
    assert text.rfind("\x1b[?25h") > text.rfind("\x1b[?25l")  # the cursor is shown again


@pytest.mark.ros
def test_watch_says_that_nothing_is_there(
    ros_environment: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code after --duration is then 1."""
    assert ros_environment
    assert main(["watch", "--duration", "0.5"]) == 1
    assert "waiting for observers" in capsys.readouterr().out
