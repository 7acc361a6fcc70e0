# SPDX-License-Identifier: Apache-2.0
"""From an event on the topic to the corrected estimate on the topic, beside an echo.

A round trip is measured: from just before the driver publishes an event until its callback has the
first estimate that contains it. Stamps of events are ``LATE`` ago, as those of a slow sensor. The
estimates that should have contained them are out already, so the observer must publish at once and
not at the next tick of a kilohertz. The echo (``echo_node.py``) answers with the same messages and
estimates nothing.
"""

import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from builtin_interfaces.msg import Time
from impact_observer_msgs.msg import ContactSwitch, ImpactEvent, ObserverState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from benchmarks.checkout import Checkout, FailedError, Figure, Figures
from benchmarks.domain import free_domain

EVENTS = 400
LATE = 2_000_000
"""ns"""
PATIENCE = 60.0
"""How long the start, an answer and the end of a node may take, s."""
WARM = 1.0
"""Time of estimates before the first event that is measured, s."""
PAUSES = (0.005, 0.015)
"""Between an answer and the next event, s."""
_RATE = ("--ros-args", "-p", "rate:=1000.0", "--log-level", "error")


def topic(checkout: Checkout) -> Figures:
    """Round trips of the observer node of a checkout, and of the echo."""
    observer = [str(checkout.scripts / "observer"), *_RATE, "-p", "model:=two_mass"]
    echo = [sys.executable, "-m", "benchmarks.echo_node", *_RATE]
    ours, theirs = round_trips(observer, checkout.environment), round_trips(echo, {**os.environ})
    cuts = {"p50": 0.5, "p99": 0.99}
    return {
        name: Figure(float(np.quantile(trips, cut)), "s")
        for who, trips in (("observer", ours), ("echo", theirs))
        for name, cut in ((f"{who}, {key}", cut) for key, cut in cuts.items())
    }


def round_trips(command: Sequence[str], environment: dict[str, str]) -> list[float]:
    """Round trips to a node that is started for them, s."""
    with free_domain() as domain:
        os.environ.update(domain)
        process = subprocess.Popen(
            command, env=environment | domain, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
        try:
            with driving() as driver:
                return [driver.trip() for _ in range(EVENTS)]
        finally:
            process.terminate()
            process.wait(PATIENCE)


@contextmanager
def driving() -> Iterator["Driver"]:
    """A driver connected to the other side, in the ROS domain of the environment."""
    context = Context()
    context.init(args=[])
    try:
        driver = Driver(context)
        try:
            driver.meet()
            yield driver
        finally:
            driver.close()
    finally:
        context.try_shutdown()


class Driver:
    """Publishes events and waits for the estimates that contain them."""

    def __init__(self, context: Context) -> None:
        """Join a domain."""
        self._node = Node("driver", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        kept = QoSProfile(depth=2000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._impacts = self._node.create_publisher(ImpactEvent, "impacts", kept)
        self._node.create_subscription(ObserverState, "observer/state", self._receive, 10)
        epoch, stop = _stamp(time.time_ns() - 1_000_000_000), ContactSwitch(contact="stop")
        self._event = ImpactEvent(episode=1, epoch=epoch, switches=[stop])
        self._pauses = random.Random(1)
        self._received = 0
        self._arrived = 0.0

    def meet(self) -> None:
        """Wait for the other side, and let it publish for a while."""
        self._until(self._impacts.get_subscription_count)
        self.trip()
        self._spin(WARM)

    def trip(self) -> float:
        """Time from an event to the estimate that contains it, s."""
        self._spin(self._pauses.uniform(*PAUSES))
        event = self._event
        event.sequence += 1
        event.header.stamp = _stamp(time.time_ns() - LATE)
        begin = time.perf_counter()
        self._impacts.publish(event)
        self._until(lambda: self._received >= event.sequence)
        return self._arrived - begin

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _receive(self, message: ObserverState) -> None:
        if message.last_sequence > self._received:
            self._arrived = time.perf_counter()
            self._received = message.last_sequence

    def _spin(self, seconds: float) -> None:
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            self._executor.spin_once(left)

    def _until(self, condition: Callable[[], object]) -> None:
        end = time.perf_counter() + PATIENCE
        while not condition():
            if time.perf_counter() > end:
                raise FailedError(f"no answer to event {self._event.sequence} in {PATIENCE:g} s")
            self._executor.spin_once(0.05)


def _stamp(nanoseconds: int) -> Time:
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)
