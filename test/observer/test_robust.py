# SPDX-License-Identifier: Apache-2.0
"""Faulty sensors: the error that is left in the end, and the covariance in between."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import (
    EPOCH,
    PRESSED,
    Harmonic,
    estimates,
    event,
    forcing,
    observer,
    run,
    sample,
    system,
)

from impact_observer.dynamics import lyapunov
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Remark, Ruling, Verdict
from impact_observer.model import System
from impact_observer.observer import Observer, make_observer
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.observer.synchronization import AGREED
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, SensorMessage, SensorModel, simulate, simulate_sensor
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
PERIODS = round(8 * 2 * np.pi / 2.5 * NS_PER_S)
"""Eight periods of the force on two_mass, ns."""
EXACT: dict[str, Any] = {"clock_error": 0.0}
UNDECLARED: dict[str, Any] = {"clock_error": None}
LATE: dict[str, Any] = {"clock_error": 0.0, "clock_offset_error": 0.02}


@cache
def truth(name: str, seconds: float) -> tuple[System, Array, Run]:
    """A system by its name, where its plant starts, and what it does."""
    if name == "pressed":
        model, start = PRESSED, (np.zeros(2), np.zeros(2))
    else:
        found = sample(name)
        model, start = found.system, found.initial_state()
    return model, np.concatenate(start), run(model, *start, seconds=seconds, rate=20.0)


def reported(
    name: str, seconds: float, sensor: SensorModel, seed: int = 0
) -> tuple[SensorMessage, ...]:
    """The events that a sensor with faults reports."""
    model, _, whole = truth(name, seconds)
    last = int(whole.stamps[-1])
    return simulate_sensor(sensor, model, whole.switchings, epoch=EPOCH, last=last, seed=seed)


def watching(model: System, x: Array, declared: dict[str, Any], **options: int) -> Observer:
    """An observer that begins at ``x``."""
    uncertainty = Uncertainty(**declared)
    return observer(
        model, "minimum-variance", x, uncertainty=uncertainty, epoch=EPOCH, history=1e4, **options
    )


def squared(model: System, error: Array) -> float:
    """Of an error (dq, du), J."""
    return float(lyapunov.distance(model, *np.split(error, 2)))


def beside(whole: Run, seconds: float) -> list[int]:
    """Indices of samples that are farther than ``seconds`` from any impact."""
    impacts = np.array([each.instant.stamp for each in whole.impacts])
    near = np.min(np.abs(whole.stamps[:, None] - impacts), axis=1)
    return [int(k) for k in np.flatnonzero(near > seconds * NS_PER_S)]


def left(
    name: str, seconds: float, sensor: SensorModel, declared: dict[str, Any], seed: int
) -> float:
    """V at the end over V at the start."""
    model, start, whole = truth(name, seconds)
    x = start + np.random.default_rng(seed).normal(size=start.size)
    watcher = watching(model, x, declared)
    for each in reported(name, seconds, sensor, seed):
        watcher.receive(each.event)
    k = beside(whole, 0.02)[-1]
    error = estimates(watcher, whole.stamps[[k]])[0] - whole.states[k]
    return squared(model, error) / squared(model, x - start)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "sensor", "declared", "bound"),
    [
        ("two_mass", SensorModel(missed=0.2), EXACT, 1e-14),
        ("two_mass", SensorModel(spurious=0.15), EXACT, 1e-14),
        ("two_mass", SensorModel(missed=0.2, spurious=0.15), EXACT, 1e-14),
        ("two_mass", SensorModel(delay=0.01), LATE, 1e-10),
        ("two_mass", SensorModel(jitter=1e-3), UNDECLARED, 1e-3),
        ("two_mass", SensorModel(quantisation=1e-3), UNDECLARED, 1e-6),
        ("two_mass", SensorModel(dead_time=0.6), EXACT, 1e-11),
        ("three_mass", SensorModel(mislabelled=0.1), EXACT, 1e-14),
    ],
    ids=["missed", "spurious", "both", "late", "jitter", "ticks", "dead time", "mislabelled"],
)
def test_faulty_sensor_costs_little(
    name: str, sensor: SensorModel, declared: dict[str, Any], bound: float
) -> None:
    """After 24 s, from a start that is wrong by about 1 in every number."""
    assert left(name, 24.0, sensor, declared, seed=1) < bound


def closed_at(whole: Run, stamp: int) -> tuple[str, ...]:
    """Contacts of a plant that are closed, as an ideal sensor reports them."""
    closed: set[str] = set()
    for each in whole.events:
        if each.stamp <= stamp:
            for switch in each.switches:
                (closed.add if switch.kind is Kind.CLOSE else closed.discard)(switch.contact)
    return tuple(sorted(closed))


@pytest.mark.slow
def test_unreported_persistent_contact_is_inserted() -> None:
    """The sensor reports impacts only: every CLOSE and OPEN is inserted."""
    model, _, whole = truth("pressed", 7.0)
    kinds = {switch.kind for each in whole.events for switch in each.switches}
    assert kinds == set(Kind)
    watcher = watching(model, np.random.default_rng(0).normal(size=4), EXACT)
    for each in reported("pressed", 7.0, SensorModel(impacts_only=True)):
        watcher.receive(each.event)
    until = int(np.searchsorted(whole.stamps, EPOCH + 4 * NS_PER_S))
    stamps = whole.stamps[30:until]
    differences = estimates(watcher, stamps) - whole.states[30:until]
    assert np.max(np.abs(differences)) < 1e-7
    resting = [closed_at(whole, stamp) for stamp in stamps.tolist()]
    closed = [watcher.estimate(stamp).closed for stamp in stamps.tolist()]
    assert closed == resting


def locked(count: int, *spurious: float, **uncertainty: float) -> Observer:
    """An observer of two_mass after ``count`` impacts and some spurious events."""
    model, start, whole = truth("two_mass", 30.0)
    watcher = watching(model, start + np.random.default_rng(0).normal(size=4), EXACT | uncertainty)
    for each in whole.events[:count]:
        watcher.receive(each)
    for seconds in spurious:
        (verdict,) = watcher.receive(event(seconds, "stop", sequence=count + 1))
        assert verdict.ruling is Ruling.REJECTED
    return watcher


@pytest.mark.parametrize(
    "spurious",
    [(), pytest.param((17.829,), marks=pytest.mark.slow)],
    ids=["no event", "after a spurious one"],
)
def test_missed_impact_is_inserted_before_the_next_event(spurious: tuple[float, ...]) -> None:
    """The impacts at 18.2 s and 20.1 s; V is small 1 ms and half a second later."""
    model, _, whole = truth("two_mass", 30.0)
    watcher, missed = locked(13, *spurious), [each.stamp for each in whole.events[13:15]]
    plant = run(model, *sample("two_mass").initial_state(), seconds=20.5, rate=1000.0)
    for stamp in (*missed, missed[0] + NS_PER_S // 2):
        k = int(np.searchsorted(plant.stamps, stamp + NS_PER_S // 1000))
        now = watcher.estimate(int(plant.stamps[k]))
        differences = np.concatenate([now.q, now.u]) - plant.states[k]
        assert np.max(np.abs(differences)) < 1e-8
        deviations = np.sqrt(np.diag(now.covariance))
        assert np.all(np.abs(differences) <= 5 * deviations + 1e-13)
        if not spurious:
            assert np.max(deviations) < 1e-7


def between_stops() -> tuple[System, Run]:
    """Four masses in a row, each between two stops, and what they do in 21 s."""
    way, n = np.arange(1, 5) / 10, 4
    sides = [(-sign * np.eye(n)[i], way[i], 0.6) for i in range(n) for sign in (1, -1)]
    row = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    row[-1, -1] = 1.0
    push = forcing(n, 0.0, [Harmonic(2.5, [0.0, 10.0, 0, 0], [0.0] * n)])
    model = system(np.eye(n), 0.1 * row, 10 * row, contacts=sides, force=push)
    return model, run(model, np.zeros(n), np.zeros(n), seconds=21.0, rate=1000.0)


def far_off(
    watcher: Observer, whole: Run, events: Sequence[ImpactEvent]
) -> list[tuple[bool, bool]]:
    """Whether each estimate after 20 s errs by more than ten deviations, and is synchronized."""
    waiting, found = deque(sorted(events, key=lambda each: each.stamp)), []
    for k in (k for k in beside(whole, 0.0015) if whole.stamps[k] > EPOCH + 20 * NS_PER_S):
        while waiting and waiting[0].stamp <= whole.stamps[k]:
            watcher.receive(waiting.popleft())
        now = watcher.estimate(int(whole.stamps[k]))
        error = np.concatenate([now.q, now.u]) - whole.states[k]
        off = np.max(np.abs(error) / (np.sqrt(np.diag(now.covariance)) + 1e-9)) > 10
        found.append((bool(off), now.synchronized))
    return found


@pytest.mark.long
def test_masses_without_springs_do_not_come_to_rest_in_a_corner() -> None:
    """Where all gaps are zero, and any event fits. Every fifth impact is missed, with jitter."""
    free = system(
        np.diag([1.0, 3.0]),
        np.zeros((2, 2)),
        np.zeros((2, 2)),
        contacts=[([1, 0], 1.0, 1.0), ([0, -1], 1.0, 1.0), ([-1, 1], 0.5, 1.0)],
    )
    whole = run(free, [-0.2, 0.1], [1.0, -0.37], seconds=60.0, rate=20.0)
    sensor, shares = SensorModel(missed=0.2, jitter=3e-4), []
    for seed in range(4):
        messages = simulate_sensor(
            sensor, free, whole.switchings, epoch=EPOCH, last=int(whole.stamps[-1]), seed=seed
        )
        options = Options("minimum-variance", f"random:{seed}", epoch=EPOCH, history=1e4)
        found = far_off(make_observer(free, options), whole, [each.event for each in messages])
        shares.append(np.mean([off for off, _ in found]))
    assert np.mean(shares) < 0.05


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 3])
def test_a_motion_that_no_impact_shows_does_not_run_away(seed: int) -> None:
    """All masses together. The covariance is widened often, the estimate stays near the motion."""
    n = 5
    stops = [(-np.eye(n)[i] + np.eye(n)[i + 1], 0.01, 0.5) for i in range(n - 1)]
    ends = [np.eye(n)[0], 0.65 * np.eye(n)[-1]]
    waves = [Harmonic(w, [*2 * each], [0.0] * n) for w, each in zip((2.5, 3.7), ends, strict=True)]
    model = system(
        np.eye(n), 0.05 * np.eye(n), 10 * np.eye(n), contacts=stops, force=forcing(n, 0.0, waves)
    )
    whole = run(model, -0.5 * np.eye(n)[0], np.zeros(n), seconds=20.0, rate=20.0)
    messages = simulate_sensor(
        SensorModel(missed=0.1, spurious=0.1),
        model,
        whole.switchings,
        epoch=EPOCH,
        last=int(whole.stamps[-1]),
        seed=seed,
    )
    watcher = make_observer(model, Options("minimum-variance", "zero", epoch=EPOCH, history=1e4))
    for each in sorted((each.event for each in messages), key=lambda each: each.stamp):
        watcher.receive(each)
    off = []
    for stamp, x in zip(whole.stamps[100:], whole.states[100:], strict=True):
        now = watcher.estimate(int(stamp))
        error = np.abs(np.concatenate([now.q, now.u]) - x)
        off.append(np.max(error / (np.sqrt(np.diag(now.covariance)) + 1e-3)) > 10)
    assert np.mean(off) < 0.1


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rig_of_half_a_millimetre_is_followed_from_a_start_that_is_off_by_a_metre(
    seed: int,
) -> None:
    """What counts as slow follows from the motion, not from what was declared of the start."""
    model, start, _ = truth("two_mass", 60.0)
    (stop,) = model.contacts
    tiny = replace(
        model,
        contacts=(replace(stop, gap=1e-3 * stop.gap),),
        forcing=forcing(2, [0, 0], [Harmonic(2.5, [0, 4e-3], [0, 0])]),
    )
    whole = run(tiny, *np.split(1e-3 * start, 2), seconds=60.0, rate=20.0)
    sensor = SensorModel(missed=0.2, spurious=0.5, jitter=3e-4)
    messages = simulate_sensor(
        sensor, tiny, whole.switchings, epoch=EPOCH, last=int(whole.stamps[-1]), seed=seed
    )
    options = Options("minimum-variance", f"random:{seed}", epoch=EPOCH, history=1e4)
    watcher = make_observer(tiny, options)
    for each in sorted((each.event for each in messages), key=lambda each: each.stamp):
        watcher.receive(each)
    k = beside(whole, 0.0015)[-1]
    found = watcher.estimate(int(whole.stamps[k]))
    error = np.concatenate([found.q, found.u]) - whole.states[k]
    assert np.max(np.abs(error)) < 3e-6  # of 1e-3 m
    exact = make_observer(tiny, options)
    for event_ in whole.events:
        exact.receive(event_)
    assert exact.estimate(int(whole.stamps[-1])).synchronized


@pytest.mark.long
def test_impacts_of_two_contacts_that_are_missed_come_in_their_order() -> None:
    """Closer to each other than the samples in which gaps are searched."""
    model, whole = between_stops()
    stamps = [each.stamp for each in whole.events]
    close = [i for i in range(60, len(stamps) - 2) if stamps[i + 1] - stamps[i] < NS_PER_S // 25]
    for i in close:
        watcher = watching(model, np.zeros(8), EXACT, ensemble=10)
        for each in whole.events[:i]:
            watcher.receive(each)
        k = int(np.searchsorted(whole.stamps, (stamps[i + 1] + stamps[i + 2]) // 2))
        assert watcher.estimate(stamps[i] - 1).synchronized
        found = estimates(watcher, whole.stamps[[k]])[0]
        np.testing.assert_allclose(found, whole.states[k], atol=1e-6)
    assert len(close) > 5


def test_a_silence_with_more_missed_impacts_than_are_inserted_is_not_synchronized() -> None:
    """From then on deviations are as large as the motion, however long it lasts."""
    model, start, whole = truth("two_mass", 30.0)
    watcher, size = (
        watching(model, start, EXACT, ensemble=10),
        np.max(np.abs(whole.states), axis=0),
    )
    for each in whole.events[:13]:
        watcher.receive(each)
    assert watcher.estimate(whole.events[14].stamp).synchronized
    for seconds in (40, 100, 1e4, 1e6):
        now = watcher.estimate(EPOCH + round(seconds * NS_PER_S))
        assert not now.synchronized
        assert np.all(np.sqrt(np.diag(now.covariance)) > size / 2)
        assert watcher.obstacle(now.stamp)


@pytest.mark.long
def test_a_jump_of_the_clock_by_an_hour_is_soon_found_hopeless() -> None:
    """The hour is silence, and after three events the estimate is wide."""
    watcher, hour = locked(13), 3600.0
    assert watcher.silence(EPOCH + round(hour * NS_PER_S))
    assert watcher.estimate(EPOCH + round(hour * NS_PER_S)).misfit
    for k in range(3):
        watcher.receive(event(hour + 2 * k, "stop", sequence=14 + k))
    assert not watcher.estimate(EPOCH + round((hour + 5) * NS_PER_S)).synchronized


def recovered(watcher: Observer, whole: Run, events: Sequence[ImpactEvent]) -> list[Verdict]:
    """The verdicts up to a correct estimate, which must come within 2n + 2 events."""
    verdicts: list[Verdict] = []
    for each in events[: 2 * watcher.system.n + 2]:
        verdicts += watcher.receive(each)
        k = int(np.searchsorted(whole.stamps, each.stamp + 1))
        error = estimates(watcher, whole.stamps[[k]])[0] - whole.states[k]
        if np.max(np.abs(error)) < 1e-5:
            return verdicts
    pytest.fail("it is not right in the end")


def explained(verdicts: Sequence[Verdict]) -> bool:
    """Whether a reason names a widened covariance or a restarted filter."""
    words = ("accepted: the covariance is made", "restart: the estimate before it is rejected")
    return any(word in each.reason for each in verdicts for word in words)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_wrong_start_with_tiny_deviation_is_corrected(seed: int) -> None:
    """An error of 1 with a declared deviation of 1e-6; a verdict has the reason."""
    model, start, whole = truth("two_mass", 30.0)
    x = start + np.random.default_rng(seed).normal(size=4)
    watcher = watching(model, x, {**EXACT, "deviation": 1e-6})
    assert explained(recovered(watcher, whole, whole.events))


@pytest.mark.parametrize(
    ("seed", "pause"),
    [(0, 1), *(pytest.param(*each, marks=pytest.mark.long) for each in ((1, 1), (0, 60)))],
)
def test_estimate_converges_again_after_the_plant_was_disturbed(seed: int, pause: int) -> None:
    """The state of the plant jumps after the estimate has converged; the pause may be long.

    In a long one so many impacts may have been missed that not all hypotheses can be followed.
    """
    model, start, whole = truth("two_mass", 30.0)
    state = np.random.default_rng(seed).normal(size=(2, 2)) * [[0.3], [2.0]]
    kicked = run(model, *state, seconds=16.0, rate=20.0)
    since = pause * PERIODS
    later = replace(kicked, stamps=kicked.stamps + since)
    before = [each for each in whole.events if each.stamp < EPOCH + PERIODS]
    after = [
        replace(each, stamp=each.stamp + since, sequence=len(before) + k + 1)
        for k, each in enumerate(kicked.events)
    ]
    watcher = watching(model, start + np.random.default_rng(0).normal(size=4), EXACT)
    for each in before:
        assert all(verdict.ruling is Ruling.APPLIED for verdict in watcher.receive(each))
    assert explained(recovered(watcher, later, after))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_wrong_set_state_with_tiny_deviation_is_corrected(seed: int) -> None:
    """``set_state`` with a deviation of 1e-6 after the estimate has converged."""
    _, _, whole = truth("two_mass", 30.0)
    watcher = locked(10)
    position, velocity = 0.7 * np.random.default_rng(seed).normal(size=(2, 2))
    since, covariance = whole.events[9].stamp + 1000, 1e-12 * np.eye(4)
    watcher.set_state(since, position, velocity, covariance)
    assert explained(recovered(watcher, whole, whole.events[10:]))


def learning(sensor: SensorModel, declared: dict[str, Any], seed: int = 0) -> tuple[Observer, int]:
    """An observer of two_mass after 24 s, and the last stamp."""
    model, start, whole = truth("two_mass", 24.0)
    watcher = watching(model, start + np.random.default_rng(seed).normal(size=4), declared)
    for each in reported("two_mass", 24.0, sensor, seed):
        watcher.receive(each.event)
    return watcher, int(whole.stamps[-1])


@pytest.mark.slow
@pytest.mark.parametrize("error", [1e-6])
def test_clock_error_is_estimated(error: float) -> None:
    """Within a factor of 3.5."""
    watcher, end = learning(SensorModel(jitter=error), UNDECLARED, seed=1)
    name, found, deviation = watcher.estimate(end).parameters[0]
    assert name == "clock_error"
    assert 1 / 3.5 < found / error < 3.5
    assert deviation < 3 * error


@pytest.mark.long
@pytest.mark.parametrize("error", [3e-5, 3e-4, 5e-4])
def test_jitter_is_not_taken_for_an_error_of_the_model(error: float) -> None:
    """Of a drill that hits twelve times a second, whatever the jitter is between two rungs.

    Stamps are described by a rung near theirs; accelerations miss little.
    """
    drill = system(
        np.diag([3.0, 0.8]),
        [[34.0, -4.0], [-4.0, 4.0]],
        [[12000.0, -4000.0], [-4000.0, 4000.0]],
        contacts=[([0, -1], 0.004, 0.6)],
        force=forcing(2, 0.0, [Harmonic(75.398, [60.0, 0.0], [0.0, 0.0])]),
    )
    whole = run(drill, np.zeros(2), np.zeros(2), seconds=8.0, rate=20.0)
    last, watcher = int(whole.stamps[-1]), watching(drill, np.zeros(4), UNDECLARED)
    sensor = SensorModel(jitter=error)
    for each in simulate_sensor(sensor, drill, whole.switchings, epoch=EPOCH, last=last, seed=5):
        watcher.receive(each.event)
    learned = {name: found for name, found, _ in watcher.estimate(last).parameters}
    assert 1 / 4 < learned["clock_error"] / error < 4
    assert learned["relative model error"] < 0.02


@pytest.mark.parametrize(
    ("delay", "jitter", "seed"),
    [
        (-0.03, 0.0, 1),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((0.01, 0.0, 0), (0.02, 1e-4, 1))
        ),
    ],
)
def test_clock_offset_is_estimated(delay: float, jitter: float, seed: int) -> None:
    """Within four of its small deviations; its message has the same value."""
    pytest.importorskip("rosbags")
    from impact_observer.io.messages import bag_messages, read_estimate

    sensor = SensorModel(clock_offset=delay, jitter=jitter)
    watcher, end = learning(sensor, {"clock_error": jitter, "clock_offset_error": 0.03}, seed)
    last = watcher.estimate(end)
    name, value, deviation = last.parameters[-1]
    assert name == "clock_offset"
    assert value == last.clock_offset
    assert abs(value - delay) <= 4 * deviation
    assert deviation < (1e-2 if jitter else 1e-7)
    names, back = read_estimate(bag_messages().estimate(last, ("x1", "x2")))
    assert names == ("x1", "x2")
    assert (back.clock_offset, back.parameters) == (last.clock_offset, last.parameters)


def test_offset_is_refused_where_no_force_depends_on_time() -> None:
    """In one line, with the reason and the remedy."""
    with pytest.raises(UsageError, match=r"no force depends on time.*leave it out") as refused:
        MinimumVariance(sample("bouncing_ball").system, Uncertainty(**LATE))
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith("clock_offset_error: ")


def never_wrong(name: str, sensor: SensorModel, declared: dict[str, Any], seed: int) -> int:
    """How often ``synchronized`` was true; asserts that V was below its threshold each time."""
    model, start, whole = truth(name, 24.0)
    x = start + np.random.default_rng(seed).normal(size=start.size)
    events = reported(name, 24.0, sensor, seed)
    watcher, came, done = watching(model, x, declared, ensemble=10), 0, 0
    for k in beside(whole, 0.02)[::4]:
        stamp = int(whole.stamps[k])
        while done < len(events) and events[done].arrival <= stamp:
            watcher.receive(events[done].event)
            done += 1
        now = watcher.estimate(stamp)
        if now.synchronized:
            then = watcher.estimate(now.last_event)
            differences = np.concatenate([now.q, now.u]) - whole.states[k]
            assert squared(model, differences) <= AGREED * squared(
                model, np.concatenate([then.q, then.u])
            )
            came += 1
    return came


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "declared"),
    [
        (SensorModel(missed=0.2, spurious=0.15), EXACT),
        (SensorModel(jitter=1e-3), UNDECLARED),
        (SensorModel(delay=0.01), LATE),
    ],
    ids=["both", "jitter", "late"],
)
def test_synchronized_is_never_wrong(sensor: SensorModel, declared: dict[str, Any]) -> None:
    """With missed, spurious, late and jittered events."""
    assert never_wrong("two_mass", sensor, declared, seed=1) > 0


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4])
def test_echoes_of_most_hits_do_not_end_synchronization(seed: int) -> None:
    """Seven of ten hits are reported again, 5 to 50 ms later: four in five samples have it."""
    model, _, whole = truth("two_mass", 40.0)
    rng, events = np.random.default_rng(seed), reported("two_mass", 40.0, SensorModel())
    sent = [(each.event.stamp, each.event.switches[0]) for each in events]
    for stamp, hit in [*sent]:
        if rng.random() < 0.7:
            sent.append((stamp + round(rng.uniform(5e-3, 5e-2) * NS_PER_S), hit))
    watcher = make_observer(model, Options(law="minimum-variance", epoch=EPOCH))
    later, flags, k = deque(sorted(sent)), [], 0
    for stamp in whole.stamps[whole.stamps.size // 4 :].tolist():
        while later and later[0][0] <= stamp:
            (at, hit), k = later.popleft(), k + 1
            watcher.receive(ImpactEvent(at, (hit,), k, 1, EPOCH))
        flags.append(watcher.estimate(stamp).synchronized)
    assert np.mean(flags) > 0.8


def test_ideal_sensor_causes_no_revision_after_convergence() -> None:
    """Nothing is rejected, inserted or revised after the first 2n + 2 events."""
    watcher = locked(6)
    before = watcher.remarks[Remark.REVISED]
    for each in truth("two_mass", 30.0)[2].events[6:]:
        (verdict,) = watcher.receive(each)
        assert (verdict.ruling, verdict.reason) == (Ruling.APPLIED, "")
    assert watcher.remarks[Remark.REVISED] == before


def test_chattering_is_followed_however_late_after_the_epoch() -> None:
    """Impacts accumulate to nanoseconds: no event is rejected, and nothing is inserted.

    The force has a period of 1 s, so a plant that starts ten minutes late moves as one does at
    first.
    """
    harmonic = Harmonic(2 * np.pi, [20.0], [0.0])
    model = system(1, 1, 20, contacts=[([-1], 0.05, 0.3)], force=forcing(1, 8.0, [harmonic]))
    start, late = np.array([0.03, 0.3]), EPOCH + 600 * NS_PER_S
    plant = Plant(model, start[:1], start[1:], epoch=late)
    whole = simulate(plant, np.array([late + NS_PER_S]))
    assert len(whole.events) == 14
    watcher = watching(model, np.zeros(2), UNDECLARED)
    watcher.set_state(late, start[:1], start[1:], 1e-12 * np.eye(2))
    for each in whole.events:
        (verdict,) = watcher.receive(replace(each, epoch=EPOCH, sequence=1 + each.sequence))
        assert (verdict.ruling, verdict.reason) == (Ruling.APPLIED, "")
    np.testing.assert_allclose(estimates(watcher, whole.stamps), whole.states, atol=1e-9)


@pytest.mark.parametrize(("clock_error", "wait"), [(0.0, 0.007), (0.0, 0.06)])
def test_a_rejection_has_the_innovation_of_its_event(clock_error: float, wait: float) -> None:
    """As of a switch that bounces."""
    _, _, whole = truth("two_mass", 30.0)
    last = (whole.events[12].stamp - EPOCH) / NS_PER_S
    watcher = locked(13, clock_error=clock_error)
    (verdict,) = watcher.receive(event(last + wait, "stop", sequence=14))
    assert verdict.ruling is Ruling.REJECTED
    assert verdict.innovation > 100
