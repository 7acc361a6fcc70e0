# SPDX-License-Identifier: Apache-2.0
"""The detector node: sensors over real DDS, a bag that is played, diagnostics."""

import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import ImpactEvent
from processes import PATIENCE, Spinner, hosted, interrupt, ros_arguments, running_node, spinning
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from signals import MS
from std_msgs.msg import Bool, Empty, Float64

from impact_observer.cli.main import main
from impact_observer.detector.sensors import MAX_DELAY
from impact_observer.events import ImpactEvent as Event
from impact_observer.events import Kind, Switch
from impact_observer.io import BagWriter
from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.io.messages import read_event
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.io.typestores import typestore
from impact_observer.ros.detector_node import DetectorNode
from impact_observer.ros.player import Player
from impact_observer.ros.recorder import Recorder
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]

EPOCH = (int(time.time()) - 5) * NS_PER_S  # near the clock, as that of a rig
BEST_EFFORT = Quality(reliable=False, depth=1000)
SOURCES = """sources:
- {contact: stop, topic: switch}
- {contact: wall, topic: /imu, threshold: 20}
"""


@dataclass
class Rig:
    """A running detector node, publishers of its sensors, and what was received from it."""

    spinner: Spinner
    node: DetectorNode
    events: list[Event] = field(default_factory=list)
    diagnostics: list[DiagnosticStatus] = field(default_factory=list)

    def sensor(self, kind: type, topic: str, quality: Quality) -> Publisher:
        """A publisher that the node listens to."""
        publisher = self.spinner.probe.create_publisher(kind, topic, qos_profile(quality))
        self.spinner.until(lambda: publisher.get_subscription_count() == 1)
        return publisher

    def until_events(self, count: int) -> None:
        """Spin until a number of events have been received."""
        self.spinner.until(lambda: len(self.events) >= count)

    def diagnosis(self, contact: str) -> DiagnosticStatus:
        """The diagnosis of a contact now, or the next one of the node."""
        if own := [each for each in self.node.statuses() if each.hardware_id == contact]:
            return own[0]
        self.diagnostics.clear()
        self.spinner.until(lambda: any(s.hardware_id == contact for s in self.diagnostics))
        return next(s for s in self.diagnostics if s.hardware_id == contact)


def make_rig(spinner: Spinner) -> Rig:
    """A detector node beside a probe."""
    node = DetectorNode()
    spinner.add(node)
    rig = Rig(spinner, node)
    spinner.probe.create_subscription(
        ImpactEvent, "impacts", lambda m: rig.events.append(read_event(m)), qos_profile(EVENTS)
    )
    spinner.probe.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda array: rig.diagnostics.extend(array.status),
        qos_profile(Quality(depth=1000)),
    )
    return rig


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A switch and an accelerometer."""
    path = tmp_path / "rig.yaml"
    path.write_text(SOURCES, encoding="utf-8")
    return path


@pytest.fixture
def rig(ros_environment: dict[str, str], sources: Path) -> Iterator[Rig]:
    """A rig by the wall clock."""
    assert ros_environment
    with spinning(ros_arguments({"sources": sources, "epoch": EPOCH})) as spinner:
        yield make_rig(spinner)


@pytest.mark.parametrize("quality", [STATES, BEST_EFFORT], ids=["reliable", "best effort"])
def test_a_switch_is_received_whatever_its_quality_of_service(rig: Rig, quality: Quality) -> None:
    """A short closure is an IMPACT; a long one without messages is a CLOSE and an OPEN."""
    switch = rig.sensor(Bool, "switch", quality)
    before = time.time_ns()
    switch.publish(Bool(data=True))
    rig.until_events(1)
    after = time.time_ns()
    switch.publish(Bool(data=False))
    rig.spinner.settle(0.2)
    assert [e.switches for e in rig.events] == [(Switch("stop"),)]
    assert before <= rig.events[0].stamp <= after
    assert rig.events[0].epoch == EPOCH
    switch.publish(Bool(data=True))
    rig.until_events(3)
    assert rig.events[2] == Event(
        rig.events[1].stamp, (Switch("stop", Kind.CLOSE),), 3, epoch=EPOCH
    )
    assert time.time_ns() >= rig.events[1].stamp + 50 * MS + MAX_DELAY
    switch.publish(Bool(data=False))
    rig.until_events(4)
    assert rig.events[3].switches == (Switch("stop", Kind.OPEN),)


def test_a_less_reliable_publisher_that_comes_later_is_received_too(rig: Rig) -> None:
    """The subscription asks for the quality that all publishers offer."""
    rig.sensor(Bool, "switch", STATES)
    second = rig.sensor(Bool, "switch", BEST_EFFORT)
    second.publish(Bool(data=True))
    rig.until_events(1)
    assert rig.events[0].switches == (Switch("stop"),)


def test_a_latched_switch_that_was_closed_before_the_node_started_is_closed(sources: Path) -> None:
    """The event has the stamp of the closing; a later volatile publisher is received too."""
    with spinning(ros_arguments({"sources": sources, "epoch": EPOCH})) as spinner:
        latched = spinner.probe.create_publisher(
            Bool, "switch", qos_profile(Quality(transient_local=True, depth=1))
        )
        before = time.time_ns()
        for closed in (False, True):
            latched.publish(Bool(data=closed))
        after = time.time_ns()
        spinner.settle(0.2)
        rig = make_rig(spinner)
        rig.until_events(2)
        assert [e.switches for e in rig.events] == [
            (Switch("stop"),),
            (Switch("stop", Kind.CLOSE),),
        ]
        assert before <= rig.events[0].stamp == rig.events[1].stamp <= after
        volatile = rig.sensor(Bool, "switch", STATES)
        volatile.publish(Bool(data=False))
        rig.until_events(3)
        assert rig.events[2].switches == (Switch("stop", Kind.OPEN),)


def test_stamps_of_headers_are_exact(rig: Rig) -> None:
    """The event is at the top of the parabola through the samples of a peak."""
    imu = rig.sensor(Imu, "imu", BEST_EFFORT)
    for k, value in enumerate((0.0, 0.0, 30.0, 40.0, 20.0, 0.0)):
        message = Imu()
        message.header.stamp = ros_messages().time(EPOCH + k * MS)
        message.linear_acceleration.x = value
        message.linear_acceleration.z = 9.81
        imu.publish(message)
    rig.until_events(1)
    top = -0.5 + 10 / (10 + 20)
    assert rig.events[0].switches == (Switch("wall"),)
    assert rig.events[0].stamp == pytest.approx(EPOCH + (3 + top) * MS, abs=0.01 * MS)


def test_diagnostics_have_the_state_of_each_sensor(rig: Rig) -> None:
    """A sensor without a publisher, messages, rate, events and invalid messages are reported."""
    status = rig.diagnosis("wall")
    assert status.level == DiagnosticStatus.WARN
    assert status.message == "no node publishes /imu"
    switch = rig.sensor(Bool, "switch", BEST_EFFORT)
    for data in (True, False):
        switch.publish(Bool(data=data))
        rig.spinner.settle(0.05)
    rig.until_events(1)
    rig.diagnosis("stop")
    status = rig.diagnosis("stop")
    values = {each.key: each.value for each in status.values}
    assert (status.level, status.message) == (DiagnosticStatus.OK, "1 impacts")
    assert (values["messages"], values["impacts"], values["kind"]) == ("2", "1", "switch")
    assert float(values["last event [s]"]) == pytest.approx(time.time(), abs=60)
    imu = rig.sensor(Imu, "imu", BEST_EFFORT)
    message = Imu()
    message.linear_acceleration.x = float("nan")
    imu.publish(message)
    rig.spinner.until(
        lambda: any(s.message.startswith("wall: 1 messages not usable") for s in rig.diagnostics)
    )


def test_a_clock_that_jumps_back_is_a_new_episode(sources: Path) -> None:
    """Simulated time stamps messages without a header; no event comes before it begins."""
    with spinning(ros_arguments({"sources": sources, "use_sim_time": True})) as spinner:
        rig = make_rig(spinner)
        clock = spinner.probe.create_publisher(Clock, "/clock", qos_profile(STATES))
        spinner.until(lambda: clock.get_subscription_count() == 1)
        switch = rig.sensor(Bool, "switch", STATES)
        switch.publish(Bool(data=True))
        spinner.until(lambda: any("no /clock has come" in s.message for s in rig.diagnostics))

        def tick(stamp: int) -> None:
            clock.publish(ros_messages().clock(stamp))
            spinner.until(lambda: rig.node.get_clock().now().nanoseconds == stamp)

        for stamp, data in ((EPOCH, True), (EPOCH + 6 * MS, False), (EPOCH - 9, True)):
            tick(stamp)
            switch.publish(Bool(data=data))
            spinner.settle(0.1)
        assert [(e.stamp, e.sequence, e.episode) for e in rig.events] == [
            (EPOCH, 1, 0),
            (EPOCH - 9, 1, 1),
        ]


def test_the_node_publishes_the_events_that_detect_finds_in_a_recording_of_it(
    rig: Rig, sources: Path, tmp_path: Path
) -> None:
    """Impacts and persistent contacts are the same events, in any order of arrival."""
    sources.write_text(
        "sources: [{contact: wall, topic: imu, kind: switch, field: linear_acceleration.x,"
        " threshold: 10}]",
        encoding="utf-8",
    )
    rig.spinner.executor.remove_node(rig.node)
    rig.node.destroy_node()
    rig.spinner.add(DetectorNode())
    sensor = Node("sensor", use_global_arguments=False)  # a recorder leaves its own topics out
    rig.spinner.add(sensor)
    random = np.random.default_rng(3)
    with BagWriter(tmp_path / "bag") as writer:
        recorder = Recorder(rig.spinner.probe, writer, ["imu"])
        imu = sensor.create_publisher(Imu, "imu", qos_profile(STATES))
        rig.spinner.until(lambda: recorder.take() or imu.get_subscription_count() == 2)
        rig.spinner.settle(0.5)
        start, value = time.time_ns(), 0.0
        changes = np.cumsum(random.choice([5, 8, 20, 45, 90, 130], 40)) * MS
        for change in changes.tolist():
            while time.time_ns() < start + change:
                rig.spinner.executor.spin_once(timeout_sec=0.001)
                recorder.take()
            value = 20.0 - value
            message = Imu()
            message.header.stamp = ros_messages().time(start + change)
            message.linear_acceleration.x = value
            imu.publish(message)
        rig.spinner.settle(0.5)
        recorder.drain()
    output = tmp_path / "out"
    found = ["--sources", str(sources), "--epoch", str(EPOCH // NS_PER_S)]
    assert recorder.counts == {"/imu": 40}
    assert main(["detect", str(tmp_path / "bag"), *found, "-o", str(output)]) == 0
    with BagReader(output) as reader:
        wanted = events_in(reader)
    assert len(wanted) > 20
    assert sorted(rig.events, key=lambda e: (e.stamp, e.sequence)) == wanted


def test_a_bag_that_is_played_gives_the_events_that_detect_finds(tmp_path: Path) -> None:
    """Stamps under simulated time are equal to 60 ms; the bag is played slowly."""
    sources = tmp_path / "rig.yaml"
    sources.write_text(SOURCES, encoding="utf-8")
    bag = tmp_path / "bag"
    types = typestore().types
    with BagWriter(bag) as writer:
        writer.declare("/switch", type_name="std_msgs/msg/Bool")
        for k in range(6):
            for t, value in ((0, True), (120 if k % 2 else 10, False)):
                stamp = EPOCH + (200 + 300 * k + t) * MS
                writer.write("/switch", stamp, types["std_msgs/msg/Bool"](data=value))
    output = tmp_path / "out"
    assert main(["detect", str(bag), "--sources", str(sources), "-o", str(output)]) == 0
    with BagReader(output) as reader:
        wanted = events_in(reader)
    assert len(wanted) == 12
    with (
        hosted(DetectorNode, {"sources": sources, "use_sim_time": True}) as (_, spinner),
        BagReader(bag) as reader,
        ros_node("player") as (node, _),
        ThreadPoolExecutor(1) as pool,
    ):
        messages = spinner.collect(ImpactEvent, "impacts", EVENTS)
        player = Player(node, reader, rate=0.4)
        spinner.until(pool.submit(player.wait_for_subscribers, PATIENCE).done)
        spinner.until(pool.submit(player.play).done)
        spinner.until(lambda: len(messages) >= len(wanted))
    received = [*map(read_event, messages)]
    received.sort(key=lambda e: (e.stamp, e.sequence))
    assert [e.switches for e in received] == [e.switches for e in wanted]
    late = [abs(a.stamp - b.stamp) for a, b in zip(received, wanted, strict=True)]
    assert max(late) <= 60 * MS


def test_a_fast_sensor_does_not_outrun_the_node(rig: Rig) -> None:
    """Two thousand waiting messages are taken a batch at a time."""
    imu = rig.sensor(Imu, "imu", Quality(depth=5000))
    message = Imu()
    for k in range(2000):
        message.header.stamp = ros_messages().time(EPOCH + k * MS)
        message.linear_acceleration.x = 40.0 if k % 100 == 50 else 0.0
        imu.publish(message)
    rig.until_events(20)
    stamps = [event.stamp for event in rig.events]
    wanted = [EPOCH + (50 + 100 * k) * MS for k in range(20)]
    np.testing.assert_allclose(stamps, wanted, rtol=0, atol=0.02 * MS)


def test_a_topic_that_is_not_what_was_declared_is_an_error_until_its_type_changes(
    tmp_path: Path,
) -> None:
    """The diagnostics name the key; a publisher that comes later is received."""
    sources = tmp_path / "rig.yaml"
    sources.write_text("sources: [{contact: stop, topic: force}]", encoding="utf-8")
    with (
        spinning(ros_arguments({"sources": sources})) as spinner,
        ros_node("sensor") as (node, _),  # a participant has one type of a topic
    ):
        rig = make_rig(spinner)
        first = node.create_publisher(Float64, "force", qos_profile(STATES))
        wanted = f"{sources}: sources[0].kind: is missing"
        spinner.until(lambda: rig.diagnosis("stop").message.startswith(wanted))
        assert rig.diagnosis("stop").level == DiagnosticStatus.ERROR
        assert rig.diagnosis("/detector").message.startswith(wanted)
        node.destroy_publisher(first)
        for kind, message in ((Bool, Bool(data=True)), (Empty, Empty())):
            count = len(rig.events)
            sensor = node.create_publisher(kind, "force", qos_profile(STATES))
            spinner.until(sensor.get_subscription_count)
            sensor.publish(message)
            rig.until_events(count + 1)
            assert rig.diagnosis("stop").level == DiagnosticStatus.OK
            node.destroy_publisher(sensor)


def test_a_long_message_is_refused_and_told(sources: Path) -> None:
    """The next message is used."""
    given = {"sources": sources, "epoch": EPOCH, "max_message": 1000}
    with spinning(ros_arguments(given)) as spinner:
        rig = make_rig(spinner)
        imu = rig.sensor(Imu, "imu", BEST_EFFORT)
        message = Imu()
        message.header.frame_id = "x" * 1000
        imu.publish(message)
        spinner.until(lambda: rig.diagnosis("/detector").level == DiagnosticStatus.WARN)
        status = rig.diagnosis("/detector")
        assert "max_message allows 1000" in status.message
        assert [(each.key, each.value) for each in status.values] == [("/imu: refused", "1")]
        imu.publish(Imu())
        spinner.until(
            lambda: ("messages", "1") in {(v.key, v.value) for v in rig.diagnosis("wall").values}
        )


def test_an_error_does_not_end_a_node(ros_environment: dict[str, str], sources: Path) -> None:
    """A field that no message has is an error each time; the node goes on, and ends in order."""
    text = SOURCES.replace("topic: switch", "topic: switch, field: dat")
    sources.write_text(text, encoding="utf-8")
    statuses: list[DiagnosticStatus] = []
    arguments = ros_arguments({"sources": sources})
    with running_node("detector", arguments, ros_environment) as process, spinning() as spinner:
        spinner.probe.create_subscription(
            DiagnosticArray, "/diagnostics", lambda array: statuses.extend(array.status), 100
        )
        switch = spinner.probe.create_publisher(Bool, "switch", qos_profile(STATES))
        spinner.until(lambda: switch.get_subscription_count() == 1)
        switch.publish(Bool(data=True))
        spinner.until(lambda: any(each.level == DiagnosticStatus.ERROR for each in statuses))
        code, errors = interrupt(process, signal.SIGTERM)
    assert code == 0
    assert "sources[0].field: switch: the message has no dat" in errors
