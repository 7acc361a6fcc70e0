# SPDX-License-Identifier: Apache-2.0
"""The plant node under live forces and grounds: no further than they are known."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from pathlib import Path

from impact_observer_msgs.msg import ImpactEvent
from live_rig import RIG, START, samples, simulated
from processes import ros_arguments, running_node, spinning
from sensor_msgs.msg import JointState
from systems import EPOCH

from impact_observer.io import interfaces
from impact_observer.ros.topics import message_class, qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S

pytestmark = pytest.mark.ros

KNOWN = 2.0
"""So long there are samples, s."""


def stamp_of(message: JointState | ImpactEvent) -> int:
    """Stamp in the header of a message, ns."""
    return int(message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec)


def test_plant_waits_for_its_inputs_and_ends_without_them(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """Impacts and true states equal those offline up to the last sample; then one line follows."""
    position, velocity = (each.tolist() for each in START)
    initial = f"initial_state: {{position: {position}, velocity: {velocity}}}\n"
    (tmp_path / "rig.yaml").write_text(RIG + initial)
    parameters = {
        "model": str(tmp_path / "rig.yaml"),
        "publish_clock": True,
        "epoch": EPOCH,
        "duration": 4.0,
        "future": 3.0,
        "input_timeout": 5.0,
        "wait_for_subscribers": 1,
    }
    make, events, truth = ros_messages(), list[ImpactEvent](), list[JointState]()
    with (
        running_node("plant", ros_arguments(parameters), ros_environment) as process,
        spinning() as spinner,
    ):
        probe = spinner.probe
        publishers = {
            each: probe.create_publisher(
                message_class(each.type), each.name, qos_profile(each.quality)
            )
            for each in (interfaces.FORCING,)
        }
        for interface, kept in (
            (interfaces.IMPACTS, events),
            (interfaces.PLANT_JOINT_STATES, truth),
        ):
            probe.create_subscription(
                message_class(interface.type),
                interface.name,
                kept.append,
                qos_profile(interface.quality),
            )
        spinner.until(lambda: all(each.get_subscription_count() for each in publishers.values()))
        spinner.settle()
        for stamp, value in samples():
            if stamp <= EPOCH + KNOWN * NS_PER_S:
                publishers[interfaces.FORCING].publish(make.forces(stamp, {"motor": value}))
        spinner.until(lambda: process.poll() is not None)
        _, errors = process.communicate()
        spinner.settle()
    assert process.returncode == 1
    (line,) = [each for each in errors.splitlines() if "the plant waits" in each]
    assert "no sample of motor for" in line
    wanted, stamps, states = simulated()
    end = EPOCH + KNOWN * NS_PER_S
    assert [stamp_of(each) for each in events] == [e.stamp for e in wanted if e.stamp < end]
    where = {stamp: k for k, stamp in enumerate(stamps.tolist())}
    assert stamp_of(truth[-1]) == end - NS_PER_S // 100
    for each in truth:
        k = where[stamp_of(each)]
        np.testing.assert_array_equal([*each.position, *each.velocity], states[k])
