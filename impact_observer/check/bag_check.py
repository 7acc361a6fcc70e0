# SPDX-License-Identifier: Apache-2.0
"""Whether an observer can use a bag, and what is wrong with the bag, in one pass."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from shlex import quote

from impact_observer.check.bag_report import Report
from impact_observer.check.event_checks import EventCheck
from impact_observer.check.findings import (
    ERROR,
    NOTE,
    SEVERITIES,
    WARNING,
    Finding,
)
from impact_observer.check.salvage import Salvage, summary
from impact_observer.check.state_checks import StateCheck
from impact_observer.draw.reports import counted, listed
from impact_observer.errors import BagError, ModelError
from impact_observer.input_files import open_input
from impact_observer.io import interfaces
from impact_observer.io.bag_topics import TopicInfo
from impact_observer.io.foreign_files import foreign_file, foreign_messages
from impact_observer.io.interfaces import Interface
from impact_observer.io.mcap_checksums import (
    chunks_without_checksum,
    data_are_damaged,
    mcap_files,
)
from impact_observer.io.messages import AnyMessage, MessageError, read_event
from impact_observer.io.reader import BagReader, RawMessage
from impact_observer.io.recordings import INTEGRATOR
from impact_observer.io.typestores import add_definition, deserialize, new_typestore
from impact_observer.model import System, parse_model
from impact_observer.model.robot_description import RobotDescription
from impact_observer.stamps import text

_INTERFACES = (interfaces.IMPACTS, interfaces.PLANT_JOINT_STATES, interfaces.PLANT_MODEL)
_MOST = 5
"""Most losses that have a line of their own."""
_SENSORS = {
    "std_msgs/msg/Bool": ("a switch", ""),
    "sensor_msgs/msg/Imu": ("an accelerometer", " --threshold N"),
    "geometry_msgs/msg/WrenchStamped": ("a force", " --field wrench.force.z --threshold N"),
    "geometry_msgs/msg/Wrench": ("a force", " --field force.z --threshold N"),
    "geometry_msgs/msg/AccelStamped": (
        "an accelerometer",
        " --field accel.linear.z --threshold N",
    ),
    "std_msgs/msg/Float64": ("a force or another signal", " --field data --threshold N"),
    "std_msgs/msg/Float32": ("a force or another signal", " --field data --threshold N"),
    "std_msgs/msg/Empty": ("a message a hit", ""),
    "std_msgs/msg/Header": ("a message a hit, or a turn of a drive (detect --pulses)", ""),
}
"""Message types that ``detect`` reads: the kind of sensor, and the options of ``detect``."""


def check_bag(
    path: Path,
    system: System | RobotDescription | None = None,
    *,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Report:
    """Check a bag, damaged or not.

    Args:
        path: a rosbag2 folder, or a bare file.
        system: system of the user's model; None for the model in the bag.
        progress: called with the work done and the whole work.

    Raises:
        UsageError: ``path`` does not exist.
    """
    try:
        with BagReader(path) as reader:
            check = BagCheck(path, system)
            for done, raw in enumerate(reader.raw()):
                check.check_message(reader.topics[raw.topic], raw)
                progress(done, reader.message_count)
            found = [*_journals(path), *_checksums(path), *check.findings(reader.topics)]
            return _report(path, check, found)
    except BagError as error:
        foreign = foreign_file(path) or foreign_messages(path)
        if foreign is not None:
            finding = Finding(ERROR, _bag_name(path), foreign.found, remedy=foreign.remedy)
            return Report(path, False, {}, [finding])
        reason = str(error).removeprefix(f"{path}: ").partition("; ")[0]
    source, check = Salvage(path), BagCheck(path, system)
    for raw in source.raw(progress):
        check.check_message(source.topics[raw.topic], raw)
    findings = [*_damage(source, reason), *_journals(path)]
    if source.counts:
        findings += check.findings(source.topics)
    return _report(path, check, findings, readable=False)


def _report(
    path: Path, check: "BagCheck", findings: list[Finding], *, readable: bool = True
) -> Report:
    findings.sort(key=lambda each: SEVERITIES.index(each.severity))
    return Report(path, readable, check.counts, findings)


class BagCheck:
    """Checks all messages of a bag.

    Attributes:
        counts: messages of each topic so far.
    """

    def __init__(self, path: Path, system: System | RobotDescription | None) -> None:
        """Check the bag at ``path`` against ``system``, or against the model in the bag."""
        self.counts: Counter[str] = Counter()
        self._path, self._name = path, _bag_name(path)
        self._system = system
        self._store = new_typestore()
        self._checks: dict[str, Callable[[RawMessage], None] | None] = {}
        self._events: dict[str, EventCheck] = {}
        self._states: dict[str, StateCheck] = {}
        self._models: dict[str, str] = {}
        self._wrong_definitions: dict[str, Finding] = {}

    def check_message(self, info: TopicInfo, raw: RawMessage) -> None:
        """Check a message of the topic ``info``."""
        self.counts[raw.topic] += 1
        if raw.topic not in self._checks:
            self._checks[raw.topic] = self._check_for(info)
        if (check := self._checks[raw.topic]) is not None:
            check(raw)

    def _check_for(self, info: TopicInfo) -> Callable[[RawMessage], None] | None:
        """The check for the messages of a topic; None if the type of the topic has no check."""
        topic = info.name
        own = next((each for each in _INTERFACES if each.fits(topic)), None)
        if own is None or info.type != own.type:
            return None
        if (finding := self._wrong_definition(info)) is not None:
            self._wrong_definitions[topic] = finding
            return None
        if own is interfaces.PLANT_JOINT_STATES:
            states = StateCheck(topic, partial(self._deserialized, info.type))
            self._states[topic] = states
            return states.check_message
        if own is interfaces.PLANT_MODEL:
            return self._keep_model
        self._events[topic] = EventCheck(topic)
        return self._check_event

    def _wrong_definition(self, info: TopicInfo) -> Finding | None:
        """The fault of a message definition in the bag; None if its fields are right."""
        try:
            differs = info.definition and add_definition(self._store, info.definition, info.type)
        except BagError as error:
            return Finding(ERROR, info.name, str(error), remedy="record again")
        if not differs:
            return None
        fault = f"the bag defines {info.type} otherwise than this package"
        remedy = "read it with the version that made it"
        return Finding(ERROR, info.name, fault, "the same fields", remedy)

    def _deserialized(self, kind: str, data: bytes) -> AnyMessage:
        try:
            return deserialize(self._store, data, kind)
        except Exception as error:
            raise BagError(f"bytes that are no {kind}") from error

    def _check_event(self, raw: RawMessage) -> None:
        check = self._events[raw.topic]
        try:
            event = read_event(self._deserialized(interfaces.IMPACT_EVENT, raw.data))
            check.check_event(event, raw.log_time)
        except (BagError, MessageError) as error:
            check.count_invalid(str(error))

    def _keep_model(self, raw: RawMessage) -> None:
        """Keep the last published model; unreadable bytes count as an invalid model."""
        try:
            self._models[raw.topic] = self._deserialized(interfaces.STRING, raw.data).data
        except BagError as error:
            self._models[raw.topic] = f"({error})"

    def findings(self, topics: Mapping[str, TopicInfo]) -> Iterator[Finding]:
        """The findings; ``topics`` includes topics without a message."""
        yield from self._wrong_definitions.values()
        used = {}
        for own in _INTERFACES:
            used[own], faults = _checked_topic(own, topics)
            yield from faults
        system = self._system
        if system is None:
            system, faults = self._model_in_bag(used[interfaces.PLANT_MODEL])
            yield from faults
        impacts, span = used[interfaces.IMPACTS], None
        if impacts is None:
            yield from self._no_impacts(topics)
        else:
            events = self._events.get(impacts, EventCheck(impacts))
            if impacts not in self._wrong_definitions:
                simulated = self._is_simulated(used[interfaces.PLANT_MODEL])
                yield from events.findings(system, simulated=simulated)
            span = (events.first, events.last) if events.valid else None
        truth = used[interfaces.PLANT_JOINT_STATES]
        if truth is None:
            fault = f"carries no truth ({interfaces.PLANT_JOINT_STATES.topic})"
            remedy = "observe needs --rate, and there is nothing to compare with"
            yield Finding(NOTE, self._name, fault, remedy=remedy)
        elif truth in self._states:
            yield from self._states[truth].findings(system, span)
        yield from self._undefined_types(topics)

    def _model_in_bag(
        self, topic: str | None
    ) -> tuple[System | RobotDescription | None, list[Finding]]:
        """The system or robot of the model in the bag, and the faults of that model."""
        remedy = "name one with --model MODEL"
        if (model := self._models.get(topic or "")) is None:
            fault = f"carries no model ({interfaces.PLANT_MODEL.topic})"
            remedy += "; contacts and epoch are checked then"
            return None, [Finding(WARNING, self._name, fault, remedy=remedy)]
        try:
            return parse_model(model, "model").subject, []
        except ModelError as error:
            fault = f"the model it carries is not valid ({error})"
            return None, [Finding(WARNING, topic or "", fault, remedy=remedy)]

    def _is_simulated(self, topic: str | None) -> bool:
        """Whether the model in the bag was published by a simulated plant."""
        try:
            return INTEGRATOR in parse_model(self._models.get(topic or "", ""), "").provenance
        except ModelError:
            return False

    def _no_impacts(self, topics: Mapping[str, TopicInfo]) -> Iterator[Finding]:
        """An error for a bag without impacts, with the topics that may yield impacts."""
        if any(interfaces.IMPACTS.fits(topic) for topic in topics):
            return
        others = [t for t, info in topics.items() if info.type == interfaces.IMPACT_EVENT]
        sensors = [
            info
            for info in topics.values()
            if info.type in _SENSORS and not interfaces.PHASE_REFERENCE.fits(info.name)
        ]
        remedy = "a table of impact times becomes a bag with `impact-observer import CSV -o BAG`"
        if others:
            remedy = f"play the bag with {others[0]} as /impacts, and record that"
        elif sensors:
            remedy = "detect can make them of its sensors"
        fault = f"no impacts; topics in the bag: {listed(topics, joint=', ')}"
        wanted = f"{interfaces.IMPACT_EVENT} on {interfaces.IMPACTS.topic}"
        yield Finding(ERROR, self._name, fault, wanted, remedy)
        detect = f"impact-observer detect {quote(str(self._path))} --contact NAME --topic"
        for info in [] if others else sensors:
            what, options = _SENSORS[info.type]
            remedy = f"{detect} {info.name}{options} -o NEW"
            yield Finding(NOTE, info.name, f"{info.type} looks like {what}", remedy=remedy)

    def _undefined_types(self, topics: Mapping[str, TopicInfo]) -> Iterator[Finding]:
        undefined = [
            f"{info.name} ({info.type})"
            for info in topics.values()
            if not info.definition and info.type not in self._store.fielddefs
        ]
        if undefined:
            fault = f"no definition of the messages on {listed(undefined, joint=', ')}"
            remedy = (
                "they can be copied and played, not read; MCAP and Jazzy bags have definitions"
            )
            yield Finding(NOTE, self._name, fault, remedy=remedy)


def _checked_topic(
    own: Interface, topics: Mapping[str, TopicInfo]
) -> tuple[str | None, list[Finding]]:
    """The topic of an interface, and its faults."""
    candidates = own.candidates(topics)
    if not candidates:
        return None, []
    if len(candidates) > 1:
        fault = f"several topics fit {own.topic}"
        remedy = f"record one only, or play the bag with one as {own.topic}"
        return None, [Finding(ERROR, " and ".join(candidates), fault, "one of them", remedy)]
    topic = candidates[0]
    others = sorted(each for each in topics if own.fits(each) and each != topic)
    notes = [Finding(NOTE, listed(others, joint=", "), f"not used; {topic} is")] if others else []
    if (kind := topics[topic].type) != own.type:
        remedy = "detect makes impacts of such a topic" if kind in _SENSORS else ""
        return None, [*notes, Finding(ERROR, topic, f"is {kind}", own.type, remedy)]
    return topic, notes


def _damage(source: Salvage, reason: str) -> Iterator[Finding]:
    """The reason why a bag cannot be read as a whole, and its readable part."""
    name = _bag_name(source.path)
    if not source.counts:
        yield Finding(ERROR, name, reason, remedy=f"nothing can be read: {summary(source)}")
        return
    complete = "" if source.losses else "nothing seems to be lost; "
    command = f"impact-observer check {quote(str(source.path))} --salvage -o NEW"
    remedy = f"{summary(source)}, can be read: write them to a new bag with `{command}`"
    yield Finding(ERROR, name, reason, remedy=f"{complete}{remedy}")
    for loss in source.losses[:_MOST]:
        file, _, what = loss.partition(": ")
        yield Finding(WARNING, file, what)
    if (more := len(source.losses) - _MOST) > 0:
        yield Finding(WARNING, name, f"{more} more places are damaged")
    for topic, count in sorted(source.counts.items()):
        until = text(source.last[topic])
        yield Finding(NOTE, topic, f"{counted(count, 'message')} can be read, up to {until} s")


def _journals(path: Path) -> Iterator[Finding]:
    """Journals of sqlite3 that a recorder left when it was killed: no reader uses them."""
    folder, files = (path, "*.db3") if path.is_dir() else (path.parent, path.name)
    for journal in sorted(folder.glob(f"{files}-wal")):
        if size := journal.stat().st_size:
            fault = f"{size} bytes that are not in the database yet"
            database = quote(str(journal.with_name(journal.name.removesuffix("-wal"))))
            remedy = f"put them in: sqlite3 {database} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            yield Finding(WARNING, journal.name, fault, remedy=remedy)


def _checksums(path: Path) -> Iterator[Finding]:
    """What the checksums of MCAP files say of a bag that can be read as a whole."""
    for file in mcap_files(path):
        with open_input(file) as stream:
            chunks, unchecked = chunks_without_checksum(stream)
            damaged = data_are_damaged(stream)
        if damaged and unchecked < chunks:
            fault = "does not match its checksum; the chunks with the messages match theirs"
            yield Finding(WARNING, file.name, fault, remedy="copy the file again")
        elif damaged:
            fault = "does not match its checksum; any message may be wrong"
            yield Finding(ERROR, file.name, fault, remedy="copy the file again")
        if unchecked:
            fault = f"{unchecked} of {counted(chunks, 'chunk')} without a checksum"
            remedy = "flipped bits in messages go unnoticed"
            yield Finding(NOTE, file.name, fault, remedy=remedy)


def _bag_name(path: Path) -> str:
    return path.name or str(path)
