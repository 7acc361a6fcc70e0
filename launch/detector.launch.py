# SPDX-License-Identifier: Apache-2.0
"""The detector of a rig, or of a bag that is played, whose sensors publish what they feel.

    ros2 launch impact_observer detector.launch.py sources:=rig_sensors.yaml

An argument beats params_file; one that is left out stays as the file, else the node, has it.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from impact_observer.options import Option
from impact_observer.ros.parameters import DETECTOR
from impact_observer.ros.wiring import following, local_discovery

PARAMETERS = (
    *DETECTOR,
    Option("use_sim_time", False, "follow /clock, of a simulation or a bag"),
)


def generate_launch_description() -> LaunchDescription:
    """The arguments and the node."""
    return LaunchDescription(
        [
            *(_argument(each) for each in PARAMETERS),
            DeclareLaunchArgument(
                "params_file",
                default_value="",
                description="a file such as config/nodes/detector.yaml",
            ),
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


def _argument(parameter: Option) -> DeclareLaunchArgument:
    """A parameter as an argument; empty means: as params_file or the node has it."""
    return DeclareLaunchArgument(
        parameter.name, default_value="", description=parameter.description
    )


def _detector(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    values = {
        each.name: ParameterValue(LaunchConfiguration(each.name), value_type=each.value_type)
        for each in PARAMETERS
        if given[each.name]
    }
    return [
        Node(
            package="impact_observer",
            executable="detector",
            name="detector",
            namespace=given["namespace"],
            parameters=[*filter(None, (given["params_file"], values))],
            remappings=[("impacts", given["impacts"])],
            output="screen",
            additional_env=following(),
        )
    ]
