# SPDX-License-Identifier: Apache-2.0
"""The plant alone: a simulated system that publishes its impacts and its true states.

    ros2 launch impact_observer plant.launch.py model:=two_mass publish_clock:=true

An argument beats params_file; one that is left out stays as the file, else the node, has it.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from impact_observer.options import Option
from impact_observer.ros.parameters import PLANT
from impact_observer.ros.wiring import following, local_discovery

PARAMETERS = (*PLANT, Option("use_sim_time", False, "follow a /clock that is not the plant's"))


def generate_launch_description() -> LaunchDescription:
    """The arguments and the node."""
    return LaunchDescription(
        [
            *(_argument(each) for each in PARAMETERS),
            DeclareLaunchArgument(
                "params_file",
                default_value="",
                description="a file such as config/nodes/plant.yaml",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the node and its topics"
            ),
            *local_discovery(),
            OpaqueFunction(function=_plant),
        ]
    )


def _argument(parameter: Option) -> DeclareLaunchArgument:
    """A parameter as an argument; empty means: as params_file or the node has it."""
    return DeclareLaunchArgument(
        parameter.name, default_value="", description=parameter.description
    )


def _plant(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    values = {
        each.name: ParameterValue(LaunchConfiguration(each.name), value_type=each.value_type)
        for each in PARAMETERS
        if given[each.name]
    }
    return [
        Node(
            package="impact_observer",
            executable="plant",
            name="plant",
            namespace=given["namespace"],
            parameters=[*filter(None, (given["params_file"], values))],
            output="screen",
            additional_env=following(),
        )
    ]
