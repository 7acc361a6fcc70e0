# SPDX-License-Identifier: Apache-2.0
"""Estimates as bytes: ROS deserializes them to the messages."""

import math
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from hypothesis import given
from hypothesis import strategies as st
from impact_observer_msgs.msg import ObserverState
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState as JointStateMessage
from systems import examples

from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io.messages import AnyMessage, JointState, MessageError
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.serialized import EstimateSerializer, read_impact
from impact_observer.states import Estimate

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)


@st.composite
def estimates(draw: st.DrawFn) -> tuple[tuple[str, ...], Estimate]:
    """Names, and an estimate of any shape."""
    names = tuple(draw(st.lists(TEXTS, min_size=1, max_size=3)))
    n = len(names)
    vectors = st.lists(NUMBERS, min_size=n, max_size=n).map(np.array)
    root = draw(st.sampled_from([0, 2 * n]))
    covariance = draw(st.lists(NUMBERS, min_size=root**2, max_size=root**2))
    stamps = st.integers(1, 2_000_000_000_000_000_000)
    estimate = Estimate(
        draw(stamps),
        draw(TEXTS),
        draw(vectors),
        draw(vectors),
        np.array(covariance).reshape(root, root),
        tuple(draw(st.lists(TEXTS, max_size=3))),
        draw(NUMBERS),
        draw(st.booleans()),
        clock_offset=draw(NUMBERS),
        parameters=tuple(draw(st.lists(st.tuples(TEXTS, NUMBERS, NUMBERS), max_size=2))),
        last_sequence=draw(st.integers(0, 2**64 - 1)),
        last_event=draw(stamps | st.just(0)),
    )
    return names, estimate


@pytest.mark.slow
@given(estimates())
@examples(100)
def test_bytes_deserialize_to_the_messages(case: tuple[tuple[str, ...], Estimate]) -> None:
    """Whatever its shape, and however large its numbers."""
    names, estimate = case
    state, joints = EstimateSerializer(names).messages(estimate)
    make = ros_messages()
    joint_state = JointState(estimate.stamp, names, estimate.q, estimate.u)
    assert deserialize_message(state, ObserverState) == make.estimate(estimate, names)
    assert deserialize_message(joints, JointStateMessage) == make.joint_state(joint_state)


def test_nothing_of_an_estimate_stays_in_the_next() -> None:
    """One of another shape between them, too."""
    made, zeros = EstimateSerializer(("x",)), np.zeros(1)
    first = Estimate(1, "law", zeros + 1, zeros, last_sequence=7, last_event=5, synchronized=True)
    closed = Estimate(2, "law", zeros, zeros, closed=("stop",))
    plain = Estimate(3, "law", zeros, zeros)

    def read(serializer: EstimateSerializer, estimate: Estimate) -> list[AnyMessage]:
        state, joints = serializer.messages(estimate)  # padding between their fields is any bytes
        return [
            deserialize_message(state, ObserverState),
            deserialize_message(joints, JointStateMessage),
        ]

    before = read(EstimateSerializer(("x",)), plain)
    for each in (first, closed):
        assert read(made, each) != before
    assert read(made, plain) == before


@pytest.mark.parametrize(
    ("estimate", "what"),
    [
        (Estimate(1, "law", np.array([math.nan]), np.zeros(1)), "position"),
        (Estimate(1, "law", np.zeros(1), np.array([math.inf])), "velocity"),
        (Estimate(0, "law", np.zeros(1), np.zeros(1)), "stamp"),
        (Estimate(1, "law", np.zeros(1), np.zeros(1), convergence=math.nan), "convergence"),
        (Estimate(1, "law", np.zeros(2), np.zeros(2)), "2 numbers; expected 1"),
    ],
)
def test_what_no_message_may_carry_is_refused(estimate: Estimate, what: str) -> None:
    """With the words of the messages themselves."""
    with pytest.raises(MessageError, match=what):
        EstimateSerializer(("x",)).messages(estimate)


@given(
    st.builds(
        ImpactEvent,
        st.integers(1, 2_000_000_000_000_000_000),
        st.lists(st.builds(Switch, TEXTS, st.sampled_from(Kind)), max_size=3).map(tuple),
        st.integers(0, 2**64 - 1),
        st.integers(0, 2**32 - 1),
        st.integers(0, 2_000_000_000_000_000_000),
    ),
    TEXTS,
)
@examples(100)
def test_event_is_read_as_it_was_sent(event: ImpactEvent, frame: str) -> None:
    """In whatever frame, with however many switches."""
    message = ros_messages().event(event)
    message.header.frame_id = frame
    assert read_impact(bytes(serialize_message(message))) == event


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda message: setattr(message.header.stamp, "nanosec", 0), "header.stamp is"),
        (lambda message: setattr(message.header.stamp, "nanosec", 10**9), "nanosec is 1000000000"),
        (lambda message: setattr(message.epoch, "sec", -1), "epoch is"),
        (lambda message: setattr(message.switches[0], "kind", 7), "kind is 7"),
    ],
)
def test_event_that_cannot_be_is_refused(change: Callable[[AnyMessage], None], what: str) -> None:
    """With the words of the messages themselves."""
    message = ros_messages().event(ImpactEvent(5, (Switch("stop"),), 1))
    change(message)
    with pytest.raises(MessageError, match=what):
        read_impact(bytes(serialize_message(message)))
