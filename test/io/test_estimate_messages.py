# SPDX-License-Identifier: Apache-2.0
"""Messages of estimates and verdicts, and the order of their log times."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.events import ImpactEvent, Ruling, Switch, Verdict
from impact_observer.io import BagReader, BagWriter, interfaces
from impact_observer.io.messages import JointState, MessageError, read, read_estimate
from impact_observer.io.observed_bag import in_log_order, messages_of, sample_stamps
from impact_observer.io.typestores import deserialize, typestore
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate, Estimates

STATES, JOINTS = interfaces.OBSERVER_STATES, interfaces.OBSERVER_JOINT_STATES
TYPES = {f"/{each.name_under('smoother')}": each.type for each in (STATES, JOINTS)} | {
    each.topic: each.type for each in (STATES, JOINTS)
}


def serialize(topic: str, message: object) -> bytes:
    """A message's bytes."""
    return bytes(typestore().serialize_cdr(message, TYPES[topic]))


def estimates(size: int, n: int, *, closed: tuple[str, ...] = ()) -> Estimates:
    """Estimates with random states, from just before a whole second on."""
    x = np.random.default_rng(size).normal(size=(size, 2 * n))
    stamps = 7 * NS_PER_S - 5 + np.arange(size) * 3
    first = Estimate(int(stamps[0]), "geometric", x[0, :n], x[0, n:], closed=closed, convergence=2)
    return Estimates(replace(first, last_sequence=3, last_event=NS_PER_S), stamps, x)


def test_an_estimate_has_two_messages_with_its_state() -> None:
    """Both messages have the same stamp, names and numbers, at the topics of the named node."""
    names = ("x1", "x2")
    for estimate in estimates(3, 2, closed=("stop",)):
        both = [*messages_of(estimate, names, serialize, "smoother")]
        assert [topic for _, topic, _ in both] == ["/smoother/joint_states", "/smoother/state"]
        assert {log_time for log_time, _, _ in both} == {estimate.stamp}
        joints = read(JointState, deserialize(typestore(), both[0][2], JOINTS.type))
        assert (joints.stamp, joints.names) == (estimate.stamp, names)
        np.testing.assert_array_equal(joints.q, estimate.q)
        np.testing.assert_array_equal(joints.u, estimate.u)
        found, state = read_estimate(deserialize(typestore(), both[1][2], STATES.type))
        assert found == names
        assert (state.stamp, state.closed, state.last_sequence) == (estimate.stamp, ("stop",), 3)
        np.testing.assert_array_equal(state.q, estimate.q)
        np.testing.assert_array_equal(state.u, estimate.u)


def test_state_that_is_not_finite_is_refused() -> None:
    """The error names the number."""
    estimate = replace(estimates(1, 2).first, u=np.array([0.0, np.nan]))
    with pytest.raises(MessageError, match=r"ObserverState\.velocity\[1\] is nan"):
        list(messages_of(estimate, ("x1", "x2"), serialize))


def test_stamp_that_no_message_carries_is_refused() -> None:
    """A stamp far in the future."""
    estimate = replace(estimates(1, 2).first, stamp=2**62)
    with pytest.raises(MessageError, match=r"header\.stamp is 4611686018"):
        list(messages_of(estimate, ("x1", "x2"), serialize))


def test_a_truth_without_a_state_ends_no_estimates(tmp_path: Path) -> None:
    """The topic was recorded and nothing came: estimates go on to the last event."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/plant/joint_states")
    events = [ImpactEvent(stamp * NS_PER_S, (Switch("stop"),), stamp) for stamp in (1, 3)]
    with BagReader(tmp_path / "bag") as reader:
        assert sample_stamps(reader, events, 1.0, 0).tolist() == [k * NS_PER_S for k in (1, 2, 3)]


@examples(60)
@given(st.lists(st.tuples(st.integers(0, 4), st.lists(st.integers(-20, 40), max_size=3))))
def test_verdicts_come_where_they_would_among_single_estimates(
    parts: list[tuple[int, list[int]]],
) -> None:
    """Early verdicts wait for the estimates up to their stamps; revisions are logged at once."""
    items: list[Estimates | Verdict] = []
    now = 100
    for size, verdicts in parts:
        items += [
            Verdict(now + each, Ruling.APPLIED, k) for k, each in enumerate(verdicts, len(items))
        ]
        if size:
            block = estimates(size, 1)
            stamps = now + 5 * np.arange(size)
            items.append(Estimates(replace(block.first, stamp=now), stamps, block.x))
            now = int(stamps[-1]) + 5
    given = [key for item in items for key in _keys(item)]
    found = [*in_log_order(items)]
    assert sorted(_key(item) for _, item in found) == sorted(given)
    times = [log_time for log_time, _ in found]
    assert times == sorted(times)
    written: set[tuple[int, int]] = set()
    for log_time, item in found:
        if isinstance(item, Estimate):
            assert log_time == item.stamp
        else:
            before = [key for key in given[: given.index(_key(item))] if key[1] == -1]
            last = max((stamp for stamp, _ in before), default=0)
            assert log_time >= max(item.stamp, last)
            assert written >= {key for key in before if key[0] < log_time}
        written.add(_key(item))


def _key(item: object) -> tuple[int, int]:
    """Returns stamp and sequence of a verdict, stamp and -1 of an estimate."""
    assert isinstance(item, (Estimate, Verdict))
    return item.stamp, -1 if isinstance(item, Estimate) else item.sequence


def _keys(item: Estimates | Verdict) -> list[tuple[int, int]]:
    """Returns the keys of what ``item`` contains."""
    return [_key(each) for each in ([item] if isinstance(item, Verdict) else item)]
