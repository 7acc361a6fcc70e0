# SPDX-License-Identifier: Apache-2.0
"""The states of a topic as arrays."""

from collections.abc import Iterator

import numpy as np
import pytest

from impact_observer.errors import BagError
from impact_observer.io import interfaces
from impact_observer.io.messages import JointState, bag_messages, read_estimate, read_joint_state
from impact_observer.io.state_arrays import (
    JointStates,
    ObserverStates,
    StateCollector,
    joined,
)
from impact_observer.io.typestores import deserialize, typestore
from impact_observer.states import Estimate

MAKE = bag_messages()
JOINT, OBSERVER = interfaces.JOINT_STATE, interfaces.OBSERVER_STATE
RNG = np.random.default_rng(1)


def serialized(message: object, type_name: str, *, little: bool = True) -> bytes:
    """A message's bytes."""
    return bytes(typestore().serialize_cdr(message, type_name, little_endian=little))


def joint(stamp: int, *names: str, little: bool = True) -> bytes:
    """A joint state with random numbers."""
    q, u = RNG.normal(size=(2, len(names)))
    return serialized(MAKE.joint_state(JointState(stamp, names, q, u)), JOINT, little=little)


def estimate(stamp: int, closed: tuple[str, ...] = (), *, sure: bool = False) -> bytes:
    """An estimate of two coordinates, with random numbers."""
    q, u = RNG.normal(size=(2, 2))
    covariance = RNG.normal(size=(4, 4)) if sure else np.empty((0, 0))
    parameters = (("clock_error", 1e-3, 1e-4),) if sure else ()
    return serialized(
        MAKE.estimate(
            Estimate(
                stamp,
                "geometric",
                q,
                u,
                covariance=covariance,
                closed=closed,
                last_sequence=stamp % 1000,
                last_event=stamp // 2,
                parameters=parameters,
            ),
            ("x1", "x2"),
        ),
        OBSERVER,
    )


def collector(type_name: str, *names: str) -> StateCollector:
    """Returns an empty collector of messages of a type."""
    return StateCollector(
        "bag: /topic", names or None, estimates=type_name == OBSERVER, covariance=True
    )


def taken(type_name: str, block: list[bytes], *names: str) -> JointStates:
    """Returns the states of a block."""
    own = collector(type_name, *names)
    for data in block:
        own.append(deserialize(typestore(), data, type_name))
    return own.take()


def joint_block() -> Iterator[bytes]:
    """Messages in two orders of names and both byte orders, some with surplus bytes at the end."""
    for stamp in range(1, 200):
        if stamp % 7 == 3:
            yield joint(stamp, "x2", "x1")
        elif stamp % 11 == 5:
            yield joint(stamp, "x1", "x2", little=False)
        else:
            yield joint(stamp, "x1", "x2") + bytes(4 * (stamp % 3 == 0))


def test_a_block_of_joint_states_equals_its_messages() -> None:
    """Numbers are equal bit for bit, in any order of names and bytes."""
    block = [*joint_block()]
    states = taken(JOINT, block)
    assert states.names == ("x1", "x2")
    for i, data in enumerate(block):
        one = read_joint_state(deserialize(typestore(), data, JOINT))
        order = [one.names.index(name) for name in states.names]
        assert states.stamps[i] == one.stamp
        assert states.q[i].tobytes() == one.q[order].tobytes()
        assert states.u[i].tobytes() == one.u[order].tobytes()


def test_a_block_of_estimates_equals_its_messages() -> None:
    """Closed contacts, covariances and parameters make other shapes, in any mixture."""
    kinds = [((), False), (("stop",), False), (("stop", "left"), True), ((), True)]
    block = [
        estimate(stamp, closed, sure=sure)
        for stamp, (closed, sure) in enumerate(kinds * 20, start=5_000_000_000)
    ]
    states = taken(OBSERVER, block)
    assert isinstance(states, ObserverStates)
    assert states.law == "geometric"
    for i, data in enumerate(block):
        one = read_estimate(deserialize(typestore(), data, OBSERVER))[1]
        assert states.stamps[i] == one.stamp
        assert states.q[i].tobytes() == one.q.tobytes()
        assert states.u[i].tobytes() == one.u.tobytes()
        assert states.last_sequence[i] == one.last_sequence
        assert states.last_event[i] == one.last_event
        wanted = one.covariance if one.covariance.size else np.full((4, 4), np.nan)
        np.testing.assert_array_equal(states.covariance[i], wanted)


def test_covariances_follow_the_order_of_the_names() -> None:
    """Rows and columns of coordinates and velocities are permuted."""
    data = estimate(7, sure=True)
    _, one = read_estimate(deserialize(typestore(), data, OBSERVER))
    states = taken(OBSERVER, [data], "x2", "x1")
    assert isinstance(states, ObserverStates)
    turned = one.covariance[[1, 0, 3, 2]][:, [1, 0, 3, 2]]
    np.testing.assert_array_equal(states.covariance[0], turned)


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"position": np.array([1.0, np.nan])}, r"message 37: JointState.position\[1\] is nan"),
        ({"velocity": np.array([np.inf, 0.0])}, r"message 37: JointState.velocity\[0\] is inf"),
        ({"velocity": np.array([0.0])}, r"message 37: JointState.velocity has 1 numbers"),
        ({"name": ["x1", "y"]}, r"/topic lacks x2; expected the coordinates x1, x2"),
    ],
)
def test_one_bad_message_of_many_is_named(bad: dict[str, object], said: str) -> None:
    """The error is the same as if the bad message were read alone."""
    block = [joint(stamp, "x1", "x2") for stamp in range(1, 100)]
    message = deserialize(typestore(), block[37], JOINT)
    for name, value in bad.items():
        setattr(message, name, value)
    block[37] = serialized(message, JOINT)
    with pytest.raises(BagError, match=said):
        taken(JOINT, block)


def test_places_are_counted_through_all_blocks() -> None:
    """The error of a later block names the message of the topic."""
    own = collector(JOINT)
    good, bad = (deserialize(typestore(), joint(4, "x1"), JOINT) for _ in range(2))
    bad.position = np.array([np.nan])
    for _ in range(3):
        own.append(good)
    own.take()
    own.append(good)
    with pytest.raises(BagError, match="/topic, message 4"):
        own.append(bad)


def test_joined_blocks_are_one() -> None:
    """Joined blocks keep their order; estimates stay estimates."""
    parts = (range(1, 4), range(4, 5), range(5, 9))
    whole = joined(taken(OBSERVER, [estimate(stamp) for stamp in part]) for part in parts)
    assert isinstance(whole, ObserverStates)
    np.testing.assert_array_equal(whole.stamps, np.arange(1, 9))
    assert whole.q.shape == (8, 2)
    assert not whole.q.flags.writeable
