# SPDX-License-Identifier: Apache-2.0
"""From an event on the topic to the corrected estimate on the topic, against an echo.

A round trip is measured: from just before the driver publishes an event until its callback has the
first estimate that contains it. Stamps of events are ``LATE`` ago, as those of a slow sensor. The
estimates that should have contained them are out already, so the observer must publish at once and
not at the next tick of a kilohertz. The echo (``echo_node.py``) answers with the same messages and
estimates nothing. Each round starts a new process of both; driver and parameters are the same.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks.domain import free_domain
from benchmarks.harness import Benchmark, Contest, Goal, Metrics, SkippedError

RATE = 1000.0
EVENTS = 400
LATE = 2_000_000
"""ns"""
PATIENCE = 10.0
"""How long a node may take to end, s."""
ECHO = "echo in rclpy"
_OURS = (
    "impact_observer.ros.entry",
    "observer",
    "--ros-args",
    "-p",
    "model:=two_mass",
    "-p",
    f"rate:={RATE}",
)
_ECHO = ("benchmarks.echo_node", "--ros-args", "-p", f"rate:={RATE}")


def prepare(_: Path) -> Contest:
    """Check that ROS is installed."""
    for package in ("rclpy", "impact_observer_msgs"):
        if find_spec(package) is None:
            raise SkippedError(f"no {package} here: source Jazzy, or ./dev setup")

    def measured(_: Path, command: tuple[str, ...]) -> Metrics:
        with take_domain(), running((*command, "--log-level", "error")):
            return _metrics()

    return Contest(
        f"two_mass, geometric, estimates at {RATE:g} Hz, {EVENTS} events {LATE / 1e6:g} ms late,"
        " each round in a new process",
        partial(measured, command=_OURS),
        {ECHO: partial(measured, command=_ECHO)},
        units={"p50": "s", "p99": "s"},
    )


@contextmanager
def take_domain() -> Iterator[None]:
    """Reserve a ROS domain for this process and its children."""
    with free_domain() as environment:
        os.environ.update(environment)
        yield


@contextmanager
def running(command: tuple[str, ...]) -> Iterator["subprocess.Popen[bytes]"]:
    """A node as a process, with one thread for small matrices."""
    process = subprocess.Popen(
        [sys.executable, "-m", *command],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        stdin=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(PATIENCE)


def _metrics() -> Metrics:
    """Send events, and take quantiles of the round trips, s."""
    from benchmarks.driver import driving  # noqa: PLC0415 (only where ROS is)

    with driving(LATE) as driver:
        p50, p99 = np.quantile([driver.trip() for _ in range(EVENTS)], (0.5, 0.99))
    return {"p50": float(p50), "p99": float(p99)}


BENCHMARK = Benchmark(
    "topic",
    "what does observing cost over answering?",
    prepare,
    (Goal(1.6, ECHO, "p50"), Goal(2.0, ECHO, "p99")),
    rounds=10,
)
