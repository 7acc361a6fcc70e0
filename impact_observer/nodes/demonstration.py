"""The demonstration: plant, observers and monitors as processes, recorded while they run."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from impact_observer.bag import interfaces
from impact_observer.bag.messages import ErrorMessage
from impact_observer.bag.writer import BagWriter
from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.nodes.messages import message_class
from impact_observer.nodes.quality import qos_profile
from impact_observer.nodes.recorder import Recorder, drain
from impact_observer.nodes.session import Stop, ros_node

_START_UP = 30.0
"""How long the processes may take to appear on the graph, s."""
_SHUT_DOWN = 10.0
"""How long a process may take to end after SIGINT, s."""
_SILENCE = 20.0
"""How long the plant may say nothing before it counts as dead, s."""
_SPIN = 0.05
"""Between two looks at the processes, s."""


class DemonstrationError(ImpactObserverError):
    """A process that failed, or that did not come up."""


@dataclass(frozen=True, slots=True)
class Setting:
    """What a demonstration runs.

    Attributes:
        model: a model file or a sample's name.
        laws: one observer and one monitor each.
        initial: the observers' initial state, as users write it.
        duration: simulated seconds.
        realtime_factor: simulated seconds a second.
        rate: true states and estimates, Hz.
        epoch: stamp of ``t = 0``, ns.
    """

    model: str
    laws: Sequence[str]
    initial: str
    duration: float
    realtime_factor: float
    rate: float
    epoch: int


@dataclass(slots=True)
class Live:
    """What is known while it runs.

    Attributes:
        time: simulated time since the epoch, s.
        impacts: events so far.
        v: latest Lyapunov distance of each law, J.
    """

    time: float = 0.0
    impacts: int = 0
    v: dict[str, float] = field(default_factory=dict)


def observer_name(law: str) -> str:
    """Name of the observer node of a law."""
    return f"observer_{law.replace('-', '_')}"


def run(setting: Setting, bag: Path, logs: Path, show: Callable[[Live], None]) -> None:
    """Run the demonstration into ``bag``.

    Args:
        setting: what to run.
        bag: the bag to make.
        logs: a folder for what the processes print.
        show: told what is known, about twenty times a second.

    Raises:
        UsageError: a plant runs on this ROS domain already.
        DemonstrationError: a process failed, or the run was interrupted.
    """
    with (
        Stop() as stop,
        ros_node("demo", use_sim_time=True) as (node, executor),
        BagWriter(bag) as writer,
    ):
        _refuse_company(node, executor)
        recorder = Recorder(node, writer)
        live = Live()
        _subscribe(node, setting, live)
        with _processes(setting, logs) as processes:
            _wait_for_nodes(executor, node, processes, stop)
            with _process("plant", _plant_arguments(setting), logs) as plant:
                heard = time.monotonic()
                while plant.poll() is None and not stop.requested:
                    before = (live.time, writer.message_count)
                    executor.spin_once(timeout_sec=_SPIN)
                    for name, process in processes.items():
                        _check(name, process, logs)
                    show(live)
                    if (live.time, writer.message_count) != before:
                        heard = time.monotonic()
                    elif time.monotonic() > heard + _SILENCE:
                        raise DemonstrationError(f"plant: silent for {_SILENCE:g} s; see {logs}")
                if stop.requested:
                    raise DemonstrationError(f"interrupted; what was recorded is in {bag}")
                _check("plant", plant, logs)
            drain(executor, writer)
            recorder.close()


def _subscribe(node: Node, setting: Setting, live: Live) -> None:
    """Keep ``live`` up to date."""

    def on_impact(_: object) -> None:
        live.impacts += 1

    def on_error(message: ErrorMessage) -> None:
        live.v[message.law] = message.v
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        live.time = max(live.time, (stamp - setting.epoch) * 1e-9)

    node.create_subscription(
        message_class(interfaces.IMPACT_EVENT),
        "impacts",
        on_impact,
        qos_profile(interfaces.EVENTS),
    )
    error = message_class(interfaces.ESTIMATE_ERROR)
    for law in setting.laws:
        topic = f"{observer_name(law).replace('observer', 'monitor', 1)}/error"
        node.create_subscription(error, topic, on_error, qos_profile(interfaces.STATES))


def _refuse_company(node: Node, executor: SingleThreadedExecutor) -> None:
    """Another plant on the same domain would be taken for ours."""
    until = time.monotonic() + 1.0
    while time.monotonic() < until:
        executor.spin_once(timeout_sec=_SPIN)
        if "plant" in node.get_node_names() or node.count_publishers("/clock"):
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise UsageError(
                f"ROS domain {domain}: a plant or a clock runs there already;"
                " end it or choose another domain with ROS_DOMAIN_ID"
            )


def _wait_for_nodes(
    executor: SingleThreadedExecutor,
    node: Node,
    processes: Mapping[str, "subprocess.Popen[bytes]"],
    stop: Stop,
) -> None:
    """Until all observers and monitors are on the graph."""
    until = time.monotonic() + _START_UP
    while missing := set(processes) - set(node.get_node_names()):
        executor.spin_once(timeout_sec=_SPIN)
        for name, process in processes.items():
            _check(name, process, None)
        if stop.requested:
            raise DemonstrationError("interrupted before the plant began")
        if time.monotonic() > until:
            names = ", ".join(sorted(missing))
            raise DemonstrationError(
                f"{names}: not on the graph after {_START_UP:g} s; does DDS work on this machine?"
            )


@contextlib.contextmanager
def _processes(setting: Setting, logs: Path) -> Iterator[dict[str, "subprocess.Popen[bytes]"]]:
    """Observers and monitors, ended when the block ends."""
    with contextlib.ExitStack() as stack:
        processes = {}
        for law in setting.laws:
            observer = observer_name(law)
            monitor = observer.replace("observer", "monitor", 1)
            processes[observer] = stack.enter_context(
                _process(observer, _observer_arguments(setting, law), logs)
            )
            processes[monitor] = stack.enter_context(
                _process(monitor, _monitor_arguments(setting, law), logs)
            )
        yield processes


@contextlib.contextmanager
def _process(
    name: str, arguments: Sequence[str], logs: Path
) -> Iterator["subprocess.Popen[bytes]"]:
    """One node as a process in a group of its own: Ctrl-C comes from here only."""
    with (logs / f"{name}.log").open("wb") as log:
        process = _spawn(arguments, log)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(_SHUT_DOWN)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    if process.returncode != 0 and sys.exc_info()[0] is None:
        _check(name, process, logs)


def _spawn(arguments: Sequence[str], log: IO[bytes]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, "-m", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def _check(name: str, process: "subprocess.Popen[bytes]", logs: Path | None) -> None:
    """Raise if a process has failed, with the last line it printed."""
    if process.poll() in (None, 0):
        return
    last = ""
    if logs is not None:
        lines = (logs / f"{name}.log").read_text(errors="replace").strip().splitlines()
        last = f": {lines[-1]}" if lines else ""
    raise DemonstrationError(f"{name} ended with exit code {process.returncode}{last}")


def _ros_arguments(module: str, name: str, values: Mapping[str, object]) -> list[str]:
    arguments = [f"impact_observer.nodes.{module}", "--ros-args", "-r", f"__node:={name}"]
    for key, value in values.items():
        shown = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ["-p", f"{key}:={shown}"]
    return arguments


def _plant_arguments(setting: Setting) -> list[str]:
    # Observers or monitors, and the recorder, on each topic.
    return _ros_arguments(
        "plant",
        "plant",
        {
            "model": setting.model,
            "rate": setting.rate,
            "epoch": setting.epoch,
            "duration": setting.duration,
            "publish_clock": True,
            "clock_rate": max(setting.rate, 100.0),
            "realtime_factor": setting.realtime_factor,
            "wait_for_subscribers": len(setting.laws) + 1,
        },
    )


def _observer_arguments(setting: Setting, law: str) -> list[str]:
    return _ros_arguments(
        "observer",
        observer_name(law),
        {
            "use_sim_time": True,
            "model": setting.model,
            "law": law,
            "initial_state": f"'{setting.initial}'",
            "rate": setting.rate,
            "epoch": setting.epoch,
            "events_durability": "transient_local",
        },
    )


def _monitor_arguments(setting: Setting, law: str) -> list[str]:
    name = observer_name(law)
    arguments = _ros_arguments(
        "monitor",
        name.replace("observer", "monitor", 1),
        {"use_sim_time": True, "model": setting.model, "law": law},
    )
    return [*arguments, "-r", f"observer/joint_states:={name}/joint_states"]
