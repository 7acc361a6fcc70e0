# SPDX-License-Identifier: Apache-2.0
"""One observer of a rig, or of a bag that is played, which publishes impacts.

    ros2 launch impact_observer observer.launch.py model:=rig.yaml impacts:=/rig/impacts

An argument beats params_file; one that is left out stays as the file, else the node, has it.
Several observers live side by side under names of their own, such as name:=observer_kinematic.
record:=FOLDER makes a bag. Security is the environment of ros2 launch (docs/security.md).
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from impact_observer.options import Option
from impact_observer.ros.parameters import MONITOR, OBSERVER
from impact_observer.ros.wiring import (
    following,
    given_parameters,
    local_discovery,
    parameter_arguments,
    recording,
)

SIM_TIME = Option("use_sim_time", False, "follow /clock, of a simulation or a bag")
PARAMETERS = (*OBSERVER, SIM_TIME)


def generate_launch_description() -> LaunchDescription:
    """The arguments, the observer, and the monitor if there is to be one."""
    return LaunchDescription(
        [
            *parameter_arguments(PARAMETERS, "observer"),
            DeclareLaunchArgument("name", default_value="observer", description="of the observer"),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the nodes and their topics"
            ),
            DeclareLaunchArgument(
                "impacts", default_value="impacts", description="the topic of the rig's impacts"
            ),
            DeclareLaunchArgument(
                "monitor",
                default_value="false",
                description="whether to compare with the truth on plant/joint_states",
            ),
            DeclareLaunchArgument("monitor_name", default_value="monitor", description="its name"),
            *local_discovery(),
            *recording(),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    observer = Node(
        package="impact_observer",
        executable="observer",
        name=given["name"],
        namespace=given["namespace"],
        parameters=given_parameters(given, PARAMETERS),
        remappings=[("impacts", given["impacts"])],
        output="screen",
        additional_env=following(),
    )
    monitor = Node(
        package="impact_observer",
        executable="monitor",
        name=given["monitor_name"],
        namespace=given["namespace"],
        parameters=given_parameters(given, (*MONITOR, SIM_TIME)),
        remappings=[("observer/joint_states", f"{given['name']}/joint_states")],
        output="screen",
        additional_env=following(),
        condition=IfCondition(LaunchConfiguration("monitor")),
    )
    return [observer, monitor]
