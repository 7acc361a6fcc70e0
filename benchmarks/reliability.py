# SPDX-License-Identifier: Apache-2.0
"""Plant, observer, detector, monitor and recorder under attack: ``./dev bench reliability``.

Again and again one of the processes gets SIGKILL or SIGTERM and is started again, is stopped
by SIGSTOP for a second, or all get random messages. A node that is never attacked publishes the
switch of the detector and receives everything: it is the witness. At the end every event is
accounted for: those of the recorder in the bags, those of the observer by its verdicts, the
pulses of the switch by the detector's events; and each monitor must have published errors. What
had reached a process more than a second before its end must be there, and no process may end by
itself. The processes talk over UDP, as docs/security.md says of Fast DDS after kills.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import rclpy
from builtin_interfaces.msg import Time
from impact_observer_msgs.msg import ContactSwitch, EstimateError, EventVerdict, ImpactEvent
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rich.console import Console
from rich.table import Table
from std_msgs.msg import Bool

from benchmarks.checkout import HERE
from benchmarks.domain import free_domain
from benchmarks.rigs import fast
from impact_observer.errors import BagError
from impact_observer.io.reader import BagReader
from impact_observer.ros.subscribing import MessageInfo

DUE = 1.0
"""What had reached a process so long before its end is not lost, s."""
SENT = 0.5
"""What a process published so long before its own end has left it, for all that receive it, s."""
UP = 2.0
"""A process is attacked at the earliest so long after its first sign of life, s."""
PULSE, SPACING = 0.02, 0.3
"""Duration of a pulse of the switch, and time between two, s."""
MESSAGES = 50
"""Random messages of an attack."""
ATTACKS = ("SIGKILL", "SIGKILL", "SIGTERM", "SIGSTOP", "messages")
_NEAR = 120_000_000
"""How far an event of the detector may be from its pulse, ns: a process may have to wait."""
_PATIENCE = 120.0
PROCESSES = ("plant", "observer", "detector", "monitor", "recorder")
PLANT, DETECTOR = "/impacts", "/rig/impacts"
EventKey = tuple[str, int, int, int, int]
"""Topic, epoch, episode, sequence, stamp."""


@dataclass
class Life:
    """One process from its start (ns) to its end, by the clock of the witness, s.

    ``up`` is its first sign of life; ``stops`` are from SIGSTOP to SIGCONT. The ``folder`` has its
    log, and the bag of a recorder.
    """

    process: "subprocess.Popen[bytes]"
    folder: Path
    began: int
    up: float = inf
    end: float = inf
    stops: list[tuple[float, float]] = field(default_factory=list)

    def had(self, at: float) -> bool:
        """Whether what came then had reached the process long enough before its end."""
        stopped = any(begin - DUE < at < end + DUE for begin, end in self.stops)
        return self.up <= at < self.end - DUE and not stopped


class Account(NamedTuple):
    """How much should be there, what of it is lost, and how much else is not there."""

    due: int
    lost: list[str]
    excused: int


class Rig:
    """The five processes, and the witness."""

    def __init__(self, folder: Path, seed: int) -> None:
        """Start all of them."""
        self._folder, self._random = folder, random.Random(seed)
        (folder / "fast.yaml").write_text(fast(10.0, 1.0), "utf-8")
        source = "sources: [{contact: stop, topic: switch, kind: switch}]\n"
        (folder / "switch.yaml").write_text(source, "utf-8")
        self._node, self._executor = Node("witness"), SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.events: dict[EventKey, float] = {}
        self.random: set[EventKey] = set()
        self.verdicts: set[tuple[int, int]] = set()
        self.pulses: list[tuple[float, int]] = []
        self.errors: list[float] = []
        self.ended: list[str] = []
        self.lives: dict[str, list[Life]] = {name: [] for name in PROCESSES}
        self._connect()
        for name in self.lives:
            self.start(name)

    def _connect(self) -> None:
        """Publish the switch, and subscribe to what the processes publish."""
        events = QoSProfile(depth=2000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe = self._node.create_subscription
        for topic, name in ((PLANT, "plant"), (DETECTOR, "detector")):
            subscribe(ImpactEvent, topic, self._event_taker(topic, name), events)
        subscribe(EventVerdict, "/observer/verdicts", self._on_verdict, events)
        subscribe(EstimateError, "/monitor/error", self._on_error, 10)
        self._switch = self._node.create_publisher(Bool, "/switch", 10)
        self._attacker = self._node.create_publisher(ImpactEvent, PLANT, events)
        self._node.create_timer(SPACING, self._pulse)

    def _event_taker(self, topic: str, name: str) -> Callable[[ImpactEvent, MessageInfo], None]:
        def take(message: ImpactEvent, info: MessageInfo) -> None:
            now, key = time.monotonic(), key_of(topic, message)
            if self.events.setdefault(key, now) == now and key not in self.random:
                self._note(name, info)

        return take

    def _on_verdict(self, message: EventVerdict, info: MessageInfo) -> None:
        self.verdicts.add((nanoseconds(message.header.stamp), message.sequence))
        self._note("observer", info)

    def _on_error(self, _: EstimateError, info: MessageInfo) -> None:
        self.errors.append(time.monotonic())
        self._note("monitor", info)

    def _note(self, name: str, info: MessageInfo) -> None:
        """Note a message: what was published before the start is of the life before."""
        life = self.lives[name][-1]
        if info["source_timestamp"] > life.began:
            life.up = min(life.up, time.monotonic())

    def _pulse(self) -> None:
        self.pulses.append((time.monotonic(), time.time_ns()))
        self._switch.publish(Bool(data=True))
        time.sleep(PULSE)
        self._switch.publish(Bool(data=False))

    def start(self, name: str) -> None:
        """Start a process, a recorder with a bag of its own."""
        folder = self._folder / f"{name}_{len(self.lives[name])}"
        folder.mkdir()
        scripts = HERE / ".venv" / "bin"
        command = [str(scripts / name), "--ros-args"]
        if name in ("plant", "observer", "monitor"):
            command += ["-p", f"model:={self._folder / 'fast.yaml'}"]
        if name == "detector":
            command += ["-p", f"sources:={self._folder / 'switch.yaml'}"]
            command += ["-r", f"impacts:={DETECTOR}"]
        if name == "recorder":
            command = [str(scripts / "impact-observer"), "record", "--topics", PLANT, DETECTOR]
            command += ["-o", str(folder / "bag")]
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
        log = (life.folder / "log").read_text(errors="replace")
        if life.up == inf and log.count("recording /") > 1:
            life.up = time.monotonic()

    def attack(self) -> str:
        """Attack a process that has been up for a while; what was done to which."""
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until:
            self.spin(self._random.uniform(0.2, 0.8))
            now = time.monotonic()
            ready = [name for name, lives in self.lives.items() if lives[-1].up < now - UP]
            if not ready:
                continue
            name, how = self._random.choice(ready), self._random.choice(ATTACKS)
            if how == "messages":
                self.send_random()
                return how
            if how == "SIGSTOP":
                life = self.lives[name][-1]
                life.process.send_signal(signal.SIGSTOP)
                self.spin(self._random.uniform(0.2, 1.5))
                life.process.send_signal(signal.SIGCONT)
                life.stops.append((now, time.monotonic()))
            else:
                self.end(name, signal.Signals[how])
                self.start(name)
            return f"{how} of {name}"
        raise TimeoutError(f"nothing came up in {_PATIENCE:g} s")

    def send_random(self) -> None:
        """Send events whose numbers and names are random to all that receive impacts."""
        draw = self._random
        for _ in range(MESSAGES):
            event = ImpactEvent(sequence=draw.getrandbits(64), episode=draw.getrandbits(32))
            for stamp in (event.header.stamp, event.epoch):
                stamp.sec, stamp.nanosec = draw.randint(-(2**31), 2**31 - 1), draw.getrandbits(32)
            contact = draw.choice(("stop", "", "x" * 1000, "\x1b[2J", "stop\n"))
            event.switches = [ContactSwitch(contact=contact, kind=draw.getrandbits(8))]
            self.random.add(key_of(PLANT, event))
            self._attacker.publish(event)

    def end(self, name: str, how: signal.Signals) -> None:
        """End a process."""
        life = self.lives[name][-1]
        if (code := life.process.poll()) is not None:
            log = (life.folder / "log").read_text(errors="replace")
            self.ended.append(f"{name}, exit code {code}: {' '.join(log.split())[-300:]}")
        life.process.send_signal(how)
        life.end = time.monotonic()
        life.process.wait()

    def close(self) -> None:
        """End everything; what came after the witness received its last message is not judged."""
        now = time.monotonic()
        for name, lives in self.lives.items():
            self.end(name, signal.SIGTERM)
            lives[-1].end = min(lives[-1].end, now)
        self._node.destroy_node()

    def accounts(self) -> dict[str, Account]:
        """What became of everything."""
        of_plant = [key for key in self.events if key[0] == PLANT and key not in self.random]
        last = {key[1]: key for key in of_plant}.values()  # the observer may wait for a second one
        sent = {key: at for key, at in self.events.items() if self._was_sent(key, at)}
        saved = self._saved()
        recorded = [(at, key in saved, str(key)) for key, at in sent.items()]
        verdicts = [
            (sent[key], (key[4], key[3]) in self.verdicts, str(key))
            for key in of_plant
            if key in sent and key not in last
        ]
        stamps = [key[4] for key in self.events if key[0] == DETECTOR]
        pulses = [
            (at, any(abs(stamp - wall) < _NEAR for stamp in stamps), str(wall))
            for at, wall in self.pulses
        ]
        monitors = [life for life in self.lives["monitor"] if life.end - life.up > 2 * DUE]
        silent = [str(e.folder) for e in monitors if not any(e.had(at) for at in self.errors)]
        return {
            "events recorded": self._account("recorder", recorded),
            "events with a verdict": self._account("observer", verdicts),
            "pulses detected": self._account("detector", pulses),
            "monitors with errors": Account(len(monitors), silent, 0),
            "processes that ended by themselves": Account(0, self.ended, 0),
        }

    def _was_sent(self, key: EventKey, at: float) -> bool:
        """Whether the sender of an event lived until it had left for all that receive it."""
        lives = self.lives["plant" if key[0] == PLANT else "detector"]
        return key in self.random or all(abs(at - life.end) > SENT for life in lives)

    def _account(self, name: str, found: Sequence[tuple[float, bool, str]]) -> Account:
        """What a process should have: when it came, whether it is there, and its name."""
        lives = self.lives[name]
        due = [each for each in found if any(life.had(each[0]) for life in lives)]
        lost = [what for _, is_there, what in due if not is_there]
        return Account(len(due), lost, sum(not each[1] for each in found) - len(lost))

    def _saved(self) -> set[EventKey]:
        """The events of all bags, killed or not."""
        saved: set[EventKey] = set()
        for life in self.lives["recorder"]:
            bag = life.folder / "bag"
            # A recorder may be killed before its first chunk.
            with suppress(BagError), BagReader(bag) as reader:
                for topic in reader.topics:
                    saved |= {key_of(topic, message) for _, message in reader.messages(topic)}
        return saved


def nanoseconds(stamp: Time) -> int:
    """A stamp in ns."""
    return 10**9 * int(stamp.sec) + int(stamp.nanosec)


def key_of(topic: str, event: ImpactEvent) -> EventKey:
    """The key of an event."""
    stamp = nanoseconds(event.header.stamp)
    return topic, nanoseconds(event.epoch), event.episode, event.sequence, stamp


def run(attacks: int, seed: int, folder: Path) -> tuple[dict[str, Account], Counter[str]]:
    """Attack again and again; what became of everything, and what was done how often."""
    rig, done = Rig(folder, seed), Counter[str]()
    try:
        for k in range(attacks):
            done[what := rig.attack()] += 1
            print(f"{k + 1}/{attacks}: {what}", file=sys.stderr)
        rig.spin(3 * DUE)
    finally:
        rig.close()
    return rig.accounts(), done


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what was lost; 1 if anything was that had reached its process in time."""
    parser = argparse.ArgumentParser(prog="./dev bench reliability", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--attacks", type=int, default=100, help="how many (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the attacks (default 0)")
    given = parser.parse_args(arguments)
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    with free_domain() as domain, TemporaryDirectory(prefix="reliability") as folder:
        os.environ.update(domain)
        rclpy.init(args=[])
        accounts, done = run(given.attacks, given.seed, Path(folder))
        rclpy.shutdown()
    table = Table("what", "due", "lost", f"lost within {DUE:g} s of an attack")
    for what, account in accounts.items():
        table.add_row(what, str(account.due), str(len(account.lost)), str(account.excused))
    console = Console(width=max(Console().width, 100))
    console.print(table)
    for what, account in accounts.items():
        console.print(*(f"lost: {what}: {line}\n" for line in account.lost), end="")
    console.print(", ".join(f"{count} {what}" for what, count in sorted(done.items())))
    return 1 if any(account.lost for account in accounts.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
