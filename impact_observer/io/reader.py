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
from functools import partial
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeVar, final

from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from impact_observer.errors import BagError, ImpactObserverError, ModelError, UnfitBagError
from impact_observer.events import ImpactEstimate, ImpactEvent, Verdict
from impact_observer.io import interfaces
from impact_observer.io.bag_files import (
    FROM_ROS_1,
    checked_files,
    has_end,
    recover_command,
    reindex_command,
    storage_of,
    write_whole,
)
from impact_observer.io.interfaces import Interface, Quality
from impact_observer.io.messages import (
    AnyMessage,
    JointState,
    MessageError,
    read,
    read_estimate,
    read_event,
    read_verdict,
)
from impact_observer.io.state_arrays import RecordedStates, state_arrays
from impact_observer.io.typestores import (
    add_definition,
    begins_with_stamp,
    deserialize,
    new_typestore,
)
from impact_observer.plain_text import say
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

_Value = TypeVar("_Value")
_STEP = 1024
"""States from one call of ``progress`` to the next."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a bag, by its absolute name.

    The types of publishers that disagreed are joined by the word ``and``. Quality of service and
    the definition of the type may not be in the bag.
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
            Quality.of_publisher(qos, interfaces.usual_quality(topic).depth)
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
    """A serialized message (CDR) of a bag; its log time is in ns."""

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
        """Open a bag: a rosbag2 folder, or a bare ``.mcap`` or ``.db3`` file.

        Raises:
            UsageError: ``path`` does not exist.
            BagError: ``path`` is no bag, or a damaged bag.
        """
        self.path, self.is_whole = Path(path), True
        self._open, self._store = ExitStack(), new_typestore()
        self.low = 0
        self._limits: tuple[int, int] | None = None
        self._received: frozenset[str] = frozenset()
        try:
            with self._translated():
                self.storage = storage_of(self.path)
                self._reader = self._open.enter_context(Reader(self._file_with_end()))
                self._read_topics()
        except BaseException:
            self.close()
            raise

    def _file_with_end(self) -> Path:
        """The bag, or a file with the messages of MCAP files without an end."""
        files = [each for each in checked_files(self.path) if each.suffix == ".mcap"]
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
    def _recover(self) -> str:
        """The remedy for a damaged file."""
        return f"`{recover_command(self.path)}` writes what is left to a new file"

    @property
    def size(self) -> int:
        """Bytes on disk."""
        files = self.path.iterdir() if self.path.is_dir() else [self.path]
        return sum(file.stat().st_size for file in files)

    def find(self, wanted: Interface) -> str | None:
        """The topic of an interface: its absolute name, else the only one in a namespace, or None.

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
        """The topic of the plant's true states; None without any. BagError: of several plants."""
        return self.find(interfaces.PLANT_JOINT_STATES)

    def observers(self) -> tuple[str, ...]:
        """Prefixes of the observers in the bag, such as ``/observer_geometric``, sorted."""
        own = interfaces.OBSERVER_STATES, interfaces.OBSERVER_JOINT_STATES
        return tuple(sorted({topic.rpartition("/")[0] for topic in self._fitting(*own)}))

    def impact_topics(self) -> tuple[str, ...]:
        """Topics of estimates of impacts, of observers and of a smoother, sorted.

        Raises:
            BagError: there are none.
        """
        own = interfaces.OBSERVER_IMPACTS, interfaces.SMOOTHED_ESTIMATES
        if not (topics := self._fitting(*own)):
            raise UnfitBagError(
                f"{self.path}: has no estimates of impacts ({own[0].topic}); run observe or smooth"
                " on it, and take the bag that it makes"
            )
        return topics

    def _fitting(self, *wanted: Interface) -> tuple[str, ...]:
        return tuple(t for t in sorted(self.topics) if any(each.fits(t) for each in wanted))

    def state_topics(self) -> dict[str, str]:
        """Prefixes by topic of states: of the truth, which is empty, then of each observer."""
        truth = self.truth_topic()
        known = {} if truth is None else {truth: ""}
        return known | {self.states_of(prefix): prefix for prefix in self.observers()}

    def states_of(self, prefix: str) -> str:
        """The topic of an observer's states, or of joint states if no states are recorded."""
        state = f"{prefix}/state"
        return state if state in self.topics else f"{prefix}/joint_states"

    def raw(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """The serialized messages on some topics, None for all, in bag order, for copying.

        Raises:
            BagError: a topic is missing, or the bag is damaged.
        """
        wanted = self.topics if topics is None else topics
        for topic in wanted:
            self._topic(topic)
        return self._stream([c for topic in wanted for c in self._connections[topic]])

    def read_between(self, low: int, high: int, received: Collection[str] = ()) -> None:
        """Leave out, from now on, what is stamped before ``low`` or after ``high``, ns.

        The stamp is that of the header; of a message without one, and on topics ``received``, the
        log time. Topics that make the rig known, ``interfaces.WHOLE``, are read whole.
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
        self._define(info)

        def decode(data: bytes) -> AnyMessage:
            try:
                return deserialize(self._store, data, info.type)
            except Exception as error:  # rosbags raises errors of many types
                raise BagError(
                    f"{self.path}: {topic} has bytes that are no {info.type}: {_reason(error)}"
                ) from error

        return decode

    # The methods below raise BagError for a topic that is missing or of another type, and for a
    # message without a valid value.

    def events(self, topic: str = interfaces.IMPACTS.topic) -> Iterator[ImpactEvent]:
        """The events of a topic, in bag order."""
        return self._values(topic, interfaces.IMPACT_EVENT, read_event)

    def verdicts(self, topic: str) -> Iterator[Verdict]:
        """The verdicts of a topic, in bag order."""
        return self._values(topic, interfaces.EVENT_VERDICT, lambda each: read_verdict(each)[0])

    def impact_estimates(self, topic: str) -> Iterator[ImpactEstimate]:
        """The estimates of impacts of a topic, in bag order; rejected ones without numbers."""
        return self._values(topic, interfaces.IMPACT_ESTIMATE, partial(read, ImpactEstimate))

    def model_text(self) -> str | None:
        """The text of the last model published in the bag; None without a model."""
        if (topic := self.find(interfaces.PLANT_MODEL)) is None:
            return None
        texts = deque(self._values(topic, interfaces.STRING, attrgetter("data")), maxlen=1)
        return texts[0] if texts else None

    def first_state(self, topics: Iterable[str]) -> JointState | None:
        """The first state on the first of some topics that has one; None without a state."""
        for topic in topics:
            for state in self._values(topic, self._state_type(topic), partial(read, JointState)):
                return state
        return None

    def states(
        self,
        topics: Iterable[str],
        names: Sequence[str] | None = None,
        progress: Callable[[int, int], object] = lambda _done, _all: None,
    ) -> dict[str, RecordedStates]:
        """The states on some topics, of joint states or of estimates, by topic.

        Args:
            topics: absolute names.
            names: of the columns; None for the names in each topic's first message.
            progress: called with the number of states read, and of all.

        Raises:
            BagError: a name is missing, unexpected or twice, or a law changes.
        """
        chosen, found, done = [*dict.fromkeys(topics)], dict[str, RecordedStates](), 0
        total = sum(self._topic(topic).count for topic in chosen)

        def counted(states: Iterable[_Value]) -> Iterator[_Value]:
            nonlocal done
            for state in states:
                yield state
                done += 1
                if done % _STEP == 0 or done == total:
                    progress(done, total)

        for topic in chosen:
            type_name = self._state_type(topic)
            value_of = read_estimate if type_name == interfaces.OBSERVER_STATE else _as_estimate
            states = counted(self._values(topic, type_name, value_of))
            found[topic] = state_arrays(states, names, f"{self.path}: {topic}")
        return found

    def joint_states(self, topic: str, names: Sequence[str] | None = None) -> RecordedStates:
        """All states on one topic; arguments and errors as of :meth:`states`."""
        return self.states([topic], names)[topic]

    observer_states = joint_states  # estimates are states, too

    def _state_type(self, topic: str) -> str:
        """The type that a topic of states must have: estimates if it has them."""
        is_estimate = self._topic(topic).type == interfaces.OBSERVER_STATE
        return interfaces.OBSERVER_STATE if is_estimate else interfaces.JOINT_STATE

    def _topic(self, topic: str) -> TopicInfo:
        """A topic, checked to be in the bag."""
        if topic not in self.topics:
            in_bag = ", ".join(self.topics) or "none"
            raise UnfitBagError(f"{self.path}: no topic {topic}; topics in the bag: {in_bag}")
        return self.topics[topic]

    def _values(
        self, topic: str, type_name: str, value_of: Callable[[AnyMessage], _Value]
    ) -> Iterator[_Value]:
        """The values of the messages of a topic of the given type."""
        if (found := self._topic(topic).type) != type_name:
            raise UnfitBagError(f"{self.path}: {topic} is {found}; expected {type_name}")
        messages = self.messages(topic)

        def values() -> Iterator[_Value]:
            position = 0
            try:
                for position, (_, message) in enumerate(messages):  # noqa: B007 (for the error)
                    yield value_of(message)
            except MessageError as error:
                raise BagError(f"{self.path}: {topic}, message {position}: {error}") from error

        return values()

    def _define(self, info: TopicInfo) -> None:
        """Have the typestore know the type of a topic."""
        place, type_name = f"{self.path}: {info.name}", info.type
        try:
            if info.definition:
                add_definition(self._store, info.definition, type_name)
        except BagError as error:
            raise BagError(f"{place}: {error}; read it with the version that made it") from error
        if type_name not in self._store.fielddefs:
            raise BagError(
                f"{place} is {type_name}, which neither this package nor the bag defines;"
                " expected a bag with message definitions, as MCAP and Jazzy write them"
            )

    def _stream(self, connections: Collection[Connection]) -> Iterator[RawMessage]:
        """Yields the messages of some connections in bag order; checks that none is missing."""
        if not connections:
            return
        names = {each.topic: interfaces.absolute(each.topic) for each in connections}
        low, high = self._limits or (0, 0)
        stamp_of = {
            topic: self._stamp_reader(topic)
            for topic in (names.values() if self._limits else ())
            if interfaces.interface(topic) not in interfaces.WHOLE
        }
        count, known = 0, [*connections, *(each for each in self._stored if each.topic in names)]
        with self._translated():
            for own, log_time, data in self._reader.messages(known):
                count += 1
                if type(log_time) is not int or type(data) is not bytes:  # of sqlite, any type
                    wrong = "rows without a whole log time (ns) and bytes"
                    raise BagError(f"{self.path}: {own.topic} has {wrong}")
                raw = RawMessage(names[own.topic], log_time, data)
                if raw.topic not in stamp_of or low <= stamp_of[raw.topic](raw) <= high:
                    yield raw
        expected = sum(connection.msgcount for connection in connections)
        if count < expected:
            found = f"{count} messages found, {expected} promised by its index"
            raise BagError(f"{self.path}: {found}; {self._recover}")

    def _stamp_reader(self, topic: str) -> Callable[[RawMessage], int]:
        """A function that gives the stamp (ns) of a message of a topic."""
        info = self._topic(topic)
        try:
            self._define(info)
        except BagError:  # no definition: the message can only be copied
            return attrgetter("log_time")
        has_header = topic not in self._received and begins_with_stamp(self._store, info.type)
        return _stamp_in if has_header else attrgetter("log_time")

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Within the block, an error of ``rosbags`` for a damaged bag is one line."""
        reindex = f"`{reindex_command(self.path)}` writes it anew"
        try:
            yield
        except ModelError as error:
            raise BagError(f"{self.path}: its metadata.yaml: {error}; {reindex}") from None
        except ImpactObserverError:
            raise
        except Exception as error:  # anything, in a damaged file
            reason = _reason(error)
            remedy = self._recover
            if "files are missing" in reason:
                remedy = f"move them back, or {reindex}"
            elif "Profile is not ros2" in reason:
                remedy = f"{FROM_ROS_1}; other messages: a table, for `import` or `detect`"
            raise BagError(f"{self.path}: cannot be read as a bag: {reason}; {remedy}") from error


def _as_estimate(message: AnyMessage) -> tuple[tuple[str, ...], Estimate]:
    """A joint state as an estimate that knows all before it."""
    state = read(JointState, message)
    return state.names, Estimate(state.stamp, "", state.q, state.u, last_event=state.stamp)


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
