# SPDX-License-Identifier: Apache-2.0
"""The timeline: events in order, kept as long as they are needed."""

from dataclasses import replace

import numpy as np
import pytest

from impact_observer.events import Kind
from impact_observer.observer import Belief
from impact_observer.observer.ensemble import Ensemble
from impact_observer.observer.event_order import EventKey, OverruledSwitch, Superseding
from impact_observer.observer.synchronization import Synchronization
from impact_observer.observer.timeline import Entry, Timeline, initial_entry

NONE = Synchronization(-1.0, 0.0)


def first(stamp: int, x: float) -> Entry:
    """The first entry of a timeline."""
    return initial_entry(stamp, Belief(Ensemble.of(np.array([[x]]))), NONE)


def update(previous: Entry, event: EventKey, superseding: Superseding) -> Entry:
    """A state whose digits are the stamps of all earlier events."""
    del superseding
    belief = Belief(Ensemble.of(previous.belief.replicas * 10 + event.stamp))
    return Entry(event, event.stamp, belief, NONE)


def key(stamp: int, sequence: int = 0, contact: int = 0) -> EventKey:
    """An impact of one contact."""
    return EventKey(stamp, sequence, ((contact, Kind.IMPACT),))


def filled(*keys: EventKey) -> Timeline:
    """A timeline from stamp 0 on with events that come in the given order."""
    timeline = Timeline(first(0, 0.0), update)
    for each in keys:
        timeline.insert(each)
    return timeline


def states(timeline: Timeline) -> list[float]:
    """The state after each entry."""
    return [float(entry.belief.x[0]) for entry in timeline.entries]


def test_equal_stamps_are_successive_by_sequence() -> None:
    """And by contact where there are no numbers; never by arrival."""
    timeline = filled(key(1, 8), key(1, 7), key(1, 9))
    assert [entry.key.sequence for entry in timeline.entries[1:]] == [7, 8, 9]
    unnumbered = filled(key(1, 0, 1), key(1, 0, 0))
    assert [entry.key.switches[0][0] for entry in unnumbered.entries[1:]] == [0, 1]


def test_event_at_the_start_comes_after_the_initial_state() -> None:
    """The initial state holds before any event of its stamp."""
    timeline = filled(key(0))
    assert [entry.key.stamp for entry in timeline.entries] == [0, 0]
    assert timeline.entry_at(0).key.switches == ((0, Kind.IMPACT),)


def test_timeline_recognises_its_events() -> None:
    """Equal stamps with another sequence number or contact are new events."""
    timeline = filled(key(2, 1))
    assert key(2, 1) in timeline
    assert key(2, 2) not in timeline
    assert key(2, 1, 1) not in timeline


def test_cut_keeps_the_states_after_it() -> None:
    """States after the cut are the same as before."""
    timeline = filled(key(1), key(2), key(4))
    was_complete = [timeline.is_complete]
    timeline.forget_before(3, 100)
    assert states(timeline) == [12, 124]
    assert timeline.start == key(2)
    assert [*was_complete, timeline.is_complete] == [True, False]
    assert timeline.entry_at(3).belief.x[0] == 12
    timeline.forget_before(-5, 100)
    assert states(timeline) == [12, 124]


def test_update_that_fails_leaves_the_timeline_unchanged() -> None:
    """The event is not in it, nor is any state changed."""

    def failing(previous: Entry, event: EventKey, superseding: Superseding) -> Entry:
        if event.stamp == 3 and previous.key.stamp == 2:
            raise ArithmeticError
        return update(previous, event, superseding)

    timeline = Timeline(first(0, 0.0), failing)
    timeline.insert(key(1))
    timeline.insert(key(3))
    kept = states(timeline)
    with pytest.raises(ArithmeticError):
        timeline.insert(key(2))
    assert states(timeline) == kept
    assert key(2) not in timeline


def test_events_of_one_stamp_are_applied_once_each() -> None:
    """Only what a CLOSE supersedes, and what follows it, is applied again."""
    applied: list[EventKey] = []

    def counted(previous: Entry, event: EventKey, superseding: Superseding) -> Entry:
        applied.append(event)
        overruled = tuple(OverruledSwitch(c, Kind.IMPACT, None, by) for c, by in superseding)
        return replace(update(previous, event, superseding), overruled=overruled)

    timeline = Timeline(first(0, 0.0), counted)
    hits = [key(5, k) for k in range(1, 100)]
    for each in hits:
        timeline.insert(each)
    assert applied == hits
    timeline.insert(key(5, 100, 1))
    closing = EventKey(5, 101, ((1, Kind.CLOSE),))
    timeline.insert(closing)
    timeline.insert(closing._replace(sequence=102))
    assert [each.sequence for each in applied[99:]] == [100, 100, 101, 102]
