# SPDX-License-Identifier: Apache-2.0
"""A simulated sensor: each fault alone, against its statistics."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats
from sensing import FULL, THREE, impacts, messages, switching
from systems import EPOCH, forcing, run, sample, system

from impact_observer.errors import UsageError
from impact_observer.events import Kind, Switch
from impact_observer.options import Option
from impact_observer.plant import (
    IDEAL,
    Plant,
    SensorMessage,
    SensorModel,
    Switching,
    simulate,
    simulate_sensor,
)
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import MAX_STAMP, NS_PER_S, Instant, grid

MANY = 2_000
"""Impacts of a statistic; a fraction p of them deviates by less than 4 sigma."""
LEAST = 1e-3
"""Least p-value accepted; seeds are fixed."""
ONE = system(1, 0, 1, contacts=[([1], 1.0, 0.5)])
FLAGS = {"impacts_only"}


def errors(sensor: SensorModel, switchings: Sequence[Switching]) -> np.ndarray:
    """Errors of the stamps, s, of a sensor without missed and spurious impacts."""
    found = messages(sensor, switchings)
    return np.array(
        [
            (each.event.stamp - true.instant.stamp) / NS_PER_S
            for each, true in zip(found, switchings, strict=True)
        ]
    )


def assert_fraction(found: int, of: int, expected: float) -> None:
    """A binomial count is what its probability says, within four standard deviations."""
    assert abs(found - of * expected) <= 4 * math.sqrt(of * expected * (1 - expected))


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball"])
def test_ideal_sensor_reports_the_events_of_the_run(name: str) -> None:
    """Bit for bit, with sequence numbers, without latency, for any seed."""
    model = sample(name)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    found = simulate(plant, grid(EPOCH, EPOCH + 6 * NS_PER_S, 10.0))
    last = int(found.stamps[-1])
    for seed in (0, 3):
        sent = simulate_sensor(
            IDEAL, model.system, found.switchings, epoch=EPOCH, last=last, seed=seed
        )
        assert tuple(each.event for each in sent) == found.events
        assert all(each.arrival == each.event.stamp for each in sent)
    assert found.epoch == EPOCH
    assert len(found.events) > 3


def test_table_of_faults_has_the_fields_of_the_sensor_model() -> None:
    """Same names in the same order, ideal by default, and every end of a range allowed."""
    assert [each.name for each in SENSOR_FAULTS] == [
        f.name for f in dataclasses.fields(SensorModel)
    ]
    for each in SENSOR_FAULTS:
        assert getattr(IDEAL, each.name) == each.default
        assert type(getattr(IDEAL, each.name)) is type(each.default)
        ends = [False, True] if each.name in FLAGS else [each.low, each.high]
        for end in ends:
            value: dict[str, Any] = {each.name: end}
            assert getattr(SensorModel(**value), each.name) == end
    assert IDEAL.faults == {}
    assert SensorModel(**FULL).faults == FULL


@pytest.mark.parametrize("fault", [pytest.param(each, id=each.name) for each in SENSOR_FAULTS])
def test_value_out_of_range_is_named(fault: Option) -> None:
    """One line: the fault, what was found, what is expected."""
    wrong: list[Any] = [math.nan, math.inf, (fault.low or 0.0) - 1]
    wrong += [0.5] if fault.name in FLAGS else [True, (fault.high or 0.0) * 1.01]
    for value in wrong:
        with pytest.raises(UsageError, match=f"sensor {fault.name}: .* found; expected ") as e:
            SensorModel(**{fault.name: value})
        assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    ("sensor", "contacts"), [(SensorModel(mislabelled=0.1), 1), (SensorModel(spurious=0.1), 0)]
)
def test_sensor_that_needs_more_contacts_is_refused(sensor: SensorModel, contacts: int) -> None:
    """One contact cannot be mislabelled, and no contact cannot have spurious impacts."""
    model = system(1, 0, 1, contacts=[([1], 1.0, 0.5)] * contacts)
    with pytest.raises(UsageError, match=f"or more: test has {contacts}"):
        simulate_sensor(sensor, model, [], epoch=EPOCH, last=EPOCH)


def test_delay_makes_stamp_and_arrival_late() -> None:
    """By the same time; nothing else changes."""
    switchings = impacts(5)
    found = messages(SensorModel(delay=0.02), switchings)
    assert [each.event.switches for each in found] == [each.switches for each in switchings]
    error = [
        each.event.stamp - true.instant.stamp for each, true in zip(found, switchings, strict=True)
    ]
    assert error == [20_000_000] * 5
    assert all(each.arrival == each.event.stamp for each in found)


def test_jitter_is_normal_and_does_not_change_the_arrival() -> None:
    """With the given standard deviation, without bias."""
    switchings = impacts(MANY)
    found = errors(SensorModel(jitter=0.003), switchings)
    assert stats.kstest(found / 0.003, "norm").pvalue > LEAST
    assert all(
        each.arrival == true.instant.stamp
        for each, true in zip(
            messages(SensorModel(jitter=0.003), switchings), switchings, strict=True
        )
    )


def test_quantised_stamps_are_the_nearest_multiples() -> None:
    """Errors are uniform within half a tick."""
    switchings = [switching(math.sqrt(k), [(0, Kind.IMPACT)]) for k in range(1, 2001)]
    found = messages(SensorModel(quantisation=0.001), switchings)
    assert all(each.event.stamp % 1_000_000 == 0 for each in found)
    error = errors(SensorModel(quantisation=0.001), switchings)
    assert np.abs(error).max() <= 0.5e-3
    assert stats.kstest(error / 0.001 + 0.5, "uniform").pvalue > LEAST


def test_clock_has_an_offset_and_a_drift() -> None:
    """The offset at the epoch, plus the drift for every second since."""
    error = errors(SensorModel(clock_offset=-0.5, clock_drift=1e-3), impacts(1000))
    np.testing.assert_allclose(error, -0.5 + 1e-3 * np.arange(1, 1001), rtol=0, atol=1e-9)


def test_clock_with_negative_stamps_is_refused() -> None:
    """The error names a later epoch as the remedy."""
    sensor = SensorModel(clock_offset=-EPOCH / NS_PER_S)
    with pytest.raises(UsageError, match="clock_offset"):
        simulate_sensor(sensor, THREE, impacts(1), epoch=EPOCH, last=EPOCH + NS_PER_S)


@pytest.mark.parametrize("offset", [-0.999999999 * EPOCH / NS_PER_S, 3600.0])
@pytest.mark.parametrize("quantisation", [0.0, 0.7])
def test_stamps_stay_where_messages_can_carry_them(offset: float, quantisation: float) -> None:
    """Above zero, not after the last stamp, and multiples of the tick even there."""
    start = EPOCH if offset < 0 else MAX_STAMP - 10 * NS_PER_S
    switchings = dataclasses.replace(impacts(1)[0], instant=Instant(start + NS_PER_S))
    sensor = SensorModel(clock_offset=offset, quantisation=quantisation)
    (found,) = simulate_sensor(
        sensor, THREE, [switchings], epoch=start, last=switchings.instant.stamp
    )
    tick = max(round(quantisation * NS_PER_S), 1)
    assert tick <= found.event.stamp <= MAX_STAMP
    assert found.event.stamp % tick == 0
    assert found.arrival == switchings.instant.stamp


def test_missed_impacts_are_a_fraction_of_all() -> None:
    """They have no sequence numbers; all others are unchanged."""
    switchings = impacts(MANY)
    found = messages(SensorModel(missed=0.2), switchings)
    assert_fraction(len(found), MANY, 0.8)
    assert [each.event.sequence for each in found] == list(range(1, len(found) + 1))
    assert {each.arrival for each in found} < {true.instant.stamp for true in switchings}
    assert messages(SensorModel(missed=1.0), switchings) == []


def test_contacts_of_one_instant_are_missed_independently() -> None:
    """Of two that hit at once one may be reported; without any there is no event."""
    pair = [(0, Kind.IMPACT), (2, Kind.IMPACT)]
    switchings = [switching(k + 1, pair) for k in range(MANY)]
    sizes = [len(each.event.switches) for each in messages(SensorModel(missed=0.3), switchings)]
    assert_fraction(sizes.count(2), MANY, 0.49)
    assert_fraction(sizes.count(1), MANY, 0.42)


def test_spurious_impacts_are_a_poisson_process() -> None:
    """Intervals are exponential, all contacts equally likely, all of kind IMPACT."""
    found = messages(SensorModel(spurious=5.0), [], seconds=1000.0)
    stamps = np.array([EPOCH, *(each.event.stamp for each in found)])
    assert abs(len(found) - 5000) < 4 * math.sqrt(5000)
    assert stats.kstest(np.diff(stamps) / NS_PER_S * 5, "expon").pvalue > LEAST
    named = [each.event.switches[0].contact for each in found]
    assert stats.chisquare([named.count(name) for name in THREE.contact_names]).pvalue > LEAST
    assert {each.event.switches[0].kind for each in found} == {Kind.IMPACT}
    assert stamps[-1] <= EPOCH + 1000 * NS_PER_S
    assert all(each.arrival == each.event.stamp for each in found)


def test_dead_time_thins_impacts_as_renewal_theory_says() -> None:
    """A Poisson process of rate r is detected at the rate r / (1 + r dead_time)."""
    found = messages(SensorModel(spurious=5.0, dead_time=0.3), [], model=ONE, seconds=2000.0)
    stamps = np.array([each.event.stamp for each in found])
    gaps = np.diff(stamps) / NS_PER_S
    assert gaps.min() >= 0.3
    assert stats.kstest((gaps - 0.3) * 5, "expon").pvalue > LEAST
    # Standard deviation of a renewal count, from that of a gap, 1 / r.
    rate = 5 / (1 + 5 * 0.3)
    assert abs(len(found) - 2000 * rate) < 4 * math.sqrt(2000 * rate**3 / 5**2)


def test_dead_time_is_of_one_contact_and_ends_in_time() -> None:
    """An impact at its end is detected; an undetected one does not prolong it."""
    at = [(1.0, 0), (1.05, 1), (1.09, 0), (1.1, 0), (1.19, 0), (1.2, 0)]
    found = messages(SensorModel(dead_time=0.1), [switching(s, [(i, Kind.IMPACT)]) for s, i in at])
    stamps = [(each.event.stamp - EPOCH) / NS_PER_S for each in found]
    assert stamps == [1.0, 1.05, 1.1, 1.2]


def test_mislabelled_impacts_report_any_other_contact() -> None:
    """With the given probability, all others equally likely; stamps are unchanged."""
    switchings = impacts(MANY)
    found = messages(SensorModel(mislabelled=0.3), switchings)
    pairs = [
        (each.event.switches[0].contact, true.switches[0].contact)
        for each, true in zip(found, switchings, strict=True)
    ]
    assert_fraction(sum(a != b for a, b in pairs), MANY, 0.3)
    wrong = [pair for pair in set(pairs) if pair[0] != pair[1]]
    assert len(wrong) == 6
    assert stats.chisquare([pairs.count(pair) for pair in wrong]).pvalue > LEAST
    assert [each.event.stamp for each in found] == [true.instant.stamp for true in switchings]
    always = messages(SensorModel(mislabelled=1.0), switchings[:100])
    assert all(
        each.event.switches != true.switches
        for each, true in zip(always, switchings[:100], strict=True)
    )


def test_contacts_reported_under_one_name_are_one_switch() -> None:
    """A message holds each switch of a contact once."""
    model = system(
        np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=[(row, 1.0, 0.5) for row in np.eye(2)]
    )
    pair = [(0, Kind.IMPACT), (1, Kind.IMPACT)]
    switchings = [switching(k + 1, pair, model=model) for k in range(200)]
    found = messages(SensorModel(mislabelled=0.5), switchings, model=model)
    assert {len(each.event.switches) for each in found} == {1, 2}
    assert all(len(set(each.event.switches)) == len(each.event.switches) for each in found)


def test_threshold_removes_slower_impacts() -> None:
    """An approach exactly as fast as the threshold is detected."""
    speeds = np.linspace(0, 2, 201)
    switchings = [switching(k + 1, [(0, Kind.IMPACT)], v) for k, v in enumerate(speeds)]
    found = messages(SensorModel(threshold=0.5), switchings)
    detected = [k for k, v in enumerate(speeds) if v >= 0.5]
    assert [(each.event.stamp - EPOCH) // NS_PER_S - 1 for each in found] == detected


def test_threshold_of_zero_detects_a_contact_that_does_not_approach() -> None:
    """One that another impact opens is reported; with any positive threshold it is not."""
    switchings = [switching(1.0, [(0, Kind.IMPACT)], speed=-0.25)]
    assert len(messages(IDEAL, switchings)) == 1
    assert messages(SensorModel(threshold=1e-9), switchings) == []


def test_transport_is_exponential_and_does_not_change_the_stamp() -> None:
    """Messages overtake each other, as sequence numbers show."""
    switchings = impacts(MANY)
    sensor = SensorModel(transport=0.6)
    found = messages(sensor, switchings)
    way = np.array([each.arrival - each.event.stamp for each in found]) / NS_PER_S
    assert stats.kstest(way / 0.6, "expon").pvalue > LEAST
    assert np.all(errors(sensor, switchings) == 0)
    arrived = simulate_sensor(
        sensor, THREE, switchings, epoch=EPOCH, last=switchings[-1].instant.stamp, seed=1
    )
    assert sorted(arrived, key=lambda each: each.arrival) == list(arrived)
    assert [each.event.sequence for each in arrived] != [each.event.sequence for each in found]


PERSISTENT = [
    switching(1.0, [(0, Kind.IMPACT)]),
    switching(2.0, [(0, Kind.CLOSE), (1, Kind.IMPACT)]),
    switching(2.1, [(0, Kind.OPEN), (2, Kind.IMPACT)]),
    switching(3.0, [(0, Kind.CLOSE)]),
    switching(4.0, [(0, Kind.OPEN)]),
]
"""A contact that hits, closes, is opened by an impact, closes and opens."""


def kinds(found: Sequence[SensorMessage]) -> list[list[tuple[str, Kind]]]:
    """Contacts and kinds of every event."""
    return [[(s.contact, s.kind) for s in each.event.switches] for each in found]


def test_sensor_of_impacts_only_never_reports_persistent_contact() -> None:
    """CLOSE is reported as IMPACT, OPEN never; an event of OPEN alone is not sent."""
    assert kinds(messages(SensorModel(impacts_only=True), PERSISTENT)) == [
        [("c1", Kind.IMPACT)],
        [("c1", Kind.IMPACT), ("c2", Kind.IMPACT)],
        [("c3", Kind.IMPACT)],
        [("c1", Kind.IMPACT)],
    ]


@pytest.mark.parametrize("sensor", [SensorModel(missed=1.0), SensorModel(threshold=2.0)])
def test_contact_whose_close_is_missed_is_not_reported_open(sensor: SensorModel) -> None:
    """Neither CLOSE nor OPEN is reported."""
    assert messages(sensor, PERSISTENT) == []


def test_close_in_the_dead_time_is_lost_and_open_in_it_is_not() -> None:
    """A CLOSE is an impact, an OPEN is not."""
    found = messages(
        SensorModel(dead_time=0.95), [switching(1.5, [(0, Kind.IMPACT)]), *PERSISTENT[1:]]
    )
    assert kinds(found) == [
        [("c1", Kind.IMPACT)],
        [("c2", Kind.IMPACT)],
        [("c3", Kind.IMPACT)],
        [("c1", Kind.CLOSE)],
        [("c1", Kind.OPEN)],
    ]
    found = messages(SensorModel(dead_time=0.5), PERSISTENT[1:3])
    assert kinds(found)[1] == [("c1", Kind.OPEN), ("c3", Kind.IMPACT)]


def test_open_is_reported_under_the_name_of_its_close() -> None:
    """Otherwise the mislabelled contact would never open."""
    switchings = [
        switching(k + 1, [(k // 2 % 3, Kind.OPEN if k % 2 else Kind.CLOSE)]) for k in range(600)
    ]
    found = kinds(messages(SensorModel(mislabelled=0.5), switchings))
    names = [
        (closed[0], opened[0]) for closed, opened in zip(found[::2], found[1::2], strict=True)
    ]
    assert all(a[0] == b[0] and b[1] is Kind.OPEN for a, b in names)
    assert (
        sum(a[0] != switchings[2 * k].switches[0].contact for k, (a, _) in enumerate(names)) > 100
    )


def test_accumulating_impacts_are_lost_to_a_dead_time_and_a_threshold() -> None:
    """A bouncing ball: intervals and speeds shrink as in closed form."""
    ball = system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=forcing(1, -8.0))
    # Thrown up at 4 m/s it hits after 1, 1/2, 1/4, ... s more, at 4, 2, 1, ... m/s.
    found = run(ball, [0.0], [4.0], seconds=3.0)
    assert found.events[-1].switches == (Switch("c1", Kind.CLOSE),)

    def detected(sensor: SensorModel) -> list[float]:
        return [
            (e.event.stamp - EPOCH) / NS_PER_S
            for e in messages(sensor, found.switchings, model=ball)
        ]

    assert detected(SensorModel(threshold=0.75)) == [1.0, 1.5, 1.75]
    assert detected(SensorModel(dead_time=0.2)) == [1.0, 1.5, 1.75, pytest.approx(1.96875)]


def test_switching_without_switches_is_not_reported() -> None:
    """A switching without switches is no event and draws nothing."""
    switchings = impacts(6)
    silent = dataclasses.replace(
        switchings[2], instant=switchings[1].instant.shifted_by(0.5), switches=()
    )
    jittered = SensorModel(jitter=0.01)
    assert messages(jittered, [*switchings[:2], silent, *switchings[2:]]) == messages(
        jittered, switchings
    )
