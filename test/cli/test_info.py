# SPDX-License-Identifier: Apache-2.0
"""The command ``info``: the contents of a bag."""

import argparse
import json
import re
from pathlib import Path

import pytest
from foreign_bags import humble_sqlite, mcap_folder

from impact_observer.check.bag_summary import summarize
from impact_observer.cli import info
from impact_observer.cli.main import main
from impact_observer.errors import BagError, UsageError
from impact_observer.io import BagWriter
from impact_observer.io.messages import bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import model_of


def parsed(*words: str) -> argparse.Namespace:
    """The command line ``words``."""
    parser = argparse.ArgumentParser()
    info.add_arguments(parser)
    return parser.parse_args(words)


def test_json_has_all_results(sample_bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command prints nothing but JSON."""
    assert info.run(parsed(str(sample_bag), "--json")) == 0
    results = json.loads(capsys.readouterr().out)
    topics = results.pop("topics")
    size = results.pop("size")
    chunks = results.pop("chunks")
    assert results == {
        "path": str(sample_bag),
        "storage": "mcap",
        "start": 1_000_000_000,
        "end": 1_500_000_000,
        "duration": 0.5,
        "messages": 114,
        "impacts": {"stop": 11},
        "closings": {},
        "episodes": 1,
        "model": {
            "name": "two_mass",
            "version": "1.2.3",
            "seed": 7,
            "integrator": None,
            "sensor": None,
        },
        "observers": {"/observer_geometric": "geometric"},
    }
    assert size == sum(file.stat().st_size for file in sample_bag.iterdir())
    assert chunks["count"] >= 1  # a chunk ends after half a second at the latest
    assert chunks["compression"] == "none"
    assert 0 < chunks["compressed"] == chunks["uncompressed"] < size
    assert topics[0] == {
        "name": "/impacts",
        "type": "impact_observer_msgs/msg/ImpactEvent",
        "count": 11,
        "rate": 20.0,
        "reliable": True,
        "transient_local": True,
        "depth": 2000,
    }
    assert {each["name"]: each["rate"] for each in topics}["/plant/model"] is None


def test_text_has_the_contents_of_the_json(
    sample_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each fact and each topic has a line with whole names on any width."""
    assert info.run(parsed(str(sample_bag))) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "time 1.000000000 to 1.500000000 s" in lines
    assert "duration 0.5 s, 114 messages" in lines
    assert "model two_mass, version 1.2.3, seed 7" in lines
    assert "impacts 11 at stop; episodes: 1" in lines
    assert "observer /observer_geometric: geometric" in lines
    assert (
        "/impacts impact_observer_msgs/ImpactEvent 11 20 reliable, transient local, last 2000"
        in lines
    )
    assert "/plant/joint_states sensor_msgs/JointState 51 100 reliable, volatile, last 10" in lines


def test_chunks_are_listed_with_their_compression(
    tmp_path: Path, sample_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Chunks have bytes before and after compression; a database has no chunks."""
    zstd = mcap_folder(sample_bag, tmp_path / "zstd", distro="jazzy", compression="zstd")
    database = humble_sqlite(sample_bag, tmp_path / "database")
    assert info.info(zstd) == info.info(database) == 0
    printed = capsys.readouterr().out
    assert re.search(r"^chunks +\d+, zstd, [\d.]+ kB in [\d.]+ kB *$", printed, re.MULTILINE)
    assert printed.count("\nchunks ") == 1


def test_sensor_faults_of_a_simulated_bag_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Faults have the names and values in the bag's model."""
    bag = tmp_path / "bag"
    given = ["--missed", "0.2", "--impacts-only", "--duration", "1", "-o", str(bag)]
    assert main(["simulate", "two_mass", *given]) == 0
    summary = summarize(bag)
    assert summary.model is not None
    assert summary.model["sensor"] == {"missed": 0.2, "impacts_only": True}
    capsys.readouterr()
    assert info.info(bag) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "sensor missed 0.2, impacts_only True" in lines


def test_bags_of_other_packages_and_empty_bags_are_described(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An invalid model is reported, and the exit code is 0."""
    make = bag_messages()
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/plant/model", 1, make.model("[just, a, list]"))
        writer.declare("/observer/joint_states")
        writer.declare("/torque", type_name="rig/msg/Torque", definition="float64 torque\n")
    with BagWriter(tmp_path / "empty"):
        pass
    assert info.info(tmp_path / "bag") == info.info(tmp_path / "empty") == 0
    printed = capsys.readouterr().out
    assert "model     cannot be read: model: " in printed
    assert "observer  /observer: law not recorded" in printed
    assert "rig/Torque" in printed
    assert "0 s, 0 messages" in printed


def test_failures_keep_their_exit_codes(tmp_path: Path) -> None:
    """No bag is wrong use; a damaged bag is a failure."""
    with pytest.raises(UsageError, match="does not exist") as absent:
        info.run(parsed(str(tmp_path / "absent")))
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP0\r\n")
    printed = (
        r"bag\.mcap: cannot be read as a bag: .*; if it was cut short, `impact-observer check"
    )
    with pytest.raises(BagError, match=printed) as damaged:
        info.run(parsed(str(tmp_path / "bag.mcap")))
    assert str(damaged.value).count("impact-observer check") == 1, "one remedy is enough"
    (tmp_path / "my bag").mkdir()
    with pytest.raises(BagError, match=r"no metadata.*; `impact-observer check '.*my bag'` says"):
        info.run(parsed(str(tmp_path / "my bag")))
    assert (absent.value.exit_code, damaged.value.exit_code) == (2, 1)


def test_persistent_contacts_and_drawn_parameters_are_those_of_simulate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A row of bounces that jitter reorders about the closing: one persistent contact."""
    model = tmp_path / "ball.yaml"
    model.write_text(
        "name: ball\nbodies: [{name: z, mass: 1}]\nforces: [{body: z, constant: -9.81}]\n"
        "stops: [{name: floor, body: z, limit: 0, side: below,"
        " restitution: {value: 0.5, deviation: 0.05}}]\n"
        "initial_state: {position: [0.1], velocity: [0]}\n"
    )
    bag = tmp_path / "bag"
    command = f"simulate {model} --duration 1 --jitter 0.001 --random-parameters 2 -o {bag}"
    assert main(command.split()) == 0
    (words,) = re.findall(r"with jitter: (\d+) impacts \((\d+) of them", capsys.readouterr().out)
    found = summarize(bag)
    assert (found.impacts["floor"], found.closings["floor"]) == tuple(map(int, words))
    assert words[1] == "1"
    assert main(["info", str(bag)]) == 0
    with BagReader(bag) as reader:
        true = model_of(reader).provenance["true_parameters"]
    assert isinstance(true, dict)
    value = true["restitution.floor"]
    assert f"drawn restitution.floor {value:.6g}" in " ".join(capsys.readouterr().out.split())
