"""The fields of the messages that we read and write.

The message classes of ``rosbags`` and of ``rclpy`` differ, but have these attributes in common.
"""

from collections.abc import Sequence
from typing import Protocol


class TimeMessage(Protocol):
    """``builtin_interfaces/Time``."""

    sec: int
    nanosec: int


class HeaderMessage(Protocol):
    """``std_msgs/Header``."""

    stamp: TimeMessage
    frame_id: str


class ClockMessage(Protocol):
    """``rosgraph_msgs/Clock``."""

    clock: TimeMessage


class StringMessage(Protocol):
    """``std_msgs/String``."""

    data: str


class JointStateMessage(Protocol):
    """``sensor_msgs/JointState``."""

    header: HeaderMessage
    name: list[str]
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]


class SwitchMessage(Protocol):
    """``impact_observer_msgs/ContactSwitch``."""

    contact: str
    kind: int


class EventMessage(Protocol):
    """``impact_observer_msgs/ImpactEvent``."""

    header: HeaderMessage
    sequence: int
    episode: int
    epoch: TimeMessage
    switches: list[SwitchMessage]


class VerdictMessage(Protocol):
    """``impact_observer_msgs/EventVerdict``."""

    header: HeaderMessage
    verdict: int
    sequence: int
    contact: str
    reason: str
    innovation: float
    latency: float


class EstimateMessage(Protocol):
    """``impact_observer_msgs/ObserverState``."""

    header: HeaderMessage
    law: str
    name: list[str]
    position: Sequence[float]
    velocity: Sequence[float]
    covariance: Sequence[float]
    closed: list[str]
    convergence: float
    synchronized: bool
    clock_offset: float
    last_sequence: int
    last_event: TimeMessage
    parameter_name: list[str]
    parameter: Sequence[float]
    parameter_deviation: Sequence[float]


class ErrorMessage(Protocol):
    """``impact_observer_msgs/EstimateError``."""

    header: HeaderMessage
    law: str
    v: float
    name: list[str]
    position_error: Sequence[float]
    velocity_error: Sequence[float]


class MessageClass(Protocol):
    """A message class: makes a message from its fields."""

    def __call__(self, **fields: object) -> object:
        """A message with ``fields``."""
