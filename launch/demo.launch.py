"""The nodes of `impact-observer demo`: a plant, two observers of it, and their monitors.

    ros2 launch impact_observer demo.launch.py model:=three_mass duration:=0.0

The observers hear of the plant's impacts and of nothing else, and start from a wrong state. Watch
`/monitor_geometric/error` go to zero, or record with `ros2 bag record -a`.
"""

import time

from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

LAWS = ("geometric", "kinematic")

_CLOCK_RATE = PythonExpression(["max(", LaunchConfiguration("rate"), ", 100.0)"])
"""The observers' timers follow /clock, so it is no slower than they are."""


def generate_launch_description() -> LaunchDescription:
    """The arguments and five nodes; the first that ends, as the plant does, ends all."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "model", default_value="two_mass", description="a model file or a sample's name"
            ),
            DeclareLaunchArgument(
                "duration", default_value="30.0", description="simulated [s]; 0 for no end"
            ),
            DeclareLaunchArgument(
                "realtime_factor", default_value="2.0", description="simulated seconds a second"
            ),
            DeclareLaunchArgument(
                "initial_state",
                default_value="random:1",
                description="of the observers: q1,..,qn,u1,..,un, random:SEED or zero",
            ),
            DeclareLaunchArgument(
                "rate", default_value="100.0", description="true states and estimates [Hz]"
            ),
            DeclareLaunchArgument(
                "epoch", default_value=str(time.time_ns()), description="stamp of t = 0 [ns]; now"
            ),
            *(_observer(law) for law in LAWS),
            *(_monitor(law) for law in LAWS),
            _plant(),
        ]
    )


def _plant() -> Node:
    return Node(
        package="impact_observer",
        executable="plant",
        name="plant",
        parameters=[
            {
                "model": _argument("model", str),
                "rate": _argument("rate", float),
                "epoch": _argument("epoch", int),
                "duration": _argument("duration", float),
                "publish_clock": True,
                "clock_rate": ParameterValue(_CLOCK_RATE, value_type=float),
                "realtime_factor": _argument("realtime_factor", float),
                "wait_for_subscribers": len(LAWS),  # it begins when all of them listen
            }
        ],
        output="screen",
        on_exit=Shutdown(),
    )


def _observer(law: str) -> Node:
    return Node(
        package="impact_observer",
        executable="observer",
        name=f"observer_{law}",
        parameters=[
            {
                "use_sim_time": True,
                "model": _argument("model", str),
                "law": law,
                "initial_state": _argument("initial_state", str),
                "rate": _argument("rate", float),
                "epoch": _argument("epoch", int),
                "events_durability": "transient_local",
            }
        ],
        output="screen",
        on_exit=Shutdown(),
    )


def _monitor(law: str) -> Node:
    return Node(
        package="impact_observer",
        executable="monitor",
        name=f"monitor_{law}",
        parameters=[{"use_sim_time": True, "model": _argument("model", str), "law": law}],
        remappings=[("observer/joint_states", f"observer_{law}/joint_states")],
        output="screen",
        on_exit=Shutdown(),
    )


def _argument(name: str, kind: type) -> ParameterValue:
    return ParameterValue(LaunchConfiguration(name), value_type=kind)
