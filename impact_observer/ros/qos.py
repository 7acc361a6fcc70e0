# SPDX-License-Identifier: Apache-2.0
"""Conversion of qualities of service to and from the profiles of ``rclpy``."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from impact_observer.io.interfaces import Quality


def qos_profile(quality: Quality) -> QoSProfile:
    """The profile of ``quality``, to offer or to request."""
    reliability = ReliabilityPolicy.RELIABLE if quality.reliable else ReliabilityPolicy.BEST_EFFORT
    durability = (
        DurabilityPolicy.TRANSIENT_LOCAL if quality.transient_local else DurabilityPolicy.VOLATILE
    )
    history = HistoryPolicy.KEEP_LAST if quality.depth else HistoryPolicy.KEEP_ALL
    return QoSProfile(
        history=history, depth=quality.depth, reliability=reliability, durability=durability
    )


def offered_quality(profile: QoSProfile, depth: int = 10) -> Quality:
    """The quality of service of a publisher.

    Args:
        profile: profile of the publisher; unspecified policies count as reliable and volatile.
        depth: depth of a publisher in another process, whose history is not visible.
    """
    kept = {HistoryPolicy.KEEP_ALL: 0, HistoryPolicy.KEEP_LAST: max(profile.depth, 1)}
    return Quality(
        reliable=profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        transient_local=profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        depth=kept.get(profile.history, depth),
    )
