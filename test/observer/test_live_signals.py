# SPDX-License-Identifier: Apache-2.0
"""Forces that are known only live: in the plant causal, in the observer by stamp."""

from dataclasses import replace

import numpy as np
import pytest
from live_rig import RIG, SECONDS, START, Array, Sample, arrivals, give, motor, samples, simulated
from numpy.typing import NDArray
from systems import EPOCH

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Ruling
from impact_observer.model import parse_model
from impact_observer.model.live_signals import connected
from impact_observer.model.measurement import Measurement
from impact_observer.observer import Observer, Options, make_observer
from impact_observer.observer import observer as observer_module
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import Plant
from impact_observer.stamps import NS_PER_S


@pytest.mark.slow
def test_plant_does_not_depend_on_how_samples_are_grouped() -> None:
    """To the bit: it goes no further than the samples, and what has been is final."""
    one = simulated()
    many = simulated(pauses=9)
    assert [e.stamp for e in one[0]] == [e.stamp for e in many[0]]
    assert len(one[0]) > 5
    count = min(len(one[1]), len(many[1]))
    np.testing.assert_array_equal(one[2][:count], many[2][:count])


def test_plant_under_live_signals_is_that_of_the_functions_they_sample() -> None:
    """A force that is held."""
    held = np.arange(0.0, SECONDS + 2e-3, 2e-3)
    rows = "".join(f"    {t!r},{motor(t)!r}\n" for t in held.tolist())
    table = f"forcing:\n  hold: previous\n  sampled: |\n    time,x2\n{rows}"
    text = RIG.replace("{body: x2, input: motor}, ", "") + table
    known = parse_model(text, "rig").system
    plant, impacts = Plant(known, *START, epoch=EPOCH), list[int]()
    while (switching := plant.next_switching(EPOCH + round(SECONDS * NS_PER_S))) is not None:
        impacts.append(switching.instant.stamp)
        plant.cross(switching)
    found = [event.stamp for event in simulated()[0]]
    assert len(found) >= len(impacts) - 1
    np.testing.assert_allclose(found[:8], impacts[:8], rtol=0, atol=100)


def watcher(law: str) -> Observer:
    """An observer of the rig."""
    options = Options(law=law, initial_state="0.3,-0.2,0.5,-0.5", epoch=EPOCH, clock_error=0.0)
    return make_observer(parse_model(RIG, "rig").system, options)


def final_estimates(observer: Observer, stamps: NDArray[np.int64]) -> Array:
    """States at stamps when all is known."""
    found = [observer.estimate(int(stamp)) for stamp in stamps]
    return np.array([np.concatenate([each.q, each.u]) for each in found])


@pytest.mark.parametrize(
    "law", ["geometric", pytest.param("minimum-variance", marks=pytest.mark.long)]
)
def test_estimates_are_those_of_all_samples_whatever_came_when(law: str) -> None:
    """To the bit: all samples first; in order with events; and a twentieth of them late."""
    events, stamps, states = simulated()
    first, given = watcher(law), samples()
    for sample in given:
        assert give(first.live, sample) == ""
    for event in events:
        first.receive(event)
    check = stamps[:: 40 if law == "geometric" else 100]
    expected = final_estimates(first, check)
    inbox: list[tuple[int, ImpactEvent | Sample]] = [
        *zip(arrivals(), given, strict=True),
        *((event.stamp, event) for event in events),
    ]
    inbox.sort(key=lambda each: each[0])
    live = watcher(law)
    for k, (at, item) in enumerate(inbox):
        if isinstance(item, ImpactEvent):
            live.receive(item)
        else:
            give(live.live, item)
        if k % 97 == 0 and live.start is not None:
            live.estimate(at)
    np.testing.assert_array_equal(final_estimates(live, check), expected)
    error = np.abs(expected - states[np.isin(stamps, check)])
    assert np.max(error[-1]) < (1e-6 if law == "minimum-variance" else 0.3)


@pytest.mark.long
def test_sensors_beside_live_forces_see_what_the_plant_does() -> None:
    """An encoder and an accelerometer on a moving ground; forces late, all else in any order."""
    events, stamps, states = simulated()
    system = parse_model(RIG, "rig").system
    sensors = (
        Measurement("x1", "/x1", "x1", "position", deviation=0.01),
        Measurement("a", "/a", field="a", acceleration={"x2": 1.0}, deviation=0.5),
    )
    some = np.arange(10, stamps.size - 10, 10)
    dt = (stamps[some + 1] - stamps[some - 1]) / NS_PER_S
    rates = (states[some + 1] - states[some - 1])[:, 3] / dt
    near = np.min(np.abs(stamps[some, None] - [e.stamp for e in events]), axis=1) < NS_PER_S // 20
    measured = [SensorSample(0, int(stamps[k]), float(states[k, 0])) for k in some]
    measured += [
        SensorSample(1, int(stamps[k]), float(rate))
        for k, rate, left_out in zip(some, rates, near, strict=True)
        if not left_out
    ]
    options = Options(
        "minimum-variance", "0.3,-0.2,0.5,-0.5", epoch=EPOCH, clock_error=0.0, model_error=0.0
    )
    one, other = (make_observer(system, options, measurements=sensors) for _ in range(2))
    for sample in samples():
        give(one.live, sample)
    for event in events:
        one.receive(event)
    one.measure(measured)
    for event in events:
        other.receive(event)
    for k, sample in enumerate(samples()):
        give(other.live, sample)
        if k % 1000 == 0:
            other.measure(measured[k // 1000 :: 11])
    other.measure(measured)
    check = stamps[some[::5]]
    expected = final_estimates(one, check)
    np.testing.assert_array_equal(final_estimates(other, check), expected)
    accepted = [each for each in one.samples.take() if each.name == "a" and each.accepted]
    late = [abs(each.innovation) for each in accepted[len(accepted) // 2 :]]
    assert np.median(late) < 0.1 * np.median(np.abs(rates))
    assert np.max(np.abs(expected[-1] - states[some[::5][-1]])) < 0.05


def test_old_samples_are_forgotten() -> None:
    """Those that no estimate of the history needs; estimates go on as before."""
    given, (events, _, _) = samples(), simulated()
    options = Options(law="geometric", epoch=EPOCH, history=0.5)
    short = make_observer(parse_model(RIG, "rig").system, options)
    whole = make_observer(parse_model(RIG, "rig").system, Options(law="geometric", epoch=EPOCH))
    for observer in (short, whole):
        waiting = list(events)
        for sample in given:
            while waiting and waiting[0].stamp <= sample[0]:
                observer.receive(waiting.pop(0))
            give(observer.live, sample)
    assert short.live is not None
    assert whole.live is not None
    assert short.live.samples.time.size < whole.live.samples.time.size
    at = EPOCH + round(SECONDS * NS_PER_S)
    one, two = short.estimate(at), whole.estimate(at)
    np.testing.assert_array_equal(one.q, two.q)


@pytest.mark.slow
def test_samples_without_any_event_do_not_fill_the_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The estimate goes on from the start of the history, equal but for rounding."""
    monkeypatch.setattr(observer_module, "MOST_LIVE_SAMPLES", 1000)
    events = simulated()[0][:1]
    options = Options(law="geometric", initial_state="0.3,-0.2,0.5,-0.5", epoch=EPOCH, history=0.5)
    bounded, whole = (make_observer(parse_model(RIG, "rig").system, options) for _ in range(2))
    for observer in (bounded, whole):
        for event in events:
            observer.receive(event)
        for k, sample in enumerate(samples()):
            give(observer.live, sample)
            if k % 250 == 0:
                observer.estimate(sample[0])
                if observer is bounded:
                    observer.forget_silence(sample[0])
    assert bounded.live is not None
    assert whole.live is not None
    assert bounded.live.samples.time.size < 1600 < whole.live.samples.time.size
    at = EPOCH + round(SECONDS * NS_PER_S)
    one, two = bounded.estimate(at), whole.estimate(at)
    np.testing.assert_allclose(one.q, two.q, atol=1e-12)
    assert one.last_sequence == 1
    late = replace(events[0], stamp=events[0].stamp + NS_PER_S // 4, sequence=2)
    (verdict,) = bounded.receive(late)
    assert verdict.ruling is Ruling.TOO_LATE
    waiting = make_observer(parse_model(RIG, "rig").system, Options(law="geometric"))
    assert waiting.live is not None
    for sample in samples():
        give(waiting.live, sample)
    waiting.forget_silence(at)
    waiting.live.follow(EPOCH)
    assert waiting.live.samples.time.size < 600


@pytest.mark.parametrize(
    ("sample", "line"),
    [
        (("motor", 1, np.nan), "'motor': nan found; expected a finite number"),
        (("engine", 1, 1.0), "'engine' is not known; expected some of motor"),
    ],
)
def test_sample_that_cannot_be_used_is_named(sample: tuple[str, int, float], line: str) -> None:
    """And changes nothing."""
    live = watcher("geometric").live
    assert live is not None
    assert live.add_force(*sample) == line
    assert live.follow(EPOCH) is None


def test_who_has_no_signals_refuses_the_model() -> None:
    """One line names what arrives live."""
    system = parse_model(RIG, "rig").system
    line = "rig: known only live: motor, which a plant without signals cannot use"
    with pytest.raises(UsageError, match=line):
        Plant(system, *START, epoch=EPOCH)


def test_samples_that_were_read_do_not_change_when_others_come() -> None:
    """Those of a user who keeps them, through later samples, late ones, and a forgotten past."""
    spring = "springs: [{between: [x1, ground], stiffness: 10}]"
    text = f"name: rig\nbodies: [{{name: x1, mass: 1}}]\n{spring}\n"
    model = parse_model(f"{text}forces: [{{body: x1, input: motor}}]\n", "rig")
    signals = connected(model.system)[1]
    assert signals is not None
    read, copies = list[Array](), list[Array]()
    for k in [*range(1, 1300), 1500, 1400, *range(1501, 1600)]:
        signals.add_force("motor", EPOCH + k * 10**6, float(k))
        signals.follow(EPOCH)
        signals.forget_before(EPOCH + (k - 50) * 10**6)
        sampled = signals.samples
        assert sampled.force[-1, 0] == max(k, 1500 if k == 1400 else 0)
        if k % 100 == 0:
            read += [sampled.time, sampled.force]
            copies += [sampled.time.copy(), sampled.force.copy()]
    assert all(np.array_equal(*each) for each in zip(read, copies, strict=True))
    assert 1400 in signals.samples.force[:, 0]
    assert 1 not in signals.samples.force[:, 0]
