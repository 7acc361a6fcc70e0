# SPDX-License-Identifier: Apache-2.0
"""What the executor waits for."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from processes import spinning
from rclpy.event_handler import EventHandler
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from impact_observer.io import interfaces
from impact_observer.io.interfaces import Quality
from impact_observer.ros import subscribing
from impact_observer.ros.live_intake import LiveIntake
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.subscribing import Ahead, EventsSeldom
from impact_observer.stamps import NS_PER_S


def test_events_of_the_middleware_have_a_moment_in_each_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It begins when the executor asks, so that none is skipped."""
    clock = SimpleNamespace()
    monkeypatch.setattr(subscribing, "time", clock)
    group, event = EventsSeldom(), object.__new__(EventHandler)
    group.add_entity(event)
    found = []
    for now in (3.0, 3.005, 3.02, 3.9, 4.3, 4.302, 4.5):
        clock.monotonic = lambda now=now: now
        found.append(group.can_execute(event))
    assert found == [True, True, False, False, True, True, False]


def test_what_is_ahead_comes_in_the_order_of_its_stamps_and_the_farthest_has_no_room() -> None:
    """Equal stamps in the order in which they came."""
    ahead = Ahead[str](3)
    given = [(5, "e"), (3, "c"), (5, "f"), (9, "i"), (4, "d")]
    assert [ahead.add(stamp, item) for stamp, item in given] == [None, None, None, "i", "f"]
    assert ahead.taken(2) is None
    assert [ahead.taken(latest) for latest in (3, 3, 9, 9, 9)] == ["c", None, "d", "e", None]
    ahead.add(1, "a")
    ahead.clear()
    assert ahead.taken(9) is None


def test_a_pulse_ahead_of_a_late_clock_is_given_when_that_has_come() -> None:
    """The first of several is logged; none counts as invalid."""
    pytest.importorskip("impact_observer_msgs")
    now, pulses, lines = [10 * NS_PER_S], list[int](), list[str]()
    node = SimpleNamespace(create_subscription=lambda *_, **__: None)
    intake = LiveIntake(
        node,
        None,
        lines.append,
        (lambda: now[0], 1.0),
        on_pulse=pulses.append,
    )
    for s in (10, 12, 13):
        message = Header(stamp=ros_messages().time(s * NS_PER_S))
        intake._take(interfaces.PHASE_REFERENCE, message)
    assert pulses == [10 * NS_PER_S]
    assert lines == [
        "phase_reference: stamped 2.000 s after the clock; future allows 1 s, and it waits"
    ]
    now[0] = 11 * NS_PER_S
    intake.take_waiting()
    assert pulses == [10 * NS_PER_S, 12 * NS_PER_S]
    intake.clear()
    now[0] = 20 * NS_PER_S
    intake.take_waiting()
    assert len(pulses) == 2
    assert intake.counts == {"samples": 3}


@pytest.mark.ros
def test_a_subscriber_that_does_not_fit_is_warned_of(
    ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """By the publisher's node, in the next such moment."""
    assert ros_environment
    logged = list[str]()
    warning = "New subscription discovered on topic 'states', requesting incompatible QoS"

    def is_warned() -> bool:
        logged.append(capfd.readouterr().err)
        return warning in "".join(logged)

    with spinning() as spinner:
        node = Node("publishing")
        spinner.add(node)
        node.create_publisher(JointState, "states", 10, callback_group=EventsSeldom())
        spinner.settle()
        durable = qos_profile(Quality(transient_local=True, depth=10))
        spinner.probe.create_subscription(JointState, "states", print, durable)
        spinner.until(is_warned)
