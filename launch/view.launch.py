# SPDX-License-Identifier: Apache-2.0
"""Plant and estimates side by side: the node viewer, and RViz to look at what it publishes.

    ros2 launch impact_observer demo.launch.py
    ros2 launch impact_observer view.launch.py model:=two_mass observers:=observer_geometric

An argument beats params_file; one that is left out stays as the file, else the node, has it.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from impact_observer.options import Option
from impact_observer.ros.parameters import VIEWER
from impact_observer.ros.wiring import following, local_discovery

RVIZ = "rviz2"
LAYOUT = Path(__file__).resolve().parents[1] / "layouts" / "view.rviz"
PARAMETERS = (
    *VIEWER,
    Option("use_sim_time", False, "follow /clock, of a simulation or a bag"),
)


def generate_launch_description() -> LaunchDescription:
    """The arguments, the viewer, and RViz if it is wanted."""
    return LaunchDescription(
        [
            *(_argument(each) for each in PARAMETERS),
            DeclareLaunchArgument(
                "params_file", default_value="", description="a file with the viewer's parameters"
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the nodes and their topics"
            ),
            DeclareLaunchArgument(
                "impacts", default_value="impacts", description="the topic of the impacts"
            ),
            DeclareLaunchArgument(
                "rviz", default_value="true", description="whether to start RViz too"
            ),
            DeclareLaunchArgument(
                "rviz_config", default_value=str(LAYOUT), description="what RViz shows"
            ),
            *local_discovery(),
            OpaqueFunction(function=_nodes),
        ]
    )


def _argument(parameter: Option) -> DeclareLaunchArgument:
    """A parameter as an argument; empty means: as params_file or the node has it."""
    return DeclareLaunchArgument(
        parameter.name, default_value="", description=parameter.description
    )


def _nodes(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    values = {
        each.name: ParameterValue(LaunchConfiguration(each.name), value_type=each.value_type)
        for each in PARAMETERS
        if given[each.name]
    }
    viewer = Node(
        package="impact_observer",
        executable="viewer",
        name="viewer",
        namespace=given["namespace"],
        parameters=[*filter(None, (given["params_file"], values))],
        remappings=[("impacts", given["impacts"])],
        output="screen",
        additional_env=following(),
    )
    rviz = Node(
        package=RVIZ,
        executable=RVIZ,
        name="rviz",
        namespace=given["namespace"],
        arguments=["-d", given["rviz_config"]],
        remappings=[("/viewer/markers", "viewer/markers")],  # below the namespace
        output="screen",
        additional_env=following(),
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return [viewer, rviz]
