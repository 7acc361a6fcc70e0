# SPDX-License-Identifier: Apache-2.0
"""Which resting contacts stay closed, against trying every set in exact rational arithmetic."""

from fractions import Fraction
from itertools import chain as joined
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from systems import Harmonic, examples, forcing, system

from impact_observer.dynamics import Grip, Phases, persistent_contacts
from impact_observer.model import System

Array = NDArray[np.float64]
Row = list[Fraction]
ORDERS = 6
NOTHING = [Fraction(0)] * ORDERS


def exact(values: Array) -> list[Row]:
    """A matrix in fractions."""
    return [[Fraction(float(value)) for value in row] for row in values]


def times(matrix: list[Row], vector: Row) -> Row:
    """Their product."""
    return [sum((a * b for a, b in zip(row, vector, strict=True)), Fraction(0)) for row in matrix]


def solved(matrix: list[Row], right: Row) -> Row | None:
    """``matrix^-1 right`` by Gauss and Jordan; None where there is no inverse."""
    rows = [[*left, value] for left, value in zip(matrix, right, strict=True)]
    for i in range(len(rows)):
        pivot = next((k for k in range(i, len(rows)) if rows[k][i]), None)
        if pivot is None:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(len(rows)):
            if k != i:
                factor = rows[k][i]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [row[-1] for row in rows]


def series(model: System, x: Array, held: tuple[int, ...]) -> tuple[list[Row], list[Row]] | None:
    """Derivatives of the loads of ``held`` and of all contacts' accelerations at ``t = 0``.

    From one linear system an order, ``M a - W_H lambda = f - C u - K q`` with ``W_H^T a = 0``;
    None where contacts depend on each other.
    """
    M, C, K, W = (exact(matrix) for matrix in (model.M, model.C, model.K, model.W))
    n, p = model.n, len(held)
    f = exact(model.forcing.derivatives(np.zeros(1), ORDERS - 1)[:, 0])
    motion = [exact(x[None, :n])[0], exact(x[None, n:])[0]]
    matrix = [[*M[i], *(-W[i][j] for j in held)] for i in range(n)]
    matrix += [[*(W[i][j] for i in range(n)), *[Fraction(0)] * p] for j in held]
    loads, accelerations = [], []
    for k in range(ORDERS):
        damped, sprung = times(C, motion[-1]), times(K, motion[-2])
        force = [a - b - c for a, b, c in zip(f[k], damped, sprung, strict=True)]
        found = solved(matrix, [*force, *[Fraction(0)] * p])
        if found is None:
            return None
        motion.append(found[:n])
        loads.append(found[n:])
        accelerations.append([sum(W[i][j] * found[i] for i in range(n)) for j in range(model.m)])
    by_contact = [list(map(Fraction, column)) for column in zip(*accelerations, strict=True)]
    return [list(column) for column in zip(*loads, strict=True)], by_contact


def decided(model: System, x: Array) -> set[tuple[int, ...]]:
    """The closed contacts of every consistent set of held ones.

    Consistent: no load and no speed falls below zero, their first derivatives that are not zero
    being positive. Closed are those whose speed never leaves zero.
    """
    found = set()
    contacts = range(model.m)
    for held in joined.from_iterable(combinations(contacts, k) for k in range(model.m + 1)):
        both = series(model, x, held)
        if both is not None and all(row >= NOTHING for row in joined(*both)):
            found.add(tuple(i for i in contacts if both[1][i] == NOTHING))
    return found


def decide(model: System, x: ArrayLike, t: float = 0.0) -> Grip:
    """What becomes of all contacts of a system."""
    return persistent_contacts(Phases(model), (), t, np.asarray(x, float), tuple(range(model.m)))


def assert_decision(model: System, x: Array) -> None:
    """The closed contacts are those of exact arithmetic, the held ones carry them."""
    expected = decided(model, x)
    assert len(expected) == 1, "the motion is unique"
    found = decide(model, x)
    assert {found.closed} == expected
    assert set(found.held) <= set(found.closed)
    carried = series(model, x, found.held)
    assert carried is not None  # independent
    assert all(row >= NOTHING for row in joined(*carried))
    rank = np.linalg.matrix_rank(model.W[:, list(found.closed)]) if found.closed else 0
    assert len(found.held) == rank


whole = st.integers(-1, 1)


@pytest.mark.slow
@examples(150)
@given(st.data())
def test_decision_is_the_one_consistent_set_of_all(data: st.DataObject) -> None:
    """Integers between -1 and 1 give many zero loads and redundant contacts."""
    n, m = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 4))
    rows = [[data.draw(whole) for _ in range(n)] for _ in range(m)]
    W = [row if any(row) else np.eye(n)[i % n].tolist() for i, row in enumerate(rows)]
    root = np.array([[data.draw(whole) for _ in range(n)] for _ in range(n)])
    springs = np.array([[data.draw(whole) for _ in range(n)] for _ in range(n)])
    push = [[data.draw(whole) for _ in range(n)] for _ in range(3)]
    model = system(
        root @ root.T + np.eye(n),
        data.draw(st.sampled_from([0.0, 0.5])) * springs.T @ springs,
        springs.T @ springs,
        contacts=[(w, 0.0, 0.5) for w in W],
        force=forcing(n, push[0], [Harmonic(1.0, push[1], push[2])]),
    )
    seen = np.any(W, axis=0)
    x = np.array([data.draw(whole) for _ in range(2 * n)], float)
    x[n:][seen] = 0.0
    assert_decision(model, x)


def pushed(*parts: tuple[float, float], constant: float = 0.0, frequency: float = 1.0) -> System:
    """One mass on its floor under ``constant + cosine cos + sine sin``."""
    harmonics = [Harmonic(frequency, [cosine], [sine]) for cosine, sine in parts]
    return system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=forcing(1, constant, harmonics))


@pytest.mark.parametrize(
    ("model", "closed"),
    [
        (pushed(constant=-1), True),
        (pushed(constant=1), False),
        (pushed((0, -1)), True),  # the load is zero and rises
        (pushed((0, 1)), False),  # and falls
        (pushed((1, 0), constant=-1), True),  # the second derivative decides
        (pushed((-1, 0), constant=1), False),
        (pushed(), True),  # never any load
    ],
    ids=["pressed", "pulled", "rising", "falling", "rising slowly", "falling slowly", "nothing"],
)
def test_first_derivative_that_is_not_zero_decides(model: System, closed: bool) -> None:
    """A load at its root stays if it rises, however slowly; one without end stays as well."""
    assert decide(model, [0.0, 0.0])[:2] == (((0,), (0,)) if closed else ((), ()))


@pytest.mark.parametrize("frequency", [0.37, 1.9838269257012868, 6.1])
@pytest.mark.parametrize("constant", [0.6095693498571635, 0.1, 0.987])
def test_load_that_cancels_between_parts_of_the_forcing_is_zero(
    frequency: float, constant: float
) -> None:
    """At its root ``sin(w t) = c`` the sum is rounding: its derivative decides."""
    model = pushed((0, 1), constant=-constant, frequency=frequency)
    falling, rising = np.arcsin(constant), np.pi - np.arcsin(constant)
    for turn in range(4):
        for phase, closed in ((falling, ()), (rising, (0,))):
            t = (phase + 2 * np.pi * turn) / frequency
            assert decide(model, [0.0, 0.0], t).closed == closed


def bar(force: ArrayLike, *harmonics: Harmonic) -> System:
    """A bar (height, tilt) on three supports."""
    supports = [([1, -1], 0.0, 0.5), ([1, 0], 0.0, 0.5), ([1, 1], 0.0, 0.5)]
    nothing = np.zeros((2, 2))
    return system(
        np.diag([1, 0.5]), nothing, nothing, contacts=supports, force=forcing(2, force, harmonics)
    )


@pytest.mark.parametrize(
    ("force", "closed"),
    [
        ([-1, 0.0], (0, 1, 2)),
        ([-1, 0.5], (0, 1, 2)),
        ([-1, -0.5], (0, 1, 2)),
        ([-1, 1.0], (0, 1, 2)),  # balanced on the left support
        ([-1, 2.0], (0,)),  # tips
        ([-1, -2.0], (2,)),
        ([0, 0.0], (0, 1, 2)),
        ([1, 0.0], ()),
    ],
)
def test_bar_on_three_supports_rests_on_two(force: list[float], closed: tuple[int, ...]) -> None:
    """All three stay closed while two can carry it; beyond an outer one it tips."""
    model = bar(force)
    assert_decision(model, np.zeros(4))
    found = decide(model, np.zeros(4))
    assert found.closed == closed
    assert len(found.held) == min(len(closed), 2)


def test_balanced_bar_tips_as_its_load_goes_on() -> None:
    """The load stands above an outer support and moves outwards or inwards."""
    outwards = bar([-1.0, -1.0], Harmonic(1.0, [0, 0], [0, -1]))
    assert decide(outwards, np.zeros(4)).closed == (2,)
    inwards = bar([-1.0, -1.0], Harmonic(1.0, [0, 0], [0, 1]))
    assert decide(inwards, np.zeros(4)).closed == (0, 1, 2)


def test_one_contact_leaves_and_others_stay() -> None:
    """Three masses, one of them pulled."""
    model = system(
        np.eye(3),
        np.zeros((3, 3)),
        np.eye(3),
        contacts=[(row, 0.0, 0.5) for row in np.eye(3)],
        force=forcing(3, [-1.0, 1.0, -2.0]),
    )
    assert decide(model, np.zeros(6))[:2] == ((0, 2), (0, 2))


@pytest.mark.parametrize("mass", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("length", [1e-6, 1.0])
def test_units_do_not_matter(mass: float, rate: float, length: float) -> None:
    """Masses, times and lengths in other units: the same contacts at rest, leaving and pulled.

    The load of the first contact is zero and falls, that of the second rises with the square of
    time, the third is always zero, and another mass oscillates.
    """
    springs = np.diag([0.0, 0.0, 0.0, 4.0])
    push = mass * rate**2 * length * np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0]])
    model = system(
        mass * np.eye(4),
        mass * rate / 8 * np.diag([0, 0, 0, 1.0]),
        mass * rate**2 * springs,
        contacts=[(row, 0.0, 0.5) for row in np.eye(4)[:3]],
        force=forcing(4, -push[1], [Harmonic(2 * rate, push[1].tolist(), push[0].tolist())]),
    )
    x = length * np.array([0, 0, 0, 1, 0, 0, 0, rate])
    assert decide(model, x).closed == (1, 2)
