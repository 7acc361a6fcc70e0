# SPDX-License-Identifier: Apache-2.0
"""A detector and an observer at 1 kHz on one processor core hold a drill of 32 hits a second."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray
from impact_observer_msgs.msg import ObserverState
from processes import ros_arguments, running_node, spinning
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from benchmarks.fast_bags import fast_model
from benchmarks.filter_cost import DRILL
from impact_observer.dynamics.lyapunov import distance
from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.io.messages import read_estimate
from impact_observer.plant import Plant, simulate
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.stamps import NS_PER_S, grid

pytestmark = [pytest.mark.ros, pytest.mark.slow]

RATE, SECONDS = 1000.0, 10.0
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


def samples(epoch: int) -> Iterator[tuple[int, float]]:
    """Stamps (ns) and values of an accelerometer at 1 kHz, with one more at each hit."""
    plant = Plant(MODEL.system, *MODEL.initial_state(), epoch=epoch)
    hits = [each.stamp for each in simulate(plant, grid(epoch, epoch + END, RATE)).events]
    quiet = grid(epoch, epoch + END, RATE).tolist()
    return iter(sorted([*((stamp, 0.0) for stamp in quiet), *((stamp, 20.0) for stamp in hits)]))


MODEL, END = fast_model(DRILL, 1 / DRILL), round(SECONDS * NS_PER_S)


def test_an_observer_beside_a_detector_holds_a_drill_on_one_core(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """Every hit is applied, no event waits at the end, and the error is small.

    Other processes may share the core, so that the test asks for a tenth of the estimates only.
    """
    (tmp_path / "drill.yaml").write_text(MODEL.text(), encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(SOURCES, encoding="utf-8")
    drill = {
        "model": tmp_path / "drill.yaml",
        "law": "minimum-variance",
        "initial_deviation": "'0.01,0.01,0.5,0.5'",
        "clock_error": 1e-6,
        "rate": RATE,
    }
    states, values = list[ObserverState](), dict[str, str]()

    def on_diagnostics(array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name == "/observer: impacts":
                values.update({each.key: each.value for each in status.values})

    rig = ros_arguments({"sources": tmp_path / "rig.yaml"})
    with spinning() as spinner:
        probe = spinner.probe
        many = qos_profile(Quality(depth=1000))
        probe.create_subscription(ObserverState, "observer/state", states.append, many)
        probe.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, many)
        imu = probe.create_publisher(Imu, "imu", qos_profile(STATES))
        pulses = probe.create_publisher(Header, "phase_reference", qos_profile(EVENTS))
        with (
            one_core(),
            running_node("detector", rig, ros_environment),
            running_node("observer", ros_arguments(drill), ros_environment),
        ):
            os.sched_setaffinity(0, range(os.cpu_count() or 1))
            spinner.until(imu.get_subscription_count)
            spinner.until(lambda: values and pulses.get_subscription_count() == 2)
            epoch = time.time_ns() + NS_PER_S // 2
            pulses.publish(Header(stamp=ros_messages().time(epoch)))
            message = Imu()
            for stamp, value in samples(epoch):
                while time.time_ns() < stamp:
                    spinner.executor.spin_once(timeout_sec=0.0)
                message.header.stamp = ros_messages().time(stamp)
                message.linear_acceleration.x = value
                imu.publish(message)
            spinner.settle(1.5)
    plant = Plant(MODEL.system, *MODEL.initial_state(), epoch=epoch)
    truth = simulate(plant, grid(epoch, epoch + END, RATE))
    errors = [
        (k, estimate.q - truth.states[k, :2], estimate.u - truth.states[k, 2:])
        for _, estimate in map(read_estimate, states)
        if (k := round((estimate.stamp - epoch) * RATE / NS_PER_S)) < len(truth.states)
    ]
    first = float(distance(MODEL.system, *errors[0][1:]))
    last = [float(distance(MODEL.system, q, u)) for k, q, u in errors if k > 0.8 * SECONDS * RATE]
    applied, published = int(values["events applied"]), len({k for k, _, _ in errors})
    assert applied >= 0.99 * len(truth.events)
    assert values["waiting"] == "0"
    assert published > 0.1 * RATE * SECONDS
    assert np.median(last) < 1e-6 * first
