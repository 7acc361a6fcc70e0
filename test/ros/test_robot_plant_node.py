# SPDX-License-Identifier: Apache-2.0
"""The plant node with a robot whose URDF comes from a topic."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")
pytest.importorskip("pinocchio", reason="not installed: extra robots")

from pathlib import Path

from impact_observer_msgs.msg import ImpactEvent
from processes import ros_arguments, spinning
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from systems import EPOCH

from impact_observer.io import interfaces
from impact_observer.model import read_model
from impact_observer.model.multibody import multibody_of
from impact_observer.plant import Plant, simulate
from impact_observer.resources import shared
from impact_observer.ros.plant_node import PlantNode
from impact_observer.ros.topics import message_class, qos_profile
from impact_observer.stamps import NS_PER_S, grid

pytestmark = pytest.mark.ros


def test_a_robot_is_simulated_live_as_offline(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """Impacts, true states and encoders with efforts are those of a run offline."""
    assert ros_environment
    sample = read_model("hammer_arm")
    assert sample.robot is not None
    text = shared("config/hammer_arm.yaml").read_text(encoding="utf-8")
    path = tmp_path / "hammer_arm.yaml"
    path.write_text(text.replace("urdf: hammer_arm.urdf", "urdf: {topic: robot_description}"))
    parameters = {
        "model": path,
        "publish_clock": True,
        "realtime_factor": 2.0,
        "epoch": EPOCH,
        "duration": 2.5,
        "rate": 100.0,
        "measurements": "hammer_arm",
        "measurement_rate": 50.0,
    }
    events, truth, encoders = list[ImpactEvent](), list[JointState](), list[JointState]()
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with spinning(ros_arguments(parameters)) as spinner:
        publisher = spinner.probe.create_publisher(String, "robot_description", latched)
        publisher.publish(String(data=sample.robot.known_urdf.text))
        for interface, kept in (
            (interfaces.IMPACTS, events),
            (interfaces.PLANT_JOINT_STATES, truth),
        ):
            spinner.probe.create_subscription(
                message_class(interface.type),
                interface.name,
                kept.append,
                qos_profile(interface.quality),
            )
        quality = qos_profile(interfaces.SENSORS)
        spinner.probe.create_subscription(JointState, "/joint_states", encoders.append, quality)
        spinner.add(node := PlantNode())
        spinner.until(lambda: node.done)
        spinner.settle()
    robot = multibody_of(sample)
    stamps = grid(EPOCH, EPOCH + round(2.5 * NS_PER_S), 100)
    run = simulate(Plant(robot, *sample.initial_state(), epoch=EPOCH), stamps)
    found = [each.header.stamp.sec * NS_PER_S + each.header.stamp.nanosec for each in events]
    assert found == [each.stamp for each in run.events]
    assert len(found) >= 1
    assert len(truth) >= 50  # a subscriber that is late keeps the last ten
    for each in truth:
        stamp = each.header.stamp.sec * NS_PER_S + each.header.stamp.nanosec
        k = int(np.searchsorted(stamps, stamp))
        np.testing.assert_array_equal([*each.position, *each.velocity], run.states[k])
    assert len(encoders) >= 20
    assert list(encoders[0].name) == ["shoulder", "elbow"]
    assert len(encoders[0].position) == len(encoders[0].effort) == 2
