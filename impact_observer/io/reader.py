# SPDX-License-Identifier: Apache-2.0
"""Reading a bag: MCAP or sqlite3, a directory or a bare file.

Messages are streamed, and checked where they are used. Every failure is one line that names the
bag, what was found and what is expected.
"""

import struct
import sys
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeVar, cast, final

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError
from rosbags.typesys.store import Typestore

from impact_observer.errors import (
    BagError,
    ImpactObserverError,
    ModelError,
    UnfitBagError,
    UsageError,
)
from impact_observer.events import ImpactEstimate, ImpactEvent, Verdict
from impact_observer.input_files import check_input
from impact_observer.io import interfaces
from impact_observer.io.bag_files import (
    FROM_ROS_1,
    bag_files,
    has_end,
    recover_command,
    reindex_command,
    storage_of,
    views_in,
    write_whole,
)
from impact_observer.io.interfaces import Interface, Quality
from impact_observer.io.messages import (
    AnyMessage,
    MessageError,
    read_event,
    read_impact_estimate,
    read_stamp,
    read_verdict,
)
from impact_observer.io.state_arrays import (
    JointStates,
    ObserverStates,
    StateCollector,
    joined,
)
from impact_observer.io.typestores import (
    add_definition,
    begins_with_stamp,
    deserialize,
    new_typestore,
)
from impact_observer.model.yaml_text import load_yaml
from impact_observer.plain_text import say
from impact_observer.resources import read_text
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps

_Value = TypeVar("_Value")

_MOST_NESTED = 1000
"""Brackets, and letters of a line, up to which metadata cannot be nested too deeply."""
_WRONG_KIND = "rows without a whole log time (ns) and bytes"
_BLOCK = 1024
"""Most states in a block."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a bag.

    Attributes:
        name: the absolute name.
        type: the message type; several joined by `` and `` when publishers disagreed.
        count: messages.
        quality: the quality of service that was offered; None when the bag does not have it.
        definition: the text of the message type; empty when the bag does not have it.
    """

    name: str
    type: str
    count: int
    quality: Quality | None
    definition: str

    @classmethod
    def of(cls, topic: str, connections: Sequence[Connection]) -> "TopicInfo":
        """A topic with all its connections."""
        offers = [
            Quality.recorded(qos, interfaces.usual_quality(topic).depth)
            for connection in connections
            if isinstance(connection.ext, ConnectionExtRosbag2)
            for qos in connection.ext.offered_qos_profiles
        ]
        return cls(
            name=topic,
            type=" and ".join(sorted({connection.msgtype for connection in connections})),
            count=sum(connection.msgcount for connection in connections),
            quality=Quality.common(offers) if offers else None,
            definition=connections[0].msgdef.data,
        )


class RawMessage(NamedTuple):
    """A serialized message of a bag.

    Attributes:
        topic: the absolute name.
        log_time: time of recording, ns.
        data: the serialized message (CDR).
    """

    topic: str
    log_time: int
    data: bytes


@final
class BagReader:
    """A bag, open for reading; a context manager.

    Attributes:
        path: the folder or file.
        storage: ``mcap`` or ``sqlite3``.
        topics: by absolute name, also where the bag leaves out the first slash.
        start: log time of the first message, ns; 0 when the bag is empty.
        end: log time of the last message, ns; 0 when the bag is empty.
        message_count: messages on all topics.
        low: first stamp of the part that is read, ns; 0 for the whole bag.
        is_whole: whether the files have an end and the folder has metadata.yaml.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a bag.

        Args:
            path: a rosbag2 folder, or a bare ``.mcap`` or ``.db3`` file.

        Raises:
            UsageError: ``path`` does not exist.
            BagError: ``path`` is no bag, or a damaged bag.
        """
        self.path = Path(path)
        self._open = ExitStack()
        self.is_whole = True
        try:
            with self._translated():
                self.storage = storage_of(self.path)
                self._check_files()
                self._reader = self._open.enter_context(Reader(self._file_with_end()))
                self._read_topics()
        except BaseException:
            self.close()
            raise
        self._store: Typestore | None = None
        self._defined = set[str]()  # topics whose definitions the store has
        self.low = 0
        self._limits: tuple[int, int] | None = None
        self._received: frozenset[str] = frozenset()

    def _file_with_end(self) -> Path:
        """The bag, or a file with the messages of MCAP files without an end."""
        files = [each for each in bag_files(self.path) if each.suffix == ".mcap"]
        is_known = (self.path / "metadata.yaml").is_file()
        if not files or ((is_known or len(files) == 1) and all(map(has_end, files))):
            return self.path if is_known or not files else files[0]
        self.is_whole = False
        folder = self._open.enter_context(TemporaryDirectory(prefix="impact_observer_"))
        file = Path(folder) / files[0].name
        if not write_whole(files, file):
            raise BagError(f"{self.path}: has no end and no whole chunk; {self._recover}")
        lacks = "a file without an end" if len(files) == 1 else "files without metadata.yaml"
        say(f"warning: {self.path}: {lacks}, read up to the last whole chunk", file=sys.stderr)
        return file

    def _check_files(self) -> None:
        """Check that the files are regular ones.

        Metadata with aliases are checked to have an end when they are written out, and those with
        many brackets or a long line, which may be nested deeply, to be YAML: the library that
        reads them ends the process.
        """
        for file in bag_files(self.path):
            check_input(file)
            if file.suffix == ".db3" and (views := views_in(file)):  # which may have no end
                found = f"{file.name} has a view {views[0]}; expected tables alone"
                raise BagError(f"{self.path}: cannot be read as a bag: {found}")
        if (metadata := self.path / "metadata.yaml").is_file():
            text = read_text(metadata)
            brackets = text.count("[") + text.count("{")
            longest = max(map(len, text.splitlines()), default=0)
            if "&" in text or max(brackets, longest) > _MOST_NESTED:
                load_yaml(text)

    def _read_topics(self) -> None:
        """Read the topics and the extent of the bag that is open."""
        self._connections: dict[str, list[Connection]] = {}
        for topic in sorted(self._reader.topics, key=interfaces.absolute):
            own = self._connections.setdefault(interfaces.absolute(topic), [])
            own += self._reader.topics[topic].connections
        self.topics = {
            topic: TopicInfo.of(topic, connections)
            for topic, connections in self._connections.items()
        }
        # `ros2 bag convert` leaves qualities out of files that metadata.yaml has; rosbags
        # takes such a topic for another one unless it is given as the files have it, too.
        files = getattr(self._reader.storage, "storages", ())
        self._stored: list[Connection] = [each for file in files for each in file.connections]
        self.message_count = self._reader.message_count
        self.start = int(self._reader.start_time) if self.message_count > 0 else 0
        self.end = int(self._reader.end_time) - 1 if self.message_count > 0 else 0

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; closing twice does no harm."""
        self._open.close()

    @property
    def _reindex(self) -> str:
        """The remedy for a wrong metadata.yaml."""
        return f"`{reindex_command(self.path)}` writes it anew"

    @property
    def _recover(self) -> str:
        """The remedy for a damaged file."""
        return f"`{recover_command(self.path)}` writes what is left to a new file"

    @property
    def size(self) -> int:
        """Bytes on disk."""
        files = self.path.iterdir() if self.path.is_dir() else [self.path]
        return sum(file.stat().st_size for file in files)

    def find(self, wanted: Interface) -> str | None:
        """The topic of an interface: its absolute name, else the only one in a namespace.

        Returns:
            The absolute name; None when the bag has no such topic.

        Raises:
            BagError: several topics fit, none of them at the top.
        """
        candidates = wanted.candidates([*self.topics])
        if len(candidates) > 1:
            raise UnfitBagError(
                f"{self.path}: {' and '.join(candidates)} both fit {wanted.topic};"
                " expected a bag of the topics of one rig"
            )
        return candidates[0] if candidates else None

    def truth_topic(self) -> str | None:
        """The topic of the plant's true states; None when the bag has none.

        Raises:
            BagError: the bag has several plants.
        """
        return self.find(interfaces.PLANT_JOINT_STATES)

    def observers(self) -> tuple[str, ...]:
        """Prefixes of the observers in the bag, such as ``/observer_geometric``, sorted."""
        own = (interfaces.OBSERVER_STATES, interfaces.OBSERVER_JOINT_STATES)
        here = self.topics
        fitting = (topic for topic in here if any(each.fits(topic) for each in own))
        return tuple(sorted({topic.rpartition("/")[0] for topic in fitting}))

    def impact_topics(self) -> tuple[str, ...]:
        """Topics of estimates of impacts, of observers and of a smoother, sorted."""
        own = (interfaces.OBSERVER_IMPACTS, interfaces.SMOOTHED_ESTIMATES)
        here = self.topics
        return tuple(sorted(topic for topic in here if any(each.fits(topic) for each in own)))

    def raw(
        self,
        topics: Collection[str] | None = None,
        start: int = 0,
    ) -> Iterator[RawMessage]:
        """The serialized messages, in bag order, for copying and playing.

        Args:
            topics: only these absolute names; None for all.
            start: only messages logged at or after this stamp, ns.

        Raises:
            BagError: a topic is missing, or the bag is damaged.
        """
        wanted = self.topics if topics is None else topics
        for topic in wanted:
            self._topic(topic)
        return self._stream([c for topic in wanted for c in self._connections[topic]], start)

    def read_between(self, low: int, high: int, received: Collection[str] = ()) -> None:
        """Leave out, from now on, what is stamped before ``low`` or after ``high``, ns.

        The stamp is that of the header, or of a message without one the log time. Topics that
        make the rig known, ``interfaces.WHOLE``, are read whole.

        Args:
            low: first stamp, ns.
            high: last stamp, ns.
            received: topics whose stamp is the log time, whatever the headers say.
        """
        self.low, self._limits, self._received = low, (low, high), frozenset(received)

    @contextmanager
    def whole_bag(self) -> Iterator[None]:
        """Read the whole bag, whatever ``read_between`` leaves out, until the context ends."""
        limits, self._limits = self._limits, None
        try:
            yield
        finally:
            self._limits = limits

    def all_stamps(self, topics: Collection[str]) -> Iterator[int]:
        """Stamps (ns) of the messages of some topics, in bag order, as ``read_between`` has them.

        Raises:
            BagError: a topic is missing, or the bag is damaged.
        """
        stamp_of = {topic: self._stamp_reader(topic) for topic in topics}
        return (stamp_of[raw.topic](raw) for raw in self.raw(topics))

    def messages(self, topic: str) -> Iterator[tuple[int, AnyMessage]]:
        """Log times (ns) and messages of a topic whose type is defined here or in the bag.

        Raises:
            BagError: the topic is missing, its type is unknown, or the bag is damaged.
        """
        decode = self.decoder(topic)
        stream = self._stream(self._connections[topic])
        return ((log_time, decode(data)) for _, log_time, data in stream)

    def decoder(self, topic: str) -> Callable[[bytes], AnyMessage]:
        """A function that deserializes the messages of a topic.

        Raises:
            BagError: the topic is missing or its type is unknown. The function raises it, too,
                for bytes that are no message of that type.
        """
        info = self._topic(topic)
        store = self._store_for(info)

        def decode(data: bytes) -> AnyMessage:
            try:
                return deserialize(store, data, info.type)
            except Exception as error:  # rosbags raises errors of many types
                raise BagError(
                    f"{self.path}: {topic} has bytes that are no {info.type}: {_reason(error)}"
                ) from error

        return decode

    def events(self, topic: str = interfaces.IMPACTS.topic) -> Iterator[ImpactEvent]:
        """The events of a topic, in bag order.

        Raises:
            BagError: the topic is missing or of another type, or a message has no valid event.
        """
        return self._values(topic, interfaces.IMPACT_EVENT, read_event)

    def verdicts(self, topic: str) -> Iterator[Verdict]:
        """The verdicts of a topic, in bag order.

        Raises:
            BagError: the topic is missing or of another type, or a message has no valid verdict.
        """
        return (
            verdict for verdict, _ in self._values(topic, interfaces.EVENT_VERDICT, read_verdict)
        )

    def impact_estimates(self, topic: str) -> Iterator[ImpactEstimate]:
        """The estimates of impacts of a topic, in bag order.

        Raises:
            BagError: the topic is missing or of another type, or a message is not valid.
        """
        return self._values(topic, interfaces.IMPACT_ESTIMATE, read_impact_estimate)

    def blocks(
        self,
        topics: Collection[str],
        names: Sequence[str] | None = None,
        *,
        covariance: bool = False,
    ) -> Iterator[tuple[str, JointStates]]:
        """The states on some topics in one pass, each topic's in bag order, a block at a time.

        Args:
            topics: absolute names, of joint states or of an observer's states.
            names: names of the columns; None for the names in each topic's first message.
            covariance: whether estimates are wanted with theirs.

        Yields:
            A topic and its next states, at most 1024 of them, an observer's as
            ``ObserverStates``. The last block of each topic may be empty.

        Raises:
            BagError: a topic is missing or of another type; a name is missing, unexpected or
                twice; a message has no finite position and velocity for each name; a law changes.
        """
        collectors = {topic: self._collector(topic, names, covariance) for topic in topics}
        decoders = {topic: self.decoder(topic) for topic in topics}
        for topic, _, data in self._stream([c for t in decoders for c in self._connections[t]]):
            collectors[topic].append(decoders[topic](data))
            if len(collectors[topic]) == _BLOCK:
                yield topic, collectors[topic].take()
        for topic, collector in collectors.items():
            yield topic, collector.take()

    def stamps(self, topic: str) -> Stamps:
        """The stamps of all joint states of a topic, ns, in bag order.

        Raises:
            BagError: the topic is missing or of another type, or a stamp is not valid.
        """
        stamps = self._values(
            topic,
            interfaces.JOINT_STATE,
            lambda message: read_stamp("JointState.header.stamp", message.header.stamp),
        )
        return np.fromiter(stamps, dtype=np.int64)

    def joint_states(self, topic: str, names: Sequence[str] | None = None) -> JointStates:
        """All states of a topic of joint states; arguments and errors as of :meth:`blocks`."""
        self._check_type(topic, interfaces.JOINT_STATE)
        return joined(block for _, block in self.blocks([topic], names))

    def observer_states(self, topic: str, names: Sequence[str] | None = None) -> ObserverStates:
        """All estimates on a topic such as ``/observer/state``; arguments as above."""
        self._check_type(topic, interfaces.OBSERVER_STATE)
        return cast("ObserverStates", joined(block for _, block in self.blocks([topic], names)))

    def _collector(
        self, topic: str, names: Sequence[str] | None, covariance: bool
    ) -> StateCollector:
        """Returns the collector of the states of a topic."""
        estimates = self._topic(topic).type == interfaces.OBSERVER_STATE
        self._check_type(topic, interfaces.OBSERVER_STATE if estimates else interfaces.JOINT_STATE)
        source = f"{self.path}: {topic}"
        return StateCollector(source, names, estimates=estimates, covariance=covariance)

    def _check_type(self, topic: str, wanted: str) -> None:
        """Check the type of a topic."""
        if (type_name := self._topic(topic).type) != wanted:
            raise UnfitBagError(f"{self.path}: {topic} is {type_name}; expected {wanted}")

    def model_text(self) -> str | None:
        """The text of the last model published in the bag; None without a model.

        Raises:
            BagError: several plants published a model, or the topic has another type.
        """
        if (topic := self.find(interfaces.PLANT_MODEL)) is None:
            return None
        texts = deque(self._values(topic, interfaces.STRING, attrgetter("data")), maxlen=1)
        return texts[0] if texts else None

    def _topic(self, topic: str) -> TopicInfo:
        """A topic, checked to be in the bag."""
        if topic not in self.topics:
            in_bag = ", ".join(self.topics) or "none"
            raise UnfitBagError(f"{self.path}: no topic {topic}; topics in the bag: {in_bag}")
        return self.topics[topic]

    def _values(
        self, topic: str, type_name: str, read: Callable[[AnyMessage], _Value]
    ) -> Iterator[_Value]:
        """The messages of a topic of the given type, each converted by ``read``."""
        self._check_type(topic, type_name)
        messages = self.messages(topic)

        def values() -> Iterator[_Value]:
            position = 0
            try:
                for position, (_, message) in enumerate(messages):  # noqa: B007 (for the error)
                    yield read(message)
            except MessageError as error:
                raise BagError(f"{self.path}: {topic}, message {position}: {error}") from error

        return values()

    def _store_for(self, info: TopicInfo) -> Typestore:
        """A typestore with the type of a topic."""
        if self._store is None:
            self._store = new_typestore()
        store, topic, type_name = self._store, info.name, info.type
        try:
            if info.definition and topic not in self._defined:
                add_definition(store, info.definition, type_name)
                self._defined.add(topic)
        except BagError as error:
            raise BagError(
                f"{self.path}: {topic}: {error}; read it with the version that made it"
            ) from error
        if type_name not in store.fielddefs:
            raise BagError(
                f"{self.path}: {topic} is {type_name}, which neither this package nor the bag "
                "defines; expected a bag with message definitions, as MCAP and Jazzy write them"
            )
        return store

    def _stream(
        self,
        connections: Collection[Connection],
        start: int = 0,
    ) -> Iterator[RawMessage]:
        """Yields the messages of some connections in bag order; checks that none is missing."""
        if not connections:
            return
        count = 0
        names = {each.topic: interfaces.absolute(each.topic) for each in connections}
        low, high = self._limits or (0, 0)
        stamp_of = {
            topic: self._stamp_reader(topic)
            for topic in (names.values() if self._limits else ())
            if interfaces.interface(topic) not in interfaces.WHOLE
        }
        stored = (each for each in self._stored if each.topic in names)
        known = [*connections, *stored]
        with self._translated():
            for own, log_time, data in self._reader.messages(known, start=start or None):
                count += 1
                if type(log_time) is not int or type(data) is not bytes:  # of sqlite, any type
                    raise BagError(f"{self.path}: {own.topic} has {_WRONG_KIND}")
                raw = RawMessage(names[own.topic], log_time, data)
                if raw.topic in stamp_of and not low <= stamp_of[raw.topic](raw) <= high:
                    continue
                yield raw
        expected = sum(connection.msgcount for connection in connections)
        if count < expected and not start:
            raise BagError(
                f"{self.path}: {count} messages found, {expected} promised by its index; "
                + self._recover
            )

    def _stamp_reader(self, topic: str) -> Callable[[RawMessage], int]:
        """A function that gives the stamp (ns) of a message of a topic."""
        has_header = topic not in self._received
        if has_header:
            try:
                info = self._topic(topic)
                has_header = begins_with_stamp(self._store_for(info), info.type)
            except BagError:  # no definition: the message can only be copied
                has_header = False
        return _stamp_in if has_header else attrgetter("log_time")

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Report an error of ``rosbags`` for a damaged bag as one line."""
        try:
            yield
        except ModelError as error:
            raise BagError(f"{self.path}: its metadata.yaml: {error}; {self._reindex}") from None
        except ImpactObserverError:
            raise
        except Exception as error:  # anything, in a damaged file
            reason = _reason(error)
            remedy = self._recover
            if "files are missing" in reason:
                remedy = f"move them back, or {self._reindex}"
            elif "Profile is not ros2" in reason:
                remedy = f"{FROM_ROS_1}; other messages: a table, for `import` or `detect`"
            raise BagError(f"{self.path}: cannot be read as a bag: {reason}; {remedy}") from error


def _stamp_in(raw: RawMessage) -> int:
    """The stamp with which a serialized message begins, ns; its log time if that is 0."""
    if len(raw.data) < 12:
        return raw.log_time
    seconds, part = struct.unpack_from("<iI" if raw.data[1] else ">iI", raw.data, 4)
    return int(seconds * NS_PER_S + part) or raw.log_time


def _reason(error: BaseException) -> str:
    """The text of an error of ``rosbags`` or the system, as one line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    line = " ".join(str(error).split()).rstrip(".")
    of_rosbags = isinstance(error, (ReaderError, SerdeError, TypesysError))
    return line if of_rosbags else f"{type(error).__name__}: {line}"


def named_topic(reader: BagReader, name: str) -> str:
    """The absolute name of a topic, given with or without its first slash.

    Raises:
        UsageError: the bag has no such topic.
    """
    topic = interfaces.absolute(name)
    if topic not in reader.topics:
        in_bag = ", ".join(reader.topics) or "none"
        raise UsageError(f"{reader.path}: no topic or observer {topic}; in the bag: {in_bag}")
    return topic


def named_states(reader: BagReader, name: str) -> str:
    """The topic of states of the observer or topic ``name``.

    Raises:
        UsageError: the bag has neither.
    """
    prefix = interfaces.absolute(name)
    return states_of(reader, prefix) if prefix in reader.observers() else named_topic(reader, name)


def states_of(reader: BagReader, prefix: str) -> str:
    """The topic of an observer's states, or of its joint states if no states are recorded."""
    state = f"{prefix}/state"
    return state if state in reader.topics else f"{prefix}/joint_states"


def first_stamp(reader: BagReader, topics: Iterable[str]) -> int | None:
    """The first stamp, ns, in the first topic with a state; None without a state."""
    first = first_block(reader, topics)
    return None if first is None else int(first.stamps[0])


def first_block(reader: BagReader, topics: Iterable[str]) -> JointStates | None:
    """The first states in the first topic with a state; None without a state."""
    blocks = (next(iter(reader.blocks([topic])))[1] for topic in topics)
    return next((block for block in blocks if block.stamps.size), None)
