# SPDX-License-Identifier: Apache-2.0
"""An observer of a robot on one processor core: ``./dev bench robot_one_core``.

    ./dev bench robot_one_core                 # two joints at 1 kHz, seven at 500 Hz, 10 s each
    ./dev bench robot_one_core --seconds 60

Positions and efforts of all joints go to the observer node in real time, and the hits. Shown are
the samples of the first joint that were used and that were shed since others waited, the hits that
were applied, the processor time by second, that of a bare node of rclpy that subscribes to the
same messages and does nothing with them, and the median of the largest velocity error, rad/s.
"""

import argparse
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import rclpy
from impact_observer_msgs.msg import ImpactEvent
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState

from benchmarks.live_inputs import JOINTS, processor_time
from benchmarks.one_core import IMPACTS, PATIENCE, TAIL, Listener, one_core
from benchmarks.robots import chain_text
from benchmarks.topic import running, take_domain
from impact_observer.io.interfaces import EVENTS, Quality
from impact_observer.io.messages import read_estimate
from impact_observer.model import Model, parse_model, read_model
from impact_observer.plant import Run, simulate
from impact_observer.plant.master import make_plant
from impact_observer.robots.robot import Robot
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.stamps import NS_PER_S, from_seconds, grid

EPOCH = NS_PER_S
"""Of the plant's run, ns."""
NOISE = 1e-3
"""Of the encoders, rad."""
SEVEN_JOINTS = """
damping: {{{damping}}}
rotor_inertia: {{{inertia}}}
contacts:
  - {{name: wall, frame: link6, normal: [1, 0, 0], offset: -0.3, restitution: 0.4}}
forces: {{topic: /joint_states, field: effort}}
torque_deviation: 0.02
forcing:
  harmonics: [{{frequency: 4.0, cosine: [8, 2, 2, 1, 1, 0.5, 0.5], sine: [0, 0, 0, 0, 0, 0, 0]}}]
initial_state: {{position: [0.1, 0, 0, 0, 0, 0, 0], velocity: [0, 0, 0, 0, 0, 0, 0]}}
"""


class Case(NamedTuple):
    """A robot, and how often its joints are measured, Hz."""

    model: Model
    rate: float


class Measured(NamedTuple):
    """What the observer made of a run."""

    name: str
    joints: int
    used: int
    shed: int
    applied: int
    processor: float
    bare: float
    error: float


def seven_joints() -> Model:
    """A chain of seven rods that swings against a wall."""
    joints = [f"joint{k}" for k in range(7)]
    each = {
        name: ", ".join(f"{joint}: {value}" for joint in joints)
        for name, value in {"damping": 0.5, "inertia": 0.05}.items()
    }
    return parse_model(chain_text(7) + SEVEN_JOINTS.format(**each), "seven_joints")


def sensors(robot: Robot) -> str:
    """The file of measurements: an encoder at each joint."""
    lines = [
        f"  - {{name: {joint}, topic: /joint_states, joint: {joint}, quantity: position,"
        f" deviation: {NOISE}}}"
        for joint in robot.coordinates
    ]
    return "\n".join(["measurements:", *lines, ""])


class Rig(Listener):
    """The robot's controller, and what the observer published."""

    def __init__(self) -> None:
        """Make the publishers."""
        super().__init__()
        fast = qos_profile(Quality(reliable=False, depth=2000))
        self.joints = self.node.create_publisher(JointState, "/joint_states", fast)
        self.impacts = self.node.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))

    def meet(self) -> None:
        """Wait for the node that is measured."""
        end = time.monotonic() + PATIENCE
        self.spin_while(
            lambda: time.monotonic() < end and not self.joints.get_subscription_count()
        )
        self.rest(1.0)

    def measured(self, command: tuple[str, ...], robot: Robot, run: Run) -> tuple[int, float]:
        """The epoch of a run before a node on one core, ns; and the node's processor time, s."""
        with ExitStack() as stack:
            with one_core():
                process = stack.enter_context(running(command))
            self.meet()
            before = processor_time(process.pid)
            epoch = self.send(robot, run)
            used = processor_time(process.pid) - before
            self.rest(TAIL)
        return epoch, used

    def rest(self, seconds: float) -> None:
        """Wait while the node is served."""
        end = time.monotonic() + seconds
        self.spin_while(lambda: time.monotonic() < end)

    def send(self, robot: Robot, run: Run) -> int:
        """Publish what is measured as if the plant began in a second; the epoch, ns."""
        noise = NOISE * np.random.default_rng(1).normal(size=(len(run.stamps), robot.n))
        positions = (run.states[:, : robot.n] + noise).tolist()
        efforts = [robot.torques((each - EPOCH) / NS_PER_S).tolist() for each in run.stamps]
        message, due = JointState(name=[*robot.coordinates]), [*run.events][::-1]
        epoch = time.time_ns() + NS_PER_S
        stamps = (run.stamps + (epoch - EPOCH)).tolist()
        for stamp, position, effort in zip(stamps, positions, efforts, strict=True):
            while time.time_ns() < stamp:
                self.executor.spin_once(timeout_sec=0.0)
            while due and (hit := due[-1].stamp + epoch - EPOCH) <= stamp:
                event = replace(due.pop(), stamp=hit, epoch=epoch)
                self.impacts.publish(ros_messages().event(event))
            message.header.stamp = ros_messages().time(stamp)
            message.position, message.effort = position, effort
            self.joints.publish(message)
        return epoch


def measured(case: Case, seconds: float, folder: Path) -> Measured:
    """Observe a robot in real time."""
    robot = Robot(case.model)
    name = robot.name
    files = {"model": folder / f"{name}.yaml", "measurements": folder / f"{name}_sensors.yaml"}
    files["model"].write_text(case.model.text(), encoding="utf-8")
    files["measurements"].write_text(sensors(robot), encoding="utf-8")
    given = {**files, "law": "minimum-variance", "clock_error": 1e-4}
    parameters = [part for key, value in given.items() for part in ("-p", f"{key}:={value}")]
    observer = ("observer", "--ros-args", *parameters)
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), case.rate)
    run = simulate(make_plant(robot, *case.model.initial_state(), epoch=EPOCH), stamps)
    rig = Rig()
    epoch, used = rig.measured(("impact_observer.ros.entry", *observer), robot, run)
    _, bare = rig.measured(("benchmarks.live_inputs", JOINTS.name), robot, run)
    rig.node.destroy_node()
    first = f"/observer: sensor {robot.coordinates[0]}"
    counts = rig.values[first]
    errors = [
        float(np.max(np.abs(estimate.u - run.states[k, robot.n :])))
        for _, estimate in map(read_estimate, rig.states)
        if seconds / 4 * case.rate < (k := round((estimate.stamp - epoch) * case.rate / NS_PER_S))
        and k < len(stamps)
    ]
    return Measured(
        name,
        robot.n,
        int(counts["accepted"]),
        int(counts["shed"]),
        int(rig.values[IMPACTS]["events applied"]),
        used / seconds,
        bare / seconds,
        float(np.median(errors)),
    )


def main(args: Sequence[str] | None = None) -> int:
    """Observe both robots; returns 1 if a sample was shed."""
    parser = argparse.ArgumentParser(description=__doc__, prog="./dev bench robot_one_core")
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--seconds", type=float, default=10.0, help="of each robot (default 10)")
    seconds = parser.parse_args(args).seconds
    shown = ("samples used", "shed", "hits applied", "processor", "bare node", "error, rad/s")
    table = Table("robot", *shown)
    shed = 0
    for case in (Case(read_model("hammer_arm"), 1000.0), Case(seven_joints(), 500.0)):
        with take_domain(), TemporaryDirectory() as folder:
            rclpy.init()
            found = measured(case, seconds, Path(folder))
            rclpy.shutdown()
        shed += found.shed
        name = f"{found.name}, {found.joints} joints at {case.rate:g} Hz"
        times = [f"{each:.2f} s/s" for each in (found.processor, found.bare)]
        cells = (found.used, found.shed, found.applied, *times, f"{found.error:.3f}")
        table.add_row(name, *map(str, cells))
    Console(width=120).print(table)
    return int(shed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
