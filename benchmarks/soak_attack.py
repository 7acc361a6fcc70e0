# SPDX-License-Identifier: Apache-2.0
"""Floods and corrupt messages at an observer node, over real DDS: ``./dev soak attack``.

    ./dev soak attack --law minimum-variance --only burst corrupt

The node is a process of its own. A plant runs here in real time; its events go to the node on
their topic, and each attack comes on top of them, from another publisher on the same topic, or on
that of a live force, which is zero unless its bytes were changed. For ``hour`` the model has no
live force, and the node listens to ``/clock``. A third process notes when estimates were
published. Printed are the longest time without an estimate, from the attack until five seconds
after it, how many of the plant's events had a verdict, and how soon after the first event after
the attack one was applied. It fails when the longest silence is more than 0.5 s, or none is
applied within ``MOST_RECOVERY``, which ``hour`` is excused from. On a machine that is busy
otherwise, ``calm`` tells how long others make the node wait.
"""

import argparse
import math
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import rclpy
from impact_observer_msgs.msg import EventVerdict, ImpactEvent, ObserverState
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from benchmarks.soak_inputs import mutated
from benchmarks.topic import running, take_domain
from impact_observer.events import ImpactEvent as Event
from impact_observer.events import Kind, Ruling, Switch
from impact_observer.io.interfaces import EVENTS, FORCING, STATES, Quality
from impact_observer.model import read_model
from impact_observer.plant import Plant, simulate
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.subscribing import waiting_messages
from impact_observer.stamps import NS_PER_S, grid

LAWS = ("geometric", "minimum-variance")
MOST_SILENCE = 0.5
"""Longest time without an estimate, s."""
MOST_RECOVERY = {"geometric": 5.0, "minimum-variance": 35.0}
"""Longest time from the first event after an attack until one is applied, s, by law."""
AFTER = 5.0
"""How long to watch after an attack, s."""
_LENGTH = 600
"""Of the plant's motion, s."""
_CHUNK = 50
"""Messages that are sent before what has come is read."""
_TICK = 10_000_000
"""Time between two messages of the clock, ns."""

Messages = Iterator[tuple[float, bytes]]
"""Serialized events with the seconds after which each is sent."""


@dataclass
class Rig:
    """Sends the plant's events when they happen, and notes when estimates were published."""

    node: Node
    events: list[Event]
    published: list[int] = field(default_factory=list)
    decided: dict[int, int] = field(default_factory=dict)
    applied: dict[int, int] = field(default_factory=dict)
    sent: int = 0
    attacked_until: int = 0
    ahead: int = 0
    told: int = 0

    def __post_init__(self) -> None:
        """Make the publisher and the subscriptions."""
        many = qos_profile(Quality(depth=20_000))
        self.impacts = self._publisher()
        self.clock = self.node.create_publisher(Clock, "/clock", qos_profile(STATES))
        command = [sys.executable, "-m", "benchmarks.soak_attack", "--watch"]
        self.watcher = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        Thread(target=self._read_stamps, daemon=True).start()
        self._verdicts = self.node.create_subscription(
            EventVerdict, "observer/verdicts", self._decide, many
        )

    def _publisher(self, *, forces: bool = False) -> Publisher:
        """Of events, or of samples of a force."""
        if forces:
            return self.node.create_publisher(
                JointState, FORCING.name, qos_profile(FORCING.quality)
            )
        return self.node.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))

    def _read_stamps(self) -> None:
        """Note the instants that the watching process prints."""
        assert self.watcher.stdout is not None, "it is a pipe"
        for line in self.watcher.stdout:
            self.published.append(int(line))

    def _decide(self, message: EventVerdict) -> None:
        stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        self.decided[stamp] = message.verdict
        if message.verdict == Ruling.APPLIED:
            self.applied.setdefault(stamp, self.now())

    def now(self) -> int:
        """Time of the plant and of ``/clock``, ns."""
        return time.time_ns() + self.ahead

    def step(self) -> None:
        """Send the clock and the plant's events that are due, and read what has come."""
        if (now := self.now()) > self.told + _TICK:
            self.clock.publish(ros_messages().clock(now))
            self.told = now
        while self.sent < len(self.events) and self.events[self.sent].stamp <= now - self.ahead:
            due = self.events[self.sent]
            self.events[self.sent] = replace(due, stamp=due.stamp + self.ahead)
            self.impacts.publish(ros_messages().event(self.events[self.sent]))
            self.sent += 1
        for message, _ in waiting_messages(self._verdicts, 10_000):
            self._decide(message)

    def watch(self, seconds: float) -> None:
        """Step for a time, s."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.step()
            time.sleep(0.001)

    def attack(self, messages: Messages, *, forces: bool) -> tuple[int, float, float]:
        """Send the messages; their number, the longest silence (s), and the time taken (s)."""
        attacker = self._publisher(forces=forces)
        while attacker.get_subscription_count() == 0:
            self.watch(0.05)
        begin, count = time.monotonic(), 0
        start = time.time_ns()
        for at, data in messages:
            while time.monotonic() < begin + at:
                self.step()
                time.sleep(0.0005)
            attacker.publish(data)
            count += 1
            if count % _CHUNK == 0:
                self.step()
        taken = time.monotonic() - begin
        self.attacked_until = self.now()
        self.watch(AFTER)
        self.node.destroy_publisher(attacker)
        end = time.time_ns()
        times = [start, *(each for each in self.published if start < each < end), end]
        self.published = []
        return count, max(later - earlier for earlier, later in pairwise(times)) / NS_PER_S, taken


def _serialized(event: Event) -> bytes:
    return bytes(serialize_message(ros_messages().event(event)))


def _hit(rig: Rig, stamp: int, **more: int) -> Event:
    given = {"epoch": rig.events[0].epoch, **more}
    return Event(stamp, (Switch("stop"),), **given)


def _calm(_: Rig) -> Messages:
    """Nothing: how long other processes make the node wait."""
    return iter(())


def _at_once(rig: Rig) -> Messages:
    """1000 impacts in 1 ms."""
    now = time.time_ns()
    return ((0.0, _serialized(_hit(rig, now + k * 1000))) for k in range(1000))


def _second(rig: Rig) -> Messages:
    """10 000 events in a second."""
    now = time.time_ns()
    return ((k * 1e-4, _serialized(_hit(rig, now + k * 100_000))) for k in range(10_000))


def _random(rig: Rig) -> Messages:
    """10 000 events in two seconds: any kind, number and stamp of the last 2 s and next 0.5 s."""
    draw = random.Random(4)
    for k in range(10_000):
        stamp = time.time_ns() + draw.randrange(-2 * NS_PER_S, NS_PER_S // 2)
        switches = (Switch("stop", draw.choice([*Kind])),)
        number = draw.choice([0, draw.randrange(10_000)])
        yield k * 2e-4, _serialized(Event(stamp, switches, number, 0, rig.events[0].epoch))


def _burst(rig: Rig) -> Messages:
    """1e5 events as fast as they can be sent."""
    now = time.time_ns()
    data = [_serialized(_hit(rig, now - (100_000 - k) * 10_000)) for k in range(100_000)]
    return ((0.0, each) for each in data)


def _late(rig: Rig) -> Messages:
    """1000 events that are up to 5 s late, in any order."""
    now, draw = time.time_ns(), random.Random(1)
    data = [_serialized(_hit(rig, now - draw.randrange(5 * NS_PER_S))) for _ in range(1000)]
    return ((0.0, each) for each in data)


def _slow_late(rig: Rig) -> Messages:
    """180 impacts at 40 a second that are up to 9 s late."""
    draw = random.Random(5)
    for k in range(180):
        late = draw.randrange(9 * NS_PER_S)
        yield k / 40, _serialized(_hit(rig, time.time_ns() - late))


def _slow_switch(rig: Rig) -> Messages:
    """180 events at 45 a second by which the contact closes and opens in turn."""
    for k in range(180):
        switches = (Switch("stop", (Kind.CLOSE, Kind.OPEN)[k % 2]),)
        yield k / 45, _serialized(Event(time.time_ns(), switches, 0, 0, rig.events[0].epoch))


def _corrupt(rig: Rig) -> Messages:
    """3000 events of which bytes were changed, in three seconds."""
    draw = random.Random(2)
    for k in range(3000):
        switches = (Switch("stop", draw.choice([*Kind])),)
        event = Event(time.time_ns(), switches, k + 1, 0, rig.events[0].epoch)
        yield k * 1e-3, mutated(draw, _serialized(event), [_serialized(event)])


def _extreme(rig: Rig) -> Messages:
    """400 events of the highest episode, a later epoch, the highest number, an epoch to come."""
    for k in range(100):
        now = time.time_ns()
        for each in (
            _hit(rig, now, episode=2**32 - 1, sequence=k * 5000),
            _hit(rig, now, epoch=now - k * 1000),
            _hit(rig, now, sequence=2**64 - 1 - k * 5000),
            _hit(rig, now, epoch=now + 3600 * NS_PER_S),
        ):
            yield k * 0.02, _serialized(each)


def _hour(rig: Rig) -> Messages:
    """The clock jumps ahead by an hour, in whole periods of the exciter; the plant goes on."""
    period = 2 * math.pi / float(read_model("two_mass").system.forcing.frequency[0])
    rig.ahead += round(round(3600 / period) * period * NS_PER_S)
    return iter(())


def _sample(stamp: int) -> bytes:
    """No force at ``stamp``, ns, serialized."""
    message = JointState(name=["motor"], effort=[0.0])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NS_PER_S)
    return bytes(serialize_message(message))


def _forces(_: Rig) -> Messages:
    """1e5 samples of a force as fast as they can be sent."""
    now = time.time_ns()
    data = [_sample(now - (100_000 - k) * 10_000) for k in range(100_000)]
    return ((0.0, each) for each in data)


def _bad_forces(_: Rig) -> Messages:
    """3000 samples of a force of which bytes were changed, in three seconds."""
    draw = random.Random(3)
    for k in range(3000):
        data = _sample(time.time_ns())
        yield k * 1e-3, mutated(draw, data, [data])


ATTACKS: dict[str, Callable[[Rig], Messages]] = {
    "calm": _calm,
    "at-once": _at_once,
    "second": _second,
    "random": _random,
    "burst": _burst,
    "late": _late,
    "slow-late": _slow_late,
    "slow-switch": _slow_switch,
    "corrupt": _corrupt,
    "extreme": _extreme,
    "forces": _forces,
    "bad-forces": _bad_forces,
    "hour": _hour,
}
"""All of them, by name."""
JUMP = "hour"
"""That of the clock, to which the node then listens."""
FORCES = ("forces", "bad-forces")
"""Those that come as samples of a live force."""


def _plant_events(epoch: int) -> list[Event]:
    """What two_mass does from ``epoch`` (ns) on."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=epoch)
    run = simulate(plant, grid(epoch, epoch + _LENGTH * NS_PER_S, 1.0))
    return [*run.events]


def _recovery(rig: Rig) -> float:
    """Time (s) until an event of the plant after an attack is applied; infinite for none.

    The time counts from the first event after the attack.
    """
    end = time.monotonic() + 60
    while time.monotonic() < end:
        new = [each.stamp for each in rig.events[: rig.sent] if each.stamp > rig.attacked_until]
        for stamp in new:
            if stamp in rig.applied:
                return (rig.applied[stamp] - new[0]) / NS_PER_S
        rig.watch(0.05)
    return math.inf


def _driven(folder: Path) -> Path:
    """A file of two_mass with a live force."""
    path = folder / "two_mass.yaml"
    text = (
        read_model("two_mass")
        .text()
        .replace("forcing:\n", "forcing:\n  inputs: [{name: motor, direction: [0, 1]}]\n")
    )
    path.write_text(text, encoding="utf-8")
    return path


def _run(law: str, names: Sequence[str], model: Path) -> bool:
    """Attack an observer of a law; whether it has held."""
    command = ("impact_observer.ros.entry", "observer", "--ros-args", "-p", f"model:={model}")
    clock = ("-p", f"use_sim_time:={str(JUMP in names).lower()}")
    held, rig = True, None
    rclpy.init(args=[])
    node = Node("attacker")
    try:
        with running((*command, *clock, "-p", f"law:={law}", "--log-level", "fatal")) as process:
            rig = Rig(node, _plant_events(time.time_ns()))
            while rig.impacts.get_subscription_count() == 0:
                time.sleep(0.05)
            while not rig.published:
                rig.watch(0.1)
            rig.watch(15.0)
            for name in names:
                before = rig.sent
                count, silence, taken = rig.attack(ATTACKS[name](rig), forces=name in FORCES)
                recovery = _recovery(rig)
                true = rig.events[before : rig.sent]
                decided = sum(each.stamp in rig.decided for each in true)
                assert process.poll() is None, "the node has ended"
                recovers = recovery <= MOST_RECOVERY[law] or name == JUMP
                held &= silence <= MOST_SILENCE and recovers
                print(
                    f"{law:16} {name:11} {count:6} messages in {taken:5.2f} s: longest silence"
                    f" {silence:.3f} s; of {len(true)} true events {decided} had a verdict; the"
                    f" first one after the attack was applied {recovery:.1f} s after it was due",
                    flush=True,
                )
    finally:
        if rig is not None:
            rig.watcher.kill()
            rig.watcher.wait()
        node.destroy_node()
        rclpy.try_shutdown()
    return held


def _watch() -> None:
    """Print when each estimate was published, ns, until the process is ended."""
    rclpy.init(args=[])
    node = Node("watcher")
    many = qos_profile(Quality(depth=20_000))
    states = node.create_subscription(
        ObserverState, "observer/state", lambda _: None, many, raw=True
    )
    while True:
        for _, info in waiting_messages(states, 10_000):
            print(info["source_timestamp"], flush=True)
        time.sleep(0.002)


def main(args: Sequence[str] | None = None) -> int:
    """Attack observers of both laws.

    Returns:
        0; 1 when one was silent for too long, or did not recover.
    """
    parser = argparse.ArgumentParser(prog="./dev soak attack", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--law", choices=LAWS, help="only this one")
    parser.add_argument("--only", nargs="+", choices=[*ATTACKS], default=[], metavar="ATTACK")
    parser.add_argument("--watch", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(args)
    if given.watch:
        _watch()
    with take_domain(), TemporaryDirectory() as folder:
        model, laws = _driven(Path(folder)), [given.law] if given.law else LAWS
        names = given.only or [*ATTACKS]
        groups = [
            [each for each in names if each != JUMP],
            [each for each in names if each == JUMP],
        ]
        models = [model, Path("two_mass")]
        held = [
            _run(law, group, model)
            for law in laws
            for group, model in zip(groups, models, strict=True)
            if group
        ]
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main())
