# SPDX-License-Identifier: Apache-2.0
"""A system checks itself, copies what it is given and cannot be changed."""

import numpy as np
import pytest
from systems import Harmonic, forcing, system

from impact_observer.errors import ModelError, UsageError
from impact_observer.model import Contact, Forcing, System

STOP = ([0, -1], 0.5, 0.7)


def example() -> System:
    """A system with everything in it."""
    return system(
        np.eye(2),
        np.eye(2),
        np.eye(2),
        contacts=[STOP],
        force=forcing(2, 1.0, [Harmonic(2.0, [1, 0], [0, 1])]),
    )


def test_arrays_of_the_caller_are_copied() -> None:
    """They are not frozen and not symmetrised in place."""
    M, K = np.eye(2), np.array([[2.0, -1.0 + 1e-10], [-1.0, 1.0]])
    direction = np.array([0.0, 1.0])
    kept = K.copy()
    s = System("s", ("a", "b"), M, M, K, Forcing.none(2), (Contact("c", direction, 0, 1),))
    M[0, 0] = direction[0] = 7.0
    np.testing.assert_array_equal(K, kept)
    assert s.M[0, 0] == s.C[0, 0] == 1.0
    assert s.W[0, 0] == 0.0


def test_gaps_and_contact_speeds_are_those_of_the_paper() -> None:
    """``g = W^T q + q_r`` and ``gamma = W^T u``; no contacts give no gaps."""
    s = system(np.eye(2), np.eye(2), np.eye(2), contacts=[STOP, ([2, 1], 0.1, 0.3)])
    q = np.array([3.0, 0.25])
    assert s.gap(q).tolist() == [0.25, 6.35]
    assert s.contact_speed(q).tolist() == [-0.25, 6.25]
    free = system([[1]], [[0]], [[0]])
    assert (free.m, free.W.shape, free.gap(np.zeros(1)).shape) == (0, (1, 0), (0,))


def test_parts_of_a_system_are_what_nothing_couples() -> None:
    """A contact couples what it touches, as a spring does."""
    K = np.diag([1.0, 2.0, 3.0, 4.0])
    K[0, 1] = K[1, 0] = -0.5
    contacts = [([0, 0, 1, 0], 1.0, 0.5)]
    parts = system(np.eye(4), np.zeros((4, 4)), K, contacts=contacts).parts()
    np.testing.assert_array_equal(parts, [0, 0, 1, 2])
    contacts = [([0, 1, -1, 0], 1.0, 0.5)]
    parts = system(np.eye(4), np.zeros((4, 4)), K, contacts=contacts).parts()
    np.testing.assert_array_equal(parts, [0, 0, 0, 1])


def test_harmonics_without_amplitude_do_not_depend_on_time() -> None:
    """A harmonic without amplitude needs no epoch."""
    assert not Forcing.none(2).depends_on_time
    assert not forcing(1, 1.0, [Harmonic(2.0, [0], [0])]).depends_on_time
    assert forcing(1, 0.0, [Harmonic(2.0, [0], [1])]).depends_on_time


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"M": np.eye(3)}, "mass"),
        ({"M": 1.0}, "mass: has shape a single number"),
        ({"K": [["a", "b"], ["c", "d"]]}, "stiffness"),
        ({"K": [[1.0], [2.0, 3.0]]}, "stiffness"),
        ({"C": np.full((2, 2), np.inf)}, r"damping\[0\]\[0\]: is not finite"),
        ({"M": np.array([[1, 0.5], [0, 1]])}, r"mass: is not symmetric: \[0\]\[1\] is 0.5 but"),
        ({"M": np.ones((2, 2))}, "mass: is not positive definite"),
        ({"K": -np.eye(2)}, "stiffness: is not positive semidefinite"),
        ({"C": -np.eye(2)}, "damping: the symmetric part of it is not positive semidefinite"),
        ({"coordinates": ()}, "coordinates: is empty"),
        ({"coordinates": ("a", "a")}, r"coordinates\[1\]: 'a' is taken already"),
        ({"coordinates": ("a", 3)}, r"coordinates\[1\]: 3 is not a name"),
        ({"contacts": (Contact("", np.ones(2), 0, 0),)}, r"contacts\[0\]: '' is not a name"),
        ({"contacts": (Contact("c", np.ones(1), 0, 0),)}, r"contacts\[0\].direction: 1 values"),
        ({"contacts": (Contact("c", np.zeros(2), 0, 0),)}, r"contacts\[0\].direction: is zero"),
        ({"contacts": (Contact("c", np.ones(2), np.nan, 0),)}, r"contacts\[0\].gap: is not fin"),
        ({"contacts": (Contact("c", np.ones(2), 0, 1.5),)}, r"contacts\[0\].restitution: 1.5"),
        ({"forcing": Forcing.none(3)}, "forcing.constant"),
        (
            {"forcing": Forcing(np.zeros(2), np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)))},
            "forcing.harmonics.frequency",
        ),
        (
            {"forcing": Forcing(np.zeros(2), np.ones(1), np.zeros((1, 3)), np.zeros((1, 2)))},
            "forcing.harmonics.cosine",
        ),
        (
            {"forcing": Forcing(np.zeros(2), np.ones(1), np.zeros((1, 2)), np.zeros((2, 2)))},
            "forcing.harmonics.sine",
        ),
    ],
)
def test_invalid_system_is_named_by_its_key(change: dict[str, object], message: str) -> None:
    """The same checks hold for systems that no file describes."""
    parts: dict[str, object] = {
        "name": "s",
        "coordinates": ("a", "b"),
        "M": np.eye(2),
        "C": np.eye(2),
        "K": np.eye(2),
        "forcing": Forcing.none(2),
        "contacts": (Contact("c", np.ones(2), 0.0, 0.5),),
    }
    with pytest.raises(ModelError, match=message):
        System(**{**parts, **change})  # type: ignore[arg-type]


def test_states_are_checked_and_frozen() -> None:
    """A state has n finite coordinates and n finite velocities."""
    q, u = example().checked_state([1, 2], (3, 4))
    assert (q.tolist(), u.tolist()) == ([1, 2], [3, 4])
    assert not q.flags.writeable
    with pytest.raises(UsageError, match="position"):
        example().checked_state([1], [1, 2])
    with pytest.raises(UsageError, match="position"):
        example().checked_state([[1, 2]], [1, 2])
    with pytest.raises(UsageError, match="velocity"):
        example().checked_state([1, 2], [1, np.inf])
    with pytest.raises(UsageError, match="position"):
        example().checked_state(["a", "2"], [1, 2])


@pytest.mark.parametrize("shuffled", [False, True])
@pytest.mark.parametrize(
    ("key", "lowered", "smallest", "message"),
    [
        ("M", 1.0 + 1e-9, -1e-9, "mass: is not positive definite"),
        ("C", 1e-6, -1e-6, "damping: the symmetric part of it is not positive semidefinite"),
        ("K", 1e-6, -1e-6, "stiffness: is not positive semidefinite"),
    ],
)
def test_definiteness_of_a_long_chain_does_not_depend_on_the_order_of_coordinates(
    key: str, lowered: float, smallest: float, message: str, *, shuffled: bool
) -> None:
    """In natural order its matrices are banded; the stiffness of a free chain is semidefinite.

    The eigenvalue in the error is compared as a number: its last digits depend on the processor.
    """
    n = 80
    free = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    free[0, 0] = free[-1, -1] = 1.0
    order = np.random.default_rng(1).permutation(n) if shuffled else np.arange(n)
    parts = {"M": free + np.eye(n), "C": 0.1 * free, "K": free}
    good = {name: matrix[np.ix_(order, order)] for name, matrix in parts.items()}
    assert system(*good.values()).n == n
    bad = {**good, key: good[key] - lowered * np.eye(n)}
    with pytest.raises(ModelError, match=message) as raised:
        system(*bad.values())
    eigenvalue = float(str(raised.value).partition("smallest eigenvalue ")[2])
    assert eigenvalue == pytest.approx(smallest, rel=1e-4)
