# SPDX-License-Identifier: Apache-2.0
"""The command ``layout``."""

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from plotting_tools import everything

from impact_observer.cli.main import main
from impact_observer.io import BagReader, BagWriter, copy_topics


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with two observers of one plant."""
    laws = {"observer_geometric": "geometric", "observer_kinematic": "kinematic"}
    return everything(tmp_path_factory.mktemp("layout") / "bag", laws, duration=2.0)


def test_a_layout_of_a_bag_shows_its_own_observers(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The layout shows topics of the bag only: without markers no scene."""
    written = tmp_path / "bag.json"
    assert main(["layout", str(bag), "-o", str(written)]) == 0
    text = written.read_text("utf-8")
    assert "/observer_geometric/state" in text
    assert "/observer_kinematic/state" in text
    assert "3D!" not in text
    assert capsys.readouterr().out == f"{written}: 50 curves on 12 topics\n"


def test_observers_are_chosen_by_name(bag: Path, tmp_path: Path) -> None:
    """Only the named observers of a bag are drawn."""
    written = tmp_path / "one.xml"
    chosen = ["--observers", "observer_kinematic"]
    assert main(["layout", str(bag), *chosen, "-o", str(written)]) == 0
    names = {curve.attrib["name"] for curve in ET.parse(written).iter("curve")}
    assert not any("geometric" in name for name in names)
    assert any("kinematic" in name for name in names)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["two_mass", "-o", "x.txt"], "x.txt: expected .json for Foxglove, or .xml for PlotJug"),
        (["two_mass", "--model", "three_mass", "-o", "x.json"], "--model three_mass: is for a b"),
        (["two_mass", "--observers", "a b", "-o", "x.json"], "observer 'a b': no name of a node"),
        (["no_model", "-o", "x.json"], "no_model: no such file"),
        (["two_mass", "-o", "no/folder/x.json"], "no/folder/x.json: no folder no/folder;"),
        (["none.mcap", "-o", "x.json"], "none.mcap: "),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    arguments: list[str],
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The line names the thing; no file is left."""
    monkeypatch.chdir(tmp_path)
    assert main(["layout", *arguments]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1
    assert errors[0].startswith(f"impact-observer: {line}")
    assert not list(tmp_path.iterdir())


def test_a_bag_must_have_what_is_asked_of_it(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A layout needs an observer of the bag, and a model."""
    wanted = ["--observers", "observer_other", "-o", str(tmp_path / "x.json")]
    assert main(["layout", str(bag), *wanted]) == 2
    line = "no observer /observer_other; in the bag: /observer_geometric, /observer_kinematic"
    assert line in capsys.readouterr().err
    with BagReader(bag) as reader, BagWriter(tmp_path / "plant") as writer:
        copy_topics(reader, writer, ["/impacts", "/plant/joint_states"])
    plant = ["layout", str(tmp_path / "plant"), "-o", str(tmp_path / "x.json")]
    assert main(plant) == 2
    assert "carries no model; name one with --model" in capsys.readouterr().err
    assert main([*plant, "--model", "two_mass"]) == 2
    assert "has no estimates; make them with observe" in capsys.readouterr().err


def test_an_observer_that_is_named_twice_is_drawn_once(tmp_path: Path) -> None:
    """A name counts as the same with and without the first slash."""
    once, twice = tmp_path / "once.json", tmp_path / "twice.json"
    assert main(["layout", "two_mass", "--observers", "observer", "-o", str(once)]) == 0
    assert main(["layout", "two_mass", "--observers", "observer,/observer", "-o", str(twice)]) == 0
    assert once.read_bytes() == twice.read_bytes()


def test_a_layout_of_ones_own_model_names_its_coordinates(tmp_path: Path) -> None:
    """Twenty coordinates are drawn in columns."""
    n = 20
    names = [f"q{i}" for i in range(n)]
    eye = [[float(i == j) for j in range(n)] for i in range(n)]
    direction = [-1.0, *[0.0] * (n - 1)]
    model = {
        "name": "long",
        "coordinates": names,
        "mass": eye,
        "damping": eye,
        "stiffness": eye,
        "contacts": [{"name": "c", "direction": direction, "gap": 1.0, "restitution": 0.5}],
    }
    source, written = tmp_path / "long.yaml", tmp_path / "long.json"
    source.write_text(json.dumps(model))
    assert main(["layout", str(source), "-o", str(written)]) == 0
    paths = [
        path
        for config in json.loads(written.read_text("utf-8"))["configById"].values()
        for path in config.get("paths", [])
    ]
    found = {path["value"] for path in paths}
    assert {f"/observer/joint_states.position[{i}]" for i in range(n)} <= found
    assert {path["label"] for path in paths} >= {f"{name} plant" for name in names}
