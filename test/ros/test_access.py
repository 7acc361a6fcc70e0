# SPDX-License-Identifier: Apache-2.0
"""The policies of SROS2 against what the running nodes do on the graph."""

import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from processes import spinning
from rclpy.node import Node

from impact_observer.io.access import NODES, OF_EVERY_NODE
from impact_observer.resources import shared
from impact_observer.ros.entry import NODES as CLASSES

OPTIONAL = {"/clock"}
"""Published by a plant that owns the time, received by nodes in simulated time."""
LIVE_MODEL = """\
name: live
bodies: [{name: x, mass: 1}]
grounds: [{name: table, motion: {harmonics: [{amplitude: 0.1, frequency: 3}]}}]
forces: [{body: x, input: motor}, {body: x, amplitude: 1, frequency: 9}]
stops: [{name: plate, between: [table, x], gap: 1, restitution: 0.5}]
initial_state: {position: [0], velocity: [0]}
"""
ENCODER = """\
measurements: [{name: a, topic: encoder, joint: x, quantity: position, deviation: 0.1}]
"""
ARGUMENTS = {"detector": ["-p", "sources:=switch"]}


def allowed(node: str, kind: str, right: str) -> set[str]:
    """The absolute names in the policy that is shipped."""
    root = ET.fromstring(shared(f"config/sros2/{node}.xml").read_text("utf-8"))
    (profile,) = root.iter("profile")
    assert (profile.get("ns"), profile.get("node")) == ("/", node)
    names = {
        str(each.text)
        for group in profile.iter(f"{kind}s")
        if group.get(right) == "ALLOW"
        for each in group.iter(kind)
    }
    return {
        each.replace("~/", f"/{node}/") if each.startswith("~") else f"/{each.lstrip('/')}"
        for each in names
    }


def test_every_node_has_a_policy() -> None:
    """A new one needs a row in ``io/access.py``."""
    assert NODES.keys() == CLASSES.keys()


@pytest.mark.ros
@pytest.mark.parametrize("name", NODES)
def test_a_policy_allows_what_its_node_does_and_nothing_else(
    name: str, ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """The policy has the topics and services of the node."""
    assert ros_environment
    (tmp_path / "live.yaml").write_text(LIVE_MODEL)
    given = ARGUMENTS.get(name, ["-p", f"model:={tmp_path / 'live.yaml'}"])
    if name == "observer":
        (tmp_path / "sensors.yaml").write_text(ENCODER)
        given += ["-p", f"measurements:={tmp_path / 'sensors.yaml'}"]
    with spinning(["--ros-args", *given]) as spinner:
        if name == "observer":
            from sensor_msgs.msg import JointState

            spinner.probe.create_publisher(JointState, "encoder", 10)
        if name == "detector":
            from std_msgs.msg import Bool

            spinner.probe.create_publisher(Bool, "switch", 10)
        node: Node = getattr(import_module(f"impact_observer.ros.{name}_node"), CLASSES[name])()
        spinner.add(node)
        wanted = allowed(name, "topic", "subscribe")

        def found(kind: str) -> set[str]:
            ask = getattr(node, f"get_{kind}_names_and_types_by_node")
            return {each for each, _ in ask(name, "/")}

        spinner.until(lambda: wanted - OPTIONAL <= found("subscriber"))
        assert found("subscriber") - OPTIONAL == wanted - OPTIONAL
        published = found("publisher") - OPTIONAL
        assert published == allowed(name, "topic", "publish") - OPTIONAL
        served = allowed(name, "service", "reply")
        unknown = {each.replace("~", f"/{name}") for each in OF_EVERY_NODE} - found("service")
        assert found("service") == served - unknown
        assert unknown <= {f"/{name}/get_type_description"}
