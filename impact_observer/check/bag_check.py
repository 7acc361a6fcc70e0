# SPDX-License-Identifier: Apache-2.0
"""What stops an observer from using a bag, and what spoils its estimates, in one pass.

Eight kinds of faults: a damaged or foreign file; no impacts; messages that are not valid; no
model; contacts that are not the model's; events that are lost or repeated; stamps that do not fit
the epoch; a truth that does not fit the model or the impacts.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from impact_observer.io.reader import BagReader
from impact_observer.io.state_arrays import RecordedStates
from impact_observer.model import Model, System, parse_model
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
    """One fault of a bag, or one remark on it: a file, topic or contact, and words.

    What is wanted is empty if obvious, and the remedy if nothing need be done.
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
    """The result of a check: counts of messages by topic, findings, the most severe first.

    The content is that of :func:`~impact_observer.check.bag_summary.summary_of`; None if the bag
    is not readable.
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
    model: Model | None = None,
    *,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Report:
    """Check a bag against the ``model`` of the user; None for that in the bag.

    Raises:
        UsageError: ``path`` does not exist.
    """
    counts = Counter[str]()
    try:
        with BagReader(path) as reader:
            for done, raw in enumerate(reader.raw()):
                counts[raw.topic] += 1
                progress(done, reader.message_count)
            found, events = _findings(reader, model)
            content = summary_of(reader, events)
    except BagError as error:
        reason = str(error).removeprefix(f"{path}: ")
        return Report(path, False, counts, [Finding(ERROR, _name(path), reason)])
    found.sort(key=lambda each: SEVERITIES.index(each.severity))
    return Report(path, True, counts, found, content)


def _name(path: Path) -> str:
    return path.name or str(path)


def _findings(reader: BagReader, model: Model | None) -> tuple[list[Finding], list[ImpactEvent]]:
    """All findings, and the impacts."""
    name, found, events = _name(reader.path), [*_incomplete(reader)], list[ImpactEvent]()
    system = _subject(reader, model, found)
    if topic := _topic(reader, interfaces.IMPACTS, found):
        try:
            events = [*reader.events(topic)]
            found += _event_findings(topic, events, system)
        except BagError as error:
            found.append(_invalid(reader, topic, error))
    elif not any(map(interfaces.IMPACTS.fits, reader.topics)):
        found += _lack_of_impacts(reader)
    if topic := _topic(reader, interfaces.PLANT_JOINT_STATES, found):
        try:
            found += _truth_findings(topic, reader.joint_states(topic), events, system)
        except BagError as error:
            found.append(_invalid(reader, topic, error))
    elif not any(map(interfaces.PLANT_JOINT_STATES.fits, reader.topics)):
        fault = f"carries no truth ({interfaces.PLANT_JOINT_STATES.topic})"
        found.append(Finding(NOTE, name, fault, remedy="observe needs --rate"))
    return found, events


def _subject(
    reader: BagReader, model: Model | None, found: list[Finding]
) -> System | RobotDescription | None:
    """The system of the user's model, else of the bag's; faults are added to those ``found``."""
    name, fault = _name(reader.path), "carries no model (/plant/model)"
    if model is None:
        try:
            text_of_model = reader.model_text()
            model = parse_model(text_of_model, "the model") if text_of_model else None
        except (BagError, ModelError) as error:
            fault = f"the model it carries is not valid ({error})"
    if model is None:
        found.append(Finding(WARNING, name, fault, remedy="name one with --model MODEL"))
        return None
    if model.misfit:
        found.append(Finding(WARNING, name, model.misfit))
    return model.subject


def _topic(reader: BagReader, own: interfaces.Interface, found: list[Finding]) -> str | None:
    """The topic of an interface; its faults are added to those ``found``."""
    candidates = own.candidates(reader.topics)
    if len(candidates) > 1:
        fault = f"several topics fit {own.topic}"
        remedy = f"play the bag with one as {own.topic}, and record that"
        found.append(Finding(ERROR, " and ".join(candidates), fault, "one of them", remedy))
    for topic in candidates if len(candidates) == 1 else ():
        if (kind := reader.topics[topic].type) == own.type:
            return topic
        found.append(Finding(ERROR, topic, f"is {kind}", own.type))
    return None


def _invalid(reader: BagReader, topic: str, error: BagError) -> Finding:
    """The finding of a message that is not valid."""
    reason = str(error).removeprefix(f"{reader.path}: ").removeprefix(topic).lstrip(", ")
    remedy = "no command uses it; mend the sender and record again"
    return Finding(ERROR, topic, f"not valid: {reason}", remedy=remedy)


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


def _lack_of_impacts(reader: BagReader) -> Iterator[Finding]:
    """That there are no impacts, and the topics of which impacts can be made."""
    fault = f"no impacts; topics in the bag: {listed(reader.topics, joint=', ')}"
    wanted = f"{interfaces.IMPACT_EVENT} on {interfaces.IMPACTS.topic}"
    remedy = "make them of a sensor by `detect`, or of a table by `import`"
    yield Finding(ERROR, _name(reader.path), fault, wanted, remedy)
    detect = f"impact-observer detect {quote(str(reader.path))} --contact NAME --topic"
    for info in reader.topics.values():
        if info.type in _SENSORS and not interfaces.PHASE_REFERENCE.fits(info.name):
            remedy = f"{detect} {info.name}{_SENSORS[info.type]} -o NEW"
            yield Finding(NOTE, info.name, f"{info.type} may be a sensor", remedy=remedy)


def _event_findings(
    topic: str, events: Sequence[ImpactEvent], system: System | RobotDescription | None
) -> Iterator[Finding]:
    """Events that are lost or repeated, and stamps that do not fit the epoch."""
    if not events:
        yield Finding(ERROR, topic, "no events", "at least one impact")
        return
    early = ((k, each.stamp < each.epoch) for k, each in enumerate(events))
    faults = [(k, "before their epoch", "") for k, is_early in early if is_early]
    places = defaultdict[str, list[str]](list)
    for place, fault, contact in (*faults, *_event_faults(events)):
        where = f"message {place} at {text(events[place].stamp)} s"
        places[fault].append(f"{contact}{where}")
    for fault, remedy in _EVENT_FAULTS.items():
        if wheres := places[fault]:
            found = f"{len(wheres)} {fault}, the first is {wheres[0]}"
            yield Finding(WARNING, topic, found, remedy=remedy)
    numbers = defaultdict[tuple[int, int], dict[int, int]](dict)
    for each in events:
        if each.sequence:
            numbers[each.epoch, each.episode][each.sequence] = each.stamp
    if gaps := [
        (stamps[after], before + 1, after - before - 1)
        for stamps in numbers.values()
        for before, after in pairwise(sorted(stamps))
        if after > before + 1
    ]:
        stamp, number, _ = min(gaps)
        missing = counted(sum(size for *_, size in gaps), "event")
        found = f"{missing} missing, the first is number {number}, before {text(stamp)} s"
        remedy = "record with reliable quality of service and a depth of 2000"
        yield Finding(WARNING, topic, found, remedy=remedy)
    if system is not None:
        without = sum(not each.epoch for each in events)
        if without and system.depends_on_time:
            found = f"{counted(without, 'event')} without an epoch"
            wanted = f"the stamp of t = 0, as the forcing of {system.name} depends on time"
            yield Finding(WARNING, topic, found, wanted, "give it with --epoch S")
        yield from _contact_findings(topic, events, system)


_EVENT_FAULTS = {
    "repeated": "each counts once",
    "with the sequence number of another event": "expected +1 a message",
    "before their epoch": "such events are not applied; give the epoch with --epoch S",
    "OPEN of a contact that is not closed": "a CLOSE was lost",
    "CLOSE or IMPACT of a closed contact": "an OPEN was lost",
}
"""Faults of single events, with what follows or helps."""


def _event_faults(events: Sequence[ImpactEvent]) -> Iterator[tuple[int, str, str]]:
    """Places of events with a fault, the fault, and the contact if the fault is one of a contact.

    CLOSE and OPEN of a contact take turns; late events are not looked at.
    """
    seen, run, closed, last = dict[tuple[int, int, int], int](), (0, 0), dict[str, int](), 0
    for place, event in enumerate(events):
        if run != (event.epoch, event.episode):
            run, closed, last = (event.epoch, event.episode), {}, 0
        key = (*run, event.sequence)
        if (earlier := seen.get(key)) is not None:
            same = earlier == event.stamp
            yield place, "repeated" if same else "with the sequence number of another event", ""
            continue
        if event.sequence:
            seen[key] = event.stamp
        is_late, last = event.stamp < last, max(last, event.stamp)
        for switch in () if is_late else sorted(event.switches, key=lambda each: each.kind):
            contact, since = f"{switch.contact}, ", closed.get(switch.contact)
            if switch.kind is Kind.OPEN:
                if since is None:
                    yield place, "OPEN of a contact that is not closed", contact
                closed.pop(switch.contact, None)
                continue
            opens = Switch(switch.contact, Kind.OPEN) in event.switches
            if since not in (None, event.stamp) and not opens:
                yield place, "CLOSE or IMPACT of a closed contact", contact
            if switch.kind is Kind.CLOSE:
                closed[switch.contact] = event.stamp


def _contact_findings(
    topic: str, events: Sequence[ImpactEvent], system: System | RobotDescription
) -> Iterator[Finding]:
    """Contacts that are not the model's, and those of the model that are silent."""
    own = system.contact_names
    seen = dict.fromkeys(switch.contact for each in events for switch in each.switches)
    if unknown := [name for name in seen if name not in own]:
        severity = ERROR if len(unknown) == len(seen) else WARNING
        found = f"contacts that the model {system.name} does not have: {listed(unknown)}"
        remedy = "they are not applied; name the model with --model, or rename them"
        yield Finding(severity, topic, found, listed(own, joint=", "), remedy)
        if severity == ERROR:
            return
    if silent := [name for name in own if name not in seen]:
        found = f"contacts of the model {system.name} never reported: {listed(silent)}"
        yield Finding(WARNING, topic, found)


def _truth_findings(
    topic: str,
    truth: RecordedStates,
    events: Sequence[ImpactEvent],
    system: System | RobotDescription | None,
) -> Iterator[Finding]:
    """Coordinates that are not the model's, and stamps that do not cover the impacts."""
    if system is not None and truth.stamps.size and {*truth.names} != {*system.coordinates}:
        found = f"states of {listed(truth.names, joint=', ')}"
        wanted = f"the coordinates {listed(system.coordinates, joint=', ')} of {system.name}"
        yield Finding(WARNING, topic, found, wanted, "compare cannot use them")
    if not events or not truth.stamps.size:
        return
    begin, end = min(each.stamp for each in events), max(each.stamp for each in events)
    first, last = int(truth.stamps.min()), int(truth.stamps.max())
    step = (last - first) // max(truth.stamps.size - 1, 1)
    if not first - step <= begin <= end <= last + step:
        covered = f"the truth is from {text(first)} to {text(last)} s"
        found = f"{covered}, the impacts are from {text(begin)} to {text(end)} s"
        apart = end < first or last < begin
        remedy = f"{'nothing' if apart else 'only what is common'} can be compared"
        yield Finding(WARNING if apart else NOTE, topic, found, remedy=remedy)
