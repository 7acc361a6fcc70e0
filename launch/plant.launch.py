# SPDX-License-Identifier: Apache-2.0
"""The plant alone: a simulated system that publishes its impacts and its true states.

    ros2 launch impact_observer plant.launch.py model:=two_mass publish_clock:=true

An argument beats params_file; one that is left out stays as the file, else the node, has it.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from impact_observer.options import Option
from impact_observer.ros.parameters import PLANT
from impact_observer.ros.wiring import (
    following,
    given_parameters,
    local_discovery,
    parameter_arguments,
)

PARAMETERS = (*PLANT, Option("use_sim_time", False, "follow a /clock that is not the plant's"))


def generate_launch_description() -> LaunchDescription:
    """The arguments and the node."""
    return LaunchDescription(
        [
            *parameter_arguments(PARAMETERS, "plant"),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the node and its topics"
            ),
            *local_discovery(),
            OpaqueFunction(function=_plant),
        ]
    )


def _plant(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    return [
        Node(
            package="impact_observer",
            executable="plant",
            name="plant",
            namespace=given["namespace"],
            parameters=given_parameters(given, PARAMETERS),
            output="screen",
            additional_env=following(),
        )
    ]
