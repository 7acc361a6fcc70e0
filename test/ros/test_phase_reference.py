# SPDX-License-Identifier: Apache-2.0
"""Nodes and the pulse that is the epoch: equal bits, and what diagnostics warn of."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import ContactSwitch, ImpactEvent
from processes import hosted
from rclpy.node import Node
from rclpy.publisher import Publisher
from rigs import EPOCH
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header

from impact_observer.io import interfaces
from impact_observer.io.interfaces import Quality
from impact_observer.resources import shared
from impact_observer.ros.detector_node import DetectorNode
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]

MOTOR = """\
name: driven
bodies: [{name: x, mass: 1}]
springs: [{between: [ground, x], stiffness: 10, damping: 0.1}]
forces: [{body: x, input: motor}, {body: x, amplitude: 1, frequency: 6.283185307179586}]
stops: [{name: stop, body: x, limit: 1, side: above, restitution: 0.5}]
"""
MANY = qos_profile(Quality(depth=1000))


def pulse_publisher(probe: Node) -> Publisher:
    """A publisher of pulses, as of a sensor."""
    interface = interfaces.PHASE_REFERENCE
    return probe.create_publisher(Header, interface.name, qos_profile(interface.quality))


def test_diagnostics_warn_of_inputs_that_are_silent(tmp_path: Path) -> None:
    """Silence beyond ``input_timeout`` is a WARN; the age of the signal is shown."""
    (tmp_path / "driven.yaml").write_text(MOTOR)
    model = tmp_path / "driven.yaml"
    parameters = {"model": model, "input_timeout": 1.2, "future": 60.0}
    found: list[DiagnosticStatus] = []
    make = ros_messages()

    def values() -> dict[str, str]:
        return {each.key: each.value for each in found[-1].values}

    with hosted(ObserverNode, parameters) as (_, spinner):
        probe = spinner.probe
        probe.create_subscription(
            DiagnosticArray, "/diagnostics", lambda array: found.append(array.status[0]), MANY
        )
        pulses = pulse_publisher(probe)
        forces = probe.create_publisher(
            JointState, "forcing", qos_profile(interfaces.FORCING.quality)
        )
        impacts = probe.create_publisher(
            ImpactEvent, "impacts", qos_profile(interfaces.IMPACTS.quality)
        )
        topics = (pulses, forces, impacts)
        spinner.until(lambda: all(each.get_subscription_count() for each in topics))
        now = probe.get_clock().now().nanoseconds
        pulses.publish(Header(stamp=make.time(now)))
        spinner.until(lambda: bool(found) and values().get("samples") == "1")
        assert values()["age of motor [s]"] == "inf"
        forces.publish(make.joints(now, ["motor"], effort=[1.0]))
        switch = ContactSwitch(contact="stop", kind=ContactSwitch.IMPACT)
        event = ImpactEvent(sequence=1, switches=[switch])
        event.header.stamp = make.time(now + NS_PER_S)
        impacts.publish(event)
        silent = "no sample of motor for"
        spinner.until(lambda: any(silent in each.message for each in found))
        (status, *_) = [each for each in found if silent in each.message]
    assert status.level == DiagnosticStatus.WARN
    assert "input_timeout is 1.2 s" in status.message


def test_detector_puts_the_first_pulse_into_its_events() -> None:
    """The first pulse is the epoch of events if no parameter gives an epoch."""
    sources = shared("config/detector/switch.yaml")
    events: list[ImpactEvent] = []
    make = ros_messages()
    with hosted(DetectorNode, {"sources": sources}) as (_, spinner):
        probe = spinner.probe
        quality = qos_profile(interfaces.IMPACTS.quality)
        probe.create_subscription(ImpactEvent, "impacts", events.append, quality)
        pulses = pulse_publisher(probe)
        switch = probe.create_publisher(Bool, "switch", 10)
        spinner.until(lambda: bool(pulses.get_subscription_count()))
        for second in (1, 2):
            pulses.publish(Header(stamp=make.time(EPOCH * second)))
        spinner.until(lambda: bool(switch.get_subscription_count()))
        spinner.settle()
        for closed in (False, True, False):
            switch.publish(Bool(data=closed))
        spinner.until(lambda: bool(events))
    assert events[0].epoch == make.time(EPOCH)
