# SPDX-License-Identifier: Apache-2.0
"""The timeline: events in order, kept as long as they are needed."""

import pytest
from tracing_law import traced, value

from impact_observer.errors import ImpactLawError
from impact_observer.events import Contacts, Kind
from impact_observer.observer.event_order import EventKey
from impact_observer.observer.timeline import Timeline


def key(stamp: int, sequence: int = 0, contact: int = 0) -> EventKey:
    """An impact of one contact."""
    return EventKey(stamp, sequence, ((contact, Kind.IMPACT),))


def filled(*keys: EventKey, history: int = 1000) -> Timeline:
    """A timeline from stamp 0 on with events that come in the given order."""
    timeline = traced(history)
    for each in keys:
        *_, _ = timeline.inserting([each])
    return timeline


def states(timeline: Timeline) -> list[int]:
    """The state after each entry."""
    return [value(entry) for entry in timeline.entries]


def test_equal_stamps_are_successive_by_sequence() -> None:
    """And by contact where there are no numbers; never by arrival."""
    timeline = filled(key(1, 8), key(1, 7), key(1, 9))
    assert [entry.key.sequence for entry in timeline.entries[1:]] == [7, 8, 9]
    unnumbered = filled(key(1, 0, 1), key(1, 0, 0))
    assert [entry.key.switches[0][0] for entry in unnumbered.entries[1:]] == [0, 1]


@pytest.mark.parametrize(
    ("kinds", "closed"),
    [
        ([(1, 8, Kind.CLOSE), (2, 7, Kind.IMPACT)], (0,)),
        ([(1, 9, Kind.OPEN), (2, 8, Kind.CLOSE)], ()),
        ([(1, 8, Kind.CLOSE), (2, 7, Kind.OPEN)], (0,)),
        ([(1, 8, Kind.CLOSE), (2, 9, Kind.IMPACT)], ()),
    ],
)
def test_of_switches_that_jitter_swaps_the_highest_number_holds(
    kinds: list[tuple[int, int, Kind]], closed: Contacts
) -> None:
    """An impact before a closing, and a closing before an opening, whatever their stamps."""
    timeline = filled(*(EventKey(at, number, ((0, kind),)) for at, number, kind in kinds))
    assert timeline.entries[-1].closed == closed


def test_the_past_is_as_long_as_the_history() -> None:
    """States after it are the same as before; events of its very start are too late."""
    whole = states(filled(key(1), key(2), key(4)))
    timeline = filled(key(1), key(2), history=2)
    assert timeline.is_complete
    *_, _ = timeline.inserting([key(4)])
    assert states(timeline) == whole[2:]
    assert (timeline.start, timeline.is_complete) == (2, False)
    assert value(timeline.entry_at(3)) == whole[2]
    assert [timeline.accepts(key(stamp, 9)) for stamp in (1, 2, 3, 4)] == [
        False,
        False,
        True,
        True,
    ]


def test_an_event_that_cannot_be_applied_has_no_effect() -> None:
    """Its entry has the error, and later events act as without it."""
    timeline = filled(key(5), key(7), key(8))
    before, failed = timeline.entries[1:3]
    assert isinstance(failed.error, ImpactLawError)
    assert (value(failed), failed.last) == (value(before), (5, 0))
    assert states(timeline)[-1] == states(filled(key(5), key(8)))[-1]
