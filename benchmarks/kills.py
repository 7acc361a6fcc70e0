# SPDX-License-Identifier: Apache-2.0
"""Plant, observer, detector and recorder are killed and started again: ``./dev kills``.

    ./dev kills --kills 10      # the quick way

SIGKILL strikes one of them at random, again and again. A node that is never killed publishes the
switch of the detector and receives everything: it is the witness. At the end every event is
accounted for: those of the recorder in the bags, those of the observer by its
verdicts, the pulses of the switch by the detector's events. What had reached a process more than a
second before it was killed must be there.

The processes talk over UDP, as docs/security.md says of Fast DDS after kills.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Console

from benchmarks.topic import take_domain
from impact_observer.errors import BagError
from impact_observer.io import BagReader, interfaces
from impact_observer.io.messages import AnyMessage, read_event, read_verdict
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.subscribing import MessageInfo

MODEL = """
name: fast
coordinates: [x1, x2]
mass:      [[1, 0], [0, 1]]
damping:   [[2, -1], [-1, 1]]
stiffness: [[2000, -1000], [-1000, 1000]]
forcing:
  constant: [0, 0]
  harmonics: [{frequency: 25, cosine: [0, 400], sine: [0, 0]}]
contacts: [{name: stop, direction: [0, -1], gap: 0.5, restitution: 0.7}]
initial_state: {position: [0.1, -0.2], velocity: [5, 0]}
"""
"""two_mass ten times as fast: seven impacts a second."""
SENSORS = "sources: [{contact: stop, topic: switch, kind: switch}]\n"
DUE = 1.0
"""What had reached a process so long before its end is not lost, s."""
SENT = 0.5
"""What a process published so long before its own end has left it, for all that receive it, s."""
UP = 2.0
"""A process is killed at the earliest so long after its first sign of life, s."""
PULSE, SPACING = 0.02, 0.3
"""Duration of a pulse of the switch, and time between two, s."""
_NEAR = 120_000_000
"""How far an event of the detector may be from its pulse, ns: a process may have to wait."""
_PATIENCE = 120.0
EventKey = tuple[str, int, int, int, int]
"""Topic, epoch, episode, sequence, stamp."""


@dataclass
class Life:
    """One process from its start to its end, by the clock of the witness, s.

    Attributes:
        process: of the operating system.
        folder: for the log, and the bag of a recorder.
        began: when it was started, by the clock of the machine, ns.
        up: when it gave its first sign of life.
        end: when it was killed.
    """

    process: "subprocess.Popen[bytes]"
    folder: Path
    began: int
    up: float = float("inf")
    end: float = float("inf")

    def note(self, now: float, info: MessageInfo) -> None:
        """Note a message: what was published before the start is of the life before."""
        if info["source_timestamp"] > self.began:
            self.up = min(self.up, now)

    def had(self, at: float) -> bool:
        """Whether what came then had reached the process long enough before its end."""
        return self.up <= at < self.end - DUE


@dataclass
class Account:
    """What should be there, what is there, and what is lost without an excuse."""

    due: int = 0
    lost: list[str] = field(default_factory=list)
    excused: int = 0


class Rig:
    """The four processes, and the witness."""

    def __init__(self, folder: Path, seed: int) -> None:
        """Start all of them."""
        self._folder, self._random = folder, random.Random(seed)
        (folder / "fast.yaml").write_text(MODEL, "utf-8")
        (folder / "switch.yaml").write_text(SENSORS, "utf-8")
        self._executor = SingleThreadedExecutor()
        self._node = Node("witness")
        self._executor.add_node(self._node)
        self.events: dict[EventKey, float] = {}
        self.verdicts: set[tuple[int, int]] = set()
        self.pulses: list[tuple[float, int]] = []
        self.lives: dict[str, list[Life]] = {name: [] for name in self._commands(folder)}
        for topic in ("/impacts", "/rig/impacts"):
            self._subscribe(topic, interfaces.IMPACT_EVENT, self._event_taker(topic))
        self._subscribe("/observer/verdicts", interfaces.EVENT_VERDICT, self._on_verdict)
        self._bool = message_class("std_msgs/msg/Bool")
        states = qos_profile(interfaces.STATES)
        self._switch = self._node.create_publisher(self._bool, "/switch", states)
        self._node.create_timer(SPACING, self._pulse)
        for name in self.lives:
            self.start(name)

    def _subscribe(self, topic: str, type_name: str, take: object) -> None:
        self._node.create_subscription(
            message_class(type_name), topic, take, qos_profile(interfaces.EVENTS)
        )

    def _commands(self, folder: Path) -> dict[str, list[str]]:
        """The arguments for ``python -m`` of each process."""
        entry = "impact_observer.ros.entry"
        model = f"model:={folder / 'fast.yaml'}"
        topics = ["--topics", "/impacts", "/rig/impacts"]
        return {
            "plant": [entry, "plant", "--ros-args", "-p", model],
            "observer": [entry, "observer", "--ros-args", "-p", model],
            "detector": [
                *(entry, "detector", "--ros-args", "-p", f"sources:={folder / 'switch.yaml'}"),
                *("-r", "impacts:=/rig/impacts"),
            ],
            "recorder": ["impact_observer", "record", *topics, "-o"],
        }

    def _event_taker(self, topic: str) -> object:
        def take(message: AnyMessage, info: MessageInfo) -> None:
            event = read_event(message)
            now = time.monotonic()
            key = (topic, event.epoch, event.episode, event.sequence, event.stamp)
            if self.events.setdefault(key, now) == now:
                self.lives["plant" if topic == "/impacts" else "detector"][-1].note(now, info)

        return take

    def _on_verdict(self, message: AnyMessage, info: MessageInfo) -> None:
        verdict, _ = read_verdict(message)
        self.verdicts.add((verdict.stamp, verdict.sequence))
        self.lives["observer"][-1].note(time.monotonic(), info)

    def _pulse(self) -> None:
        self.pulses.append((time.monotonic(), time.time_ns()))
        self._switch.publish(self._bool(data=True))
        time.sleep(PULSE)
        self._switch.publish(self._bool(data=False))

    def start(self, name: str) -> None:
        """Start a process, a recorder with a bag of its own."""
        folder = self._folder / f"{name}_{len(self.lives[name])}"
        folder.mkdir()
        command = [sys.executable, "-m", *self._commands(self._folder)[name]]
        command += [str(folder / "bag")] if name == "recorder" else []
        began = time.time_ns()
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        self.lives[name].append(Life(process, folder, began))

    def spin(self, seconds: float) -> None:
        """Receive for a while, and see whether a recorder has begun."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._executor.spin_once(timeout_sec=0.05)
        life = self.lives["recorder"][-1]
        if life.up == float("inf"):
            log = (life.folder / "log").read_text(errors="replace")
            if "recording /impacts" in log and "recording /rig/impacts" in log:
                life.up = time.monotonic()

    def kill_one(self) -> str:
        """Kill a process that has been up for a while, and start it again; its name."""
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until:
            self.spin(self._random.uniform(0.2, 0.8))
            now = time.monotonic()
            ready = [name for name, lives in self.lives.items() if lives[-1].up < now - UP]
            if ready:
                name = self._random.choice(ready)
                self.end(name, signal.SIGKILL)
                self.start(name)
                return name
        raise TimeoutError(f"nothing came up in {_PATIENCE:g} s; see {self._folder}")

    def end(self, name: str, how: signal.Signals) -> None:
        """End a process."""
        life = self.lives[name][-1]
        assert life.process.poll() is None, f"{name} has ended by itself; see {life.folder}/log"
        life.process.send_signal(how)
        life.end = time.monotonic()
        life.process.wait()

    def close(self) -> None:
        """End everything; what came after the witness received its last message is not judged."""
        now = time.monotonic()
        for name, lives in self.lives.items():
            if lives[-1].process.poll() is None:
                self.end(name, signal.SIGTERM)
            lives[-1].end = min(lives[-1].end, now)
        self._node.destroy_node()

    def recorded(self) -> Account:
        """The events of all bags, killed or not."""
        saved: set[EventKey] = set()
        for life in self.lives["recorder"]:
            bag = life.folder / "bag"
            if not (bag / "bag_0.mcap").exists():
                continue
            with suppress(BagError), BagReader(bag) as reader:  # killed before its first chunk
                for topic in reader.topics:
                    saved |= {
                        (topic, e.epoch, e.episode, e.sequence, e.stamp)
                        for e in reader.events(topic)
                    }
        account = Account()
        for key, at in self.events.items():
            if self._was_sent(key, at) and any(life.had(at) for life in self.lives["recorder"]):
                account.due += 1
                account.lost += [] if key in saved else [str(key)]
            else:
                account.excused += key not in saved
        return account

    def _was_sent(self, key: EventKey, at: float) -> bool:
        """Whether the sender of an event lived until it had left for all that receive it."""
        lives = self.lives["plant" if key[0] == "/impacts" else "detector"]
        return all(not life.end - SENT < at < life.end + SENT for life in lives)

    def judged(self) -> Account:
        """The verdicts of the observer on the plant's events."""
        plant = [(key, at) for key, at in self.events.items() if key[0] == "/impacts"]
        last = {key[1]: key for key, _ in plant}  # of each plant, which may wait for a second one
        account = Account()
        for key, at in plant:
            *_, sequence, stamp = key
            is_judged = (stamp, sequence) in self.verdicts
            reached = self._was_sent(key, at) and key not in last.values()
            if reached and any(life.had(at) for life in self.lives["observer"]):
                account.due += 1
                account.lost += [] if is_judged else [str(key)]
            else:
                account.excused += not is_judged
        return account

    def detected(self) -> Account:
        """The detector's events of the pulses of the switch."""
        stamps = sorted(key[-1] for key in self.events if key[0] == "/rig/impacts")
        account = Account()
        for at, wall in self.pulses:
            is_detected = any(abs(stamp - wall) < _NEAR for stamp in stamps)
            if any(life.had(at) for life in self.lives["detector"]):
                account.due += 1
                account.lost += [] if is_detected else [str(wall)]
            else:
                account.excused += not is_detected
        return account


def run(
    kills: int, minutes: float, seed: int, folder: Path, console: Console
) -> dict[str, Account]:
    """Kill ``kills`` times, or until the ``minutes`` are over; what became of every event."""
    rig, until = Rig(folder, seed), time.monotonic() + 60 * minutes
    try:
        for k in range(kills):
            if time.monotonic() > until:
                break
            console.print(f"{k + 1}/{kills}: {rig.kill_one()} killed")
        rig.spin(DUE)
    except TimeoutError as error:
        console.print(f"ended early: {error}")
    finally:
        rig.close()
    return {
        "events recorded": rig.recorded(),
        "events with a verdict": rig.judged(),
        "pulses detected": rig.detected(),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what was lost; 1 if anything was that had reached its process in time."""
    parser = argparse.ArgumentParser(prog="./dev kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=100, help="how often (default 100)")
    most = "after which no more is killed (default 60)"
    parser.add_argument("--minutes", type=float, default=60.0, help=most)
    parser.add_argument("--seed", type=int, default=0, help="of what is killed (default 0)")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    given = parser.parse_args(arguments)
    console = Console(stderr=True)
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    with take_domain(), TemporaryDirectory(prefix="kills") as folder:
        rclpy.init(args=[])
        accounts = run(given.kills, given.minutes, given.seed, Path(folder), console)
        rclpy.shutdown()
    for what, account in accounts.items():
        if given.json:
            figures = {"what": what, "due": account.due, "lost": len(account.lost)}
            print(json.dumps(figures | {"excused": account.excused}))
            continue
        print(
            f"{what}: {account.due - len(account.lost)} of {account.due} that had reached the"
            f" process {DUE:g} s before its end; {account.excused} others lost"
        )
        for line in account.lost:
            print(f"  lost: {line}")
    return 1 if any(account.lost for account in accounts.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
