# SPDX-License-Identifier: Apache-2.0
"""Layouts for Foxglove and PlotJuggler show numbers that bags have."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from plotting_tools import everything, message_path, messages_in, plotjuggler_series, resolved
from systems import system as make_system

from impact_observer.cli.layout import layout
from impact_observer.draw.curves import curves
from impact_observer.draw.layouts import foxglove, plotjuggler
from impact_observer.draw.observer_topics import ObserverTopics
from impact_observer.errors import UsageError
from impact_observer.model import read_model

LAYOUTS = Path(__file__).parents[2] / "layouts"
SHIPPED = {
    "demo": ["observer_geometric", "observer_kinematic"],
    "observer": ["observer"],
}
LAWS = {
    "observer": "geometric",
    "observer_geometric": "geometric",
    "observer_kinematic": "kinematic",
    "observer_minimum_variance": "minimum-variance",
    "observer_unilateral": "unilateral",
}
LUA = {
    "if value > 0 then return time, math.log(value) / math.log(10) end\nreturn {}",
    "if value >= 0 then return time, math.sqrt(value) end\nreturn {}",
}


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[object]]:
    """All messages of a bag in which observers of five names ran."""
    return messages_in(everything(tmp_path_factory.mktemp("all") / "bag", LAWS, duration=1.5))


@pytest.fixture(scope="module")
def series(messages: dict[str, list[object]]) -> dict[str, list[object]]:
    """The same as PlotJuggler's series."""
    found: dict[str, list[object]] = {}
    for topic, each in messages.items():
        for message in each:
            for name, value in plotjuggler_series(topic, message).items():
                found.setdefault(name, []).append(value)
    return found


def drawn(observers: list[str], model: str = "two_mass") -> tuple[str, str]:
    """Both layouts of a model and of the observers with these names."""
    found = curves(read_model(model).system, [ObserverTopics.of_node(name) for name in observers])
    return foxglove(found), plotjuggler(found)


def paths_of(text: str) -> list[str]:
    """Every message path in a Foxglove layout: of plots, states and texts."""
    configs = json.loads(text)["configById"].values()
    paths = [path["value"] for config in configs for path in config.get("paths", [])]
    return paths + [config["topicPath"] for config in configs if "topicPath" in config]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SHIPPED, "all"])
def test_every_path_for_foxglove_finds_a_number_in_the_bag(
    name: str, messages: dict[str, list[object]]
) -> None:
    """Paths follow the grammar of message paths; a panel of texts shows a topic of the bag."""
    text = drawn([*LAWS])[0] if name == "all" else (LAYOUTS / f"{name}.json").read_text("utf-8")
    paths = paths_of(text)
    assert len(paths) > 20
    for path in paths:
        parsed = message_path(path)
        values = [v for each in messages[parsed.topic] for v in resolved(parsed, each)]
        assert values, f"{path} finds nothing"
        if parsed.steps:  # diagnostics are texts, which Foxglove draws as the numbers they are
            assert all(np.isfinite(float(value)) for value in values), path  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [*SHIPPED, "all"])
def test_every_series_for_plotjuggler_is_a_number_in_the_bag(
    name: str, series: dict[str, list[object]]
) -> None:
    """Series are named as PlotJuggler flattens messages; Lua computes transformed series."""
    text = drawn([*LAWS])[1] if name == "all" else (LAYOUTS / f"{name}.xml").read_text("utf-8")
    root = ET.fromstring(text)
    computed = set()
    for snippet in root.iterfind("customMathEquations/snippet"):
        source = snippet.findtext("linked_source")
        assert source in series, source
        assert all(isinstance(value, float) for value in series[source])
        assert snippet.findtext("function") in LUA
        computed.add(snippet.attrib["name"])
    shown = {curve.attrib["name"] for curve in root.iter("curve")}
    assert computed <= shown
    assert len(shown) > 20
    for name_shown in shown - computed:
        assert name_shown in series, name_shown
        assert all(isinstance(value, float) for value in series[name_shown]), name_shown


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("kind", ["json", "xml"])
def test_shipped_layouts_are_what_the_command_writes(name: str, kind: str, tmp_path: Path) -> None:
    """Shipped layouts are byte for byte those of ``impact-observer layout``."""
    written = tmp_path / f"{name}.{kind}"
    assert layout("two_mass", written, observers=SHIPPED[name]) == 0
    assert written.read_bytes() == (LAYOUTS / written.name).read_bytes()


def test_joint_states_of_an_observer_of_any_name_are_series_by_joint() -> None:
    """PlotJuggler names joint states by joint on a topic of any name."""
    names = {curve.attrib["name"] for curve in ET.fromstring(drawn(["watcher"])[1]).iter("curve")}
    assert "/watcher/joint_states/x1/position" in names


def leaves(tree: Any) -> list[str]:  # noqa: ANN401 (of JSON)
    """The panels in a tree of Foxglove's; splits are well formed."""
    if isinstance(tree, str):
        return [tree]
    assert tree["direction"] in {"row", "column"}
    assert 0 < tree["splitPercentage"] < 100
    return leaves(tree["first"]) + leaves(tree["second"])


def test_a_foxglove_layout_shows_each_of_its_panels_once() -> None:
    """One panel has the tabs; every other panel is in exactly one tab."""
    whole = json.loads(drawn(["observer"])[0])
    configs = whole["configById"]
    tabs = configs[whole["layout"]]["tabs"]
    placed = [panel for tab in tabs for panel in leaves(tab["layout"])]
    assert sorted([*placed, whole["layout"]]) == sorted(configs)
    kinds = {panel.partition("!")[0] for panel in configs}
    wanted = {"Tab", "Plot", "StateTransitions", "RawMessages", "DiagnosticSummary", "3D"}
    assert kinds == wanted
    assert set(whole) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}


def test_a_plotjuggler_layout_is_of_splitters_that_count_right() -> None:
    """Beside and under each other; sizes add up; every plot has a title and curves."""
    root = ET.fromstring(drawn(["observer", "observer_minimum_variance"])[1])
    tabs = root.findall("tabbed_widget/Tab")
    assert [tab.attrib["tab_name"] for tab in tabs][:3] == ["positions", "velocities", "errors"]
    for splitter in root.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(splitter) == int(splitter.attrib["count"]) == len(sizes)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-4)
        assert splitter.attrib["orientation"] in {"|", "-"}
    for area in root.iter("DockArea"):
        assert area.attrib["name"]
        assert area.findall("plot/curve")


def test_plant_and_observers_differ_without_colours() -> None:
    """The plant's line is grey and twice as wide; every observer has one colour everywhere."""
    configs = json.loads(drawn(["observer_geometric", "observer_kinematic"])[0])["configById"]
    colours: dict[str, set[str]] = {}
    for name, config in configs.items():
        for path in config["paths"] if name.startswith("Plot!") else []:
            source = path["label"].rpartition(" ")[2]
            colours.setdefault(source, set()).add(path["color"])
            assert path["lineSize"] == (3 if source == "plant" else 1.5)
    assert {len(each) for each in colours.values()} == {1}
    assert len(set.union(*colours.values())) == len(colours) == 3


def test_arrays_that_plotjuggler_does_not_read_are_left_out() -> None:
    """The covariance of six coordinates has more than a hundred numbers, of five fewer."""
    for n, there in ((5, True), (6, False)):
        model = make_system(np.eye(n), np.eye(n), np.eye(n))
        found = curves(model, [ObserverTopics.of_node("observer_minimum_variance")])
        tabs = [tab.attrib["tab_name"] for tab in ET.fromstring(plotjuggler(found)).iter("Tab")]
        assert ("standard deviations" in tabs) == there
        assert "standard deviations" in foxglove(found)


def test_a_contact_with_quotes_in_its_name_is_found() -> None:
    """The path has quotes of the other kind; a name with both kinds is refused in one line."""
    forms = {"a'b": '{contact=="a\'b"}', 'a"b': "{contact=='a\"b'}"}
    for name, wanted in forms.items():
        assert any(wanted in path for path in paths_of(foxglove(curves(named(name), OBSERVER))))
    with pytest.raises(UsageError, match=r"both kinds of quotes"):
        curves(named("a'\"b"), OBSERVER)


OBSERVER = [ObserverTopics.of_node("observer")]


def named(contact: str) -> Any:  # noqa: ANN401 (a System)
    """The system two_mass whose contact has another name."""
    from dataclasses import replace

    whole = read_model("two_mass").system
    return replace(whole, contacts=(replace(whole.contacts[0], name=contact),))
