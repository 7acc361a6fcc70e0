# SPDX-License-Identifier: Apache-2.0
"""Contacts that stay closed: CLOSE, OPEN, and the motion in between."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import (
    EPOCH,
    PRESSED,
    Harmonic,
    estimates,
    forcing,
    observer,
    run,
    sample,
    switching,
    system,
)

from impact_observer.events import ImpactEvent, Kind, Ruling, Switch
from impact_observer.model import System
from impact_observer.observer import ReplicaLaw
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
LAWS = pytest.mark.parametrize("law", ["kinematic", "geometric"])

TABLE = system(
    1, 0, 0, contacts=[([1], 0.0, 0.3)], force=forcing(1, -9.81, [Harmonic(10.0, [15.0], [0.0])])
)
"""A body on a shaking table that throws it, in the frame of the table."""


@cache
def pressed() -> Run:
    """A run of ``PRESSED`` from rest."""
    return run(PRESSED, [0.0, 0.0], [0.0, 0.0], seconds=11.5, rate=50.0)


def gap_and_speed(model: System, states: Array) -> tuple[Array, Array]:
    """Gaps and contact speeds, shape (samples, m)."""
    q, u = states[:, : model.n], states[:, model.n :]
    return q @ model.W + model.q_r, u @ model.W


def test_sample_run_closes_and_opens_both_contacts() -> None:
    """Several times, also together."""
    kinds = [(s.contact, s.kind) for each in pressed().events for s in each.switches]
    for contact in ("c1", "c2"):
        assert kinds.count((contact, Kind.CLOSE)) >= 2
        assert kinds.count((contact, Kind.OPEN)) >= 2
    assert any(len(switching.closed) == 2 for switching in pressed().switchings)


@pytest.mark.slow
@LAWS
@pytest.mark.parametrize(("model", "start"), [(TABLE, [0.0, 0.0]), (PRESSED, [0.0] * 4)])
def test_observer_in_the_true_state_stays_there(law: str, model: System, start: Array) -> None:
    """Through accumulation, rest and release, to the rounding of stamps."""
    truth = run(model, *np.split(np.array(start), 2), seconds=6.0)
    watcher = observer(model, law, start, epoch=EPOCH, history=100.0)
    for each in truth.events:
        assert {verdict.ruling for verdict in watcher.receive(each)} == {Ruling.APPLIED}
    np.testing.assert_allclose(estimates(watcher, truth.stamps), truth.states, atol=1e-5)
    away = np.abs(estimates(watcher, truth.stamps) - truth.states).max(axis=1)
    # Only in the microseconds between the last reported impact and true rest it is larger.
    assert np.mean(away > 1e-7) < 0.02


def test_geometric_replica_keeps_closed_gaps_closed_while_its_clutch_slips() -> None:
    """``g = 0`` all the time, ``gamma > 0`` until the clutch holds, never below zero."""
    watcher = observer(PRESSED, "geometric", [0.3, -0.4, 1.0, -2.0], epoch=EPOCH)
    watcher.receive(switching(("c1", Kind.CLOSE), seconds=0.5, sequence=1))
    stamps = EPOCH + np.arange(500_000_000, 1_500_000_000, 2_000_000)
    gap, speed = gap_and_speed(PRESSED, estimates(watcher, stamps))
    np.testing.assert_allclose(gap[:, 0], 0.0, atol=1e-12)
    assert speed[:, 0].min() >= -1e-13
    held = speed[:, 0] < 1e-13
    assert held.any()
    assert not held.all()


def test_kinematic_replica_keeps_its_gap_once_its_clutch_holds() -> None:
    """The gap is not zero; it only stops closing."""
    watcher = observer(PRESSED, "kinematic", [0.3, -0.4, 1.0, -2.0], epoch=EPOCH)
    watcher.receive(switching(("c1", Kind.CLOSE), seconds=0.5, sequence=1))
    stamps = EPOCH + np.arange(500_000_000, 1_200_000_000, 1_000_000)
    gap, speed = gap_and_speed(PRESSED, estimates(watcher, stamps))
    held = speed[:, 0] < 1e-13
    assert 0 < held.sum() < held.size
    assert np.all(np.diff(gap[:, 0]) >= -1e-13)
    assert gap[-1, 0] > 0.1


@LAWS
def test_contact_that_opens_by_an_impact_takes_part_in_it(law: str) -> None:
    """OPEN with an IMPACT of another at one stamp: first the law on both, then chi is 0."""
    x = [0.3, -0.4, 1.0, -2.0]
    watcher, before = (observer(PRESSED, law, x, epoch=EPOCH) for _ in range(2))
    for each in (watcher, before):
        each.receive(switching(("c1", Kind.CLOSE), seconds=0.3, sequence=1))
    moment = EPOCH + round(0.35 * NS_PER_S)
    watcher.receive(switching(("c2", Kind.IMPACT), ("c1", Kind.OPEN), seconds=0.35, sequence=2))
    was, now = before.estimate(moment), watcher.estimate(moment)
    assert isinstance(before.law, ReplicaLaw)
    expected = before.law.impact(np.concatenate([was.q, was.u]), (0, 1), ())
    np.testing.assert_allclose(np.concatenate([now.q, now.u]), expected, atol=1e-12)
    assert now.closed == ()


def test_redundant_switches_are_applied_without_effect() -> None:
    """A contact opened twice, or opened before it was closed: chi stays the same."""
    plain, repeated = (observer(PRESSED, "geometric", np.ones(4), epoch=EPOCH) for _ in range(2))
    plain.receive(
        switching(("c3", Kind.OPEN), seconds=0.2, sequence=1)
    )  # there is no such contact
    repeated.receive(switching(("c1", Kind.OPEN), seconds=0.2, sequence=1))
    for watcher in (plain, repeated):
        watcher.receive(switching(("c1", Kind.CLOSE), seconds=0.5, sequence=2))
        watcher.receive(switching(("c1", Kind.OPEN), seconds=0.8, sequence=3))
    verdict = repeated.receive(switching(("c1", Kind.OPEN), seconds=0.9, sequence=4))[0]
    assert verdict.ruling is Ruling.APPLIED
    stamps = EPOCH + np.arange(0, 2_000_000_000, 100_000_000)
    np.testing.assert_allclose(estimates(repeated, stamps), estimates(plain, stamps), atol=1e-12)


def test_impact_of_a_closed_contact_implies_a_missed_opening() -> None:
    """An IMPACT is one instant: where the OPEN was lost, the contact is open afterwards."""
    watcher = observer(PRESSED, "geometric", np.zeros(4), epoch=EPOCH)
    watcher.receive(switching(("c1", Kind.CLOSE), seconds=1.0, sequence=1))
    watcher.receive(switching(("c1", Kind.IMPACT), seconds=2.0, sequence=3))
    assert watcher.estimate(EPOCH + 5 * NS_PER_S // 2).closed == ()
    assert watcher.missing == 1


@LAWS
def test_state_set_from_outside_leaves_contacts_closed(law: str) -> None:
    """Closed contacts constrain the given state at once, and afterwards."""
    watcher = observer(PRESSED, law, np.zeros(4), epoch=EPOCH)
    watcher.receive(switching(("c1", Kind.CLOSE), seconds=1.0, sequence=1))
    moment = EPOCH + 2 * NS_PER_S
    watcher.set_state(moment, [0.2, 0.3], [0.1, 0.5])
    now, next_one = watcher.estimate(moment), watcher.estimate(moment + 1)
    assert now.closed == watcher.estimate(EPOCH + 3 * NS_PER_S).closed == ("c1",)
    assert PRESSED.contact_speed(now.u)[0] >= 0
    if law == "geometric":
        assert PRESSED.gap(now.q)[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(next_one.q, now.q, atol=1e-8)
    np.testing.assert_allclose(next_one.u, now.u, atol=1e-7)


def test_new_episode_begins_with_all_contacts_open() -> None:
    """Contacts closed in the episode before do not count."""
    watcher = observer(PRESSED, "geometric", np.zeros(4), epoch=EPOCH)
    watcher.receive(switching(("c1", Kind.CLOSE), seconds=1.0, sequence=1))
    epoch = EPOCH + 10 * NS_PER_S
    for k in (1, 2):
        watcher.receive(ImpactEvent(epoch + k * NS_PER_S // 2, (Switch("c2"),), k, 1, epoch))
    assert watcher.estimate(epoch + 2 * NS_PER_S).closed == ()


@pytest.mark.parametrize(
    ("law", "height"), [pytest.param("kinematic", 1.2, marks=pytest.mark.slow), ("geometric", 0.0)]
)
def test_estimate_of_a_ball_comes_to_rest_with_it(law: str, height: float) -> None:
    """The geometric estimate is exact; the kinematic one, K = 0, keeps its error of height."""
    model = sample("bouncing_ball").system
    truth = run(model, [1.0], [0.0], seconds=10.0)
    watcher = observer(model, law, [1.7, 0.4], epoch=EPOCH, history=100.0)
    for each in truth.events:
        watcher.receive(each)
    end = watcher.estimate(int(truth.stamps[-1]))
    assert end.closed == ("floor",)
    assert abs(end.u[0]) < 1e-12
    assert end.q[0] == pytest.approx(0.0, abs=1e-12) if height == 0 else end.q[0] > 0.1
