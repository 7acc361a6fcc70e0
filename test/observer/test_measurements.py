# SPDX-License-Identifier: Apache-2.0
"""Samples of sensors beside the impacts, in every law."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg
from systems import EPOCH, Harmonic, forcing, run, sample, system, without_faults

from impact_observer.events import ImpactEvent, MeasurementVerdict
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.observer import Observer, law_named
from impact_observer.observer.samples import MOST_KEPT, SensorSample
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
LAW = "minimum-variance"
EXACT_STAMPS = without_faults(deviation=0.3)


def encoder(joint: str = "x1", **others: object) -> Measurement:
    """A sensor of a coordinate, with 1 mm of noise unless ``others`` say more."""
    given = {"joint": joint, "quantity": "position", "deviation": 1e-3, **others}
    return Measurement(str(given.pop("name", joint)), "/encoder", **given)  # type: ignore[arg-type]


def watcher(
    model: System, law: str, x: Array, sensors: Sequence[Measurement], **options: object
) -> Observer:
    """An observer that starts at ``x`` at the epoch, of events without faults unless declared."""
    declared = options.pop("uncertainty", EXACT_STAMPS)
    assert isinstance(declared, Uncertainty)
    start = np.split(np.asarray(x, float), 2)
    options = {"ensemble": 3, "epoch": EPOCH, **options}
    return Observer(
        model,
        law_named(law)(model, declared),
        *start,
        measurements=sensors,
        **options,  # type: ignore[arg-type]
    )


def at(seconds: float) -> int:
    """A stamp, ns."""
    return EPOCH + round(seconds * NS_PER_S)


def x_of(observer: Observer, stamp: int) -> Array:
    """The estimate (q, u)."""
    estimate = observer.estimate(stamp)
    return np.concatenate([estimate.q, estimate.u])


@cache
def truth(name: str, seconds: float, rate: float = 50.0) -> tuple[System, Run]:
    """A sample model, and what its plant does."""
    model = sample(name)
    whole = run(model.system, *model.initial_state(), seconds=seconds, rate=rate)
    return model.system, whole


def measured(whole: Run, rows: Array, noise: float, seed: int = 1) -> list[SensorSample]:
    """Samples of functions ``rows x`` of all states but the first, shape (sensors, 2n)."""
    rng = np.random.default_rng(seed)
    values = whole.states @ rows.T
    values += noise * rng.normal(size=values.shape)
    return [
        SensorSample(k, int(stamp), float(value))
        for stamp, each in zip(whole.stamps[1:], values[1:], strict=True)
        for k, value in enumerate(each)
    ]


def fed(
    observer: Observer, events: Sequence[ImpactEvent], samples: Sequence[SensorSample]
) -> None:
    """Give everything in order of stamps, events first."""
    both = [*((e.stamp, 0, e) for e in events), *((s.stamp, 1, s) for s in samples)]
    for _, kind, each in sorted(both, key=lambda item: item[:2]):
        if kind:
            observer.measure([each])  # type: ignore[list-item]
        else:
            observer.receive(each)  # type: ignore[arg-type]


def free(n: int = 2) -> System:
    """A driven chain without stops."""
    springs = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return system(
        np.diag(np.arange(1.0, n + 1)),
        0.1 * springs,
        20 * springs,
        force=forcing(n, 0.5, [Harmonic(3.0, n * [1.0], n * [0.0])]),
    )


def flow_of(model: System, s: float) -> tuple[Array, Callable[[float], Array]]:
    """The transition over ``s`` seconds of a chain without stops, and what forces add from t on.

    By a matrix exponential of the state, a constant and pairs that turn with the drives.
    """
    n, omegas = model.n, model.forcing.frequency.tolist()
    inverse, first = np.linalg.inv(model.M), 2 * model.n + 1
    A = np.zeros((first + 2 * len(omegas), first + 2 * len(omegas)))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n, : 2 * n] = -inverse @ np.hstack([model.K, model.C])
    A[n : 2 * n, 2 * n] = inverse @ model.forcing.constant
    for k, omega in enumerate(omegas):
        cos, sin = first + 2 * k, first + 2 * k + 1
        A[n : 2 * n, cos] = inverse @ model.forcing.cosine[k]
        A[n : 2 * n, sin] = inverse @ model.forcing.sine[k]
        A[cos, sin], A[sin, cos] = -omega, omega
    whole = linalg.expm(A * s)

    def forced(t: float) -> Array:
        pairs = [f(omega * t) for omega in omegas for f in (math.cos, math.sin)]
        return np.asarray(whole[: 2 * n, 2 * n :] @ np.array([1.0, *pairs]))

    return whole[: 2 * n, : 2 * n], forced


@pytest.mark.parametrize("declared", [EXACT_STAMPS, Uncertainty(deviation=0.3, model_error=0.0)])
def test_between_impacts_it_is_the_textbook_kalman_filter(declared: Uncertainty) -> None:
    """Positions, speeds and accelerations, with covariance, to 1e-10; one filter or a bank."""
    model, step = free(), 0.013
    n, inverse = model.n, np.linalg.inv(model.M)
    sensors = [
        encoder(),
        encoder("x2", name="speed", quantity="velocity", deviation=0.05, offset=0.2),
        Measurement("imu", "/imu", field="a", acceleration={"x1": 2.0}, deviation=0.4),
    ]
    lower = -inverse @ np.hstack([model.K, model.C])
    H = np.vstack([np.eye(2 * n)[0], np.eye(2 * n)[n + 1], 2 * lower[0]])
    R, x, P = [1e-6, 0.05**2, 0.4**2], np.array([0.1, -0.2, 0.3, 0.5]), 0.09 * np.eye(2 * n)
    observer = watcher(model, LAW, x, sensors, uncertainty=declared)
    Phi, forced = flow_of(model, step)
    rng = np.random.default_rng(4)
    for k in range(40):
        t = k * step
        x, P = Phi @ x + forced(t), Phi @ P @ Phi.T
        forces = model.forcing.constant + model.forcing.cosine[0] * math.cos(3.0 * (t + step))
        rests = [0.0, 0.2, 2 * (inverse @ forces)[0]]
        for i, (h, r, rest) in enumerate(zip(H, R, rests, strict=True)):
            y = float(h @ x + rest + rng.normal() * math.sqrt(h @ P @ h + r))
            observer.measure([SensorSample(i, at(t + step), y)])
            gain = P @ h / (h @ P @ h + r)
            x = x + gain * (y - h @ x - rest)
            P = (np.eye(2 * n) - np.outer(gain, h)) @ P
        estimate = observer.estimate(at(t + step))
        np.testing.assert_allclose(np.append(estimate.q, estimate.u), x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(estimate.covariance, P, rtol=1e-8, atol=1e-12)
    assert all(each.accepted for each in observer.samples.take())


def dense(
    model: System,
    events: Sequence[ImpactEvent],
    x0: Array,
    samples: Sequence[SensorSample],
    rows: Array,
) -> Array:
    """The state just after the last of ``events`` by one dense least-squares problem.

    The unknown is the initial state. All flights are matrix exponentials, impacts are Newton's law
    at their stamps, an impact is a row of its gap.
    """
    n, lhs, rhs = model.n, [np.eye(2 * model.n) / 0.3], [x0 / 0.3]
    Phi, c, now = np.eye(2 * n), np.zeros(2 * n), EPOCH
    marks = [(e.stamp, 0, e) for e in events] + [(s.stamp, 1, s) for s in samples]
    for stamp, kind, each in sorted(marks, key=lambda mark: mark[:2]):
        if stamp > now:
            map_, forced = flow_of(model, (stamp - now) / NS_PER_S)
            Phi, c = map_ @ Phi, map_ @ c + forced((now - EPOCH) / NS_PER_S)
            now = stamp
        if kind:
            lhs.append(rows[each.sensor : each.sensor + 1] @ Phi / 1e-3)  # type: ignore[union-attr]
            rhs.append((each.value - rows[each.sensor] @ c)[None] / 1e-3)  # type: ignore[union-attr]
            continue
        i = model.contact_names.index(each.switches[0].contact)  # type: ignore[union-attr]
        w = np.append(model.W[:, i], np.zeros(n))
        lhs.append(1e9 * w[None] @ Phi)
        rhs.append(-1e9 * (w @ c + model.q_r[i])[None])
        kick = np.linalg.solve(model.M, model.W[:, i])
        kick *= (1 + model.eps[i]) / float(model.W[:, i] @ kick)
        jump = np.eye(2 * n)
        jump[n:, n:] -= np.outer(kick, model.W[:, i])
        Phi, c = jump @ Phi, jump @ c
    found = np.linalg.lstsq(np.vstack(lhs), np.concatenate(rhs), rcond=None)[0]
    return np.asarray(Phi @ found + c)


@pytest.mark.parametrize("name", ["two_mass", "three_mass"])
def test_at_every_impact_it_is_the_dense_least_squares_solution(name: str) -> None:
    """Exact stamps, an encoder and a speed; the state after each impact to 1e-9."""
    model, whole = truth(name, 6.0)
    n = model.n
    rows = np.eye(2 * n)[[0, n]]
    sensors = [encoder(), encoder(name="speed", quantity="velocity")]
    samples = measured(whole, rows, 1e-3)
    x0 = whole.states[0] + 0.2 * np.random.default_rng(7).normal(size=2 * n)
    impacts = [each.stamp for each in whole.events]
    assert len(impacts) >= 3
    for stamp in impacts:
        observer = watcher(model, LAW, x0, sensors)
        early = [each for each in samples if each.stamp < stamp]
        events = [e for e in whole.events if e.stamp <= stamp]
        fed(observer, events, early)
        expected = dense(model, events, x0, early, rows)
        np.testing.assert_allclose(x_of(observer, stamp), expected, rtol=0, atol=1e-9)


def rig(law: str, **options: object) -> tuple[Observer, list[ImpactEvent], list[SensorSample]]:
    """An observer of three_mass with two sensors, and what they and the stops report."""
    model, whole = truth("three_mass", 5.0, rate=40.0)
    n = model.n
    x0 = whole.states[0] + 0.2 * np.random.default_rng(5).normal(size=2 * n)
    sensors = [encoder(), encoder("x3", name="speed", quantity="velocity", deviation=0.02)]
    samples = measured(whole, np.eye(2 * n)[[0, n + 2]], 1e-3)
    return watcher(model, law, x0, sensors, **options), list(whole.events), samples


def test_the_order_of_arrival_does_not_change_a_bit() -> None:
    """Everything late, one by one or together, and events after the samples that follow them."""
    one, events, samples = rig(LAW)
    fed(one, events, samples)
    other, *_ = rig(LAW)
    draw = np.random.default_rng(2)
    waiting: list[SensorSample] = []
    late = sorted(events, key=lambda e: e.stamp + int(draw.integers(0, NS_PER_S // 5)))
    for each in sorted(samples, key=lambda s: s.stamp + int(draw.integers(0, NS_PER_S // 20))):
        while late and late[0].stamp < each.stamp:
            other.receive(late.pop(0))
        waiting.append(each)
        if draw.random() < 0.5:
            other.measure(waiting)
            waiting = []
    other.measure(waiting)
    for event_ in late:
        other.receive(event_)
    for stamp in (at(1.01), at(3.3), at(5.0)):
        first, second = one.estimate(stamp), other.estimate(stamp)
        assert first.q.tobytes() == second.q.tobytes()
        assert first.u.tobytes() == second.u.tobytes()
        assert first.covariance.tobytes() == second.covariance.tobytes()
        assert first.last_event == second.last_event


def test_a_late_impact_acts_before_the_samples_after_it() -> None:
    """An impact that arrives after seven later samples gives the estimate of the true order."""
    model, whole = truth("two_mass", 3.0)
    samples = measured(whole, np.eye(4)[:1], 1e-3)
    first = whole.events[0]
    before = [each for each in samples if each.stamp < first.stamp]
    upto = samples[: len(before) + 7]
    observer = watcher(model, LAW, whole.states[0], [encoder()])
    fed(observer, [], upto)
    observer.receive(first)
    same = watcher(model, LAW, whole.states[0], [encoder()])
    fed(same, [first], upto)
    stamp = upto[-1].stamp
    np.testing.assert_array_equal(x_of(observer, stamp), x_of(same, stamp))


def test_an_event_is_the_last_one_whatever_is_measured_after_it() -> None:
    """``last_event`` and ``last_sequence`` are those of events, late counts only events."""
    observer, events, samples = rig(LAW)
    first = events[0]
    fed(observer, [], [each for each in samples if each.stamp <= first.stamp + NS_PER_S // 10])
    assert observer.last_event == 0
    (verdict,) = observer.receive(first)
    assert "late" not in verdict.reason
    estimate = observer.estimate(samples[-1].stamp)
    assert (estimate.last_event, estimate.last_sequence) == (first.stamp, first.sequence)
    assert observer.last_event == first.stamp


def verdicts_of(observer: Observer) -> dict[str, list[MeasurementVerdict]]:
    """The verdicts on samples so far, by sensor."""
    found = sorted(observer.samples.take(), key=lambda each: each.name)
    groups = itertools.groupby(found, key=lambda each: each.name)
    return {name: list(each) for name, each in groups}


def test_what_cannot_be_used_has_a_reason_and_changes_nothing() -> None:
    """No number, twice the same stamp, too late, and nothing else is lost."""
    observer, events, samples = rig(LAW, history=1.0)
    fed(observer, events, samples)
    before = x_of(observer, at(5.0))
    verdicts_of(observer)
    wrong = [
        samples[-2]._replace(value=math.nan),
        samples[-2]._replace(value=7.0),
        SensorSample(0, at(0.5), 0.0),
        SensorSample(0, 1, 0.0),
    ]
    for each in wrong:
        observer.measure([each])
    reasons = [each.reason for each in observer.samples.take()]
    assert reasons[0] == "nan found; expected a number of at most 1e+09"
    assert reasons[1] == "the sensor has another sample of the same stamp"
    assert reasons[2].startswith("too late: before 9.")
    assert reasons[3].startswith("too late: before 9.")
    np.testing.assert_array_equal(x_of(observer, at(5.0)), before)


def test_the_gate_rejects_an_outlier_and_says_by_how_much() -> None:
    """One sample that is wrong by 1 m, after the estimate is good."""
    observer, events, samples = rig(LAW)
    fed(observer, events, samples)
    verdicts_of(observer)
    before = x_of(observer, at(5.01))
    observer.measure([SensorSample(0, at(5.01), before[0] + 1.0)])
    (verdict,) = observer.samples.take()
    assert not verdict.accepted
    assert verdict.reason.startswith("gate: ")
    assert verdict.innovation == pytest.approx(1.0, abs=1e-9)
    assert 500 < verdict.normalized <= 1000.1
    np.testing.assert_array_equal(x_of(observer, at(5.01)), before)
    assert observer.samples.counts[0]["rejected"] == 1


def test_blanking_leaves_out_what_follows_an_impact() -> None:
    """So long after its stamp; the motion goes on as if there had been no sample."""
    model, whole = truth("two_mass", 4.0)
    sensor = encoder(blanking=0.05)
    stamp = whole.events[0].stamp
    for after, used in ((0.049, False), (0.051, True)):
        observer = watcher(model, LAW, whole.states[0], [sensor])
        observer.receive(whole.events[0])
        before = x_of(observer, stamp + NS_PER_S)
        observer.measure([SensorSample(0, stamp + round(after * NS_PER_S), 0.2)])
        (verdict,) = observer.samples.take()
        same = np.array_equal(x_of(observer, stamp + NS_PER_S), before)
        assert same is not used or verdict.reason.startswith("gate")
        assert verdict.reason.startswith("blanking: an impact was 0.049") is not used


@pytest.mark.parametrize("law", ["open-loop", "kinematic", "geometric", "unilateral"])
def test_laws_without_covariance_use_no_samples(law: str) -> None:
    """The estimate is as without them, and each verdict names the law."""
    observer, events, samples = rig(law)
    without, *_ = rig(law)
    fed(observer, events, samples)
    fed(without, events, [])
    np.testing.assert_array_equal(x_of(observer, at(5.0)), x_of(without, at(5.0)))
    reasons = {each.reason for each in observer.samples.take()}
    assert reasons == {f"{law} uses no measurements"}


def test_a_missed_impact_is_found_at_once_where_an_encoder_sees_it() -> None:
    """The impact is inserted within five samples, and the estimate stays good."""
    model, whole = truth("two_mass", 6.0, rate=100.0)
    declared = Uncertainty(deviation=0.1, clock_error=0.0, model_error=0.0, missed=0.1)
    joint = "x2"  # which hits the stop
    observer = watcher(model, LAW, whole.states[0], [encoder(joint)], uncertainty=declared)
    first = whole.events[0]
    samples = measured(whole, np.eye(4)[1:2], 1e-3)
    upto = [each for each in samples if each.stamp < first.stamp + 6 * NS_PER_S // 100]
    fed(observer, [], upto)
    estimate = observer.estimate(upto[-1].stamp)
    k = int(np.searchsorted(whole.stamps, upto[-1].stamp))
    error = np.append(estimate.q, estimate.u) - whole.states[k]
    assert np.max(np.abs(error[[1, 3]])) < 0.05
    assert np.all(np.abs(error) < 5 * np.sqrt(np.diag(estimate.covariance)))


def test_samples_wait_for_the_epoch_and_are_used_then() -> None:
    """Where forces depend on time; nothing is lost."""
    model, whole = truth("two_mass", 3.0)
    samples = measured(whole, np.eye(4)[:1], 1e-3)
    given = watcher(model, LAW, whole.states[0], [encoder()])
    later = watcher(model, LAW, whole.states[0], [encoder()], epoch=0)
    fed(given, whole.events, samples)
    later.measure(samples[:20])
    assert not later.samples.take()
    for each in whole.events:
        later.receive(each)
    later.measure(samples[20:])
    np.testing.assert_array_equal(x_of(later, at(3.0)), x_of(given, at(3.0)))


def test_samples_that_are_too_many_to_wait_are_counted() -> None:
    """The oldest go; the counts of all sensors say how many."""
    model, whole = truth("two_mass", 3.0)
    sensors = [encoder(), encoder("x2")]
    observer = watcher(model, "geometric", whole.states[0], sensors, epoch=0)
    observer.measure([SensorSample(0, at(k * 1e-3), 0.0) for k in range(10)])
    observer.measure([SensorSample(1, at(k * 1e-3), 0.0) for k in range(MOST_KEPT - 3)])
    observer.measure([SensorSample(1, at(60.0), 0.0)])
    assert [counts["dropped"] for counts in observer.samples.counts] == [8, 0]
    assert len(observer.samples.waiting) == MOST_KEPT


def test_a_new_episode_uses_the_samples_that_follow_it() -> None:
    """Those that came before its first event are not lost, those of the past are left out."""
    model, whole = truth("two_mass", 3.0)
    observer = watcher(model, LAW, whole.states[0], [encoder()], epoch=0)
    samples = measured(whole, np.eye(4)[:1], 0.0)
    first = [replace(e, episode=1) for e in whole.events]
    fed(observer, first[:1], [s for s in samples if s.stamp <= first[0].stamp])
    shift = 20 * NS_PER_S
    again = [
        replace(e, stamp=e.stamp + shift, epoch=EPOCH + shift, episode=2) for e in whole.events
    ]
    moved = [s._replace(stamp=s.stamp + shift) for s in samples]
    observer.measure(moved[:60])
    observer.receive(again[0])
    observer.receive(again[1])
    fresh = watcher(model, LAW, whole.states[0], [encoder()], epoch=EPOCH + shift)
    fed(fresh, [replace(e, episode=0) for e in again[:2]], moved[:60])
    stamp = max(again[1].stamp, moved[59].stamp) + 1
    np.testing.assert_array_equal(x_of(observer, stamp), x_of(fresh, stamp))


def _counted(function: Callable[..., object], calls: list[object]) -> Callable[..., object]:
    """A function that notes its calls."""

    def called(*given: object) -> object:
        calls.append(given)
        return function(*given)

    return called


@pytest.mark.slow
@pytest.mark.parametrize("trouble", ["outliers", "stuck"])
def test_a_bad_sensor_is_survived(trouble: str) -> None:
    """One sample of twenty wrong by 0.3 m; or the same value for a second: good again soon."""
    model, whole = truth("three_mass", 6.5, rate=100.0)
    rng, start = np.random.default_rng(2), whole.states[0]
    samples = measured(whole, np.eye(6)[:1], 1e-3)
    if trouble == "outliers":
        samples = [
            each._replace(value=each.value + 0.3 * (rng.random() < 0.05)) for each in samples
        ]
    else:
        samples[200:300] = [s._replace(value=samples[200].value) for s in samples[200:300]]
    declared = Uncertainty(deviation=0.2, clock_error=1e-3)
    x0 = start + 0.2 * rng.normal(size=6)
    observer = watcher(model, LAW, x0, [encoder()], uncertainty=declared)
    fed(observer, whole.events, samples)
    for k in (560, 600, 640):
        estimate = observer.estimate(int(whole.stamps[k]))
        error = np.append(estimate.q, estimate.u) - whole.states[k]
        assert np.max(np.abs(error[:3])) < 2e-3
        assert np.max(np.abs(error) / np.sqrt(np.diag(estimate.covariance))) < 5
