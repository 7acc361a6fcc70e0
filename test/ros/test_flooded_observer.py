# SPDX-License-Identifier: Apache-2.0
"""An observer process that is given far more events than it can apply."""

import time
from itertools import pairwise

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray
from impact_observer_msgs.msg import ImpactEvent as EventMessage
from processes import ros_arguments, running_node, spinning
from sensor_msgs.msg import JointState

from impact_observer.events import ImpactEvent, Switch
from impact_observer.io.interfaces import EVENTS, STATES
from impact_observer.ros.topics import qos_profile, ros_messages

pytestmark = [pytest.mark.ros, pytest.mark.slow]

COUNT, SECONDS = 10_000, 2.0
MOST_SILENCE = 0.5
"""Longest time without an estimate, s."""


def test_estimates_go_on_while_a_flood_of_events_is_worked_on(
    ros_environment: dict[str, str],
) -> None:
    """The longest silence is half a second; diagnostics say how many events were dropped."""
    arguments = ros_arguments({"model": "two_mass", "law": "geometric"})
    received: list[float] = []
    told: dict[str, str] = {}

    def note(message: DiagnosticArray) -> None:
        for status in message.status:
            told.update({each.key: each.value for each in status.values})

    with spinning() as spinner, running_node("observer", arguments, ros_environment) as process:
        probe = spinner.probe
        impacts = probe.create_publisher(EventMessage, "impacts", qos_profile(EVENTS))
        probe.create_subscription(
            JointState,
            "observer/joint_states",
            lambda _: received.append(time.monotonic()),
            qos_profile(STATES),
        )
        probe.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
        spinner.until(impacts.get_subscription_count)
        epoch = time.time_ns()
        switches = (Switch("stop"),)
        impacts.publish(ros_messages().event(ImpactEvent(epoch, switches, 1, epoch=epoch)))
        spinner.until(lambda: len(received) > 10)
        begin = time.monotonic()
        for k in range(COUNT):
            event = ImpactEvent(time.time_ns(), switches, k + 2, epoch=epoch)
            impacts.publish(ros_messages().event(event))
            if k % 20 == 0:  # a probe that is late receives, too
                spinner.executor.spin_once(timeout_sec=0.0)
            while time.monotonic() < begin + k * SECONDS / COUNT:
                spinner.executor.spin_once(timeout_sec=0.0)
        spinner.until(lambda: time.monotonic() > begin + SECONDS + 5.0)
        assert process.poll() is None
        spinner.until(lambda: told.get("waiting") == "0")
    silences = [b - a for a, b in pairwise([each for each in received if each > begin - 0.1])]
    assert max(silences) < MOST_SILENCE
    keys = ("events applied", "dropped", "missing sequence numbers")
    applied, dropped, missing = (int(told[key]) for key in keys)
    assert applied > 100
    assert applied + dropped <= COUNT + 1  # the queue of the middleware loses events, too
    assert applied + missing > 0.99 * COUNT
