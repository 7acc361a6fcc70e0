# SPDX-License-Identifier: Apache-2.0
"""Sets of contacts that can close together, and impacts that can raise V."""

from itertools import chain as joined
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import optimize
from systems import chain, delassus, examples, sample, system, systems

from impact_observer.check import closing_sets, impact_expansion
from impact_observer.check.closing_sets import ClosingSets, SearchResult
from impact_observer.check.impact_expansion import expansive_sets, growth, is_nonexpansive
from impact_observer.dynamics import ImpactLaw
from impact_observer.events import Contacts
from impact_observer.model import System

Array = NDArray[np.float64]
TOL = 1e-7


def subsets(m: int) -> list[list[int]]:
    """All nonempty subsets of ``m`` contacts."""
    every = joined.from_iterable(combinations(range(m), k) for k in range(1, m + 1))
    return [list(each) for each in every]


def closes(model: System, index: list[int]) -> bool:
    """Whether ``g_A = 0, g >= 0`` has a solution: equations, ``q = p - r`` with ``p, r >= 0``."""
    W, gap = model.W, model.q_r
    others = [j for j in range(model.m) if j not in index]
    rows = -np.hstack([W[:, others].T, -W[:, others].T])
    found = optimize.linprog(
        np.zeros(2 * model.n),
        A_ub=rows if others else None,
        b_ub=gap[others] if others else None,
        A_eq=np.hstack([W[:, index].T, -W[:, index].T]),
        b_eq=-gap[index],
        method="highs-ds",
    )
    return bool(found.status == 0)


def independent(model: System, index: list[int]) -> bool:
    """Whether the contact directions are linearly independent."""
    return bool(np.linalg.matrix_rank(model.W[:, index], tol=1e-9) == len(index))


def raises(model: System, index: list[int]) -> bool:
    """Whether ``G - E G E`` has a negative eigenvalue."""
    G, E = delassus(model)[np.ix_(index, index)], np.diag(model.eps[index])
    return bool(np.linalg.eigvalsh(G - E @ G @ E)[0] < -TOL * np.linalg.norm(G))


def smallest(sets: list[list[int]]) -> list[Contacts]:
    """The sets that contain no other set."""
    return [tuple(a) for a in sets if not any(set(b) < set(a) for b in sets)]


def redundant(model: System) -> SearchResult:
    """Contacts that depend on each other and can close together."""
    return closing_sets.redundant(ClosingSets(model))


def corner(*eps: float, gap: float = 0.0) -> System:
    """The documented counterexample: two contacts that are not orthogonal."""
    contacts = [([1.0, 0.0], gap, eps[0]), ([0.9, 0.436], gap, eps[1])]
    return system(np.eye(2), np.eye(2), np.eye(2), contacts=contacts)


def grown(model: System, contacts: Contacts, one: Array, two: Array) -> float:
    """Factor of ``du^T M du`` at an impact of velocities with these contact speeds."""
    W = model.W[:, list(contacts)]
    lift = np.linalg.solve(model.M, W) @ np.linalg.inv(W.T @ np.linalg.solve(model.M, W))
    law, u, v = ImpactLaw(model), lift @ one, lift @ two
    after = law.velocity_after(u, contacts) - law.velocity_after(v, contacts)
    before = u - v
    return float((after @ model.M @ after) / (before @ model.M @ before))


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball"])
def test_no_impact_of_a_sample_raises_v(name: str) -> None:
    """The result holds although one sample has two different restitutions."""
    model = sample(name).system
    assert is_nonexpansive(model) is True
    assert expansive_sets(model) == ()
    assert redundant(model) == SearchResult((), True)


def test_the_documented_counterexample_fails() -> None:
    """``M = K = I``, restitution 1 and 0, in a corner that both contacts can be in."""
    assert expansive_sets(corner(1.0, 0.0)) == ((0, 1),)
    assert is_nonexpansive(corner(1.0, 0.0)) is False
    assert is_nonexpansive(corner(0.3, 0.3)) is True


@pytest.mark.slow
@examples(25)
@given(systems(max_n=3, contacts=(1, 5), forced=False))
def test_answers_agree_with_trying_every_set_of_contacts(model: System) -> None:
    """The oracle solves equations instead of a minimum, and takes eigenvalues of every set."""
    closed = [index for index in subsets(model.m) if closes(model, index)]
    failing = [i for i in closed if independent(model, i) and raises(model, i)]
    answer = impact_expansion.expansive(ClosingSets(model))
    assert answer.decided
    assert bool(answer.sets) == bool(failing)
    assert set(answer.sets) <= set(smallest(failing))
    dependent = [index for index in closed if not independent(model, index)]
    found = redundant(model)
    assert found.decided
    assert set(found.sets) <= set(smallest(dependent))
    # Without the last contact of every set found, all that close together are independent.
    dropped = {each[-1] for each in found.sets}
    assert all(dropped & set(index) for index in dependent)


@pytest.mark.slow
@examples(25)
@given(systems(max_n=3, contacts=(2, 5), common_restitution=False, gaps=(0.0, 0.0), forced=False))
def test_contacts_that_meet_at_rest_can_all_close_together(model: System) -> None:
    """If all gaps are zero only eigenvalues and dependence count."""
    assert ClosingSets(model).conflict(tuple(range(model.m))) is None
    failing = [i for i in subsets(model.m) if independent(model, i) and raises(model, i)]
    assert bool(expansive_sets(model)) == bool(failing)


@pytest.mark.slow
@examples(25)
@given(systems(contacts=(1, 4), forced=False), st.integers(0, 1000))
def test_two_solutions_never_diverge_where_v_cannot_rise(model: System, seed: int) -> None:
    """The impact law raises V on no set that can close together, dependent sets included."""
    rng = np.random.default_rng(seed)
    law, nonexpansive = ImpactLaw(model), is_nonexpansive(model)
    assert nonexpansive is not None
    roomy = ClosingSets(model).has_clearance
    for index in subsets(model.m):
        if not (nonexpansive and roomy and closes(model, index)):
            continue
        # All contacts that close with these do so too; the law is that of the whole set.
        u, v = rng.normal(size=(2, model.n))
        gap = law.velocity_after(u, tuple(index)) - law.velocity_after(v, tuple(index))
        before = float((u - v) @ model.M @ (u - v))
        assert gap @ model.M @ gap <= before * (1 + 1e-7)


@pytest.mark.slow
@examples(25)
@given(systems(contacts=(2, 4), common_restitution=False, gaps=(0.0, 0.5), forced=False))
def test_the_two_solutions_given_diverge_by_the_factor_given(model: System) -> None:
    """The first of them closes every contact, as a plant does."""
    scaled = ClosingSets(model)
    for contacts in impact_expansion.expansive(scaled).sets:
        found = growth(scaled, contacts)
        assert found.factor > 1
        assert np.all(found.one < 0)
        measured = grown(model, contacts, found.one, found.two)
        assert measured == pytest.approx(found.factor, rel=1e-5)


def test_no_two_solutions_diverge_by_more_than_the_factor() -> None:
    """The closed form for two contacts, and pairs at random."""
    model = corner(1.0, 0.0)
    factor = growth(ClosingSets(model), (0, 1)).factor
    # dgamma+ = (-dgamma_1, 0), measured in G^-1: the largest eigenvalue of rank one.
    G = delassus(model)
    assert factor == pytest.approx(G[0, 0] * np.linalg.inv(G)[0, 0], rel=1e-12)
    rng = np.random.default_rng(4)
    pairs = rng.normal(size=(200, 2, 2)) - 1
    assert max(grown(model, (0, 1), *pair) for pair in pairs) <= factor * (1 + 1e-12)


def test_two_sided_stops_do_not_warn() -> None:
    """Floor and ceiling cannot close together, whatever their restitutions."""
    contacts = [([1.0], 0.1, 1.0), ([-1.0], 0.2, 0.0)]
    play = system(1, 1, 1, contacts=contacts)
    assert is_nonexpansive(play) is True
    assert redundant(play) == SearchResult((), True)
    assert ClosingSets(play).conflict((0, 1)) == (0, 1)


def test_stops_without_play_are_always_closed() -> None:
    """Floor and ceiling at one height depend on each other, and leave no room."""
    none = system(1, 1, 1, contacts=[([1.0], 0.1, 0.5), ([-2.0], -0.2, 0.5)])
    scaled = ClosingSets(none)
    assert scaled.feasible
    assert not scaled.has_clearance
    assert redundant(none).sets == ((0, 1),)


def test_contradicting_stops_close_nothing() -> None:
    """A ceiling below the floor: no position is outside both."""
    model = system(1, 1, 1, contacts=[([1.0], -0.1, 0.5), ([-1.0], -0.1, 1.0)])
    assert not ClosingSets(model).feasible
    assert is_nonexpansive(model) is True


def test_a_doubled_contact_of_unequal_restitution_is_redundant_and_raises_nothing() -> None:
    """The larger one counts, ``u+ = -0.8 u-``, though ``G - E G E`` is indefinite."""
    model = system(1, 1, 1, contacts=[([1], 0.0, 0.5), ([1], 0.0, 0.8)])
    assert raises(model, [0, 1])
    assert is_nonexpansive(model) is True
    assert redundant(model).sets == ((0, 1),)
    u, v = np.array([-1.0]), np.array([-0.25])
    law = ImpactLaw(model)
    difference = law.velocity_after(u, (0, 1)) - law.velocity_after(v, (0, 1))
    assert abs(difference) == pytest.approx(0.8 * 0.75, rel=1e-12)


def test_contacts_out_of_reach_of_each_other_do_not_count() -> None:
    """The counterexample's contacts, and a third that keeps the body out of their corner."""
    contacts = [([1.0, 0.0], 0.0, 1.0), ([0.9, 0.436], 0.0, 0.0), ([1.0, 1.0], -1.0, 0.5)]
    model = system(np.eye(2), np.eye(2), np.eye(2), contacts=contacts)
    assert not closes(model, [0, 1])
    assert (0, 1) not in expansive_sets(model)
    assert set(expansive_sets(model)) == {
        tuple(i) for i in subsets(3) if len(i) == 2 and closes(model, i) and raises(model, i)
    }


def threefold() -> tuple[System, System]:
    """Three contacts that fail together while no two fail; the same with one restitution."""
    directions, unit = [[1, 0.0, 0.0], [0.8, 0.6, 0.0], [0.8, 0.3, 0.52]], np.eye(3)

    def model(*eps: float) -> System:
        contacts = [(w, 0.1, e) for w, e in zip(directions, eps, strict=True)]
        return system(unit, unit, unit, contacts=contacts)

    grid = np.linspace(0.5, 0.9, 21)
    tried = (model(0.5, a, b) for a in grid for b in grid)
    failing = next(m for m in tried if [i for i in subsets(3) if raises(m, i)] == [[0, 1, 2]])
    return failing, model(0.5, 0.5, 0.5)


def test_three_contacts_can_fail_where_no_two_of_them_do() -> None:
    """Slight differences add up to a failure without a failing pair."""
    model, equal = threefold()
    assert expansive_sets(model) == ((0, 1, 2),)
    assert is_nonexpansive(equal) is True


def test_a_common_restitution_never_fails_by_rounding() -> None:
    """Contacts almost parallel, masses from a milligram to a ton, restitution 1."""
    rng = np.random.default_rng(5)
    M = np.diag([1e-6, 1.0, 1e3])
    contacts = [([1, 1e-9 * k, rng.normal()], 0.0, 1.0) for k in range(6)]
    model = system(M, np.eye(3), np.eye(3), contacts=contacts)
    assert is_nonexpansive(model) is True


def test_hundreds_of_contacts_need_few_programmes() -> None:
    """Walls on both sides of 149 masses; and the one unequal link of a chain is found."""
    n = 150
    unit = np.eye(n)
    eps = np.linspace(0.0, 1.0, n)
    walls = [(side * unit[i], 0.1, eps[i - side]) for i in range(n - 1) for side in (1, -1)]
    both = chain(n, contacts=walls)
    assert impact_expansion.expansive(ClosingSets(both)) == SearchResult((), True)
    assert redundant(both) == SearchResult((), True)
    links = [unit[i + 1] - unit[i] for i in range(n - 1)]
    odd = [(link, 0.1, 0.0 if i == 75 else 1.0) for i, link in enumerate(links)]
    assert expansive_sets(chain(n, contacts=odd)) == ((74, 75), (75, 76))


def test_what_is_not_decided_is_not_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the search reaches its bound, the answer is None."""
    model, _ = threefold()
    assert is_nonexpansive(model) is False
    monkeypatch.setattr(closing_sets, "STEPS", 1)
    assert is_nonexpansive(model) is None
    assert expansive_sets(model) == ()
    assert redundant(model) == SearchResult((), True)
    spread = [([1, 0, 0], 1.0), ([0, 1, 0], 1.0), ([0, 0, 1], 1.0), ([1, 1, 1], 1.0)]
    unit = np.eye(3)
    assert not redundant(system(unit, unit, unit, contacts=[(*w, 0.5) for w in spread])).decided
