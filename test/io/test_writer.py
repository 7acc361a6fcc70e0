# SPDX-License-Identifier: Apache-2.0
"""Writing a bag."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from ruamel.yaml import YAML

from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagReader, BagWriter, Quality, interfaces
from impact_observer.io.messages import bag_messages
from impact_observer.io.recordings import carried_topics

MAKE = bag_messages()
FOREIGN = "float64 torque\nstring[] labels\n"


def event(stamp: int) -> object:
    """A message of an event at ``stamp``."""
    return MAKE.event(ImpactEvent(stamp, (Switch("stop"),), sequence=stamp))


def test_folder_has_the_form_of_jazzy(tmp_path: Path) -> None:
    """A bag has version 9, one MCAP file with the name of rosbag2, and hashes of the types."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/impacts", 7, event(5))
        writer.write("/impacts", 9, event(6))
    metadata = YAML(typ="safe").load(tmp_path / "bag" / "metadata.yaml")
    about = metadata["rosbag2_bagfile_information"]
    assert about["version"] == 9
    assert about["storage_identifier"] == "mcap"
    assert about["relative_file_paths"] == ["bag_0.mcap"]
    assert about["message_count"] == 2
    assert about["starting_time"] == {"nanoseconds_since_epoch": 7}
    assert about["duration"] == {"nanoseconds": 2}
    topic = about["topics_with_message_count"][0]["topic_metadata"]
    assert topic["serialization_format"] == "cdr"
    assert topic["type_description_hash"].startswith("RIHS01_")
    offered = topic["offered_qos_profiles"][0]
    assert (offered["history"], offered["depth"]) == ("keep_last", 2000)
    assert (offered["reliability"], offered["durability"]) == ("reliable", "transient_local")
    assert offered["deadline"] == {"sec": 9223372036, "nsec": 854775807}


def test_mcap_is_of_profile_ros2_with_texts_of_its_messages(tmp_path: Path) -> None:
    """Another library reads the profile and the definitions."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/impacts", 7, event(5))
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert summary is not None
        assert [c.message_encoding for c in summary.channels.values()] == ["cdr"]
        (schema,) = summary.schemas.values()
        assert (schema.name, schema.encoding) == (interfaces.IMPACT_EVENT, "ros2msg")
        assert b"MSG: impact_observer_msgs/ContactSwitch" in schema.data
        assert [m.log_time for _, _, m in reader.iter_messages()] == [7]


def test_hash_of_our_messages_is_that_of_their_ros_classes(tmp_path: Path) -> None:
    """With the right hashes ``ros2 bag play`` recognises the recorded types."""
    messages = pytest.importorskip("impact_observer_msgs.msg")
    with BagWriter(tmp_path / "bag") as writer:
        for topic in interfaces.INTERFACES:
            writer.declare(topic.topic)
    metadata = YAML(typ="safe").load(tmp_path / "bag" / "metadata.yaml")
    hashes = {
        each["topic_metadata"]["type"]: each["topic_metadata"]["type_description_hash"]
        for each in metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    }
    checked = 0
    for type_name, found in hashes.items():
        package, _, name = type_name.split("/")
        if package == "impact_observer_msgs":
            installed = Path(messages.__file__).parents[5] / "share" / package / "msg"
            if (installed / f"{name}.json").is_file():
                assert found in (installed / f"{name}.json").read_text("utf-8")
                checked += 1
    assert checked in {0, 7}


def test_qualities_are_kept(tmp_path: Path) -> None:
    """Known topics have the qualities of the table; other topics have their declared ones."""
    own = Quality(reliable=False, transient_local=True, depth=0)
    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/plant/model")
        writer.declare("/observer_geometric/state")
        writer.declare("/own", type_name=interfaces.STRING, quality=own)
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"):
        with BagReader(path) as reader:
            assert reader.topics["/plant/model"].quality == interfaces.LATCHED
            assert reader.topics["/observer_geometric/state"].quality == interfaces.STATES
            assert reader.topics["/own"].quality == own


@pytest.mark.parametrize("name", ["file", "link", ".", "absent/bag", "x" * 300])
def test_a_path_for_no_bag_is_refused_and_left_alone(name: str, tmp_path: Path) -> None:
    """A file, a link to nowhere, a folder, a mistyped folder, a name that is too long."""
    (tmp_path / "file").write_text("mine", "utf-8")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    said = {"absent/bag": "no folder .*absent; make it first", "x" * 300: "File name too long"}
    with pytest.raises(UsageError, match=said.get(name, "exists already")):
        BagWriter(tmp_path / name)
    assert (tmp_path / "file").read_text("utf-8") == "mine"
    assert {each.name for each in tmp_path.iterdir()} == {"file", "link"}


def test_bag_is_whole_after_an_exception(tmp_path: Path) -> None:
    """Messages before the exception are in the bag, and the exception is not hidden."""

    def write_and_fail() -> None:
        with BagWriter(tmp_path / "bag") as writer:
            for stamp in range(1, 1001):
                writer.write("/impacts", stamp, event(stamp))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_and_fail()
    with BagReader(tmp_path / "bag") as reader:
        assert [each.stamp for each in reader.events()] == list(range(1, 1001))


def test_empty_bag_is_a_bag(tmp_path: Path) -> None:
    """A bag without messages can be read, with topics and without."""
    with BagWriter(tmp_path / "none"):
        pass
    with BagWriter(tmp_path / "silent") as writer:
        writer.declare("/impacts")
    with BagReader(tmp_path / "none") as reader:
        assert (reader.topics, reader.start, reader.end) == ({}, 0, 0)
        assert list(reader.raw()) == []
    with BagReader(tmp_path / "silent") as reader:
        assert list(reader.events()) == []
        assert reader.topics["/impacts"].count == 0


def test_closed_bag_takes_nothing(tmp_path: Path) -> None:
    """A closed bag refuses messages; closing twice does no harm."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/impacts", 1, event(1))
        writer.close()
        with pytest.raises(UsageError, match="is closed"):
            writer.write("/impacts", 2, event(2))


def test_topics_must_be_known_and_hold_their_type(tmp_path: Path) -> None:
    """The error names each mistake."""
    with BagWriter(tmp_path / "bag") as writer:
        with pytest.raises(UsageError, match=r"/torque is no topic of this package; name its"):
            writer.write("/torque", 1, MAKE.model("x"))
        with pytest.raises(UsageError, match=r"/torque is rig/msg/Torque; give its definition"):
            writer.declare("/torque", type_name="rig/msg/Torque")
        with pytest.raises(UsageError, match=r"/impacts is .*ImpactEvent; not std_msgs/msg/Str"):
            writer.write("/impacts", 1, MAKE.model("x"))
        with pytest.raises(UsageError, match=r"/impacts is declared twice"):
            writer.declare("/impacts")
        with pytest.raises(UsageError, match=r"/impacts at log time -1 ns; expected 0 or more"):
            writer.write("/impacts", -1, event(1))
        with pytest.raises(BagError, match=r"another definition of std_msgs/msg/String"):
            writer.declare("/s", type_name=interfaces.STRING, definition="int32 data")
        with pytest.raises(BagError, match=r"definition of rig/msg/Torque cannot be parsed"):
            writer.declare("/torque", type_name="rig/msg/Torque", definition="?!")


def test_foreign_type_is_written_and_copied_with_its_definition(tmp_path: Path) -> None:
    """A type that only the bag defines is decoded from it."""
    with BagWriter(tmp_path / "one") as writer:
        writer.declare("/torque", type_name="rig/msg/Torque", definition=FOREIGN)
        writer.write("/impacts", 4, event(4))
        writer.write_raw("/torque", 5, b"\x00\x01\x00\x00" + np.float64(2.5).tobytes() + b"\0" * 4)
    with BagReader(tmp_path / "one") as reader, BagWriter(tmp_path / "two") as writer:
        assert carried_topics(reader, writer, ()) == (["/impacts", "/torque"], [])
        for raw in reader.raw():
            writer.write_raw(*raw)
    with BagReader(tmp_path / "two") as reader:
        ((log_time, message),) = reader.messages("/torque")
        assert log_time == 5
        assert getattr(message, "torque", None) == 2.5
        assert reader.topics["/torque"].definition.startswith("float64 torque")
        assert [each.stamp for each in reader.events()] == [4]
