# SPDX-License-Identifier: Apache-2.0
"""Estimates and verdicts as the messages that an observer node publishes, many at a time."""

import heapq
from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias

import numpy as np

from impact_observer.events import MeasurementVerdict, Verdict
from impact_observer.io import interfaces
from impact_observer.io.messages import JointState, bag_messages
from impact_observer.io.state_blocks import encode
from impact_observer.stamps import MAX_STAMP
from impact_observer.states import Estimate, Estimates

Serialize: TypeAlias = Callable[[str, object], bytes]
"""Makes bytes of a topic and a message of its type."""
_OWN = (interfaces.OBSERVER_JOINT_STATES, interfaces.OBSERVER_STATES)
_Judged: TypeAlias = Verdict | MeasurementVerdict
OBSERVER = "observer"
"""The node that publishes estimates, where none other is named."""


def in_log_order(
    items: Iterable[Estimates | _Judged],
) -> Iterator[tuple[int, Estimates | _Judged]]:
    """Estimates and verdicts with log times (ns) that never go back.

    The log time of an estimate is its stamp. A verdict that is given before the estimates up to
    its stamp waits for them. One on an earlier stamp, a revision, is logged when it is given.
    """
    waiting: list[tuple[int, int, _Judged]] = []
    last = 0
    for k, item in enumerate(items):
        if not isinstance(item, Estimates):
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
    estimates: Estimates, names: tuple[str, ...], serialize: Serialize, owner: str = OBSERVER
) -> Iterator[tuple[int, str, bytes]]:
    """The messages that an observer node publishes of estimates: log times (ns), topics, bytes.

    The ``owner`` is the node's name.

    Raises:
        MessageError: a message cannot carry an estimate.
    """
    n, x, stamps = len(names), estimates.x, estimates.stamps
    is_wrong = stamps[-1] > MAX_STAMP or not np.isfinite(x).all()  # one of them raises the error
    if is_wrong or stamps.size == 1:
        for each in estimates if is_wrong else (estimates.first,):
            for topic, data in _one(each, names, serialize, owner):
                yield each.stamp, topic, data
        return
    made = []
    first = _one(estimates.first, names, serialize, owner)
    for own, (topic, example) in zip(_OWN, first, strict=True):
        copies = encode(own.type, example, stamps, x[:, :n], x[:, n:])
        assert copies is not None, "our messages have a layout"
        made.append([(topic, data) for data in copies])
    for stamp, *both in zip(stamps.tolist(), *made, strict=True):
        for topic, data in both:
            yield stamp, topic, data


def _one(
    estimate: Estimate, names: tuple[str, ...], serialize: Serialize, owner: str
) -> Iterator[tuple[str, bytes]]:
    """The two messages of an estimate, with their topics."""
    make = bag_messages()
    joints = JointState(estimate.stamp, names, estimate.q, estimate.u)
    messages = (make.joint_state(joints), make.estimate(estimate, names))
    for own, message in zip(_OWN, messages, strict=True):
        topic = f"/{own.of(owner)}"
        yield topic, serialize(topic, message)
