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
from pathlib import Path

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.io.writer import BagWriter
from impact_observer.process_end import Interrupt, Stop
from impact_observer.ros.parameters import TABLES
from impact_observer.ros.recorder import Recorder
from impact_observer.ros.session import ros_node
from impact_observer.ros.wiring import (
    DISCOVERY,
    LOCAL,
    DemoSetup,
    NodeSetup,
    following,
    monitors,
    node_name,
    observers,
    plant,
)
from impact_observer.stamps import seconds_between

_START_UP = 30.0
"""How long the processes may take to appear on the graph, s."""
_SHUT_DOWN = 10.0
"""How long a process may take to end after SIGINT, s."""
_SILENCE, _CATCH_UP = 0.5, 5.0
"""Time without an error of a monitor after which the estimates are at the end of the plant's run,
and how long the estimates may take until then, s."""
_DISCOVERY = 1.5
"""How long to search for other nodes on the same ROS domain, s."""
_SPIN = 0.02
"""Between two checks of the processes, s."""


class DemonstrationError(ImpactObserverError):
    """A process failed, or did not start."""


def run(setup: DemoSetup, folder: Path, show: Callable[[float], object]) -> Path:
    """Run the demonstration.

    Args:
        setup: the plant, laws and times.
        folder: folder to create for the bag and the ``logs`` of the processes.
        show: called with the simulated time, s since the epoch.

    Returns:
        The bag.

    Raises:
        UsageError: another plant runs on this ROS domain, a parameter is not allowed, or the
            folder cannot be created.
        DemonstrationError: a process failed.
        Interrupt: a signal has come.
    """
    for each in (plant(setup), *observers(setup), *monitors(setup)):
        for row in TABLES[each.executable]:
            if row.name in each.parameters:
                row.check(each.parameters[row.name])
    os.environ.setdefault(DISCOVERY, LOCAL)  # nobody else's nodes, on no other machine
    bag, logs = folder / "bag", folder / "logs"
    with Stop() as stop, ros_node("demo", use_sim_time=True) as (node, executor):
        _refuse_other_nodes(node, executor)
        try:
            folder.mkdir()
            logs.mkdir()
        except OSError as error:
            why = f"{folder}: cannot be made: {error.strerror}"
            raise UsageError(f"{why}; remove it or choose another name") from None
        with BagWriter(bag) as writer, _Processes(logs) as processes:
            recorder = Recorder(node, writer)

            def spin() -> None:
                """Record; raise the error of a process that failed, or a signal."""
                executor.spin_once(timeout_sec=_SPIN)
                recorder.take()
                processes.check()
                if stop.requested:
                    raise Interrupt(stop.number, f"what was recorded is in {bag}")
                now = node.get_clock().now().nanoseconds
                show(max(seconds_between(setup.epoch, now), 0.0))

            _run_nodes(setup, recorder, processes, spin)
        processes.check()
    return bag


def _run_nodes(
    setup: DemoSetup, recorder: Recorder, processes: "_Processes", spin: Callable[[], None]
) -> None:
    """Run the nodes to the end of the plant, and until the estimates are there, too."""
    errors = [f"/{node_name('monitor', law)}/error" for law in setup.laws]
    wanted = errors + [f"/{node_name('observer', law)}/state" for law in setup.laws]
    for each in (*observers(setup), *monitors(setup)):
        processes.start(each)
    latest = time.monotonic() + _START_UP
    while not all(map(recorder.is_connected, wanted)):
        spin()
        if time.monotonic() > latest:
            topics = ", ".join(wanted)
            raise DemonstrationError(f"{topics}: not all received after {_START_UP:g} s")
    master = processes.start(plant(setup, recorders=1))
    while master.poll() is None:
        spin()
    end = silent = time.monotonic()
    count = 0
    while time.monotonic() < min(silent + _SILENCE, end + _CATCH_UP):
        spin()
        before, count = count, sum(recorder.counts.get(each, 0) for each in errors)
        silent = time.monotonic() if count > before else silent


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
