# SPDX-License-Identifier: Apache-2.0
"""Plant and estimates side by side: the node viewer, robots of the estimates, and RViz.

    ros2 launch impact_observer demo.launch.py
    ros2 launch impact_observer view.launch.py model:=two_mass observers:=observer_geometric

An argument beats params_file; one that is left out stays as the file, else the node, has it.
With the argument model, robot_state_publisher moves a robot by the joint states of each observer.
A model with a URDF has no markers: RViz shows the robot of the first observer.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from impact_observer.draw.urdf_text import model_urdf
from impact_observer.io.interfaces import OBSERVER_JOINT_STATES
from impact_observer.model import Model, read_model
from impact_observer.model.robot_description import RobotDescription
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
    """The arguments, the viewer, and the robots and RViz if they are wanted."""
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
                "robots", default_value="true", description="whether estimates move robots, too"
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
    observers = [each.strip() for each in (given["observers"] or "observer").split(",")]
    model = read_model(given["model"]) if given["model"] else None
    robot = None if model is None else model.robot
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
        arguments=["-d", given["rviz_config"], *_fixed_frame(robot)],
        remappings=[  # below the namespace
            ("/viewer/markers", "viewer/markers"),
            ("/observer/robot_description", f"{observers[0]}/robot_description"),
        ],
        output="screen",
        additional_env=following(),
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    robots = [] if model is None else _robots(context, model, observers)
    return [*([viewer] if robot is None else []), *robots, rviz]


def _fixed_frame(robot: RobotDescription | None) -> list[str]:
    """Arguments of RViz: the frame of the layout, but of a robot its first link."""
    return [] if robot is None else ["-f", robot.known_urdf.root_link]


def _robots(context: LaunchContext, model: Model, observers: list[str]) -> list[Node]:
    """One robot_state_publisher for each observer, in the place of its markers.

    A URDF has the same links for all observers, so that frames of all but the first have a prefix.
    """
    given, kind = context.launch_configurations, "robot_state_publisher"
    frame, amplitude = given["frame"] or "world", float(given["amplitude"] or 0)
    robots = []
    for row, observer in enumerate(observers, start=1):
        own = observer.rpartition("/")[2]
        text = model_urdf(model, prefix=f"{own}_", frame=frame, row=row, amplitude=amplitude)
        parameters = {"robot_description": ParameterValue(text, value_type=str)}
        if model.robot is not None and row > 1:
            parameters["frame_prefix"] = ParameterValue(f"{own}/", value_type=str)
        if given["use_sim_time"]:
            clock = LaunchConfiguration("use_sim_time")
            parameters["use_sim_time"] = ParameterValue(clock, value_type=bool)
        states = OBSERVER_JOINT_STATES.name_under(observer)
        robots.append(
            Node(
                package=kind,
                executable=kind,
                name=f"{own}_robot",
                namespace=given["namespace"],
                parameters=[parameters],
                remappings=[
                    ("joint_states", states),
                    ("robot_description", f"{observer}/robot_description"),
                ],
                output="screen",
                additional_env=following(),
                condition=IfCondition(LaunchConfiguration("robots")),
            )
        )
    return robots
