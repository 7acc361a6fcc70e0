# SPDX-License-Identifier: Apache-2.0
"""What stops an observer from using a bag, and what spoils its estimates, in one pass.

Eight kinds of faults: a damaged or foreign file; no impacts; messages that are not valid; no
model; contacts that are not the model's; events that are lost or repeated; stamps that do not fit
the epoch; a truth that does not fit the model or the impacts.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Any

from impact_observer.check.bag_summary import print_summary, summary_of
from impact_observer.draw.reports import counted, listed, print_facts
from impact_observer.errors import BagError, ModelError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage, MessageError, read_event, read_joint_state
from impact_observer.io.reader import BagReader, RawMessage
from impact_observer.model import System, parse_model
from impact_observer.model.robot_description import RobotDescription
from impact_observer.plain_text import say
from impact_observer.stamps import text

ERROR, WARNING, NOTE = SEVERITIES = ("error", "warning", "note")
"""Severities, most severe first.

No observer can use a bag with an error. A warning means that part of the bag is lost, or that an
observer needs an option. A note is information only.
"""
_SENSORS = {
    "std_msgs/msg/Bool": "",
    "sensor_msgs/msg/Imu": " --threshold N",
    "geometry_msgs/msg/WrenchStamped": " --field wrench.force.z --threshold N",
    "geometry_msgs/msg/Wrench": " --field force.z --threshold N",
    "geometry_msgs/msg/AccelStamped": " --field accel.linear.z --threshold N",
    "std_msgs/msg/Float64": " --field data --threshold N",
    "std_msgs/msg/Float32": " --field data --threshold N",
    "std_msgs/msg/Empty": "",
    "std_msgs/msg/Header": "",
}
"""Message types that ``detect`` reads, and the options of ``detect``."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a bag, or one remark on it.

    Attributes:
        severity: ``error``, ``warning`` or ``note``.
        thing: the file, topic or contact.
        found: the fault in words.
        wanted: the expectation; empty if obvious.
        remedy: advice to the user; empty if nothing need be done.
    """

    severity: str
    thing: str
    found: str
    wanted: str = ""
    remedy: str = ""

    @property
    def line(self) -> str:
        """The finding as one line."""
        wanted = f"expected {self.wanted}" if self.wanted else ""
        parts = filter(None, (f"{self.thing}: {self.found}", wanted, self.remedy))
        return " ".join("; ".join(parts).split())


@dataclass(frozen=True, slots=True)
class Report:
    """The result of a check.

    Attributes:
        path: the bag.
        readable: whether the bag can be read.
        counts: messages of each topic.
        findings: the most severe first.
        content: of :func:`~impact_observer.check.bag_summary.summary_of`; None if unreadable.
    """

    path: Path
    readable: bool
    counts: Mapping[str, int]
    findings: list[Finding]
    content: dict[str, Any] | None = None

    @property
    def usable(self) -> bool:
        """Whether an observer can use the bag."""
        return all(each.severity != ERROR for each in self.findings)

    def for_json(self) -> dict[str, object]:
        """The report as the dictionary that ``--json`` prints."""
        return {
            "path": str(self.path),
            "usable": self.usable,
            "readable": self.readable,
            "topics": dict(sorted(self.counts.items())),
            "findings": [asdict(each) | {"line": each.line} for each in self.findings],
            "content": self.content,
        }

    def print(self) -> None:
        """Print the contents, the findings, and whether an observer can use the bag."""
        if self.content is not None:
            print_summary(self.content)
            say("")
        print_facts((each.severity, each.line) for each in self.findings)
        counts = Counter(each.severity for each in self.findings)
        numbers = listed(counted(counts[s], s) for s in SEVERITIES if counts[s])
        usable = "an observer can use it" if self.usable else "no observer can use it"
        say(f"{self.path}: {usable} ({numbers if self.findings else 'no findings'})")


def check_bag(
    path: Path,
    system: System | RobotDescription | None = None,
    *,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Report:
    """Check a bag.

    Args:
        path: a rosbag2 folder, or a bare file.
        system: system of the user's model; None for the model in the bag.
        progress: called with the number of messages read and of all messages.

    Raises:
        UsageError: ``path`` does not exist.
    """
    counts = Counter[str]()
    try:
        with BagReader(path) as reader:
            check = _BagCheck(reader, system)
            for done, raw in enumerate(reader.raw()):
                counts[raw.topic] += 1
                check.take(raw)
                progress(done, reader.message_count)
            found = [*_incomplete(reader), *check.findings()]
            content = summary_of(reader, check.events.valid)
    except BagError as error:
        reason = str(error).removeprefix(f"{path}: ")
        return Report(path, False, counts, [Finding(ERROR, _name(path), reason)])
    found.sort(key=lambda each: SEVERITIES.index(each.severity))
    return Report(path, True, counts, found, content)


def _name(path: Path) -> str:
    return path.name or str(path)


def _incomplete(reader: BagReader) -> Iterator[Finding]:
    """A file without an end, and journals of sqlite3 that a killed recorder left."""
    path = reader.path
    if not reader.is_whole:
        yield Finding(WARNING, _name(path), "has no end, and is read up to its last whole chunk")
    folder, files = (path, "*.db3") if path.is_dir() else (path.parent, path.name)
    for journal in sorted(folder.glob(f"{files}-wal")):
        if size := journal.stat().st_size:
            fault = f"{size} bytes that are not in the database yet"
            database = quote(str(journal.with_name(journal.name.removesuffix("-wal"))))
            remedy = f"put them in: sqlite3 {database} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            yield Finding(WARNING, journal.name, fault, remedy=remedy)


class _Faults:
    """Counts of faults, each with the place of the first."""

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self.first = dict[str, str]()

    def add(self, fault: str, where: str) -> None:
        """Count a fault at a place."""
        self.counts[fault] += 1
        self.first.setdefault(fault, where)

    def findings(
        self, thing: str, severity: str, remedies: Mapping[str, str]
    ) -> Iterator[Finding]:
        """A finding for each fault that has a remedy here, in their order."""
        for fault, remedy in remedies.items():
            if count := self.counts[fault]:
                found = f"{count} {fault}, the first is {self.first[fault]}"
                yield Finding(severity, thing, found, remedy=remedy)


class _Events:
    """The events of one topic, in bag order."""

    remedies = {  # noqa: RUF012 (a constant)
        "repeated": "each counts once",
        "with the sequence number of another event": "expected +1 a message",
        "before their epoch": "such events are not applied; give the epoch with --epoch S",
        "OPEN of a contact that is not closed": "a CLOSE was lost",
        "CLOSE or IMPACT of a closed contact": "an OPEN was lost",
    }

    def __init__(self) -> None:
        self.faults, self.invalid = _Faults(), _Faults()
        self.runs: defaultdict[tuple[int, int], dict[int, int]] = defaultdict(dict)
        self.valid: list[ImpactEvent] = []
        self.contacts, self.epochs = Counter[str](), Counter[int]()
        self.first = self.last = 0
        self._run: tuple[int, int] | None = None
        self._closed: dict[str, int] = {}

    def take(self, message: AnyMessage, place: int) -> None:
        """Take a message, the number ``place`` of its topic."""
        event = read_event(message)
        self.valid.append(event)
        where = f"message {place} at {text(event.stamp)} s"
        self.epochs[event.epoch] += 1
        if event.stamp < event.epoch:
            self.faults.add("before their epoch", where)
        run = event.epoch, event.episode
        if run != self._run:
            self._run, self._closed = run, {}
        if (earlier := self.runs[run].get(event.sequence)) is not None:
            same = earlier == event.stamp
            fault = "repeated" if same else "with the sequence number of another event"
            self.faults.add(fault, where)
            return
        if event.sequence:
            self.runs[run][event.sequence] = event.stamp
        self._take_switches(event, where)
        self.first = min(self.first or event.stamp, event.stamp)
        self.last = max(self.last, event.stamp)

    def _take_switches(self, event: ImpactEvent, where: str) -> None:
        """Check that CLOSE and OPEN of a contact take turns; late events are not looked at."""
        for switch in sorted(event.switches, key=lambda each: each.kind):
            contact, kind = switch.contact, switch.kind
            self.contacts[contact] += 1
            if event.stamp < self.last:
                continue
            closed = self._closed.get(contact)
            if kind is Kind.OPEN:
                if closed is None:
                    self.faults.add("OPEN of a contact that is not closed", f"{contact}, {where}")
                self._closed.pop(contact, None)
                continue
            opens = Switch(contact, Kind.OPEN) in event.switches
            if closed is not None and closed != event.stamp and not opens:
                self.faults.add("CLOSE or IMPACT of a closed contact", f"{contact}, {where}")
            if kind is Kind.CLOSE:
                self._closed[contact] = event.stamp

    def missing(self) -> Iterator[tuple[int, int, int]]:
        """Stamp after, first number and count of each gap in the sequence numbers."""
        for stamps in self.runs.values():
            for before, after in pairwise(sorted(stamps)):
                if after > before + 1:
                    yield stamps[after], before + 1, after - before - 1


class _BagCheck:
    """The check of all messages of a bag."""

    def __init__(self, reader: BagReader, system: System | RobotDescription | None) -> None:
        self._reader, self._system, self._name = reader, system, _name(reader.path)
        self.events, self._truth_faults = _Events(), _Faults()
        self._names: tuple[str, ...] = ()
        self._stamps = [0, 0, 0]  # first, last, number
        self._found: list[Finding] = []
        self._places = Counter[str]()
        self._decoders = dict[str, tuple[Callable[[bytes], AnyMessage], Callable[..., None]]]()
        takers = {
            interfaces.IMPACTS: self.events.take,
            interfaces.PLANT_JOINT_STATES: self._take_state,
        }
        self._topics = {own: self._topic(own) for own in takers}
        for own, take in takers.items():
            if (topic := self._topics[own]) is not None:
                self._decoders[topic] = reader.decoder(topic), take

    def _topic(self, own: interfaces.Interface) -> str | None:
        """The topic of an interface; its faults are findings."""
        candidates = own.candidates(self._reader.topics)
        if len(candidates) > 1:
            fault = f"several topics fit {own.topic}"
            remedy = f"play the bag with one as {own.topic}, and record that"
            self._add(ERROR, " and ".join(candidates), fault, "one of them", remedy)
        for topic in candidates if len(candidates) == 1 else ():
            if (kind := self._reader.topics[topic].type) == own.type:
                return topic
            self._add(ERROR, topic, f"is {kind}", own.type)
        return None

    def _add(self, *parts: str) -> None:
        self._found.append(Finding(*parts))

    def take(self, raw: RawMessage) -> None:
        """Take a message of any topic."""
        if raw.topic in self._decoders:
            decode, take = self._decoders[raw.topic]
            place = self._places[raw.topic]
            self._places[raw.topic] += 1
            try:
                take(decode(raw.data), place)
            except (BagError, MessageError) as error:
                reason = str(error).removeprefix(f"{self._reader.path}: ")
                faults = self.events.invalid if take == self.events.take else self._truth_faults
                faults.add("not valid", f"message {place}: {reason}")

    def _take_state(self, message: AnyMessage, place: int) -> None:
        """Take a true state."""
        state = read_joint_state(message)
        self._names = self._names or state.names
        if set(state.names) != set(self._names) or len(set(state.names)) < len(state.names):
            names = listed(state.names, joint=", ")
            self._truth_faults.add("with other coordinates", f"message {place}: {names}")
        first, last, count = self._stamps
        self._stamps = [min(first or state.stamp, state.stamp), max(last, state.stamp), count + 1]

    def findings(self) -> list[Finding]:
        """All findings, after all messages."""
        system = self._model()
        if (topic := self._topics[interfaces.IMPACTS]) is not None:
            self._found += self._event_findings(topic, system)
        elif not any(map(interfaces.IMPACTS.fits, self._reader.topics)):
            self._add_lack_of_impacts()
        if (truth := self._topics[interfaces.PLANT_JOINT_STATES]) is not None:
            self._found += self._truth_findings(truth, system)
        elif not any(map(interfaces.PLANT_JOINT_STATES.fits, self._reader.topics)):
            fault = f"carries no truth ({interfaces.PLANT_JOINT_STATES.topic})"
            self._add(NOTE, self._name, fault, "", "observe needs --rate")
        return self._found

    def _model(self) -> System | RobotDescription | None:
        """The given system, else that of the model in the bag."""
        if self._system is not None:
            return self._system
        try:
            if (model := self._reader.model_text()) is not None:
                return parse_model(model, "model").subject
            fault = f"carries no model ({interfaces.PLANT_MODEL.topic})"
        except (BagError, ModelError) as error:
            fault = f"the model it carries is not valid ({error})"
        self._add(WARNING, self._name, fault, "", "name one with --model MODEL")
        return None

    def _add_lack_of_impacts(self) -> None:
        """Add that there are no impacts, with the topics of which impacts can be made."""
        topics = self._reader.topics
        fault = f"no impacts; topics in the bag: {listed(topics, joint=', ')}"
        wanted = f"{interfaces.IMPACT_EVENT} on {interfaces.IMPACTS.topic}"
        remedy = "make them of a sensor by `detect`, or of a table by `import`"
        self._add(ERROR, self._name, fault, wanted, remedy)
        detect = f"impact-observer detect {quote(str(self._reader.path))} --contact NAME --topic"
        for info in topics.values():
            if info.type in _SENSORS and not interfaces.PHASE_REFERENCE.fits(info.name):
                remedy = f"{detect} {info.name}{_SENSORS[info.type]} -o NEW"
                self._add(NOTE, info.name, f"{info.type} may be a sensor", "", remedy)

    def _event_findings(
        self, topic: str, system: System | RobotDescription | None
    ) -> Iterator[Finding]:
        events = self.events
        if not events.valid:
            found = f"no valid events among {counted(self._places[topic], 'message')}"
            yield Finding(ERROR, topic, found, "at least one impact")
        remedy = "mend the sender and record again"
        yield from events.invalid.findings(topic, ERROR, {"not valid": remedy})
        yield from events.faults.findings(topic, WARNING, events.remedies)
        if gaps := sorted(events.missing()):
            stamp, number, _ = gaps[0]
            missing = counted(sum(size for *_, size in gaps), "event")
            found = f"{missing} missing, the first is number {number}, before {text(stamp)} s"
            remedy = "record with reliable quality of service and a depth of 2000"
            yield Finding(WARNING, topic, found, remedy=remedy)
        if events.epochs[0] and system is not None and system.depends_on_time:
            found = f"{counted(events.epochs[0], 'event')} without an epoch"
            wanted = f"the stamp of t = 0, as the forcing of {system.name} depends on time"
            yield Finding(WARNING, topic, found, wanted, "give it with --epoch S")
        if system is not None and events.valid:
            yield from self._contact_findings(topic, system)

    def _contact_findings(
        self, topic: str, system: System | RobotDescription
    ) -> Iterator[Finding]:
        own, seen = system.contact_names, self.events.contacts
        wanted = listed(own, joint=", ")
        if unknown := [name for name in seen if name not in own]:
            severity = ERROR if len(unknown) == len(seen) else WARNING
            found = f"contacts that the model {system.name} does not have: {listed(unknown)}"
            remedy = "they are not applied; name the model with --model, or rename them"
            yield Finding(severity, topic, found, wanted, remedy)
            if severity == ERROR:
                return
        if silent := [name for name in own if name not in seen]:
            found = f"contacts of the model {system.name} never reported: {listed(silent)}"
            yield Finding(WARNING, topic, found)

    def _truth_findings(
        self, topic: str, system: System | RobotDescription | None
    ) -> Iterator[Finding]:
        remedy = "observe and compare refuse it; record again, or leave the topic out"
        remedies = dict.fromkeys(("not valid", "with other coordinates"), remedy)
        yield from self._truth_faults.findings(topic, ERROR, remedies)
        if self._names and system is not None and set(self._names) != set(system.coordinates):
            found = f"states of {listed(self._names, joint=', ')}"
            wanted = f"the coordinates {listed(system.coordinates, joint=', ')} of {system.name}"
            yield Finding(WARNING, topic, found, wanted, "compare cannot use them")
        (first, last, count), events = self._stamps, self.events
        step = (last - first) // max(count - 1, 1)
        if (
            count
            and events.last
            and not first - step <= events.first <= events.last <= last + step
        ):
            truth = f"the truth is from {text(first)} to {text(last)} s"
            found = f"{truth}, the impacts are from {text(events.first)} to {text(events.last)} s"
            apart = events.last < first or last < events.first
            remedy = f"{'nothing' if apart else 'only what is common'} can be compared"
            yield Finding(WARNING if apart else NOTE, topic, found, remedy=remedy)
