# SPDX-License-Identifier: Apache-2.0
"""Rank of the observability matrix of impacts, against matrices stacked by hand."""

from collections.abc import Sequence
from math import pi, sqrt

import numpy as np
import pytest
from contact_cases import pulled_mass
from hypothesis import given, reject
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
    observer,
    run,
    sample,
    system,
    systems,
)

from impact_observer.dynamics import Phases
from impact_observer.errors import BagError, ImpactLawError, UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.filter.readings import sensors_of
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples
from impact_observer.model.measurement import Measurement
from impact_observer.observability.rank import Observability, observability
from impact_observer.observability.rank_rows import RankRows
from impact_observer.observer.episode import last_episode
from impact_observer.observer.samples import SensorSample
from impact_observer.stamps import NS_PER_S, seconds_between

Array = NDArray[np.float64]

KINDS = st.sampled_from(list(Kind))


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


def event_at(seconds: float, *switches: tuple[str, Kind], sequence: int = 0) -> ImpactEvent:
    """An event of switches by name and kind."""
    stamp = EPOCH + round(seconds * NS_PER_S)
    return ImpactEvent(stamp, tuple(Switch(*each) for each in switches), sequence, 0, EPOCH)


def of_sample(name: str, seconds: float) -> Observability:
    """The observability of a run of a sample."""
    model = sample(name)
    return observability(
        model.system, run(model.system, *model.initial_state(), seconds=seconds).events
    )


DECOUPLED = system(
    np.diag([1.0, 2.0]), np.diag([0.1, 0.0]), np.diag([10.0, 7.0]), contacts=[([-1, 0], 0.5, 0.7)]
)
"""Two decoupled oscillators; one has a stop."""


@examples(12)
@given(systems(max_n=3), st.data())
def test_singular_values_are_those_of_the_matrix_stacked_by_hand(
    model: System, data: st.DataObject
) -> None:
    """And the rank, after every impact, K singular or not; undetermined errors move no gap."""
    hits = data.draw(
        st.lists(st.tuples(numbers(0.0, 2.0), st.integers(0, model.m - 1)), min_size=1, max_size=8)
    )
    wanted = stacked(model, hits)
    result = observability(model, impacts_of(model, hits))
    size = np.linalg.norm(wanted, 2)
    for k in range(len(hits)):
        values = np.linalg.svd(wanted[: k + 1], compute_uv=False)
        found = result.singular[k]
        np.testing.assert_allclose(found[: values.size], values, rtol=1e-8, atol=1e-10 * size)
        np.testing.assert_allclose(found[values.size :], 0.0, atol=1e-12 * size)
    few, many = (np.linalg.matrix_rank(wanted, tol=tol * size) for tol in (1e-8, 1e-10))
    assert few <= result.rank[-1] <= many
    assert len(result.undetermined) == 2 * model.n - result.rank[-1]
    if few == many:
        np.testing.assert_allclose(wanted @ result.undetermined.T, 0.0, atol=1e-5 * size)


@examples(12)
@given(systems(max_n=3, common_restitution=True, forced=False), st.data())
def test_rank_never_falls(model: System, data: st.DataObject) -> None:
    """Whatever follows: no singular value falls, and so no rank."""
    switch = st.tuples(st.sampled_from(model.contact_names), KINDS)
    steps = data.draw(st.lists(st.tuples(numbers(0.0, 2.0), switch), min_size=1, max_size=6))
    instants = np.cumsum([wait for wait, _ in steps])
    events = [event_at(t, one) for t, (_, one) in zip(instants, steps, strict=True)]
    try:
        found = observability(model, [*events, event_at(20.0, ("c1", Kind.IMPACT))])
    except ImpactLawError:  # contacts that depend on each other
        reject()
    fallen = np.diff(found.singular, axis=0).min(initial=0.0)
    assert fallen >= -1e-12 * found.singular.max()
    assert np.all(np.diff(found.rank) >= 0)
    assert np.all(np.isfinite(found.singular))


@examples(15)
@given(st.data())
def test_events_are_read_as_an_observer_reads_them(data: st.DataObject) -> None:
    """Missed and redundant openings, equal stamps, duplicates, any order of arrival."""
    model = system(
        np.eye(2), np.eye(2), np.eye(2), contacts=[([1, 0], 0.0, 0.5), ([0, 1], 0.0, 0.5)]
    )
    switch = st.tuples(st.sampled_from(["c1", "c2", "c3"]), KINDS)
    steps = data.draw(
        st.lists(st.tuples(st.integers(0, 3), st.lists(switch, max_size=3)), max_size=5)
    )
    events = [event_at(t, *some, sequence=k) for k, (t, some) in enumerate(steps, start=1)]
    events.append(event_at(4, ("c1", Kind.IMPACT), sequence=20))
    episode = last_episode(model, data.draw(st.permutations([*events, *events])))
    watcher = observer(model, "open-loop", np.zeros(4), epoch=EPOCH, ensemble=1)
    for each in events:
        watcher.receive(each)
    assert episode.start == watcher.start
    assert watcher.timeline is not None
    entries = watcher.timeline.entries[1:]
    assert [change.stamp for change in episode.changes] == [entry.key.stamp for entry in entries]
    assert [change.closed for change in episode.changes] == [e.closed for e in entries]
    assert episode.left_out == len(entries)


def test_impact_that_a_close_supersedes_adds_nothing() -> None:
    """Every figure is that of the CLOSE alone, to the last bit."""
    closing = event_at(1.0, ("c1", Kind.CLOSE), sequence=3)
    rest = [event(0.4, "c1", sequence=1), event(1.7, "c1", sequence=4)]
    plain = observability(DECOUPLED, [*rest, closing])
    found = observability(DECOUPLED, [*rest, event(1.0, "c1", sequence=2), closing])
    assert found.singular.tobytes() == plain.singular.tobytes()
    assert (found.stamps.tolist(), found.episode.left_out) == (plain.stamps.tolist(), 0)


@pytest.mark.parametrize(("name", "impacts"), [("two_mass", 4), ("three_mass", 6)])
def test_each_of_the_first_impacts_of_the_samples_raises_the_rank(name: str, impacts: int) -> None:
    """So 2n impacts determine the state."""
    found = of_sample(name, 30.0)
    assert found.complete == impacts - 1
    np.testing.assert_array_equal(found.rank[:impacts], np.arange(1, impacts + 1))
    assert found.condition[impacts - 2] == np.inf
    assert found.condition[-1] < 50
    assert found.determined == found.states
    assert found.undetermined.shape == (0, 2 * found.system.n)


@pytest.mark.parametrize("name", ["two_mass", "three_mass"])
def test_rows_solve_for_the_initial_state_of_a_plant(name: str) -> None:
    """A replica that starts at rest has gaps at the impacts; least squares give the plant's start.

    As well as the condition number and stamps of 1 ns allow.
    """
    model = sample(name)
    plant, n = model.system, model.system.n
    truth = np.concatenate(model.initial_state())
    episode = last_episode(plant, run(plant, truth[:n], truth[n:], seconds=30.0).events)
    errors, phase = RankRows(plant, np.ones(2 * n)), Phases(plant).phase()
    rows, gaps, x, t = [], [], np.zeros(2 * n), 0.0
    for change in episode.changes:
        x = phase.start(t, x).state(change.t - t)
        gaps.append(plant.gap(x[:n])[list(change.hit)])
        x, t = reset(plant, *change.hit) @ x, change.t
        rows.append(errors.cross(change))
    found = np.linalg.lstsq(np.vstack(rows), -np.concatenate(gaps), rcond=None)[0]
    np.testing.assert_allclose(found, truth, atol=1e-7)


def test_motion_of_stops_changes_no_row() -> None:
    """Differences of two motions do not contain it: impacts say as much as at a stop at rest.

    The ball's rows are those above a still floor: (1, t1) and (1, t1 - eps (t2 - t1)).
    """
    model = sample("ball_on_table").system
    found = observability(model, run(model, [0.02], [0.0], seconds=1.0).events)
    one, two = found.seconds[:2]
    assert found.singular[1].prod() == pytest.approx(0.5 * (two - one), rel=1e-12)
    np.testing.assert_array_equal(found.rank[:3], [1, 2, 2])


def test_state_of_a_decoupled_oscillator_without_a_stop_is_undetermined() -> None:
    """Its position and its velocity; the state of the other oscillator is determined."""
    hits = [(0.3 + 0.1 * k, 0) for k in range(12)]
    found = observability(DECOUPLED, impacts_of(DECOUPLED, hits))
    assert found.rank[-1] == 2
    assert found.complete is None
    np.testing.assert_array_equal(found.undetermined, [[0, 1, 0, 0], [0, 0, 0, 1]])
    assert found.determined == ("x1", "dx1/dt")
    assert np.all(np.isinf(found.condition))


def test_ball_is_determined_by_two_impacts() -> None:
    """Rows (1, t1) and (1, t1 - eps (t2 - t1)): the determinant is -eps (t2 - t1)."""
    found = of_sample("bouncing_ball", 3.0)
    one, two = found.seconds[:2]
    np.testing.assert_allclose(found.singular[0], [sqrt(1 + one**2), 0.0], atol=1e-15)
    assert found.singular[1].prod() == pytest.approx(0.9 * (two - one), rel=1e-12)
    np.testing.assert_array_equal(found.rank[:3], [1, 2, 2])


def test_orbit_whose_impacts_all_add_the_same_row() -> None:
    """``x'' + x = cos 2t``, x <= 0, eps 0.8: one impact a half period of the free oscillator.

    The rank stays 1, and a plant that starts elsewhere along the undetermined direction
    hits at the same instants, with other speeds.
    """
    model = system(
        1, 0, 1, contacts=[([-1], 0.0, 0.8)], force=forcing(1, 0, [Harmonic(2.0, [1.0], [0.0])])
    )
    start = np.array([-1 / 3 - 3 * sqrt(2), 3 * sqrt(2)])
    truth = run(model, start[:1], start[1:], seconds=60.0)
    found = observability(model, truth.events)
    np.testing.assert_allclose(found.seconds, pi / 4 + pi * np.arange(19), atol=1e-9)
    assert np.all(found.rank == 1)
    np.testing.assert_allclose(np.abs(found.undetermined), [[sqrt(0.5), sqrt(0.5)]], atol=1e-9)
    assert found.undetermined[0].prod() < 0 < found.undetermined[0].max()
    np.testing.assert_allclose(np.abs(found.remaining), [[0.0, 0.8**19]], atol=1e-9)
    other = start + 0.5 * found.undetermined[0]
    again = run(model, other[:1], other[1:], seconds=60.0)
    stamps = [[e.stamp for e in each.events] for each in (truth, again)]
    np.testing.assert_allclose(stamps[1], stamps[0], atol=3)
    assert np.abs(again.states[0] - truth.states[0]).max() > 0.3


def test_persistent_contact_adds_gap_speed_and_at_its_end_the_load() -> None:
    """Rank 2 by closing, 3 by opening; the undetermined error is the one found by hand.

    By hand: while closed, the second mass is an oscillator of its own, and pulls at the first.
    """
    model = pulled_mass(0.5).system
    first = exponential(model, 1.0)
    gap = np.append(model.W[:, 0], [0.0, 0.0])
    speed = np.append([0.0, 0.0], model.W[:, 0])
    pull = np.array([0.0, model.K[0, 1], 0.0, model.C[0, 1]])
    after = reset(model, 0) @ first
    A = np.array([[0, 1], [-model.K[1, 1], -model.C[1, 1]]]) / [[1], [model.M[1, 1]]]
    along = np.zeros((4, 4))
    along[np.ix_([1, 3], [1, 3])] = linalg.expm(A * 0.7)
    along = along @ after
    found = observability(
        model, [event_at(1.0, ("c1", Kind.CLOSE)), event_at(1.7, ("c1", Kind.OPEN))]
    )
    np.testing.assert_array_equal(found.rank, [2, 3])
    np.testing.assert_array_equal(found.released, [False, True])
    unknown = linalg.null_space(np.array([gap @ first, speed @ after, pull @ along]))
    np.testing.assert_allclose(np.abs(found.undetermined @ unknown), [[1.0]], rtol=1e-12)
    # An impact of a closed contact means a missed opening: it adds nothing.
    missed = [event_at(1.0, ("c1", Kind.CLOSE)), event_at(1.7, ("c1", Kind.IMPACT))]
    missed.append(event_at(2.1, ("c1", Kind.IMPACT)))
    found = observability(model, missed)
    np.testing.assert_array_equal(found.rank, [2, 2, 3])
    later = gap @ exponential(model, 0.4) @ reset(model, 0) @ along
    unknown = linalg.null_space(np.array([gap @ first, speed @ after, later]))
    np.testing.assert_allclose(np.abs(found.undetermined @ unknown), [[1.0]], rtol=1e-12)


def test_row_of_a_load_is_scaled_to_the_gap_that_it_closes_in_the_time_scale() -> None:
    """Two masses with a spring of stiffness k, one of them on its stop.

    Only the free mass' position is uncertain: the load is ``-k dq2``, the acceleration that it
    prevents ``-k dq2 / m1``.
    """
    m, k = 4.0, 3.0
    model = system(
        np.diag([m, 1.0]),
        np.zeros((2, 2)),
        k * np.array([[1.0, -1.0], [-1.0, 1.0]]),
        contacts=[([1, 0], 0.0, 0.5)],
    )
    events = [event_at(0.0, ("c1", Kind.CLOSE)), event_at(0.2, ("c1", Kind.OPEN))]
    found = observability(model, events, deviation=np.array([0.0, 1.0, 0.0, 0.0]))
    fastest = sqrt(k / m + k)
    wanted = k / m / fastest**2 * np.cos(sqrt(k) * 0.2)
    np.testing.assert_allclose(found.singular[:, 0], [0.0, wanted], rtol=1e-12, atol=1e-15)


def test_contacts_that_open_together_or_by_a_jump_of_the_force_add_nothing() -> None:
    """Their loads need not have come down to zero, or share it in an unknown way."""
    corner = system(
        np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=[([1, 0], 0.0, 0.5), ([1, 1], 0.0, 0.5)]
    )
    both = observability(
        corner,
        [
            event_at(1.0, ("c1", Kind.CLOSE), ("c2", Kind.CLOSE)),
            event_at(2.0, ("c1", Kind.OPEN), ("c2", Kind.OPEN)),
        ],
    )
    assert both.stamps.size == 1
    closed_then_open = [event_at(1.0, ("c1", Kind.CLOSE)), event_at(2.0, ("c1", Kind.OPEN))]
    found = {}
    for hold in ("previous", "linear"):
        samples = Samples(np.array([0.0, 9.0]), np.array([[0.0, 0.0], [1.0, 0.0]]), hold)
        force = Forcing(np.zeros(2), np.empty(0), np.empty((0, 2)), np.empty((0, 2)), samples)
        masses = system(
            np.eye(2),
            np.zeros((2, 2)),
            [[2, -1], [-1, 2]],
            contacts=[([1, 0], 0.0, 0.5)],
            force=force,
        )
        found[hold] = observability(masses, closed_then_open).rank.tolist()
    assert found == {"previous": [2], "linear": [2, 3]}


@pytest.mark.parametrize(("eps", "rank"), [(0.5, 2), (0.0, 1)])
def test_closing_without_restitution_adds_no_speed(eps: float, rank: int) -> None:
    """It is zero afterwards, whatever it was before."""
    model = pulled_mass(eps).system
    found = observability(model, [event_at(1.0, ("c1", Kind.CLOSE))])
    assert found.rank[-1] == rank
    np.testing.assert_allclose(model.W[:, 0] @ found.remaining[:, :2].T, 0.0, atol=1e-15)
    np.testing.assert_allclose(model.W[:, 0] @ found.remaining[:, 2:].T, 0.0, atol=1e-15)


def test_second_contact_adds_rows_while_the_first_is_closed() -> None:
    """Both of a corner's directions: closed in x, impacts in y."""
    model = system(
        np.eye(2),
        np.zeros((2, 2)),
        np.diag([1.0, 2.0]),
        contacts=[([1, 0], 0.0, 0.5), ([0, 1], 0.0, 0.5)],
    )
    found = observability(
        model,
        [
            event_at(0.5, ("c1", Kind.CLOSE)),
            event_at(1.0, ("c2", Kind.IMPACT)),
            event_at(1.6, ("c2", Kind.IMPACT)),
        ],
    )
    np.testing.assert_array_equal(found.rank, [2, 3, 4])
    assert found.contacts == (("c1",), ("c2",), ("c2",))


def test_two_stops_at_one_instant_add_two_rows() -> None:
    """The jump is that of both."""
    both = system(
        np.eye(2),
        np.zeros((2, 2)),
        np.eye(2),
        contacts=[([1, 0], 0.0, 0.5), ([0, 1], 0.0, 0.8)],
    )
    found = observability(both, [event(0.3, "c1", "c2"), event(0.8, "c1", "c2")])
    one_by_one = observability(
        both, [event(0.3, "c1"), event(0.3, "c2"), event(0.8, "c1"), event(0.8, "c2")]
    )
    np.testing.assert_array_equal(found.rank, [2, 4])
    np.testing.assert_allclose(found.singular[-1], one_by_one.singular[-1], rtol=1e-13)


def test_deviations_are_the_units_of_the_initial_state() -> None:
    """Columns of the matrix are scaled by them; certain states are no unknowns."""
    hits = [(0.4, 0), (0.5, 0), (0.9, 0)]
    deviation = np.array([0.1, 3.0, 2.0, 0.0])
    found = observability(DECOUPLED, impacts_of(DECOUPLED, hits), deviation=deviation)
    wanted = np.linalg.svd(stacked(DECOUPLED, hits) * deviation, compute_uv=False)
    assert found.size == 3
    np.testing.assert_allclose(found.singular[-1], wanted[:3], rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(found.undetermined, [[0, 3.0, 0, 0]])
    assert found.determined == ("x1", "dx1/dt")


def test_only_the_last_episode_of_the_last_epoch_counts() -> None:
    """As with an observer, which is reset by a new one."""
    model = DECOUPLED
    later = EPOCH + 100 * NS_PER_S
    events = [
        event(0.5, "c1", sequence=1),
        event(0.9, "c1", sequence=1, episode=1),
        event(100.3, "c1", sequence=1, episode=0, epoch=later),
        event(100.5, "c1", sequence=2, episode=0, epoch=later),
    ]
    found = observability(model, events)
    assert found.episode.episodes == 3
    assert found.episode.start == later
    np.testing.assert_allclose(found.seconds, [0.3, 0.5])


def test_recording_that_misses_its_beginning_starts_at_its_first_stamp() -> None:
    """So does one without an epoch; events before the epoch are left out."""
    late = observability(DECOUPLED, [event(3.0, "c1", sequence=7), event(3.5, "c1", sequence=8)])
    unknown = observability(DECOUPLED, [event(3.0, "c1", epoch=0), event(3.5, "c1", epoch=0)])
    for found in (late, unknown):
        assert seconds_between(EPOCH, found.episode.start) == 3.0
        np.testing.assert_array_equal(found.seconds, [0.0, 0.5])
        np.testing.assert_allclose(found.singular[0], [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    early = observability(DECOUPLED, [event(-1.0, "c1"), event(1.0, "c1")])
    assert early.episode.left_out == 1
    np.testing.assert_array_equal(early.seconds, [1.0])


def test_other_contacts_are_counted_and_own_ones_are_needed() -> None:
    """The error names both."""
    found = observability(DECOUPLED, [event(1.0, "c1", "bell"), event(2.0, "bell")])
    assert found.episode.foreign == {"bell": 2}
    assert found.stamps.size == 1
    with pytest.raises(BagError, match=r"contains no impact of the model's contacts \(c1\).*"):
        observability(DECOUPLED, [event(2.0, "bell")])
    with pytest.raises(BagError, match="none"):
        observability(DECOUPLED, [])
    with pytest.raises(BagError, match="c1"):
        observability(DECOUPLED, [event_at(1.0, ("c1", Kind.OPEN))])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tolerance": 1.0}, "tolerance: 1 found"),
        ({"tolerance": np.nan}, "tolerance: nan"),
        ({"deviation": 0.0}, "0 throughout"),
        ({"deviation": -1.0}, "expected 0 to 1e"),
        ({"deviation": np.ones(3)}, "3 numbers, expected 1 or 4"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options: dict[str, float], words: str) -> None:
    """By name, with what was found."""
    with pytest.raises(UsageError, match=words):
        observability(DECOUPLED, [event(1.0, "c1")], **options)  # type: ignore[arg-type]


def test_states_that_move_no_gap_have_rank_zero() -> None:
    """Rank 0 and finite figures."""
    found = observability(DECOUPLED, [event(1.0, "c1")], deviation=np.array([0.0, 1.0, 0.0, 1.0]))
    assert found.rank[-1] == 0
    np.testing.assert_allclose(found.singular, 0.0, atol=1e-300)
    np.testing.assert_array_equal(found.undetermined, [[0, 1, 0, 0], [0, 0, 0, 1]])
    assert found.determined == ()


def test_samples_add_rows_like_gaps() -> None:
    """Against a matrix stacked by hand: an encoder, and a speed in the model's time scale."""
    model = sample("two_mass").system
    whole = run(model, *sample("two_mass").initial_state(), seconds=3.0, rate=10.0)
    declared = (
        Measurement("x", "/x", "x1", "position", deviation=1.0),
        Measurement("v", "/v", "x1", "velocity", deviation=1.0),
    )
    stamps = [EPOCH + NS_PER_S // 10, EPOCH + NS_PER_S // 5]
    samples = [SensorSample(k, stamp, 0.0) for k, stamp in enumerate(stamps)]
    found = observability(
        model, whole.events[:1], sensors=sensors_of(declared, model), samples=samples
    )
    phases = Phases(model)
    transition = phases.phase().transition
    gap = np.concatenate([model.W[:, 0], [0.0, 0.0]])
    at = seconds_between(EPOCH, whole.events[0].stamp)
    rows = [
        transition(0.1)[0],
        phases.scales.timescale * transition(0.2)[2],
        gap @ transition(at),
    ]
    expected = np.linalg.svd(np.array(rows), compute_uv=False)
    np.testing.assert_allclose(found.singular[0][:3], expected, rtol=1e-9)
    assert found.rank[0] == 3
    assert found.samples == {"x": 1, "v": 1}
