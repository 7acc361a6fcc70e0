# SPDX-License-Identifier: Apache-2.0
"""States followed to a sample by the kernel: against matrix exponentials and the textbook."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import integrate, linalg
from systems import examples, system, systems

from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.members import Members
from impact_observer.model import System
from impact_observer.model.free_parameters import parametric_family

Array = NDArray[np.float64]


def free(model: System) -> Members:
    """What the kernel knows of a system."""
    return Members(parametric_family(model, ()))


def flown(model: System, t: float, x: Array, s: float) -> tuple[Array, Array]:
    """The state ``s`` seconds later, by an integrator, and the matrix exponential."""
    n, inverse = model.n, np.linalg.inv(model.M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ model.K, -inverse @ model.C]])

    def rate(at: float, x: Array) -> Array:
        force = model.forcing.derivatives(np.array([at]), 0)[0, 0]
        return np.asarray(A @ x + np.concatenate([np.zeros(n), inverse @ force]))

    found = integrate.solve_ivp(rate, (t, t + s), x, method="DOP853", rtol=1e-13, atol=1e-13)
    return found.y[:, -1], linalg.expm(A * s)


def noise_of(model: System, s: float) -> Array:
    """The covariance that unit white accelerations add (Van Loan)."""
    n, inverse = model.n, np.linalg.inv(model.M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ model.K, -inverse @ model.C]])
    Q = linalg.block_diag(np.zeros((n, n)), np.eye(n))
    both = linalg.expm(np.block([[-A, Q], [np.zeros_like(A), A.T]]) * s)
    size = 2 * n
    return np.asarray(both[size:, size:].T @ both[:size, size:])


@examples(40)
@given(
    systems(max_n=3, contacts=(0, 0)),
    st.integers(0, 999),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([0.0, 1e-3, 0.2]),
)
def test_a_followed_state_is_predicted_and_corrected_as_in_the_textbook(
    model: System, seed: int, level: float, s: float
) -> None:
    """Two states with an offset of the clock; one of them is beyond the gate."""
    random, size, t = np.random.default_rng(seed), 2 * model.n, 0.7
    states = [
        GaussianState(
            random.normal(size=size),
            np.array([0.1]),
            0.5 * random.normal(size=(size + 1, size + 1)),
            np.vstack([random.normal(size=(size, 2)), np.zeros((1, 2))]),
        )
        for _ in range(2)
    ]
    row, rest, noise, gate = random.normal(size=size), 0.3, 0.04, 4.0
    before = [flown(model, t, each.x, s) for each in states]
    expected = [float(row @ x) + rest for x, _ in before]
    value = expected[0] + 0.5
    levels = np.array([0.0, level])
    gaps = free(model).free_gaps
    made = gaps.followed(t, s, states, levels, 0.0, row, rest, value, noise, gate, True)
    assert made is not None
    priors = gaps.flown(np.full(len(states), t), np.full(len(states), s), states, levels, 0.0)
    each_one = zip(states, before, levels, priors, made, strict=True)
    for each, (x, map_), added, prior, found in each_one:
        Phi = linalg.block_diag(map_, np.eye(1))
        P = Phi @ each.root @ each.root.T @ Phi.T
        P[:size, :size] += added**2 * noise_of(model, s)
        tolerance = 1e-9 * (1 + np.max(np.abs(P)))
        np.testing.assert_allclose(prior[2] @ prior[2].T, P, atol=tolerance)
        np.testing.assert_allclose(np.append(*prior[:2]), np.append(x, each.constants), atol=1e-9)
        np.testing.assert_allclose(prior[3], Phi @ each.differences, atol=tolerance)
        H = np.append(row, 0.0)
        S, e = float(H @ P @ H) + noise, value - (float(row @ x) + rest)
        is_used = abs(e) <= gate * np.sqrt(S)
        gain = P @ H / S if is_used else np.zeros(size + 1)
        wanted = np.append(x, each.constants) + gain * e
        after = P - np.outer(gain, H @ P)
        others = Phi @ each.differences
        others = others - np.outer(gain, H @ others)
        x_found, constants, root, differences, innovation, normalised, density = found
        np.testing.assert_allclose(np.append(x_found, constants), wanted, atol=tolerance)
        np.testing.assert_allclose(root @ root.T, after, atol=tolerance)
        np.testing.assert_allclose(differences, others, atol=tolerance)
        assert innovation == pytest.approx(e, abs=1e-9)
        assert normalised == pytest.approx(abs(e) / np.sqrt(S), rel=1e-8)
        least = min(normalised, gate)
        assert density == pytest.approx(-(least**2 + np.log(S)) / 2, rel=1e-8)


@pytest.mark.parametrize(("height", "speed", "is_found"), [(1.0, 0.0, True), (0.001, -1.0, False)])
def test_a_gap_that_is_negative_meanwhile_is_left_to_others(
    height: float, speed: float, is_found: bool
) -> None:
    """A ball that would be above the floor again, or below it."""
    ball = system(np.eye(1), [[0.0]], [[900.0]], contacts=[([1.0], 0.0, 0.5)])
    state = GaussianState(
        np.array([height, speed]), np.zeros(0), 1e-6 * np.eye(2), np.zeros((2, 0))
    )
    row = np.array([1.0, 0.0])
    for searches, s in ((True, 0.01), (False, 0.01), (True, 0.2)):
        made = free(ball).free_gaps.followed(
            0.0, s, [state], np.zeros(1), 0.0, row, 0.0, height, 1.0, 9.0, searches
        )
        assert (made is not None) == (is_found and s < 0.1)
