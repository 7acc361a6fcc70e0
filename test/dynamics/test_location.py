"""The first closing gap is found, wherever it hides."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import optimize
from systems import Harmonic, examples, forcing, numbers, sample, system, systems, vectors

from impact_observer.dynamics import Closing, ContactSearch, flow_of
from impact_observer.dynamics.bounds import GapBounds
from impact_observer.model import System

Array = NDArray[np.float64]


def search(model: System, x: Array, horizon: float, t: float = 0.0) -> Closing | None:
    """The first closing along the motion through ``x`` at ``t``."""
    return ContactSearch(model).first_closing(flow_of(model).start(t, x), horizon)


def assert_closing(found: Closing | None, s: float, *contacts: int) -> None:
    """The closing is that of ``contacts`` at ``s``."""
    assert found is not None
    assert found.s == pytest.approx(s, abs=1e-14)
    assert found.contacts == contacts


def sampled(model: System, x: Array, horizon: float, t: float) -> float | None:
    """The first closing of a gap by looking at 4001 samples and refining the first sign."""
    motion = flow_of(model).start(t, x)
    s = np.linspace(0.0, horizon, 4_001)
    g = motion.states(s)[:, : model.n] @ model.W + model.q_r
    roots = []
    for i in range(model.m):
        below = np.flatnonzero((g[:-1, i] > 0) & (g[1:, i] <= 0))
        if below.size:
            low, high = s[below[0]], s[below[0] + 1]
            roots.append(
                optimize.brentq(
                    lambda at, i=i: float(model.gap(motion.state(at)[: model.n])[i]), low, high
                )
            )
    return min(roots, default=None)


@examples(40)
@given(st.data())
def test_first_closing_is_the_one_that_dense_sampling_finds(data: st.DataObject) -> None:
    """Or an earlier one between two samples, with all gaps open before it."""
    model = data.draw(systems(contacts=(1, 3), gaps=(0.0, 2.0)))
    x = np.concatenate([data.draw(vectors(model.n, -1, 1)), data.draw(vectors(model.n, -4, 4))])
    assume(np.all(model.gap(x[: model.n]) > 0.01))
    t, horizon = data.draw(numbers(0, 4)), 4.0
    found = search(model, x, horizon, t)
    expected = sampled(model, x, horizon, t)
    if found is None:
        assert expected is None
        return
    motion = flow_of(model).start(t, x)
    before = motion.states(np.linspace(0.0, found.s, 2001))[:, : model.n]
    assert np.min(before @ model.W + model.q_r) > -1e-11
    assert np.max(np.abs(model.gap(before[-1])[list(found.contacts)])) < 1e-11
    if expected is None or found.s < expected - 1e-9:
        assert found.contacts  # a shorter dip than the sampling sees, and it is a true one
        assert model.gap(motion.state(found.s + 1e-7)[: model.n])[found.contacts[0]] < 0
    else:
        assert found.s == pytest.approx(expected, abs=1e-9)


@examples(40)
@given(st.data())
def test_bounds_hold_between_samples(data: st.DataObject) -> None:
    """No gap gets below its lower bound, no acceleration above its upper one."""
    model = data.draw(systems(contacts=(1, 3)))
    x = np.concatenate([data.draw(vectors(model.n)), data.draw(vectors(model.n, -4, 4))])
    t, h = data.draw(numbers(0, 4)), data.draw(st.sampled_from([0.01, 0.1, 0.5, 2.0]))
    motion = flow_of(model).start(t, x)
    s = h * np.arange(4.0)
    states = motion.states(s)
    q, u = states[:, : model.n], states[:, model.n :]
    g, gamma = q @ model.W + model.q_r, u @ model.W
    bounds = GapBounds(model)
    derivatives = bounds.derivatives(t + s[:-1], q[:-1], u[:-1])
    low = bounds.lower(g, derivatives, gamma, h)
    high = bounds.acceleration(derivatives, h)
    for j in range(3):
        fine = s[j] + np.linspace(0.0, h, 101)
        inside = motion.states(fine)
        gaps = inside[:, : model.n] @ model.W + model.q_r
        loads = np.array([model.forcing(t + at) for at in fine])
        loads -= inside[:, model.n :] @ model.C.T + inside[:, : model.n] @ model.K
        accelerations = np.linalg.solve(model.M, loads.T).T @ model.W
        assert np.all(gaps.min(axis=0) >= low[j] - 1e-9 * (1 + np.abs(gaps).max()))
        assert np.all(np.abs(accelerations) <= high[j] + 1e-9 * (1 + np.abs(accelerations).max()))


def test_gap_that_closes_and_opens_between_two_samples_is_found() -> None:
    """A dip of a millisecond in a motion that is sampled every tenth of a second."""
    # x = cos t against a stop just below its peak: closed for about 2 sqrt(2 d).
    for depth in (1e-3, 1e-7, 1e-10):
        model = system(1, 0, 1, contacts=[([-1], 1 - depth, 0.5)])
        start = flow_of(model).start(0.0, np.array([np.cos(-2.0), -np.sin(-2.0)]))
        found = ContactSearch(model).first_closing(start, 5.0)
        assert found is not None
        assert found.s == pytest.approx(2.0 - np.arccos(1 - depth), abs=1e-11 / np.sqrt(depth))


def test_deepest_graze_passed_over_is_as_deep_as_rounding() -> None:
    """A touch that no double can tell from none is none; it is found at a picometre."""
    start = np.array([np.cos(-2.0), -np.sin(-2.0)])
    shallow = system(1, 0, 1, contacts=[([-1], 1 + 1e-12, 0.5)])
    assert search(shallow, start, 5.0) is None
    deep = system(1, 0, 1, contacts=[([-1], 1 - 1e-12, 0.5)])
    assert search(deep, start, 5.0) is not None


def test_earlier_of_two_crossings_in_one_window_is_found() -> None:
    """Two contacts, and one contact twice."""
    both = system(1, 0, 1, contacts=[([-1], 0.9, 0.5), ([-1], 0.8, 0.5)])
    found = search(both, np.array([0.0, 1.0]), 10.0)
    assert_closing(found, np.arcsin(0.8), 1)
    # Fast and slow together: the first of many crossings.
    beats = system(
        np.eye(2), np.zeros((2, 2)), np.diag([1.0, 2500.0]), contacts=[([1, 1], 0.0, 1)]
    )
    x = np.array([1.0, 1.5, 0.0, 0.0])
    found = search(beats, x, 3.0)
    assert found is not None
    first = optimize.brentq(lambda s: np.cos(s) + 1.5 * np.cos(50 * s), 0.0, np.pi / 50)
    assert found.s == pytest.approx(first, abs=1e-13)


def test_contacts_that_close_together_are_told_together() -> None:
    """A symmetric motion hits both walls at one instant."""
    model = system(
        np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=[([1, 0], 0.5, 1), ([0, -1], 0.5, 1)]
    )
    found = search(model, np.array([0.0, 0.0, -1.0, 1.0]), 5.0)
    assert_closing(found, np.pi / 6, 0, 1)


def test_nothing_closes_beyond_the_horizon() -> None:
    """The horizon itself is looked at, and nothing after it."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    x = np.array([1.0, -1.0])
    assert search(model, x, 0.999) is None
    found = search(model, x, 1.001)
    assert_closing(found, 1.0, 0)


def test_contact_that_just_separated_is_not_found_again() -> None:
    """A gap that rounding leaves below zero opens without a second impact."""
    model = sample("bouncing_ball").system
    for rounding in (0.0, -1e-16, -1e-14):
        found = search(model, np.array([rounding, 1.0]), 1.0)
        assert found is not None
        assert found.s == pytest.approx(2 / 9.81, abs=1e-12)


def test_window_does_not_decide_what_is_found() -> None:
    """Looking on where one stopped finds what one look finds."""
    model = sample("three_mass").system
    x = np.array([0.1, -0.1, 0.05, 0.5, 0.0, -0.5])
    motion, look = flow_of(model).start(0.0, x), ContactSearch(model)
    once = look.first_closing(motion, 10.0)
    assert once is not None
    pieces, start, found = np.linspace(0.0, 10.0, 97)[1:], 0.0, None
    for stop in pieces:
        found = look.first_closing(motion, stop, start)
        if found is not None:
            break
        start = stop
    assert found is not None
    assert found.s == pytest.approx(once.s, abs=1e-14)


AT_REST = {
    "in equilibrium": system(1, 0.1, 2, contacts=[([-1], 0.3, 0.8)], force=forcing(1, 0.6)),
    "beside one that moves": system(
        np.eye(2),
        np.zeros((2, 2)),
        np.diag([2.0, 9.0]),
        contacts=[([-1, 0], 0.3, 0.8)],
        force=forcing(2, [0.6, 0.0]),
    ),
    "beside one that is shaken": system(
        np.eye(2),
        np.zeros((2, 2)),
        np.diag([2.0, 9.0]),
        contacts=[([-1, 0], 0.3, 0.8)],
        force=forcing(2, [0.6, 0.0], [Harmonic(40.0, [0, 1], [0, 0])]),
    ),
    "in the node of a mode": system(
        np.eye(3),
        np.zeros((3, 3)),
        10 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)),
        contacts=[([0, -1, 0], 0.0, 0.5), ([0, 1, 0], 0.0, 0.5)],
    ),
}


@pytest.mark.parametrize("model", AT_REST.values(), ids=list(AT_REST))
def test_body_at_rest_against_its_stop_costs_little(model: System) -> None:
    """A gap that stays zero is not divided for ever, whatever else moves."""
    x = np.zeros(2 * model.n)
    x[0] = -model.q_r[0] / model.W[0, 0] if model.W[0, 0] else 1.0
    x[model.n - 1] += -1.0 if model.n == 3 else float(model.n == 2)
    motion, look = flow_of(model).start(0.0, x), ContactSearch(model)
    calls = 0
    original = motion.states

    def counted(s: Array) -> Array:
        nonlocal calls
        calls += 1
        return original(s)

    motion.states = counted  # type: ignore[method-assign]
    assert look.first_closing(motion, 10.0) is None
    assert calls < 60 * (1 + 10.0 / look.window)
