# SPDX-License-Identifier: Apache-2.0
"""Reading a bag."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from systems import examples

from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent, Kind, Ruling, Switch, Verdict
from impact_observer.io import BagReader, BagWriter, JointState, Quality, interfaces
from impact_observer.io.messages import bag_messages
from impact_observer.io.typestores import typestore
from impact_observer.states import Estimate, frozen

MAKE = bag_messages()
EVENTS = [
    ImpactEvent(stamp, (Switch("stop", Kind.CLOSE), Switch("left")), stamp, 1, 9)
    for stamp in range(10, 20)
]
VERDICT = Verdict(10, Ruling.REJECTED, 10, "left", "too far", 5.5)


def state(stamp: int, **values: tuple[float, float]) -> object:
    """A joint state message of (position, velocity) a name."""
    q, u = (frozen([each[k] for each in values.values()]) for k in (0, 1))
    return MAKE.joint_state(JointState(stamp, tuple(values), q, u))


def estimate(stamp: int, law: str = "geometric") -> object:
    """An estimate's message."""
    q, u = frozen([0.5, stamp]), frozen([1.5, 2.5])
    return MAKE.estimate(
        Estimate(stamp, law, q, u, last_sequence=stamp - 1, last_event=stamp - 2), ("a", "b")
    )


@pytest.fixture(scope="module")
def first_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag from which ``bag`` is copied."""
    path = tmp_path_factory.mktemp("first") / "bag"
    with BagWriter(path) as writer:
        writer.write("/plant/model", 5, MAKE.model("name: first"))
        writer.write("/plant/model", 6, MAKE.model("name: last"))
        for k, event in enumerate(EVENTS):
            writer.write("/impacts", 10 + k, MAKE.event(event))
            writer.write("/plant/joint_states", 10 + k, state(1 + k, a=(k, 1), b=(2, 3)))
            writer.write("/plant/joint_states", 10 + k, state(2 + k, b=(20, 30), a=(k, 10)))
            writer.write("/observer_geometric/state", 10 + k, estimate(10 + k))
        writer.write("/observer_geometric/verdicts", 30, MAKE.verdict(VERDICT, 0.5))
        writer.write("/rig/observer/joint_states", 30, state(1, a=(1, 2)))
    return path


@pytest.fixture
def bag(first_bag: Path, tmp_path: Path) -> Path:
    """A bag with everything we publish; joint states in changing order of names."""
    return Path(shutil.copytree(first_bag, tmp_path / "bag"))


def test_a_bag_is_read_as_it_was_written(bag: Path) -> None:
    """From its folder and from its bare file."""
    for path in (bag, bag / "bag_0.mcap"):
        with BagReader(path) as reader:
            assert reader.storage == "mcap"
            assert (reader.start, reader.end, reader.message_count) == (5, 30, 44)
            assert reader.topics["/impacts"].count == 10
            assert reader.topics["/impacts"].quality == interfaces.EVENTS
            assert reader.size > 1000
            assert list(reader.events()) == EVENTS
            assert list(reader.verdicts("/observer_geometric/verdicts")) == [VERDICT]
            assert reader.model_text() == "name: last"


def test_observers_and_truth_are_found(bag: Path) -> None:
    """A bag's observers of any law are found in any namespace."""
    with BagReader(bag) as reader:
        assert reader.observers() == ("/observer_geometric", "/rig/observer")
        assert reader.truth_topic() == "/plant/joint_states"
        assert reader.find(interfaces.MONITOR_ERROR) is None


def test_several_plants_are_ambiguous(tmp_path: Path) -> None:
    """A plant without a namespace wins; the error names two plants in namespaces."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/a/plant/joint_states")
        writer.declare("/b/plant/joint_states")
    with BagReader(tmp_path / "bag") as reader:
        assert reader.model_text() is None
        with pytest.raises(BagError, match=r"/a/plant/joint_states and /b/plant/joint_states"):
            reader.truth_topic()


def test_raw_messages_can_be_chosen(bag: Path) -> None:
    """Messages are chosen by topic, and are in the order of the bag."""
    with BagReader(bag) as reader:
        assert len(list(reader.raw())) == 44
        some = list(reader.raw(["/impacts", "/plant/model"]))
        assert [each.log_time for each in some] == [5, 6, *range(10, 20)]
        assert list(reader.raw([])) == []


def test_a_missing_path_is_a_usage_error(tmp_path: Path) -> None:
    """A missing path is wrong use, unlike a damaged bag."""
    with pytest.raises(UsageError, match="absent"):
        BagReader(tmp_path / "absent")


def folder_without_files(path: Path) -> Path:
    """An empty folder in place of a bag."""
    shutil.rmtree(path)
    path.mkdir()
    return path


def changed(path: Path, name: str, data: bytes, damaged: str = "") -> Path:
    """A bag with a file of these bytes; ``damaged`` is the bare file that is read."""
    (path / name).write_bytes(data)
    return path / damaged


DAMAGES: dict[str, Callable[[Path], Path]] = {
    r"notes\.txt": lambda bag: changed(bag, "notes.txt", b"x", "notes.txt"),
    r"bag: no metadata\.yaml; expected a bag": folder_without_files,
    r"bag: cannot be read as a bag: Could not load YAML": lambda bag: changed(
        bag, "metadata.yaml", b"{["
    ),
    r"bag: cannot be read as a bag: Some database files are missing: .*; move them": lambda bag: (
        (bag / "bag_0.mcap").rename(bag / "other").parent
    ),
    r"bag: has no end and no whole chunk; `mcap recover .*bag_0\.mcap": lambda bag: changed(
        bag, "bag_0.mcap", (bag / "bag_0.mcap").read_bytes()[:5000]
    ),
    r"bag\.db3: cannot be read as a bag: Cannot open database": lambda bag: changed(
        bag, "bag.db3", b"SQLite format 4\0" * 100, "bag.db3"
    ),
    r"bag_0\.mcap: cannot be read as a bag: File .* seems to be empty": lambda bag: changed(
        bag, "bag_0.mcap", b"", "bag_0.mcap"
    ),
}
"""How to damage a bag, by what is said of it."""


@pytest.mark.parametrize("expected", DAMAGES)
def test_damaged_bag_is_one_line(bag: Path, expected: str) -> None:
    """The error names the bag, its fault and a remedy."""
    with pytest.raises(BagError, match=expected) as caught:
        BagReader(DAMAGES[expected](bag))
    assert "\n" not in str(caught.value)


@settings(examples(100), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    flips=st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), max_size=4),
    keep=st.floats(0, 1) | st.just(1.0),
)
def test_damage_anywhere_is_never_a_traceback(
    bag: Path, flips: list[tuple[float, int]], keep: float
) -> None:
    """After flipped bytes or a cut, reading works, or the error is one line."""
    data = bytearray((bag / "bag_0.mcap").read_bytes())
    for where, mask in flips:
        data[round(where * (len(data) - 1))] ^= mask
    damaged = bag.parent / "damaged.mcap"
    damaged.write_bytes(data[: round(keep * len(data))])
    line = None
    try:
        with BagReader(damaged) as reader:
            assert len(list(reader.raw())) >= len(list(reader.events()))
            reader.joint_states("/plant/joint_states")
            reader.observer_states("/observer_geometric/state")
    except BagError as error:
        line = str(error)
    assert line is None or (line.startswith(str(damaged)) and "\n" not in line)


def test_index_with_more_messages_than_the_file_is_an_error(bag: Path) -> None:
    """A truncated bag is not read without an error."""
    metadata = (bag / "metadata.yaml").read_text("utf-8")
    (bag / "metadata.yaml").write_text(metadata.replace("count: 10\n", "count: 12\n"), "utf-8")
    with (
        BagReader(bag) as reader,
        pytest.raises(BagError, match=r"10 messages found, 12 promised by its index"),
    ):
        list(reader.events())


def test_missing_topic_and_wrong_type_are_named(bag: Path) -> None:
    """The error lists the topics of the bag."""
    with BagReader(bag) as reader:
        with pytest.raises(BagError, match="no topic /rig/impacts; topics in the bag"):
            reader.events("/rig/impacts")
        with pytest.raises(BagError, match=r"/plant/model is std_msgs/msg/String; expected sens"):
            reader.joint_states("/plant/model")
        with pytest.raises(BagError, match=r"/impacts is .*ImpactEvent; expected .*EventVerdict"):
            reader.verdicts("/impacts")
        with pytest.raises(BagError, match=r"no topic /absent"):
            reader.raw(["/absent"])


def test_event_that_is_none_is_named(tmp_path: Path) -> None:
    """The error names the place of the message in the topic."""
    bad = MAKE.event(ImpactEvent(1, ()))
    bad.header.stamp.nanosec = 0
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/impacts", 1, MAKE.event(EVENTS[0]))
        writer.write("/impacts", 2, bad)
    with (
        BagReader(tmp_path / "bag") as reader,
        pytest.raises(BagError, match="/impacts, message 1"),
    ):
        list(reader.events())


def test_bytes_that_are_no_message_are_an_error_with_their_place(tmp_path: Path) -> None:
    """A message with more than a few surplus bytes is an error, too."""
    for k, data in enumerate((b"", b"\x07\x07\0\0", b"\x00\x01\0\0\1", b"\x00\x01" + b"\0" * 99)):
        with BagWriter(tmp_path / str(k)) as writer:
            writer.write_raw("/plant/model", 1, data)
        with (
            BagReader(tmp_path / str(k)) as reader,
            pytest.raises(BagError, match=r"/plant/model has bytes that are no std_msgs/msg/Str"),
        ):
            reader.model_text()


def test_bag_with_another_definition_of_our_type_is_refused(tmp_path: Path) -> None:
    """The bytes of another definition would be misread."""
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            "/impacts", interfaces.IMPACT_EVENT, msgdef="int32 data\n", rihs01="RIHS01_0"
        )
        writer.write(connection, 1, b"\x00\x01\0\0\1\0\0\0")
    with BagReader(tmp_path / "bag") as reader:
        assert len(list(reader.raw())) == 1
        with pytest.raises(BagError, match=r"/impacts: another definition of .*ImpactEvent"):
            reader.events()


def test_type_without_a_definition_can_only_be_copied(tmp_path: Path) -> None:
    """An old sqlite3 bag has no definitions."""
    with Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/x", "rig/msg/X", msgdef="int32 a", rihs01="RIHS01_0")
        writer.write(connection, 1, b"\x00\x01\0\0\1\0\0\0")
    metadata = tmp_path / "bag" / "metadata.yaml"
    with BagReader(tmp_path / "bag") as reader:
        assert [getattr(message, "a", None) for _, message in reader.messages("/x")] == [1]
    import apsw

    database = apsw.Connection(str(tmp_path / "bag" / "bag.db3"))
    database.execute("UPDATE message_definitions SET topic_type = 'rig/msg/Other'")
    database.close()
    assert metadata.is_file()
    with BagReader(tmp_path / "bag") as reader:
        assert len(list(reader.raw())) == 1
        with pytest.raises(BagError, match=r"/x is rig/msg/X, which neither this package nor"):
            reader.messages("/x")


def test_topic_with_two_types_is_not_used(tmp_path: Path) -> None:
    """A topic whose publishers disagree on the type is not used."""
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for type_name in (interfaces.STRING, interfaces.IMPACT_EVENT):
            writer.add_connection("/impacts", type_name, typestore=typestore())
    with BagReader(tmp_path / "bag") as reader:
        assert reader.topics["/impacts"].quality is None
        with pytest.raises(BagError, match=r"/impacts is .*ImpactEvent and std_msgs/msg/String"):
            reader.events()


def test_publishers_of_different_quality_have_their_common_quality(tmp_path: Path) -> None:
    """A recorder stores one profile for each publisher."""
    offers = [interfaces.EVENTS.offered(), Quality(reliable=False, depth=7).offered()]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection(
            "/impacts", interfaces.IMPACT_EVENT, typestore=typestore(), offered_qos_profiles=offers
        )
    with BagReader(tmp_path / "bag") as reader:
        assert reader.topics["/impacts"].quality == Quality(False, False, 2000)
