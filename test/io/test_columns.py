# SPDX-License-Identifier: Apache-2.0
"""Blocks of states: decoded together, the same as one by one."""

from collections.abc import Iterator

import numpy as np
import pytest

from impact_observer.errors import BagError
from impact_observer.io import interfaces
from impact_observer.io.columns import Columns, JointStates, ObserverStates, joined
from impact_observer.io.messages import JointState, bag_messages, read_estimate, read_joint_state
from impact_observer.io.state_blocks import decode, layout_of
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


def columns(type_name: str, *names: str) -> Columns:
    """Collects messages of a type."""
    return Columns(
        "bag: /topic",
        type_name,
        names or None,
        lambda data: deserialize(typestore(), data, type_name),
    )


def taken(type_name: str, block: list[bytes], *names: str) -> JointStates:
    """The states of a block."""
    own = columns(type_name, *names)
    for data in block:
        own.add([data])
    return own.take()


def joint_block() -> Iterator[bytes]:
    """Two orders of names, both byte orders, and bytes too many at an end."""
    for stamp in range(1, 200):
        if stamp % 7 == 3:
            yield joint(stamp, "x2", "x1")
        elif stamp % 11 == 5:
            yield joint(stamp, "x1", "x2", little=False)
        else:
            yield joint(stamp, "x1", "x2") + bytes(4 * (stamp % 3 == 0))


def test_a_block_of_joint_states_equals_its_messages() -> None:
    """Bit for bit, whatever the order of names and bytes."""
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
    together, alone = decode(OBSERVER, block)
    assert len(together) == 4, "one layout a shape"
    assert not alone


def test_messages_of_many_shapes_are_all_read() -> None:
    """Each message has its own."""
    block = [estimate(stamp, ("c" * stamp,)) for stamp in range(1, 80)]
    np.testing.assert_array_equal(taken(OBSERVER, block).stamps, np.arange(1, 80))


def test_a_layout_stops_where_the_bytes_do() -> None:
    """Cut at any place, a message has no layout or the same; it is never read beyond its end."""
    data = estimate(7, ("stop",), sure=True)
    whole = layout_of(OBSERVER, data)
    assert whole is not None
    for size in range(len(data)):
        cut = layout_of(OBSERVER, data[:size])
        assert cut is None or (cut.q, cut.u, cut.last_event) == (
            whole.q,
            whole.u,
            whole.last_event,
        )


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
    """As if each were read alone."""
    block = [joint(stamp, "x1", "x2") for stamp in range(1, 100)]
    message = deserialize(typestore(), block[37], JOINT)
    for name, value in bad.items():
        setattr(message, name, value)
    block[37] = serialized(message, JOINT)
    with pytest.raises(BagError, match=said):
        taken(JOINT, block)


def test_places_are_counted_through_all_blocks() -> None:
    """The error of a later block names the message of the topic."""
    own = columns(JOINT)
    for stamp in (1, 2, 3):
        own.add([joint(stamp, "x1")])
    own.take()
    bad = deserialize(typestore(), joint(4, "x1"), JOINT)
    bad.position = np.array([np.nan])
    own.add([joint(4, "x1")])
    own.add([serialized(bad, JOINT)])
    with pytest.raises(BagError, match=r"/topic, message 4: JointState.position\[0\] is nan"):
        own.take()


def test_joined_blocks_are_one() -> None:
    """In the same order; estimates stay estimates."""
    own = columns(OBSERVER)
    blocks = []
    for stamps in (range(1, 4), range(4, 5), range(5, 9)):
        for stamp in stamps:
            own.add([estimate(stamp)])
        blocks.append(own.take())
    whole = joined(blocks)
    assert isinstance(whole, ObserverStates)
    np.testing.assert_array_equal(whole.stamps, np.arange(1, 9))
    assert whole.q.shape == (8, 2)
    assert not whole.q.flags.writeable
