"""The replica's past: events in their places, and no more of it than is needed."""

import numpy as np
import pytest

from impact_observer.estimation.ensemble import Ensemble
from impact_observer.events import Kind
from impact_observer.observer import Belief
from impact_observer.observer.event_order import EventKey, Interpretation
from impact_observer.observer.synchronization import Synchronization
from impact_observer.observer.timeline import Entry, Timeline, initial_entry

NONE = Synchronization(-1.0, 0.0)


def first(stamp: int, x: float) -> Entry:
    """The entry of a timeline's beginning."""
    return initial_entry(stamp, Belief(Ensemble.of(np.array([[x]]))), NONE)


def step(previous: Entry, event: EventKey, reading: Interpretation) -> Entry:
    """A state that tells the whole way to it: digits of the events' stamps."""
    belief = Belief(Ensemble.of(previous.belief.replicas * 10 + event.stamp))
    return Entry(event, event.stamp, belief, NONE, (), reading.spoken)


def key(stamp: int, sequence: int = 0, contact: int = 0) -> EventKey:
    """An event's place."""
    return EventKey(stamp, sequence, ((contact, Kind.IMPACT),))


def filled(*keys: EventKey) -> Timeline:
    """A timeline from stamp 0 on with events that come in the given order."""
    timeline = Timeline(first(0, 0.0))
    for each in keys:
        timeline.insert(each, step)
    return timeline


def states(timeline: Timeline) -> list[float]:
    """The state after each entry."""
    return [float(entry.belief.x[0]) for entry in timeline.entries]


def test_late_event_is_put_in_its_place_and_the_rest_done_again() -> None:
    """The same states as if it had come in time."""
    assert states(filled(key(1), key(3), key(2))) == [0, 1, 12, 123]
    assert states(filled(key(3), key(2), key(1))) == states(filled(key(1), key(2), key(3)))


def test_equal_stamps_are_successive_by_sequence() -> None:
    """And by contact where nobody counts; never by arrival."""
    timeline = filled(key(1, 8), key(1, 7), key(1, 9))
    assert [entry.key.sequence for entry in timeline.entries[1:]] == [7, 8, 9]
    unnumbered = filled(key(1, 0, 1), key(1, 0, 0))
    assert [entry.key.switches[0][0] for entry in unnumbered.entries[1:]] == [0, 1]


def test_state_at_a_stamp_is_after_all_events_of_that_stamp() -> None:
    """At, before and after, with two events at one instant."""
    timeline = filled(key(2, 1), key(2, 2), key(5, 3))
    assert timeline.at(1).key.sequence == -1
    assert timeline.at(2).key.sequence == 2
    assert timeline.at(4).key.sequence == 2
    assert timeline.at(5).key.sequence == timeline.at(9).key.sequence == 3


def test_event_at_the_very_beginning_comes_after_the_initial_state() -> None:
    """The initial state holds before any event of its stamp."""
    timeline = filled(key(0))
    assert [entry.key.stamp for entry in timeline.entries] == [0, 0]
    assert timeline.at(0).key.switches == ((0, Kind.IMPACT),)


def test_known_event_is_recognised() -> None:
    """Only the very same one."""
    timeline = filled(key(2, 1))
    assert key(2, 1) in timeline
    assert key(2, 2) not in timeline
    assert key(2, 1, 1) not in timeline


def test_past_is_dropped_up_to_the_state_that_is_needed() -> None:
    """What is asked for after the cut has the same answer as before it."""
    timeline = filled(key(1), key(2), key(4))
    whole = [timeline.whole]
    timeline.forget_before(3)
    assert states(timeline) == [12, 124]
    assert timeline.start == key(2)
    assert [*whole, timeline.whole] == [True, False]
    assert timeline.at(3).belief.x[0] == 12
    timeline.forget_before(-5)
    assert states(timeline) == [12, 124]


def test_beginning_elsewhere_does_everything_again() -> None:
    """Events before the new beginning are gone, those after it follow the new state."""
    timeline = filled(key(1), key(3), key(4))
    timeline.begin(first(2, 5.0), step)
    assert states(timeline) == [5, 53, 534]


def test_step_that_fails_leaves_the_past_as_it_was() -> None:
    """The event is not in it, nor is any state changed."""
    timeline = filled(key(1), key(3))
    kept = states(timeline)

    def failing(previous: Entry, event: EventKey, reading: Interpretation) -> Entry:
        if event.stamp == 3:
            raise ArithmeticError
        return step(previous, event, reading)

    with pytest.raises(ArithmeticError):
        timeline.insert(key(2), failing)
    assert states(timeline) == kept
    assert key(2) not in timeline


def test_rehearsed_entry_is_the_latest_once_more_and_is_not_kept() -> None:
    """Made from the entry before it, by one step; the timeline is what it was."""
    timeline = filled(key(1), key(2), key(4))
    kept, asked = [*timeline.entries], []

    def counted(previous: Entry, event: EventKey, reading: Interpretation) -> Entry:
        asked.append((previous, event))
        return step(previous, event, reading)

    made = timeline.rehearsed(counted)
    assert made is not None
    assert asked == [(kept[-2], key(4))]
    assert made is not kept[-1]
    assert (made.key, made.belief.x.tolist()) == (key(4), [124.0])
    assert timeline.entries == kept


def test_nothing_is_rehearsed_where_an_event_was_not_made_by_one_step_alone() -> None:
    """Before the first one, beside another of its stamp, and of one that does nothing."""
    stale = EventKey(4, 1, ((0, Kind.OPEN),))
    timelines = [filled(), filled(key(2), key(2, 0, 1)), filled(key(2, 7), stale)]
    timelines[2].forget_before(3)
    assert [len(each.entries) for each in timelines] == [1, 3, 2]
    assert timelines[2].entries[-1].since == 2
    assert [each.rehearsed(step) for each in timelines] == [None, None, None]
