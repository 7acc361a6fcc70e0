"""A sensor of impacts: each of its troubles by itself, against what theory says of it."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats
from sensing import FULL, THREE, heard, impacts, switching
from systems import EPOCH, forcing, run, sample, system

from impact_observer.errors import UsageError
from impact_observer.events import Kind, Switch
from impact_observer.options import Option
from impact_observer.plant import (
    IDEAL,
    SensorMessage,
    SensorModel,
    Switching,
    event_of,
    make_plant,
    simulate,
    simulate_sensor,
)
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import MAX_STAMP, NS_PER_S, Instant, grid

MANY = 2_000
"""Impacts of a statistic; what is a fraction p of them deviates by less than 4 sigma."""
LEAST = 1e-3
"""Probability below which a statistic would not be believed; seeds are fixed."""
ONE = system(1, 0, 1, contacts=[([1], 1.0, 0.5)])
FLAGS = {"impacts_only"}


def errors(sensor: SensorModel, told: Sequence[Switching]) -> np.ndarray:
    """By how much the stamps of impacts are late, s, where none is lost or spurious."""
    found = heard(sensor, told)
    return np.array(
        [
            (each.event.stamp - true.instant.stamp) / NS_PER_S
            for each, true in zip(found, told, strict=True)
        ]
    )


def assert_fraction(found: int, of: int, expected: float) -> None:
    """A binomial count is what its probability says, within four standard deviations."""
    assert abs(found - of * expected) <= 4 * math.sqrt(of * expected * (1 - expected))


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball"])
def test_ideal_sensor_tells_what_the_run_has(name: str) -> None:
    """Bit for bit, sequence numbers included, and at once; whatever the seed."""
    model = sample(name)
    plant = make_plant(model.system, *model.initial_state(), epoch=EPOCH)
    found = simulate(plant, grid(EPOCH, EPOCH + 6 * NS_PER_S, 10.0))
    last = int(found.stamps[-1])
    for seed in (0, 3):
        told = simulate_sensor(
            IDEAL, model.system, found.switchings, epoch=EPOCH, last=last, seed=seed
        )
        assert tuple(each.event for each in told) == found.events
        assert all(each.arrival == each.event.stamp for each in told)
    assert found.epoch == EPOCH
    assert len(found.events) > 3


def test_the_table_of_troubles_is_the_sensor() -> None:
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


@pytest.mark.parametrize("trouble", [pytest.param(each, id=each.name) for each in SENSOR_FAULTS])
def test_value_out_of_range_is_named(trouble: Option) -> None:
    """One line: the trouble, what was found, what is expected."""
    wrong: list[Any] = [math.nan, math.inf, (trouble.low or 0.0) - 1]
    wrong += [0.5] if trouble.name in FLAGS else [True, (trouble.high or 0.0) * 1.01]
    for value in wrong:
        with pytest.raises(UsageError, match=f"sensor {trouble.name}: .* found; expected ") as e:
            SensorModel(**{trouble.name: value})
        assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    ("sensor", "contacts"), [(SensorModel(mislabelled=0.1), 1), (SensorModel(spurious=0.1), 0)]
)
def test_sensor_that_needs_more_contacts_is_refused(sensor: SensorModel, contacts: int) -> None:
    """No other contact can be named where there is one, none spurious where there is none."""
    model = system(1, 0, 1, contacts=[([1], 1.0, 0.5)] * contacts)
    with pytest.raises(UsageError, match=f"or more: test has {contacts}"):
        simulate_sensor(sensor, model, [], epoch=EPOCH, last=EPOCH)


def test_delay_makes_stamp_and_arrival_late() -> None:
    """By the same, and nothing else changes."""
    told = impacts(5)
    found = heard(SensorModel(delay=0.02), told)
    assert [each.event.switches for each in found] == [each.switches for each in told]
    late = [each.event.stamp - true.instant.stamp for each, true in zip(found, told, strict=True)]
    assert late == [20_000_000] * 5
    assert all(each.arrival == each.event.stamp for each in found)


def test_jitter_is_normal_and_leaves_the_arrival() -> None:
    """Of the standard deviation that was asked for, without bias."""
    told = impacts(MANY)
    found = errors(SensorModel(jitter=0.003), told)
    assert stats.kstest(found / 0.003, "norm").pvalue > LEAST
    assert all(
        each.arrival == true.instant.stamp
        for each, true in zip(heard(SensorModel(jitter=0.003), told), told, strict=True)
    )


def test_jitter_puts_stamps_in_another_order_than_sequence_numbers() -> None:
    """Sequence numbers count the instants."""
    found = heard(SensorModel(jitter=0.01), impacts(200, every=0.001))
    assert [each.event.sequence for each in found] == list(range(1, 201))
    assert np.any(np.diff([each.event.stamp for each in found]) < 0)


def test_quantised_stamps_are_the_nearest_multiples() -> None:
    """Of the whole nanoseconds asked for; errors are uniform within half of it."""
    told = [switching(math.sqrt(k), [(0, Kind.IMPACT)]) for k in range(1, 2001)]
    found = heard(SensorModel(quantisation=0.001), told)
    assert all(each.event.stamp % 1_000_000 == 0 for each in found)
    late = errors(SensorModel(quantisation=0.001), told)
    assert np.abs(late).max() <= 0.5e-3
    assert stats.kstest(late / 0.001 + 0.5, "uniform").pvalue > LEAST


def test_clock_is_ahead_and_too_fast() -> None:
    """By an offset at the epoch, and by the drift for every second since."""
    late = errors(SensorModel(clock_offset=-0.5, clock_drift=1e-3), impacts(1000))
    np.testing.assert_allclose(late, -0.5 + 1e-3 * np.arange(1, 1001), rtol=0, atol=1e-9)


def test_the_epoch_of_an_event_is_the_plants() -> None:
    """The clock is wrong about impacts; when the forcing began is told right."""
    found = heard(SensorModel(clock_offset=-0.5), impacts(3))
    assert {each.event.epoch for each in found} == {EPOCH}


def test_clock_that_would_show_less_than_zero_is_refused() -> None:
    """At the epoch already; the line names a later epoch as the remedy."""
    sensor = SensorModel(clock_offset=-EPOCH / NS_PER_S)
    with pytest.raises(UsageError, match=r"clock_offset: .* stamps start above zero"):
        simulate_sensor(sensor, THREE, impacts(1), epoch=EPOCH, last=EPOCH + NS_PER_S)


@pytest.mark.parametrize("offset", [-0.999999999 * EPOCH / NS_PER_S, 3600.0])
@pytest.mark.parametrize("quantisation", [0.0, 0.7])
def test_stamps_stay_where_messages_can_carry_them(offset: float, quantisation: float) -> None:
    """Above zero, below the last stamp there is, and multiples even there."""
    start = EPOCH if offset < 0 else MAX_STAMP - 10 * NS_PER_S
    told = dataclasses.replace(impacts(1)[0], instant=Instant(start + NS_PER_S))
    sensor = SensorModel(clock_offset=offset, quantisation=quantisation)
    (found,) = simulate_sensor(sensor, THREE, [told], epoch=start, last=told.instant.stamp)
    tick = max(round(quantisation * NS_PER_S), 1)
    assert tick <= found.event.stamp <= MAX_STAMP
    assert found.event.stamp % tick == 0
    assert found.arrival == told.instant.stamp


def test_missed_impacts_are_so_many() -> None:
    """They are not counted either; the rest is what it was."""
    told = impacts(MANY)
    found = heard(SensorModel(missed=0.2), told)
    assert_fraction(len(found), MANY, 0.8)
    assert [each.event.sequence for each in found] == list(range(1, len(found) + 1))
    assert {each.arrival for each in found} < {true.instant.stamp for true in told}
    assert heard(SensorModel(missed=1.0), told) == []


def test_every_contact_of_an_instant_is_missed_by_itself() -> None:
    """Of two that hit at once one may be told; of none there is no event."""
    pair = [(0, Kind.IMPACT), (2, Kind.IMPACT)]
    told = [switching(k + 1, pair) for k in range(MANY)]
    sizes = [len(each.event.switches) for each in heard(SensorModel(missed=0.3), told)]
    assert_fraction(sizes.count(2), MANY, 0.49)
    assert_fraction(sizes.count(1), MANY, 0.42)


def test_spurious_impacts_are_a_poisson_process() -> None:
    """Gaps are exponential, and every contact is named as often, as IMPACT."""
    found = heard(SensorModel(spurious=5.0), [], seconds=1000.0)
    stamps = np.array([EPOCH, *(each.event.stamp for each in found)])
    assert abs(len(found) - 5000) < 4 * math.sqrt(5000)
    assert stats.kstest(np.diff(stamps) / NS_PER_S * 5, "expon").pvalue > LEAST
    named = [each.event.switches[0].contact for each in found]
    assert stats.chisquare([named.count(name) for name in THREE.contact_names]).pvalue > LEAST
    assert {each.event.switches[0].kind for each in found} == {Kind.IMPACT}
    assert stamps[-1] <= EPOCH + 1000 * NS_PER_S
    assert all(each.arrival == each.event.stamp for each in found)


def test_dead_time_thins_impacts_as_renewal_theory_says() -> None:
    """Of a Poisson process of rate r, r / (1 + r dead) is felt by a detector that it blinds."""
    found = heard(SensorModel(spurious=5.0, dead_time=0.3), [], model=ONE, seconds=2000.0)
    stamps = np.array([each.event.stamp for each in found])
    gaps = np.diff(stamps) / NS_PER_S
    assert gaps.min() >= 0.3
    assert stats.kstest((gaps - 0.3) * 5, "expon").pvalue > LEAST
    # Standard deviation of a renewal count, from that of a gap, 1 / r.
    rate = 5 / (1 + 5 * 0.3)
    assert abs(len(found) - 2000 * rate) < 4 * math.sqrt(2000 * rate**3 / 5**2)


def test_dead_time_is_of_one_contact_and_ends_in_time() -> None:
    """An impact as late as the dead time is felt; one that is not felt prolongs nothing."""
    at = [(1.0, 0), (1.05, 1), (1.09, 0), (1.1, 0), (1.19, 0), (1.2, 0)]
    found = heard(SensorModel(dead_time=0.1), [switching(s, [(i, Kind.IMPACT)]) for s, i in at])
    stamps = [(each.event.stamp - EPOCH) / NS_PER_S for each in found]
    assert stamps == [1.0, 1.05, 1.1, 1.2]


def test_mislabelled_impacts_name_any_other_contact() -> None:
    """So many, the others alike; all else is told right."""
    told = impacts(MANY)
    found = heard(SensorModel(mislabelled=0.3), told)
    pairs = [
        (each.event.switches[0].contact, true.switches[0].contact)
        for each, true in zip(found, told, strict=True)
    ]
    assert_fraction(sum(a != b for a, b in pairs), MANY, 0.3)
    wrong = [pair for pair in set(pairs) if pair[0] != pair[1]]
    assert len(wrong) == 6
    assert stats.chisquare([pairs.count(pair) for pair in wrong]).pvalue > LEAST
    assert [each.event.stamp for each in found] == [true.instant.stamp for true in told]
    always = heard(SensorModel(mislabelled=1.0), told[:100])
    assert all(
        each.event.switches != true.switches for each, true in zip(always, told[:100], strict=True)
    )


def test_contacts_that_get_one_name_are_told_once() -> None:
    """A message names the same switch of a contact once only."""
    model = system(
        np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=[(row, 1.0, 0.5) for row in np.eye(2)]
    )
    pair = [(0, Kind.IMPACT), (1, Kind.IMPACT)]
    told = [switching(k + 1, pair, model=model) for k in range(200)]
    found = heard(SensorModel(mislabelled=0.5), told, model=model)
    assert {len(each.event.switches) for each in found} == {1, 2}
    assert all(len(set(each.event.switches)) == len(each.event.switches) for each in found)


def test_threshold_keeps_what_hits_faster() -> None:
    """Exactly: an approach as fast as the threshold is felt."""
    speeds = np.linspace(0, 2, 201)
    told = [switching(k + 1, [(0, Kind.IMPACT)], v) for k, v in enumerate(speeds)]
    found = heard(SensorModel(threshold=0.5), told)
    felt = [k for k, v in enumerate(speeds) if v >= 0.5]
    assert [(each.event.stamp - EPOCH) // NS_PER_S - 1 for each in found] == felt


def test_threshold_of_zero_feels_a_contact_that_does_not_approach() -> None:
    """One that another impact throws off is told, as ever; with any threshold it is not."""
    told = [switching(1.0, [(0, Kind.IMPACT)], speed=-0.25)]
    assert len(heard(IDEAL, told)) == 1
    assert heard(SensorModel(threshold=1e-9), told) == []


def test_transport_is_exponential_and_leaves_the_stamp() -> None:
    """Messages overtake each other; sequence numbers tell."""
    told = impacts(MANY)
    sensor = SensorModel(transport=0.6)
    found = heard(sensor, told)
    way = np.array([each.arrival - each.event.stamp for each in found]) / NS_PER_S
    assert stats.kstest(way / 0.6, "expon").pvalue > LEAST
    assert np.all(errors(sensor, told) == 0)
    arrived = simulate_sensor(
        sensor, THREE, told, epoch=EPOCH, last=told[-1].instant.stamp, seed=1
    )
    assert sorted(arrived, key=lambda each: each.arrival) == list(arrived)
    assert [each.event.sequence for each in arrived] != [each.event.sequence for each in found]


LASTING = [
    switching(1.0, [(0, Kind.IMPACT)]),
    switching(2.0, [(0, Kind.CLOSE), (1, Kind.IMPACT)]),
    switching(2.1, [(0, Kind.OPEN), (2, Kind.IMPACT)]),
    switching(3.0, [(0, Kind.CLOSE)]),
    switching(4.0, [(0, Kind.OPEN)]),
]
"""A contact that hits, closes, is thrown off, closes and lets go."""


def kinds(found: Sequence[SensorMessage]) -> list[list[tuple[str, Kind]]]:
    """Contacts and kinds of every event."""
    return [[(s.contact, s.kind) for s in each.event.switches] for each in found]


def test_sensor_of_impacts_only_never_tells_lasting_contact() -> None:
    """CLOSE is told as IMPACT, OPEN not at all; an event of OPEN alone is none."""
    assert kinds(heard(SensorModel(impacts_only=True), LASTING)) == [
        [("c1", Kind.IMPACT)],
        [("c1", Kind.IMPACT), ("c2", Kind.IMPACT)],
        [("c3", Kind.IMPACT)],
        [("c1", Kind.IMPACT)],
    ]


@pytest.mark.parametrize("sensor", [SensorModel(missed=1.0), SensorModel(threshold=2.0)])
def test_contact_whose_closing_was_not_felt_does_not_open(sensor: SensorModel) -> None:
    """Nothing is told of it at all."""
    assert heard(sensor, LASTING) == []


def test_closing_in_the_dead_time_is_lost_and_opening_in_it_is_not() -> None:
    """A CLOSE is an impact, an OPEN is none."""
    found = heard(SensorModel(dead_time=0.95), [switching(1.5, [(0, Kind.IMPACT)]), *LASTING[1:]])
    assert kinds(found) == [
        [("c1", Kind.IMPACT)],
        [("c2", Kind.IMPACT)],
        [("c3", Kind.IMPACT)],
        [("c1", Kind.CLOSE)],
        [("c1", Kind.OPEN)],
    ]
    found = heard(SensorModel(dead_time=0.5), LASTING[1:3])
    assert kinds(found)[1] == [("c1", Kind.OPEN), ("c3", Kind.IMPACT)]


def test_contact_opens_by_the_name_it_closed_by() -> None:
    """Else the one that was named by mistake would stay closed for ever."""
    told = [
        switching(k + 1, [(k // 2 % 3, Kind.OPEN if k % 2 else Kind.CLOSE)]) for k in range(600)
    ]
    found = kinds(heard(SensorModel(mislabelled=0.5), told))
    names = [
        (closed[0], opened[0]) for closed, opened in zip(found[::2], found[1::2], strict=True)
    ]
    assert all(a[0] == b[0] and b[1] is Kind.OPEN for a, b in names)
    assert sum(a[0] != told[2 * k].switches[0].contact for k, (a, _) in enumerate(names)) > 100


def test_accumulating_impacts_are_lost_to_a_dead_time_and_a_threshold() -> None:
    """A ball that comes to rest: gaps shrink, speeds too, as the closed forms say."""
    ball = system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=forcing(1, -8.0))
    # Thrown up at 4 m/s it hits after 1, 1/2, 1/4, ... s more, at 4, 2, 1, ... m/s.
    found = run(ball, [0.0], [4.0], seconds=3.0)
    assert found.events[-1].switches == (Switch("c1", Kind.CLOSE),)

    def felt(sensor: SensorModel) -> list[float]:
        return [
            (e.event.stamp - EPOCH) / NS_PER_S for e in heard(sensor, found.switchings, model=ball)
        ]

    assert felt(SensorModel(threshold=0.75)) == [1.0, 1.5, 1.75]
    assert felt(SensorModel(dead_time=0.2)) == [1.0, 1.5, 1.75, pytest.approx(1.96875)]


def test_ideal_event_is_that_of_event_of() -> None:
    """The same value from both, for whatever switches."""
    for k, each in enumerate(LASTING):
        (told,) = heard(IDEAL, LASTING)[k : k + 1]
        assert told.event == event_of(each, sequence=k + 1, episode=0, epoch=EPOCH)


def test_what_only_shifts_loads_is_not_told() -> None:
    """A switching without switches is no event and draws nothing."""
    told = impacts(6)
    silent = dataclasses.replace(told[2], instant=told[1].instant.after(0.5), switches=())
    jittered = SensorModel(jitter=0.01)
    assert heard(jittered, [*told[:2], silent, *told[2:]]) == heard(jittered, told)
