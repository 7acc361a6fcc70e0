# SPDX-License-Identifier: Apache-2.0
"""Playing a bag to the ROS graph, over real DDS."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.io import BagReader, BagWriter, interfaces
from impact_observer.io.messages import bag_messages, read_event, read_stamp
from impact_observer.ros.player import Player, Playing, play
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import message_class, offered_quality, qos_profile

if TYPE_CHECKING:
    from impact_observer.io.messages import AnyMessage

pytestmark = pytest.mark.ros
PATIENCE = 90.0
"""Longest wait on a slow machine, s."""
ENOUGH = 1000
"""Messages that wait for a listener without a loss, however busy the machine is."""
PLAY = """
import argparse, sys
from impact_observer.cli import play
parser = argparse.ArgumentParser()
play.add_arguments(parser)
sys.exit(play.run(parser.parse_args()))
"""


class Received(NamedTuple):
    """A message and when it came, s."""

    topic: str
    at: float
    message: object


@contextmanager
def listening(*topics: str) -> Iterator[list[Received]]:
    """The messages that a node in this process receives on some topics; spun in a thread."""
    received: list[Received] = []
    done = threading.Event()
    with ros_node("listener") as (node, executor):
        for topic in topics:
            described = interfaces.interface(topic)
            assert described is not None
            node.create_subscription(
                message_class(described.type),
                topic,
                lambda message, topic=topic: received.append(
                    Received(topic, time.monotonic(), message)
                ),
                qos_profile(replace(described.quality, depth=ENOUGH)),
            )

        def spin() -> None:
            while not done.is_set():
                executor.spin_once(timeout_sec=0.05)

        thread = threading.Thread(target=spin)
        thread.start()
        try:
            yield received
        finally:
            done.set()
            thread.join()


def wait_for(received: list[Received], count: int) -> None:
    """Wait until a number of messages have come."""
    latest = time.monotonic() + PATIENCE
    while len(received) < count:
        assert time.monotonic() < latest, f"{len(received)} of {count} came"
        time.sleep(0.02)


def stamps(received: list[Received]) -> list[int]:
    """Stamps of the events received, ns."""
    messages: list[AnyMessage] = [h.message for h in received if h.topic == "/impacts"]
    return [read_event(message).stamp for message in messages]


def clock(received: list[Received]) -> list[int]:
    """Times that the clock showed, ns."""
    messages: list[AnyMessage] = [h.message for h in received if h.topic == "/clock"]
    return [read_stamp("clock", message.clock) for message in messages]


@contextmanager
def player_of(bag: Path, how: Playing) -> Iterator[Player]:
    """A player in this process."""
    with BagReader(bag) as reader, ros_node("player") as (node, _):
        yield Player(node, reader, how)


def test_messages_are_sent_in_order_and_not_before_they_are_due(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """Due times are the intervals in the bag divided by the rate."""
    assert ros_environment
    topics = ["/impacts", "/plant/joint_states"]
    with BagReader(sample_bag) as reader:
        logged = np.array([each.log_time for each in reader.raw(topics)])
        wanted = [event.stamp for event in reader.events()]
    sent: dict[int, float] = {}
    with (
        listening(*topics) as received,
        player_of(sample_bag, Playing(topics, 0.5)) as player,
    ):
        assert player.wait_for_subscribers(PATIENCE)
        begin = time.monotonic()
        # The last call before a message is sent overwrites the earlier ones.
        player.play(lambda: sent.update({player.count: time.monotonic() - begin}) is None)
        player.finish()
        wait_for(received, player.count)
    assert player.count == len(received) == 62
    assert stamps(received) == wanted
    late = np.array([sent[k] for k in range(62)]) - (logged - logged[0]) * 1e-9 / 0.5
    assert late.min() >= 0
    assert np.median(late) < 0.1


def test_clock_shows_the_time_of_every_message_and_ticks_between(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The clock never goes back in one pass, and ends with the last message."""
    assert ros_environment
    with listening("/impacts", "/clock") as received:
        play(sample_bag, Playing(["/impacts"], 0.25), delay=PATIENCE)
        wait_for(received, 11 + 51)
    times = clock(received)
    assert times == sorted(times)
    assert set(stamps(received)) <= set(times)
    assert times[-1] == 1_500_000_000
    assert len(times) > 3 * 11


def test_loop_begins_again_and_the_clock_jumps_back(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The loop goes on until the player is told to end."""
    assert ros_environment
    with listening("/impacts", "/clock") as received:
        with player_of(sample_bag, Playing(["/impacts"], 5.0, loop=True)) as player:
            assert player.wait_for_subscribers(PATIENCE)
            player.play(lambda: player.count < 30)
            player.finish()
        wait_for(received, 30 + 28)
    once = [1_000_000_000 + k * 50_000_000 for k in range(11)]
    assert stamps(received)[:30] == (once * 3)[:30]
    assert sum(b < a for a, b in zip(clock(received), clock(received)[1:], strict=False)) == 2


def test_late_listener_gets_events_and_model_until_the_end(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """Events and model have the durability with which they were recorded."""
    assert ros_environment
    with BagReader(sample_bag) as reader, ros_node("player") as (node, _):
        player = Player(node, reader, Playing(rate=10.0))
        player.play()
        infos = node.get_publishers_info_by_topic("/impacts")
        offered = [offered_quality(info.qos_profile, depth=2000) for info in infos]
        with listening("/impacts", "/plant/model") as received:
            player.finish()
            wait_for(received, 12)
    assert offered == [interfaces.EVENTS]
    assert len(stamps(received)) == 11


def test_recorded_clock_is_replaced_by_that_of_the_player(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """The recorded clock is left out, since two clocks would contradict each other."""
    assert ros_environment
    make = bag_messages()
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/clock", 1_000_000_000, make.clock(77))
        writer.write("/impacts", 1_000_000_000, make.event(ImpactEvent(1, ())))
    with BagReader(tmp_path / "bag") as reader, ros_node("player") as (node, _):
        assert Player(node, reader).topics == ("/impacts",)


def test_topic_with_another_publisher_gives_a_warning(
    sample_bag: Path, ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """The other publisher may be a plant that still runs."""
    assert ros_environment
    with ros_node("plant") as (plant, _):
        plant.create_publisher(
            message_class(interfaces.IMPACT_EVENT), "/impacts", qos_profile(interfaces.EVENTS)
        )
        play(sample_bag, Playing(rate=10.0), delay=1.0)
    assert "another node publishes /impacts too" in capfd.readouterr().err


def test_foreign_type_is_left_out_with_a_warning(
    tmp_path: Path, ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """A bag with foreign types alone is an error."""
    assert ros_environment
    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/torque", type_name="rig/msg/Torque", definition="float64 torque\n")
        writer.write_raw("/torque", 1, b"\x00\x01\0\0" + b"\0" * 8)
        writer.write("/impacts", 1, bag_messages().event(ImpactEvent(1, ())))
    assert play(tmp_path / "bag", delay=0.0) == 1
    said = capfd.readouterr().err
    assert "/torque, 1 of 2 messages of the bag, is not played: rig/msg/Torque: no such" in said
    with pytest.raises(UsageError, match="nothing to play"):
        play(tmp_path / "bag", Playing(["/torque"]), delay=0.0)


def test_absent_topic_is_named(sample_bag: Path, ros_environment: dict[str, str]) -> None:
    """The error lists the topics of the bag."""
    assert ros_environment
    with pytest.raises(UsageError, match=r"no topic /absent; in the bag: /impacts, /observer"):
        play(sample_bag, Playing(["/absent"]))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_loop_with_exit_code_0(
    sample_bag: Path, ros_environment: dict[str, str], number: signal.Signals
) -> None:
    """The command says how many messages were played."""
    command = [sys.executable, "-c", PLAY, str(sample_bag), "--loop"]
    with (
        listening("/impacts") as received,
        subprocess.Popen(
            command, env=ros_environment, stdout=subprocess.PIPE, text=True
        ) as process,
    ):
        try:
            wait_for(received, 15)
            process.send_signal(number)
            said, _ = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode == 0
    assert f"messages played from {sample_bag}" in said


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rate": 0.0}, r"rate is 0\.0; expected a positive number"),
        ({"rate": float("nan")}, "rate is nan"),
    ],
)
def test_a_number_out_of_range_is_named(wrong: dict[str, float], said: str) -> None:
    """The error says what was expected."""
    with pytest.raises(UsageError, match=said):
        Playing(**wrong)  # type: ignore[arg-type]


def test_late_listener_gets_the_model_in_a_later_pass(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The model is published again in each pass."""
    assert ros_environment
    how = Playing(["/impacts", "/plant/model"], 5.0, loop=True)
    done = threading.Event()
    with player_of(sample_bag, how) as player:
        thread = threading.Thread(target=player.play, args=(lambda: not done.is_set(),))
        thread.start()
        try:
            while player.count < 20:
                time.sleep(0.01)
            with listening("/plant/model") as received:
                wait_for(received, 1)
        finally:
            done.set()
            thread.join()
    assert received[0].topic == "/plant/model"
