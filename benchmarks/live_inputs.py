# SPDX-License-Identifier: Apache-2.0
"""What a thousand inputs, or samples of a sensor, a second cost an observer node.

The processor time of the node's process while they arrive, less that of the same process without
them, over the samples. The bare node, which this module is when it is run, subscribes to the same
topic and does nothing with them. The observer publishes estimates at its usual rate meanwhile. An
encoder's samples go to the law ``minimum-variance`` as well, with a declared error of the clock,
and so do messages of a robot's joints, two encoders and two efforts in each, at a lower rate.
There the estimates count, too: without samples each is predicted over all the time since the last.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.harness import (
    Benchmark,
    Contest,
    DisagreementError,
    Goal,
    Metrics,
    SkippedError,
)
from benchmarks.topic import running, take_domain
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io.interfaces import EVENTS, FORCING, JOINT_STATE, Interface, Quality
from impact_observer.model import read_model
from impact_observer.plant import make_plant, simulate
from impact_observer.robots.robot import Robot, simulated
from impact_observer.stamps import NS_PER_S, grid

RATE = 1000.0
IDLE, BUSY = 4.0, 10.0
"""Without and with inputs, s."""
PATIENCE = 20.0
"""For discovery, s."""
BARE = "bare rclpy node"
MODEL = """\
name: driven
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 10, damping: 0.1}
forces: [{body: x2, input: motor}]
stops: [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.7}]
"""
_BARE = "benchmarks.live_inputs"
ENCODER = Interface("encoder", JOINT_STATE, Quality(reliable=False, depth=2000))
JOINTS = Interface("joint_states", JOINT_STATE, Quality(reliable=False, depth=2000))
JOINTS_RATE = 100.0
GEOMETRIC = "the same with geometric"


def prepare(folder: Path) -> Contest:
    """Check that ROS is installed, and write the model."""
    _require_ros()
    model = folder / "driven.yaml"
    model.write_text(MODEL, encoding="utf-8")
    return Contest(
        f"an input at {RATE:g} Hz, {BUSY:g} s, law geometric; each round in a new process",
        partial(_measured, topic=FORCING, command=(*_OBSERVER, f"model:={model}")),
        {BARE: partial(_measured, topic=FORCING, command=(_BARE, FORCING.name))},
        units={"sample": "s"},
    )


def prepare_sensor(_: Path) -> Contest:
    """The same for samples of an encoder."""
    _require_ros()
    observer = (*_OBSERVER, "model:=two_mass", "-p", "measurements:=encoder")
    law = ("-p", "law:=minimum-variance", "-p", "clock_error:=0.001")
    return Contest(
        f"an encoder at {RATE:g} Hz, {BUSY:g} s, law minimum-variance; a new process each round",
        partial(_measured, topic=ENCODER, command=(*observer, *law)),
        {
            BARE: partial(_measured, topic=ENCODER, command=(_BARE, ENCODER.name)),
            GEOMETRIC: partial(_measured, topic=ENCODER, command=observer),
        },
        units={"sample": "s"},
    )


def prepare_robot(_: Path) -> Contest:
    """The same for the joints of a robot."""
    _require_ros()
    if find_spec("pinocchio") is None:
        raise SkippedError("no pinocchio here: ./dev setup")
    observer = (*_OBSERVER, "model:=hammer_arm", "-p", "measurements:=hammer_arm")
    law = ("-p", "law:=minimum-variance", "-p", "clock_error:=0.001")
    return Contest(
        f"two joints at {JOINTS_RATE:g} Hz, {BUSY:g} s, law minimum-variance",
        partial(_measured, topic=JOINTS, command=(*observer, *law)),
        {BARE: partial(_measured, topic=JOINTS, command=(_BARE, JOINTS.name))},
        units={"sample": "s"},
    )


_START = NS_PER_S
"""Epoch of the plant's run, ns."""


class _Played(NamedTuple):
    """A run of a plant as sensors see it: a row of each list is a message."""

    rate: float
    names: tuple[str, ...]
    positions: list[list[float]]
    efforts: list[list[float]]
    events: list[ImpactEvent]


@cache
def _played(topic: Interface) -> _Played:
    """What is measured on a topic, for as long as any round takes."""
    is_robot = topic is JOINTS
    rate, seconds = (JOINTS_RATE if is_robot else RATE), 2 * BUSY + IDLE
    model = read_model("hammer_arm" if is_robot else "two_mass")
    system, stamps = simulated(model), grid(_START, _START + round(seconds * NS_PER_S), rate)
    run = simulate(make_plant(system, *model.initial_state(), epoch=_START), stamps)
    measured = run.states[:, : system.n if is_robot else 1]
    noise = 1e-3 * np.random.default_rng(1).normal(size=measured.shape)
    times, efforts = (stamps - _START) / NS_PER_S, list[list[float]]()
    if isinstance(system, Robot):
        efforts = [system.torques(t).tolist() for t in times.tolist()]
    names = system.coordinates[: measured.shape[1]]
    return _Played(rate, names, (measured + noise).tolist(), efforts, [*run.events])


_OBSERVER = ("impact_observer.ros.entry", "observer", "--ros-args", "-p")


def _require_ros() -> None:
    for package in ("rclpy", "impact_observer_msgs"):
        if find_spec(package) is None:
            raise SkippedError(f"no {package} here: source Jazzy, or ./dev setup")


def _measured(_: Path, topic: Interface, command: tuple[str, ...]) -> Metrics:
    with take_domain(), running(command) as process, _publishing(topic) as publish:
        return {"sample": _cost(process, publish)}


class _Publisher:
    """Publishes an event, and samples of an input or a sensor.

    Attributes:
        counts_estimates: whether a node without samples is one that has not begun to estimate.
    """

    def __init__(self, topic: Interface) -> None:
        from impact_observer_msgs.msg import ImpactEvent as Message  # noqa: PLC0415 (ROS only)
        from rclpy.context import Context  # noqa: PLC0415
        from rclpy.node import Node  # noqa: PLC0415
        from sensor_msgs.msg import JointState  # noqa: PLC0415

        from impact_observer.ros.message_classes import ros_messages  # noqa: PLC0415
        from impact_observer.ros.qos import qos_profile  # noqa: PLC0415

        self._context = Context()
        self._context.init(args=[])
        self._node = Node("driver", context=self._context)
        self._events = self._node.create_publisher(Message, "impacts", qos_profile(EVENTS))
        quality = qos_profile(topic.quality)
        self._inputs = self._node.create_publisher(JointState, topic.name, quality)
        self._sample = JointState(name=["motor"], effort=[0.0])
        self._make = ros_messages()
        self.counts_estimates = topic is JOINTS
        self._epoch, self._tick, self._rate = 0, 0, RATE
        self._played = None if topic is FORCING else _played(topic)
        self._due = list[ImpactEvent]()
        if self._played is not None:
            self._rate = self._played.rate
            self._sample.name = [*self._played.names]
            self._due = self._played.events[::-1]

    def meet(self) -> None:
        """Wait for the node, and say where time begins."""
        end = time.monotonic() + PATIENCE
        while not self._inputs.get_subscription_count():
            if time.monotonic() > end:
                raise DisagreementError(f"no subscription within {PATIENCE:g} s")
            time.sleep(0.05)
        self._epoch = time.time_ns() - NS_PER_S // 2
        if self._played is None:
            event = ImpactEvent(self._epoch, (Switch("stop"),), 1, epoch=self._epoch)
            self._events.publish(self._make.event(event))

    def samples(self, seconds: float) -> int:
        """Publish samples at their rate; how many."""
        begin, count = time.monotonic(), round(seconds * self._rate)
        for k in range(count):
            time.sleep(max(begin + k / self._rate - time.monotonic(), 0.0))
            now = time.time_ns()
            if self._played is not None:
                tick = int((now - self._epoch) * self._rate / NS_PER_S)
                self._tick = tick = max(tick, self._tick + 1)
                now = self._epoch + round(tick * NS_PER_S / self._rate)
                self._sample.position = self._played.positions[tick]
                self._sample.effort = self._played.efforts[tick] if self._played.efforts else []
                self._publish_due(now)
            else:
                self._sample.effort[0] = k % 7 - 3.0
            stamp = self._sample.header.stamp
            stamp.sec, stamp.nanosec = divmod(now, NS_PER_S)
            self._inputs.publish(self._sample)
        return count

    def _publish_due(self, now: int) -> None:
        """Publish the impacts of the plant up to ``now``, ns."""
        while self._due and self._due[-1].stamp - _START + self._epoch <= now:
            event = self._due.pop()
            stamp = event.stamp - _START + self._epoch
            moved = replace(event, stamp=stamp, epoch=self._epoch)
            self._events.publish(self._make.event(moved))

    def close(self) -> None:
        """Leave the domain."""
        self._node.destroy_node()
        self._context.try_shutdown()


@contextmanager
def _publishing(topic: Interface) -> Iterator[_Publisher]:
    publisher = _Publisher(topic)
    try:
        publisher.meet()
        yield publisher
    finally:
        publisher.close()


def _cost(process: "subprocess.Popen[bytes]", publisher: _Publisher) -> float:
    """Processor time of the process by a sample, s."""
    if not publisher.counts_estimates:
        publisher.samples(1.0)
    before = processor_time(process.pid)
    time.sleep(IDLE)
    idle = (processor_time(process.pid) - before) / IDLE
    if publisher.counts_estimates:
        publisher.samples(1.0)
    before, begin = processor_time(process.pid), time.monotonic()
    count = publisher.samples(BUSY)
    time.sleep(0.2)  # the last ones
    busy = processor_time(process.pid) - before
    return (busy - idle * (time.monotonic() - begin)) / count


def processor_time(pid: int) -> float:
    """Processor time of a process so far, s."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    user, system = text.rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """The bare node of a topic."""
    topic = next(each for each in (FORCING, ENCODER, JOINTS) if each.name == sys.argv[1])
    import rclpy  # noqa: PLC0415 (ROS only)
    from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415
    from sensor_msgs.msg import JointState  # noqa: PLC0415

    from impact_observer.ros.qos import qos_profile  # noqa: PLC0415

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a signal ends it
    node = rclpy.create_node("bare")
    node.create_subscription(JointState, topic.name, lambda _: None, qos_profile(topic.quality))
    rclpy.spin(node)


BENCHMARK = Benchmark(
    "live",
    "what do a thousand live inputs a second cost a node?",
    prepare,
    (Goal(1.6, BARE, "sample"),),
    rounds=5,
)

SENSOR = Benchmark(
    "sensor",
    "what do a thousand samples of an encoder a second cost a node?",
    prepare_sensor,
    (Goal(1.6, BARE, "sample"),),
    rounds=5,
)

ROBOT = Benchmark(
    "robot_node",
    "what does a sample of a robot's joints cost a node?",
    prepare_robot,
    (Goal(10.0, BARE, "sample"),),
    rounds=3,
)


if __name__ == "__main__":
    main()
