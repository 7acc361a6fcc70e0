# SPDX-License-Identifier: Apache-2.0
"""The detector of a rig, or of a bag that is played, whose sensors publish what they feel.

    ros2 launch impact_observer detector.launch.py sources:=rig_sensors.yaml

An argument beats params_file; one that is left out stays as the file, else the node, has it.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from impact_observer.options import Option
from impact_observer.ros.parameters import DETECTOR
from impact_observer.ros.wiring import (
    following,
    given_parameters,
    local_discovery,
    parameter_arguments,
)

PARAMETERS = (
    *DETECTOR,
    Option("use_sim_time", False, "follow /clock, of a simulation or a bag"),
)


def generate_launch_description() -> LaunchDescription:
    """The arguments and the node."""
    return LaunchDescription(
        [
            *parameter_arguments(PARAMETERS, "detector"),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the node and its topics"
            ),
            DeclareLaunchArgument(
                "impacts", default_value="impacts", description="the topic of the impacts"
            ),
            *local_discovery(),
            OpaqueFunction(function=_detector),
        ]
    )


def _detector(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    return [
        Node(
            package="impact_observer",
            executable="detector",
            name="detector",
            namespace=given["namespace"],
            parameters=given_parameters(given, PARAMETERS),
            remappings=[("impacts", given["impacts"])],
            output="screen",
            additional_env=following(),
        )
    ]
