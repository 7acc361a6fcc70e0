# SPDX-License-Identifier: Apache-2.0
"""A blind juggler: a table keeps a ball at its height, and knows nothing but impact times.

The observer estimates the ball from the instants at which it hits the table. From the estimate the
juggler computes how the table must move, and publishes that on ``ground_motion``, to the plant and
to the observer, ahead of time. It aims at one thing: that the table has the height zero and the
speed ``v`` at the next impact which sends the ball to the height wanted ::

    u+ = (1 + eps) v - eps u-,    so    v = (sqrt(2 g h) + eps u-) / (1 + eps)

    python examples/blind_juggler.py                    # in simulated time, without ROS
    python examples/blind_juggler.py --ros -o juggled   # nodes, and a bag of what they did

Juggling without seeing: Ronsse, Lefevre and Sepulchre (2007), Reist and D'Andrea (2012).
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impact_observer.events import ImpactEvent
from impact_observer.model import parse_model
from impact_observer.model.live_signals import connected
from impact_observer.observer import Observer, Options, make_observer
from impact_observer.plant import make_plant
from impact_observer.stamps import NS_PER_S

GRAVITY, RESTITUTION, HEIGHT = 9.81, 0.8, 0.3
MODEL = f"""\
name: juggled_ball
bodies:  [{{name: ball, mass: 0.1}}]
grounds: [{{name: table, motion: {{live: true}}}}]
forces:  [{{body: ball, constant: {-0.1 * GRAVITY}}}]
stops:   [{{name: plate, between: [table, ball], gap: 0, restitution: {RESTITUTION}}}]
initial_state: {{position: [0.4], velocity: [0]}}
"""
GUESS = "0.33,0"
"""What the observer starts from; the ball is somewhere else."""
STEP, AHEAD, FIXED = NS_PER_S // 200, NS_PER_S // 10, NS_PER_S // 50
"""Between samples; how far ahead they are; how long before an impact its aim is kept; ns."""
PERIOD = 2 * sqrt(2 * HEIGHT / GRAVITY)
"""Of a flight to the height wanted, s."""


class Sample(NamedTuple):
    """Where the table is at a stamp (ns): m, m/s."""

    stamp: int
    position: float
    velocity: float


class Juggler:
    """Plans the table's motion from estimates of the ball."""

    def __init__(self, start: int) -> None:
        """The table rests at height zero until ``start`` (ns)."""
        self._last = Sample(start, 0.0, 0.0)
        self._aim = start, 0.0
        self._seen: tuple[int, float, float] | None = None

    def see(self, stamp: int, height: float, speed: float) -> None:
        """Take an estimate of the ball at ``stamp`` (ns)."""
        self._seen = stamp, height, speed

    def samples(self, until: int) -> Iterator[Sample]:
        """The table's motion from the last sample up to ``until`` (ns)."""
        while self._last.stamp + STEP <= until:
            self._last = self._next(self._last.stamp + STEP)
            yield self._last

    def _next(self, stamp: int) -> Sample:
        """A cubic from the last sample to the aim, at ``stamp``."""
        last, aim = self._last, self._aim
        if last.stamp >= aim[0] or aim[0] - last.stamp > FIXED:  # later it is too late
            aim = self._aim = self._new_aim(last.stamp)
        if aim[0] <= last.stamp:
            return Sample(stamp, last.position, 0.0)
        whole, s = (aim[0] - last.stamp) / NS_PER_S, (stamp - last.stamp) / NS_PER_S
        if s > whole:  # beyond the aim: with its speed
            return Sample(stamp, aim[1] * (s - whole), aim[1])
        p, v = last.position, last.velocity
        bend = (-3 * p - (2 * v + aim[1]) * whole) / whole**2
        turn = (2 * p + (v + aim[1]) * whole) / whole**3
        position = p + s * (v + s * (bend + s * turn))
        return Sample(stamp, position, v + s * (2 * bend + 3 * s * turn))

    def _new_aim(self, after: int) -> tuple[int, float]:
        """Stamp of the first impact ``after`` a stamp (ns), and the table's speed then."""
        if self._seen is None:
            return after, 0.0
        stamp, height, speed = self._seen
        falls = speed + sqrt(max(speed**2 + 2 * GRAVITY * height, 0.0))  # g times the time left
        arrives, u = stamp + round(falls / GRAVITY * NS_PER_S), speed - falls
        while arrives <= after:  # after that impact it flies to the height wanted
            arrives, u = arrives + round(PERIOD * NS_PER_S), -GRAVITY * PERIOD / 2
        v = (sqrt(2 * GRAVITY * HEIGHT) + RESTITUTION * u) / (1 + RESTITUTION)
        return arrives, min(max(v, -1.0), 1.0)


class Juggled(NamedTuple):
    """What happened: impacts, the table's samples, true and estimated states of the ball."""

    events: list[ImpactEvent]
    samples: list[Sample]
    stamps: list[int]
    truth: list[np.ndarray]
    estimates: list[np.ndarray]
    observer: Observer


def new_observer(epoch: int, law: str = "geometric") -> Observer:
    """An observer of the ball."""
    options = Options(law=law, initial_state=GUESS, epoch=epoch, history=1e6)
    return make_observer(parse_model(MODEL, "juggler").system, options)


def juggle(seconds: float, epoch: int = NS_PER_S, law: str = "geometric") -> Juggled:
    """Plant, observer and juggler in simulated time."""
    model = parse_model(MODEL, "juggler")
    system, live = connected(model.system, causal=True)
    observer, juggler = new_observer(epoch, law), Juggler(epoch - STEP)
    assert live is not None, "the table is live"
    assert observer.live is not None, "the table is live"
    found = Juggled([], [], [], [], [], observer)
    plant = None
    for now in range(epoch, epoch + round(seconds * NS_PER_S), STEP):
        if observer.start is not None:
            estimate = observer.estimate(now)
            juggler.see(now, float(estimate.q[0]), float(estimate.u[0]))
        for sample in juggler.samples(now + AHEAD):
            found.samples.append(sample)
            for signals in (live, observer.live):
                signals.add_motion("table", *sample)
        plant = plant or make_plant(system, *model.initial_state(), epoch=epoch, live=live)
        while (switching := plant.next_switching(now)) is not None:
            plant.cross(switching)
            stamp, number = switching.instant.stamp, len(found.events) + 1
            found.events.append(ImpactEvent(stamp, switching.switches, number, epoch=epoch))
            observer.receive(found.events[-1])
        found.stamps.append(now)
        found.truth.append(plant.states(np.array([now]))[0])
        known = observer.estimate(now)
        found.estimates.append(np.concatenate([known.q, known.u]))
    return found


def run_nodes(seconds: float, output: Path) -> None:
    """The same with nodes, in processes of their own, and a recorder."""
    import rclpy

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / "juggler.yaml").write_text(MODEL)
        model = ["-p", f"model:={folder / 'juggler.yaml'}"]
        plant = ["-p", f"duration:={seconds}", "-p", "wait_for_subscribers:=1"]
        watch = ["-p", f"initial_state:='{GUESS}'", "-p", "rate:=200.0"]
        for words in (
            ["impact_observer", "record", "-o", str(output)],
            ["impact_observer.ros.entry", "observer", "--ros-args", *model, *watch],
            ["impact_observer.ros.entry", "plant", "--ros-args", *model, *plant],
        ):
            process = subprocess.Popen([sys.executable, "-m", *words])
            stack.callback(process.wait)
            stack.callback(process.terminate)
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        node = _node()
        while process.poll() is None:
            rclpy.spin_once(node, timeout_sec=0.1)
        time.sleep(1.0)  # the recorder takes the last messages


def _node() -> "object":
    """The juggler as a node: ``observer/state`` in, ``ground_motion`` out."""
    from impact_observer_msgs.msg import ObserverState
    from rclpy.node import Node

    from impact_observer.io import interfaces
    from impact_observer.io.messages import JointState
    from impact_observer.ros.message_classes import message_class, ros_messages
    from impact_observer.ros.qos import qos_profile

    node, motion, make = Node("juggler"), interfaces.GROUND_MOTION, ros_messages()
    now = node.get_clock().now
    juggler = Juggler(now().nanoseconds)
    publisher = node.create_publisher(
        message_class(motion.type), motion.name, qos_profile(motion.quality)
    )

    def see(message: ObserverState) -> None:
        stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        juggler.see(stamp, message.position[0], message.velocity[0])

    def publish() -> None:
        if publisher.get_subscription_count() < len(("plant", "observer", "recorder")):
            return
        for stamp, position, velocity in juggler.samples(now().nanoseconds + AHEAD):
            state = JointState(stamp, ("table",), np.array([position]), np.array([velocity]))
            publisher.publish(make.joint_state(state))

    states = interfaces.OBSERVER_STATES
    node.create_subscription(message_class(states.type), states.name, see, 10)
    node.create_timer(STEP / NS_PER_S, publish)
    return node


def main() -> None:
    """Juggle, and print the heights."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--ros", action="store_true", help="with nodes; needs --output")
    parser.add_argument("-o", "--output", type=Path, default=Path("juggled"))
    args = parser.parse_args()
    if args.ros:
        run_nodes(args.seconds, args.output)
        return
    found = juggle(args.seconds)
    heights = np.array(found.truth)[:, 0]
    errors = np.array(found.estimates)[:, 0] - heights
    t = (np.array(found.stamps) - found.stamps[0]) / NS_PER_S
    for start in np.arange(0.0, args.seconds, 2.0).tolist():
        part = (t >= start) & (t < start + 2.0)
        print(
            f"{start:4g} s: highest {heights[part].max():.6f} m,"
            f" error of the estimate {np.abs(errors[part]).max():.2e} m"
        )


if __name__ == "__main__":
    main()
