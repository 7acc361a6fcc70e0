# SPDX-License-Identifier: Apache-2.0
"""A simulated robot that hits something, its observer, and RViz with the robot as estimated.

    ros2 launch impact_observer robot.launch.py rviz:=false

The observer receives impacts, encoders and efforts only. Compare `/observer/joint_states` with
`/plant/joint_states`. A robot of one's own: model:=arm.yaml measurements:=encoders.yaml
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from impact_observer.ros.wiring import following, local_discovery

VIEW = Path(__file__).resolve().parent / "view.launch.py"
ARGUMENTS = {
    "model": ("hammer_arm", "a model file of a robot, or a sample's name"),
    "measurements": ("hammer_arm", "a file with its encoders, or a sample's name"),
    "measurement_rate": ("100.0", "of the encoders [Hz]"),
    "clock_error": ("0.0002", "standard deviation of the stamps of impacts [s]"),
    "rate": ("100.0", "true states and estimates [Hz]"),
    "duration": ("0.0", "of the simulation [s]; 0 for no end"),
    "rviz": ("true", "whether to start RViz too"),
}


def generate_launch_description() -> LaunchDescription:
    """The arguments, plant and observer, and the view."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            *local_discovery(),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node | IncludeLaunchDescription]:
    given = context.launch_configurations
    rate, error = float(given["rate"]), float(given["clock_error"])
    both = {"model": given["model"], "measurements": given["measurements"], "rate": rate}
    plant = {
        "measurement_rate": float(given["measurement_rate"]),
        "duration": float(given["duration"]),
        "sensor.jitter": error,
    }
    observer = {"law": "minimum-variance", "clock_error": error}
    shown = {"model": given["model"], "observers": "observer", "rviz": given["rviz"]}
    return [
        _node("plant", {**both, **plant}),
        _node("observer", {**both, **observer}),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(VIEW)), launch_arguments=shown.items()
        ),
    ]


def _node(name: str, values: dict[str, str | float]) -> Node:
    return Node(
        package="impact_observer",
        executable=name,
        name=name,
        parameters=[
            {key: ParameterValue(value, value_type=type(value)) for key, value in values.items()}
        ],
        output="screen",
        additional_env=following(),
    )
