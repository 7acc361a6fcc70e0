# SPDX-License-Identifier: Apache-2.0
"""Services of running nodes, called from this process: no request ends a node."""

import random
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer_msgs.srv import SetState
from processes import Spinner, hosted, interrupt, ros_arguments, running_node, spinning
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
from rclpy.qos import qos_profile_parameters
from std_srvs.srv import Trigger
from type_description_interfaces.srv import GetTypeDescription

from impact_observer.ros.entry import NODES
from impact_observer.ros.observer_node import ObserverNode

pytestmark = pytest.mark.ros

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


def test_each_parameter_has_an_answer_of_its_own(ros_environment: dict[str, str]) -> None:
    """Values that can be used are set beside others, each of which is refused with its reason."""
    assert ros_environment
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
