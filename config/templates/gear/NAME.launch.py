"""Detector and observer of NAME, for ROS 2 Jazzy.

    ros2 launch NAME.launch.py epoch:=NANOSECONDS

epoch is the stamp of t = 0 of the swing, in nanoseconds. Leave epoch out where the drive
publishes its pulse at t = 0 on phase_reference.
What these nodes take (rate, use_sim_time, namespace, local, ...) may be given in the same way:
    ros2 launch NAME.launch.py --show-args
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from impact_observer.resources import shared

FOLDER = Path(__file__).resolve().parent
NODES = {
    "detector": {"sources": str(FOLDER / "NAME_sensors.yaml")},
    "observer": {
        "model": str(FOLDER / "NAME.yaml"),  # after a fit: out/fitted.yaml
        "law": "minimum-variance",
        "initial_deviation": "0.01,1.5",  # rad, rad/s: how far and fast the wheel may be
    },
}


def generate_launch_description() -> LaunchDescription:
    """The launch files of the package, with the files of this rig."""
    return LaunchDescription([included(node, given) for node, given in NODES.items()])


def included(node: str, given: dict[str, str]) -> IncludeLaunchDescription:
    """The launch file of a node."""
    source = PythonLaunchDescriptionSource(str(shared(f"launch/{node}.launch.py")))
    return IncludeLaunchDescription(source, launch_arguments=given.items())
