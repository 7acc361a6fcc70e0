# SPDX-License-Identifier: Apache-2.0
"""Linear complementarity in ``G = B^T B``, against trying every set of rows."""

from itertools import chain, combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import optimize
from systems import examples, matrices, vectors

from impact_observer.dynamics.contact.complementarity import complementary

Array = NDArray[np.float64]


def enumerated(B: Array, b: Array) -> list[Array]:
    """``B Lambda`` of every set of rows whose equations solve the problem."""
    G, scale = B.T @ B, 1e-9 * (1 + np.max(np.abs(b)))
    found = []
    for rows in chain.from_iterable(combinations(range(b.size), k) for k in range(b.size + 1)):
        pressed, pushed = list(rows), np.zeros(b.size)
        # Of loads that share a push in many ways the least may be negative: any will do.
        pushed[pressed] = optimize.nnls(G[np.ix_(pressed, pressed)], -b[pressed])[0] if rows else 0
        separation = G @ pushed + b
        if np.all(np.abs(separation[pressed]) <= scale) and np.all(separation >= -scale):
            found.append(B @ pushed)
    return found


def problem(data: st.DataObject, most: int) -> tuple[Array, Array]:
    """``B`` without a zero column, often with columns that depend on each other, and ``b``."""
    n, m = data.draw(st.integers(1, 3)), data.draw(st.integers(1, most))
    B = data.draw(matrices(n, m))
    for i in range(m):
        if not np.any(B[:, i]):
            B[:, i] = np.eye(n)[i % n]
    if m > 1 and data.draw(st.booleans()):
        B[:, -1] = data.draw(st.sampled_from([1.0, 2.0, -1.0])) * B[:, 0]
    return B, data.draw(vectors(m))


def assert_solves(B: Array, b: Array, found: Array) -> None:
    """The residual of the problem itself, in units of each row."""
    length = np.linalg.norm(B, axis=0)
    scale = float(np.max(-b / length, initial=0.0))
    separation = (B.T @ (B @ found) + b) / length
    assert np.all(found >= 0)
    assert np.all(np.abs(np.minimum(found * length, separation)) <= 2e-9 * scale)


@pytest.mark.slow
@examples(150)
@given(st.data())
def test_solution_is_the_one_that_trying_every_set_of_rows_finds(data: st.DataObject) -> None:
    """``B Lambda`` is unique; where no set solves the problem there is no solution."""
    B, b = problem(data, most=4)
    expected = enumerated(B, b)
    found = complementary(B, b)
    if found is None:
        assert not expected
        return
    assert_solves(B, b, found)
    assert expected
    np.testing.assert_allclose(B @ found, expected[0], atol=1e-6)


@pytest.mark.slow
@examples(80)
@given(st.data())
def test_solution_exists_exactly_where_all_rows_can_separate(data: st.DataObject) -> None:
    """``B^T v >= -b`` is a linear programme: its verdict and ours agree."""
    B, b = problem(data, most=6)
    possible = optimize.linprog(
        np.zeros(len(B)), A_ub=-B.T, b_ub=b, bounds=[(None, None)] * len(B)
    )
    assert (complementary(B, b) is not None) == (possible.status == 0)


@examples(60)
@given(st.data())
def test_solution_is_the_shortest_separating_vector(data: st.DataObject) -> None:
    """``v = B Lambda`` with ``B^T v >= -b``: no other such vector is shorter."""
    n, m = 3, data.draw(st.integers(1, 5))
    B, towards = data.draw(matrices(n, m)), data.draw(vectors(n))
    B[:, ~np.any(B, axis=0)] = 1.0
    found = complementary(B, B.T @ towards)
    assert found is not None  # -towards separates all of them
    v = B @ found
    # Variational inequality on the polyhedron, at the one point that certainly lies in it.
    assert v @ (-towards - v) >= -1e-8 * (1 + towards @ towards)
    assert v @ v <= towards @ towards * (1 + 1e-9) + 1e-12


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_units_of_single_columns_do_not_matter(size: float) -> None:
    """A contact measured in micrometres takes loads in its own unit."""
    B = np.array([[1.0, 1, 1], [0, 1, -1]])
    b, unit = np.array([-1.0, -2, 0.5]), np.array([1.0, size, 1 / size])
    plain, scaled = complementary(B, b), complementary(B * unit, b * unit)
    assert plain is not None
    assert scaled is not None
    np.testing.assert_allclose(scaled * unit, plain, rtol=1e-9, atol=1e-12)


def test_columns_that_are_equal_share_what_one_would_take() -> None:
    """``Lambda`` is not unique then, their sum is."""
    column = np.array([[1.0], [2.0]])
    single = complementary(column, np.array([-3.0]))
    triple = complementary(np.hstack([column] * 3), np.full(3, -3.0))
    assert single == pytest.approx([0.6], rel=1e-14)
    assert triple is not None
    assert np.sum(triple) == pytest.approx(0.6, rel=1e-12)


def test_opposite_columns_that_both_want_to_separate_have_no_solution() -> None:
    """A floor that rises towards a ceiling."""
    B = np.array([[1.0, -1.0]])
    assert complementary(B, np.array([-1.0, 0.5])) is None
    assert complementary(B, np.array([-1.0, 1.0])) is not None  # both can separate
