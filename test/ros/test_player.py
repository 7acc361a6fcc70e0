# SPDX-License-Identifier: Apache-2.0
"""Playing a bag to the ROS graph, over real DDS."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.io import BagReader, BagWriter, Quality, interfaces
from impact_observer.io.messages import bag_messages, read_event, read_stamp
from impact_observer.ros.player import Player, play
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import message_class, qos_profile

if TYPE_CHECKING:
    from impact_observer.io.messages import AnyMessage

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]
PATIENCE = 90.0
"""Longest wait on a slow machine, s."""
ENOUGH = 1000
"""Messages that wait for a listener without a loss, however busy the machine is."""


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
def player_of(bag: Path, topics: list[str] | None = None, **how: Any) -> Iterator[Player]:  # noqa: ANN401
    """A player in this process."""
    with BagReader(bag) as reader, ros_node("player") as (node, _):
        yield Player(node, reader, topics, **how)


def test_messages_are_sent_in_order_and_not_before_they_are_due(sample_bag: Path) -> None:
    """Due times are the intervals in the bag divided by the rate; the clock ticks between."""
    topics = ["/impacts", "/plant/joint_states"]
    with BagReader(sample_bag) as reader:
        logged = np.array([each.log_time for each in reader.raw(topics)])
        wanted = [event.stamp for event in reader.events()]
    sent: dict[int, float] = {}
    begin = 0.0

    def keep_on() -> bool:
        """Note the time: the last call before a message is sent overwrites the earlier ones."""
        sent[player.count] = time.monotonic() - begin
        return True

    with (
        listening(*topics, "/clock") as received,
        player_of(sample_bag, topics, rate=0.5, keep_on=keep_on) as player,
    ):
        assert player.wait_for_subscribers(PATIENCE)
        begin = time.monotonic()
        player.play()
        player.finish()
        wait_for(received, player.count + 62)
    assert player.count == 62
    assert stamps(received) == wanted
    late = np.array([sent[k] for k in range(62)]) - (logged - logged[0]) * 1e-9 / 0.5
    assert late.min() >= 0
    assert np.median(late) < 0.1
    times = clock(received)
    assert times == sorted(times)
    assert set(wanted) <= set(times)
    assert times[-1] == 1_500_000_000


def test_loop_begins_again_and_the_clock_jumps_back(sample_bag: Path) -> None:
    """The loop goes on until the player is told to end."""
    calls, once = count(), [1_000_000_000 + k * 50_000_000 for k in range(11)]
    how: dict[str, Any] = {"rate": 5.0, "loop": True, "keep_on": lambda: next(calls) < 400}
    with (
        listening("/impacts", "/clock") as received,
        player_of(sample_bag, ["/impacts"], **how) as player,
    ):
        player.wait_for_subscribers(PATIENCE)
        player.play()
        assert player.count > 22
        wait_for(received, player.count + 28)
    assert stamps(received)[:23] == (once * 3)[:23]
    assert sum(b < a for a, b in pairwise(clock(received))) >= 2


def test_late_listener_gets_events_and_model_until_the_end(sample_bag: Path) -> None:
    """Events and model have the durability with which they were recorded."""
    with BagReader(sample_bag) as reader, ros_node("player") as (node, _):
        player = Player(node, reader, rate=10.0)
        player.play()
        infos = node.get_publishers_info_by_topic("/impacts")
        offered = [Quality.of_publisher(info.qos_profile, depth=2000) for info in infos]
        with listening("/impacts", "/plant/model") as received:
            player.finish()
            wait_for(received, 12)
    assert offered == [interfaces.EVENTS]
    assert len(stamps(received)) == 11


def test_what_cannot_be_played_is_named(
    tmp_path: Path, sample_bag: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A foreign type and a publisher beside are warnings; the recorded clock is left out."""
    foreign = tmp_path / "foreign"
    with BagWriter(foreign) as writer:
        writer.declare("/torque", type_name="rig/msg/Torque", definition="float64 torque\n")
        writer.write_raw("/torque", 1, b"\x00\x01\0\0" + b"\0" * 8)
        writer.write("/impacts", 1, bag_messages().event(ImpactEvent(1, ())))
        writer.write("/clock", 1, bag_messages().clock(77))
    with ros_node("plant") as (plant, _):
        plant.create_publisher(
            message_class(interfaces.IMPACT_EVENT), "/impacts", qos_profile(interfaces.EVENTS)
        )
        assert play(foreign, delay=0.5) == 1
    said = capfd.readouterr().err
    assert "/torque, 1 of 3 messages of the bag, is not played: rig/msg/Torque: no such" in said
    assert "another node publishes /impacts too" in said
    for topics in (["/torque"], ["/clock"]):
        with pytest.raises(UsageError, match="nothing to play"):
            play(foreign, topics, delay=0.0)
    with pytest.raises(UsageError, match=r"no topic /absent; in the bag: /impacts, /observer"):
        play(sample_bag, ["/absent"])


def test_late_listener_gets_the_model_in_a_later_pass(sample_bag: Path) -> None:
    """The model is published again in each pass."""
    done = threading.Event()
    how: dict[str, Any] = {"rate": 5.0, "loop": True, "keep_on": lambda: not done.is_set()}
    with player_of(sample_bag, ["/impacts", "/plant/model"], **how) as player:
        thread = threading.Thread(target=player.play)
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
