# SPDX-License-Identifier: Apache-2.0
"""What launch files share, and the nodes of the demonstration, which the demo command starts too.

The module imports no ROS, so that launch files and tests can import the module.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from impact_observer.options import Option, Value

FOLLOW = "IMPACT_OBSERVER_FOLLOW"
"""Environment variable with the id of the parent, with whose end a process ends."""
DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""Environment variable with the range within which nodes are discovered."""
LOCAL = "LOCALHOST"
"""Value of ``DISCOVERY`` for discovery on this machine only."""


def following() -> dict[str, str]:
    """The environment variables of a process that ends with this process."""
    return {FOLLOW: str(os.getpid())}


def local_discovery() -> tuple[Any, Any]:
    """The launch argument ``local``, and the action that limits discovery of later nodes."""
    # Imported here, as the demo command needs no launch.
    from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
    from launch.conditions import IfCondition
    from launch.substitutions import LaunchConfiguration

    meaning = "whether only nodes on this machine are discovered"
    wanted = IfCondition(LaunchConfiguration("local"))
    return (
        DeclareLaunchArgument("local", default_value="false", description=meaning),
        SetEnvironmentVariable(DISCOVERY, LOCAL, condition=wanted),
    )


def recording() -> tuple[Any, Any]:
    """The launch argument ``record``, and the action that records all topics into a new bag."""
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    meaning = "a folder to make: a bag of all topics"
    return (
        DeclareLaunchArgument("record", default_value="", description=meaning),
        OpaqueFunction(function=_recorder),
    )


def _recorder(context: Any) -> list[Any]:  # noqa: ANN401 - launch has no types
    """The recorder, if a folder is given."""
    from launch.actions import ExecuteProcess

    folder = context.launch_configurations["record"]
    command = ["ros2", "bag", "record", "-a", "-s", "mcap", "-o", folder]
    return [ExecuteProcess(cmd=command, output="screen")] if folder else []


def parameter_arguments(table: Sequence[Option], sample: str) -> list[Any]:
    """The launch arguments ``params_file``, such as a ``sample``, and one a parameter.

    An argument beats the file; one that is left out stays as the file, else the node, has it.
    """
    from launch.actions import DeclareLaunchArgument

    file = f"a file such as config/nodes/{sample}.yaml"
    return [
        *(
            DeclareLaunchArgument(each.name, default_value="", description=each.description)
            for each in table
        ),
        DeclareLaunchArgument("params_file", default_value="", description=file),
    ]


def given_parameters(given: Mapping[str, str], table: Sequence[Option]) -> list[Any]:
    """The parameters of a node of a launch file by the values of ``parameter_arguments``."""
    from launch.substitutions import LaunchConfiguration
    from launch_ros.parameter_descriptions import ParameterValue

    values = {
        each.name: ParameterValue(LaunchConfiguration(each.name), value_type=each.value_type)
        for each in table
        if given[each.name]
    }
    return [*filter(None, (given["params_file"], values))]


@dataclass(frozen=True, slots=True)
class NodeSetup:
    """A node to start.

    Attributes:
        executable: ``plant``, ``observer`` or ``monitor``.
        name: the node's name.
        parameters: parameters that differ from the defaults.
        remappings: new names of topics, by the names that the node uses.
    """

    executable: str
    name: str
    parameters: Mapping[str, Value]
    remappings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DemoSetup:
    """The plant, laws and times of a demonstration.

    Attributes:
        model: a model file, or the name of a sample.
        laws: laws, each with an observer and a monitor.
        initial_state: initial state of the observers, as on the command line.
        duration: simulated time, s; 0 for no end.
        realtime_factor: simulated seconds per second.
        rate: rate of true states and estimates, Hz.
        epoch: stamp of ``t = 0``, ns.
    """

    model: str
    laws: Sequence[str]
    initial_state: str
    duration: float
    realtime_factor: float
    rate: float
    epoch: int


def node_name(executable: str, law: str) -> str:
    """Name of the ``observer`` or ``monitor`` of a law."""
    return f"{executable}_{law.replace('-', '_')}"


def plant(setup: DemoSetup, recorders: int = 0) -> NodeSetup:
    """The plant, which starts when all observers or monitors, and ``recorders``, subscribe."""
    given: dict[str, Value] = {
        "model": setup.model,
        "rate": setup.rate,
        "epoch": setup.epoch,
        "duration": setup.duration,
        "publish_clock": True,
        "clock_rate": max(setup.rate, 100.0),
        "realtime_factor": setup.realtime_factor,
        "wait_for_subscribers": len(setup.laws) + recorders,
    }
    return NodeSetup("plant", "plant", given)


def observers(setup: DemoSetup) -> list[NodeSetup]:
    """An observer for each law."""
    given: dict[str, Value] = {
        "use_sim_time": True,
        "model": setup.model,
        "initial_state": setup.initial_state,
        "rate": setup.rate,
        "epoch": setup.epoch,
    }
    return [
        NodeSetup("observer", node_name("observer", law), {**given, "law": law})
        for law in setup.laws
    ]


def monitors(setup: DemoSetup) -> list[NodeSetup]:
    """A monitor for each law's observer."""
    given: dict[str, Value] = {"use_sim_time": True, "model": setup.model}
    return [
        NodeSetup(
            "monitor",
            node_name("monitor", law),
            {**given, "law": law},
            {"observer/joint_states": f"{node_name('observer', law)}/joint_states"},
        )
        for law in setup.laws
    ]
