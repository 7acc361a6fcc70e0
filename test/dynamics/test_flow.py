# SPDX-License-Identifier: Apache-2.0
"""The exact flow of a linear phase, against arithmetic that shares nothing with it."""

import numpy as np
import precise
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import linalg
from systems import (
    LAPLACIAN,
    Harmonic,
    chain,
    examples,
    flow_of,
    forcing,
    numbers,
    sample,
    state_matrix,
    system,
    systems,
)

from impact_observer.model import System

Array = NDArray[np.float64]


def error(model: System, found: Array, expected: Array, start: Array) -> float:
    """Largest error, in units of the largest state; positions count with the fastest mode."""
    stiffest = linalg.eigh(model.K, model.M, eigvals_only=True)[-1]
    unit = np.repeat([max(1.0, np.sqrt(max(stiffest, 0.0))), 1.0], model.n)
    scale = max(np.max(np.abs(np.vstack([expected, start]) * unit)), 1e-3)
    return float(np.max(np.abs(found - expected) * unit) / scale)


def oscillator(c: float, k: float, *harmonics: Harmonic, constant: float = 0.0) -> System:
    """One unit mass."""
    return system(1, c, k, force=forcing(1, constant, harmonics))


def push(frequency: float) -> Harmonic:
    """A harmonic on one coordinate."""
    return Harmonic(frequency, [1.0], [0.5])


TWO = [Harmonic(2.7, [3, 0, 1], [0, 0, 2]), Harmonic(0.4, [0, 1, 0], [0, 1, 1])]
NOT_PROPORTIONAL = np.array([[0.3, 0, 0], [0, 0, 0], [0, 0, 0.7]])
SKEW = np.array([[0, 2.0, 0], [-2, 0, 1], [0, -1, 0]])
PHASES = {
    "two_mass": sample("two_mass").system,
    "three_mass": sample("three_mass").system,
    "ball": sample("bouncing_ball").system,
    "not proportional": system(
        np.diag([1, 2, 3]), NOT_PROPORTIONAL, 9 * LAPLACIAN + np.eye(3), force=forcing(3, 1, TWO)
    ),
    "gyroscopic": system(
        np.eye(3), SKEW, 5 * LAPLACIAN + np.eye(3), force=forcing(3, [1, 2, 3], TWO)
    ),
    "gyroscopic and damped": system(
        np.eye(3), SKEW + NOT_PROPORTIONAL, 5 * LAPLACIAN + np.eye(3), force=forcing(3, 0, TWO)
    ),
    "rigid": system(
        np.diag([1, 2, 3]), 0.1 * LAPLACIAN, 4 * LAPLACIAN, force=forcing(3, [1, 0, 2], TWO)
    ),
    "rigid, not proportional": system(
        np.diag([1, 2, 3]), NOT_PROPORTIONAL, 4 * LAPLACIAN, force=forcing(3, [1, 0, 2], TWO)
    ),
    "no stiffness": system(
        np.eye(3), np.diag([0, 0.1, 3]), 0 * LAPLACIAN, force=forcing(3, 1, TWO)
    ),
    "coupled mass": system(
        [[2, 0.5], [0.5, 1]], np.diag([0.1, 0]), [[3, 1], [1, 2]], force=forcing(2, [0, 1])
    ),
    "critical": oscillator(2.0, 1.0, push(0.7), constant=1.0),
    "critical, unequal pair": system(np.eye(2), np.diag([2.0, 4]), np.diag([1.0, 4])),
    "resonant": oscillator(0.0, 1.0, push(1.0)),
    "resonant, constant": oscillator(0.0, 1.0, push(1.0), push(2.0), constant=3.0),
    "resonant and critical": system(
        np.eye(2), np.diag([0, 2.0]), np.eye(2), force=forcing(2, 1, [Harmonic(1, [1, 1], [0, 1])])
    ),
    "drift against drag": oscillator(0.3, 0.0, push(0.7), constant=1.0),
    "overdamped": oscillator(20.0, 1.0, push(3.0), constant=1.0),
    "stiff, oscillating": system(np.eye(2), np.zeros((2, 2)), np.diag([1.0, 1e4])),
}
PHASES |= {
    f"nearly critical {delta:g}": oscillator(2.0 * (1 + delta), 1.0, push(0.7), constant=1.0)
    for delta in (-1e-2, -1e-6, -1e-10, -1e-15, 1e-15, 1e-10, 1e-6, 1e-2)
}
PHASES |= {
    f"nearly resonant {delta:g}": oscillator(0.0, 1.0, push(1 + delta))
    for delta in (1e-15, 1e-12, 1e-9, -1e-6, 0.9e-3, 1.1e-3, 9e-3, -1.1e-2)
}
PHASES |= {
    f"lightly damped resonance {c:g}": oscillator(c, 4.0, push(2.0)) for c in (1e-12, 1e-6, 3e-3)
}
PHASES |= {
    f"nearly free {k:g}": oscillator(0.0, k, push(0.3), constant=1.0)
    for k in (1e-14, 1e-8, 1e-4, 9e-3, 1.1e-2)
}


@pytest.mark.parametrize("model", PHASES.values(), ids=list(PHASES))
def test_flow_is_exact(model: System) -> None:
    """Against the power series in 90 digits, from two starting times."""
    x = np.linspace(1.0, -0.7, 2 * model.n)
    seconds = np.array([0.0, 1e-9, 0.013, 0.4, 1.7])
    for t in (0.0, 3.3):
        expected = precise.flow(model, t, x, seconds.tolist())
        assert error(model, flow_of(model).start(t, x).states(seconds), expected, x) < 3e-14


@pytest.mark.parametrize("seconds", [1e-6, 1e-3, 1.0, 10.0])
def test_stiff_overdamped_flow_keeps_the_slow_motion(seconds: float) -> None:
    """Eigenvalues that differ by a factor of 1e8: both exponentials have a closed form."""
    c, k = 1e4, 1.0
    fast = -(c + np.sqrt(c * c - 4 * k)) / 2
    slow = k / fast
    q0, u0 = 1.0, 2.0
    # q = a e^{slow s} + b e^{fast s}
    b = (u0 - slow * q0) / (fast - slow)
    a = q0 - b
    late, early = np.exp(slow * seconds), np.exp(fast * seconds)
    expected = [a * late + b * early, a * slow * late + b * fast * early]
    found = flow_of(oscillator(c, k)).start(0.0, np.array([q0, u0])).state(seconds)
    assert abs(found[0] - expected[0]) < 1e-11 * abs(expected[0])
    assert abs(found[1] - expected[1]) < 1e-14 * abs(u0)


def test_resonance_grows_linearly_for_a_thousand_periods() -> None:
    """``x'' + x = cos t`` from rest is ``t sin(t) / 2`` exactly."""
    flow = flow_of(oscillator(0.0, 1.0, Harmonic(1.0, [1.0], [0.0])))
    s = np.linspace(0.0, 2000 * np.pi, 57)
    q = flow.start(0.0, np.zeros(2)).states(s)[:, 0]
    np.testing.assert_allclose(q, s * np.sin(s) / 2, atol=1e-12 * s[-1])


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 13, 21, 30])
def test_flow_of_any_size_agrees_with_a_matrix_exponential(n: int) -> None:
    """The augmented matrix is assembled here, row by row."""
    rng = np.random.default_rng(n)
    root, twist = rng.normal(size=(n, n)), rng.normal(size=(n, n))
    M = root @ root.T / n + np.eye(n)
    C = 0.1 * np.diag(rng.uniform(size=n)) + 0.1 * (twist - twist.T)
    cosine = rng.normal(size=n)
    model = system(
        M,
        C,
        10 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)),
        force=forcing(n, 0.3, [Harmonic(2.2, cosine.tolist(), [0.0] * n)]),
    )
    A = np.zeros((2 * n + 3, 2 * n + 3))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n] = np.linalg.solve(
        M, np.hstack([-model.K, -C, np.full((n, 1), 0.3), cosine[:, None], np.zeros((n, 1))])
    )
    A[-2, -1], A[-1, -2] = -2.2, 2.2
    x, t, s = rng.normal(size=2 * n), 0.8, 1.3
    start = np.concatenate([x, [1.0, np.cos(2.2 * t), np.sin(2.2 * t)]])
    expected = (linalg.expm(s * A) @ start)[None, : 2 * n]
    found = flow_of(model).start(t, x).states(np.array([s]))
    assert error(model, found, expected, x) < 2e-13


def test_flow_of_unforced_system_does_not_depend_on_the_start_time() -> None:
    """Shifting an autonomous motion in time changes no bit."""
    model = chain(3)
    x = np.arange(6.0)
    early, late = (flow_of(model).start(t, x).state(0.7) for t in (0.0, 123.456))
    assert early.tolist() == late.tolist()


def test_forcing_is_periodic_in_the_starting_time() -> None:
    """A whole number of periods later the forced motion is the same."""
    model = sample("two_mass").system
    period, x = 2 * np.pi / 2.5, np.array([0.1, -0.2, 0.5, 0.0])
    now, later = (flow_of(model).start(t, x).state(0.9) for t in (1.0, 1.0 + 3 * period))
    np.testing.assert_allclose(now, later, rtol=1e-13)


def defective() -> System:
    """Two oscillators and one damper, with the characteristic polynomial (z^2 + z/2 + 1)^2.

    ``(z^2 + 2c z + c^2 + 1)(z^2 + 1) - c^2 = (z^2 + c z + 1)^2``, and one eigenvector a root.
    """
    return system(np.eye(2), np.diag([1.0, 0.0]), [[1.25, 0.5], [0.5, 1.0]])


def test_flow_of_a_defective_system_is_exact() -> None:
    """Where eigenvectors coincide the exponential needs none."""
    model = defective()
    x, s = np.array([1.0, 0.5, -0.3, 0.2]), np.array([0.3, 2.0])
    expected = precise.flow(model, 0.0, x, s.tolist())
    assert error(model, flow_of(model).start(0.0, x).states(s), expected, x) < 1e-13


@pytest.mark.parametrize("model", PHASES.values(), ids=PHASES.keys())
def test_one_state_is_as_exact_as_many(model: System) -> None:
    """One alone, which may come another way; and each of many alone, in every bit."""
    flow = flow_of(model)
    x, s = np.linspace(-1.0, 1.3, 2 * model.n), np.array([0.0, 1e-6, 0.02, 0.5, 3.0, 40.0])
    for t in (0.0, 17.3):
        motion = flow.start(t, x)
        alone = np.array([motion.state(at) for at in s.tolist()])
        np.testing.assert_array_equal(motion.states(s), alone)


@examples(40)
@given(st.data())
def test_difference_of_two_motions_goes_on_by_the_transition(data: st.DataObject) -> None:
    """Forwards and backwards, whatever the modes are, against the matrix exponential."""
    model = data.draw(systems(max_n=3, forced=False))
    flow, s = flow_of(model), data.draw(numbers(0.0, 2.0))
    expected = linalg.expm(s * state_matrix(model))
    scale = np.max(np.abs(expected)) * (1 + np.max(np.abs(model.K)))
    np.testing.assert_allclose(flow.transition(s), expected, atol=1e-11 * scale)


def test_a_state_of_a_day_later_needs_no_windows() -> None:
    """``x'' + 0.01 x' + 25 x = 5`` comes to rest at 0.2; undamped it turns on by its frequency."""
    later = np.array([0.3, 86_400.0])
    damped = system(1, 0.01, 25, force=forcing(1, 5.0))
    states = flow_of(damped).start(0.0, np.array([1.0, 2.0])).states(later)
    np.testing.assert_allclose(states[1], [0.2, 0.0], rtol=0, atol=1e-12)
    free = flow_of(system(1, 0, 25)).start(0.0, np.array([1.0, 0.0])).state(86_400.0)
    np.testing.assert_allclose(free, [np.cos(432_000), -5 * np.sin(432_000)], rtol=0, atol=1e-6)
