# SPDX-License-Identifier: Apache-2.0
"""The plant against a second one that shares nothing with it but the model.

The other integrates with scipy's DOP853, finds gaps and loads that vanish as its events, and
solves both complementarity problems, of impulses and of loads, by trying all sets of contacts.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import contact_cases as cases
import numpy as np
import pytest
from contact_cases import Case
from numpy.typing import NDArray
from scipy import integrate, linalg

from impact_observer.events import Kind
from impact_observer.plant import Switching

Array = NDArray[np.float64]
Function = Callable[[float, Array], float]

_AT_STOP = 1e-9
"""A gap that is closed, m."""
_RESTS = 1e-6
"""Contact speed below which a closed contact is at rest, m/s; a flight at it takes some us."""


class Found(NamedTuple):
    """What the other plant did at one instant."""

    seconds: float
    contacts: tuple[int, ...]
    closed: tuple[int, ...]
    before: Array
    after: Array


def complementary(G: Array, b: Array) -> Array:
    """``0 <= G z + b _|_ z >= 0`` by trying every set of entries that may be positive."""
    size = len(b)
    for count in range(size + 1):
        for chosen in map(list, itertools.combinations(range(size), count)):
            z = np.zeros(size)
            z[chosen] = np.linalg.solve(G[np.ix_(chosen, chosen)], -b[chosen])
            if np.all(z >= 0) and np.all(np.delete(G @ z + b, chosen) >= 0):
                return z
    raise AssertionError("no set of contacts solves the law")


class Other:
    """A plant of its own, with the contacts of ``closed`` held."""

    def __init__(self, case: Case) -> None:
        """Start where ``case`` starts."""
        self.system = case.system
        self.inverse = linalg.inv(case.system.M)
        self.G = case.system.W.T @ self.inverse @ case.system.W
        self.t, self.end = 0.0, case.seconds
        self.x = np.concatenate([case.position, case.velocity])
        self.closed: tuple[int, ...] = ()

    def run(self) -> list[Found]:
        """Everything up to the end."""
        found = [self.switch(())]
        while (opened := self.advance()) is not None:
            found.append(self.switch(opened))
        return [one for one in found if one.contacts or one.seconds]

    def free(self, t: float, x: Array) -> Array:
        """Accelerations without contact."""
        q, u = np.split(x, 2)
        model = self.system
        return np.asarray(self.inverse @ (model.forcing(t) - model.C @ u - model.K @ q))

    def loads(self, t: float, x: Array) -> Array:
        """The loads that hold the closed contacts."""
        held = list(self.closed)
        b = self.system.W[:, held].T @ self.free(t, x)
        return np.linalg.solve(self.G[np.ix_(held, held)], -b)

    def rates(self, t: float, x: Array) -> Array:
        """``dx/dt`` with the closed contacts held."""
        acceleration = self.free(t, x)
        if self.closed:
            directions = self.system.W[:, list(self.closed)]
            acceleration = acceleration + self.inverse @ directions @ self.loads(t, x)
        return np.concatenate([x[self.system.n :], acceleration])

    def advance(self) -> tuple[int, ...] | None:
        """Go to the next instant at which a contact closes or opens; those that open there."""
        watched = [i for i in range(len(self.system.eps)) if i not in self.closed]
        events = [self.gap(i) for i in watched] + [self.load(k) for k in range(len(self.closed))]
        for event in events:
            event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
        solution = integrate.solve_ivp(
            self.rates,
            (self.t, self.end),
            self.x,
            method="DOP853",
            events=events,
            rtol=1e-11,
            atol=1e-12,
            max_step=0.05,
        )
        self.t, self.x = float(solution.t[-1]), solution.y[:, -1]
        if solution.status == 0:
            return None
        happened = [len(times) > 0 for times in solution.t_events[len(watched) :]]
        return tuple(itertools.compress(self.closed, happened))

    def gap(self, i: int) -> Function:
        """A gap; of a contact that leaves its stop now, divided by the time since."""
        w, start, begin = self.system.W[:, i], self.x.copy(), self.t
        n = self.system.n
        if w @ start[:n] + self.system.q_r[i] > _AT_STOP:
            return lambda _, x: float(w @ x[:n] + self.system.q_r[i])

        def divided(t: float, x: Array) -> float:
            return float(w @ (x - start)[:n] / (t - begin) if t > begin else w @ start[n:])

        return divided

    def load(self, k: int) -> Function:
        """The load of a closed contact."""
        return lambda t, x: float(self.loads(t, x)[k])

    def switch(self, opened: tuple[int, ...]) -> Found:
        """Newton's law on all closed contacts where one hits, then what stays closed."""
        model, before = self.system, self.x.copy()
        n = model.n
        at_stop = np.flatnonzero(np.abs(model.gap(before[:n])) < _AT_STOP).tolist()
        gamma = model.contact_speed(before[n:])[at_stop]
        G, directions = self.G[np.ix_(at_stop, at_stop)], model.W[:, at_stop]
        hit = bool(np.any(gamma < -_AT_STOP))
        if hit:
            impulses = complementary(G, (1 + model.eps[at_stop]) * gamma)
            self.x[n:] += self.inverse @ directions @ impulses
        self.closed = self.staying([i for i in at_stop if i not in opened])
        return Found(self.t, tuple(at_stop) if hit else (), self.closed, before, self.x.copy())

    def staying(self, at_stop: list[int]) -> tuple[int, ...]:
        """Which of the contacts ``at_stop`` rest and are pressed; their speeds become zero."""
        model, n = self.system, self.system.n
        gamma = model.contact_speed(self.x[n:])
        resting = [i for i in at_stop if abs(gamma[i]) < _RESTS]
        b = model.W[:, resting].T @ self.free(self.t, self.x)
        loads = complementary(self.G[np.ix_(resting, resting)], b)
        held = [i for i, load in zip(resting, loads, strict=True) if load > 0]
        impulses = np.linalg.solve(self.G[np.ix_(held, held)], -gamma[held])
        self.x[n:] += self.inverse @ model.W[:, held] @ impulses
        return tuple(held)


def agreement(ours: Switching, other: Found, n: int) -> float:
    """Largest difference of instant and speeds, in s and m/s."""
    return max(
        abs(cases.seconds(ours) - other.seconds),
        float(np.max(np.abs(ours.before[n:] - other.before[n:]))),
        float(np.max(np.abs(ours.after[n:] - other.after[n:]))),
    )


@pytest.mark.parametrize(
    ("case", "count"),
    [
        (cases.floor_and_ceiling, 23),
        pytest.param(cases.collapsing_beads, 37, marks=pytest.mark.slow),
        (cases.thrown_beads, 28),
        pytest.param(cases.resting_beads, 4, marks=pytest.mark.slow),
    ],
)
def test_simultaneous_impacts_are_those_of_an_enumeration(
    case: Callable[[], Case], count: int
) -> None:
    """The same contacts in the same order, at the same instants, with the same speeds."""
    given = case()
    ours = cases.impacts(given)
    other = [one for one in Other(given).run() if one.contacts]
    assert len(ours) == count
    assert [one.contacts for one in ours] == [one.contacts for one in other]
    assert max(agreement(*pair, given.system.n) for pair in zip(ours, other, strict=True)) < 1e-8


def test_resting_beads_stay_closed_under_the_falling_one() -> None:
    """Nine contacts are closed before and after each impact of the tenth."""
    found = cases.impacts(cases.resting_beads())
    assert [one.closed for one in found] == [tuple(range(9))] * 4


@pytest.mark.slow
@pytest.mark.parametrize("case", [cases.pressed_mass, cases.pulled_mass])
@pytest.mark.parametrize("eps", [0.0, 0.5])
def test_sticking_and_release_are_those_of_another_integrator(
    case: Callable[[float], Case], eps: float
) -> None:
    """A contact closes, at once or by accumulating impacts, and opens at the same instants."""
    given = case(eps)
    ours = cases.switchings(given)
    other = Other(given).run()
    closes = [cases.seconds(one) for one in ours if Kind.CLOSE in cases.kinds(one)]
    opens = [cases.seconds(one) for one in ours if Kind.OPEN in cases.kinds(one)]
    others = [one.seconds for one in other if one.contacts and one.closed]
    tolerance = 1e-5 if eps else 1e-9  # both leave out the last impacts of an accumulation
    np.testing.assert_allclose(closes, others, rtol=0, atol=tolerance)
    others = [one.seconds for one in other if not one.contacts]
    np.testing.assert_allclose(opens, others, rtol=0, atol=tolerance)
    assert agreement(ours[0], other[0], given.system.n) < 1e-9
