# SPDX-License-Identifier: Apache-2.0
"""Plant, observer, detector, monitor and recorder under attack: ``./dev bench reliability``.

Again and again one of the processes gets SIGKILL or SIGTERM and is started again, or is stopped
by SIGSTOP for a second, or all get random messages. A node that is never attacked, the witness,
publishes the switch of the detector and receives everything. What had reached a process more than
a second before its end must be there: events in the bags of the recorder, verdicts of the
observer, the detector's events of pulses, errors of the monitor. No process may end by itself.
The processes talk over UDP, as docs/security.md says of Fast DDS after kills.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

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
from impact_observer.ros.topics import MessageInfo

DUE, SENT, UP = 1.0, 0.5, 2.0
"""What had reached a process so long before its end is not lost; what it published so long before
its end has left it; it is attacked so long after its first sign of life, s."""
PULSE, SPACING, MESSAGES = 0.02, 0.3, 50
"""Duration of a pulse and time between two, s; random messages of an attack."""
ATTACKS = ("SIGKILL", "SIGKILL", "SIGTERM", "SIGSTOP", "messages")
_NEAR, _PATIENCE = 120_000_000, 120.0
"""How far an event of the detector may be from its pulse, ns; longest wait for a process, s."""
SENSORS = "sources: [{contact: stop, topic: switch, kind: switch}]\n"
SCRIPTS = HERE / ".venv" / "bin"
PROCESSES = ("plant", "observer", "detector", "monitor", "recorder")
PLANT, DETECTOR = "/impacts", "/rig/impacts"
EventKey = tuple[str, int, int, int, int]
"""Topic, epoch, episode, sequence, stamp."""
Account = tuple[int, list[str]]
"""How much should be there, and what of it is lost."""


@dataclass
class Life:
    """One process from its start (ns) to its end, by the clock of the witness, s.

    ``up`` is its first sign of life; ``stops`` are from SIGSTOP to SIGCONT.
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


class Rig:
    """The five processes, and the witness."""

    def __init__(self, folder: Path, seed: int) -> None:
        """Start all of them."""
        self._folder, self._random = folder, random.Random(seed)
        (folder / "fast.yaml").write_text(fast(10.0, 1.0), "utf-8")
        (folder / "switch.yaml").write_text(SENSORS, "utf-8")
        self._node, self._executor = Node("witness"), SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.events: dict[EventKey, float] = {}
        self.random: set[EventKey] = set()
        self.verdicts: set[tuple[int, int]] = set()
        self.pulses: list[tuple[float, int]] = []
        self.errors: list[float] = []
        self.ended: list[str] = []
        self.lives: dict[str, list[Life]] = {name: [] for name in PROCESSES}
        events = QoSProfile(depth=2000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe = self._node.create_subscription
        for topic in (PLANT, DETECTOR):
            subscribe(ImpactEvent, topic, partial(self._on_event, topic), events)
        subscribe(EventVerdict, "/observer/verdicts", self._on_verdict, events)
        subscribe(EstimateError, "/monitor/error", self._on_error, 10)
        self._switch = self._node.create_publisher(Bool, "/switch", 10)
        self._attacker = self._node.create_publisher(ImpactEvent, PLANT, events)
        self._node.create_timer(SPACING, self._pulse)
        for name in PROCESSES:
            self.start(name)

    def _on_event(self, topic: str, message: ImpactEvent, info: MessageInfo) -> None:
        now, key = time.monotonic(), key_of(topic, message)
        if self.events.setdefault(key, now) == now and key not in self.random:
            self._note("plant" if topic == PLANT else "detector", info)

    def _on_verdict(self, message: EventVerdict, info: MessageInfo) -> None:
        self.verdicts.add((message.sequence, nanoseconds(message.header.stamp)))
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
        for closed in (True, False):
            self._switch.publish(Bool(data=closed))
            time.sleep(PULSE)

    def start(self, name: str) -> None:
        """Start a process, a recorder with a bag of its own."""
        folder = self._folder / f"{name}_{len(self.lives[name])}"
        folder.mkdir()
        command = [f"{SCRIPTS}/{name}", "--ros-args"]
        if name == "detector":
            command += ["-p", f"sources:={self._folder}/switch.yaml", "-r", f"impacts:={DETECTOR}"]
        elif name != "recorder":
            command += ["-p", f"model:={self._folder / 'fast.yaml'}"]
        else:
            command = [f"{SCRIPTS}/impact-observer", "record", "-o", str(folder / "bag")]
            command += ["--topics", PLANT, DETECTOR]
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
        if life.up == inf and (life.folder / "log").read_text().count("recording /") > 1:
            life.up = time.monotonic()

    def attack(self) -> str:
        """Attack a process when it has been up for a while; what was done to which."""
        name, how = self._random.choice(PROCESSES), self._random.choice(ATTACKS)
        until = time.monotonic() + _PATIENCE
        self.spin(self._random.uniform(0.2, 0.8))
        while not (life := self.lives[name][-1]).up < time.monotonic() - UP:
            if time.monotonic() > until:
                raise TimeoutError(f"{name}: not up after {_PATIENCE:g} s")
            self.spin(0.2)
        if how == "messages":
            self.send_random()
            return how
        if how == "SIGSTOP":
            begin = time.monotonic()
            life.process.send_signal(signal.SIGSTOP)
            self.spin(self._random.uniform(0.2, 1.5))
            life.process.send_signal(signal.SIGCONT)
            life.stops.append((begin, time.monotonic()))
        else:
            self.end(name, signal.Signals[how])
            self.start(name)
        return f"{how} of {name}"

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
            log = " ".join((life.folder / "log").read_text(errors="replace").split())
            self.ended.append(f"{name}, exit code {code}: {log[-300:]}")
        life.process.send_signal(how)
        life.end = time.monotonic()
        life.process.wait()

    def close(self) -> None:
        """End everything; what came after the witness received its last message is not judged."""
        now = time.monotonic()
        for name, lives in self.lives.items():
            self.end(name, signal.SIGTERM)
            lives[-1].end = now

    def accounts(self) -> dict[str, Account]:
        """What became of everything."""
        of_plant = [key for key in self.events if key[0] == PLANT and key not in self.random]
        last = {key[1]: key for key in of_plant}.values()  # the observer may wait for a second one
        sent = {key: at for key, at in self.events.items() if self._was_sent(key, at)}
        saved = self._saved()
        recorded = [(at, key in saved, str(key)) for key, at in sent.items()]
        verdicts = [
            (sent[key], key[3:] in self.verdicts, str(key))
            for key in of_plant
            if key in sent and key not in last
        ]
        found = [key[4] for key in self.events if key[0] == DETECTOR]
        pulses = [
            (at, any(abs(each - wall) < _NEAR for each in found), str(wall))
            for at, wall in self.pulses
        ]
        monitors = [life for life in self.lives["monitor"] if life.end - life.up > 2 * DUE]
        silent = [e.folder.name for e in monitors if not any(e.had(at) for at in self.errors)]
        return {
            "events recorded": self._account("recorder", recorded),
            "events with a verdict": self._account("observer", verdicts),
            "pulses detected": self._account("detector", pulses),
            "monitors with errors": (len(monitors), silent),
            "processes up at their end": (sum(map(len, self.lives.values())), self.ended),
        }

    def _was_sent(self, key: EventKey, at: float) -> bool:
        """Whether the sender of an event lived until it had left for all that receive it."""
        lives = self.lives["plant" if key[0] == PLANT else "detector"]
        return key in self.random or all(abs(at - life.end) > SENT for life in lives)

    def _account(self, name: str, found: Sequence[tuple[float, bool, str]]) -> Account:
        """What a process should have: when it came, whether it is there, and its name."""
        due = [each for each in found if any(life.had(each[0]) for life in self.lives[name])]
        return len(due), [what for _, is_there, what in due if not is_there]

    def _saved(self) -> set[EventKey]:
        """The events of all bags, killed or not."""
        saved: set[EventKey] = set()
        for life in self.lives["recorder"]:
            with suppress(BagError), BagReader(life.folder / "bag") as reader:  # may be empty
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
        rig, done = Rig(Path(folder), given.seed), Counter[str]()
        try:
            for k in range(given.attacks):
                done[what := rig.attack()] += 1
                print(f"{k + 1}/{given.attacks}: {what}", file=sys.stderr)
            rig.spin(3 * DUE)
        finally:
            rig.close()
        accounts = rig.accounts()
    table = Table("what", "due", "lost")
    for what, (due, lost) in accounts.items():
        table.add_row(what, str(due), str(len(lost)))
        print("".join(f"lost: {what}: {each}\n" for each in lost), end="")
    Console().print(table, ", ".join(f"{count} {what}" for what, count in sorted(done.items())))
    return 1 if any(lost for _, lost in accounts.values()) else 0
