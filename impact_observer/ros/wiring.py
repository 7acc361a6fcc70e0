# SPDX-License-Identifier: Apache-2.0
"""The nodes of the demonstration: one list for the demo command and the launch file.

Imports no ROS, so that launch files and tests can read it.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from impact_observer.options import Value

FOLLOW = "IMPACT_OBSERVER_FOLLOW"
"""Environment variable with the id of a parent process; this process ends when the parent does."""
DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""Environment variable that says how far away nodes are discovered."""
LOCAL = "LOCALHOST"
"""Its value for: on this machine only."""


def following() -> dict[str, str]:
    """The environment of a process that ends with this one."""
    return {FOLLOW: str(os.getpid())}


def local_discovery() -> tuple[Any, Any]:
    """For launch files: the argument ``local``, and what it does to all nodes that follow."""
    # Not at the top: the demo command needs no launch.
    from launch.actions import (
        DeclareLaunchArgument,
        SetEnvironmentVariable,
    )
    from launch.conditions import IfCondition
    from launch.substitutions import LaunchConfiguration

    meaning = "whether only nodes on this machine are discovered"
    wanted = IfCondition(LaunchConfiguration("local"))
    return (
        DeclareLaunchArgument("local", default_value="false", description=meaning),
        SetEnvironmentVariable(DISCOVERY, LOCAL, condition=wanted),
    )


@dataclass(frozen=True, slots=True)
class NodeSetup:
    """How a node is started.

    Attributes:
        executable: ``plant``, ``observer`` or ``monitor``.
        name: the node's name.
        parameters: those that differ from the defaults.
        remappings: new names of topics, by the node's own.
    """

    executable: str
    name: str
    parameters: Mapping[str, Value]
    remappings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DemoSetup:
    """What the demonstration runs.

    Attributes:
        model: a model file or a sample's name.
        laws: each has an observer and a monitor.
        initial: the observers' initial state, as on the command line.
        duration: simulated seconds; 0 for no end.
        realtime_factor: simulated seconds a second.
        rate: true states and estimates, Hz.
        epoch: stamp of ``t = 0``, ns.
    """

    model: str
    laws: Sequence[str]
    initial: str
    duration: float
    realtime_factor: float
    rate: float
    epoch: int


def observer_name(law: str) -> str:
    """Name of the observer node of a law."""
    return f"observer_{law.replace('-', '_')}"


def monitor_name(law: str) -> str:
    """Name of the monitor node of a law's observer."""
    return f"monitor_{law.replace('-', '_')}"


def plant(setup: DemoSetup, recorders: int = 0) -> NodeSetup:
    """The plant; it starts when all observers or monitors, and ``recorders``, have subscribed."""
    return NodeSetup(
        "plant",
        "plant",
        {
            "model": setup.model,
            "rate": setup.rate,
            "epoch": setup.epoch,
            "duration": setup.duration,
            "publish_clock": True,
            "clock_rate": max(setup.rate, 100.0),
            "realtime_factor": setup.realtime_factor,
            "wait_for_subscribers": len(setup.laws) + recorders,
        },
    )


def observers(setup: DemoSetup) -> tuple[NodeSetup, ...]:
    """An observer for each law."""
    return tuple(
        NodeSetup(
            "observer",
            observer_name(law),
            {
                "use_sim_time": True,
                "model": setup.model,
                "law": law,
                "initial_state": setup.initial,
                "rate": setup.rate,
                "epoch": setup.epoch,
                "events_durability": "transient_local",
            },
        )
        for law in setup.laws
    )


def monitors(setup: DemoSetup) -> tuple[NodeSetup, ...]:
    """A monitor for each law's observer."""
    return tuple(
        NodeSetup(
            "monitor",
            monitor_name(law),
            {"use_sim_time": True, "model": setup.model, "law": law},
            {"observer/joint_states": f"{observer_name(law)}/joint_states"},
        )
        for law in setup.laws
    )
