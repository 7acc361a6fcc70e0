# SPDX-License-Identifier: Apache-2.0
"""Bags whose topics have no first slash, as writers outside a node make them."""

import json
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_observer.cli.main import main
from impact_observer.io import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.io.typestores import typestore

MS = 1_000_000
HITS = np.array([500, 1300, 1900, 2350])  # ms after the start
START = 1_000_000_000
BOOL = "std_msgs/msg/Bool"


def without_slash(source: Path, path: Path) -> Path:
    """The same messages under names without the first slash."""
    with BagReader(source) as reader, Writer(path, version=9) as writer:
        own = {
            topic.name: writer.add_connection(
                topic.name[1:], topic.type, typestore=typestore(), msgdef=topic.definition
            )
            for topic in reader.topics.values()
        }
        for topic, log_time, data in reader.raw():
            writer.write(own[topic], log_time, data)
    return path


@pytest.fixture(params=[StoragePlugin.MCAP, StoragePlugin.SQLITE3], ids=["mcap", "sqlite3"])
def switch_bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A switch at 1 kHz that is closed for 5 ms at each hit, beside a topic with a slash."""
    path, store = tmp_path / "bag", typestore()
    message = store.types[BOOL]
    with Writer(path, version=9, storage_plugin=cast("StoragePlugin", request.param)) as writer:
        topics = [
            writer.add_connection(name, BOOL, typestore=store) for name in ("switch", "/other")
        ]
        for k in range(3000):
            closed = bool(np.any((k >= HITS) & (k < HITS + 5)))
            for topic in topics:
                data = store.serialize_cdr(message(data=closed), BOOL)
                writer.write(topic, START + k * MS, data)
    return path


@pytest.mark.parametrize("topic", ["switch", "/switch"])
def test_detect_finds_a_topic_by_both_names(switch_bag: Path, tmp_path: Path, topic: str) -> None:
    """Each hit is an impact; the new bag has the topic with its slash."""
    output = tmp_path / "out"
    given = ["--contact", "stop", "--topic", topic, "-o", str(output)]
    assert main(["detect", str(switch_bag), *given]) == 0
    with BagReader(output) as reader:
        assert [each.stamp for each in events_in(reader)] == (START + HITS * MS).tolist()
        assert [*reader.topics] == ["/impacts", "/other", "/switch"]
    assert "name: /switch" in (output / "metadata.yaml").read_text("utf-8")


def test_check_names_the_topic_with_its_slash(
    switch_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """So does the command that makes impacts of it."""
    assert main(["check", str(switch_bag), "--json"]) == 1
    topics = json.loads(capsys.readouterr().out)["topics"]
    assert topics == {"/other": 3000, "/switch": 3000}
    assert main(["check", str(switch_bag)]) == 1
    assert "--contact NAME --topic /switch -o NEW" in " ".join(capsys.readouterr().out.split())


def test_two_names_of_one_topic_are_one(tmp_path: Path) -> None:
    """The messages of both come in the order of the bag."""
    path, store = tmp_path / "bag", typestore()
    message = store.types[BOOL]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = [
            writer.add_connection(name, BOOL, typestore=store) for name in ("switch", "/switch")
        ]
        for k in range(6):
            data = store.serialize_cdr(message(data=k % 2 == 1), BOOL)
            writer.write(topics[k % 2], START + k, data)
    with BagReader(path) as reader:
        assert [each.topic for each in reader.raw()] == 6 * ["/switch"]
        values = [each.data for _, each in reader.messages("/switch")]
    assert values == [False, True] * 3


def test_an_observer_estimates_the_same(tmp_path: Path) -> None:
    """Impacts, truth and model are found without their slash; estimates are equal bits."""
    plant, bare = tmp_path / "plant", tmp_path / "bare"
    made = ["simulate", "two_mass", "--duration", "3", "--rate", "20", "-o", str(plant)]
    assert main(made) == 0
    without_slash(plant, bare)
    states = []
    for bag in (plant, bare):
        output = bag.with_name(f"{bag.name}_observed")
        assert main(["observe", str(bag), "-o", str(output)]) == 0
        with BagReader(output) as reader:
            states.append(reader.observer_states("/observer/state"))
    assert states[0].stamps.size == 61
    for name in ("stamps", "q", "u"):
        np.testing.assert_array_equal(getattr(states[0], name), getattr(states[1], name))


@pytest.mark.ros
def test_a_topic_is_played_by_both_names(
    switch_bag: Path,
    ros_environment: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Only its messages are sent, and counted."""
    assert ros_environment
    player = pytest.importorskip("impact_observer.ros.player")
    played = list[int]()

    def at_once(*given: object, **how: object) -> int:
        played.append(player_play(*given, **how, delay=0.0))
        return played[-1]

    player_play = player.play
    monkeypatch.setattr(player, "play", at_once)
    for topic in ("switch", "/switch"):
        assert main(["play", str(switch_bag), "--rate", "20", "--topics", topic]) == 0
    assert played == [3000, 3000]
    assert capsys.readouterr().out.count(f"3000 messages played from {switch_bag}") == 2
