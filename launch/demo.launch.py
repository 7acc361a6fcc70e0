# SPDX-License-Identifier: Apache-2.0
"""The nodes of `impact-observer demo`: a plant, two observers of it, and their monitors.

    ros2 launch impact_observer demo.launch.py model:=three_mass duration:=0

The observers receive the plant's impacts only, and start from a wrong state. Watch
`/monitor_geometric/error` go to zero, or make a bag by record:=FOLDER. Security is the environment
of ros2 launch (docs/security.md).
"""

import time

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from impact_observer.ros.wiring import (
    DemoSetup,
    NodeSetup,
    following,
    local_discovery,
    monitors,
    observers,
    plant,
    recording,
)


def generate_launch_description() -> LaunchDescription:
    """The arguments and the nodes; the first that ends, as the plant does, ends all."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "model", default_value="two_mass", description="a model file or a sample's name"
            ),
            DeclareLaunchArgument(
                "laws", default_value="geometric,kinematic", description="one observer each"
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
            *local_discovery(),
            *recording(),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    setup = DemoSetup(
        model=given["model"],
        laws=given["laws"].split(","),
        initial_state=given["initial_state"],
        duration=float(given["duration"]),
        realtime_factor=float(given["realtime_factor"]),
        rate=float(given["rate"]),
        epoch=int(given["epoch"]),
    )
    served = plant(setup, recorders=int(bool(given["record"])))
    return [_node(each) for each in (*observers(setup), *monitors(setup), served)]


def _node(node_setup: NodeSetup) -> Node:
    return Node(
        package="impact_observer",
        executable=node_setup.executable,
        name=node_setup.name,
        parameters=[
            {
                name: ParameterValue(value, value_type=type(value))
                for name, value in node_setup.parameters.items()
            }
        ],
        remappings=list(node_setup.remappings.items()),
        output="screen",
        additional_env=following(),
        on_exit=Shutdown(),
    )
