# SPDX-License-Identifier: Apache-2.0
"""A simulated sensor as a stream, with all faults at once; faults are independent."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensing import FULL, THREE, impacts, switching
from systems import EPOCH, examples

from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.plant import (
    IDEAL,
    SensorMessage,
    SensorModel,
    SensorSimulation,
    Switching,
    simulate_sensor,
)
from impact_observer.stamps import NS_PER_S


@st.composite
def runs(draw: st.DrawFn) -> list[Switching]:
    """Any sequence of switchings of three contacts, each of which closes before it opens."""
    switchings, seconds = [], 0.0
    closed: set[int] = set()
    for _ in range(draw(st.integers(0, 12))):
        seconds += draw(st.integers(0, 64)) / 64
        which = sorted(draw(st.sets(st.integers(0, 2), min_size=1)))
        pairs = []
        for i in which:
            free = st.sampled_from([Kind.IMPACT, Kind.CLOSE])
            kind = Kind.OPEN if i in closed else draw(free)
            closed = closed - {i} if kind is Kind.OPEN else closed | ({i} if kind else set())
            pairs.append((i, kind))
        switchings.append(switching(seconds, pairs, draw(st.integers(-8, 64)) / 32))
    return switchings


def values(name: str) -> st.SearchStrategy[float | bool]:
    """Ideal, or as in ``FULL``."""
    return st.sampled_from([getattr(IDEAL, name), FULL[name]])


sensors = st.builds(SensorModel, **{name: values(name) for name in FULL})


def last_of(switchings: Sequence[Switching]) -> int:
    """The end of a run, 1 s after its last switching."""
    return max([EPOCH, *(each.instant.stamp for each in switchings)]) + NS_PER_S


@given(runs(), sensors, st.integers(0, 5), st.lists(st.integers(1, 400), max_size=30))
@examples(40)
def test_streaming_gives_the_events_of_the_whole_run(
    switchings: list[Switching], sensor: SensorModel, seed: int, waits: list[int]
) -> None:
    """For any instants of ``due``; nothing arrives before ``next_stamp`` or is lost."""
    last = last_of(switchings)
    whole = simulate_sensor(sensor, THREE, switchings, epoch=EPOCH, last=last, seed=seed)
    simulation = SensorSimulation(sensor, THREE, epoch=EPOCH, last=last, seed=seed)
    now, left, found = EPOCH - 1, list(switchings), list[SensorMessage]()
    for wait in [*waits, 10**6]:
        now += wait * 10_000_000
        while left and left[0].instant.stamp <= now:
            simulation.detect(left.pop(0))
        expected = simulation.next_stamp
        arrived = simulation.due(now)
        assert all(expected is not None and expected <= each.arrival <= now for each in arrived)
        found += arrived
    assert simulation.next_stamp is None
    assert tuple(found) == whole


@given(runs(), sensors, st.integers(0, 5))
@examples(40)
def test_events_are_consistent_for_every_sensor(
    switchings: list[Switching], sensor: SensorModel, seed: int
) -> None:
    """Numbered without gaps, arriving in order, stamped above zero; no OPEN without CLOSE."""
    found = simulate_sensor(
        sensor, THREE, switchings, epoch=EPOCH, last=last_of(switchings), seed=seed, episode=2
    )
    assert [each.arrival for each in found] == sorted(each.arrival for each in found)
    counted = sorted(found, key=lambda each: each.event.sequence)
    assert [each.event.sequence for each in counted] == list(range(1, len(found) + 1))
    assert all(each.event.stamp > 0 and each.event.switches for each in found)
    assert {(each.event.episode, each.event.epoch) for each in found} <= {(2, EPOCH)}
    closed: dict[str, int] = {}
    for switch in (switch for each in counted for switch in each.event.switches):
        change = {Kind.IMPACT: 0, Kind.CLOSE: 1, Kind.OPEN: -1}[switch.kind]
        closed[switch.contact] = closed.get(switch.contact, 0) + change
        assert closed[switch.contact] >= 0
        assert not (sensor.impacts_only and change)


def content(each: SensorMessage) -> tuple[int, tuple[Switch, ...], int]:
    """A message without its sequence number."""
    return each.event.stamp, each.event.switches, each.arrival


def unchanged(
    *kept: Callable[[SensorMessage], object],
) -> Callable[[list[SensorMessage], list[SensorMessage]], bool]:
    """Whether two runs agree, event by event, in what is ``kept``."""
    return lambda without, with_it: (
        [tuple(k(e) for k in kept) for e in without]
        == [tuple(k(e) for k in kept) for e in with_it]
    )


def fewer(without: list[SensorMessage], with_it: list[SensorMessage]) -> bool:
    """Whether a fault removed switches, and changed nothing else."""
    left, there = (
        Counter((e.event.stamp, e.arrival, switch) for e in found for switch in e.event.switches)
        for found in (with_it, without)
    )
    return not left - there


def impacts_in(found: list[SensorMessage]) -> list[SensorMessage]:
    """The same without OPEN, and with CLOSE as IMPACT."""
    events = [
        dataclasses.replace(
            each.event,
            switches=tuple(
                Switch(s.contact) for s in each.event.switches if s.kind is not Kind.OPEN
            ),
        )
        for each in found
    ]
    return [each._replace(event=event) for each, event in zip(found, events, strict=True)]


def switches_of(each: SensorMessage) -> object:
    """The switches of a message."""
    return each.event.switches


def arrival_of(each: SensorMessage) -> object:
    """When a message is received."""
    return each.arrival


def event_alone(each: SensorMessage) -> ImpactEvent:
    """The event of a message."""
    return each.event


def count_of(each: SensorMessage) -> object:
    """Its number and stamp."""
    return each.event.sequence, each.event.stamp


CHANGES: dict[str, Callable[[list[SensorMessage], list[SensorMessage]], bool]] = {
    "delay": unchanged(switches_of),
    "jitter": unchanged(switches_of, arrival_of),
    "quantisation": unchanged(switches_of, arrival_of),
    "clock_offset": unchanged(switches_of, arrival_of),
    "clock_drift": unchanged(switches_of, arrival_of),
    "transport": unchanged(event_alone),
    "mislabelled": unchanged(count_of, arrival_of),
    "impacts_only": lambda without, with_it: fewer(impacts_in(without), impacts_in(with_it)),
    "dead_time": fewer,
    "missed": fewer,
    "threshold": fewer,
    "spurious": lambda without, with_it: set(map(content, without)) <= set(map(content, with_it)),
}
"""What each fault leaves unchanged, whatever the other faults."""


@pytest.mark.parametrize("name", CHANGES)
@given(runs(), sensors, st.integers(0, 5))
@examples(12)
def test_a_fault_changes_no_draw_of_another(
    name: str, switchings: list[Switching], sensor: SensorModel, seed: int
) -> None:
    """Each fault has its own effect only; dead time is left out, as it couples faults."""
    off: dict[str, Any] = {"dead_time": 0.0, name: getattr(IDEAL, name)}
    without = dataclasses.replace(sensor, **off)
    with_it = dataclasses.replace(without, **{name: FULL[name]})
    last = last_of(switchings)
    found = [
        sorted(
            simulate_sensor(each, THREE, switchings, epoch=EPOCH, last=last, seed=seed),
            key=lambda message: message.event.sequence,
        )
        for each in (without, with_it)
    ]
    assert CHANGES[name](*found)


def test_every_episode_has_its_own_draws() -> None:
    """So has every seed; equal seeds and episodes have equal draws."""
    switchings = impacts(20)
    last = switchings[-1].instant.stamp

    def stamps(seed: int, episode: int) -> list[int]:
        found = simulate_sensor(
            SensorModel(jitter=0.01),
            THREE,
            switchings,
            epoch=EPOCH,
            last=last,
            seed=seed,
            episode=episode,
        )
        return [each.event.stamp for each in found]

    assert stamps(1, 0) == stamps(1, 0)
    assert not {*stamps(1, 0)} & {*stamps(1, 1)}
    assert not {*stamps(1, 0)} & {*stamps(2, 0)}
