# SPDX-License-Identifier: Apache-2.0
"""Estimates and verdicts as the messages that an observer node publishes."""

import heapq
from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias

from impact_observer.events import MeasurementVerdict, Verdict
from impact_observer.io import interfaces
from impact_observer.io.messages import bag_messages
from impact_observer.states import Estimate, Estimates

Serialize: TypeAlias = Callable[[str, object], bytes]
"""Makes bytes of a topic and a message of its type."""
_Judged: TypeAlias = Verdict | MeasurementVerdict
OBSERVER = "observer"
"""The node that publishes estimates, where no other is named."""


def in_log_order(
    items: Iterable[Estimates | _Judged],
) -> Iterator[tuple[int, Estimate | _Judged]]:
    """Yields estimates and verdicts with log times (ns) that never go back.

    The log time of an estimate is its stamp. A verdict that is given before the estimates up to
    its stamp waits for them. A verdict on an earlier stamp, a revision, is logged when given.
    """
    waiting: list[tuple[int, int, _Judged]] = []
    last = 0
    for k, item in enumerate(items):
        if not isinstance(item, Estimates):
            heapq.heappush(waiting, (max(item.stamp, last), k, item))
            continue
        for estimate in item:
            while waiting and waiting[0][0] <= estimate.stamp:
                last, _, verdict = heapq.heappop(waiting)
                yield last, verdict
            last = estimate.stamp
            yield last, estimate
    for log_time, _, verdict in sorted(waiting):
        yield log_time, verdict


def messages_of(
    estimate: Estimate, names: tuple[str, ...], serialize: Serialize, owner: str = OBSERVER
) -> Iterator[tuple[int, str, bytes]]:
    """Yields log time (ns), topic and bytes of the two messages of an estimate.

    Args:
        estimate: of the node ``owner``.
        names: of the coordinates.
        serialize: makes the bytes.
        owner: the node's name.

    Raises:
        MessageError: a message cannot carry the estimate.
    """
    make = bag_messages()
    state = make.estimate(estimate, names)
    for own, message in (
        (interfaces.OBSERVER_JOINT_STATES, make.joint_state_of(state)),
        (interfaces.OBSERVER_STATES, state),
    ):
        topic = f"/{own.name_under(owner)}"
        yield estimate.stamp, topic, serialize(topic, message)
