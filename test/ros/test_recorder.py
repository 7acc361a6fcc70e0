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
    from rclpy.node import Node
    from rclpy.publisher import Publisher

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]
MAKE = ros_messages()
PATIENCE = 90.0
"""How long a slow machine may take, s."""


def advertise(node: "Node", topic: str, quality: Quality | None = None) -> "Publisher":
    """A publisher of one of our topics."""
    described = interfaces.interface(topic)
    assert described is not None
    profile = qos_profile(quality or described.quality)
    return node.create_publisher(message_class(described.type), topic, profile)


def event(stamp: int) -> object:
    """A message of an event."""
    return MAKE.event(ImpactEvent(stamp, (Switch("stop"),), stamp))


@contextmanager
def recording(path: Path, topics: list[str] | None = None) -> Iterator[Recorder]:
    """A recorder in this process."""
    with ros_node("recorder") as (node, _), BagWriter(path) as writer:
        yield Recorder(node, writer, topics)


def take_until(recorder: Recorder, done: Callable[[], object]) -> None:
    """Record until a condition holds."""
    latest = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < latest, "it did not come"
        recorder.take()
        time.sleep(0.01)


@contextmanager
def recording_process(
    environment: dict[str, str], *arguments: str
) -> Iterator["subprocess.Popen[str]"]:
    """The command as a process, killed at the end."""
    command = [sys.executable, "-m", "impact_observer", "record", *arguments]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def connected(*publishers: "Publisher") -> None:
    """Wait until each publisher has a subscriber."""
    latest = time.monotonic() + PATIENCE
    while not all(each.get_subscription_count() for each in publishers):
        assert time.monotonic() < latest
        time.sleep(0.05)


def test_what_is_played_is_recorded_until_a_signal(
    tmp_path: Path, sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """Messages are equal byte for byte, in order, with qualities; a topic may never appear."""
    copied, topics = tmp_path / "copy", ["/absent"]
    with BagReader(sample_bag) as original:
        topics += original.topics
    with recording_process(ros_environment, "-o", str(copied), "--topics", *topics) as process:
        while not copied.exists():
            assert process.poll() is None
            time.sleep(0.05)
        play(sample_bag, delay=PATIENCE)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "recording /impacts [impact_observer_msgs/msg/ImpactEvent]" in said
    assert "0 /absent: never appeared\n" in said
    with BagReader(sample_bag) as original, BagReader(copied) as copy:
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


def test_a_late_recorder_has_earlier_messages_bursts_and_what_is_best_effort(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Each topic is taken with the quality that all its first publishers offer.

    A later publisher of less quality cannot reach that subscription, which is a warning, once.
    """
    state = MAKE.joint_state(JointState(1, ("a",), np.zeros(1), np.zeros(1)))
    with ros_node("plant") as (plant, _), ros_node("sensor") as (sensor, _):
        model, impacts = advertise(plant, "/plant/model"), advertise(plant, "/impacts")
        states = advertise(plant, "/plant/joint_states", Quality(reliable=False, depth=3000))
        for text in ("name: first", "name: last"):
            model.publish(MAKE.model(text))
        for stamp in range(1, 1501):
            impacts.publish(event(stamp))
        with recording(tmp_path / "bag") as recorder:
            counts = recorder.counts
            take_until(recorder, lambda: counts.get("/impacts") == 1500)
            take_until(recorder, lambda: counts.get("/plant/model") == 1)
            take_until(recorder, states.get_subscription_count)
            states.publish(state)
            take_until(recorder, lambda: counts["/plant/joint_states"] == 1)
            for stamp in range(1501, 3501):
                impacts.publish(event(stamp))
            take_until(recorder, lambda: counts["/impacts"] == 3500)
            advertise(sensor, "/impacts", Quality(reliable=False))
            latest = time.monotonic() + 1
            take_until(recorder, lambda: time.monotonic() > latest)
            assert recorder.missing == []
    assert capfd.readouterr().err.count("/impacts has a new publisher that is less reliable") == 1
    with BagReader(tmp_path / "bag") as bag:
        assert [each.stamp for each in bag.events()] == list(range(1, 3501))
        assert bag.model_text() == "name: last"
        assert bag.topics["/impacts"].quality == interfaces.EVENTS
        assert bag.topics["/plant/model"].quality == interfaces.LATCHED
        # a publisher's depth cannot be seen
        assert bag.topics["/plant/joint_states"].quality == Quality(reliable=False)


def test_only_the_topics_asked_for_are_recorded(tmp_path: Path) -> None:
    """Topics may have relative names; a topic that never appears is reported as missing."""
    with (
        ros_node("plant") as (plant, _),
        recording(tmp_path / "bag", ["impacts", "/absent"]) as recorder,
    ):
        advertise(plant, "/plant/model").publish(MAKE.model("x"))
        advertise(plant, "/impacts").publish(event(1))
        take_until(recorder, lambda: recorder.counts.get("/impacts") == 1)
        assert recorder.missing == ["/absent"]
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics.keys() == {"/impacts"}


def test_a_signal_amid_a_burst_leaves_a_whole_bag(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """The bag has every message up to its last; the counts are printed."""
    with (
        ros_node("plant") as (plant, _),
        recording_process(ros_environment, "-o", str(tmp_path / "bag")) as process,
    ):
        impacts = advertise(plant, "/impacts")
        connected(impacts, advertise(plant, "/plant/model"))
        for stamp in range(1, 1901):
            impacts.publish(event(stamp))
            if stamp == 900:
                process.send_signal(signal.SIGTERM)
            time.sleep(0 if stamp % 20 else 0.001)
        said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    with BagReader(tmp_path / "bag") as bag:
        stamps = [each.stamp for each in bag.events()]
        assert {"/impacts", "/plant/model"} <= bag.topics.keys()
    assert stamps == list(range(1, len(stamps) + 1))
    assert len(stamps) >= 900
    assert f"{len(stamps)} /impacts\n" in said
    assert "0 /plant/model: no messages\n" in said


def test_a_killed_recorder_loses_the_last_second_only(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """Another library reads the messages from the file that was never closed."""
    stamps: list[int] = []
    with (
        ros_node("plant") as (plant, _),
        recording_process(ros_environment, "-o", str(tmp_path / "bag")) as process,
    ):
        impacts = advertise(plant, "/impacts")
        connected(impacts)
        for stamp in range(1, 11):
            impacts.publish(event(stamp))
        latest = time.monotonic() + PATIENCE
        while len(stamps) < 10:
            assert time.monotonic() < latest
            time.sleep(0.1)
            stamps = messages_on_disk(tmp_path / "bag" / "bag_0.mcap")
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


@pytest.mark.parametrize("definition", ["string data\n", None])
def test_a_foreign_type_is_recorded_if_its_definition_is_installed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    definition: str | None,
) -> None:
    """Else one warning names topic and type; ``std_msgs/String`` stands for a foreign type."""
    fields = dict(typestore().fielddefs)
    del fields[interfaces.STRING]
    poor = type("Store", (), {"fielddefs": fields})()
    monkeypatch.setattr(recorder_module, "typestore", lambda: poor)
    monkeypatch.setattr(recorder_module, "installed_definition", lambda _: definition)
    with ros_node("plant") as (plant, _), recording(tmp_path / "bag") as recorder:
        advertise(plant, "/plant/model").publish(MAKE.model("x"))
        advertise(plant, "/impacts").publish(event(1))
        take_until(recorder, lambda: recorder.counts.get("/impacts"))
        if definition:
            take_until(recorder, lambda: recorder.counts.get("/plant/model"))
        recorder.drain()
    warning = "/plant/model is not recorded: the definition of std_msgs/msg/Str"
    assert capfd.readouterr().err.count(warning) == (0 if definition else 1)
    with BagReader(tmp_path / "bag") as bag:
        assert ("/plant/model" in bag.topics) == bool(definition)


def test_wrong_use_is_an_error_before_anything_is_written(tmp_path: Path) -> None:
    """An invalid topic, or a bag that exists already."""
    with pytest.raises(
        UsageError, match=r"^topic 'bad name': topic name must not contain [^\n]*$"
    ):
        record(tmp_path / "bag", ["/impacts", "bad name"], duration=1.0)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "bag").mkdir()
    with pytest.raises(UsageError, match="exists already"):
        record(tmp_path / "bag", duration=1.0)
