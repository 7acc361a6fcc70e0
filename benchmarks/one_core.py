# SPDX-License-Identifier: Apache-2.0
"""A detector and an observer at 1 kHz on one processor core, at a drill of 32 hits a second.

    ./dev bench one_core                # ten seconds of the drill
    ./dev bench one_core --seconds 60

An accelerometer's samples go to the detector in real time, the detector's events to the observer.
Shown are the hits that were applied, the estimates that were published, and the error at the end
over the error at the beginning (Lyapunov distance).
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from impact_observer_msgs.msg import ObserverState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from benchmarks.fast_bags import fast_model
from benchmarks.filter_cost import DRILL
from benchmarks.topic import running, take_domain
from impact_observer.dynamics.lyapunov import distance
from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.io.messages import read_estimate
from impact_observer.model import Model
from impact_observer.plant import Plant, Run, simulate
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.stamps import NS_PER_S, from_seconds, grid

RATE = 1000.0
PATIENCE = 20.0
"""For discovery, s."""
TAIL = 1.5
"""For what is still on its way at the end, s."""
HIT = 20.0
"""The acceleration at a hit, m/s²; between hits the sensor shows 0."""
IMPACTS = "/observer: impacts"
"""The observer's status in the diagnostics."""
SOURCES = """\
sources: [{contact: stop, topic: imu, kind: switch, field: linear_acceleration.x, threshold: 10}]
"""


@contextmanager
def one_core() -> Iterator[None]:
    """Processes that are started within the block stay on one core."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


class Listener:
    """A node that keeps what the observer published.

    Attributes:
        node: the node.
        states: the estimates.
        values: the latest values of each status in the diagnostics.
    """

    def __init__(self) -> None:
        """Make the subscriptions."""
        self.node = Node("rig")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.states: list[ObserverState] = []
        self.values: dict[str, dict[str, str]] = {}
        many = qos_profile(Quality(depth=2000))
        self.node.create_subscription(ObserverState, "observer/state", self.states.append, many)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, many)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.values[status.name] = {each.key: each.value for each in status.values}

    def spin_while(self, condition: Callable[[], bool]) -> None:
        """Serve the node while a condition holds."""
        while condition():
            self.executor.spin_once(timeout_sec=0.001)


class Rig(Listener):
    """The accelerometer, and what the observer published."""

    def __init__(self) -> None:
        """Make publishers and subscriptions."""
        super().__init__()
        self.imu = self.node.create_publisher(Imu, "imu", qos_profile(STATES))
        self.pulses = self.node.create_publisher(Header, "phase_reference", qos_profile(EVENTS))

    def send(self, epoch: int, run: Run) -> None:
        """Publish a sample per millisecond, and one at each hit, when its time has come."""
        quiet = [(stamp, 0.0) for stamp in run.stamps.tolist()]
        message = Imu()
        self.pulses.publish(Header(stamp=ros_messages().time(epoch)))
        for stamp, value in sorted([*quiet, *((each.stamp, HIT) for each in run.events)]):
            while time.time_ns() < stamp:
                self.executor.spin_once(timeout_sec=0.0)
            message.header.stamp = ros_messages().time(stamp)
            message.linear_acceleration.x = value
            self.imu.publish(message)
        end = time.monotonic() + TAIL
        self.spin_while(lambda: time.monotonic() < end)


def motion_of(model: Model, epoch: int, seconds: float) -> Run:
    """The drill's motion from an epoch on, with a state per millisecond."""
    plant = Plant(model.system, *model.initial_state(), epoch=epoch)
    return simulate(plant, grid(epoch, epoch + from_seconds(seconds), RATE))


def observed_on_one_core(model: Model, seconds: float, folder: Path) -> tuple[Rig, int]:
    """The rig after its run, and the epoch of the run."""
    (folder / "drill.yaml").write_text(model.text(), encoding="utf-8")
    (folder / "rig.yaml").write_text(SOURCES, encoding="utf-8")
    parameters = {
        "model": folder / "drill.yaml",
        "law": "minimum-variance",
        "initial_deviation": "'0.01,0.01,0.5,0.5'",
        "clock_error": 1e-6,
        "rate": RATE,
    }
    observer = [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
    detector = ["-p", f"sources:={folder / 'rig.yaml'}"]
    entry = "impact_observer.ros.entry"
    rig = Rig()
    with ExitStack() as stack:
        with one_core():
            stack.enter_context(running((entry, "detector", "--ros-args", *detector)))
            stack.enter_context(running((entry, "observer", "--ros-args", *observer)))
        end = time.monotonic() + PATIENCE
        rig.spin_while(
            lambda: (
                time.monotonic() < end
                and not (
                    rig.imu.get_subscription_count()
                    and IMPACTS in rig.values
                    and rig.pulses.get_subscription_count() == 2
                )
            )
        )
        epoch = time.time_ns() + NS_PER_S // 2
        rig.send(epoch, motion_of(model, epoch, seconds))
    return rig, epoch


def main(args: Sequence[str] | None = None) -> int:
    """Run the drill; returns 1 if an event was not applied."""
    parser = argparse.ArgumentParser(description=__doc__, prog="./dev bench one_core")
    parser.add_argument("--seconds", type=float, default=10.0, help="of the drill")
    seconds = parser.parse_args(args).seconds
    model = fast_model(DRILL, 1 / DRILL)
    with take_domain(), TemporaryDirectory() as folder:
        rclpy.init()
        rig, epoch = observed_on_one_core(model, seconds, Path(folder))
        rclpy.shutdown()
    truth = motion_of(model, epoch, seconds)
    errors = {
        k: float(
            distance(
                model.system, estimate.q - truth.states[k, :2], estimate.u - truth.states[k, 2:]
            )
        )
        for _, estimate in map(read_estimate, rig.states)
        if (k := round((estimate.stamp - epoch) * RATE / NS_PER_S)) < len(truth.states)
    }
    late = [error for k, error in errors.items() if k > 0.8 * seconds * RATE]
    impacts = rig.values[IMPACTS]
    applied = int(impacts["events applied"])
    print(f"{applied} of {len(truth.events)} hits applied, {impacts['waiting']} waiting")
    print(f"{len(errors)} of {len(truth.stamps)} estimates published")
    ratio = np.median(late) / errors[min(errors)]
    print(f"error at the end over error at the beginning: {ratio:.1e}")
    return int(applied < len(truth.events))


if __name__ == "__main__":
    raise SystemExit(main())
