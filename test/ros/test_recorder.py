# SPDX-License-Identifier: Apache-2.0
"""Recording topics of the ROS graph, over real DDS."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagReader, BagWriter, JointState, interfaces
from impact_observer.io.interfaces import Quality
from impact_observer.io.typestores import typestore
from impact_observer.ros import recorder as recorder_module
from impact_observer.ros.player import play
from impact_observer.ros.recorder import Recorder, record
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import message_class, qos_profile, ros_messages

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.publisher import Publisher

pytestmark = pytest.mark.ros
MAKE = ros_messages()
PATIENCE = 90.0
"""How long a slow machine may take, s."""
RECORD = """
import argparse, sys
from impact_observer.cli import record
parser = argparse.ArgumentParser()
record.add_arguments(parser)
sys.exit(record.run(parser.parse_args()))
"""


def advertise(node: "Node", topic: str, quality: Quality | None = None) -> "Publisher":
    """A publisher of one of our topics."""
    described = interfaces.interface(topic)
    assert described is not None
    profile = qos_profile(quality or described.quality)
    return node.create_publisher(message_class(described.type), topic, profile)


def event(stamp: int) -> object:
    """A message of an event."""
    return MAKE.event(ImpactEvent(stamp, (Switch("stop"),), stamp))


def spin_until(executor: "SingleThreadedExecutor", done: Callable[[], bool]) -> None:
    """Spin until a condition holds."""
    latest = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < latest, "it did not come"
        executor.spin_once(timeout_sec=0.05)


@contextmanager
def recording(
    path: Path, topics: list[str] | None = None
) -> Iterator[tuple[Recorder, "SingleThreadedExecutor"]]:
    """A recorder in this process."""
    with (
        ros_node("recorder") as (node, executor),
        BagWriter(path) as writer,
    ):
        recorder = Recorder(node, writer, topics)
        yield recorder, executor
        recorder.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_is_played_is_recorded_until_a_signal(
    tmp_path: Path, sample_bag: Path, ros_environment: dict[str, str], number: signal.Signals
) -> None:
    """Messages are equal byte for byte, in order, with qualities; the bag is whole."""
    command = [sys.executable, "-c", RECORD, "-o", str(tmp_path / "copy")]
    with subprocess.Popen(
        command, env=ros_environment, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            while not (tmp_path / "copy").exists():
                assert process.poll() is None
                time.sleep(0.05)
            play(sample_bag, delay=PATIENCE)
            process.send_signal(number)
            said, _ = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode == 0
    assert "recording /impacts [impact_observer_msgs/msg/ImpactEvent]" in said
    with BagReader(sample_bag) as original, BagReader(tmp_path / "copy") as copy:
        for topic in original.topics.values():
            pairs = zip(original.raw([topic.name]), copy.raw([topic.name]), strict=True)
            for sent, taken in pairs:
                assert taken.data[: len(sent.data)] == sent.data
                assert len(taken.data) - len(sent.data) < 4  # DDS fills up to a multiple of 4
            assert copy.topics[topic.name].quality == topic.quality
            assert copy.topics[topic.name].type == topic.type
            assert f"{topic.count} {topic.name}" in said
        times = [each.log_time for each in copy.raw()]
        assert times == sorted(times)
        assert abs(time.time() - times[0] * 1e-9) < 60


def test_latched_and_earlier_messages_are_recorded_by_a_late_recorder(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """The recorder asks for the quality that all publishers of a topic offer."""
    assert ros_environment
    with ros_node("plant") as (plant, _):
        model, impacts = advertise(plant, "/plant/model"), advertise(plant, "/impacts")
        for text in ("name: first", "name: last"):
            model.publish(MAKE.model(text))
        for stamp in range(1, 1501):
            impacts.publish(event(stamp))
        with recording(tmp_path / "bag") as (recorder, executor):
            spin_until(executor, lambda: recorder.counts.get("/impacts") == 1500)
            spin_until(executor, lambda: recorder.counts.get("/plant/model") == 1)
            assert recorder.missing == []
    with BagReader(tmp_path / "bag") as bag:
        assert [each.stamp for each in bag.events()] == list(range(1, 1501))
        assert bag.model_text() == "name: last"
        assert bag.topics["/impacts"].quality == interfaces.EVENTS
        assert bag.topics["/plant/model"].quality == interfaces.LATCHED


def test_best_effort_publishers_are_received_too(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """A reliable subscription would never connect to them."""
    assert ros_environment
    poor = Quality(reliable=False)
    with ros_node("sensor") as (sensor, _), recording(tmp_path / "bag") as (recorder, executor):
        impacts = advertise(sensor, "/impacts", poor)
        spin_until(executor, lambda: "/impacts" in recorder.counts)
        spin_until(executor, lambda: impacts.get_subscription_count() > 0)
        impacts.publish(event(1))
        spin_until(executor, lambda: recorder.counts["/impacts"] == 1)
    with BagReader(tmp_path / "bag") as bag:
        found = bag.topics["/impacts"].quality
    assert found == Quality(reliable=False, depth=2000)  # a publisher's depth cannot be seen


def test_burst_is_not_lost(tmp_path: Path, ros_environment: dict[str, str]) -> None:
    """Two thousand simultaneous events with states between them are recorded."""
    assert ros_environment
    state = MAKE.joint_state(JointState(1, ("a",), np.zeros(1), np.zeros(1)))
    with ros_node("plant") as (plant, _), recording(tmp_path / "bag") as (recorder, executor):
        impacts = advertise(plant, "/impacts")
        states = advertise(plant, "/plant/joint_states", Quality(depth=2000))
        spin_until(executor, lambda: len(recorder.counts.keys() & {"/impacts", states.topic}) == 2)
        spin_until(executor, lambda: states.get_subscription_count() > 0)
        for stamp in range(1, 2001):
            impacts.publish(event(stamp))
            states.publish(state)
        spin_until(executor, lambda: recorder.counts["/impacts"] == 2000)
        spin_until(executor, lambda: recorder.counts["/plant/joint_states"] == 2000)
    with BagReader(tmp_path / "bag") as bag:
        assert [each.stamp for each in bag.events()] == list(range(1, 2001))


def test_only_the_topics_asked_for_are_recorded(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """Topics may have relative names; a topic that never appears is reported as missing."""
    assert ros_environment
    with (
        ros_node("plant") as (plant, _),
        recording(tmp_path / "bag", ["impacts", "/absent"]) as (recorder, executor),
    ):
        advertise(plant, "/plant/model").publish(MAKE.model("x"))
        advertise(plant, "/impacts").publish(event(1))
        spin_until(executor, lambda: recorder.counts.get("/impacts") == 1)
        assert recorder.missing == ["/absent"]
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics.keys() == {"/impacts"}


def test_a_signal_amid_a_burst_leaves_a_whole_bag(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """The bag has every message up to its last; the counts are printed."""
    command = [sys.executable, "-c", RECORD, "-o", str(tmp_path / "bag")]
    command += ["--topics", "/impacts", "/absent", "/plant/model"]
    with (
        ros_node("plant") as (plant, _),
        subprocess.Popen(
            command, env=ros_environment, stdout=subprocess.PIPE, text=True
        ) as process,
    ):
        try:
            impacts = advertise(plant, "/impacts")
            silent = advertise(plant, "/plant/model")
            latest = time.monotonic() + PATIENCE
            while not (impacts.get_subscription_count() and silent.get_subscription_count()):
                assert time.monotonic() < latest
                time.sleep(0.05)
            for stamp in range(1, 1901):
                impacts.publish(event(stamp))
                if stamp == 900:
                    process.send_signal(signal.SIGTERM)
                time.sleep(0 if stamp % 20 else 0.001)
            said, _ = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode == 0
    with BagReader(tmp_path / "bag") as bag:
        stamps = [each.stamp for each in bag.events()]
        assert {each.name for each in bag.topics.values()} == {"/impacts", "/plant/model"}
    assert stamps == list(range(1, len(stamps) + 1))
    assert len(stamps) >= 900
    assert f"{len(stamps)} /impacts\n" in said
    assert "0 /plant/model: no messages\n" in said
    assert "0 /absent: never appeared\n" in said


def test_a_killed_recorder_loses_the_last_second_only(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """Another library reads the messages from the file that was never closed."""
    command = [sys.executable, "-c", RECORD, "-o", str(tmp_path / "bag")]
    stamps: list[int] = []
    with (
        ros_node("plant") as (plant, _),
        subprocess.Popen(
            command, env=ros_environment, stdout=subprocess.PIPE, text=True
        ) as process,
    ):
        try:
            impacts = advertise(plant, "/impacts")
            latest = time.monotonic() + PATIENCE
            while not impacts.get_subscription_count():
                assert time.monotonic() < latest
                time.sleep(0.05)
            for stamp in range(1, 11):
                impacts.publish(event(stamp))
            while len(stamps) < 10:
                assert time.monotonic() < latest
                time.sleep(0.1)
                stamps = messages_on_disk(tmp_path / "bag" / "bag_0.mcap")
        finally:
            process.kill()
    assert messages_on_disk(tmp_path / "bag" / "bag_0.mcap") == stamps


def messages_on_disk(file: Path) -> list[int]:
    """Log times of the messages on ``/impacts`` in an MCAP file that may have no end."""
    found = list[int]()
    impacts = set[int]()
    with suppress(EndOfFile):
        for each in StreamReader(BytesIO(file.read_bytes())).records:
            if isinstance(each, Channel) and each.topic == "/impacts":
                impacts.add(each.id)
            if isinstance(each, Message) and each.channel_id in impacts:
                found.append(each.log_time)
    return found


def test_foreign_type_is_recorded_with_its_installed_definition(
    tmp_path: Path, ros_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """``std_msgs/String`` stands for a type of another package."""
    assert ros_environment
    definitions = []

    def installed(type_name: str) -> str:
        definitions.append(type_name)
        return "string data\n"

    fields = dict(typestore().fielddefs)
    del fields[interfaces.STRING]
    poor = type("Store", (), {"fielddefs": fields})()
    monkeypatch.setattr(recorder_module, "typestore", lambda: poor)
    monkeypatch.setattr(recorder_module, "installed_definition", installed)
    with ros_node("plant") as (plant, _), recording(tmp_path / "bag") as (recorder, executor):
        advertise(plant, "/plant/model").publish(MAKE.model("x"))
        spin_until(executor, lambda: recorder.counts.get("/plant/model") == 1)
    assert definitions == [interfaces.STRING]


def test_type_that_cannot_be_described_is_left_out_with_one_warning(
    tmp_path: Path,
    ros_environment: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The warning names topic and type; other topics are recorded."""
    assert ros_environment
    fields = dict(typestore().fielddefs)
    del fields[interfaces.STRING]
    poor = type("Store", (), {"fielddefs": fields})()
    monkeypatch.setattr(recorder_module, "typestore", lambda: poor)
    monkeypatch.setattr(recorder_module, "installed_definition", lambda _: None)
    with ros_node("plant") as (plant, _), recording(tmp_path / "bag") as (recorder, executor):
        advertise(plant, "/plant/model").publish(MAKE.model("x"))
        impacts = advertise(plant, "/impacts")
        spin_until(executor, lambda: "/impacts" in recorder.counts)
        for _ in range(10):
            executor.spin_once(timeout_sec=0.1)
        assert impacts.get_subscription_count() == 1
    warnings = capfd.readouterr().err
    assert warnings.count("/plant/model is not recorded: the definition of std_msgs/msg/Str") == 1
    with BagReader(tmp_path / "bag") as bag:
        assert "/plant/model" not in bag.topics


def test_later_publisher_of_less_quality_is_warned_of_once(
    tmp_path: Path, ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """The later publisher's messages cannot reach the subscription to the first."""
    assert ros_environment
    with (
        ros_node("plant") as (plant, _),
        ros_node("sensor") as (sensor, _),
        recording(tmp_path / "bag") as (recorder, executor),
    ):
        advertise(plant, "/impacts").publish(event(1))
        spin_until(executor, lambda: recorder.counts.get("/impacts") == 1)
        advertise(sensor, "/impacts", Quality(reliable=False))
        latest = time.monotonic() + 2
        spin_until(executor, lambda: time.monotonic() > latest)
    assert capfd.readouterr().err.count("/impacts has a new publisher that is less reliable") == 1


def test_wrong_use_is_an_error_before_anything_is_written(tmp_path: Path) -> None:
    """An invalid duration or topic, or a bag that exists already."""
    with pytest.raises(UsageError, match=r"duration is 0\.0; expected a positive number"):
        record(tmp_path / "bag", duration=0.0)
    with pytest.raises(
        UsageError, match=r"^topic 'bad name': topic name must not contain [^\n]*$"
    ):
        record(tmp_path / "bag", ["/impacts", "bad name"], duration=1.0)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "bag").mkdir()
    with pytest.raises(UsageError, match="exists already"):
        record(tmp_path / "bag", duration=1.0)
