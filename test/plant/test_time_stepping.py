# SPDX-License-Identifier: Apache-2.0
"""The time-stepping plant against closed forms and against the event-driven plant."""

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
import pytest
from contact_cases import resting_beads
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from systems import (
    EPOCH,
    Harmonic,
    chain,
    crossed,
    examples,
    forcing,
    sample,
    system,
    systems,
    vectors,
)

from impact_observer.dynamics.contact.moreau import MoreauScheme
from impact_observer.errors import UsageError
from impact_observer.events import Kind
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples
from impact_observer.plant import Plant, Switching, simulate
from impact_observer.plant.time_stepping import TimeSteppingPlant
from impact_observer.stamps import NS_PER_S, Instant, grid

Array = NDArray[np.float64]
STEPS = [8e-3, 4e-3, 2e-3]
"""Lengths of steps for orders of accuracy, s."""


def started(
    model: System, position: ArrayLike, velocity: ArrayLike, step: float, epoch: int = EPOCH
) -> TimeSteppingPlant:
    """A plant at ``EPOCH``."""
    q, u = np.asarray(position, float), np.asarray(velocity, float)
    return TimeSteppingPlant(model, q, u, epoch=epoch, step=step)


def times(switchings: Sequence[Switching]) -> Array:
    """Instants of switchings, s since the epoch."""
    return np.array([-each.instant.until(EPOCH) for each in switchings])


def kinds(switchings: Sequence[Switching]) -> list[list[tuple[str, Kind]]]:
    """Contacts and kinds of each switching."""
    return [[(switch.contact, switch.kind) for switch in each.switches] for each in switchings]


def end(plant: TimeSteppingPlant | Plant, seconds: float) -> Array:
    """The state after ``seconds``, shape (2n,), once all switchings before it are crossed."""
    return np.asarray(plant.states(np.array([plant.epoch + round(seconds * NS_PER_S)]))[0])


def orders(errors: Callable[[float], list[float]], steps: Sequence[float] = STEPS) -> Array:
    """How fast errors fall with the step: the slopes of lines through the logarithms."""
    found = [errors(step) for step in steps]
    return np.asarray(np.polyfit(np.log(steps), np.log(found), 1)[0])


def ball(eps: float) -> System:
    """A ball of 1 kg above a floor, m/s2 as on Earth."""
    return system(1, 0, 0, contacts=[([1], 0.0, eps)], force=forcing(1, -9.81))


@pytest.mark.slow
def test_ball_bounces_at_the_times_of_the_closed_form_to_first_order() -> None:
    """The mean error of ten impacts and the error of a state in flight."""
    first = np.sqrt(2 / 9.81)
    exact = first + np.concatenate([[0], np.cumsum(2 * first * 0.9 ** np.arange(1, 10))])
    top = exact[-1] + first * 0.9**10

    def errors(step: float) -> list[float]:
        plant = started(ball(0.9), [1.0], [0.0], step)
        found = crossed(plant, top)
        assert len(found) == 10
        assert step / 2 <= times(found)[0] - first <= 3 / 2 * step + 1e-9
        off = end(plant, top) - [0.9**20, 0.0]
        return [float(np.mean(np.abs(times(found) - exact))), float(np.linalg.norm(off))]

    late, off = orders(errors)
    assert late == pytest.approx(1.0, abs=0.25)
    assert off > 0.7
    assert errors(1e-3)[0] < 10e-3


@pytest.mark.parametrize(
    "eps",
    [pytest.param(0.0, marks=pytest.mark.slow), 0.5, pytest.param(0.8, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("step", [8e-3, 2e-3, pytest.param(5e-4, marks=pytest.mark.slow)])
def test_ball_comes_to_rest_where_its_impacts_accumulate(eps: float, step: float) -> None:
    """Its last event is CLOSE, to first order at the closed form; then it does not move."""
    first = np.sqrt(2 / 9.81)
    rest = first * (1 + eps) / (1 - eps)
    plant = started(ball(eps), [1.0], [0.0], step)
    found = crossed(plant, rest + 0.8)
    found_kinds = [kind for [(_, kind)] in kinds(found)]
    assert found_kinds == [Kind.IMPACT] * (len(found) - 1) + [Kind.CLOSE]
    assert plant.closed == (0,)
    assert abs(times(found)[-1] - rest) < 12 * step
    begin = EPOCH + round((rest + 0.8) * NS_PER_S)
    x = plant.states(grid(begin, begin + NS_PER_S, 10.0))
    assert np.max(np.abs(x[:, 0])) < step * np.sqrt(2 * 9.81)
    np.testing.assert_allclose(x[:, 1], 0.0, atol=1e-12)


@pytest.mark.slow
def test_pressed_mass_is_released_when_its_load_is_gone() -> None:
    """``x'' = 3 cos t - 2``: held until ``cos t = 2/3``, then in free motion."""
    force = forcing(1, 2.0, [Harmonic(1.0, [-3.0], [0])])
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=force)
    release = np.arccos(2 / 3)

    def motion(t: float) -> Array:
        s, sine = t - release, np.sin(release)
        speed = 2 * s - 3 * (np.sin(t) - sine)
        return np.array([s**2 + 3 * (np.cos(t) - 2 / 3) + 3 * sine * s, speed])

    def off(step: float) -> list[float]:
        plant = started(model, [0.0], [0.0], step)
        found = crossed(plant, 2.0)
        assert kinds(found) == [[("c1", Kind.CLOSE)], [("c1", Kind.OPEN)]]
        assert [each.contacts for each in found] == [(0,), ()]
        assert [each.closed for each in found] == [(0,), ()]
        assert times(found)[0] == pytest.approx(step)  # the end of the first step
        assert abs(times(found)[1] - release) <= step
        np.testing.assert_array_equal(found[1].before, found[1].after)
        return [float(np.linalg.norm(end(plant, 2.0) - motion(2.0)))]

    assert orders(off)[0] > 0.8
    assert off(1e-3)[0] < 2e-3


@pytest.mark.parametrize(
    ("name", "seconds", "impacts"),
    [("two_mass", 8, 5), pytest.param("three_mass", 10, 8, marks=pytest.mark.slow)],
)
def test_both_integrators_agree_to_first_order(name: str, seconds: float, impacts: int) -> None:
    """The same impacts in the same order; times and states converge to the event-driven ones."""
    model, start = sample(name).system, sample(name).initial_state()
    exact = Plant(model, *start, epoch=EPOCH)
    expected = crossed(exact, seconds)
    assert len(expected) == impacts

    def errors(step: float) -> list[float]:
        plant = TimeSteppingPlant(model, *start, epoch=EPOCH, step=step)
        found = crossed(plant, seconds)
        assert [each.contacts for each in found] == [each.contacts for each in expected]
        assert kinds(found) == kinds(expected)
        late = float(np.mean(np.abs(times(found) - times(expected))))
        assert late < 5 * step
        return [late, float(np.linalg.norm(end(plant, seconds) - end(exact, seconds)))]

    assert np.all(orders(errors) > 0.7)


def robust(runs: list[list[Switching]], model: System, until: float) -> int:
    """Number of switchings at the start of a run that small changes do not alter.

    Up to the first that differs for a nearby start (so nothing grazes), whose impact is slow, that
    nearly closes another contact too, or that is close to its neighbours in time. The neighbour of
    the last one of each run is not in it.
    """
    differences = np.diff(times(runs[0]), prepend=-1.0, append=until)
    for count, several in enumerate(zip(*(run[:9] for run in runs), strict=False)):
        one = several[0]
        gap, gamma = model.gap(one.before[: model.n]), model.contact_speed(one.before[model.n :])
        by_contact = {model.contact_names.index(each.contact): each.kind for each in one.switches}
        others = set(range(model.m)) - {*by_contact, *one.contacts, *one.closed}
        slow = any(gamma[i] > -0.1 for i, kind in by_contact.items() if kind is not Kind.OPEN)
        delicate = slow or any(gap[i] < 0.03 for i in others)
        same = all(kinds([each]) == kinds([one]) for each in several)
        if not same or delicate or min(differences[count : count + 2]) < 0.03:
            return count
    return min(len(run[:9]) for run in runs)


@pytest.mark.slow
def test_both_integrators_agree_on_random_systems() -> None:
    """Robust switchings, which are most of them, are the same and within some steps."""
    step, offset, counts = 2e-3, 5e-3, [0, 0]

    @examples(14)
    @given(st.data())
    def agree(data: st.DataObject) -> None:
        model = data.draw(systems(common_restitution=True, gaps=(0.0, 1.0), max_n=3))
        q, u = data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))
        assume(np.all(model.gap(q) > 0.05))
        starts = [(q + shift, u + shift) for shift in (0.0, offset, -offset)]
        runs = [
            [each for each in crossed(Plant(model, *start, epoch=EPOCH), 3.0, 10) if each.switches]
            for start in starts
        ]
        count = robust(runs, model, 3.0)
        one, *others = (times(each[:count]) for each in runs)
        found = crossed(started(model, q, u, step), 3.1, count)
        assert kinds(found) == kinds(runs[0][:count])
        sensitivity = np.max(np.abs(np.array(others) - one), initial=0.0) / offset
        assert np.all(np.abs(times(found) - one) < (4 + 20 * sensitivity) * step)
        counts[:] = [counts[0] + count, counts[1] + len(runs[0][:9])]

    agree()
    assert counts[0] > 15
    assert counts[0] > counts[1] / 4, counts


def test_symmetric_chain_hits_both_walls_at_once() -> None:
    """Simultaneous impacts are one switching, and the motion stays symmetric."""
    contacts = [([1, 0, 0, 0], 0.2, 0.9), ([0, 0, 0, -1], 0.2, 0.9), ([0, -1, 1, 0], 0.3, 0.9)]
    model = chain(4, damping=0.02, contacts=contacts)
    plant = started(model, [-0.1, 0.05, -0.05, 0.1], [-2.0, 1.0, -1.0, 2.0], 1e-3)
    found = crossed(plant, 3.0)
    assert {each.contacts for each in found} >= {(0, 1), (2,)}
    assert {each.contacts for each in found} <= {(0, 1), (2,), (0, 1, 2)}
    for each in found:
        np.testing.assert_allclose(each.after[:4], -each.after[3::-1], atol=1e-10)


def test_held_contact_takes_part_in_an_impact_without_a_switch() -> None:
    """A ball lies on the floor, a second one falls on it: one IMPACT, of their contact."""
    contacts = [([1, 0], 0.0, 0.5), ([-1, 1], 0.0, 0.5)]
    model = system(
        np.eye(2), np.zeros((2, 2)), np.zeros((2, 2)), contacts=contacts, force=forcing(2, -9.81)
    )
    first, second = crossed(started(model, [0.0, 1.0], [0.0, 0.0], 1e-3), 0.6)
    assert kinds([first, second]) == [[("c1", Kind.CLOSE)], [("c2", Kind.IMPACT)]]
    assert second.contacts == (0, 1)
    assert second.closed == (0,)


@pytest.mark.slow
def test_bodies_at_rest_on_each_other_stay_so() -> None:
    """Nine beads rest on a wall while a tenth bounces on them: no contact opens by rounding."""
    case = resting_beads()
    found = crossed(started(*case[:3], 1e-3), case.seconds)
    assert {kind for _, kind in kinds(found[:1])[0]} == {Kind.CLOSE}
    assert kinds(found[1:]) == [[("c10", Kind.IMPACT)]] * 4
    exact = crossed(Plant(*case[:3], epoch=EPOCH), case.seconds)
    np.testing.assert_allclose(times(found), times(exact), atol=4e-3)


@pytest.mark.slow
def test_gaps_are_violated_by_a_step_of_motion_at_most() -> None:
    """The body gets into its stop by up to ``h`` times its speed, which vanishes with ``h``."""
    model, start = sample("three_mass").system, sample("three_mass").initial_state()
    stamps = grid(EPOCH, EPOCH + 3 * NS_PER_S, 1000.0)
    for step in (8e-3, 2e-3, 5e-4):
        plant = cast("Plant", TimeSteppingPlant(model, *start, epoch=EPOCH, step=step))
        x = simulate(plant, stamps).states
        fastest = np.max(np.abs(x[:, 3:] @ model.W))
        assert np.min(x[:, :3] @ model.W + model.q_r) >= -step * fastest


@pytest.mark.slow
def test_states_at_the_ends_of_steps_are_the_schemes() -> None:
    """At impacts the state after them; positions are continuous, velocities from the left too."""
    model, start = sample("two_mass").system, sample("two_mass").initial_state()
    step = 2_000_003
    plant = TimeSteppingPlant(model, *start, epoch=EPOCH, step=step / NS_PER_S)
    scheme, (q, u) = MoreauScheme(model, step / NS_PER_S), start
    crossings = 0
    for k in range(1500):
        stamp = EPOCH + k * step
        if (switching := plant.next_switching(stamp)) is not None:
            crossings += 1
            assert switching.instant == Instant(stamp)
            left = plant.states(np.array([stamp - 1]))[0]
            np.testing.assert_allclose(left, switching.before, atol=1e-7)
            plant.cross(switching)
            np.testing.assert_array_equal(switching.after, np.concatenate([q, u]))
        np.testing.assert_allclose(
            plant.states(np.array([stamp]))[0], np.concatenate([q, u]), rtol=0, atol=1e-15
        )
        done = scheme.step(k, q, u)
        q, u = done.q, done.u
    assert crossings == 2


def test_states_within_a_step_are_of_second_order() -> None:
    """Sampled between the ends of steps, without contact."""
    plain = chain(2, damping=0.2, force=forcing(2, 1.0, [Harmonic(3.0, [1, 0], [0, 2])]))
    exact = Plant(plain, np.array([0.1, 0.2]), np.array([1.0, -1.0]), epoch=EPOCH)
    stamps = grid(EPOCH, EPOCH + NS_PER_S, 777.0)

    def off(step: float) -> list[float]:
        plant = started(plain, [0.1, 0.2], [1.0, -1.0], step)
        return [float(np.max(np.abs(plant.states(stamps) - exact.states(stamps))))]

    assert orders(off, [2e-2, 1e-2, 5e-3])[0] == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_states_do_not_depend_on_when_they_are_requested() -> None:
    """One by one, backwards or all at once, with or without a prediction: the same bits."""
    model, start = sample("three_mass").system, sample("three_mass").initial_state()
    stamps = grid(EPOCH, EPOCH + NS_PER_S, 333.0)
    plant = TimeSteppingPlant(model, *start, epoch=EPOCH, step=1e-3)
    once = plant.states(stamps)
    plant.next_switching(int(stamps[-1]))
    backwards = [plant.states(np.array([stamp]))[0] for stamp in stamps[::-20]]
    np.testing.assert_array_equal(backwards, once[::-20])
    np.testing.assert_array_equal(plant.states(np.array([EPOCH - 5])), once[:1])


def test_switchings_do_not_depend_on_when_they_are_requested() -> None:
    """A node that asks every few milliseconds and a run that asks once get the same."""
    once = crossed(started(ball(0.5), [0.2], [0.0], 1e-3), 1.5)
    plant, often = started(ball(0.5), [0.2], [0.0], 1e-3), []
    for limit in grid(EPOCH, EPOCH + round(1.5 * NS_PER_S), 300.0).tolist():
        while (switching := plant.next_switching(limit)) is not None:
            assert plant.next_switching(limit) is switching
            assert plant.next_switching(switching.instant.stamp - 1) is None
            assert switching.instant.stamp <= limit
            plant.cross(switching)
            often.append(switching)
    assert [each.instant for each in often] == [each.instant for each in once]
    assert kinds(often) == kinds(once)
    for one, two in zip(once, often, strict=True):
        np.testing.assert_array_equal(one.after, two.after)


@pytest.mark.slow
def test_steps_are_whole_nanoseconds_from_the_epoch() -> None:
    """No step of a third of a millisecond drifts, nor does the epoch matter."""
    late = 1_700_000_000_123_456_789
    runs = []
    for epoch in (EPOCH, late):
        plant = started(ball(0.9), [1.0], [0.0], 1e-3 / 3, epoch)
        assert plant.step == 333_333
        runs.append(crossed(plant, 2.5))
    for one, two in zip(*runs, strict=True):
        assert (one.instant.stamp - EPOCH) % 333_333 == 0
        assert one.instant.remainder == 0
        assert two.instant.stamp - late == one.instant.stamp - EPOCH
        np.testing.assert_array_equal(one.after, two.after)


@pytest.mark.parametrize(
    ("position", "velocity", "step", "message"),
    [
        ([-0.1], [0.0], 1e-3, "position: is inside the stop 'c1' .gap -0.1.; expected gap >= 0"),
        ([1.0, 2.0], [0.0], 1e-3, "position: 2 values, expected 1"),
        ([1.0], [np.nan], 1e-3, "velocity: .* is not finite"),
        ([1.0], [0.0], 0.0, "step: is 0 s; expected at least 1e-09 s"),
        ([1.0], [0.0], -1e-3, "step: is -0.001 s; expected at least 1e-09 s"),
        ([1.0], [0.0], 4e-10, "step: is 4e-10 s; expected at least 1e-09 s"),
        ([1.0], [0.0], np.nan, "step: is nan s; expected at least 1e-09 s"),
        ([1.0], [0.0], np.inf, "step: is inf s; expected at least 1e-09 s"),
    ],
)
def test_invalid_start_is_one_line(
    position: list[float], velocity: list[float], step: float, message: str
) -> None:
    """It names the argument, what was found, what is expected."""
    with pytest.raises(UsageError, match=message) as caught:
        started(ball(0.9), position, velocity, step)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("step", [1e-2, 3e-3])
def test_run_goes_on_after_its_recorded_force(step: float) -> None:
    """A force that is recorded for a second; then its last value is held."""
    samples = Samples(np.array([0.0, 0.5, 1.0]), np.array([[1.0], [0.0], [2.0]]), "linear")
    model = system(1, 0.1, 1, contacts=[([1], 5.0, 0.5)], force=Forcing.of_samples(samples))
    exact = Plant(model, np.zeros(1), np.ones(1), epoch=EPOCH)
    plant = started(model, [0.0], [1.0], step)
    assert crossed(plant, 3.0) == []
    for t in (1.0, 3.0):
        np.testing.assert_allclose(end(plant, t), end(exact, t), atol=step)


def test_impact_that_opens_a_held_contact_is_one_switching() -> None:
    """Two coupled coordinates: an impulse on the second lifts the first off its stop."""
    contacts = [([1, 0], 0.0, 0.5), ([0, 1], 1.0, 0.5)]
    model = system(
        [[1, -0.5], [-0.5, 1]],
        np.zeros((2, 2)),
        np.zeros((2, 2)),
        contacts=contacts,
        force=forcing(2, [-1.0, 0.0]),
    )
    first, second = crossed(started(model, [0.0, 0.0], [0.0, -1.0], 1e-3), 1.5)
    assert kinds([first]) == [[("c1", Kind.CLOSE)]]
    assert kinds([second]) == [[("c1", Kind.OPEN), ("c2", Kind.IMPACT)]]
    assert (first.contacts, first.closed, first.held) == ((0,), (0,), (0,))
    assert (second.contacts, second.closed, second.held) == ((0, 1), (), ())
    assert times([second])[0] == pytest.approx(1.0, abs=2e-3)
    np.testing.assert_allclose(second.after[2:], [0.75, 0.5], atol=5e-3)
