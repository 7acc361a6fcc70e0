# SPDX-License-Identifier: Apache-2.0
"""Between values and messages."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from systems import examples

from impact_observer.events import (
    ImpactEstimate,
    ImpactEvent,
    Kind,
    MeasurementVerdict,
    Ruling,
    SmoothedImpact,
    Switch,
    Verdict,
)
from impact_observer.io import interfaces
from impact_observer.io import messages as m
from impact_observer.io.messages import (
    EstimateError,
    JointState,
    MessageError,
    Messages,
    bag_messages,
)
from impact_observer.io.typestores import deserialize, typestore
from impact_observer.stamps import MAX_STAMP
from impact_observer.states import Estimate, Vector, frozen

MAKE = bag_messages()
FLOATS = st.floats(allow_nan=False, allow_infinity=False)
STAMPS = st.integers(1, MAX_STAMP)
EARLY = st.integers(0, MAX_STAMP)
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)
COUNTS = st.integers(0, 2**64 - 1)
EVENTS = st.builds(
    ImpactEvent,
    stamp=STAMPS,
    switches=st.lists(st.builds(Switch, TEXTS, st.sampled_from(Kind)), max_size=3).map(tuple),
    sequence=COUNTS,
    episode=st.integers(0, 2**32 - 1),
    epoch=EARLY,
)
VERDICTS = st.builds(
    Verdict, STAMPS, st.sampled_from(Ruling), COUNTS, TEXTS, TEXTS, FLOATS, revises=st.just(False)
)
SMOOTHED = st.builds(SmoothedImpact, STAMPS, EARLY, COUNTS, TEXTS, st.sampled_from(Ruling), FLOATS)
ESTIMATED_IMPACTS = st.builds(
    ImpactEstimate, STAMPS, TEXTS, st.sampled_from(Ruling), COUNTS, *[FLOATS] * 8
)
SAMPLES = st.builds(
    MeasurementVerdict, STAMPS, TEXTS, FLOATS, FLOATS, FLOATS, st.booleans(), TEXTS
)
NAMES = st.lists(TEXTS, max_size=3, unique=True).map(tuple)


def vectors(size: int) -> SearchStrategy[Vector]:
    """Finite arrays of shape (size,)."""
    return st.lists(FLOATS, min_size=size, max_size=size).map(frozen)


@st.composite
def joint_states(draw: st.DrawFn) -> JointState:
    """States of up to three coordinates."""
    names = draw(NAMES)
    q, u = draw(vectors(len(names))), draw(vectors(len(names)))
    return JointState(draw(STAMPS), names, q, u)


@st.composite
def estimates(draw: st.DrawFn) -> tuple[Estimate, tuple[str, ...]]:
    """Estimates with and without covariance, and their coordinates' names."""
    state = draw(joint_states())
    n = len(state.names)
    estimate = Estimate(
        stamp=state.stamp,
        law=draw(TEXTS),
        q=state.q,
        u=state.u,
        closed=draw(NAMES),
        convergence=draw(FLOATS),
        synchronized=draw(st.booleans()),
        clock_offset=draw(FLOATS),
        last_sequence=draw(COUNTS),
        last_event=draw(EARLY),
    )
    if n and draw(st.booleans()):
        covariance = frozen(np.reshape(draw(vectors(4 * n * n)), (2 * n, 2 * n)))
        estimate = replace(estimate, covariance=covariance)
    return estimate, state.names


@st.composite
def errors(draw: st.DrawFn) -> EstimateError:
    """Errors of estimates of up to three coordinates."""
    state = draw(joint_states())
    return EstimateError(state.stamp, draw(TEXTS), draw(FLOATS), state.names, state.q, state.u)


def through_bytes(message: object, type_name: str) -> Any:  # noqa: ANN401 (a class of rosbags)
    """``message`` after its way through the bytes of a bag."""
    store = typestore()
    return deserialize(store, bytes(store.serialize_cdr(message, type_name)), type_name)


def bits(value: object) -> object:
    """A value whose equality is that of all its fields, of arrays bit for bit."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        return type(value), [bits(getattr(value, each.name)) for each in fields(value)]
    return [bits(each) for each in value] if isinstance(value, tuple) else value


def ns(time: m.AnyMessage) -> int:
    """A time of a message, ns."""
    return int(time.sec * 10**9 + time.nanosec)


def smoothed_impact(b: m.AnyMessage) -> SmoothedImpact:
    """The impact in a message, field by field."""
    stamps = ns(b.header.stamp), ns(b.reported)
    return SmoothedImpact(*stamps, b.sequence, b.contact, Ruling(b.verdict), b.deviation)


def sample_verdict(b: m.AnyMessage) -> MeasurementVerdict:
    """The verdict in a message, field by field."""
    numbers = b.value, b.innovation, b.normalized
    return MeasurementVerdict(ns(b.header.stamp), b.name, *numbers, b.accepted, b.reason)


def estimate_error(b: m.AnyMessage) -> EstimateError:
    """The error in a message, field by field."""
    errors = b.position_error, b.velocity_error
    return EstimateError(ns(b.header.stamp), b.law, b.v, tuple(b.name), *errors)


Maker = Callable[[Messages, Any], object]
Reader = Callable[[m.AnyMessage], object]
VALUES: dict[str, tuple[SearchStrategy[Any], str, Maker, Reader]] = {
    "event": (EVENTS, interfaces.IMPACT_EVENT, Messages.event, m.read_event),
    "verdict": (
        st.tuples(VERDICTS, FLOATS),
        interfaces.EVENT_VERDICT,
        lambda make, both: make.verdict(*both),
        m.read_verdict,
    ),
    "joint_state": (
        joint_states(),
        interfaces.JOINT_STATE,
        Messages.joint_state,
        partial(m.read, JointState),
    ),
    "estimate": (
        estimates(),
        interfaces.OBSERVER_STATE,
        lambda make, both: make.estimate(*both),
        lambda message: m.read_estimate(message)[::-1],
    ),
    "impact_estimate": (
        ESTIMATED_IMPACTS,
        interfaces.IMPACT_ESTIMATE,
        Messages.impact_estimate,
        partial(m.read, ImpactEstimate),
    ),
    "smoothed_impact": (
        SMOOTHED,
        interfaces.SMOOTHED_IMPACT,
        Messages.smoothed_impact,
        smoothed_impact,
    ),
    "sample": (
        SAMPLES,
        interfaces.MEASUREMENT_VERDICT,
        Messages.measurement_verdict,
        sample_verdict,
    ),
    "error": (errors(), interfaces.ESTIMATE_ERROR, Messages.estimate_error, estimate_error),
    "clock": (EARLY, interfaces.CLOCK, Messages.clock, lambda message: ns(message.clock)),
    "model": (TEXTS, interfaces.STRING, Messages.model, lambda message: message.data),
}
"""Values, their message type, and how they are made a message and read again."""


@pytest.mark.parametrize("name", VALUES)
@given(data=st.data())
def test_a_value_survives_its_message(name: str, data: st.DataObject) -> None:
    """A message keeps stamps to the nanosecond, counters, and numbers bit for bit."""
    strategy, type_name, make, read = VALUES[name]
    value = data.draw(strategy)
    assert bits(read(through_bytes(make(MAKE, value), type_name))) == bits(value)


@pytest.mark.slow
@pytest.mark.parametrize("name", VALUES)
@examples(20)
@given(data=st.data())
def test_ros_and_bag_messages_are_the_same_bytes_but_for_padding(
    name: str, data: st.DataObject
) -> None:
    """A bag made here has the same bytes as one recorded from nodes."""
    serialization = pytest.importorskip("rclpy.serialization")
    pytest.importorskip("impact_observer_msgs")
    from impact_observer.ros.topics import ros_messages

    strategy, type_name, make, _ = VALUES[name]
    value, store = data.draw(strategy), typestore()
    ours = bytes(store.serialize_cdr(make(MAKE, value), type_name))
    message = make(ros_messages(), value)
    theirs = serialization.serialize_message(message)
    # Fast CDR leaves what it finds in the bytes that align a field, and some at the end.
    assert store.serialize_cdr(deserialize(store, theirs, type_name), type_name) == ours
    assert serialization.deserialize_message(ours, type(message)) == message


STATE = JointState(1, ("a", "b"), frozen([1.0, 2.0]), frozen([3.0, 4.0]))
ESTIMATE = Estimate(1, "geometric", STATE.q, STATE.u)
APPLIED = Verdict(1, Ruling.APPLIED)
REFUSED: dict[str, Callable[[], object]] = {
    r"JointState\.position\[1\] is nan": lambda: MAKE.joint_state(
        replace(STATE, q=np.array([0, np.nan]))
    ),
    r"JointState\.velocity\[0\] is -inf": lambda: MAKE.joint_state(
        replace(STATE, u=np.array([-np.inf, 0]))
    ),
    r"ObserverState\.convergence is inf": lambda: MAKE.estimate(
        replace(ESTIMATE, convergence=np.inf), STATE.names
    ),
    r"ObserverState\.covariance\[5\] is nan": lambda: MAKE.estimate(
        replace(ESTIMATE, covariance=np.diag([1.0, np.nan, 1.0, 1.0])), STATE.names
    ),
    r"EventVerdict\.innovation": lambda: MAKE.verdict(APPLIED._replace(innovation=np.nan)),
    r"EventVerdict\.latency": lambda: MAKE.verdict(APPLIED, np.inf),
    r"EstimateError\.v ": lambda: MAKE.estimate_error(
        EstimateError(1, "", np.nan, (), frozen([]), frozen([]))
    ),
    r"ImpactEstimate\.impulse": lambda: MAKE.impact_estimate(
        ImpactEstimate(1, "stop", Ruling.APPLIED, impulse=np.nan)
    ),
    r"ImpactEvent\.header\.stamp": lambda: MAKE.event(ImpactEvent(0, ())),
    r"ImpactEvent\.header\.stamp .*at most": lambda: MAKE.event(ImpactEvent(MAX_STAMP + 1, ())),
    r"ImpactEvent\.epoch": lambda: MAKE.event(ImpactEvent(1, (), epoch=-1)),
    r"ObserverState\.last_event": lambda: MAKE.estimate(
        replace(ESTIMATE, last_event=MAX_STAMP + 1), STATE.names
    ),
    r"ImpactEvent\.sequence is -1": lambda: MAKE.event(ImpactEvent(1, (), sequence=-1)),
    r"ImpactEvent\.episode is 4294967296": lambda: MAKE.event(ImpactEvent(1, (), episode=2**32)),
    r"velocity has 1 numbers; expected 2, as named": lambda: MAKE.joint_state(
        replace(STATE, u=frozen([1.0]))
    ),
    r"covariance has 4 numbers; expected 16": lambda: MAKE.estimate(
        replace(ESTIMATE, covariance=np.eye(2)), STATE.names
    ),
}
"""Values that no message can carry, by the name of what is wrong."""


@pytest.mark.parametrize("wrong", REFUSED)
def test_value_that_no_message_can_carry_is_refused(wrong: str) -> None:
    """Numbers are finite and as many as names; stamps start above zero and end in 2038."""
    with pytest.raises(MessageError, match=wrong):
        REFUSED[wrong]()


def test_state_has_its_columns_by_name() -> None:
    """Columns are in the order of the argument; other, missing or repeated names are refused."""
    state = JointState(7, ("a", "b"), np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    turned = state.ordered(("b", "a"))
    assert (turned.stamp, turned.names) == (7, ("b", "a"))
    assert (turned.q.tolist(), turned.u.tolist()) == ([2.0, 1.0], [4.0, 3.0])
    for others in (("a",), ("a", "c"), ("a", "b", "c"), ("a", "b", "b")):
        with pytest.raises(MessageError, match=f"^names a, b; expected {', '.join(others)}$"):
            state.ordered(others)


def test_received_stamp_must_be_a_time() -> None:
    """A second has less than 10^9 nanoseconds, and an event has a stamp."""
    message = MAKE.event(ImpactEvent(5, ()))
    message.header.stamp.nanosec = 10**9
    with pytest.raises(MessageError, match=r"stamp\.nanosec is 1000000000"):
        m.read_event(message)
    message.header.stamp.nanosec = 0
    with pytest.raises(MessageError, match=r"stamp is 0\.000000000 s; expected more than 0"):
        m.read_event(message)


def test_received_constant_must_be_known() -> None:
    """The error lists those that are."""
    event = MAKE.event(ImpactEvent(5, (Switch("a"),)))
    event.switches[0].kind = 7
    with pytest.raises(MessageError, match=r"ContactSwitch\.kind is 7; expected 0 \(IMPACT\)"):
        m.read_event(event)
    verdict = MAKE.verdict(Verdict(5, Ruling.APPLIED))
    verdict.verdict = 9
    with pytest.raises(MessageError, match=r"EventVerdict\.verdict is 9; .*3 \(DUPLICATE\)"):
        m.read_verdict(verdict)


@pytest.mark.parametrize(
    ("limit", "switches"),
    [("switches", (Switch("stop"),) * 101), ("contact", (Switch("s" * 257),))],
)
def test_an_event_of_too_many_contacts_or_too_long_a_name_is_refused(
    limit: str, switches: tuple[Switch, ...]
) -> None:
    """By nodes and by readers of bags."""
    message = MAKE.event(ImpactEvent(1, switches))
    with pytest.raises(m.MessageError, match=f"{limit}; expected at most"):
        m.read_event(message)
