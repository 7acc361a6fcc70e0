# SPDX-License-Identifier: Apache-2.0
"""The head of ``check``: the contents of a bag, and impacts counted by contact and episode."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from impact_observer.check.bag_check import check_bag
from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import BagWriter
from impact_observer.io.messages import bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import model_of


def content_of(bag: Path) -> dict[str, Any]:
    """The contents of a bag."""
    content = check_bag(bag).content
    assert content is not None
    return content


def test_impacts_are_counted_by_contact_and_episode(tmp_path: Path) -> None:
    """A closing is an impact, an opening is none."""
    make = bag_messages()
    both = (Switch("left"), Switch("right", Kind.CLOSE))
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/impacts", 1, make.event(ImpactEvent(1, both, 1, 1)))
        writer.write(
            "/impacts", 2, make.event(ImpactEvent(2, (Switch("right", Kind.OPEN),), 2, 1))
        )
        writer.write("/impacts", 3, make.event(ImpactEvent(3, (Switch("left"),), 3, 2)))
    summary = content_of(tmp_path / "bag")
    assert summary["impacts"] == {"left": 2, "right": 1}
    assert summary["closings"] == {"right": 1}
    assert summary["episodes"] == 2
    assert summary["model"] is None
    assert summary["observers"] == {}


def test_impact_superseded_by_a_close_is_counted_once(tmp_path: Path) -> None:
    """The impact counts as persistent contact; a duplicate is counted once too."""
    make = bag_messages()
    switches = [(1, Kind.IMPACT), (2, Kind.IMPACT), (2, Kind.CLOSE), (3, Kind.OPEN)]
    events = [
        ImpactEvent(stamp, (Switch("stop", kind),), k + 1)
        for k, (stamp, kind) in enumerate(switches)
    ]
    with BagWriter(tmp_path / "bag") as writer:
        for event in [*events, events[0]]:
            writer.write("/impacts", 10, make.event(event))
    summary = content_of(tmp_path / "bag")
    assert (summary["impacts"], summary["closings"]) == ({"stop": 2}, {"stop": 1})


def test_json_has_all_results(sample_bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command prints nothing but JSON."""
    assert main(["check", str(sample_bag), "--json"]) == 0
    results = json.loads(capsys.readouterr().out)["content"]
    topics = results.pop("topics")
    size = results.pop("size")
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
        "model": {"name": "two_mass", "version": "1.2.3", "seed": 7, "sensor": None},
        "observers": {"/observer_geometric": "geometric"},
    }
    assert size == sum(file.stat().st_size for file in sample_bag.iterdir())
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
    assert main(["check", str(sample_bag)]) == 0
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


def test_sensor_faults_of_a_simulated_bag_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Faults have the names and values in the bag's model."""
    bag = tmp_path / "bag"
    given = ["--missed", "0.2", "--impacts-only", "--duration", "1", "-o", str(bag)]
    assert main(["simulate", "two_mass", *given]) == 0
    summary = content_of(bag)
    assert summary["model"] is not None
    assert summary["model"]["sensor"] == {"missed": 0.2, "impacts_only": True}
    capsys.readouterr()
    assert main(["check", str(bag)]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "sensor missed 0.2, impacts_only True" in lines


def test_bags_of_other_packages_and_empty_bags_are_described(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An invalid model is reported, and what there is is listed."""
    make = bag_messages()
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/plant/model", 1, make.model("[just, a, list]"))
        writer.declare("/observer/joint_states")
        writer.declare("/torque", type_name="rig/msg/Torque", definition="float64 torque\n")
    with BagWriter(tmp_path / "empty"):
        pass
    assert main(["check", str(tmp_path / "bag")]) == 1
    assert main(["check", str(tmp_path / "empty")]) == 1
    printed = capsys.readouterr().out
    assert "model     cannot be read: model: " in printed
    assert "observer  /observer: law not recorded" in printed
    assert "rig/Torque" in printed
    assert "0 s, 0 messages" in printed


def test_a_bag_that_cannot_be_read_has_findings_and_no_head(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No bag is wrong use; a damaged bag is a failure."""
    assert main(["check", str(tmp_path / "absent")]) == 2
    assert "absent: does not exist" in capsys.readouterr().err
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert main(["check", str(tmp_path / "bag.mcap")]) == 1
    assert capsys.readouterr().out.startswith("error")
    assert main(["check", str(tmp_path / "bag.mcap"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["content"] is None


def test_persistent_contacts_and_drawn_parameters_are_those_of_simulate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A row of bounces that jitter reorders about the closing: one persistent contact.

    An impact that is stamped after the closing, and was before, does not count.
    """
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
    (words,) = re.findall(r"(\d+) impacts, (\d+) of them", capsys.readouterr().out)
    found = content_of(bag)
    assert int(words[0]) - 1 <= found["impacts"]["floor"] <= int(words[0])
    assert (found["closings"]["floor"], words[1]) == (1, "1")
    assert main(["check", str(bag)]) == 0
    with BagReader(bag) as reader:
        true = model_of(reader).provenance["true_parameters"]
    assert isinstance(true, dict)
    value = true["restitution.floor"]
    assert f"drawn restitution.floor {value:.6g}" in " ".join(capsys.readouterr().out.split())
