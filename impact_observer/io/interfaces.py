# SPDX-License-Identifier: Apache-2.0
"""The table of the package's topics: name, message type, quality of service.

Nodes use the names relative to their namespace, bags the absolute ones.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

_FOREVER = QosTime(9_223_372_036, 854_775_807)
"""Infinite duration in ROS 2 Jazzy: the largest int64 of nanoseconds."""


@dataclass(frozen=True, slots=True)
class Quality:
    """The policies of quality of service that differ among our topics; a depth of 0 keeps all."""

    reliable: bool = True
    transient_local: bool = False
    depth: int = 10

    def offered(self) -> Qos:
        """The quality as ``rosbags`` writes it into a bag."""
        return Qos(
            QosHistory.KEEP_LAST if self.depth else QosHistory.KEEP_ALL,
            self.depth,
            QosReliability.RELIABLE if self.reliable else QosReliability.BEST_EFFORT,
            QosDurability.TRANSIENT_LOCAL if self.transient_local else QosDurability.VOLATILE,
            _FOREVER,
            _FOREVER,
            QosLiveliness.AUTOMATIC,
            _FOREVER,
            avoid_ros_namespace_conventions=False,
        )

    @classmethod
    def of_publisher(cls, policies: Any, depth: int = 10) -> "Quality":  # noqa: ANN401 (of two libraries)
        """The quality that a publisher offers; reliable where that is unknown.

        Args:
            policies: the ``Qos`` of ``rosbags`` or the ``QoSProfile`` of ``rclpy``, whose policies
                have the same numbers.
            depth: counts if there is none: the history of a publisher in another process is not
                visible, so ``ros2 bag record`` writes ``unknown``.
        """
        kept = {QosHistory.KEEP_ALL: 0, QosHistory.KEEP_LAST: max(policies.depth, 1)}
        return cls(
            reliable=policies.reliability.value != QosReliability.BEST_EFFORT.value,
            transient_local=policies.durability.value == QosDurability.TRANSIENT_LOCAL.value,
            depth=kept.get(QosHistory(policies.history.value), depth),
        )

    @classmethod
    def common(cls, offers: Iterable["Quality"]) -> "Quality":
        """The highest quality that publishers with these ``offers`` all provide."""
        reliable, transient_local, depths = zip(
            *((offer.reliable, offer.transient_local, offer.depth) for offer in offers),
            strict=True,
        )
        return cls(all(reliable), all(transient_local), max(depths) if all(depths) else 0)


EVENTS = Quality(transient_local=True, depth=2000)
"""Events: none may be lost, and a late subscriber receives the earlier ones."""
STATES = Quality()
"""States: none should be lost; a late subscriber does not need earlier ones."""
LATCHED = Quality(transient_local=True, depth=1)
"""A value that holds until the next one: a late subscriber receives the last one."""

INPUTS = Quality(depth=2000)
"""Samples of live forces and grounds: none may be lost, and many may wait."""
SENSORS = Quality(reliable=False, depth=100)
"""Samples of sensors, as their drivers publish them."""

SMOOTHER = "smoother"
"""The owner of the topics of smoothed recordings."""
_ALSO_SMOOTHED = ("observer/joint_states", "observer/state", "observer/verdicts")
"""Topics of an observer that a smoother has under its own name."""
IMPACT_EVENT = "impact_observer_msgs/msg/ImpactEvent"
CONTACT_SWITCH = "impact_observer_msgs/msg/ContactSwitch"
OBSERVER_STATE = "impact_observer_msgs/msg/ObserverState"
EVENT_VERDICT = "impact_observer_msgs/msg/EventVerdict"
MEASUREMENT_VERDICT = "impact_observer_msgs/msg/MeasurementVerdict"
SMOOTHED_IMPACT = "impact_observer_msgs/msg/SmoothedImpact"
IMPACT_ESTIMATE = "impact_observer_msgs/msg/ImpactEstimate"
ESTIMATE_ERROR = "impact_observer_msgs/msg/EstimateError"
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
HEADER = "std_msgs/msg/Header"
TIME = "builtin_interfaces/msg/Time"
CLOCK = "rosgraph_msgs/msg/Clock"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
DIAGNOSTIC = "diagnostic_msgs/msg/DiagnosticStatus"


@dataclass(frozen=True, slots=True)
class Interface:
    """A topic of the package, relative to the namespace, or absolute where ROS fixes it."""

    name: str
    type: str
    quality: Quality = STATES

    @property
    def topic(self) -> str:
        """The absolute name in a bag."""
        return self.name if self.name.startswith("/") else f"/{self.name}"

    def name_under(self, owner: str) -> str:
        """The relative name of the same topic of another owner, such as ``observer_geometric``."""
        return f"{owner}/{self.name.rpartition('/')[2]}"

    def candidates(self, topics: Collection[str]) -> list[str]:
        """This topic of ``topics`` if its absolute name is among them; else all that fit."""
        return [self.topic] if self.topic in topics else sorted(filter(self.fits, topics))

    def fits(self, topic: str) -> bool:
        """Whether an absolute ``topic`` is this one, in any namespace and of any owner.

        ``/rig/observer_geometric/state`` fits ``observer/state``: several observers live side
        by side as ``observer_<law>``. So does ``/smoother/state``: estimates of a smoother are
        read like those of an observer.
        """
        if self.name.startswith("/"):
            return topic == self.name
        wanted, parts = self.name.split("/"), topic.split("/")[1:]
        if len(parts) < len(wanted) or parts[-1] != wanted[-1]:
            return False
        owner = parts[-2] if len(parts) > 1 else ""
        if len(wanted) == 1:  # /observer/impacts is none of /impacts in a namespace
            return owner != SMOOTHER and not _is_of("observer", owner)
        smoothed = owner == SMOOTHER and self.name in _ALSO_SMOOTHED
        return _is_of(wanted[0], owner) or smoothed


def _is_of(kind: str, owner: str) -> bool:
    """Whether an ``owner`` of topics, such as ``observer_geometric``, is a node of this kind."""
    return owner == kind or owner.startswith(f"{kind}_")


INTERFACES = (
    IMPACTS := Interface("impacts", IMPACT_EVENT, EVENTS),
    FORCING := Interface("forcing", JOINT_STATE, INPUTS),
    PHASE_REFERENCE := Interface("phase_reference", HEADER, EVENTS),
    PLANT_JOINT_STATES := Interface("plant/joint_states", JOINT_STATE),
    PLANT_MODEL := Interface("plant/model", STRING, LATCHED),
    OBSERVER_JOINT_STATES := Interface("observer/joint_states", JOINT_STATE),
    OBSERVER_STATES := Interface("observer/state", OBSERVER_STATE),
    OBSERVER_VERDICTS := Interface("observer/verdicts", EVENT_VERDICT, EVENTS),
    OBSERVER_IMPACTS := Interface("observer/impacts", IMPACT_ESTIMATE, EVENTS),
    OBSERVER_MEASUREMENTS := Interface("observer/measurements", MEASUREMENT_VERDICT, INPUTS),
    OBSERVER_BOUND := Interface("observer/bound", ESTIMATE_ERROR, LATCHED),
    SMOOTHED_IMPACTS := Interface("smoother/impacts", SMOOTHED_IMPACT, EVENTS),
    SMOOTHED_ESTIMATES := Interface("smoother/impact_estimates", IMPACT_ESTIMATE, EVENTS),
    MONITOR_ERROR := Interface("monitor/error", ESTIMATE_ERROR),
    SIMULATED_CLOCK := Interface("/clock", CLOCK),
    DIAGNOSTIC_ARRAYS := Interface("/diagnostics", DIAGNOSTICS),
)
NOT_SYNCHRONIZED = "not synchronized"
"""Key of the reason in the diagnostics of an observer that is not synchronized."""
WHOLE = (PLANT_MODEL, FORCING, PHASE_REFERENCE)
"""Topics that are read whole where a part of a bag is: what holds, or drives, from before on."""


def absolute(topic: str) -> str:
    """The absolute name of a topic of a bag.

    Writers that are no nodes leave out the first slash.
    """
    return f"/{topic.strip('/')}"


def interface(topic: str) -> Interface | None:
    """The interface of an absolute ``topic``; None for a foreign topic."""
    return next((each for each in INTERFACES if each.fits(topic)), None)


def usual_quality(topic: str) -> Quality:
    """The quality of service of an absolute ``topic`` in the table; else ``STATES``."""
    known = interface(topic)
    return known.quality if known else STATES
