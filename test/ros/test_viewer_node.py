# SPDX-License-Identifier: Apache-2.0
"""The viewer node: markers of plant and estimates, stamped, under stable ids."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")
pytest.importorskip("visualization_msgs")

from builtin_interfaces.msg import Time
from impact_observer_msgs.msg import ImpactEvent
from processes import Spinner, interrupt, refusal, ros_arguments, running_node, spinning
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState as JointStateMessage
from systems import system
from visualization_msgs.msg import Marker, MarkerArray

from impact_observer.draw.scene.scene import Scene
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent as Event
from impact_observer.events import Kind, Switch
from impact_observer.io.interfaces import EVENTS, STATES, VIEWER_MARKERS
from impact_observer.io.messages import JointState
from impact_observer.model import read_model
from impact_observer.ros.markers import ESTIMATE, PLANT, MarkerRow, Painter
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.viewer_node import ViewerNode
from impact_observer.states import Vector

pytestmark = pytest.mark.ros

EPOCH = 5_000_000_000
MODEL = read_model("two_mass")
SCENE = Scene.of_system(MODEL.system, [MODEL.initial_state()[0]])
OBSERVERS = ("observer_geometric", "observer_kinematic")


def shapes(markers: list[Marker], row: str, kind: str) -> dict[int, Marker]:
    """Markers of a row and kind, by id."""
    return {each.id: each for each in markers if each.ns == f"{row}/{kind}"}


def is_lit(marker: Marker) -> bool:
    """Whether a stop has the colour of one that is hit."""
    return bool(marker.color.r > 2 * marker.color.g)


@dataclass
class Rig:
    """A viewer and a probe that plays plant, observers and RViz."""

    spinner: Spinner
    states: dict[str, Publisher]
    impacts: Publisher
    received: list[MarkerArray] = field(default_factory=list)

    def publish_state(self, owner: str, stamp: int, q: list[float]) -> None:
        """Publish a state."""
        state = JointState(stamp, ("x1", "x2"), np.array(q), np.zeros(2))
        self.states[owner].publish(ros_messages().joint_state(state))

    def hit(self, stamp: int, kind: Kind, sequence: int) -> None:
        """Publish an event of the stop."""
        event = Event(stamp, (Switch("stop", kind),), sequence, 1, EPOCH)
        self.impacts.publish(ros_messages().event(event))

    def shown(self, row: str, stamp: int) -> list[Marker]:
        """The next markers of a row whose state has a stamp."""
        del self.received[:]
        wanted = ros_messages().time(stamp)
        self.spinner.until(lambda: any(self._of(each, row, wanted) for each in self.received))
        return next(found for each in self.received if (found := self._of(each, row, wanted)))

    @staticmethod
    def _of(array: MarkerArray, row: str, time: Time) -> list[Marker]:
        own = [each for each in array.markers if each.ns.startswith(f"{row}/")]
        return [each for each in own if each.header.stamp == time]


@pytest.fixture
def rig(ros_environment: dict[str, str]) -> Iterator[Rig]:
    """A viewer of a plant and two observers."""
    assert ros_environment
    arguments = {"model": "two_mass", "observers": ",".join(OBSERVERS), "rate": 50.0}
    with spinning(ros_arguments(arguments)) as spinner:
        probe, states = spinner.probe, qos_profile(STATES)
        topics = {
            owner: probe.create_publisher(JointStateMessage, f"{owner}/joint_states", states)
            for owner in ("plant", *OBSERVERS)
        }
        impacts = probe.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))
        made = Rig(spinner, topics, impacts)
        quality = qos_profile(VIEWER_MARKERS.quality)
        probe.create_subscription(MarkerArray, "viewer/markers", made.received.append, quality)
        spinner.add(ViewerNode())
        publishers = [*topics.values(), impacts]
        spinner.until(lambda: all(each.get_subscription_count() == 1 for each in publishers))
        yield made


def test_viewer_shows_what_comes_and_removes_what_was_there(rig: Rig) -> None:
    """DELETEALL comes first, then each row that has a state, at the place of the state."""
    rig.spinner.until(lambda: rig.received)
    assert [each.action for each in rig.received[0].markers] == [Marker.DELETEALL]
    assert all(len(each.markers) == 1 for each in rig.received)
    rig.publish_state("plant", EPOCH + 10, [0.1, -0.2])
    plant = rig.shown("plant", EPOCH + 10)
    assert not any(
        each.ns.startswith("observer") for array in rig.received for each in array.markers
    )
    rig.publish_state(OBSERVERS[1], EPOCH + 20, [0.3, 0.4])
    estimate = rig.shown(OBSERVERS[1], EPOCH + 20)
    for markers, row, q in ((plant, "plant", [0.1, -0.2]), (estimate, OBSERVERS[1], [0.3, 0.4])):
        bodies = shapes(markers, row, "bodies")
        found = [bodies[slot].pose.position.x for slot in range(2)]
        np.testing.assert_allclose(found, SCENE.frame(np.array(q)).bodies)
        assert {each.header.frame_id for each in markers} == {"world"}
    assert {(each.ns.partition("/")[2], each.id) for each in plant} == {
        (each.ns.partition("/")[2], each.id) for each in estimate
    }


def test_viewer_lights_stops_that_are_hit_or_closed(rig: Rig) -> None:
    """An impact lights its stop for a moment, a closed contact until the contact opens."""
    rig.hit(EPOCH + 1_000_000_000, Kind.IMPACT, 1)
    for k, (ms, lit) in enumerate([(900, False), (1050, True), (1900, False)]):
        stamp = EPOCH + ms * 1_000_000
        rig.spinner.settle(0.1)
        rig.publish_state("plant", stamp, [0.0, 0.5])
        stop = shapes(rig.shown("plant", stamp), "plant", "stops")[0]
        assert is_lit(stop) is lit, k
    rig.hit(EPOCH + 2_000_000_000, Kind.CLOSE, 2)
    rig.spinner.settle(0.1)
    rig.publish_state("plant", EPOCH + 9_000_000_000, [0.0, 0.5])
    shown = rig.shown("plant", EPOCH + 9_000_000_000)
    assert is_lit(shapes(shown, "plant", "stops")[0])
    rig.hit(EPOCH + 9_500_000_000, Kind.OPEN, 3)
    rig.spinner.settle(0.1)
    shown = rig.shown("plant", EPOCH + 9_000_000_000)
    assert not is_lit(shapes(shown, "plant", "stops")[0])


def test_viewer_begins_again_with_a_bag_that_is_played_again(rig: Rig) -> None:
    """The second pass lights the same stops; contacts left closed by the first pass are open."""
    for _ in range(2):
        for ms, lit in ((1050, True), (1500, False)):
            stamp = EPOCH + ms * 1_000_000
            rig.hit(EPOCH + 1_000_000_000, Kind.IMPACT, 1)
            rig.spinner.settle(0.1)
            rig.publish_state("plant", stamp, [0.0, 0.5])
            assert is_lit(shapes(rig.shown("plant", stamp), "plant", "stops")[0]) is lit
        rig.hit(EPOCH + 5_000_000_000, Kind.CLOSE, 2)
        rig.spinner.settle(0.1)
        rig.received.clear()


def test_viewer_follows_another_run_of_the_sender_with_two_events(rig: Rig) -> None:
    """A single message of another episode changes nothing, as in an observer."""
    stamp = EPOCH + 9_000_000_000
    rig.hit(EPOCH + 2_000_000_000, Kind.CLOSE, 1)
    for sequence, lit in ((1, True), (2, False)):
        at = EPOCH + (2 + sequence) * 1_000_000_000
        switches = (Switch("stop", Kind.OPEN),)
        event = Event(at, switches, sequence, 7, EPOCH)
        rig.impacts.publish(ros_messages().event(event))
        rig.spinner.settle(0.1)
        rig.publish_state("plant", stamp + sequence, [0.0, 0.5])
        assert is_lit(shapes(rig.shown("plant", stamp + sequence), "plant", "stops")[0]) is lit


def test_viewer_takes_columns_by_name_and_refuses_others(rig: Rig) -> None:
    """A state of another model is not shown."""
    wrong = JointState(EPOCH + 1, ("x1", "y"), np.zeros(2), np.zeros(2))
    rig.states["plant"].publish(ros_messages().joint_state(wrong))
    turned = JointState(EPOCH + 2, ("x2", "x1"), np.array([0.4, 0.1]), np.zeros(2))
    rig.states["plant"].publish(ros_messages().joint_state(turned))
    bodies = shapes(rig.shown("plant", EPOCH + 2), "plant", "bodies")
    found = [bodies[slot].pose.position.x for slot in range(2)]
    np.testing.assert_allclose(found, SCENE.frame(np.array([0.1, 0.4])).bodies)


def markers(scene: Scene, q: Vector, place: int = 0, lit: tuple[int, ...] = ()) -> list[Marker]:
    """Markers of one row."""
    row = MarkerRow("row", place, PLANT if place == 0 else ESTIMATE)
    return Painter(scene, "world").markers(row, q, lit, Time(sec=7))


def test_rows_stand_side_by_side() -> None:
    """The rows are equal except for their offset, and do not overlap."""
    one, two = (markers(SCENE, np.zeros(2), place) for place in (0, 1))
    for first, second in zip(one, two, strict=True):
        if first.type == Marker.LINE_LIST:
            assert len(first.points) == len(second.points)
            continue
        assert first.pose.position.x == second.pose.position.x
        assert first.pose.position.z == second.pose.position.z
        assert first.pose.position.y - second.pose.position.y > 2 * SCENE.half
    assert all(each.header.stamp.sec == 7 for each in one)


def test_markers_of_all_kinds_of_contacts_are_valid() -> None:
    """RViz needs positive scales, whole pairs of points, a text, an orientation, an id."""
    K = 5 * np.eye(4) - np.ones((4, 4))
    contacts = [
        ([0.0, 0.0, 0.0, -1.0], 0.2, 0.5),
        ([-1.0, 1.0, 0.0, 0.0], 0.1, 0.5),
        ([1.0, 1.0, 1.0, 0.0], 0.3, 0.5),
    ]
    model = system(np.eye(4), np.zeros((4, 4)), K, contacts=contacts)
    found = markers(Scene.of_system(model), np.array([0.1, 0.0, -0.1, 0.2]), lit=(1,))
    keys = [(each.ns, each.id) for each in found]
    assert len(set(keys)) == len(keys)
    assert sorted(shapes(found, "row", "stops")) == [0, 1, 2]
    assert [is_lit(shapes(found, "row", "stops")[i]) for i in range(3)] == [False, True, False]
    for each in found:
        assert each.pose.orientation.w == 1.0
        assert each.color.a == 1.0
        if each.type == Marker.CUBE:
            assert min(each.scale.x, each.scale.y, each.scale.z) > 0
        elif each.type == Marker.LINE_LIST:
            assert each.scale.x > 0
            assert len(each.points) % 2 == 0
            assert each.points
        else:
            assert each.type == Marker.TEXT_VIEW_FACING
            assert each.scale.z > 0
            assert each.text


def test_viewer_runs_as_a_process_and_ends_in_good_order(
    ros_environment: dict[str, str],
) -> None:
    """The process has a name of its own, and ends on Ctrl-C."""
    arguments = ros_arguments({"model": "three_mass"}, "__node:=my_viewer")
    with spinning() as spinner, running_node("viewer", arguments, ros_environment) as process:
        names = spinner.probe.get_node_names
        spinner.until(lambda: process.poll() is not None or "my_viewer" in names())
        code, errors = interrupt(process)
    assert code == 0, errors


def test_wrong_parameters_are_one_line(
    ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """The line names the parameter."""
    assert ros_environment
    arguments = ros_arguments({"model": "two_mass", "observers": "'a,,b'"})
    line = refusal("viewer", arguments, capfd)
    assert "parameter observers: 'a,,b' has an empty name" in line
    for names, line in (("a-b", "no name of a node"), ("plant", "leave it out")):
        wrong = ros_arguments({"model": "two_mass", "observers": names})
        with spinning(wrong), pytest.raises(UsageError, match=line):
            ViewerNode()
    wrong = ros_arguments({"model": "two_mass", "amplitude": -1.0})
    with spinning(wrong), pytest.raises(UsageError, match="parameter amplitude"):
        ViewerNode()
