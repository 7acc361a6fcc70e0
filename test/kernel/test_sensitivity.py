# SPDX-License-Identifier: Apache-2.0
"""Sensitivities are derivatives, and their noise covers the rest."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import examples, matrices, vectors

from impact_observer.kernel._kernel import Sensitivity, leading

Array = NDArray[np.float64]
P, N = 2, 3
TAILS = 1.5
"""By how much noise of second order is wider than a normal product."""


class Quadratic:
    """``F = (A + B_j theta_j) x + c + b_j theta_j + c_jk theta_j theta_k / 2``, drawn."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.A, self.B = rng.normal(size=(N, N)), rng.normal(size=(P, N, N))
        self.b, bent = rng.normal(size=(P, N)), rng.normal(size=(P, P, N))
        self.c = bent + bent.transpose(1, 0, 2)
        self.x, self.theta = rng.normal(size=N), rng.normal(size=P)
        root = np.tril(rng.normal(size=(N + P, N + P)))
        self.root = leading(np.roll(root, -P, axis=0), N, P)

    def value(self, x: Array, theta: Array) -> Array:
        """``F`` of one state and one theta, or of as many as there are rows of both."""
        bent = np.einsum("...j,...k,jkn->...n", theta, theta, self.c) / 2
        turned = np.einsum("...j,jnm,...m->...n", theta, self.B, x)
        return np.asarray(x @ self.A.T + turned + theta @ self.b + bent)

    def at(self, theta: Array) -> tuple[Array, Array]:
        """The map for other parameters."""
        return self.value(self.x, theta), self.A + np.tensordot(theta, self.B, 1)


@given(seed=st.integers(0, 10_000), exponents=st.tuples(*[st.integers(-6, 2)] * P))
@examples(40)
def test_differences_of_a_quadratic_map_are_its_derivatives(
    seed: int, exponents: tuple[int, ...]
) -> None:
    """For any grid; first derivatives are those at ``theta``, not at a grid point."""
    F = Quadratic(seed)
    steps = np.exp2(np.array(exponents, dtype=float))
    seen = Sensitivity(F.at, F.theta, steps)
    first = F.b + np.einsum("jkn,k->jn", F.c, F.theta) + F.B @ F.x
    rounding = 1e-12 / np.min(steps) ** 2
    np.testing.assert_allclose(seen.first, first, atol=1e-11 + rounding)
    # The noise of a state without error, and of one that is independent of theta.
    alone = seen.noise(np.zeros((N, P)), np.eye(P)) / TAILS
    wanted = np.array([F.c[0, 0] * math.sqrt(3) / 2, F.c[1, 1] * math.sqrt(3) / 2, F.c[0, 1]])
    np.testing.assert_allclose(alone.T, wanted, atol=1e-10 + rounding)
    root = np.hstack([np.zeros((N, P)), np.eye(N)])
    beside = seen.noise(root, np.eye(P, N + P)) / TAILS
    found = [beside[:, :N], beside[:, N + 1 : 2 * N + 1]]
    np.testing.assert_allclose(found, F.B, atol=1e-11 + rounding)


@pytest.mark.parametrize("seed", range(6))
def test_noise_covers_the_remainder_of_a_quadratic_map(seed: int) -> None:
    """The covariance of the true remainder is nowhere larger than the noise.

    Nor is the noise more than a few times as large.
    """
    F = Quadratic(seed)
    seen = Sensitivity(F.at, F.theta, np.full(P, 0.25))
    linear = F.at(F.theta)[1] @ F.root[:N]
    linear += seen.first.T @ F.root[N:]
    noise = seen.noise(F.root[:N], F.root[N:])
    rng = np.random.default_rng(seed + 100)
    drawn = rng.normal(size=(40_000, N + P)) @ F.root.T
    errors = F.value(F.x + drawn[:, :N], F.theta + drawn[:, N:]) - F.value(F.x, F.theta)
    left = errors - drawn @ np.linalg.lstsq(F.root.T, linear.T, rcond=None)[0]
    true, claimed = left.T @ left / len(left), noise @ noise.T
    ratios = np.linalg.eigvals(np.linalg.solve(claimed, true)).real
    assert np.max(ratios) < 1.0
    assert np.min(ratios) > 0.05


@given(root=matrices(5, 7), first=st.integers(0, 3))
@examples(40)
def test_leading_triangular_root_has_the_same_covariance(root: Array, first: int) -> None:
    """And its rows begin as a lower triangle."""
    rows = slice(first, first + 2)
    found = leading(root, first, 2)
    np.testing.assert_allclose(found @ found.T, root @ root.T, atol=1e-12)
    np.testing.assert_allclose(np.triu(found[rows], 1), 0.0, atol=1e-14)


@given(x=vectors(N))
@examples(10)
def test_without_parameters_nothing_is_added(x: Array) -> None:
    """A map that does not depend on the parameters."""
    seen = Sensitivity(lambda _: (x, np.eye(N)), np.zeros(1), np.ones(1))
    assert not np.any(seen.first)
    assert not np.any(seen.noise(np.eye(N), np.eye(1, N)))


@given(seed=st.integers(0, 10_000), still=st.integers(0, P - 1))
@examples(20)
def test_a_parameter_without_a_step_is_not_asked(seed: int, still: int) -> None:
    """The map stays at its value; the others add what they add where it is known."""
    F, moves = Quadratic(seed), 1 - still
    steps = np.where(np.arange(P) == still, 0.0, 0.25)

    def alone(theta: Array) -> tuple[Array, Array]:
        return F.at(np.where(np.arange(P) == still, F.theta, theta))

    seen, other = Sensitivity(F.at, F.theta, steps), Sensitivity(alone, F.theta, np.full(P, 0.25))
    np.testing.assert_allclose(seen.first[moves], other.first[moves], atol=1e-11)
    assert not np.any(seen.first[still])
    found, wanted = (each.noise(F.root[:N], F.root[N:]) for each in (seen, other))
    np.testing.assert_allclose(found @ found.T, wanted @ wanted.T, rtol=1e-9, atol=1e-9)


@given(root=matrices(N, 9), own=matrices(P, P))
@examples(20)
def test_noise_does_not_depend_on_columns_without_parameters(root: Array, own: Array) -> None:
    """However many they are, and in whichever basis."""
    seen = Sensitivity(Quadratic(1).at, np.zeros(P), np.ones(P))
    own = np.pad(np.tril(own), ((0, 0), (0, root.shape[1] - P)))
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(9 - P, 9 - P)))[0]
    turned = np.hstack([root[:, :P], root[:, P:] @ turn])
    found, wanted = (each @ each.T for each in (seen.noise(root, own), seen.noise(turned, own)))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)
