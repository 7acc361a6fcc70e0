"""Playing a bag to the ROS graph, over real DDS."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer.bag import BagReader, BagWriter, interfaces
from impact_observer.bag.messages import bag_messages, read_event, read_stamp
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.nodes.messages import message_class
from impact_observer.nodes.player import Player, play
from impact_observer.nodes.quality import offered_quality, qos_profile
from impact_observer.nodes.session import ros_node

if TYPE_CHECKING:
    from impact_observer.bag.messages import ClockMessage, EventMessage

pytestmark = pytest.mark.ros
PATIENCE = 20.0
"""How long a slow machine may take, s."""
PLAY = """
import argparse, sys
from impact_observer.cli import play
parser = argparse.ArgumentParser()
play.add_arguments(parser)
sys.exit(play.run(parser.parse_args()))
"""


class Heard(NamedTuple):
    """A message and when it came, s."""

    topic: str
    at: float
    message: object


@contextmanager
def listening(*topics: str) -> Iterator[list[Heard]]:
    """What a node in this process hears on some topics; spun in a thread."""
    heard: list[Heard] = []
    done = threading.Event()
    with ros_node("listener") as (node, executor):
        for topic in topics:
            known = interfaces.interface(topic)
            assert known is not None
            node.create_subscription(
                message_class(known.type),
                topic,
                lambda message, topic=topic: heard.append(Heard(topic, time.monotonic(), message)),
                qos_profile(known.quality),
            )

        def spin() -> None:
            while not done.is_set():
                executor.spin_once(timeout_sec=0.05)

        thread = threading.Thread(target=spin)
        thread.start()
        try:
            yield heard
        finally:
            done.set()
            thread.join()


def wait_for(heard: list[Heard], count: int) -> None:
    """Wait until that many messages have come."""
    latest = time.monotonic() + PATIENCE
    while len(heard) < count:
        assert time.monotonic() < latest, f"{len(heard)} of {count} came"
        time.sleep(0.02)


def stamps(heard: list[Heard]) -> list[int]:
    """Stamps of the events heard, ns."""
    messages: list[EventMessage] = [h.message for h in heard if h.topic == "/impacts"]  # type: ignore[misc]
    return [read_event(message).stamp for message in messages]


def clock(heard: list[Heard]) -> list[int]:
    """What the clock showed, ns."""
    messages: list[ClockMessage] = [h.message for h in heard if h.topic == "/clock"]  # type: ignore[misc]
    return [read_stamp("clock", message.clock) for message in messages]


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_messages_come_when_they_are_due(
    sample_bag: Path, ros_environment: dict[str, str], rate: float
) -> None:
    """All of them from the first on, at their distances divided by the rate."""
    assert ros_environment
    with BagReader(sample_bag) as reader:
        wanted = [event.stamp for event in reader.events()]
    with listening("/impacts", "/plant/joint_states") as heard:
        count = play(sample_bag, ["/impacts", "/plant/joint_states"], rate=rate, delay=PATIENCE)
        wait_for(heard, count)
    assert count == len(heard) == 62
    assert stamps(heard) == wanted
    times = np.array([each.at for each in heard if each.topic == "/impacts"])
    late = (times - times[0]) - (np.array(wanted) - wanted[0]) * 1e-9 / rate
    assert abs(np.median(late)) < 0.02
    assert np.abs(late).max() < 0.2


def test_clock_shows_the_time_of_every_message_and_ticks_between(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """It never goes back in one pass, and ends with the last message."""
    assert ros_environment
    with listening("/impacts", "/clock") as heard:
        play(sample_bag, ["/impacts"], rate=2.0, clock_rate=200.0, delay=PATIENCE)
        wait_for(heard, 11 + 51)
    times = clock(heard)
    assert times == sorted(times)
    assert set(stamps(heard)) <= set(times)
    assert times == [1_000_000_000 + k * 10_000_000 for k in range(51)]


def test_loop_begins_again_and_the_clock_jumps_back(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """Until it is told to end."""
    assert ros_environment
    with listening("/impacts", "/clock") as heard:
        with BagReader(sample_bag) as reader, ros_node("player") as (node, _):
            player = Player(node, reader, ["/impacts"], rate=5.0, clock_rate=100.0)
            assert player.wait_for_subscribers(PATIENCE)
            begin = time.monotonic()
            player.play(loop=True, keep_on=lambda: player.count < 30)
            took = time.monotonic() - begin
            player.finish()
        wait_for(heard, 30)
        time.sleep(0.2)
    once = [1_000_000_000 + k * 50_000_000 for k in range(11)]
    assert stamps(heard)[:30] == (once * 3)[:30]
    assert sum(b < a for a, b in zip(clock(heard), clock(heard)[1:], strict=False)) == 2
    assert took == pytest.approx(2.7 * 0.1, abs=0.1)


def test_start_skips_messages_but_not_latched_values(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """An observer still gets the model."""
    assert ros_environment
    with listening("/impacts", "/plant/model") as heard:
        play(sample_bag, ["/impacts", "/plant/model"], start=0.3, rate=5.0, delay=PATIENCE)
        wait_for(heard, 6)
    assert heard[0].topic == "/plant/model" or heard[1].topic == "/plant/model"
    assert stamps(heard) == [1_300_000_000 + k * 50_000_000 for k in range(5)]


def test_late_listener_gets_events_and_model_until_the_end(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """They are published with the durability they were recorded with."""
    assert ros_environment
    with BagReader(sample_bag) as reader, ros_node("player") as (node, _):
        player = Player(node, reader, rate=10.0)
        player.play()
        infos = node.get_publishers_info_by_topic("/impacts")
        offered = [offered_quality(info.qos_profile, depth=2000) for info in infos]
        with listening("/impacts", "/plant/model") as heard:
            player.finish()
            wait_for(heard, 12)
    assert offered == [interfaces.EVENTS]
    assert len(stamps(heard)) == 11


def test_recorded_clock_gives_way_to_the_player_s_own(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """Two clocks would contradict each other."""
    assert ros_environment
    make = bag_messages()
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/clock", 1_000_000_000, make.clock(77))
        writer.write("/impacts", 1_000_000_000, make.event(ImpactEvent(1, ())))
    with BagReader(tmp_path / "bag") as reader, ros_node("player") as (node, _):
        assert Player(node, reader, clock_rate=100.0).topics == ("/impacts",)
        assert Player(node, reader).topics == ("/clock", "/impacts")


def test_topic_that_someone_else_publishes_is_warned_of(
    sample_bag: Path, ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """A plant that still runs would mix with the bag."""
    assert ros_environment
    with ros_node("plant") as (plant, _):
        plant.create_publisher(
            message_class(interfaces.IMPACT_EVENT), "/impacts", qos_profile(interfaces.EVENTS)
        )
        play(sample_bag, rate=10.0, delay=1.0)
    assert "another node publishes /impacts too" in capfd.readouterr().err


def test_foreign_type_is_left_out_with_a_warning(
    tmp_path: Path, ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """And alone it is an error."""
    assert ros_environment
    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/torque", type_name="rig/msg/Torque", definition="float64 torque\n")
        writer.write_raw("/torque", 1, b"\x00\x01\0\0" + b"\0" * 8)
        writer.write("/impacts", 1, bag_messages().event(ImpactEvent(1, ())))
    assert play(tmp_path / "bag", delay=0.0) == 1
    assert "/torque is not played: rig/msg/Torque: no such ROS message" in capfd.readouterr().err
    with pytest.raises(UsageError, match="nothing to play"):
        play(tmp_path / "bag", ["/torque"], delay=0.0)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"rate": 0.0}, r"rate is 0\.0; expected a positive number"),
        ({"rate": float("nan")}, r"rate is nan"),
        ({"clock_rate": -1.0}, r"clock rate is -1\.0"),
        ({"start": 0.6}, r"start is 0\.6; expected 0 to 0\.5 s, the bag's length"),
        ({"start": -1.0}, r"start is -1\.0"),
        ({"delay": -1.0}, r"delay is -1\.0; expected 0 or more"),
    ],
)
def test_number_out_of_range_is_named(
    sample_bag: Path,
    ros_environment: dict[str, str],
    arguments: dict[str, float],
    expected: str,
) -> None:
    """With what is wanted."""
    assert ros_environment
    with pytest.raises(UsageError, match=expected):
        play(sample_bag, **arguments)  # type: ignore[arg-type]


def test_absent_topic_is_named(sample_bag: Path, ros_environment: dict[str, str]) -> None:
    """With those in the bag."""
    assert ros_environment
    with pytest.raises(UsageError, match=r"no topic /absent; in the bag: /impacts, /observer"):
        play(sample_bag, ["/absent"])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_loop_well(
    sample_bag: Path, ros_environment: dict[str, str], number: signal.Signals
) -> None:
    """Exit code 0 and a line that says how far it got."""
    command = [sys.executable, "-c", PLAY, str(sample_bag), "--loop", "--clock"]
    with (
        listening("/impacts") as heard,
        subprocess.Popen(
            command, env=ros_environment, stdout=subprocess.PIPE, text=True
        ) as process,
    ):
        try:
            wait_for(heard, 15)
            process.send_signal(number)
            said, _ = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode == 0
    assert f"messages played from {sample_bag}" in said
