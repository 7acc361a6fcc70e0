# SPDX-License-Identifier: Apache-2.0
"""Topics and services of each node, and the SROS2 policies that allow no others.

A policy (https://design.ros2.org/articles/ros2_access_control_policies.html) has an enclave for
each node, in a file of its own, made by ``./dev docs`` from the table here.
"""

from collections.abc import Iterable
from typing import NamedTuple

from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface

FOLDER = "config/sros2"
"""Folder of the policies."""
_PARAMETERS = ("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters")
_SETTING = ("set_parameters", "set_parameters_atomically")
_TRANSITIONS = ("change_state", "get_available_transitions", "get_transition_graph")
_STATES = ("get_state", "get_available_states")
_OF_RCLPY = (*_PARAMETERS, *_SETTING, *_TRANSITIONS, *_STATES, "get_type_description")
OF_EVERY_NODE = tuple(f"~/{each}" for each in _OF_RCLPY)
"""Services of parameters, of the life cycle and of types."""
LOGS, CHANGES, TRANSITIONS = "/rosout", "/parameter_events", "~/transition_event"
TOPICS_OF_EVERY_NODE = (LOGS, CHANGES, TRANSITIONS, interfaces.DIAGNOSTIC_ARRAYS.name)
"""Topics that every node publishes."""


class Access(NamedTuple):
    """Topics and services of a node.

    Attributes:
        publishes: topics.
        subscribes: topics; those of sensors come from files of detector and observer.
        serves: names of services.
    """

    publishes: tuple[Interface, ...]
    subscribes: tuple[Interface, ...]
    serves: tuple[str, ...] = ()


SENSOR = Interface("switch", "std_msgs/msg/Bool")
"""The sensor of the sample ``config/detector/switch.yaml``."""
ENCODER = Interface("encoder", interfaces.JOINT_STATE)
"""The sensor of the sample ``config/measurements/encoder.yaml``."""
LIVE = (interfaces.FORCING,)
"""Topics of a node whose model has live forces."""
NODES = {
    "plant": Access(
        (
            interfaces.IMPACTS,
            interfaces.PLANT_JOINT_STATES,
            interfaces.PLANT_MODEL,
            interfaces.SIMULATED_CLOCK,
        ),
        LIVE,
        ("~/reset",),
    ),
    "observer": Access(
        (
            interfaces.OBSERVER_STATES,
            interfaces.OBSERVER_JOINT_STATES,
            interfaces.OBSERVER_VERDICTS,
            interfaces.OBSERVER_MEASUREMENTS,
            interfaces.OBSERVER_BOUND,
        ),
        (interfaces.IMPACTS, *LIVE, interfaces.PHASE_REFERENCE, ENCODER),
        ("~/reset", "~/set_state"),
    ),
    "detector": Access((interfaces.IMPACTS,), (SENSOR, interfaces.PHASE_REFERENCE)),
    "monitor": Access(
        (interfaces.MONITOR_ERROR,),
        (interfaces.PLANT_JOINT_STATES, interfaces.OBSERVER_JOINT_STATES),
    ),
}
"""Topics and services of each node, by its executable."""


def policy(node: str) -> str:
    """The policy of a node of this name, without a namespace, as XML."""
    access = NODES[node]
    published = [*(each.name for each in access.publishes), *TOPICS_OF_EVERY_NODE]
    subscribed = [*(each.name for each in access.subscribes), interfaces.SIMULATED_CLOCK.name]
    served = [*access.serves, *OF_EVERY_NODE]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<!-- Made by ./dev docs: all that the node {node} needs. See docs/security.md. -->",
        '<policy version="0.2.0">',
        "  <enclaves>",
        f'    <enclave path="/impact_observer/{node}">',
        "      <profiles>",
        f'        <profile ns="/" node="{node}">',
        *_group("topics", 'publish="ALLOW"', published),
        *_group("topics", 'subscribe="ALLOW"', dict.fromkeys(subscribed)),
        *_group("services", 'reply="ALLOW"', served),
        "        </profile>",
        "      </profiles>",
        "    </enclave>",
        "  </enclaves>",
        "</policy>",
    ]
    return "\n".join(lines) + "\n"


def _group(kind: str, right: str, names: Iterable[str]) -> list[str]:
    """The lines that allow something on some topics or services."""
    one = kind.removesuffix("s")
    inside = [f"            <{one}>{name}</{one}>" for name in names]
    return [f"          <{kind} {right}>", *inside, f"          </{kind}>"]
