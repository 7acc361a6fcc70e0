# SPDX-License-Identifier: Apache-2.0
"""The plant against conservation laws; its starts, stamps, limits and errors."""

import numpy as np
import pytest
from contact_cases import approach, seconds
from numpy.typing import NDArray
from systems import EPOCH, chain, forcing, run, sample, started, system

from impact_observer.errors import ImpactLawError, UsageError
from impact_observer.events import Switch
from impact_observer.model import System
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, Instant, grid

Array = NDArray[np.float64]


def test_impact_without_restitution_separates_where_a_spring_pulls() -> None:
    """A body with zero speed after the impact leaves its stop at once."""
    model = system(1, 0, 1, contacts=[([1], 0.5, 0.0)])
    impacts = run(model, [1.0], [0.0], seconds=10.0).impacts
    assert len(impacts) == 1
    assert impacts[0].after[1] == pytest.approx(0.0, abs=1e-15)


def energy(model: System, states: Array) -> Array:
    """Kinetic and elastic energy and that of constant forces, shape (samples,)."""
    q, u = states[:, : model.n], states[:, model.n :]
    kinetic, elastic = ((x @ form * x).sum(axis=1) / 2 for x, form in ((u, model.M), (q, model.K)))
    return np.asarray(kinetic + elastic - q @ model.forcing.constant)


@pytest.mark.slow
def test_energy_is_conserved_over_ten_thousand_impacts() -> None:
    """Each impact and each flight changes it by 1e-14 at most: ten thousand by at most 2e-10.

    A chain whose last mass is pushed against its wall by a load.
    """
    contacts = [([1, 0], 0.05, 1.0), ([0, -1], 0.0, 1.0), ([-1, 1], 0.1, 1.0)]
    model = chain(2, 400.0, 0.0, contacts=contacts, force=forcing(2, [0.0, 20.0]))
    found = run(model, [0.02, -0.05], [2.0, -3.0], seconds=15.0, rate=20.0)
    assert len(found.impacts) > 700
    around = np.array([x for impact in found.impacts for x in (impact.before, impact.after)])
    total = energy(model, around)
    assert np.max(np.abs(np.diff(total))) <= 1e-14 * total[0]


def test_impact_lowers_the_energy_by_newtons_law() -> None:
    """A single contact takes ``(1 - eps^2) gamma-^2 / (2 G)``."""
    model = sample("three_mass").system
    found = run(model, *sample("three_mass").initial_state(), seconds=20.0)
    G = np.diag(model.W.T @ np.linalg.solve(model.M, model.W))
    assert len(found.impacts) > 10
    for impact in found.impacts:
        before, after = energy(model, np.array([impact.before, impact.after]))
        contact = impact.contacts[0]
        lost = (1 - model.eps[contact] ** 2) * approach(model, impact) ** 2 / (2 * G[contact])
        assert before - after == pytest.approx(lost, abs=1e-13)


def test_symmetric_chain_hits_both_walls_at_once() -> None:
    """Simultaneous impacts stay simultaneous, and the motion stays symmetric."""
    contacts = [([1, 0, 0, 0], 0.2, 0.9), ([0, 0, 0, -1], 0.2, 0.9), ([0, -1, 1, 0], 0.3, 0.9)]
    model = chain(4, damping=0.02, contacts=contacts)
    found = run(model, [-0.1, 0.05, -0.05, 0.1], [-2.0, 1.0, -1.0, 2.0], seconds=3.0)
    assert {impact.contacts for impact in found.impacts} >= {(0, 1), (2,)}
    assert {impact.contacts for impact in found.impacts} <= {(0, 1), (2,), (0, 1, 2)}
    q = found.states[:, :4]
    np.testing.assert_allclose(q, -q[:, ::-1], atol=1e-10)
    event = next(e for e in found.events if len(e.switches) == 2)
    assert event.switches == (Switch("c1"), Switch("c2"))


def test_sample_at_an_impacts_stamp_is_after_it() -> None:
    """Whether the true instant was rounded up or down."""
    model = sample("bouncing_ball").system
    plant = started(model, [1.0], [0.0])
    remainders = []
    for _ in range(12):
        impact = plant.next_switching(EPOCH + 10 * NS_PER_S)
        assert impact is not None
        plant.cross(impact)
        remainders.append(impact.instant.remainder)
        at = plant.states(np.array([impact.instant.stamp]))[0]
        assert at[1] == pytest.approx(impact.after[1], abs=1e-8)
        assert at[1] > 0
        assert at[0] >= -1e-15
    assert min(remainders) < 0 < max(remainders)


def test_moving_the_epoch_moves_the_stamps_only() -> None:
    """Forced or not, the same states to the last bit and the same instants, later."""
    model, start = sample("three_mass").system, sample("three_mass").initial_state()
    runs = []
    for epoch in (EPOCH, 1_700_000_000_123_456_789):
        stamps = grid(epoch, epoch + 15 * NS_PER_S, 50.0)
        runs.append(simulate(Plant(model, *start, epoch=epoch), stamps))
    np.testing.assert_array_equal(runs[0].states, runs[1].states)
    moved = 1_700_000_000_123_456_789 - EPOCH
    for early, late in zip(runs[0].impacts, runs[1].impacts, strict=True):
        assert late.instant == Instant(early.instant.stamp + moved, early.instant.remainder)


def test_equal_runs_are_equal_to_the_last_bit() -> None:
    """No hidden state, no randomness."""
    model, start = sample("two_mass").system, sample("two_mass").initial_state()
    one, two = (run(model, *start, seconds=20.0) for _ in range(2))
    np.testing.assert_array_equal(one.states, two.states)
    assert one.events == two.events


def test_impacts_do_not_depend_on_when_they_are_requested() -> None:
    """A node that asks every millisecond and a run that asks once get the same bits."""
    model, start = sample("three_mass").system, sample("three_mass").initial_state()
    once = run(model, *start, seconds=8.0).impacts
    plant, often = Plant(model, *start, epoch=EPOCH), []
    for limit in grid(EPOCH, EPOCH + 8 * NS_PER_S, 1000.0).tolist():
        while (impact := plant.next_switching(limit)) is not None:
            assert plant.next_switching(limit) is impact
            plant.cross(impact)
            often.append(impact)
    assert [i.instant for i in often] == [i.instant for i in once]
    for one, two in zip(once, often, strict=True):
        np.testing.assert_array_equal(one.after, two.after)


def test_impact_is_returned_only_up_to_the_limit() -> None:
    """Its own stamp is inside, one nanosecond less is not."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    plant = started(model, [1.0], [-1.0])
    assert plant.next_switching(EPOCH + NS_PER_S - 1) is None
    assert plant.next_switching(EPOCH + NS_PER_S) is not None


def test_plant_that_starts_at_a_stop_hits_it_at_once() -> None:
    """A closed gap that is still closing is an impact at the epoch."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    found = run(model, [0.0], [-1.0], seconds=1.0)
    assert [seconds(impact) for impact in found.impacts] == [0.0]
    assert found.states[0].tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("position", "velocity", "message"),
    [
        ([-0.1], [0.0], "position"),
        ([1.0, 2.0], [0.0], "position"),
        ([1.0], [np.nan], "velocity.*: is not finite"),
    ],
)
def test_impossible_start_is_refused(
    position: list[float], velocity: list[float], message: str
) -> None:
    """One line that names the argument and the problem."""
    with pytest.raises(UsageError, match=message):
        started(sample("bouncing_ball").system, position, velocity)


def test_start_at_an_impact_without_a_solution_is_refused() -> None:
    """Two stops that depend on each other with unequal restitution, hit together.

    It can be at the start only: stops that leave a body no room are closed all the time.
    """
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.8), ([-1], 0.0, 0.5)])
    with pytest.raises(ImpactLawError, match=r"at 5\.000000000 s"):
        started(model, [0.0], [-1.0])


def test_progress_is_called_at_every_impact() -> None:
    """With its stamp, for progress bars."""
    stamps: list[int] = []
    plant = started(sample("bouncing_ball").system, [1.0], [0.0])
    found = simulate(plant, grid(EPOCH, EPOCH + 3 * NS_PER_S, 10.0), progress=stamps.append)
    assert stamps == [impact.instant.stamp for impact in found.impacts]
