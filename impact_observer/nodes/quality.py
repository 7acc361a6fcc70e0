"""Qualities of service as ``rclpy`` wants and gives them."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from impact_observer.bag.interfaces import Quality


def qos_profile(quality: Quality) -> QoSProfile:
    """``quality`` for a publisher that offers it, or a subscriber that asks for it."""
    reliability = ReliabilityPolicy.RELIABLE if quality.reliable else ReliabilityPolicy.BEST_EFFORT
    durability = (
        DurabilityPolicy.TRANSIENT_LOCAL if quality.transient_local else DurabilityPolicy.VOLATILE
    )
    history = HistoryPolicy.KEEP_LAST if quality.depth else HistoryPolicy.KEEP_ALL
    return QoSProfile(
        history=history, depth=quality.depth, reliability=reliability, durability=durability
    )


def offered_quality(profile: QoSProfile, depth: int = 10) -> Quality:
    """The quality in a ``profile``.

    Args:
        profile: of a publisher; what it leaves open is read as reliable and volatile.
        depth: messages kept when the profile does not know, as that of a publisher in another
            process, whose history cannot be seen.
    """
    kept = {HistoryPolicy.KEEP_ALL: 0, HistoryPolicy.KEEP_LAST: max(profile.depth, 1)}
    return Quality(
        reliable=profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        transient_local=profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        depth=kept.get(profile.history, depth),
    )
