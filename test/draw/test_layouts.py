# SPDX-License-Identifier: Apache-2.0
"""The layouts for Foxglove and PlotJuggler show numbers that a bag of two_mass has."""

import json
import math
import re
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.io import BagReader, BagWriter, EstimateError
from impact_observer.io.messages import bag_messages
from impact_observer.resources import shared

FOXGLOVE = json.loads(shared("layouts/foxglove.json").read_text("utf-8"))
PLOTJUGGLER = ET.parse(shared("layouts/plotjuggler.xml")).getroot()
FUNCTIONS = {"": float, "log10": math.log10, "sqrt": math.sqrt}


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """The messages of a plant, an observer and its monitor, by topic."""
    folder = tmp_path_factory.mktemp("layouts")
    bag = str(folder / "bag")
    observe = ["observe", str(shared("bags/two_mass")), "--law", "minimum-variance"]
    assert main([*observe, "--duration", "2", "-o", bag]) == 0
    with BagReader(folder / "bag") as reader:
        found = {t: [each for _, each in reader.messages(t)] for t in reader.topics}
    make, error = bag_messages(), np.array([1e-3, -1e-3])
    with BagWriter(folder / "nodes") as writer:
        estimate = EstimateError(1, "minimum-variance", 1e-6, ("x1", "x2"), error, error)
        writer.write("/monitor/error", 1, make.estimate_error(estimate))
        writer.write("/observer/bound", 1, make.estimate_error(estimate))
    with BagReader(folder / "nodes") as reader:
        return found | {t: [each for _, each in reader.messages(t)] for t in reader.topics}


def walked(value: Any, path: str) -> list[Any]:  # noqa: ANN401 (of messages)
    """The values of ``.name``, ``[index]``, ``[:]`` and ``{name=="text"}`` in a message."""
    for step in re.findall(r"\.\w+|\[[\d:]+\]|\{[^}]+\}", path):
        values = value if isinstance(value, list) and step[0] != "[" else [value]
        if step[0] == ".":
            value = [getattr(each, step[1:]) for each in values]
        elif step[0] == "{":
            name, text = step[1:-1].split("==")
            value = [each for each in values if getattr(each, name) == text.strip('"')]
        else:
            (value,) = value
            value = list(value) if step == "[:]" else [value[int(step[1:-1])]]
    return list(value)


def leaves(tree: Any) -> list[str]:  # noqa: ANN401 (of JSON)
    """The panels in a tree of Foxglove's."""
    return [tree] if isinstance(tree, str) else [*leaves(tree["first"]), *leaves(tree["second"])]


def test_every_path_for_foxglove_finds_a_number_in_the_bag(
    messages: dict[str, list[Any]],
) -> None:
    """Every panel is shown once."""
    panels = FOXGLOVE["configById"]
    assert sorted(leaves(FOXGLOVE["layout"])) == sorted(panels)
    paths = [each["value"] for panel in panels.values() for each in panel.get("paths", [])]
    assert len(paths) > 8
    for path in paths:
        whole, _, function = path.partition(".@")
        topic, rest = re.fullmatch(r"([/\w]+)(\..*)", whole).groups()  # type: ignore[union-attr]
        found = [each for message in messages[topic] for each in walked(message, rest)]
        assert found, path
        assert all(np.isfinite(FUNCTIONS[function](each)) for each in found), path


def test_every_series_for_plotjuggler_is_a_number_in_the_bag(
    messages: dict[str, list[Any]],
) -> None:
    """Joint states go by the joint; a computed series names its source."""
    snippets = PLOTJUGGLER.findall("customMathEquations/snippet")
    computed = {each.attrib["name"]: str(each.findtext("linked_source")) for each in snippets}
    shown = [curve.attrib["name"] for curve in PLOTJUGGLER.iter("curve")]
    assert computed.keys() <= set(shown)
    for series in (computed.get(name, name) for name in shown):
        topic = next(each for each in messages if series.startswith(f"{each}/"))
        message, rest = messages[topic][-1], series.removeprefix(f"{topic}/")
        joint, _, field = rest.partition("/")
        if field:
            rest = f"{field}[{list(message.name).index(joint)}]"
        (value,) = walked(message, f".{rest}")
        assert np.isfinite(float(value)), series
