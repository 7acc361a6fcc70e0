# SPDX-License-Identifier: Apache-2.0
"""Nodes for tests: as processes that never outlive the test, or in this process."""

import contextlib
import gc
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from impact_observer.io.interfaces import Quality
from impact_observer.ros import entry
from impact_observer.ros.topics import qos_profile

Hosted = TypeVar("Hosted", bound=Node)
Message = TypeVar("Message")
MANY = Quality(depth=2000)
PATIENCE = 90.0
"""How long a process may take to do what a test waits for, s."""
SHORT_WAIT = 0.005
"""Of one spin while a test settles, s."""
IDLE_WAITS, MOST_CALLS = 5, 200
"""Waits that ran out one after the other, or callbacks, before a test has settled."""


def ros_arguments(parameters: Mapping[str, object], *remappings: str) -> list[str]:
    """``--ros-args`` for ``parameters`` and remappings such as ``__node:=name``."""
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        shown = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ["-p", f"{name}:={shown}"]
    for remapping in remappings:
        arguments += ["-r", remapping]
    return arguments


@contextlib.contextmanager
def running(
    module: str, arguments: list[str], environment: Mapping[str, str]
) -> Iterator["subprocess.Popen[str]"]:
    """``python -m module arguments`` as a process, killed at the end if it still runs."""
    process = subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        env=dict(environment),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def running_node(
    name: str, arguments: list[str], environment: Mapping[str, str]
) -> contextlib.AbstractContextManager["subprocess.Popen[str]"]:
    """The node called ``name`` in ``ros/entry.py`` as a process, killed at the end."""
    return running(entry.__name__, [name, *arguments], environment)


def refusal(name: str, arguments: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """The line that a node prints, run in this process, when it refuses its arguments."""
    capfd.readouterr()
    code = entry.main([name, *arguments])
    gc.collect()  # the error holds a node that was partly made
    assert code == 2
    said = capfd.readouterr().err.strip().splitlines()
    lines = [each for each in said if not each.startswith("[INFO]")]  # of ROS: where keys are
    assert len(lines) == 1, lines
    return lines[0]


def interrupt(process: "subprocess.Popen[str]", how: int = signal.SIGINT) -> tuple[int, str]:
    """Send a signal; the exit code and what was written to stderr."""
    process.send_signal(how)
    _, errors = process.communicate(timeout=PATIENCE)
    return process.returncode, errors


class Spinner:
    """Nodes of this process on one executor."""

    def __init__(self) -> None:
        """Make a probe node that ignores the arguments of the test."""
        self.executor = SingleThreadedExecutor()
        self.probe = Node("probe", use_global_arguments=False)
        self.executor.add_node(self.probe)
        self.nodes: list[Node] = [self.probe]

    def add(self, node: Node) -> None:
        """Spin ``node`` too."""
        self.executor.add_node(node)
        self.nodes.append(node)

    def until(self, condition: Callable[[], object], patience: float = PATIENCE) -> None:
        """Spin until ``condition`` holds; fail the test when it does not in time."""
        end = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < end, "the condition never held"
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, kind: Any, name: str, **fields: Any) -> Any:  # noqa: ANN401
        """The answer of a service of another process."""
        client = self.probe.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**fields))
        self.until(future.done)
        return future.result()

    def collect(self, kind: type[Message], topic: str, quality: Quality = MANY) -> list[Message]:
        """The messages that come on a topic from now on."""
        messages = list[Message]()
        self.probe.create_subscription(kind, topic, messages.append, qos_profile(quality))
        return messages

    def settle(self, seconds: float = 0.1) -> None:
        """Spin for ``seconds``, and then until there is nothing to do.

        Nothing was to do where several waits ran out one after the other; nodes with fast timers
        get a number of callbacks instead, so that a busy machine takes longer.
        """
        end, idle, calls = time.monotonic() + seconds, 0, 0
        while time.monotonic() < end or (idle < IDLE_WAITS and calls < MOST_CALLS):
            begin = time.monotonic()
            self.executor.spin_once(timeout_sec=SHORT_WAIT)
            calls += 1
            idle = idle + 1 if time.monotonic() > begin + SHORT_WAIT else 0


@contextlib.contextmanager
def spinning(arguments: list[str] | None = None) -> Iterator[Spinner]:
    """ROS in this process: nodes made inside see ``arguments``; all is torn down at the end."""
    rclpy.init(args=arguments or [])
    spinner = Spinner()
    try:
        yield spinner
    finally:
        for node in reversed(spinner.nodes):
            node.destroy_node()
        spinner.executor.shutdown()
        rclpy.shutdown()


@contextlib.contextmanager
def hosted(
    make: Callable[[], Hosted], parameters: Mapping[str, object], *remappings: str
) -> Iterator[tuple[Hosted, Spinner]]:
    """A node in this process, beside the probe of a spinner."""
    with spinning(ros_arguments(parameters, *remappings)) as spinner:
        spinner.add(node := make())
        yield node, spinner
