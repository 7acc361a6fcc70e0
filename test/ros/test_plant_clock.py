# SPDX-License-Identifier: Apache-2.0
"""The plant node on a clock of others that jumps."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import ImpactEvent
from processes import ros_arguments, spinning
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.io.messages import read_event, read_stamp
from impact_observer.ros.plant_node import PlantNode
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S

pytestmark = pytest.mark.ros

MANY = qos_profile(Quality(depth=2000))
START, HOUR = 100 * NS_PER_S, 3600 * NS_PER_S


def test_a_jump_of_the_clock_ahead_begins_a_new_episode(ros_environment: dict[str, str]) -> None:
    """Nothing is published of the time between, and the diagnostics tell the jump."""
    assert ros_environment
    truth, events = list[JointState](), list[ImpactEvent]()
    statuses: list[DiagnosticStatus] = []
    with spinning(ros_arguments({"model": "two_mass", "use_sim_time": True})) as spinner:
        probe = spinner.probe
        spinner.add(PlantNode())
        clock = probe.create_publisher(Clock, "/clock", qos_profile(STATES))
        probe.create_subscription(JointState, "plant/joint_states", truth.append, MANY)
        probe.create_subscription(ImpactEvent, "impacts", events.append, qos_profile(EVENTS))
        probe.create_subscription(
            DiagnosticArray, "/diagnostics", lambda array: statuses.extend(array.status), MANY
        )
        spinner.until(clock.get_subscription_count)

        def until_published(stamp: int) -> None:
            """Let the time be ``stamp``, and wait for the true state shortly before."""
            clock.publish(ros_messages().clock(stamp))
            spinner.until(lambda: stamps() and stamps()[-1] > stamp - NS_PER_S // 10)

        def stamps() -> list[int]:
            return [read_stamp("stamp", each.header.stamp) for each in truth]

        for second in (0, 3):
            until_published(START + second * NS_PER_S)
        until_published(START + HOUR)
        until_published(START + HOUR + 3 * NS_PER_S)
        spinner.until(lambda: read_event(events[-1]).stamp > START + HOUR)
        assert [each for each in stamps() if START + 3 * NS_PER_S < each < START + HOUR] == []
        assert {read_event(each).episode for each in events} == {0, 1}
        assert {read_event(each).epoch for each in events} == {START, START + HOUR}
        spinner.until(lambda: any("3597.000 s ahead" in each.message for each in statuses))
