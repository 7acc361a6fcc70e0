# SPDX-License-Identifier: Apache-2.0
"""The life cycle of nodes, by services that others call."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer_msgs.msg import EstimateError, EventVerdict, ImpactEvent, ObserverState
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from processes import Spinner, hosted
from rclpy.logging import LoggingSeverity
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.io.messages import read_estimate, read_event, read_stamp
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer
from impact_observer.plant import Plant, simulate
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.detector_node import DetectorNode
from impact_observer.ros.monitor_node import MonitorNode
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.plant_node import PlantNode
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S, grid

pytestmark = pytest.mark.ros

EPOCH = 5_000_000_000
MANY = qos_profile(Quality(depth=2000))
CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE
SHUTDOWN = Transition.TRANSITION_ACTIVE_SHUTDOWN
STEP = 100_000_000
"""Time between two estimates or true states, ns."""


class Managed:
    """A node in this process, beside a probe that calls its services."""

    def __init__(self, node: BaseNode, spinner: Spinner, log: Callable[[], str]) -> None:
        self.node, self.name, self.spinner, self._log = node, node.get_name(), spinner, log

    def state(self) -> str:
        """The state of the node."""
        return str(self.spinner.call(GetState, f"{self.name}/get_state").current_state.label)

    def change(self, *transitions: int) -> bool:
        """Make transitions up to the first that fails; whether none failed."""
        return all(
            self.spinner.call(
                ChangeState, f"{self.name}/change_state", transition=Transition(id=each)
            ).success
            for each in transitions
        )

    def ended(self) -> str:
        """The log of the node, whose process is to end."""
        assert self.node.done
        return self._log()


Manage = Callable[..., AbstractContextManager[Managed]]


@pytest.fixture
def managed(ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]) -> Manage:
    """Makes a node that waits for transitions unless parameters say otherwise."""
    assert ros_environment

    @contextmanager
    def manage(make: Callable[[], BaseNode], **parameters: object) -> Iterator[Managed]:
        with hosted(make, {"autostart": False, **parameters}) as (node, spinner):
            node.get_logger().set_level(LoggingSeverity.INFO)  # another test may have changed it
            yield Managed(node, spinner, lambda: "".join(capfd.readouterr()))

    return manage


def connected(spinner: Spinner, *publishers: Publisher) -> None:
    """Wait until each of ``publishers`` has a subscriber."""
    spinner.until(lambda: all(each.get_subscription_count() for each in publishers))


def test_the_time_of_a_plant_stands_still_while_it_is_inactive(managed: Manage) -> None:
    """The node gives the same states and events as a simulation, without a gap and anew."""
    model = read_model("two_mass")
    states, events = list[JointState](), list[ImpactEvent]()
    given = {"model": "two_mass", "publish_clock": True, "epoch": EPOCH, "rate": 10.0}
    with managed(PlantNode, realtime_factor=2.0, **given) as node:
        spinner = node.spinner
        spinner.probe.create_subscription(JointState, "plant/joint_states", states.append, MANY)
        spinner.probe.create_subscription(
            ImpactEvent, "impacts", events.append, qos_profile(EVENTS)
        )
        assert node.state() == "unconfigured"
        assert not node.change(ACTIVATE), "a plant that is not configured"
        assert node.change(CONFIGURE)
        assert node.state() == "inactive"
        topics = ("plant/joint_states", "impacts")
        spinner.until(lambda: all(spinner.probe.count_publishers(each) for each in topics))
        spinner.settle(0.5)
        assert not states
        assert node.change(ACTIVATE)
        spinner.until(lambda: len(states) > 20)
        assert node.change(DEACTIVATE)
        spinner.settle()
        count, had = len(states), len(events)
        spinner.settle(1.0)
        assert (len(states), len(events)) == (count, had)
        assert node.change(ACTIVATE)
        spinner.until(lambda: len(states) > count + 10 and len(events) > had)
        stamps = [read_stamp("stamp", each.header.stamp) for each in states]
        assert set(np.diff(stamps)) == {STEP}
        plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
        wanted = simulate(plant, grid(EPOCH, stamps[-1] + NS_PER_S, 1.0)).events
        assert [read_event(each).stamp for each in events] == [
            each.stamp for each in wanted[: len(events)]
        ]
        assert node.change(DEACTIVATE, CLEANUP)
        assert node.state() == "unconfigured"
        spinner.until(lambda: not spinner.probe.count_publishers("impacts"))
        events.clear()
        assert node.change(CONFIGURE, ACTIVATE)
        assert node.state() == "active"
        spinner.until(lambda: events)
        assert read_event(events[0]) == wanted[0]
        assert node.change(SHUTDOWN)
        assert "transition 3 failed: the node is unconfigured" in node.ended()


def test_a_plant_on_the_clock_of_others_publishes_what_a_pause_had_late(
    managed: Manage,
) -> None:
    """No event is lost, as real time does not stand still."""
    events = list[ImpactEvent]()
    with managed(PlantNode, autostart=True, model="two_mass") as node:
        spinner, probe = node.spinner, node.spinner.probe
        probe.create_subscription(ImpactEvent, "impacts", events.append, qos_profile(EVENTS))
        spinner.until(lambda: events)
        answer = spinner.call(Trigger, "plant/reset")
        assert answer.success
        assert answer.message.startswith("episode 1, epoch ")
        events.clear()
        spinner.until(lambda: events)
        assert node.change(DEACTIVATE)
        count, begin = len(events), probe.get_clock().now().nanoseconds
        spinner.settle(3.0)
        assert len(events) <= count + 1, "one may have been on its way"
        assert not spinner.call(Trigger, "plant/reset").success
        end = probe.get_clock().now().nanoseconds
        assert node.change(ACTIVATE)
        spinner.until(lambda: read_event(events[-1]).stamp > end)
        assert node.change(SHUTDOWN)
        node.ended()
    assert [each.sequence for each in events] == [k + 1 for k in range(len(events))]
    assert any(begin < read_event(each).stamp < end for each in events)


def test_an_inactive_observer_keeps_its_state_and_a_cleanup_forgets_it(managed: Manage) -> None:
    """Estimates after a pause know its events: they are those of an observer without ROS."""
    model, options = read_model("two_mass"), Options("geometric", "random:1", epoch=EPOCH)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    impacts = simulate(plant, grid(EPOCH, EPOCH + 6 * NS_PER_S, 1.0)).events
    states, verdicts = list[ObserverState](), list[EventVerdict]()
    given = {"initial_state": "random:1", "epoch": EPOCH, "rate": 10.0, "use_sim_time": True}
    with managed(ObserverNode, model="two_mass", **given) as node:
        spinner, probe = node.spinner, node.spinner.probe
        clock = probe.create_publisher(Clock, "/clock", qos_profile(STATES))
        events = probe.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))
        probe.create_subscription(ObserverState, "observer/state", states.append, MANY)
        probe.create_subscription(EventVerdict, "observer/verdicts", verdicts.append, MANY)

        def go_on(begin: int, end: int) -> None:
            """Send the impacts from ``begin`` to ``end``, s since the epoch, and the clock."""
            for each in impacts:
                if begin * NS_PER_S <= each.stamp - EPOCH < end * NS_PER_S:
                    events.publish(ros_messages().event(each))
                    same.receive(each)
            clock.publish(ros_messages().clock(EPOCH + end * NS_PER_S))

        def is_same(seconds: int) -> bool:
            """Whether the last estimate is that of the other observer, ``seconds`` after epoch."""
            wanted = same.estimate(EPOCH + seconds * NS_PER_S)
            found = read_estimate(states[-1])[1] if states else None
            return found is not None and (
                (found.stamp, found.q.tobytes(), found.u.tobytes())
                == (wanted.stamp, wanted.q.tobytes(), wanted.u.tobytes())
            )

        assert node.change(CONFIGURE, ACTIVATE)
        connected(spinner, clock, events)
        same = make_observer(model, options)
        go_on(0, 2)
        spinner.until(lambda: is_same(2))
        assert node.change(DEACTIVATE)
        count, judged = len(states), len(verdicts)
        assert judged
        go_on(2, 4)
        spinner.settle(0.5)
        assert (len(states), len(verdicts)) == (count, judged)
        assert node.change(ACTIVATE)
        go_on(4, 6)
        spinner.until(lambda: is_same(6))
        assert states[-1].last_sequence == len(impacts)
        assert node.change(DEACTIVATE, CLEANUP)
        probe.destroy_publisher(events)  # a publisher would repeat its past events
        events = probe.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))
        assert node.change(CONFIGURE, ACTIVATE)
        connected(spinner, events)
        same = make_observer(model, options)
        go_on(6, 7)
        spinner.until(lambda: is_same(7))
        assert states[-1].last_sequence == 0
        assert node.change(SHUTDOWN)
        node.ended()


def test_an_observer_waits_for_the_measurements_it_declares(
    managed: Manage, tmp_path: Path
) -> None:
    """The log names those that are missing; the node is active once each has had a sample."""
    path = tmp_path / "sensors.yaml"
    path.write_text(
        "measurements:\n"
        "  - {name: encoder, topic: encoder, joint: x1, quantity: position, deviation: 0.001}\n"
        "  - {name: laser, topic: laser, field: range, position: {x2: -1}, deviation: 0.01}\n"
    )
    given = {"model": "two_mass", "measurements": path, "wait_for_measurements": True}
    with managed(ObserverNode, autostart=True, **given) as node:
        spinner, probe = node.spinner, node.spinner.probe
        encoder = probe.create_publisher(JointState, "encoder", qos_profile(STATES))
        laser = probe.create_publisher(Range, "laser", qos_profile(STATES))
        assert node.state() == "inactive"
        connected(spinner, encoder, laser)
        for publisher, message in (
            (encoder, JointState(name=["x1"], position=[0.1])),
            (laser, Range(range=0.1)),
        ):
            assert node.state() == "inactive"
            message.header.stamp = probe.get_clock().now().to_msg()
            publisher.publish(message)
            spinner.settle(0.5)
        spinner.until(lambda: node.state() == "active")
        assert node.change(SHUTDOWN)
        log = node.ended()
    assert "not active: no measurement yet of encoder, laser" in log
    assert "not active: no measurement yet of laser" in log


def test_an_inactive_detector_publishes_no_event_but_counts_it(managed: Manage) -> None:
    """So a receiver notices by the sequence what it has missed."""
    events = list[ImpactEvent]()
    with managed(DetectorNode, sources="switch") as node:
        spinner, probe = node.spinner, node.spinner.probe
        probe.create_subscription(ImpactEvent, "impacts", events.append, qos_profile(EVENTS))
        switch = probe.create_publisher(Bool, "switch", qos_profile(STATES))

        def hit() -> None:
            """Close and open the switch."""
            for closed in (True, False):
                switch.publish(Bool(data=closed))
            spinner.settle(0.3)

        assert node.change(CONFIGURE, ACTIVATE)
        connected(spinner, switch)
        hit()
        assert node.change(DEACTIVATE)
        hit()
        assert node.change(ACTIVATE)
        hit()
        assert [each.sequence for each in events] == [1, 3]
        assert node.change(DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE)
        events.clear()
        connected(spinner, switch)
        hit()
        assert [each.sequence for each in events] == [1]
        assert node.change(SHUTDOWN)
        node.ended()


def test_an_inactive_monitor_publishes_no_error(managed: Manage) -> None:
    """A transition that is not possible changes nothing."""
    errors = list[EstimateError]()
    with managed(MonitorNode, model="two_mass") as node:
        spinner, probe = node.spinner, node.spinner.probe
        probe.create_subscription(EstimateError, "monitor/error", errors.append, MANY)
        topics = ("plant/joint_states", "observer/joint_states")
        publishers = [probe.create_publisher(JointState, each, MANY) for each in topics]

        def compare(stamp: int) -> None:
            """Publish a true state and an estimate of one ``stamp``."""
            names = ["x1", "x2"]
            state = JointState(name=names, position=[0.1, 0.2], velocity=[0.3, 0.4])
            state.header.stamp = ros_messages().time(stamp)
            for each in publishers:
                each.publish(state)
            spinner.settle(0.3)

        assert node.change(CONFIGURE)
        connected(spinner, *publishers)
        compare(1)
        assert node.change(ACTIVATE)
        spinner.until(lambda: probe.count_publishers("monitor/error"))
        compare(2)
        assert not node.change(CONFIGURE)
        assert node.state() == "active"
        compare(3)
        assert node.change(DEACTIVATE)
        compare(4)
        assert [each.header.stamp.nanosec for each in errors] == [2, 3]
        assert node.change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
        assert "transition 1 failed: the node is active" in node.ended()


def test_a_node_that_cannot_be_configured_says_why_and_stays_unconfigured(managed: Manage) -> None:
    """The line is the one with which a node ends that configures itself."""
    with managed(ObserverNode, model="no_such_model") as node:
        assert not node.change(CONFIGURE)
        assert node.state() == "unconfigured"
        assert node.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        log = node.ended()
    assert "transition 1 failed: no_such_model: no such file; expected a model file" in log
