# SPDX-License-Identifier: Apache-2.0
"""The states of a topic as arrays."""

from pathlib import Path

import numpy as np
import pytest

from impact_observer.errors import BagError
from impact_observer.io import BagReader, BagWriter, interfaces
from impact_observer.io.messages import JointState, bag_messages, read, read_estimate
from impact_observer.io.typestores import typestore
from impact_observer.states import Estimate

MAKE = bag_messages()
RNG = np.random.default_rng(1)
TRUTH, ESTIMATES = "/plant/joint_states", "/observer/state"


def joints(stamp: int, *names: str) -> object:
    """A joint state with random numbers."""
    q, u = RNG.normal(size=(2, len(names)))
    return MAKE.joint_state(JointState(stamp, names, q, u))


def estimate(stamp: int, closed: tuple[str, ...] = (), *, sure: bool = False) -> object:
    """An estimate of two coordinates, with random numbers."""
    q, u = RNG.normal(size=(2, 2))
    root = RNG.normal(size=(4, 4))
    made = Estimate(
        stamp,
        "geometric",
        q,
        u,
        covariance=root @ root.T if sure else np.empty((0, 0)),
        closed=closed,
        last_sequence=stamp % 1000,
        last_event=stamp // 2,
        parameters=(("clock_error", 1e-3, 1e-4),) if sure else (),
    )
    return MAKE.estimate(made, ("x1", "x2"))


def written(path: Path, topic: str, *messages: object) -> BagReader:
    """A bag with these messages on a topic."""
    with BagWriter(path) as writer:
        for k, message in enumerate(messages):
            writer.write(topic, k, message)
    return BagReader(path)


def test_joint_states_equal_their_messages(tmp_path: Path) -> None:
    """Numbers are equal bit for bit, in any order of names and bytes, with bytes at the end."""
    orders = ("x1", "x2"), ("x2", "x1")
    messages = [joints(stamp, *orders[stamp % 7 == 3]) for stamp in range(1, 200)]
    with BagWriter(tmp_path / "bag") as writer:
        for k, each in enumerate(messages):
            little = k % 5 > 0
            data = typestore().serialize_cdr(each, interfaces.JOINT_STATE, little_endian=little)
            writer.write_raw(TRUTH, k, bytes(data) + bytes(4 * (k % 3 == 0)))
    with BagReader(tmp_path / "bag") as reader:
        states = reader.joint_states(TRUTH)
    assert states.names == ("x1", "x2")
    for i, each in enumerate(messages):
        one = read(JointState, each).ordered(states.names)
        assert states.stamps[i] == one.stamp
        assert states.q[i].tobytes() == one.q.tobytes()
        assert states.u[i].tobytes() == one.u.tobytes()
    assert np.isnan(states.deviations).all()


def test_estimates_equal_their_messages(tmp_path: Path) -> None:
    """Closed contacts, covariances and parameters make other shapes, in any mixture."""
    kinds = [((), False), (("stop",), False), (("stop", "left"), True), ((), True)]
    messages = [
        estimate(stamp, closed, sure=sure)
        for stamp, (closed, sure) in enumerate(kinds * 20, start=5_000_000_000)
    ]
    with written(tmp_path / "bag", ESTIMATES, *messages) as reader:
        states = reader.observer_states(ESTIMATES)
        turned = reader.observer_states(ESTIMATES, ("x2", "x1"))
    assert states.law == "geometric"
    for i, each in enumerate(messages):
        one = read_estimate(each)[1]
        assert states.x[i].tobytes() == np.concatenate([one.q, one.u]).tobytes()
        assert turned.x[i].tolist() == states.x[i, [1, 0, 3, 2]].tolist()
        assert states.stamps[i] == one.stamp
        assert states.last_sequence[i] == one.last_sequence
        assert states.last_event[i] == one.last_event
        variances = np.diag(one.covariance) if one.covariance.size else np.full(4, np.nan)
        np.testing.assert_array_equal(states.deviations[i], np.sqrt(variances))
        np.testing.assert_array_equal(turned.deviations[i], np.sqrt(variances[[1, 0, 3, 2]]))


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"position": np.array([1.0, np.nan])}, r"message 37: JointState.position\[1\] is nan"),
        ({"velocity": np.array([np.inf, 0.0])}, r"message 37: JointState.velocity\[0\] is inf"),
        ({"velocity": np.array([0.0])}, r"message 37: JointState.velocity has 1 numbers"),
        ({"velocity": np.empty(0)}, r"message 37: JointState.velocity has 0 numbers"),
        ({"name": ["x1", "y"]}, rf"{TRUTH} lacks x2; expected the coordinates x1, x2"),
        ({"name": ["x1", "x1"]}, rf"{TRUTH} names twice x1; expected"),
    ],
)
def test_one_bad_message_of_many_is_named(
    tmp_path: Path, bad: dict[str, object], said: str
) -> None:
    """The error names the place of the message in the topic."""
    messages = [joints(stamp, "x1", "x2") for stamp in range(1, 100)]
    for name, value in bad.items():
        setattr(messages[37], name, value)
    with (
        written(tmp_path / "bag", TRUTH, *messages) as reader,
        pytest.raises(BagError, match=said),
    ):
        reader.joint_states(TRUTH)


@pytest.mark.parametrize(
    ("own", "wanted", "said"),
    [
        (("a", "c"), ("a", "b"), "lacks b; expected the coordinates a, b"),
        (("a", "b", "c"), ("b", "a"), "has also c; expected .* b, a"),
        (("a",), None, "lacks b; expected the coordinates a, b"),
    ],
)
def test_coordinates_that_do_not_fit_are_named(
    tmp_path: Path, own: tuple[str, ...], wanted: tuple[str, ...] | None, said: str
) -> None:
    """Coordinates are compared with the given names, or with those of the first message."""
    messages = [joints(1, "a", "b")] * (wanted is None) + [joints(2, *own)]
    with (
        written(tmp_path / "bag", TRUTH, *messages) as reader,
        pytest.raises(BagError, match=said),
    ):
        reader.joint_states(TRUTH, wanted)


def test_topic_with_estimates_of_two_laws_is_refused(tmp_path: Path) -> None:
    """All estimates of a topic are of one observer."""
    other = estimate(6)
    other.law = "kinematic"  # type: ignore[attr-defined]
    with (
        written(tmp_path / "bag", ESTIMATES, estimate(5), other) as reader,
        pytest.raises(BagError, match=r"changes its law from geometric to kinematic"),
    ):
        reader.observer_states(ESTIMATES)


def test_columns_are_read_only(tmp_path: Path) -> None:
    """Nobody changes what another one has read; an empty topic has no rows."""
    with written(tmp_path / "bag", TRUTH, joints(1, "a")) as reader:
        states = reader.joint_states(TRUTH)
    assert not any(each.flags.writeable for each in (states.stamps, states.x, states.q, states.u))
    with BagWriter(tmp_path / "empty") as writer:
        writer.declare(TRUTH)
    with BagReader(tmp_path / "empty") as reader:
        assert reader.joint_states(TRUTH, ("a",)).x.shape == (0, 2)
        assert reader.first_state([TRUTH]) is None
