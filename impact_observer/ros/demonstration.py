# SPDX-License-Identifier: Apache-2.0
"""The demonstration: plant, observers and monitors run as processes, and are recorded."""

import contextlib
import json
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

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage
from impact_observer.io.writer import BagWriter
from impact_observer.process_end import Interrupt, Stop
from impact_observer.ros.parameters import TABLES, check
from impact_observer.ros.recorder import Recorder, drain
from impact_observer.ros.session import ros_node, spin_once
from impact_observer.ros.topics import message_class, qos_profile
from impact_observer.ros.wiring import (
    DISCOVERY,
    LOCAL,
    DemoSetup,
    NodeSetup,
    following,
    monitor_name,
    monitors,
    observer_name,
    observers,
    plant,
)

_START_UP = 30.0
"""How long the processes may take to appear on the graph, s."""
_SHUT_DOWN = 10.0
"""How long a process may take to end after SIGINT, s."""
_SILENCE = 20.0
"""Time without a message after which the plant counts as dead, s."""
_CATCH_UP = 5.0
"""How long the observers may continue after the plant has ended, s."""
_DISCOVERY = 1.5
"""How long to search for other nodes on the same ROS domain, s."""
_SPIN = 0.05
"""Between two checks of the processes, s."""


class DemonstrationError(ImpactObserverError):
    """A process failed, or did not start."""


@dataclass(slots=True)
class DemoProgress:
    """The progress of a demonstration.

    Attributes:
        time: simulated time since the epoch, s.
        impacts: number of events so far.
        v: latest Lyapunov distance of each law, J.
        reached: simulated time of the last estimate of each law since the epoch, s.
    """

    time: float = 0.0
    impacts: int = 0
    v: dict[str, float] = field(default_factory=dict)
    reached: dict[str, float] = field(default_factory=dict)


def run(
    setup: DemoSetup,
    folder: Path,
    show: Callable[[DemoProgress], None],
) -> Path:
    """Run the demonstration.

    Args:
        setup: the plant, laws and times.
        folder: folder to create for the bag and the ``logs`` of the processes.
        show: called with the progress about twenty times a second.

    Returns:
        The bag.

    Raises:
        UsageError: another plant runs on this ROS domain, a parameter is not allowed, or the
            folder cannot be created.
        DemonstrationError: a process failed.
        Interrupt: a signal has come.
    """
    for each in (plant(setup), *observers(setup), *monitors(setup)):
        check(TABLES[each.executable], each.parameters)
    os.environ.setdefault(DISCOVERY, LOCAL)  # nobody else's nodes, on no other machine
    bag, logs = folder / "bag", folder / "logs"
    with (
        Stop() as stop,
        ros_node("demo", use_sim_time=True) as (node, executor),
        contextlib.ExitStack() as later,
    ):
        _refuse_other_nodes(node, executor)
        _make(folder)
        logs.mkdir()
        writer = later.enter_context(BagWriter(bag))
        recorder, progress = Recorder(node, writer), DemoProgress()
        _subscribe(node, setup, progress)
        with _processes(setup, logs) as processes:
            _wait_for_connections(executor, recorder, processes, stop, setup=setup, logs=logs)
            with _process(plant(setup, recorders=1), logs) as master:
                last_message, count = time.monotonic(), -1
                while master.poll() is None and not stop.requested:
                    spin_once(executor, node, _SPIN)
                    _check_all(processes, logs)
                    show(progress)
                    if writer.message_count > count:
                        last_message, count = time.monotonic(), writer.message_count
                    elif time.monotonic() > last_message + _SILENCE:
                        raise DemonstrationError(f"plant: silent for {_SILENCE:g} s; see {logs}")
                if stop.requested:
                    raise Interrupt(stop.number, f"what was recorded is in {bag}")
                _check("plant", master, logs)
            _let_catch_up(executor, setup, progress)
            drain(executor, writer)
            recorder.close()
    return bag


def _make(folder: Path) -> None:
    try:
        folder.mkdir()
    except FileExistsError:
        raise UsageError(f"{folder}: exists already; remove it or choose another name") from None
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made: {error.strerror}") from None


def _subscribe(node: Node, setup: DemoSetup, progress: DemoProgress) -> None:
    """Update ``progress`` by messages."""

    def on_impact(_: object) -> None:
        progress.impacts += 1

    def on_error(message: AnyMessage) -> None:
        progress.v[message.law] = message.v
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        reached = progress.reached[message.law] = (stamp - setup.epoch) * 1e-9
        progress.time = max(progress.time, reached)

    node.create_subscription(
        message_class(interfaces.IMPACT_EVENT),
        "impacts",
        on_impact,
        qos_profile(interfaces.EVENTS),
    )
    error = message_class(interfaces.ESTIMATE_ERROR)
    for law in setup.laws:
        topic = f"{monitor_name(law)}/error"
        node.create_subscription(error, topic, on_error, qos_profile(interfaces.STATES))


def _refuse_other_nodes(node: Node, executor: SingleThreadedExecutor) -> None:
    """Raise UsageError if another plant, demonstration or clock runs on this domain."""
    until = time.monotonic() + _DISCOVERY
    while time.monotonic() < until:
        executor.spin_once(timeout_sec=_SPIN)
        names = node.get_node_names()
        if "plant" in names or names.count("demo") > 1 or node.count_publishers("/clock"):
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise UsageError(
                f"ROS domain {domain}: another demo, plant or clock runs there already;"
                " end it or choose another domain with ROS_DOMAIN_ID"
            )


def _wait_for_connections(
    executor: SingleThreadedExecutor,
    recorder: Recorder,
    processes: Mapping[str, "subprocess.Popen[bytes]"],
    stop: Stop,
    *,
    setup: DemoSetup,
    logs: Path,
) -> None:
    """Wait until the recorder is connected to all observers and monitors."""
    topics = [
        topic
        for law in setup.laws
        for topic in (
            f"{observer_name(law)}/state",
            f"{observer_name(law)}/joint_states",
            f"{observer_name(law)}/verdicts",
            f"{monitor_name(law)}/error",
        )
    ]
    until = time.monotonic() + _START_UP
    while missing := [topic for topic in topics if not recorder.is_connected(topic)]:
        executor.spin_once(timeout_sec=_SPIN)
        _check_all(processes, logs)
        if stop.requested:
            raise Interrupt(stop.number, "the plant had not begun")
        if time.monotonic() > until:
            raise DemonstrationError(f"{missing[0]}: not received after {_START_UP:g} s")


def _let_catch_up(
    executor: SingleThreadedExecutor, setup: DemoSetup, progress: DemoProgress
) -> None:
    """Wait until the estimates have reached the end of the plant's run."""
    until, end = time.monotonic() + _CATCH_UP, setup.duration - 1.5 / setup.rate
    while any(progress.reached.get(law, 0.0) < end for law in setup.laws):
        if time.monotonic() > until:
            return
        executor.spin_once(timeout_sec=_SPIN)


@contextlib.contextmanager
def _processes(setup: DemoSetup, logs: Path) -> Iterator[dict[str, "subprocess.Popen[bytes]"]]:
    """Run observers and monitors until the block ends."""
    with contextlib.ExitStack() as stack:
        processes = {
            each.name: stack.enter_context(_process(each, logs))
            for each in (*observers(setup), *monitors(setup))
        }
        yield processes


@contextlib.contextmanager
def _process(node: NodeSetup, logs: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a node as a process in a session of its own, so that Ctrl-C does not reach the node."""
    with (logs / f"{node.name}.log").open("wb") as log:
        process = _spawn(node_arguments(node), log)
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
        _check(node.name, process, logs)


def _spawn(arguments: Sequence[str], log: IO[bytes]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, "-m", *arguments],
        env={**os.environ, **following()},
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def _check_all(processes: Mapping[str, "subprocess.Popen[bytes]"], logs: Path) -> None:
    for name, process in processes.items():
        _check(name, process, logs)


def _check(name: str, process: "subprocess.Popen[bytes]", logs: Path) -> None:
    """Raise DemonstrationError with the last line of a process if the process has failed."""
    if process.poll() in (None, 0):
        return
    lines = (logs / f"{name}.log").read_text(errors="replace").strip().splitlines()
    last = f": {lines[-1]}" if lines else ""
    raise DemonstrationError(f"{name} ended with exit code {process.returncode}{last}")


def node_arguments(node: NodeSetup) -> list[str]:
    """Arguments for ``python -m``; strings are quoted, so that YAML reads them as strings."""
    arguments = ["impact_observer.ros.entry", node.executable, "--ros-args"]
    arguments += ["-r", f"__node:={node.name}"]
    for name, value in node.parameters.items():
        arguments += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]
    for ours, theirs in node.remappings.items():
        arguments += ["-r", f"{ours}:={theirs}"]
    return arguments
