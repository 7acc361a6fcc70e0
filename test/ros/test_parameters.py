# SPDX-License-Identifier: Apache-2.0
"""Parameters and services of nodes: wrong ones are told, and no request ends a node."""

import random
import re
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

import yaml  # type: ignore[import-untyped]
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.srv import SetState
from processes import Spinner, hosted, interrupt, refusal, ros_arguments, running_node, spinning
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.client import Client
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameters
from std_srvs.srv import Trigger
from type_description_interfaces.srv import GetTypeDescription

from impact_observer.io.interfaces import STATES
from impact_observer.ros.entry import NODES
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.plant_node import PlantNode
from impact_observer.ros.topics import qos_profile

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]


@pytest.mark.parametrize(
    ("module", "parameters", "expected"),
    [
        ("observer", {}, "parameter model: is not set"),
        ("observer", {}, "a sample: give --ros-args -p model:=FILE"),
        ("observer", {"model": "nothing.yaml"}, "nothing.yaml: no such file"),
        ("observer", {"model": "two_mass", "law": "magic"}, "law 'magic': not installed"),
        ("observer", {"model": "two_mass", "rate": -1.0}, "parameter rate"),
        ("observer", {"model": "two_mass", "rate": "[]"}, "parameter rate: None found"),
        ("observer", {"model": "two_mass", "history": 1e300}, "parameter history"),
        ("observer", {"model": "two_mass", "initial_state": "one"}, "initial state 'one'"),
        ("plant", {"model": "two_mass", "realtime_factor": 2.0}, "needs publish_clock"),
        ("plant", {"model": "two_mass", "duration": 1e300}, "parameter duration"),
        ("plant", {"model": "two_mass", "sensor.mislabelled": 0.1}, "sensor mislabelled"),
        ("observer", {"model": "two_mass", "use_sim_time": "banana"}, "use_sim_time"),
        ("observer", {"model": "two_mass", "lag": 3.0, "history": 2.0}, "parameter lag"),
        ("detector", {}, "parameter sources: is not set"),
        ("detector", {"sources": "no.yaml"}, "no.yaml"),
        ("detector", {"sources": "switch", "epoch": -1}, "parameter epoch"),
        ("monitor", {"model": "two_mass", "law": 3}, "parameter law"),
    ],
)
def test_a_wrong_parameter_is_one_line_and_exit_code_2(
    capfd: pytest.CaptureFixture[str], module: str, parameters: dict[str, object], expected: str
) -> None:
    """The line names the parameter, the value and the values that are expected."""
    arguments = ros_arguments(parameters)
    line = refusal(module, arguments, capfd)
    assert line.startswith(f"{module}: ")
    assert expected in line


def test_misspelt_parameters_give_a_warning_in_log_and_diagnostics(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """ROS ignores such parameters, on the command line and in files, also beside an empty list."""
    file = tmp_path / "parameters.yaml"
    text = "/**: {ros__parameters: {estimate_parameters: [], sensor: {jitter: 1.0}}}\n"
    file.write_text(f"{text}plant: {{ros__parameters: {{step: 1.0}}}}\n", encoding="utf-8")
    arguments = ros_arguments({"model": "two_mass", "lwa": "kinematic", "observer:rat": 1.0})
    arguments += ["-p", "monitor:laws:=x", "--params-file", str(file)]
    statuses: dict[str, DiagnosticStatus] = {}
    with spinning(arguments) as spinner:
        spinner.add(ObserverNode())
        spinner.probe.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda array: statuses.update({each.name: each for each in array.status}),
            qos_profile(STATES),
        )
        spinner.until(lambda: "/observer: node" in statuses)
    errors = "".join(capfd.readouterr())
    status = statuses["/observer: node"]
    assert status.level == DiagnosticStatus.WARN
    assert "parameter lwa does not exist and is ignored; expected " in status.message
    unknown = re.findall(r"parameter (\S+) does not exist", errors)
    assert unknown == ["lwa", "rat", "sensor.jitter"]


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


def test_what_a_node_says_of_its_parameters_is_a_file_that_it_loads(tmp_path: Path) -> None:
    """With the read-only ones, and with a value that was set while the node ran."""
    given = {"model": "two_mass", "law": "minimum-variance", "rate": 20, "sensor.jitter": 0.001}
    for make, name in ((ObserverNode, "observer"), (PlantNode, "plant")):
        with hosted(make, given) as (_, spinner):
            if name == "observer":
                lag = Parameter(name="lag", value=ParameterValue(type=3, double_value=0.25))
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


OF_ALL: dict[str, Any] = {
    "describe_parameters": DescribeParameters,
    "get_parameters": GetParameters,
    "get_parameter_types": GetParameterTypes,
    "list_parameters": ListParameters,
    "set_parameters": SetParameters,
    "set_parameters_atomically": SetParametersAtomically,
    "get_type_description": GetTypeDescription,
}
OF_SOME = {"plant": {"reset": Trigger}, "observer": {"reset": Trigger, "set_state": SetState}}
NUMBERS = [0.0, -1.0, 50.0, 1e308, float("inf"), float("nan")]
REQUESTS = 80


def value(draw: random.Random) -> ParameterValue:
    """Any value of any type, also of types that do not exist."""
    return ParameterValue(
        type=draw.choice([*range(10), 10, 77, 255]),
        bool_value=draw.random() < 0.5,
        integer_value=draw.choice([0, 7, -(2**63), 2**63 - 1]),
        double_value=draw.choice(NUMBERS),
        string_value=draw.choice(["", "zero", "x" * 1000, "\x1b[2J", "1,2"]),
        byte_array_value=[b"\x00", b"\xff"],
        bool_array_value=[True],
        integer_array_value=[1, 2],
        double_array_value=draw.choices(NUMBERS, k=2),
        string_array_value=["", "ü"],
    )


def request(kind: Any, draw: random.Random) -> Any:  # noqa: ANN401 (a service has no base class)
    """A request with names that exist, and with others."""
    made = kind.Request()
    names = ["rate", "lag", "model", "seed", "sources", "amplitude", "", "x" * 500, "\n", "ü"]
    count = draw.choice([0, 1, 2, 5, 1500] if draw.random() < 0.3 else [3])
    if kind in {SetParameters, SetParametersAtomically}:
        given = [Parameter(name=draw.choice(names), value=value(draw)) for _ in range(count)]
        made.parameters = given
    elif kind is ListParameters:
        made.prefixes, made.depth = draw.choices(names, k=count), draw.choice([0, 1, 2**64 - 1])
    elif kind is GetTypeDescription:
        made.type_name, made.type_hash = draw.choice(names), draw.choice(["", "RIHS01_0", "x"])
    elif kind is SetState:
        made.position, made.velocity = draw.choices(NUMBERS, k=2), draw.choices(NUMBERS, k=2)
        made.covariance = draw.choices(NUMBERS, k=draw.choice([0, 1, 16]))
    elif kind is not Trigger:
        made.names = draw.choices(names, k=count)
    return made


def clients(spinner: Spinner, node: str) -> dict[Client, Any]:
    """A client of each service of ``node``, which keeps as many answers as it asks for."""
    kinds = OF_ALL | OF_SOME.get(node, {})
    return {
        spinner.probe.create_client(kind, f"{node}/{name}", qos_profile=qos_profile_parameters): (
            kind
        )
        for name, kind in kinds.items()
    }


def answers(spinner: Spinner, calls: list[tuple[Client, Any]]) -> list[Any]:
    """Send all requests at once, and wait for all answers."""
    futures = [client.call_async(each) for client, each in calls]
    spinner.until(lambda: all(each.done() for each in futures))
    return [each.result() for each in futures]


def test_no_request_ends_a_node(ros_environment: dict[str, str]) -> None:
    """A request that has no answer, as of an unknown type, leaves those after it theirs."""
    given = {"model": "two_mass"}
    draw = random.Random(1)
    with ExitStack() as stack:
        processes = {
            name: stack.enter_context(
                running_node(
                    name,
                    ros_arguments({"sources": "switch"} if name == "detector" else given),
                    ros_environment,
                )
            )
            for name in NODES
        }
        spinner = stack.enter_context(spinning())
        for name, process in processes.items():
            services = clients(spinner, name)
            for each in services:
                spinner.until(each.service_is_ready)
            for each in draw.choices([*services], k=REQUESTS):
                each.call_async(request(services[each], draw))
            ask = next(each for each, kind in services.items() if kind is ListParameters)
            (listed,) = answers(spinner, [(ask, ListParameters.Request())])
            assert "use_sim_time" in listed.result.names
            assert interrupt(process)[0] == 0, name


def test_each_parameter_has_an_answer_of_its_own() -> None:
    """Values that can be used are set beside others, each of which is refused with its reason."""
    rate = ParameterValue(type=3, double_value=50.0)
    given = {
        "rate": rate,
        "lag": ParameterValue(type=3, double_value=float("nan")),
        "law": ParameterValue(type=4, string_value="kinematic"),
        "lags": rate,
    }
    together = [Parameter(name="rate", value=ParameterValue(type=3, double_value=20.0))]
    together.append(Parameter(name="lag", value=ParameterValue(type=3, double_value=1e6)))
    with hosted(ObserverNode, {"model": "two_mass"}) as (_, spinner):
        parameters = [Parameter(name=name, value=value) for name, value in given.items()]
        results = spinner.call(
            SetParameters, "observer/set_parameters", parameters=parameters
        ).results
        answer = spinner.call(
            SetParametersAtomically, "observer/set_parameters_atomically", parameters=together
        )
        found = spinner.call(
            GetParameters, "observer/get_parameters", names=["rate", "lag"]
        ).values
    assert [each.successful for each in results] == [True, False, False, False]
    assert "lag" in results[1].reason
    assert "read-only" in results[2].reason
    assert "history" in answer.result.reason
    assert [each.double_value for each in found] == [50.0, 0.0]
