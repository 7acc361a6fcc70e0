# SPDX-License-Identifier: Apache-2.0
"""The plant node under live forces and grounds: no further than they are known."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from pathlib import Path

from impact_observer_msgs.msg import ImpactEvent
from live_rig import RIG, START, samples, simulated
from processes import hosted
from sensor_msgs.msg import JointState
from systems import EPOCH

from impact_observer.errors import InputTimeoutError
from impact_observer.io import interfaces
from impact_observer.ros.plant_node import PlantNode
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
        "model": tmp_path / "rig.yaml",
        "publish_clock": True,
        "epoch": EPOCH,
        "duration": 4.0,
        "future": 3.0,
        "input_timeout": 2.0,
    }
    make, events, truth = ros_messages(), list[ImpactEvent](), list[JointState]()
    assert ros_environment
    with hosted(PlantNode, parameters) as (_, spinner):
        probe = spinner.probe
        forces = probe.create_publisher(
            JointState, interfaces.FORCING.name, qos_profile(interfaces.FORCING.quality)
        )
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
        spinner.until(forces.get_subscription_count)
        spinner.settle()
        for stamp, value in samples():
            if stamp <= EPOCH + KNOWN * NS_PER_S:
                forces.publish(make.forces(stamp, {"motor": value}))
                spinner.executor.spin_once(timeout_sec=0.0)  # no more wait than the topic keeps
        with pytest.raises(InputTimeoutError, match="no sample of motor for"):
            spinner.until(lambda: False)
    wanted, stamps, states = simulated()
    end = EPOCH + KNOWN * NS_PER_S
    assert [stamp_of(each) for each in events] == [e.stamp for e in wanted if e.stamp < end]
    where = {stamp: k for k, stamp in enumerate(stamps.tolist())}
    assert stamp_of(truth[-1]) == end - NS_PER_S // 100
    for each in truth:
        k = where[stamp_of(each)]
        np.testing.assert_array_equal([*each.position, *each.velocity], states[k])
