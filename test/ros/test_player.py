# SPDX-License-Identifier: Apache-2.0
"""Playing a bag to the ROS graph, over real DDS."""

import math
import os
import pty
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
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
from impact_observer.io.interfaces import Quality
from impact_observer.io.messages import bag_messages, read_event, read_stamp
from impact_observer.io.play_schedule import Control, Playing
from impact_observer.io.qos_overrides import Profile
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.player import Player, play
from impact_observer.ros.qos import offered_quality, qos_profile
from impact_observer.ros.session import ros_node

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
    """Wait until that many messages have come."""
    latest = time.monotonic() + PATIENCE
    while len(received) < count:
        assert time.monotonic() < latest, f"{len(received)} of {count} came"
        time.sleep(0.02)


def stamps(received: list[Received]) -> list[int]:
    """Stamps of the events received, ns."""
    messages: list[AnyMessage] = [h.message for h in received if h.topic == "/impacts"]
    return [read_event(message).stamp for message in messages]


def clock(received: list[Received]) -> list[int]:
    """What the clock showed, ns."""
    messages: list[AnyMessage] = [h.message for h in received if h.topic == "/clock"]
    return [read_stamp("clock", message.clock) for message in messages]


class Instants:
    """The time of a player: it passes while the player sleeps, and only then."""

    def __init__(self) -> None:
        self.begin = self.now = time.monotonic_ns()

    def monotonic_ns(self) -> int:
        """As of ``time``, ns."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """As of ``time``, but at once."""
        self.now += math.ceil(seconds * 1e9)

    @property
    def took(self) -> float:
        """Since the begin, s."""
        return (self.now - self.begin) * 1e-9


@contextmanager
def simulated_time() -> Iterator[Instants]:
    """Players are exact here, however busy the machine is."""
    with pytest.MonkeyPatch.context() as patch:
        instants = Instants()
        patch.setattr("impact_observer.ros.player.time", instants)
        yield instants


@contextmanager
def player_of(bag: Path, how: Playing) -> Iterator[Player]:
    """A player in this process."""
    with BagReader(bag) as reader, ros_node("player") as (node, _):
        yield Player(node, reader, how)


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_messages_are_sent_when_they_are_due(
    sample_bag: Path, ros_environment: dict[str, str], rate: float
) -> None:
    """All of them, at their intervals in the bag divided by the rate."""
    assert ros_environment
    topics = ["/impacts", "/plant/joint_states"]
    with BagReader(sample_bag) as reader:
        logged = np.array([each.log_time for each in reader.raw(topics)])
        wanted = [event.stamp for event in reader.events()]
    sent: dict[int, float] = {}
    with (
        listening(*topics) as received,
        player_of(sample_bag, Playing(topics, rate)) as player,
    ):
        assert player.wait_for_subscribers(PATIENCE)
        with simulated_time() as instants:
            # The last call before a message is sent overwrites those before.
            player.play(lambda: sent.update({player.count: instants.took}) is None)
        player.finish()
        wait_for(received, player.count)
    assert player.count == len(received) == 62
    assert stamps(received) == wanted
    due = (logged - logged[0]) * 1e-9 / rate
    np.testing.assert_allclose([sent[k] for k in range(62)], due, rtol=0, atol=1e-7)


def test_a_bag_takes_as_long_as_it_is(sample_bag: Path, ros_environment: dict[str, str]) -> None:
    """Or longer, where the machine is busy."""
    assert ros_environment
    with player_of(sample_bag, Playing(["/impacts"])) as player:
        begin = time.monotonic()
        player.play()
        assert time.monotonic() - begin >= 0.5


def test_clock_shows_the_time_of_every_message_and_ticks_between(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """It never goes back in one pass, and ends with the last message."""
    assert ros_environment
    with listening("/impacts", "/clock") as received:
        play(sample_bag, Playing(["/impacts"], 2.0, clock_rate=200.0), delay=PATIENCE)
        wait_for(received, 11 + 51)
    times = clock(received)
    assert times == sorted(times)
    assert set(stamps(received)) <= set(times)
    assert times == [1_000_000_000 + k * 10_000_000 for k in range(51)]


def test_loop_begins_again_and_the_clock_jumps_back(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """Until it is interrupted."""
    assert ros_environment
    with listening("/impacts", "/clock") as received:
        with BagReader(sample_bag) as reader, ros_node("player") as (node, _):
            player = Player(node, reader, Playing(["/impacts"], 5.0, loop=True, clock_rate=100.0))
            assert player.wait_for_subscribers(PATIENCE)
            with simulated_time() as instants:
                player.play(lambda: player.count < 30)
            player.finish()
        wait_for(received, 30 + 28)
    once = [1_000_000_000 + k * 50_000_000 for k in range(11)]
    assert stamps(received)[:30] == (once * 3)[:30]
    assert sum(b < a for a, b in zip(clock(received), clock(received)[1:], strict=False)) == 2
    assert instants.took == pytest.approx(2.7 * 0.1, abs=0.011)


def test_start_skips_messages_but_not_latched_values(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The model is still published."""
    assert ros_environment
    with listening("/impacts", "/plant/model") as received:
        how = Playing(["/impacts", "/plant/model"], 5.0, start=0.3)
        play(sample_bag, how, delay=PATIENCE)
        wait_for(received, 6)
    assert received[0].topic == "/plant/model" or received[1].topic == "/plant/model"
    assert stamps(received) == [1_300_000_000 + k * 50_000_000 for k in range(5)]


def test_late_listener_gets_events_and_model_until_the_end(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """They are published with the durability they were recorded with."""
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
    """Two clocks would contradict each other."""
    assert ros_environment
    make = bag_messages()
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/clock", 1_000_000_000, make.clock(77))
        writer.write("/impacts", 1_000_000_000, make.event(ImpactEvent(1, ())))
    with BagReader(tmp_path / "bag") as reader, ros_node("player") as (node, _):
        assert Player(node, reader, Playing(clock_rate=100.0)).topics == ("/impacts",)
        assert Player(node, reader).topics == ("/clock", "/impacts")


def test_topic_with_another_publisher_gives_a_warning(
    sample_bag: Path, ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """Such as that of a plant that still runs."""
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
    """If the bag has no other topic it is an error."""
    assert ros_environment
    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/torque", type_name="rig/msg/Torque", definition="float64 torque\n")
        writer.write_raw("/torque", 1, b"\x00\x01\0\0" + b"\0" * 8)
        writer.write("/impacts", 1, bag_messages().event(ImpactEvent(1, ())))
    assert play(tmp_path / "bag", delay=0.0) == 1
    assert "/torque is not played: rig/msg/Torque: no such ROS message" in capfd.readouterr().err
    with pytest.raises(UsageError, match="nothing to play"):
        play(tmp_path / "bag", Playing(["/torque"]), delay=0.0)


@pytest.mark.parametrize("start", [0.6, -1.0])
def test_start_outside_the_bag_is_named(
    sample_bag: Path, ros_environment: dict[str, str], start: float
) -> None:
    """With how long the bag is; and so is a delay that is none."""
    assert ros_environment
    with pytest.raises(UsageError, match=rf"start is {start}; expected 0 to 0\.5 s"):
        play(sample_bag, Playing(start=start))
    with pytest.raises(UsageError, match=r"delay is -1\.0; expected 0 or more"):
        play(sample_bag, delay=-1.0)


def test_absent_topic_is_named(sample_bag: Path, ros_environment: dict[str, str]) -> None:
    """With those in the bag."""
    assert ros_environment
    with pytest.raises(UsageError, match=r"no topic /absent; in the bag: /impacts, /observer"):
        play(sample_bag, Playing(["/absent"]))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_loop_with_exit_code_0(
    sample_bag: Path, ros_environment: dict[str, str], number: signal.Signals
) -> None:
    """The command says how many messages were played."""
    command = [sys.executable, "-c", PLAY, str(sample_bag), "--loop", "--clock"]
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


class Script:
    """Actions of a user, each as soon as its condition holds."""

    def __init__(self, player: Player, *acts: tuple[Callable[[], bool], Control]) -> None:
        self._player = player
        self._acts = list(acts)

    def __call__(self) -> bool:
        """Do the next action if it is due; playing never ends by this."""
        if self._acts and self._acts[0][0]():
            self._player.control(self._acts.pop(0)[1])
        return True


def after(seconds: float, now: Callable[[], float] = time.monotonic) -> Callable[[], bool]:
    """A condition that holds ``seconds`` after it was first evaluated."""
    begun: list[float] = []

    def passed() -> bool:
        begun.append(now())
        return begun[-1] > begun[0] + seconds

    return passed


def test_pause_holds_messages_while_the_clock_stands_still(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The clock is published on; afterwards all messages come, later by the pause."""
    assert ros_environment
    how = Playing(["/impacts"], clock_rate=100.0)
    with listening("/impacts", "/clock") as received, player_of(sample_bag, how) as player:
        assert player.wait_for_subscribers(PATIENCE)
        with simulated_time() as instants:
            resume = after(0.5, lambda: instants.took)
            acts = (lambda: player.count == 3, Control.PAUSE), (resume, Control.PAUSE)
            player.play(Script(player, *acts))
        player.finish()
        wait_for(received, 11 + 100)
    assert len(stamps(received)) == 11
    times = clock(received)
    assert times == sorted(times)
    longest = max(times.count(each) for each in times)
    assert 48 <= longest <= 52
    assert instants.took == pytest.approx(1.0, abs=0.02)


def test_single_messages_are_sent_while_paused(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The clock follows them, and playing goes on from there; it may start paused."""
    assert ros_environment
    how = Playing(["/impacts"], rate=2.0, paused=True, clock_rate=100.0)
    with listening("/impacts", "/clock") as received, player_of(sample_bag, how) as player:
        assert player.wait_for_subscribers(PATIENCE)
        acts = [(after(0.1), Control.NEXT) for _ in range(4)]
        counts: list[int] = []
        ready = after(0.1)
        script = Script(player, *acts, (lambda: bool(counts) and ready(), Control.PAUSE))

        def keep_on() -> bool:
            if player.count == 4:
                counts.append(player.count)
            return script()

        player.play(keep_on)
        player.finish()
        wait_for(received, 11 + 40)
    assert stamps(received) == [1_000_000_000 + k * 50_000_000 for k in range(11)]
    assert len(counts) > 2
    times = clock(received)
    assert times == sorted(times)
    assert times.count(1_150_000_000) > 5


def test_next_acts_in_pauses_only_and_rates_have_limits(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """A step faster and a step slower give the first rate."""
    assert ros_environment
    with player_of(sample_bag, Playing(rate=90.0)) as player:
        player.control(Control.NEXT)
        for _ in range(3):
            player.control(Control.FASTER)
        assert player.pace.rate == pytest.approx(99.0)
        player.control(Control.SLOWER)
        assert player.pace.rate == pytest.approx(90.0)
        player.play()
        assert player.count == 114


def test_only_a_part_is_played(sample_bag: Path, ros_environment: dict[str, str]) -> None:
    """From the start for the duration, once or in a loop."""
    assert ros_environment
    how = Playing(["/impacts"], start=0.1, duration=0.22, loop=True)
    with listening("/impacts") as received, player_of(sample_bag, how) as player:
        assert player.wait_for_subscribers(PATIENCE)
        with simulated_time() as instants:
            player.play(lambda: player.count < 11)
        player.finish()
        wait_for(received, 11)
    once = [1_100_000_000 + k * 50_000_000 for k in range(5)]
    assert stamps(received) == [*once, *once, *once[:1]]
    assert 0.44 <= instants.took < 0.5
    assert player.length == pytest.approx(0.22)


def test_topics_are_published_by_other_names_and_qualities(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The clock too; two types under one name are refused."""
    assert ros_environment
    names = {"/impacts": "/rig/impacts", "/clock": "/rig_clock"}
    profiles = {"/impacts": Profile(depth=7, durability="volatile", deadline=5_000_000)}
    how = Playing(["/impacts"], 5.0, clock_rate=100.0, names=names, profiles=profiles)
    with player_of(sample_bag, how) as player:
        node = player._node
        (info,) = node.get_publishers_info_by_topic("/rig/impacts")
        assert not node.get_publishers_info_by_topic("/impacts")
        assert len(node.get_publishers_info_by_topic("/rig_clock")) == 1
        assert offered_quality(info.qos_profile, depth=7) == Quality(depth=7)
        assert info.qos_profile.deadline.nanoseconds == 5_000_000
        assert player.topics == ("/impacts",)
    wrong = Playing(names={"/impacts": "/plant/model"})
    with pytest.raises(UsageError, match=r"/plant/model: would be .*ImpactEvent and std_msgs"):
        play(sample_bag, wrong)
    with pytest.raises(UsageError, match=r"no topic /absent; in the bag"):
        play(sample_bag, Playing(names={"/absent": "/x"}))


def test_late_listener_gets_the_model_in_a_later_pass(
    sample_bag: Path, ros_environment: dict[str, str]
) -> None:
    """The first pass began after the model's message."""
    assert ros_environment
    how = Playing(["/impacts", "/plant/model"], 5.0, start=0.2, loop=True)
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


def test_keys_pause_and_end_the_command(sample_bag: Path, ros_environment: dict[str, str]) -> None:
    """On a terminal, whose state is restored at the end."""
    main, side = pty.openpty()
    before = termios.tcgetattr(side)
    script = f"import fcntl, termios\nfcntl.ioctl(0, termios.TIOCSCTTY, 0)\n{PLAY}"
    command = [sys.executable, "-c", script, str(sample_bag), "--loop", "--start-paused"]
    process = subprocess.Popen(
        [*command, "--delay", "0"],
        env={**ros_environment, "TERM": "xterm", "COLUMNS": "90"},
        stdin=side,
        stdout=side,
        stderr=side,
        start_new_session=True,
    )
    said = ""
    try:
        for wanted, key in (("space pauses", ""), ("paused at 0.000", " "), ("at 1x", "q")):
            while wanted not in said:
                said += os.read(main, 4096).decode(errors="replace")
            os.write(main, key.encode())
        while "messages played" not in said:
            said += os.read(main, 4096).decode(errors="replace")
        assert process.wait(PATIENCE) == 0
        assert termios.tcgetattr(side) == before
    finally:
        process.kill()
        process.wait()
        os.close(main)
        os.close(side)
