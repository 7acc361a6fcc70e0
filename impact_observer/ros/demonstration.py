# SPDX-License-Identifier: Apache-2.0
"""The demonstration: plant, observers and monitors run as processes, and are recorded."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage
from impact_observer.io.writer import BagWriter
from impact_observer.process_end import Interrupt, Stop
from impact_observer.ros.parameters import TABLES, check
from impact_observer.ros.recorder import Recorder, drain
from impact_observer.ros.session import ros_node, spin_once, warning_of
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
    with Stop() as stop, ros_node("demo", use_sim_time=True) as (node, executor):
        warn = warning_of(node)

        def spin(what: str) -> None:
            """Let messages in; raise the error of a process that failed, or a signal."""
            spin_once(executor, warn, _SPIN)
            processes.check()
            if stop.requested:
                raise Interrupt(stop.number, what)

        _refuse_other_nodes(node, executor)
        try:
            folder.mkdir()
            logs.mkdir()
        except OSError as error:
            why = f"{folder}: cannot be made: {error.strerror}"
            raise UsageError(f"{why}; remove it or choose another name") from None
        with BagWriter(bag) as writer, _Processes(logs) as processes:
            recorder, progress = Recorder(node, writer), DemoProgress()
            _subscribe(node, setup, progress)
            for each in (*observers(setup), *monitors(setup)):
                processes.start(each)
            _wait_for_connections(setup, recorder, partial(spin, "the plant had not begun"))
            recorded = f"what was recorded is in {bag}"
            master = processes.start(plant(setup, recorders=1))
            while master.poll() is None:
                spin(recorded)
                show(progress)
            _let_catch_up(setup, progress, partial(spin, recorded))
            drain(executor, writer)
            recorder.close()
        processes.check()
    return bag


def _wait_for_connections(setup: DemoSetup, recorder: Recorder, spin: Callable[[], None]) -> None:
    """Spin until the recorder is connected to all observers and monitors."""
    until, missing = time.monotonic() + _START_UP, list[str]()
    for law in setup.laws:
        missing += [f"{observer_name(law)}/{n}" for n in ("state", "joint_states", "verdicts")]
        missing.append(f"{monitor_name(law)}/error")
    while missing := [each for each in missing if not recorder.is_connected(each)]:
        spin()
        if time.monotonic() > until:
            raise DemonstrationError(f"{missing[0]}: not received after {_START_UP:g} s")


def _let_catch_up(setup: DemoSetup, progress: DemoProgress, spin: Callable[[], None]) -> None:
    """Spin until the estimates have reached the end of the plant's run."""
    until, end = time.monotonic() + _CATCH_UP, setup.duration - 1.5 / setup.rate
    while any(progress.reached.get(law, 0.0) < end for law in setup.laws):
        spin()
        if time.monotonic() > until:
            return


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


class _Processes(ExitStack):
    """Nodes as processes, each in a session of its own, so that Ctrl-C does not reach them."""

    def __init__(self, logs: Path) -> None:
        """Write logs into the folder ``logs``; all end with the block, one after the other."""
        super().__init__()
        self._logs = logs
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, node: NodeSetup) -> "subprocess.Popen[bytes]":
        """Run a node until the block ends."""
        with (self._logs / f"{node.name}.log").open("wb") as log:
            process = self._running[node.name] = subprocess.Popen(
                [sys.executable, "-m", *node_arguments(node)],
                env={**os.environ, **following()},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self.callback(_end, process)
        return process

    def check(self) -> None:
        """Raise DemonstrationError with the last line of a process that has failed."""
        for name, process in self._running.items():
            if process.poll() not in {None, 0}:
                lines = (self._logs / f"{name}.log").read_text(errors="replace").split("\n")
                last = next((f": {each}" for each in reversed(lines) if each.strip()), "")
                raise DemonstrationError(f"{name} ended with exit code {process.returncode}{last}")


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process by SIGINT, else by SIGKILL."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        process.wait(_SHUT_DOWN)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def node_arguments(node: NodeSetup) -> list[str]:
    """Arguments for ``python -m``; strings are quoted, so that YAML reads them as strings."""
    arguments = ["impact_observer.ros.entry", node.executable, "--ros-args"]
    arguments += ["-r", f"__node:={node.name}"]
    for name, value in node.parameters.items():
        arguments += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]
    for ours, theirs in node.remappings.items():
        arguments += ["-r", f"{ours}:={theirs}"]
    return arguments
