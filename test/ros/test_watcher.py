# SPDX-License-Identifier: Apache-2.0
"""The screen of ``watch``: of messages, of a bag, and of running processes."""

import fcntl
import io
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from arms import PENDULUM, SLIDER, model_of
from plotting_tools import DIAGNOSTICS, EPOCH, diagnostics, everything
from processes import PATIENCE, ros_arguments, running_node
from rich.cells import cell_len
from rich.console import Console

from impact_observer.dynamics.lyapunov import distance
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Ruling, Switch, Verdict
from impact_observer.io import BagReader, JointState
from impact_observer.io.messages import AnyMessage, bag_messages
from impact_observer.model import read_model
from impact_observer.resources import shared
from impact_observer.robots import Robot
from impact_observer.ros.watcher import (
    Listener,
    ObserverView,
    StateLine,
    View,
    line,
    screen,
    watch,
)
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

LAWS = {"observer": "geometric", "observer_minimum_variance": "minimum-variance"}
MAKE = bag_messages()
WATCH = [sys.executable, "-m", "impact_observer", "watch"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 6 s: a plant and two observers."""
    return everything(tmp_path_factory.mktemp("watched") / "bag", LAWS, duration=6.0)


def truth(stamp: int, names: tuple[str, ...] = ("x1", "x2"), q: float = 0.0) -> AnyMessage:
    """A true state at rest."""
    return MAKE.joint_state(JointState(stamp, names, np.full(len(names), q), np.zeros(len(names))))


def estimate(stamp: int, q: float = 0.0) -> AnyMessage:
    """An estimate of the state of two_mass at rest."""
    return MAKE.estimate(Estimate(stamp, "geometric", np.full(2, q), np.zeros(2)), ("x1", "x2"))


def received(bag: Path, listener: Listener, without: Collection[str] = ()) -> View:
    """The view after all messages of a bag, with views in between."""
    with BagReader(bag) as reader:
        for k, (topic, stamp, data) in enumerate(reader.raw()):
            if topic not in without and listener.wants(topic, reader.topics[topic].type):
                listener.receive(topic, reader.decoder(topic)(data))
            if k % 500 == 0:
                listener.view(stamp)
        return listener.view(reader.end)


def test_estimates_are_shown_against_the_truth_of_their_stamp(bag: Path) -> None:
    """Estimate, truth, deviation and V are those of the bag at its end."""
    view = received(bag, Listener())
    assert (view.model, view.truth, view.epoch) == ("two_mass", True, EPOCH)
    assert [each.name for each in view.observers] == ["/observer", "/observer_minimum_variance"]
    system = read_model("two_mass").system
    with BagReader(bag) as reader:
        true = reader.joint_states("/plant/joint_states")
        for each in view.observers:
            states = reader.observer_states(f"{each.name}/state")
            assert each.stamp == states.stamps[-1]
            assert [line.estimate for line in each.lines] == [*states.q[-1], *states.u[-1]]
            assert [line.truth for line in each.lines] == [*true.q[-1], *true.u[-1]]
            assert [line.unit for line in each.lines] == ["m", "m", "m/s", "m/s"]
            q, u = states.q[-1] - true.q[-1], states.u[-1] - true.u[-1]
            assert each.v == pytest.approx(float(distance(system, q, u)))
            assert each.history[-1] == each.v
            assert each.history[-1] < 0.5 * each.history[0]
        events = list(reader.events())
        verdicts = list(reader.verdicts("/observer/verdicts"))
    assert (view.impacts, view.last_impact) == (len(events), (events[-1].stamp, "stop"))
    plain, filters = view.observers
    assert plain.counts == {"applied": len(verdicts)}
    assert [verdict for verdict, _ in plain.verdicts] == verdicts[::-1][:8]
    assert all(line.deviation is None for line in plain.lines)
    assert all(line.deviation is not None and line.deviation > 0 for line in filters.lines)
    assert plain.bound is not None
    assert filters.bound is None
    assert json.loads(json.dumps(asdict(view)))["observers"][0]["law"] == "geometric"


def test_v_needs_the_truth_and_a_model(bag: Path) -> None:
    """A given model takes the place of the model that the plant publishes."""
    system = read_model("two_mass").system
    assert received(bag, Listener(), ["/plant/model"]).observers[0].v is None
    named = received(bag, Listener(system=system), ["/plant/model"]).observers[0]
    assert named.v == received(bag, Listener()).observers[0].v
    alone = received(bag, Listener(), ["/plant/joint_states"])
    assert not alone.truth
    assert (alone.observers[0].v, alone.observers[0].lines[0].truth) == (None, None)


def test_a_view_is_complete_when_it_has_what_it_can_show() -> None:
    """An estimate suffices alone; beside a plant it needs the truth of its stamp, and gives V."""
    listener = Listener()
    assert not listener.view(0).is_complete
    listener.receive("/observer/state", estimate(5))
    assert listener.view(0).is_complete
    listener.receive("/plant/joint_states", truth(4))
    assert not listener.view(0).is_complete
    listener.receive("/plant/joint_states", truth(5))
    assert listener.view(0).is_complete
    listener.receive("/plant/model", MAKE.model(shared("config/two_mass.yaml").read_text()))
    assert listener.view(0).is_complete
    assert listener.view(0).observers[0].v == 0


def test_diagnostics_go_to_their_observer() -> None:
    """Health, the reason of no agreement, and sensors are told apart by the names of statuses."""
    listener = Listener(["observer", "rig/observer"])
    for name, level in (("/observer", 1), ("/rig/observer", 2), ("/elsewhere", 0)):
        listener.receive("/diagnostics", diagnostics(name, "two_mass", level, f"of {name}"))
    message = diagnostics("/observer", "two_mass", 1, "no sample yet")
    message.status[0].name = "/observer: sensor encoder"  # type: ignore[attr-defined]
    listener.receive("/diagnostics", message)
    message = diagnostics("/rig/observer", "two_mass", 2, "of /rig/observer")
    (value, *_) = message.status[0].values  # type: ignore[attr-defined]
    value.key, value.value = "not synchronized", "one replica"
    listener.receive("/diagnostics", message)
    first, second = listener.view(EPOCH).observers
    assert (first.health, second.health) == ((1, "of /observer"), (2, "of /rig/observer"))
    assert (first.obstacle, second.obstacle) == ("", "one replica")
    assert first.sensors == {"encoder": (1, "no sample yet")}


def test_topics_of_several_nodes_are_a_warning_until_one_is_left() -> None:
    """The clock and the diagnostics, which all nodes share, give no warning."""
    listener = Listener()
    listener.note_publishers({"/observer/state": 2, "/diagnostics": 2, "/clock": 2})
    (warning,) = listener.view(EPOCH).warnings
    assert warning.startswith("several nodes publish /observer/state, and what is shown is a")
    listener.note_publishers({"/observer/state": 1})
    assert listener.view(EPOCH).warnings == ()


def test_only_wanted_observers_are_received() -> None:
    """The plant is always received; other topics and types never."""
    listener = Listener(["observer_a"])
    joint, state = "sensor_msgs/msg/JointState", "impact_observer_msgs/msg/ObserverState"
    wanted = {
        ("/observer_a/state", state): True,
        ("/observer_b/state", state): False,
        ("/plant/joint_states", joint): True,
        ("/plant/joint_states", state): False,
        ("/camera", joint): False,
    }
    assert {each: listener.wants(*each) for each in wanted} == wanted
    assert Listener().wants("/observer_b/state", state)
    assert [each.name for each in listener.view(EPOCH).observers] == ["/observer_a"]
    with pytest.raises(UsageError, match="no name of a node"):
        Listener(["no name"])


def test_a_clock_that_jumps_back_restarts() -> None:
    """The second pass of a bag shows nothing of the first pass."""
    listener = Listener(["observer"])
    for stamp in (EPOCH, EPOCH + 9 * NS_PER_S):
        listener.receive("/clock", MAKE.clock(stamp))
        listener.receive("/plant/joint_states", truth(stamp))
        listener.receive("/observer/state", estimate(stamp))
    view = listener.view(0)
    assert (view.simulated, view.clock) == (True, EPOCH + 9 * NS_PER_S)
    assert view.observers[0].stamp == EPOCH + 9 * NS_PER_S
    listener.receive("/clock", MAKE.clock(EPOCH + NS_PER_S))
    view = listener.view(0)
    assert (view.observers[0].lines, view.truth) == ((), False)


def test_a_truth_of_other_coordinates_is_not_shown() -> None:
    """The estimate is shown alone."""
    listener = Listener(system=read_model("two_mass").system)
    listener.receive("/plant/joint_states", truth(EPOCH, ("a", "b")))
    listener.receive("/observer/state", estimate(EPOCH))
    (seen,) = listener.view(EPOCH).observers
    assert [each.truth for each in seen.lines] == [None] * 4
    assert seen.v is None


def test_v_of_a_robot_has_the_mass_at_the_true_position() -> None:
    """A cart of 2 kg on a rail: half its mass times both squares; units are those of the joint."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    model, listener = model_of(SLIDER, "rail"), Listener()
    listener.receive("/plant/model", MAKE.model(model.text()))
    listener.receive("/plant/joint_states", truth(EPOCH, ("rail",), q=0.5))
    state = Estimate(EPOCH, "minimum-variance", np.array([0.8]), np.array([0.4]))
    listener.receive("/observer/state", MAKE.estimate(state, ("rail",)))
    (view,) = listener.view(EPOCH).observers
    assert view.v == pytest.approx(2.0 * (0.3**2 + 0.4**2) / 2, rel=1e-12)
    assert [each.unit for each in view.lines] == ["m", "m/s"]
    listener = Listener(system=Robot(model_of(PENDULUM, "hinge")))
    listener.receive("/plant/joint_states", truth(EPOCH, ("hinge",), q=0.5))
    state = Estimate(EPOCH, "minimum-variance", np.array([0.6 + 2 * np.pi]), np.array([0.2]))
    listener.receive("/observer/state", MAKE.estimate(state, ("hinge",)))
    (view,) = listener.view(EPOCH).observers
    assert view.v == pytest.approx((0.1**2 + 0.2**2) / 2, rel=1e-12), "a turn is no error"
    assert [each.unit for each in view.lines] == ["rad", "rad/s"]


def test_a_message_without_sense_is_a_warning() -> None:
    """Later messages are received."""
    listener = Listener()
    message = truth(EPOCH)
    message.position[0] = np.nan
    listener.receive("/plant/joint_states", message)
    listener.receive("/observer/state", estimate(EPOCH))
    view = listener.view(EPOCH)
    assert view.warnings[0].startswith("not understood: /plant/joint_states: JointState.position")
    assert view.observers[0].lines


def test_rigs_have_their_own_truth_and_epoch() -> None:
    """Two rigs have no common epoch."""
    listener = Listener()
    for k, rig in enumerate(("/a", "/b")):
        epoch = EPOCH + k * NS_PER_S
        event = ImpactEvent(epoch + NS_PER_S, (Switch("stop", Kind.IMPACT),), epoch=epoch)
        listener.receive(f"{rig}/impacts", MAKE.event(event))
        listener.receive(f"{rig}/plant/joint_states", truth(EPOCH, q=1.0 + k))
        listener.receive(f"{rig}/observer/state", estimate(EPOCH))
    view = listener.view(EPOCH)
    assert [each.lines[0].truth for each in view.observers] == [1.0, 2.0]
    assert [each.epoch for each in view.observers] == [EPOCH, EPOCH + NS_PER_S]
    assert view.epoch == 0


def seconds(time: float) -> int:
    """A stamp by its time since the epoch."""
    return EPOCH + round(time * NS_PER_S)


GEOMETRIC = ObserverView(
    "/observer_geometric",
    law="geometric",
    stamp=seconds(12.34),
    lines=(
        StateLine("x1", "m", 0.123456789, 0.12),
        StateLine("x2", "m/s", 12345.678, 12345.0),
    ),
    v=0.02,
    history=(40.0, 3.0, 0.02),
    convergence=1.0,
    synchronized=False,
    obstacle="one replica only",
    bound=436.4,
    closed=("stop",),
    verdicts=(
        (Verdict(seconds(12.0), Ruling.APPLIED, 3, "stop"), 0.0021),
        (Verdict(seconds(10.5), Ruling.REJECTED, 2, "stop", "nothing has happened"), 0.0),
    ),
    counts={"applied": 7, "rejected": 1},
    health=(1, "1 events were not applied"),
    sensors={"encoder": (0, "10 samples")},
)
FILTER = ObserverView(
    "/observer_minimum_variance",
    law="minimum-variance",
    stamp=seconds(12.34),
    lines=(StateLine("x1", "m", 0.125, 0.12, 1e-9),),
    v=1e-19,
    convergence=-1.0,
    synchronized=True,
    learned=(("clock_error", 2.9e-4, 1e-5),),
)
BOTH = View(
    seconds(12.35),
    simulated=True,
    epoch=EPOCH,
    model="two_mass",
    truth=True,
    impacts=8,
    last_impact=(seconds(12.0), "stop"),
    observers=(GEOMETRIC, FILTER),
    warnings=("something is doubtful",),
)


def shown(view: View, width: int = 160, height: int | None = 50) -> list[str]:
    """The rows on a terminal of that size."""
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=False)
    with console.capture() as capture:
        console.print(screen(view, console, height))
    return capture.get().splitlines()


@pytest.mark.parametrize(
    "words",
    [
        "two_mass t = 12.35 s (/clock) 8 impacts, last 0.3 s ago (stop)",
        "something is doubtful",
        "observer_geometric (geometric)",
        "V 2.00e-02 J",
        "convergence 1.00e+00 J between replicas, not synchronized: one replica only",
        "bound V <= 436 J certified",
        "closed stop",
        "health warning: 1 events were not applied",
        "sensor encoder: 10 samples",
        "x1 m +0.123457 +0.120000 +3.5e-03",
        "x2 m/s +1.23457e+04 +1.23450e+04 +6.8e-01",
        "events 7 applied, 1 rejected",
        "12.000000 s stop applied 2.1 ms",
        "10.500000 s stop rejected nothing has happened",
        "observer_minimum_variance (minimum-variance)",
        "V 1.00e-19 J",
        "one replica, synchronized",
        "learned clock error [s] 0.000290 +- 1e-05",
        "x1 m +0.125000 +0.120000 +5.0e-03 1.0e-09",
    ],
)
def test_the_screen_shows(words: str) -> None:
    """Everything of a view is on a terminal with room for both observers."""
    text = " ".join(" ".join(shown(replace(BOTH, observers=(each,)))) for each in BOTH.observers)
    assert words in " ".join(text.split())


@pytest.mark.parametrize(("width", "height"), [(80, 24), (60, 18), (160, 24), (160, 50)])
def test_the_screen_fits(width: int, height: int) -> None:
    """An observer without room is named."""
    rows = shown(BOTH, width, height)
    assert len(rows) <= height
    assert max(map(cell_len, rows)) <= width
    text = "\n".join(rows)
    assert "V  2.00e-02 J" in text
    hidden = "shown with --observers: observer_minimum_variance" in text
    assert hidden != ("V  1.00e-19 J" in text)
    assert hidden == (height == 18)


@pytest.mark.parametrize(
    ("observer", "changes", "words"),
    [
        (ObserverView("/observer"), {}, "no estimate yet"),
        (ObserverView("/observer"), {}, "waiting for impacts ..."),
        (ObserverView("/observer"), {}, "no diagnostics yet"),
        (ObserverView("/observer"), {}, "unknown: no estimate yet"),
        (replace(FILTER, v=None), {"truth": False}, "unknown: no truth"),
        (replace(FILTER, v=None), {}, "no model of the plant; give --model"),
        (replace(FILTER, bound=-1.0), {}, "bound  none certified"),
        (FILTER, {"model": ""}, "no model"),
        (FILTER, {"simulated": False}, "(system clock)"),
        (replace(FILTER, health=(7, "odd")), {}, "health  stale: odd"),
    ],
)
def test_the_screen_names_what_is_missing(
    observer: ObserverView, changes: dict[str, object], words: str
) -> None:
    """The words say what is missing, or what to do."""
    view = replace(BOTH, observers=(observer,), **changes)  # type: ignore[arg-type]
    assert words in "\n".join(shown(view))


def test_words_of_strangers_do_not_control_the_terminal() -> None:
    """Control characters in diagnostics, verdicts and warnings are escaped."""
    verdict = Verdict(EPOCH, Ruling.REJECTED, 1, "\x1b[2Jstop", "\x1b]0;reason")
    observer = replace(
        FILTER,
        health=(1, "\x1b[31m"),
        sensors={"e\x1b": (0, "\x1b[H")},
        verdicts=((verdict, 0.0),),
    )
    text = "\n".join(shown(replace(BOTH, observers=(observer,), warnings=("\x1b[1A",))))
    assert "\x1b" not in text
    for escaped in ("\\x1b[2Jstop", "\\x1b]0;", "\\x1b[31m", "e\\x1b: \\x1b[H", "\\x1b[1A"):
        assert escaped in text


def test_a_line_says_the_same_in_short() -> None:
    """The line holds V, agreement and warnings of every observer."""
    assert line(BOTH) == (
        "t = 12.35 s, 8 impacts, last 0.3 s ago (stop);"
        " observer_geometric: V 2.00e-02 J, convergence 1.00e+00 J,"
        " not synchronized: one replica only, warning: 1 events were not applied;"
        " observer_minimum_variance: V 1.00e-19 J, synchronized;"
        " warning: something is doubtful"
    )
    assert line(replace(BOTH, observers=(), warnings=())).endswith("(stop); no estimate yet")


@contextmanager
def system(environment: dict[str, str]) -> Iterator[None]:
    """A plant and its observer, as processes."""
    observer = {
        "model": "two_mass",
        "use_sim_time": True,
        "initial_state": "'random:1'",
        "rate": 20.0,
    }
    plant = {"model": "two_mass", "rate": 20.0, "publish_clock": True}
    with ExitStack() as stack:
        for module, parameters in (("observer", observer), ("plant", plant)):
            stack.enter_context(running_node(module, ros_arguments(parameters), environment))
        yield


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


def on_terminal(environment: dict[str, str]) -> tuple[int, str]:
    """Run in a terminal until an observer is shown, then Ctrl-C: exit code and output."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    process = subprocess.Popen(
        WATCH,
        env={**environment, "TERM": "xterm-256color"},
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)
    output = b""
    try:
        while b"x2  m/s" not in output:
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


class Keeping(Listener):
    """Keeps the keys of all diagnostics too."""

    keys: frozenset[str] = frozenset()

    def receive(self, topic: str, message: AnyMessage) -> None:
        """Take in a message."""
        if topic == "/diagnostics":
            self.keys |= {each.key for each in message.status[0].values}
        super().receive(topic, message)


@pytest.mark.ros
def test_watch_shows_running_processes(ros_environment: dict[str, str]) -> None:
    """Processes are shown in this process, in a terminal, as lines until Ctrl-C, and as JSON."""
    listener = Keeping()
    with system(ros_environment), ExitStack() as stack:
        lines = stack.enter_context(started([], ros_environment))
        stack.callback(lines.kill)
        once = stack.enter_context(
            started(["--once", "--json", "--duration", f"{PATIENCE}"], ros_environment)
        )
        stack.callback(once.kill)
        view = watch(listener, lambda _: None, rate=10.0, duration=PATIENCE, once=True)
        (observer,) = view.observers
        assert (view.model, view.truth, view.simulated) == ("two_mass", True, True)
        assert (observer.name, observer.law) == ("/observer", "geometric")
        assert observer.health is not None
        assert observer.v is not None
        assert observer.lines
        # The layouts of Foxglove and PlotJuggler draw these; some come after the first estimate.
        until = time.monotonic() + PATIENCE
        while not DIAGNOSTICS.keys() <= listener.keys:
            assert time.monotonic() < until, DIAGNOSTICS.keys() - listener.keys
            watch(listener, lambda _: None, rate=10.0, duration=1.0)
        code, text = on_terminal(ros_environment)
        assert code == 0
        assert text.count("\x1b[?1049h") == text.count("\x1b[?1049l") == 1
        assert text.rfind("\x1b[?25h") > text.rfind("\x1b[?25l")
        written, errors = once.communicate(timeout=PATIENCE)
        assert (once.returncode, errors) == (0, "")
        (seen,) = json.loads(written)["observers"]
        assert seen["law"] == "geometric"
        assert seen["v"] > 0
        assert seen["health"]
        lines.send_signal(signal.SIGINT)
        written, errors = lines.communicate(timeout=PATIENCE)
        assert (lines.returncode, errors) == (0, "")
        assert re.search(r"^t = .* impacts, last .*; observer: V \S+ J", written, re.MULTILINE)
        assert "\x1b" not in written


@pytest.mark.ros
def test_watch_says_that_nothing_is_there(ros_environment: dict[str, str]) -> None:
    """The exit code with --once is 1."""
    with started(["--once", "--duration", "0.5"], ros_environment) as process:
        written, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (1, "")
    assert "waiting for observers" in written
