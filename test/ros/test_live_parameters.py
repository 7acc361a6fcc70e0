# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node, by services that others call."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

import yaml  # type: ignore[import-untyped]
from processes import Spinner, hosted, spinning
from rcl_interfaces.msg import Parameter as Given
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python

from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.plant_node import PlantNode

pytestmark = pytest.mark.ros

EPOCH = 5_000_000_000


def parameters_of(spinner: Spinner, node: str) -> dict[str, object]:
    """All parameters that a node lists, with their values."""
    names = spinner.call(ListParameters, f"{node}/list_parameters").result.names
    values = spinner.call(GetParameters, f"{node}/get_parameters", names=names).values
    return dict(zip(names, map(parameter_value_to_python, values), strict=True))


def file_of(parameters: dict[str, object]) -> str:
    """The text that ``ros2 param dump`` prints: names with dots are nested."""
    nested: dict[str, Any] = {}
    for name, value in parameters.items():
        *groups, last = name.split(".")
        place = nested
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    return str(yaml.dump({"/**": {"ros__parameters": nested}}, default_flow_style=False))


def test_what_a_node_says_of_its_parameters_is_a_file_that_it_loads(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """With the read-only ones, and with a value that was set while the node ran."""
    assert ros_environment
    given = {"model": "two_mass", "law": "minimum-variance", "rate": 20, "sensor.jitter": 0.001}
    for make, name in ((ObserverNode, "observer"), (PlantNode, "plant")):
        with hosted(make, given) as (_, spinner):
            if name == "observer":
                lag = Given(name="lag", value=Parameter("lag", value=0.25).get_parameter_value())
                service = "observer/set_parameters_atomically"
                answer = spinner.call(SetParametersAtomically, service, parameters=[lag])
                assert answer.result.successful, answer.result.reason
            said = parameters_of(spinner, name)
        assert said.get("lag") == (0.25 if name == "observer" else None)
        path = tmp_path / f"{name}.yaml"
        path.write_text(file_of(said), encoding="utf-8")
        with spinning(["--ros-args", "--params-file", str(path)]) as spinner:
            spinner.add(make())
            assert parameters_of(spinner, name) == said
