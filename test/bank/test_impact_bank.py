# SPDX-License-Identifier: Apache-2.0
"""The filter on arrays: against dense conditioning, simulated plants, and draws."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.bank.bank import MISSED, SPURIOUS, Bank, mixture
from impact_observer.bank.impact_bank import DeclaredErrors, ImpactBank
from impact_observer.bank.notes import Event
from impact_observer.dynamics.tangent import Tangent
from impact_observer.model import read_model
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import Elapsed, from_seconds, grid
from impact_observer.states import Vector

EPOCH = 10**9
SECONDS = 60.0
Hit = tuple[int, int]
"""ns since the epoch, and the contact."""


def plant(name: str) -> tuple[Tangent, list[Hit], NDArray[np.float64], Vector]:
    """A sample model: its tangent, its impacts, its states at 100 Hz, its start."""
    model = read_model(name)
    q, u = model.initial_state()
    stamps = grid(EPOCH, EPOCH + from_seconds(SECONDS), 100.0)
    run = simulate(Plant(model.system, q, u, epoch=EPOCH), stamps)
    events = [(each.instant.stamp - EPOCH, each.contacts[0]) for each in run.switchings]
    tangent = Tangent(ParametricFamily(model.system, ()))
    return tangent, events, run.states, np.concatenate([q, u])


def filtered(filter_: ImpactBank, events: Sequence[Hit], start: Vector, end: float) -> Bank:
    """The bank at ``end`` s since the epoch, from a start with deviations of one."""
    bank, before = filter_.begin(Elapsed(0), start, np.eye(start.size)), 0
    for stamp, contact in events:
        bank = filter_.predicted(bank, (stamp - before) / 1e9, (contact,))
        bank = filter_.after(bank._replace(t=Elapsed(stamp)), Event((contact,)))
        before = stamp
    return filter_.predicted(bank, end - before / 1e9)


def best(bank: Bank) -> Vector:
    """The state of the likeliest hypothesis."""
    return np.asarray(bank.rows.x[np.argmax(bank.rows.logw)])


def test_a_far_start_is_forgotten_and_the_model_is_found_to_be_exact() -> None:
    """Exact stamps of an exact model give the state to nine digits, on the lowest rungs."""
    tangent, events, states, start = plant("two_mass")
    filter_ = ImpactBank(tangent.family, DeclaredErrors(missed=0.05, spurious=0.05))
    far = start + np.random.default_rng(0).normal(size=4)
    bank = filtered(filter_, events, far, 59.99)
    assert np.max(np.abs(best(bank) - states[5999])) < 1e-9
    assert filter_.ladders.errors[bank.rows.r[0]] == 0.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_missed_and_false_impacts_are_recognised(seed: int) -> None:
    """A fifth is missed, and as many are false; the decisions say which."""
    tangent, events, states, start = plant("two_mass")
    rng = np.random.default_rng(seed)
    kept = [each for each in events if rng.random() > 0.2]
    false = [(int(t * 1e9), 0) for t in rng.uniform(25, 40, 3)]
    filter_ = ImpactBank(tangent.family, DeclaredErrors(missed=0.1, spurious=0.1))
    bank = filtered(filter_, sorted([*kept, *false]), start + rng.normal(size=4), 59.99)
    assert np.max(np.abs(best(bank) - states[5999])) < 1e-7


def test_decisions_name_the_missed_impact_and_the_false_alarm() -> None:
    """From a known state one impact is left out and one is invented."""
    tangent, events, _, start = plant("two_mass")
    filter_ = ImpactBank(
        tangent.family, DeclaredErrors(clock=0.0, error=0.0, missed=0.1, spurious=0.1)
    )
    given = [events[0], (events[0][0] + 300_000_000, 0), *events[2:4]]
    bank = filter_.begin(Elapsed(0), start, 1e-6 * np.eye(4))
    before = 0
    for stamp, contact in given:
        bank = filter_.predicted(bank, (stamp - before) / 1e9, (contact,))
        bank = filter_.after(bank._replace(t=Elapsed(stamp)), Event((contact,)))
        before = stamp
    past = bank.rows.past[np.argmax(bank.rows.logw)] % 8
    assert past.tolist()[-5:] == [1, SPURIOUS, MISSED, 1, 1]


@pytest.mark.long
@pytest.mark.parametrize("model", ["two_mass", "three_mass"])
def test_covariances_are_those_of_errors_over_draws_of_jittered_stamps(model: str) -> None:
    """Of an exact model with the declared jitter of 1 ms: NEES / 2n between 0.7 and 1.3."""
    tangent, events, states, start = plant(model)
    filter_, found = ImpactBank(tangent.family, DeclaredErrors(clock=1e-3, error=0.0)), []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        given = sorted((t + int(1e6 * rng.normal()), i) for t, i in events)
        bank = filtered(filter_, given, start + rng.normal(size=start.size), 59.99)
        x, root = mixture(bank.rows, filter_.ladders, 0.0)
        error = np.linalg.solve(root, x - states[5999])
        found.append(error @ error / start.size)
    assert 0.7 < np.mean(found) < 1.3


def test_an_impact_corrects_as_dense_conditioning_on_state_and_stamp_does() -> None:
    """Mean and covariance of the linear problem, by differences of an exact jump."""
    tangent, *_ = plant("two_mass")
    filter_ = ImpactBank(tangent.family, DeclaredErrors(clock=1e-5, error=0.0))
    t, x = 3.0, np.array([0.1, 0.5, 0.3, 1.1])
    rng = np.random.default_rng(5)
    S = 1e-6 * rng.normal(size=(4, 4))
    W = tangent.system.W[:, 0]

    def flown(state: Vector, since: float, s: float) -> Vector:
        return np.asarray(tangent.flights([since], np.array([s]), ()).of(state)[0])

    def after(z: Vector) -> Vector:
        """State at the stamp, of the state without an impact and the error of the stamp."""
        own = flown(z[:4], t, -z[4])
        return flown(tangent.impact(own, (0,)).x, t - z[4], z[4])

    def gap(z: Vector) -> float:
        return float(W @ flown(z[:4], t, -z[4])[:2] + tangent.system.q_r[0])

    z = np.append(x, 0.0)
    steps = 1e-6 * np.eye(5)
    H = np.array([(gap(z + e) - gap(z - e)) / 2e-6 for e in steps])
    J = np.array([(after(z + e) - after(z - e)) / 2e-6 for e in steps]).T
    P = np.zeros((5, 5))
    P[:4, :4], P[4, 4] = S @ S.T, filter_.ladders.clocks[0] ** 2
    K = P @ H / (H @ P @ H)
    expected = J @ (P - np.outer(K, H @ P)) @ J.T
    bank = filter_.begin(Elapsed(3 * 10**9), x, S)
    found = filter_.after(bank, Event((0,))).rows
    hit = np.flatnonzero(found.past[:, -1] % 8 == 1)[0]
    assert found.x[hit] == pytest.approx(after(z - K * gap(z)), abs=1e-11)
    size = np.sqrt(np.diag(expected))
    own = found.S[hit] @ found.S[hit].T
    assert own / np.outer(size, size) == pytest.approx(expected / np.outer(size, size), abs=1e-4)


def test_what_lies_on_its_stop_has_no_larger_motion() -> None:
    """The size of the motion of a ball at rest is that of the ball, not that of a fall."""
    system = read_model("bouncing_ball").system
    filter_ = ImpactBank(ParametricFamily(system, ()), DeclaredErrors(missed=0.05, spurious=0.05))
    bank = filter_.begin(Elapsed(0), np.array([0.0, -0.1]), 0.01 * np.eye(2))
    bank = filter_.after(bank, Event((0,), closed=(0,)))
    for k in range(1, 11):
        bank = filter_.predicted(bank, 2.0, (0,))._replace(t=Elapsed(2 * k * EPOCH))
        bank = filter_.after(bank, Event((0,), closed=(0,)))
    assert np.all(bank.sizes < 0.5)
