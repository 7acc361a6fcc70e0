"""Which nodes a demonstration consists of: the one list for the demo command and the launch file.

Imports no ROS, so that a launch file may read it and a test may compare.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from impact_observer.options import Value


@dataclass(frozen=True, slots=True)
class Started:
    """A node as it is to be started.

    Attributes:
        executable: ``plant``, ``observer`` or ``monitor``.
        name: the node's name.
        parameters: those that are not left at their defaults.
        remappings: topics by the name that the node knows.
    """

    executable: str
    name: str
    parameters: Mapping[str, Value]
    remappings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Setting:
    """What a demonstration runs.

    Attributes:
        model: a model file or a sample's name.
        laws: one observer and one monitor each.
        initial: the observers' initial state, as users write it.
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


def plant(setting: Setting, recorders: int = 0) -> Started:
    """The plant; it begins when all observers or monitors, and ``recorders``, listen."""
    return Started(
        "plant",
        "plant",
        {
            "model": setting.model,
            "rate": setting.rate,
            "epoch": setting.epoch,
            "duration": setting.duration,
            "publish_clock": True,
            "clock_rate": max(setting.rate, 100.0),
            "realtime_factor": setting.realtime_factor,
            "wait_for_subscribers": len(setting.laws) + recorders,
        },
    )


def observers(setting: Setting) -> tuple[Started, ...]:
    """An observer for each law."""
    return tuple(
        Started(
            "observer",
            observer_name(law),
            {
                "use_sim_time": True,
                "model": setting.model,
                "law": law,
                "initial_state": setting.initial,
                "rate": setting.rate,
                "epoch": setting.epoch,
                "events_durability": "transient_local",
            },
        )
        for law in setting.laws
    )


def monitors(setting: Setting) -> tuple[Started, ...]:
    """A monitor for each law's observer."""
    return tuple(
        Started(
            "monitor",
            monitor_name(law),
            {"use_sim_time": True, "model": setting.model, "law": law},
            {"observer/joint_states": f"{observer_name(law)}/joint_states"},
        )
        for law in setting.laws
    )
