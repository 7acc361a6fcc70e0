# SPDX-License-Identifier: Apache-2.0
"""A simulated robot that hits something, its observer, and the robot as estimated for RViz.

    ros2 launch impact_observer robot.launch.py
    rviz2 -f base    # Add a RobotModel with the description topic /observer/robot_description

The observer receives impacts, encoders and efforts only. Compare `/observer/joint_states` with
`/plant/joint_states`. A robot of one's own: model:=arm.yaml measurements:=encoders.yaml
record:=FOLDER makes a bag. Security is the environment of ros2 launch (docs/security.md).
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from impact_observer.model import read_model
from impact_observer.ros.wiring import following, local_discovery, recording

ARGUMENTS = {
    "model": ("hammer_arm", "a model file of a robot, or a sample's name"),
    "measurements": ("hammer_arm", "a file with its encoders, or a sample's name"),
    "measurement_rate": ("100.0", "of the encoders [Hz]"),
    "clock_error": ("0.0002", "standard deviation of the stamps of impacts [s]"),
    "rate": ("100.0", "true states and estimates [Hz]"),
    "duration": ("0.0", "of the simulation [s]; 0 for no end"),
}


def generate_launch_description() -> LaunchDescription:
    """The arguments, the plant, the observer, and the publisher of frames of the estimate."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            *local_discovery(),
            *recording(),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    rate, error = float(given["rate"]), float(given["clock_error"])
    both = {"model": given["model"], "measurements": given["measurements"], "rate": rate}
    plant = {
        "measurement_rate": float(given["measurement_rate"]),
        "duration": float(given["duration"]),
        "sensor.jitter": error,
    }
    observer = {"law": "minimum-variance", "clock_error": error}
    return [
        _node("plant", {**both, **plant}),
        _node("observer", {**both, **observer}),
        *_frames(given["model"]),
    ]


def _frames(model: str) -> list[Node]:
    """What moves the robot's URDF by the estimates; none where the URDF comes on a topic."""
    robot = read_model(model).robot
    if robot is None or robot.urdf is None:
        return []
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="observer_robot",
            parameters=[{"robot_description": ParameterValue(robot.urdf.text, value_type=str)}],
            remappings=[
                ("joint_states", "observer/joint_states"),
                ("robot_description", "observer/robot_description"),
            ],
            output="screen",
            additional_env=following(),
        )
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
