# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What the executor waits for."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from processes import spinning
from rclpy.event_handler import EventHandler
from rclpy.node import Node
from sensor_msgs.msg import JointState

from impact_observer.io.interfaces import Quality
from impact_observer.ros import subscribing
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.subscribing import EventsSeldom


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
