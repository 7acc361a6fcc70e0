# SPDX-License-Identifier: Apache-2.0
"""Messages of estimates and verdicts: many together, the same as one by one."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.events import Ruling, Verdict
from impact_observer.io import interfaces
from impact_observer.io.estimate_messages import in_log_order, messages_of
from impact_observer.io.messages import JointState, MessageError, bag_messages
from impact_observer.io.state_blocks import encode
from impact_observer.io.typestores import typestore
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate, Estimates

MAKE = bag_messages()
STATES, JOINTS = interfaces.OBSERVER_STATES, interfaces.OBSERVER_JOINT_STATES
TYPES = {each.topic: each.type for each in (STATES, JOINTS)}


def serialize(topic: str, message: object) -> bytes:
    """A message's bytes."""
    return bytes(typestore().serialize_cdr(message, TYPES[topic]))


def estimates(size: int, n: int, *, closed: tuple[str, ...] = ()) -> Estimates:
    """Estimates with random states, from just before a whole second on."""
    x = np.random.default_rng(size).normal(size=(size, 2 * n))
    stamps = 7 * NS_PER_S - 5 + np.arange(size) * 3
    first = Estimate(int(stamps[0]), "geometric", x[0, :n], x[0, n:], closed=closed, convergence=2)
    return Estimates(replace(first, last_sequence=3, last_event=NS_PER_S), stamps, x)


def one_by_one(block: Estimates, names: tuple[str, ...]) -> list[tuple[int, str, bytes]]:
    """The messages of each estimate as ``rosbags`` makes them."""
    found = []
    for each in block:
        joints = MAKE.joint_state(JointState(each.stamp, names, each.q, each.u))
        found.append((each.stamp, JOINTS.topic, serialize(JOINTS.topic, joints)))
        state = serialize(STATES.topic, MAKE.estimate(each, names))
        found.append((each.stamp, STATES.topic, state))
    return found


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 100])
@pytest.mark.parametrize("names", [("x",), ("x1", "a longer name"), ("a", "bc", "def")])
def test_messages_are_those_of_rosbags_in_every_byte(size: int, names: tuple[str, ...]) -> None:
    """Across a whole second, whatever the padding."""
    for closed in ((), ("stop",)):
        block = estimates(size, len(names), closed=closed)
        assert list(messages_of(block, names, serialize)) == one_by_one(block, names)


def test_state_that_is_not_finite_is_refused() -> None:
    """As when it is made alone, with the name of the number."""
    block = estimates(9, 2)
    block.x[6, 3] = np.nan
    with pytest.raises(MessageError, match=r"JointState\.velocity\[1\] is nan"):
        list(messages_of(block, ("x1", "x2"), serialize))


def test_stamp_that_no_message_carries_is_refused() -> None:
    """The last one, far in the future."""
    block = estimates(9, 2)
    stamps = block.stamps.copy()
    stamps[-1] = 2**62
    with pytest.raises(MessageError, match=r"header\.stamp is 4611686018"):
        list(messages_of(replace(block, stamps=stamps), ("x1", "x2"), serialize))


def test_a_message_without_layout_is_not_copied() -> None:
    """Nor what has another number of coordinates."""
    state = serialize(STATES.topic, MAKE.estimate(estimates(1, 2).first, ("x1", "x2")))
    x, stamps = np.zeros((3, 2)), np.arange(1, 4)
    assert encode(interfaces.STRING, state, stamps, x, x) is None
    assert encode(STATES.type, state, stamps, x[:, :1], x[:, :1]) is None
    assert len(encode(STATES.type, state, stamps, x, x) or ()) == 3


def slowly(items: Sequence[Estimates | Verdict]) -> Iterator[tuple[int, Estimate | Verdict]]:
    """The order of ``in_log_order``, estimate by estimate."""
    waiting: list[tuple[int, int, Verdict]] = []
    last = 0
    for k, item in enumerate(items):
        if isinstance(item, Verdict):
            heapq.heappush(waiting, (max(item.stamp, last), k, item))
            continue
        for each in item:
            while waiting and waiting[0][0] <= each.stamp:
                last, _, verdict = heapq.heappop(waiting)
                yield last, verdict
            last = each.stamp
            yield last, each
    for log_time, _, verdict in sorted(waiting):
        yield log_time, verdict


@examples(60)
@given(st.lists(st.tuples(st.integers(0, 4), st.lists(st.integers(-20, 40), max_size=3))))
def test_verdicts_come_where_they_would_among_single_estimates(
    parts: list[tuple[int, list[int]]],
) -> None:
    """Early ones wait for the estimates up to their stamps, revisions are logged at once."""
    items: list[Estimates | Verdict] = []
    now = 100
    for size, verdicts in parts:
        items += [Verdict(now + each, Ruling.APPLIED, k) for k, each in enumerate(verdicts)]
        if size:
            block = estimates(size, 1)
            stamps = now + 5 * np.arange(size)
            items.append(Estimates(replace(block.first, stamp=now), stamps, block.x))
            now = int(stamps[-1]) + 5
    found: list[tuple[int, object]] = []
    for log_time, item in in_log_order(items):
        if isinstance(item, Verdict):
            found.append((log_time, item))
            continue
        assert isinstance(item, Estimates)
        assert log_time == item.first.stamp == item.stamps[0]
        found += [(each.stamp, each.q.tolist()) for each in item]
    assert found == [
        (t, each.q.tolist() if isinstance(each, Estimate) else each) for t, each in slowly(items)
    ]
