"""Whether an observer can use a bag, and what is wrong with it: one pass in constant memory."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import cast

from impact_observer.check.event_checks import EventCheck
from impact_observer.check.findings import (
    ERROR,
    NOTE,
    WARNING,
    Finding,
    gravest_first,
    listed,
    times,
)
from impact_observer.check.salvage import Salvage, summary
from impact_observer.check.state_checks import StateCheck
from impact_observer.errors import BagError, ModelError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface
from impact_observer.io.messages import EventMessage, MessageError, StringMessage, read_event
from impact_observer.io.reader import BagReader, RawMessage, TopicInfo
from impact_observer.io.typestores import add_definition, deserialize, new_typestore
from impact_observer.model import System, parse_model
from impact_observer.stamps import text

_WANTED = (interfaces.IMPACTS, interfaces.PLANT_JOINT_STATES, interfaces.PLANT_MODEL)
_MOST = 5
"""Losses and sensors of a bag that have a line of their own."""
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
    "std_msgs/msg/Header": ("a message a hit", ""),
}
"""What ``detect`` makes impacts of: what such a topic looks like, and what it must be told."""


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a check.

    Attributes:
        path: the bag.
        readable: whether all of it can be read as it is.
        counts: messages of each topic that can be read.
        findings: the gravest first.
    """

    path: Path
    readable: bool
    counts: Mapping[str, int]
    findings: list[Finding] = field(default_factory=list)

    @property
    def usable(self) -> bool:
        """Whether an observer can use the bag."""
        return all(each.severity != ERROR for each in self.findings)


def check_bag(
    path: Path,
    system: System | None = None,
    *,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Report:
    """Check a bag, however broken it is.

    Args:
        path: a rosbag2 folder, or a bare file.
        system: of the model that the user names; None for the one in the bag.
        progress: told how much was done and how much there is to do.

    Raises:
        UsageError: there is nothing at ``path``.
    """
    try:
        with BagReader(path) as reader:
            checker = Checker(path, system)
            for done, raw in enumerate(reader.raw()):
                checker.hear(reader.topics[raw.topic], raw)
                progress(done, reader.message_count)
            own = checker.findings(reader.topics)
            return Report(path, True, checker.counts, gravest_first([*_leftovers(path), *own]))
    except BagError as error:
        trouble = _trouble(error, path)
    source, checker = Salvage(path), Checker(path, system)
    for raw in source.raw(progress):
        checker.hear(source.topics[raw.topic], raw)
    found = [*_damage(source, trouble), *_leftovers(path)]
    if source.counts:
        found += checker.findings(source.topics)
    return Report(path, False, checker.counts, gravest_first(found))


class Checker:
    """Listens to all messages of a bag.

    Attributes:
        counts: messages of each topic so far.
    """

    def __init__(self, path: Path, system: System | None) -> None:
        """Check the bag at ``path`` against a ``system``, or against that of its own model."""
        self.counts: Counter[str] = Counter()
        self._path = path
        self._system = system
        self._store = new_typestore()
        self._listeners: dict[str, Callable[[RawMessage], None]] = {}
        self._events: dict[str, EventCheck] = {}
        self._states: dict[str, StateCheck] = {}
        self._models: dict[str, str] = {}
        self._complaints: list[Finding] = []

    def hear(self, info: TopicInfo, raw: RawMessage) -> None:
        """One more message, and what the bag says of its topic."""
        self.counts[raw.topic] += 1
        listener = self._listeners.get(raw.topic)
        if listener is None:
            listener = self._listeners[raw.topic] = self._listener(info)
        listener(raw)

    def findings(self, topics: Mapping[str, TopicInfo]) -> Iterator[Finding]:
        """What is wrong, when all was heard; ``topics`` with those without a message."""
        yield from self._complaints
        system, used = self._system, {}
        for wanted in _WANTED:
            topic, about = _chosen(topics, wanted)
            yield from about
            used[wanted.name] = topic
        impacts, truth, model = (used[each.name] for each in _WANTED)
        if system is None:
            system, about = self._carried(model)
            yield from about
        if impacts is None:
            yield from self._without_impacts(topics)
            events = None
        else:
            check = self._events.get(impacts) or EventCheck(impacts)
            if not self._refused(impacts):
                yield from check.findings(system)
            events = (check.first, check.last) if check.valid else None
        if truth is not None and truth in self._states:
            yield from self._states[truth].findings(system, events)
        elif truth is None:
            yield Finding(
                NOTE,
                self._name,
                f"carries no truth ({interfaces.PLANT_JOINT_STATES.topic})",
                remedy="observe needs --rate, and there is nothing to compare with",
            )
        yield from self._unknown_types(topics)

    @property
    def _name(self) -> str:
        return _named(self._path)

    def _refused(self, topic: str) -> bool:
        return any(each.thing == topic for each in self._complaints)

    def _listener(self, info: TopicInfo) -> Callable[[RawMessage], None]:
        """What listens to a topic, at its first message."""
        topic = info.name
        wanted = next((each for each in _WANTED if each.fits(topic)), None)
        if wanted is None or info.type != wanted.type:
            return _ignore
        if (complaint := self._definition_fault(info)) is not None:
            self._complaints.append(complaint)
            return _ignore

        def message(data: bytes) -> object:
            return self._deserialized(info.type, data)

        if wanted is interfaces.PLANT_JOINT_STATES:
            states = self._states[topic] = StateCheck(topic, message)
            return lambda raw: states.hear(raw.data)
        if wanted is interfaces.PLANT_MODEL:
            return lambda raw: self._hear_model(topic, raw.data)
        events = self._events[topic] = EventCheck(topic)
        return lambda raw: self._hear_event(events, raw)

    def _definition_fault(self, info: TopicInfo) -> Finding | None:
        """What is wrong with the message definition that a bag brings."""
        try:
            differs = info.definition and add_definition(self._store, info.definition, info.type)
        except BagError as error:
            return Finding(ERROR, info.name, str(error), remedy="record again")
        if not differs:
            return None
        return Finding(
            ERROR,
            info.name,
            f"the bag defines {info.type} otherwise than this package",
            "the same fields",
            "read it with the version that made it",
        )

    def _deserialized(self, kind: str, data: bytes) -> object:
        try:
            return deserialize(self._store, data, kind)
        except Exception as error:
            raise BagError(f"bytes that are no {kind}") from error

    def _hear_event(self, check: EventCheck, raw: RawMessage) -> None:
        try:
            message = self._deserialized(interfaces.IMPACT_EVENT, raw.data)
            event = read_event(cast("EventMessage", message))
        except BagError as error:
            check.refuse(str(error))
        except MessageError as error:
            check.refuse(str(error))
        else:
            check.hear(event, raw.log_time)

    def _hear_model(self, topic: str, data: bytes) -> None:
        """Keep the last model that was published; bytes that are none are an invalid one."""
        try:
            message = self._deserialized(interfaces.STRING, data)
            self._models[topic] = cast("StringMessage", message).data
        except BagError as error:
            self._models[topic] = f"({error})"

    def _carried(self, topic: str | None) -> tuple[System | None, list[Finding]]:
        """The system of the bag's own model, and what is wrong with it."""
        carried = self._models.get(topic or "")
        if carried is None:
            return None, [
                Finding(
                    WARNING,
                    self._name,
                    f"carries no model ({interfaces.PLANT_MODEL.topic})",
                    remedy="name one with --model MODEL; contacts and epoch are checked then",
                )
            ]
        try:
            return parse_model(carried, "model").system, []
        except ModelError as error:
            return None, [
                Finding(
                    WARNING,
                    topic or "",
                    f"the model it carries is not valid ({error})",
                    remedy="name one with --model MODEL",
                )
            ]

    def _without_impacts(self, topics: Mapping[str, TopicInfo]) -> Iterator[Finding]:
        """No impacts: what they could be made of."""
        fitting = [topic for topic in topics if interfaces.IMPACTS.fits(topic)]
        if fitting:
            return
        others = [t for t, info in topics.items() if info.type == interfaces.IMPACT_EVENT]
        sensors = [info for info in topics.values() if info.type in _SENSORS]
        remedy = "a table of impact times becomes a bag with `impact-observer import CSV -o BAG`"
        if sensors:
            remedy = "detect can make them of its sensors"
        if others:
            remedy = f"play the bag with {others[0]} as /impacts, and record that"
        yield Finding(
            ERROR,
            self._name,
            f"no impacts; topics in the bag: {listed(topics)}",
            f"{interfaces.IMPACT_EVENT} on {interfaces.IMPACTS.topic}",
            remedy,
        )
        for info in [] if others else sensors[:_MOST]:
            what, options = _SENSORS[info.type]
            yield Finding(
                NOTE,
                info.name,
                f"{info.type} looks like {what}",
                remedy=f"impact-observer detect {quote(str(self._path))} --contact NAME"
                f" --topic {info.name}{options} -o NEW",
            )

    def _unknown_types(self, topics: Mapping[str, TopicInfo]) -> Iterator[Finding]:
        """Topics that can only be copied."""
        unknown = [
            f"{info.name} ({info.type})"
            for info in topics.values()
            if not info.definition and info.type not in self._store.fielddefs
        ]
        if unknown:
            yield Finding(
                NOTE,
                self._name,
                f"no definition of the messages on {listed(unknown)}",
                remedy="they can be copied and played, not read; MCAP and Jazzy bags have"
                " definitions",
            )


def _ignore(_raw: RawMessage) -> None:
    """A topic that is none of ours."""


def _chosen(
    topics: Mapping[str, TopicInfo], wanted: Interface
) -> tuple[str | None, list[Finding]]:
    """The topic that is used for an interface, as ``BagReader.find``, and what is wrong."""
    fitting = sorted(topic for topic in topics if wanted.fits(topic))
    if not fitting:
        return None, []
    if len(fitting) > 1 and wanted.topic not in fitting:
        fault = Finding(
            ERROR,
            " and ".join(fitting),
            f"several topics fit {wanted.topic}",
            "one of them",
            "record one only, or play the bag with one as " + wanted.topic,
        )
        return None, [fault]
    topic = wanted.topic if wanted.topic in fitting else fitting[0]
    others = [each for each in fitting if each != topic]
    about = []
    if others:
        about.append(Finding(NOTE, listed(others), f"not used; {topic} is"))
    if (found := topics[topic].type) != wanted.type:
        remedy = "" if found not in _SENSORS else "detect makes impacts of such a topic"
        about.append(Finding(ERROR, topic, f"is {found}", wanted.type, remedy))
        return None, about
    return topic, about


def _damage(source: Salvage, trouble: str) -> Iterator[Finding]:
    """What is wrong with the files, and what can still be read."""
    name, path = _named(source.path), quote(str(source.path))
    again = f"impact-observer check {path} --salvage -o NEW"
    if not source.counts:
        yield Finding(ERROR, name, trouble, remedy=f"nothing can be read: {summary(source)}")
        return
    seems = "" if source.losses else "nothing seems to be lost; "
    yield Finding(
        ERROR,
        name,
        trouble,
        remedy=f"{seems}{summary(source)}, can be read: write them to a new bag with `{again}`",
    )
    for loss in source.losses[:_MOST]:
        file, _, what = loss.partition(": ")
        yield Finding(WARNING, file, what)
    if (more := len(source.losses) - _MOST) > 0:
        yield Finding(WARNING, name, f"{more} more places are damaged")
    for topic, count in sorted(source.counts.items()):
        until = text(source.last[topic])
        yield Finding(NOTE, topic, f"{times(count, 'message')} can be read, up to {until} s")


def _leftovers(path: Path) -> Iterator[Finding]:
    """Journals that a recorder left which did not end well: nobody reads them."""
    folder = path if path.is_dir() else path.parent
    own = "*.db3" if path.is_dir() else path.name
    for journal in sorted(folder.glob(f"{own}-wal")):
        if journal.stat().st_size:
            database = journal.with_name(journal.name.removesuffix("-wal"))
            yield Finding(
                WARNING,
                journal.name,
                f"{journal.stat().st_size} bytes that are not in the database yet",
                remedy=f"put them in: sqlite3 {quote(str(database))}"
                " 'PRAGMA wal_checkpoint(TRUNCATE)'",
            )


def _trouble(error: BagError, path: Path) -> str:
    """What the reader says of a bag, without its name and remedy."""
    return str(error).removeprefix(f"{path}: ").partition("; ")[0]


def _named(path: Path) -> str:
    """A bag's name."""
    return path.name or str(path)
