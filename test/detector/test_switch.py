# SPDX-License-Identifier: Apache-2.0
"""Contact switches: edges, chatter, impacts and persistent contact."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from signals import MS, START, Scalar, detections, events, every, sampled, switch
from systems import examples, sample

from impact_observer.detector import Detection, Detector, Source
from impact_observer.detector.sensors import MAX_DELAY
from impact_observer.events import Kind
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import grid

Changes = list[tuple[int, float]]


def changes(*milliseconds: float, first: float = 1.0) -> Changes:
    """A switch that publishes on change: closed, open, closed, ... at these times."""
    return [
        (START + round(t * MS), first if k % 2 == 0 else 1.0 - first)
        for k, t in enumerate(milliseconds)
    ]


def at(milliseconds: float) -> int:
    """The stamp at so many milliseconds."""
    return START + round(milliseconds * MS)


FORCE = [9.9, 10.0, 7.0, 6.0, 12.0, 5.9, 9.0]
IMPACT, CLOSE, OPEN = Kind
CLOSURES: dict[str, tuple[Source, Changes, list[tuple[float, Kind]]]] = {
    "short": (switch(), changes(10, 15, 400, 405), [(10, IMPACT), (400, IMPACT)]),
    "long": (
        switch(),
        [*changes(10), (at(60), 1.0), (at(90), 1.0), (at(200), 0.0)],
        [(10, IMPACT), (10, CLOSE), (200, OPEN)],
    ),
    "closed from the first message on, where the gap is zero": (
        switch(),
        [(at(0), 1.0), (at(100), 1.0)],
        [(0, IMPACT), (0, CLOSE)],
    ),
    "without a least duration": (
        switch(min_contact_duration=0.0),
        changes(10, 20, 30, 31),
        [(10, CLOSE), (20, OPEN), (30, CLOSE), (31, OPEN)],
    ),
    "a level at the end of the dead time": (
        switch(min_contact_duration=0.02),
        changes(0, 50, 53),
        [(0, IMPACT), (0, CLOSE), (50, OPEN), (53, IMPACT), (53, CLOSE)],
    ),
    "a force with hysteresis, closed from 10 N on and open below 6 N": (
        switch(kind="switch", threshold=10.0, hysteresis=4.0),
        sampled(every(100 * MS, 7), np.array(FORCE)),
        [(100, IMPACT), (100, CLOSE), (500, OPEN)],
    ),
}
"""A switch, its changes, and the events at so many milliseconds."""


@pytest.mark.parametrize("name", CLOSURES)
def test_a_closure_is_an_impact_or_lasting_contact_by_its_length(name: str) -> None:
    """Events have the stamps of their edges and follow each other in number."""
    source, signal, wanted = CLOSURES[name]
    detected = detections(source, signal, at(1000))
    assert events(detected) == [(at(t), kind) for t, kind in wanted]
    assert [d.event.sequence for d in detected] == [*range(1, len(wanted) + 1)]


def test_an_event_is_decided_as_soon_as_it_is_certain() -> None:
    """An impact at once, lasting contact at its least duration, an edge after the dead time."""
    for name, decided in (("short", [10, 400]), ("long", [10, 60, 200])):
        source, signal, _ = CLOSURES[name]
        assert [d.decided for d in detections(source, signal)] == [*map(at, decided)]
    source, signal, _ = CLOSURES["a level at the end of the dead time"]
    assert detections(source, signal, at(200))[3].decided == at(55) + MAX_DELAY


def test_a_switch_without_messages_while_closed_is_a_persistent_contact() -> None:
    """Messages on change only: the deadline is over when no message can be on its way any more."""
    detector = Detector([switch()])
    assert len(detector.feed(0, Scalar(1.0), at(10))) == 1
    assert detector.advance(at(60) + MAX_DELAY - 1) == []
    detected = detector.advance(at(500))
    assert events(detected) == [(at(10), Kind.CLOSE)]
    assert detected[0].decided == at(60) + MAX_DELAY
    assert events(detector.feed(0, Scalar(0.0), at(600))) == [(at(600), Kind.OPEN)]


def test_a_normally_closed_switch_opens_at_a_hit() -> None:
    """An inverted switch has the same events; open before its first impact is no event."""
    usual = detections(switch(), [(START, 0.0), *changes(10, 15, 100, 300)], at(400))
    turned = [(START, 1.0), *changes(10, 15, 100, 300, first=0.0)]
    assert detections(switch(inverted=True), turned, at(400)) == usual
    assert len(usual) == 4


def test_releases_no_longer_than_the_dead_time_are_counted() -> None:
    """A contact that drops out for 3 ms hits again; one that opens for 50 ms does not count."""
    detector = Detector([switch()])
    for stamp, value in [(START, 0.0), *changes(100, 200, 203, 300, 350, 500)]:
        detector.advance(stamp)
        detector.feed(0, Scalar(value), stamp)
    detector.advance(at(5000))
    assert detector.counts[0].short_releases == 1
    assert detector.counts[0].impacts == 3


@pytest.mark.parametrize("seed", range(5))
def test_chatter_of_closing_and_of_opening_is_one_edge_each(seed: int) -> None:
    """Contacts bounce for up to four milliseconds, with a dozen edges."""
    times = np.sort(np.random.default_rng(seed).uniform(0, 4, 12))
    closing, opening = 10 + times, 200 + times[:-1]
    signal = changes(10, *closing, *opening)
    detected = detections(switch(), [*signal, (at(500), 0.0)], at(600))
    assert [kind for _, kind in events(detected)] == [Kind.IMPACT, Kind.CLOSE, Kind.OPEN]
    assert [stamp for stamp, _ in events(detected)] == [at(10), at(10), signal[13][0]]


@pytest.mark.parametrize("rate", [0, 100, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_switch_that_closes_for_milliseconds_at_each_impact_gives_impacts_only(
    rate: int,
) -> None:
    """Stamps of closures of 5 ms are exact on change, and within a period if polled."""
    model = sample("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=START)
    run = simulate(plant, grid(START, START + 30_000 * MS, 1.0))
    impacts = np.array([event.stamp for event in run.events])
    assert len(impacts) > 10
    assert np.diff(impacts).min() > 20 * MS
    signal = sorted(
        [(s, 1.0) for s in impacts.tolist()] + [(s + 5 * MS, 0.0) for s in impacts.tolist()]
    )
    if rate:  # at 100 Hz half of the closures of 5 ms fall between two samples
        stamps = grid(START, START + 31_000 * MS, rate)
        before = np.searchsorted(impacts, stamps, side="right") - 1
        closed = (before >= 0) & (stamps < impacts[before] + 5 * MS)
        signal = sampled(stamps, closed.astype(float))
    detected = events(detections(switch(), signal, START + 32_000 * MS))
    assert {kind for _, kind in detected} == {Kind.IMPACT}
    seen = np.array([stamp for stamp, _ in detected])
    late = seen - impacts[np.searchsorted(impacts, seen, side="right") - 1]
    assert late.max() <= (min(1_000_000_000 // rate, 5 * MS) if rate else 0)
    assert len(detected) == len(impacts) if rate != 100 else 0 < len(detected) < len(impacts)


CHANGES = st.lists(st.integers(1, 80 * MS), min_size=1, max_size=30).map(
    lambda steps: [
        (START + int(t), float((k + 1) % 2))
        for k, t in enumerate(np.cumsum(steps, dtype=np.int64))
    ]
)


@examples(60)
@given(CHANGES)
def test_without_dead_time_each_closure_is_detected_once_by_its_length(signal: Changes) -> None:
    """Closures of any length lose no event and cause no spurious event."""
    end = signal[-1][0] + 1000 * MS
    wanted: list[tuple[int, Kind]] = []
    for (stamp, value), (until, _) in pairwise([*signal, (end, 0.0)]):
        if value:
            wanted += [(stamp, Kind.IMPACT)]
            if until - stamp >= 50 * MS:
                wanted += [(stamp, Kind.CLOSE)]
                wanted += [(until, Kind.OPEN)] if until < end else []
    assert events(detections(switch(dead_time=0.0), signal, end)) == wanted


@examples(60)
@given(CHANGES, st.lists(st.integers(0, 3000 * MS), max_size=30))
def test_detections_do_not_depend_on_when_time_is_advanced(
    signal: Changes, looks: list[int]
) -> None:
    """A timer, other topics or nothing between the messages: the same detections."""
    detector = Detector([switch()])
    detected: list[Detection] = []
    pending = sorted(START + look for look in looks)
    for stamp, value in signal:
        while pending and pending[0] <= stamp:
            detected += detector.advance(pending.pop(0))
        detected += detector.feed(0, Scalar(value), stamp)
    end = signal[-1][0] + 1000 * MS
    detected += detector.advance(end)
    assert detected == detections(switch(), signal, end)


@examples(50)
@given(CHANGES, st.integers(0, 20))
def test_detected_edges_have_the_dead_time_between_them(signal: Changes, dead_time: int) -> None:
    """Every detected edge is an edge of the signal."""
    source = switch(dead_time=dead_time / 1000, min_contact_duration=0.0)
    detected = events(detections(source, signal, signal[-1][0] + 1000 * MS))
    assert all(kind == (Kind.CLOSE, Kind.OPEN)[k % 2] for k, (_, kind) in enumerate(detected))
    values = dict(signal)
    assert all(values[stamp] == (kind is Kind.CLOSE) for stamp, kind in detected)
    assert detected[-1][1] == (Kind.OPEN, Kind.CLOSE)[int(signal[-1][1])] if detected else True
