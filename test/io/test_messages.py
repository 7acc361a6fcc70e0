# SPDX-License-Identifier: Apache-2.0
"""Between values and messages."""

import math
from collections.abc import Callable
from dataclasses import replace

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
IMPACTS = st.builds(SmoothedImpact, STAMPS, EARLY, COUNTS, TEXTS, st.sampled_from(Ruling), FLOATS)
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


def through_bytes(message: object, type_name: str) -> object:
    """``message`` after its way through the bytes of a bag."""
    store = typestore()
    return deserialize(store, bytes(store.serialize_cdr(message, type_name)), type_name)


def same(left: object, right: object) -> bool:
    """Whether two of our values are equal, arrays bit for bit."""
    for name in type(left).__dataclass_fields__:  # type: ignore[attr-defined]
        a, b = getattr(left, name), getattr(right, name)
        equal = a.tobytes() == b.tobytes() if isinstance(a, np.ndarray) else a == b
        if not equal:
            return False
    return type(left) is type(right)


@given(event=EVENTS)
def test_event_survives_its_message(event: ImpactEvent) -> None:
    """A message keeps stamps to the nanosecond, and counters to the last bit."""
    back = through_bytes(bag_messages().event(event), interfaces.IMPACT_EVENT)
    assert m.read_event(back) == event


@given(verdict=VERDICTS, latency=FLOATS)
def test_verdict_survives_its_message(verdict: Verdict, latency: float) -> None:
    """A message keeps the verdict and its latency."""
    back = through_bytes(bag_messages().verdict(verdict, latency), interfaces.EVENT_VERDICT)
    assert m.read_verdict(back) == (verdict, latency)


@given(state=joint_states())
def test_joint_state_survives_its_message(state: JointState) -> None:
    """A message keeps the numbers bit for bit."""
    back = through_bytes(bag_messages().joint_state(state), interfaces.JOINT_STATE)
    assert same(m.read_joint_state(back), state)


@given(both=estimates())
def test_estimate_survives_its_message(both: tuple[Estimate, tuple[str, ...]]) -> None:
    """A message keeps the estimate, its names and the shape of its covariance."""
    back = through_bytes(bag_messages().estimate(*both), interfaces.OBSERVER_STATE)
    names, estimate = m.read_estimate(back)
    assert names == both[1]
    assert same(estimate, both[0])


@given(impact=IMPACTS)
def test_smoothed_impact_survives_its_message(impact: SmoothedImpact) -> None:
    """A message keeps the stamps to the nanosecond, and the deviation bit for bit."""
    back: m.AnyMessage = through_bytes(
        bag_messages().smoothed_impact(impact), interfaces.SMOOTHED_IMPACT
    )
    stamps = [each.sec * 10**9 + each.nanosec for each in (back.header.stamp, back.reported)]
    assert stamps == [impact.stamp, impact.reported]
    assert (back.sequence, back.contact) == (impact.sequence, impact.contact)
    assert (back.verdict, back.deviation) == (impact.ruling, impact.deviation)


@given(impact=ESTIMATED_IMPACTS)
def test_estimate_of_an_impact_survives_its_message(impact: ImpactEstimate) -> None:
    """A message keeps the numbers bit for bit, each in the field of its name."""
    message = bag_messages().impact_estimate(impact)
    assert message.impulse == impact.impulse
    assert message.energy_loss_deviation == impact.energy_loss_deviation
    assert m.read_impact_estimate(through_bytes(message, interfaces.IMPACT_ESTIMATE)) == impact


def test_no_message_carries_an_impact_with_a_number_that_is_not_finite() -> None:
    """The error names the field."""
    impact = ImpactEstimate(1, "stop", Ruling.APPLIED, impulse=math.nan)
    with pytest.raises(m.MessageError, match=r"ImpactEstimate\.impulse"):
        bag_messages().impact_estimate(impact)


@given(verdict=SAMPLES)
def test_verdict_on_a_sample_survives_its_message(verdict: MeasurementVerdict) -> None:
    """A message keeps the numbers bit for bit."""
    made = bag_messages().measurement_verdict(verdict)
    back: m.AnyMessage = through_bytes(made, interfaces.MEASUREMENT_VERDICT)
    fields = [getattr(back, name) for name in verdict._fields if name != "stamp"]
    assert fields == [*verdict[1:]]
    assert m.read_stamp("header", back.header.stamp) == verdict.stamp


@given(error=errors())
def test_estimate_error_survives_its_message(error: EstimateError) -> None:
    """A message keeps the numbers bit for bit."""
    back: m.AnyMessage = through_bytes(
        bag_messages().estimate_error(error), interfaces.ESTIMATE_ERROR
    )
    assert (back.law, back.v, tuple(back.name)) == (error.law, error.v, error.names)
    np.testing.assert_array_equal(back.position_error, error.position_error)
    np.testing.assert_array_equal(back.velocity_error, error.velocity_error)


MAKERS: SearchStrategy[tuple[str, Callable[[Messages], object]]] = st.one_of(
    EVENTS.map(lambda v: (interfaces.IMPACT_EVENT, lambda make: make.event(v))),
    ESTIMATED_IMPACTS.map(
        lambda v: (interfaces.IMPACT_ESTIMATE, lambda make: make.impact_estimate(v))
    ),
    IMPACTS.map(lambda v: (interfaces.SMOOTHED_IMPACT, lambda make: make.smoothed_impact(v))),
    VERDICTS.map(lambda v: (interfaces.EVENT_VERDICT, lambda make: make.verdict(v, 0.25))),
    joint_states().map(lambda v: (interfaces.JOINT_STATE, lambda make: make.joint_state(v))),
    estimates().map(lambda v: (interfaces.OBSERVER_STATE, lambda make: make.estimate(*v))),
    errors().map(lambda v: (interfaces.ESTIMATE_ERROR, lambda make: make.estimate_error(v))),
    EARLY.map(lambda v: (interfaces.CLOCK, lambda make: make.clock(v))),
    TEXTS.map(lambda v: (interfaces.STRING, lambda make: make.model(v))),
)


@pytest.mark.slow
@examples(100)
@given(maker=MAKERS)
def test_ros_and_bag_messages_are_the_same_bytes_but_for_padding(
    maker: tuple[str, Callable[[Messages], object]],
) -> None:
    """A bag made here has the same bytes as one recorded from nodes."""
    serialization = pytest.importorskip("rclpy.serialization")
    pytest.importorskip("impact_observer_msgs")
    from impact_observer.ros.topics import ros_messages

    type_name, make = maker
    store = typestore()
    ours = bytes(store.serialize_cdr(make(bag_messages()), type_name))
    message = make(ros_messages())
    theirs = serialization.serialize_message(message)
    # Fast CDR leaves what it finds in the bytes that align a field, and some at the end.
    assert store.serialize_cdr(deserialize(store, theirs, type_name), type_name) == ours
    assert serialization.deserialize_message(ours, type(message)) == message


STATE = JointState(1, ("a", "b"), frozen([1.0, 2.0]), frozen([3.0, 4.0]))
ESTIMATE = Estimate(1, "geometric", STATE.q, STATE.u)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_number_that_is_not_finite_is_refused(bad: float) -> None:
    """The error names message, field and entry."""
    make = bag_messages()
    for field, refused in (
        (
            r"JointState\.position\[1\]",
            lambda: make.joint_state(replace(STATE, q=np.array([0, bad]))),
        ),
        (
            r"JointState\.velocity\[0\]",
            lambda: make.joint_state(replace(STATE, u=np.array([bad, 0]))),
        ),
        (
            r"ObserverState\.convergence",
            lambda: make.estimate(replace(ESTIMATE, convergence=bad), STATE.names),
        ),
        (
            r"ObserverState\.clock_offset",
            lambda: make.estimate(replace(ESTIMATE, clock_offset=bad), STATE.names),
        ),
        (
            r"ObserverState\.covariance\[5\]",
            lambda: make.estimate(
                replace(ESTIMATE, covariance=np.diag([1.0, bad, 1.0, 1.0])), STATE.names
            ),
        ),
        (
            r"EventVerdict\.innovation",
            lambda: make.verdict(Verdict(1, Ruling.APPLIED, innovation=bad)),
        ),
        (r"EventVerdict\.latency", lambda: make.verdict(Verdict(1, Ruling.APPLIED), bad)),
        (
            r"EstimateError\.v ",
            lambda: make.estimate_error(EstimateError(1, "", bad, (), frozen([]), frozen([]))),
        ),
    ):
        with pytest.raises(MessageError, match=field):
            refused()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("stamp", [0, -1, MAX_STAMP + 1])
def test_stamp_that_no_message_can_carry_is_refused(stamp: int) -> None:
    """Stamps start above zero and end in 2038."""
    with pytest.raises(MessageError, match=r"ImpactEvent\.header\.stamp"):
        bag_messages().event(ImpactEvent(stamp, ()))
    with pytest.raises(MessageError, match=r"ImpactEvent\.epoch"):
        bag_messages().event(ImpactEvent(1, (), epoch=stamp or -1))
    with pytest.raises(MessageError, match=r"ObserverState\.last_event"):
        bag_messages().estimate(replace(ESTIMATE, last_event=stamp or -1), STATE.names)


def test_counter_that_does_not_fit_is_refused() -> None:
    """The error names the field of the counter."""
    with pytest.raises(MessageError, match=r"ImpactEvent\.sequence is -1"):
        bag_messages().event(ImpactEvent(1, (), sequence=-1))
    with pytest.raises(MessageError, match=r"ImpactEvent\.episode is 4294967296"):
        bag_messages().event(ImpactEvent(1, (), episode=2**32))


def test_arrays_that_do_not_fit_the_names_are_refused() -> None:
    """A message needs one number for each name."""
    with pytest.raises(MessageError, match=r"velocity has 1 numbers; expected 2, as named"):
        bag_messages().joint_state(replace(STATE, u=frozen([1.0])))
    with pytest.raises(MessageError, match=r"covariance has 4 numbers; expected 16"):
        bag_messages().estimate(replace(ESTIMATE, covariance=np.eye(2)), STATE.names)


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
    message = bag_messages().event(ImpactEvent(5, ()))
    message.header.stamp.nanosec = 10**9
    with pytest.raises(MessageError, match=r"stamp\.nanosec is 1000000000"):
        m.read_event(message)
    message.header.stamp.nanosec = 0
    with pytest.raises(MessageError, match=r"stamp is 0\.000000000 s; expected more than 0"):
        m.read_event(message)


def test_received_constant_must_be_known() -> None:
    """The error lists those that are."""
    event = bag_messages().event(ImpactEvent(5, (Switch("a"),)))
    event.switches[0].kind = 7
    with pytest.raises(MessageError, match=r"ContactSwitch\.kind is 7; expected 0 \(IMPACT\)"):
        m.read_event(event)
    verdict = bag_messages().verdict(Verdict(5, Ruling.APPLIED))
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
    message = m.bag_messages().event(ImpactEvent(1, switches))
    with pytest.raises(m.MessageError, match=f"{limit}; expected at most"):
        m.read_event(message)
