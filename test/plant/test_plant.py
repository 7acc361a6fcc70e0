"""The plant against published numbers, closed forms and its own conservation laws."""

import contextlib

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from scipy import linalg
from systems import (
    EPOCH,
    Harmonic,
    chain,
    examples,
    forcing,
    run,
    sample,
    system,
    systems,
    vectors,
)

from impact_observer.dynamics import flow_of
from impact_observer.errors import (
    DynamicsError,
    ImpactLawError,
    LastingContactError,
    UsageError,
)
from impact_observer.events import ImpactEvent, Switch
from impact_observer.model import System
from impact_observer.plant import Impact, Plant, simulate
from impact_observer.stamps import NS_PER_S, Instant, grid

Array = NDArray[np.float64]


def seconds(impact: Impact) -> float:
    """The instant of an impact since the epoch, s."""
    return -impact.instant.until(EPOCH)


def approach(model: System, impact: Impact) -> float:
    """``gamma-`` of the first contact."""
    return float(model.contact_speed(impact.before[model.n :])[impact.contacts[0]])


def started(model: System, position: ArrayLike, velocity: ArrayLike) -> Plant:
    """A plant at ``EPOCH``."""
    return Plant(model, np.asarray(position, float), np.asarray(velocity, float), epoch=EPOCH)


def crossed(plant: Plant, count: int) -> list[Impact]:
    """The next ``count`` impacts."""
    impacts = []
    for _ in range(count):
        impact = plant.next_impact(EPOCH + 1000 * NS_PER_S)
        assert impact is not None
        plant.cross(impact)
        impacts.append(impact)
    return impacts


def test_ball_bounces_at_the_published_times() -> None:
    """Eps 0.9 from 1 m: closed form of every impact, published for the first three."""
    model = sample("bouncing_ball").system
    times = [seconds(impact) for impact in crossed(started(model, [1.0], [0.0]), 60)]
    published = [0.4515236409857308, 1.264266194760045, 1.995734493156927]
    np.testing.assert_allclose(times[:3], published, rtol=0, atol=1e-14)
    first = np.sqrt(2 / 9.81)
    flights = 2 * first * 0.9 ** np.arange(1, 60)
    np.testing.assert_allclose(
        times, first + np.concatenate([[0], np.cumsum(flights)]), atol=1e-12
    )


def test_accumulating_impacts_are_one_line_with_contact_and_time() -> None:
    """The ball comes to rest at 8.578949178728887 s; just before, the plant says so."""
    model = sample("bouncing_ball").system
    with pytest.raises(LastingContactError) as caught:
        run(model, [1.0], [0.0], seconds=20.0)
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    assert "'floor'" in line
    told = float(line.split("t = ")[1].split(" s", maxsplit=1)[0])
    assert 8.578949178728887 - 1e-6 < told <= 8.578949178728887


def test_run_that_ends_before_the_impacts_accumulate_is_whole() -> None:
    """Nothing is refused before it happens, however far the plant looks ahead."""
    assert len(run(sample("bouncing_ball").system, [1.0], [0.0], seconds=8.0).impacts) == 26


def test_impact_without_restitution_is_one_line_with_contact_and_time() -> None:
    """Eps = 0 closes the contact for good where the load presses."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.0)], force=forcing(1, -9.81))
    with pytest.raises(LastingContactError, match=r"'c1'.* stamp 5\.451523641 s \(t = 0\.4515236"):
        run(model, [1.0], [0.0], seconds=1.0)


def test_impact_without_restitution_goes_on_where_the_load_pulls() -> None:
    """A body that is stopped where its spring pulls it away leaves again."""
    model = system(1, 0, 1, contacts=[([1], 0.5, 0.0)])
    impacts = run(model, [1.0], [0.0], seconds=10.0).impacts
    assert len(impacts) == 1
    assert impacts[0].after[1] == pytest.approx(0.0, abs=1e-15)


def test_lasting_contact_from_the_start_is_one_line() -> None:
    """A ball that lies on the floor is told when the plant is made."""
    with pytest.raises(LastingContactError, match=r"'floor'.*at stamp 5\.000000000 s"):
        started(sample("bouncing_ball").system, [0.0], [0.0])


def test_siconos_oscillator_hits_at_the_published_times() -> None:
    """LinearOscillatorED: m 1e-3, k 100, gravity, eps 0.9, a stop in the rest position."""
    model = system(1e-3, 0, 100, contacts=[([1], 0.0, 0.9)], force=forcing(1, -9.81e-3))
    impacts = run(model, [1.0], [0.0], seconds=0.0345).impacts
    published = [0.004966983943888618, 0.01490088290077536, 0.02483470526778414]
    np.testing.assert_allclose([seconds(i) for i in impacts[:3]], published, rtol=0, atol=1e-15)
    assert approach(model, impacts[0]) == pytest.approx(-316.2587864392096, rel=1e-14)


def test_siconos_ball_between_floor_and_ceiling_hits_at_the_published_times() -> None:
    """Two contacts in turn: ceiling, floor, ceiling."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.8), ([-1], 1.5, 0.8)], force=forcing(1, -10.0))
    impacts = run(model, [1.0], [10.0], seconds=0.6).impacts
    published = [0.0513167019494863, 0.2283187800528825, 0.4665486160195453]
    np.testing.assert_allclose([seconds(i) for i in impacts[:3]], published, rtol=0, atol=1e-14)
    assert [impact.contacts for impact in impacts[:3]] == [(1,), (0,), (1,)]


def test_exact_orbit_stays_for_ten_periods() -> None:
    """``x'' + x = cos 2t``, ``x <= 0``: one impact a period, at phase pi/2, with speed 20/3."""
    # The stop is above: gamma- is -20/3. The orbit is stable (eps^2 < 1).
    model = system(
        1, 0, 1, contacts=[([-1], 0.0, 0.8)], force=forcing(1, 0, [Harmonic(2.0, [1], [0])])
    )
    # x = -cos(2t)/3 + a cos t + b sin t hits x = 0 at t0 = pi/4 (2 t0 = pi/2) with speed 20/3.
    t0 = np.pi / 4
    for speed in (20 / 3,):
        # After the impact: x = 0, x' = -0.8 * speed; flow to the epoch of the next phase start.
        flow = flow_of(model).start(t0, np.array([0.0, -0.8 * speed]))
        begin = np.pi - t0
        position, velocity = flow.state(begin)
        plant = started(model, [position], [velocity])
        impacts = crossed(plant, 10)
        # The epoch is at t = pi = 0 (mod pi): impacts at t0 + k pi.
        expected = t0 + np.pi * np.arange(10)
        np.testing.assert_allclose([seconds(i) for i in impacts], expected, atol=1e-12)
        for impact in impacts:
            assert approach(model, impact) == pytest.approx(-20 / 3, abs=1e-11)


def coco() -> System:
    """COCO's example 15.2: k 1, c 0.1, cos t, gap 1, eps 0.8."""
    return system(
        1, 0.1, 1, contacts=[([-1], 1.0, 0.8)], force=forcing(1, 0, [Harmonic(1.0, [1], [0])])
    )


def test_coco_orbit_returns_after_one_period() -> None:
    """Started on the published orbit, the impact comes back to its phase and speed."""
    model = coco()
    phase, speed = 0.07595216493832649, 1.695732937594892
    motion = flow_of(model).start(phase, np.array([1.0, -0.8 * speed]))
    x = motion.state(2 * np.pi - phase)
    impact = crossed(started(model, [x[0]], [x[1]]), 1)[0]
    assert seconds(impact) == pytest.approx(phase, abs=1e-10)
    assert -approach(model, impact) == pytest.approx(speed, abs=1e-10)


def energy(model: System, states: Array) -> Array:
    """Kinetic and elastic energy and that of constant forces, shape (samples,)."""
    q, u = states[:, : model.n], states[:, model.n :]
    kinetic, elastic = ((x @ form * x).sum(axis=1) / 2 for x, form in ((u, model.M), (q, model.K)))
    return np.asarray(kinetic + elastic - q @ model.forcing.constant)


def test_energy_is_conserved_without_damping_and_with_full_restitution() -> None:
    """Hundreds of impacts of a chain between two walls."""
    contacts = [([1, 0, 0], 0.2, 1.0), ([0, 0, -1], 0.3, 1.0), ([0, -1, 1], 0.1, 1.0)]
    model = chain(3, damping=0.0, contacts=contacts, force=forcing(3, [0.3, 0, -0.2]))
    found = run(model, [0.0, 0.1, 0.05], [2.0, -3.0, 1.0], seconds=60.0)
    assert len(found.impacts) > 250
    total = energy(model, found.states)
    np.testing.assert_allclose(total, total[0], rtol=1e-11)


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


@examples(25)
@given(st.data())
def test_gaps_never_close_beyond_rounding(data: st.DataObject) -> None:
    """``g >= -1e-10`` along random runs, at and between impacts; each impact obeys its law."""
    model = data.draw(systems(gaps=(0.0, 2.0)))
    x = np.concatenate([data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))])
    assume(np.all(model.gap(x[: model.n]) > 0))
    plant, stamps = started(model, *np.split(x, 2)), grid(EPOCH, EPOCH + 4 * NS_PER_S, 200.0)
    impacts: list[Impact] = []
    states, last = [], EPOCH - 1
    # As far as it goes: random systems may end in lasting contact.
    with contextlib.suppress(LastingContactError, ImpactLawError):
        while len(impacts) < 20:
            impact = plant.next_impact(int(stamps[-1]))
            until = int(stamps[-1]) if impact is None else impact.instant.stamp
            phase = stamps[(stamps > last) & (stamps <= until)]
            states.append(plant.states(phase[phase < until] if impact else phase))
            if impact is None:
                break
            plant.cross(impact)
            impacts.append(impact)
            last = until - 1
    for part in states:
        gaps = part[:, : model.n] @ model.W + model.q_r
        assert np.min(gaps, initial=0.0) >= -1e-10
    for impact in impacts:
        closed = list(impact.contacts)
        gaps = model.gap(impact.before[: model.n])
        assert np.max(np.abs(gaps[closed])) < 1e-10
        assert np.min(gaps) >= -1e-10
        np.testing.assert_array_equal(impact.before[: model.n], impact.after[: model.n])
        before, after = (
            model.contact_speed(v[model.n :])[closed] for v in (impact.before, impact.after)
        )
        assert np.all(after + model.eps[closed] * before >= -1e-9 * (1 + np.abs(before).max()))


def test_sample_at_an_impacts_stamp_is_after_it() -> None:
    """Whether the true instant was rounded up or down."""
    model = sample("bouncing_ball").system
    plant = started(model, [1.0], [0.0])
    remainders = []
    for _ in range(12):
        impact = plant.next_impact(EPOCH + 10 * NS_PER_S)
        assert impact is not None
        plant.cross(impact)
        remainders.append(impact.instant.remainder)
        at = plant.states(np.array([impact.instant.stamp]))[0]
        assert at[1] == pytest.approx(impact.after[1], abs=1e-8)
        assert at[1] > 0
        assert at[0] >= -1e-15
    assert min(remainders) < 0 < max(remainders)


def test_run_samples_an_impacts_stamp_after_it() -> None:
    """The same through a whole run, with the impact's stamp on the grid."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    found = run(model, [1.0], [-1.0], seconds=2.0, rate=2.0)
    np.testing.assert_allclose(found.states[:, 1], [-1, -1, 0.5, 0.5, 0.5], atol=1e-15)
    np.testing.assert_allclose(found.states[:, 0], [1, 0.5, 0, 0.25, 0.5], atol=1e-15)
    assert found.events == (ImpactEvent(EPOCH + NS_PER_S, (Switch("c1"),), 1, 0, EPOCH),)


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


def test_impacts_do_not_depend_on_who_asks_when() -> None:
    """A node that asks every millisecond and a run that asks once get the same bits."""
    model, start = sample("three_mass").system, sample("three_mass").initial_state()
    once = run(model, *start, seconds=8.0).impacts
    plant, often = Plant(model, *start, epoch=EPOCH), []
    for limit in grid(EPOCH, EPOCH + 8 * NS_PER_S, 1000.0).tolist():
        while (impact := plant.next_impact(limit)) is not None:
            assert plant.next_impact(limit) is impact
            plant.cross(impact)
            often.append(impact)
    assert [i.instant for i in often] == [i.instant for i in once]
    for one, two in zip(once, often, strict=True):
        np.testing.assert_array_equal(one.after, two.after)


def test_impact_is_told_only_up_to_the_limit() -> None:
    """Its own stamp is inside, one nanosecond less is not."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    plant = started(model, [1.0], [-1.0])
    assert plant.next_impact(EPOCH + NS_PER_S - 1) is None
    assert plant.next_impact(EPOCH + NS_PER_S) is not None


def test_plant_that_starts_at_a_stop_hits_it_at_once() -> None:
    """A closed gap that is still closing is an impact at the epoch."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    found = run(model, [0.0], [-1.0], seconds=1.0)
    assert [seconds(impact) for impact in found.impacts] == [0.0]
    assert found.states[0].tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("position", "velocity", "message"),
    [
        ([-0.1], [0.0], "position: is inside the stop 'floor' .gap -0.1.; expected gap >= 0"),
        ([1.0, 2.0], [0.0], "position: 2 values, expected 1"),
        ([1.0], [np.nan], "velocity: .* is not finite"),
    ],
)
def test_impossible_start_is_refused(
    position: list[float], velocity: list[float], message: str
) -> None:
    """One line that names what is wrong."""
    with pytest.raises(UsageError, match=message):
        started(sample("bouncing_ball").system, position, velocity)


def test_impact_without_a_solution_names_its_stamp() -> None:
    """Two stops that depend on each other with unequal restitution, hit together."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.8), ([-1], 0.0, 0.5)])
    plant = started(model, [0.0], [-1.0])
    with pytest.raises(DynamicsError, match=r"at 5\.000000000 s: contacts 'c1', 'c2'"):
        plant.next_impact(EPOCH)


def test_run_without_samples_is_empty() -> None:
    """No stamps, no states, no impacts; a run without contact has no events."""
    nothing = simulate(started(chain(2), [0.1, 0.0], [0.0, 0.0]), np.empty(0, dtype=np.int64))
    assert nothing.states.shape == (0, 4)
    free = run(chain(2), [0.1, 0.0], [0.0, 0.0], seconds=2.0)
    assert free.events == ()
    expected = linalg.expm(
        2.0 * np.block([[np.zeros((2, 2)), np.eye(2)], [-chain(2).K, -chain(2).C]])
    )
    np.testing.assert_allclose(free.states[-1], expected @ [0.1, 0, 0, 0], atol=1e-13)


def test_progress_is_told_of_every_impact() -> None:
    """For a bar that a command shows."""
    told: list[int] = []
    plant = started(sample("bouncing_ball").system, [1.0], [0.0])
    found = simulate(plant, grid(EPOCH, EPOCH + 3 * NS_PER_S, 10.0), progress=told.append)
    assert told == [impact.instant.stamp for impact in found.impacts]
