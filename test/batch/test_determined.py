# SPDX-License-Identifier: Apache-2.0
"""What impacts say of the start, against matrices stacked by hand."""

from collections.abc import Sequence
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import linalg
from systems import (
    EPOCH,
    Harmonic,
    event,
    examples,
    forcing,
    numbers,
    run,
    sample,
    system,
    systems,
)

from impact_observer.batch.determined import Determined, determined
from impact_observer.dynamics import Phases
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.observer.samples import SensorSample
from impact_observer.stamps import NS_PER_S, seconds_between

Array = NDArray[np.float64]
DECOUPLED = system(
    np.diag([1.0, 2.0]), np.diag([0.1, 0.0]), np.diag([10.0, 7.0]), contacts=[([-1, 0], 0.5, 0.7)]
)
"""Two decoupled oscillators; one has a stop."""


def exponential(model: System, seconds: float) -> Array:
    """The transition matrix by scipy's matrix exponential."""
    n = model.n
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:] = np.linalg.solve(model.M, -np.hstack([model.K, model.C]))
    return np.asarray(linalg.expm(A * seconds))


def reset(model: System, contact: int) -> Array:
    """How an impact of one contact changes an error, shape (2n, 2n)."""
    w = model.W[:, contact]
    pushed = np.linalg.solve(model.M, w)
    jump = np.eye(model.n) - (1 + model.eps[contact]) * np.outer(pushed, w) / (w @ pushed)
    return np.asarray(linalg.block_diag(np.eye(model.n), jump))


def stacked(model: System, hits: Sequence[tuple[float, int]]) -> Array:
    """The rows of isolated impacts (seconds since the last one, contact), one above the other."""
    moved = np.eye(2 * model.n)
    rows = []
    for wait, contact in hits:
        moved = exponential(model, wait) @ moved
        rows.append(model.W[:, contact] @ moved[: model.n])
        moved = reset(model, contact) @ moved
    return np.array(rows)


def impacts_of(model: System, hits: Sequence[tuple[float, int]]) -> list[ImpactEvent]:
    """The same as events."""
    instants = np.cumsum([wait for wait, _ in hits])
    return [
        event(t, model.contact_names[contact], sequence=k)
        for k, (t, (_, contact)) in enumerate(zip(instants, hits, strict=True), start=1)
    ]


def of(model: System, events: Sequence[ImpactEvent]) -> Determined:
    """What they say of a start of unit deviations."""
    return determined(model, events, np.ones(2 * model.n))


@examples(12)
@given(systems(max_n=3), st.data())
def test_singular_values_are_those_of_the_matrix_stacked_by_hand(
    model: System, data: st.DataObject
) -> None:
    """K singular or not; undetermined errors move no gap."""
    hits = data.draw(
        st.lists(st.tuples(numbers(0.0, 2.0), st.integers(0, model.m - 1)), min_size=1, max_size=8)
    )
    wanted = stacked(model, hits)
    size = np.linalg.norm(wanted, 2)
    found = of(model, impacts_of(model, hits))
    values = np.linalg.svd(wanted, compute_uv=False)
    k = min(values.size, 2 * model.n)
    np.testing.assert_allclose(found.singular[:k], values[:k], rtol=1e-7, atol=1e-9 * size)
    np.testing.assert_allclose(found.singular[k:], 0.0, atol=1e-9 * size)
    np.testing.assert_allclose(wanted @ found.undetermined.T, 0.0, atol=1e-7 * size)


@pytest.mark.parametrize(("name", "impacts"), [("two_mass", 4), ("three_mass", 6)])
def test_2n_impacts_determine_the_state_of_the_samples(name: str, impacts: int) -> None:
    """The rank is full after them."""
    model = sample(name)
    events = run(model.system, *model.initial_state(), seconds=30.0).events
    found = of(model.system, events)
    assert found.full_after is not None
    assert found.full_after[0] == impacts
    assert found.condition is not None
    assert found.condition < 50
    assert found.undetermined.shape == (0, 2 * found.system.n)


def test_motion_of_stops_changes_no_row() -> None:
    """A ball's rows are those above a still floor: (1, t1) and (1, t1 - eps (t2 - t1))."""
    model = sample("ball_on_table").system
    events = run(model, [0.02], [0.0], seconds=1.0).events[:2]
    one, two = (seconds_between(EPOCH, each.stamp) for each in events)
    assert of(model, events).singular.prod() == pytest.approx(0.5 * (two - one), rel=1e-9)


def test_state_of_a_decoupled_oscillator_without_a_stop_is_undetermined() -> None:
    """Its position and its velocity."""
    found = of(DECOUPLED, impacts_of(DECOUPLED, [(0.3 + 0.1 * k, 0) for k in range(12)]))
    assert (found.rank, found.full_after, found.condition) == (2, None, None)
    np.testing.assert_array_equal(found.undetermined, [[0, 1, 0, 0], [0, 0, 0, 1]])


def test_orbit_whose_impacts_all_add_the_same_row() -> None:
    """``x'' + x = cos 2t``, x <= 0, eps 0.8: one impact a half period of the free oscillator.

    A plant that starts elsewhere along the undetermined direction hits at the same instants.
    """
    model = system(
        1, 0, 1, contacts=[([-1], 0.0, 0.8)], force=forcing(1, 0, [Harmonic(2.0, [1.0], [0.0])])
    )
    start = np.array([-1 / 3 - 3 * sqrt(2), 3 * sqrt(2)])
    truth = run(model, start[:1], start[1:], seconds=60.0)
    found = of(model, truth.events)
    assert found.impacts == 19
    assert found.seconds == pytest.approx(pi / 4 + 18 * pi, abs=1e-6)
    assert found.rank == 1
    np.testing.assert_allclose(np.abs(found.undetermined), [[sqrt(0.5), sqrt(0.5)]], atol=1e-9)
    np.testing.assert_allclose(np.abs(found.remaining), [[0.0, 0.8**19]], atol=1e-9)
    other = start + 0.5 * found.undetermined[0]
    again = run(model, other[:1], other[1:], seconds=60.0)
    stamps = [[e.stamp for e in each.events] for each in (truth, again)]
    np.testing.assert_allclose(stamps[1], stamps[0], atol=3)


def test_two_stops_at_one_instant_add_two_rows() -> None:
    """As one by one."""
    contacts = [([1, 0], 0.0, 0.5), ([0, 1], 0.0, 0.8)]
    both = system(np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=contacts)
    found = of(both, [event(0.3, "c1", "c2"), event(0.8, "c1", "c2")])
    single = [event(0.3, "c1"), event(0.3, "c2"), event(0.8, "c1"), event(0.8, "c2")]
    assert found.rank == 4
    np.testing.assert_allclose(found.singular, of(both, single).singular, rtol=1e-9)


def test_deviations_are_the_units_of_the_initial_state() -> None:
    """Columns of the matrix are scaled by them; certain states are no unknowns."""
    hits = [(0.4, 0), (0.5, 0), (0.9, 0)]
    deviation = np.array([0.1, 3.0, 2.0, 0.0])
    found = determined(DECOUPLED, impacts_of(DECOUPLED, hits), deviation)
    wanted = np.linalg.svd(stacked(DECOUPLED, hits) * deviation, compute_uv=False)
    assert found.size == 3
    np.testing.assert_allclose(found.singular, wanted[:3], rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(found.undetermined, [[0, 3.0, 0, 0]])
    with pytest.raises(UsageError, match="0 throughout"):
        determined(DECOUPLED, impacts_of(DECOUPLED, hits), np.zeros(4))


def test_only_the_last_episode_counts_and_needs_impacts() -> None:
    """As with an observer, which is reset by a new one."""
    later = EPOCH + 100 * NS_PER_S
    events = [
        event(0.5, "c1", sequence=1),
        event(0.9, "c1", sequence=1, episode=1),
        event(100.3, "c1", sequence=1, episode=0, epoch=later),
        event(100.5, "c1", sequence=2, episode=0, epoch=later),
    ]
    found = of(DECOUPLED, events)
    assert found.impacts == 2
    assert found.seconds == pytest.approx(0.5)
    with pytest.raises(BagError, match="c1"):
        of(DECOUPLED, [event(2.0, "bell")])


def test_samples_add_rows_like_gaps() -> None:
    """Against a matrix stacked by hand: an encoder and a speed, each in its own unit."""
    model = sample("two_mass").system
    whole = run(model, *sample("two_mass").initial_state(), seconds=3.0, rate=10.0)
    declared = (
        Measurement("x", "/x", "x1", "position", deviation=1.0),
        Measurement("v", "/v", "x1", "velocity", deviation=1.0),
    )
    stamps = [EPOCH + NS_PER_S // 10, EPOCH + NS_PER_S // 5]
    samples = [SensorSample(k, stamp, 0.0) for k, stamp in enumerate(stamps)]
    first = whole.events[:1]
    found = determined(model, first, np.ones(4), measurements=declared, samples=samples)
    transition = Phases(model).phase().transition
    gap = np.concatenate([model.W[:, 0], [0.0, 0.0]])
    at = seconds_between(EPOCH, first[0].stamp)
    rows = [transition(0.1)[0], transition(0.2)[2], gap @ transition(at)]
    expected = np.linalg.svd(np.array(rows), compute_uv=False)
    np.testing.assert_allclose(found.singular[:3], expected, rtol=1e-9)
    assert found.rank == 3
