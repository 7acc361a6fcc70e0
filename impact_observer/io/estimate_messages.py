"""Estimates and verdicts as the messages that an observer node publishes, many at a time."""

import heapq
from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias

import numpy as np

from impact_observer.events import Verdict
from impact_observer.io import interfaces
from impact_observer.io.messages import JointState, bag_messages
from impact_observer.io.state_blocks import encode
from impact_observer.states import Estimate, Estimates

Serialize: TypeAlias = Callable[[str, object], bytes]
"""Makes bytes of a topic and a message of its type."""
_FEW = 4
"""Messages of fewer estimates are made one by one."""
_JOINT_STATES, _STATES = interfaces.OBSERVER_JOINT_STATES, interfaces.OBSERVER_STATES


def in_log_order(
    items: Iterable[Estimates | Verdict],
) -> Iterator[tuple[int, Estimates | Verdict]]:
    """Estimates and verdicts with log times (ns) that never go back.

    The log time of an estimate is its stamp. A verdict that is given before the estimates up to
    its stamp waits for them. One on an earlier stamp, a revision, is logged when it is given.
    """
    waiting: list[tuple[int, int, Verdict]] = []
    last = 0
    for k, item in enumerate(items):
        if isinstance(item, Verdict):
            heapq.heappush(waiting, (max(item.stamp, last), k, item))
            continue
        begin, size = 0, item.stamps.size
        while waiting and waiting[0][0] <= item.stamps[-1]:
            last, _, verdict = heapq.heappop(waiting)
            if (end := int(np.searchsorted(item.stamps, last))) > begin:
                yield int(item.stamps[begin]), item.part(begin, end)
                begin = end
            yield last, verdict
        yield int(item.stamps[begin]), item.part(begin, size)
        last = int(item.stamps[-1])
    for log_time, _, verdict in sorted(waiting):
        yield log_time, verdict


def messages_of(
    estimates: Estimates, names: tuple[str, ...], serialize: Serialize
) -> Iterator[tuple[int, str, bytes]]:
    """The messages that an observer node publishes of estimates: log times (ns), topics, bytes.

    Raises:
        MessageError: a message cannot carry an estimate.
    """
    both = _together(estimates, names, serialize)
    if both is None:
        for each in estimates:
            for topic, data in _one(each, names, serialize):
                yield each.stamp, topic, data
        return
    of_joints, of_state = _JOINT_STATES.topic, _STATES.topic
    for stamp, joints, state in zip(estimates.stamps.tolist(), *both, strict=True):
        yield stamp, of_joints, joints
        yield stamp, of_state, state


def _together(
    estimates: Estimates, names: tuple[str, ...], serialize: Serialize
) -> list[list[bytes]] | None:
    """The two messages of all estimates; None where they have to be made one by one."""
    n, x = len(names), estimates.x
    if len(x) < _FEW or not np.isfinite(x).all():
        return None
    last = estimates.part(len(x) - 1, len(x)).first
    found: list[list[bytes]] = []
    of_first, of_last = (_one(each, names, serialize) for each in (estimates.first, last))
    for own, (_, example), (_, expected) in zip(
        (_JOINT_STATES, _STATES), of_first, of_last, strict=True
    ):
        made = encode(own.type, example, estimates.stamps, x[:, :n], x[:, n:])
        if made is None or made[0] != example or made[-1] != expected:
            return None
        found.append(made)
    return found


def _one(
    estimate: Estimate, names: tuple[str, ...], serialize: Serialize
) -> Iterator[tuple[str, bytes]]:
    """The two messages of an estimate, with their topics."""
    make = bag_messages()
    joints = JointState(estimate.stamp, names, estimate.q, estimate.u)
    for topic, message in (
        (_JOINT_STATES.topic, make.joint_state(joints)),
        (_STATES.topic, make.estimate(estimate, names)),
    ):
        yield topic, serialize(topic, message)
