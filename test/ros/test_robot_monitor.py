# SPDX-License-Identifier: Apache-2.0
"""The monitor node of a robot."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")
pytest.importorskip("pinocchio", reason="not installed: extra robots")

from impact_observer_msgs.msg import EstimateError
from processes import hosted
from sensor_msgs.msg import JointState

from impact_observer.io.interfaces import Quality
from impact_observer.robots import Robot
from impact_observer.ros.monitor_node import MonitorNode
from impact_observer.ros.topics import qos_profile


@pytest.mark.ros
def test_v_of_a_robot_is_half_the_error_by_the_mass_at_the_true_position(
    ros_environment: dict[str, str],
) -> None:
    """For an error of one velocity V is half an entry of the mass matrix."""
    true = {"position": [0.3, 0.8], "velocity": [0.0, 1.0]}
    states = {
        "plant/joint_states": true,
        "observer/joint_states": {**true, "velocity": [0.0, 1.5]},
    }
    errors, quality = list[EstimateError](), qos_profile(Quality(depth=10))
    assert ros_environment
    with hosted(MonitorNode, {"model": "hammer_arm"}) as (_, spinner):
        probe = spinner.probe
        probe.create_subscription(EstimateError, "monitor/error", errors.append, quality)
        publishers = [probe.create_publisher(JointState, each, quality) for each in states]
        spinner.until(lambda: all(each.get_subscription_count() for each in publishers))
        spinner.until(lambda: probe.count_publishers("monitor/error"))
        for publisher, state in zip(publishers, states.values(), strict=True):
            message = JointState(name=["shoulder", "elbow"], **state)
            message.header.stamp.sec = 2
            publisher.publish(message)
        spinner.until(lambda: errors)
    q = Robot("hammer_arm").checked_state([0.3, 0.8], [0.0, 0.0])[0]
    assert errors[0].v == pytest.approx(Robot("hammer_arm").mass(q)[1, 1] * 0.5**2 / 2)
    assert list(errors[0].velocity_error) == [0.0, 0.5]
