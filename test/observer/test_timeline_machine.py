# SPDX-License-Identifier: Apache-2.0
"""The timeline against a trivial reference: all events sorted, and applied from the beginning."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)
from systems import examples

from impact_observer.errors import DynamicsError
from impact_observer.events import Kind
from impact_observer.observer import Belief
from impact_observer.observer.ensemble import Ensemble
from impact_observer.observer.event_order import EventKey, OverruledSwitch, Superseding
from impact_observer.observer.synchronization import Synchronization
from impact_observer.observer.timeline import Entry, Timeline, initial_entry, outcome

KEYS = st.builds(
    EventKey,
    st.integers(0, 12),
    st.integers(0, 4),
    st.sampled_from(
        [
            *(((0, Kind.IMPACT),), ((1, Kind.IMPACT),), ((0, Kind.CLOSE),), ((1, Kind.CLOSE),)),
            *(((0, Kind.IMPACT), (1, Kind.IMPACT)), ((0, Kind.CLOSE), (1, Kind.OPEN))),
        ]
    ),
    st.just(()),
)
NONE = Synchronization(-1.0, 0.0)


def update(previous: Entry, event: EventKey, superseding: Superseding) -> Entry:
    """A number in which each event, and what supersedes it, leave their trace.

    7 after 5 fails, and 9 after some of the numbers.
    """
    before = int(previous.belief.x[0])
    if event.stamp == 7 and previous.key.stamp == 5:
        raise DynamicsError("no solution")
    if event.stamp == 9 and before % 5 == 0:
        raise DynamicsError("no solution after this one")
    trace = hash((event, tuple(sorted(superseding)))) % 97
    belief = Belief(Ensemble.of(np.array([[float((31 * before + trace) % 1_000_003)]])))
    overruled = tuple(OverruledSwitch(c, Kind.IMPACT, None, by) for c, by in superseding)
    return Entry(event, event.stamp, belief, NONE, overruled=overruled)


def beginning() -> Entry:
    """The entry before all events."""
    return initial_entry(0, Belief(Ensemble.of(np.array([[1.0]]))), NONE)


def value(entry: Entry) -> float:
    """The state after an event."""
    return float(entry.belief.x[0])


class TimelineMachine(RuleBasedStateMachine):
    """Events in any order, alone or together; the past is forgotten or begun again.

    Attributes:
        checked: how often the states were compared.
    """

    checked = 0

    @initialize()
    def start(self) -> None:
        """Nothing has come."""
        self.timeline = Timeline(beginning(), update)
        self.first, self.keys = beginning(), list[EventKey]()

    def replayed(self, keys: Sequence[EventKey]) -> list[float]:
        """The states after all of ``keys``, sorted and applied from the beginning."""
        ordered, entry, found = sorted(keys), self.first, [value(self.first)]
        for i, key in enumerate(ordered):
            same = [k for k in range(len(ordered)) if ordered[k].stamp == key.stamp and k != i]
            chosen = [ordered[k] for k in same if k > i or not key.sequence]
            closing = [
                (contact, [e.sequence for e in chosen if (contact, Kind.CLOSE) in e.switches])
                for contact, kind in key.switches
                if kind is Kind.IMPACT
            ]
            entry = update(entry, key, [(contact, by[0]) for contact, by in closing if by])
            found.append(value(entry))
        return found

    def is_possible(self, keys: Sequence[EventKey]) -> bool:
        """Whether all of ``keys`` can be applied."""
        try:
            self.replayed(keys)
        except DynamicsError:
            return False
        return True

    @rule(key=KEYS)
    def insert(self, key: EventKey) -> None:
        """One event; what fails changes nothing."""
        if not self.timeline.accepts(key) or key in self.timeline:
            return
        try:
            self.timeline.insert(key)
        except DynamicsError:
            assert not self.is_possible([*self.keys, key])
        else:
            self.keys.append(key)

    @rule(keys=st.lists(KEYS, min_size=1, max_size=5, unique=True))
    def insert_together(self, keys: list[EventKey]) -> None:
        """Several; those that cannot be applied are left out, and no others need be."""
        new = [k for k in keys if self.timeline.accepts(k) and k not in self.timeline]
        if not new:
            return
        made = outcome(self.timeline.inserting(new))
        assert sorted([*made.failed, *(each.entry.key for each in made.insertions)]) == sorted(new)
        assert not made.failed or not self.is_possible([*self.keys, *new])
        self.keys += [key for key in new if key not in made.failed]

    @rule(stamp=st.integers(0, 12), most=st.integers(1, 20))
    def forget(self, stamp: int, most: int) -> None:
        """What is left has the states that it had."""
        self.timeline.forget_before(stamp, most)
        oldest = self.timeline.entries[0]
        if not self.timeline.is_complete:
            self.first = oldest
            self.keys = [key for key in self.keys if key > oldest.key]

    @rule(stamp=st.integers(0, 12))
    def begin_again(self, stamp: int) -> None:
        """A state that holds after the events of its stamp."""
        first = initial_entry(stamp, Belief(Ensemble.of(np.array([[5.0]]))), NONE)
        keys = [key for key in self.keys if key.stamp > stamp]
        if stamp < self.timeline.start.stamp:
            return
        with suppress(DynamicsError):  # then nothing changes
            self.timeline.restart(first, after=True)
            self.first, self.keys = first, keys

    @invariant()
    def states_are_those_of_the_reference(self) -> None:
        """After every step, at every entry, and at every stamp."""
        TimelineMachine.checked += 1
        wanted = self.replayed(self.keys)
        assert [value(entry) for entry in self.timeline.entries] == wanted
        ordered = sorted(self.keys)
        for stamp in range(self.timeline.start.stamp, 14):
            count = sum(key.stamp <= stamp for key in ordered)
            assert value(self.timeline.entry_at(stamp)) == wanted[count]


def test_any_steps_lead_to_the_states_of_the_reference() -> None:
    """Of a timeline that was given events in any order, cut and begun again."""
    run_state_machine_as_test(  # type: ignore[no-untyped-call]
        TimelineMachine, settings=examples(24)
    )
    assert TimelineMachine.checked > 100
