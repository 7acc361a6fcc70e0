# SPDX-License-Identifier: Apache-2.0
"""The timeline against a trivial reference: all events sorted, and applied from the beginning."""

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
from tracing_law import SYSTEM, TracingLaw, traced, value

from impact_observer.errors import ImpactLawError
from impact_observer.events import Kind
from impact_observer.observer import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.event_order import EventKey

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
LAW = TracingLaw(SYSTEM)


class TimelineMachine(RuleBasedStateMachine):
    """Events in any order, alone or together; the past is forgotten or begun again.

    Attributes:
        checked: how often the states were compared.
    """

    checked = 0

    @initialize(history=st.sampled_from([6, 100]))
    def start(self, history: int) -> None:
        """Nothing has come."""
        self.timeline = traced(history)
        self.first, self.closed = self.timeline.entries[0].belief, tuple[int, ...]()
        self.numbers = dict[int, int]()
        self.keys = list[EventKey]()

    def replayed(self) -> list[tuple[Belief, tuple[int, ...], dict[int, int]]]:
        """Belief, closed contacts and their numbers after all events, applied in order."""
        found = [(self.first, self.closed, self.numbers)]
        for key in sorted(self.keys):
            closing = {
                (i, Kind.IMPACT)
                for other in self.keys
                for i, kind in other.switches
                if other.stamp == key.stamp and kind is Kind.CLOSE
            }
            (belief, closed, before), switches = found[-1], list[tuple[int, Kind]]()
            numbers = dict(before)
            for i, kind in key.switches:
                if (i, kind) in closing:
                    continue
                if 0 < key.sequence < before.get(i, 0):  # a later event has closed or opened it
                    switches += [(i, Kind.IMPACT)] if kind is Kind.CLOSE else []
                    continue
                switches.append((i, kind))
                numbers |= {i: key.sequence} if kind is not Kind.IMPACT else {}
            if switches:
                change = ContactChange.of(
                    0.0, closed, switches, stamp=key.stamp, sequence=key.sequence
                )
                with suppress(ImpactLawError):
                    belief, closed = LAW.correct(change, belief), change.closed
            found.append((belief, closed, numbers))
        return found

    @rule(keys=st.lists(KEYS, min_size=1, max_size=5, unique=True))
    def insert(self, keys: list[EventKey]) -> None:
        """One event or several."""
        new = [k for k in keys if self.timeline.accepts(k) and k not in self.timeline]
        if not new:
            return
        *_, made = self.timeline.inserting(new)
        assert {*new} <= {entry.key for entry in made}
        self.keys += new
        self.forget()

    def forget(self) -> None:
        """Take over the start of the past; what is left has the states that it had."""
        every, start = sorted(self.keys), self.timeline.entries[0].key
        before = sum(key < start for key in every)
        self.first, self.closed, self.numbers = self.replayed()[before]
        self.keys = every[before:]

    @rule(stamp=st.integers(0, 12))
    def set_state(self, stamp: int) -> None:
        """A state that holds after the events of its stamp."""
        if stamp < self.timeline.start:
            return
        self.closed = self.timeline.entry_at(stamp).closed
        self.numbers = dict(self.timeline.entry_at(stamp).last_switches)
        self.timeline.set_state(np.array([[5.0, float(stamp)]]), np.zeros((2, 2)), stamp)
        self.first = self.timeline.entries[0].belief
        self.keys = [key for key in self.keys if key.stamp > stamp]

    @invariant()
    def states_are_those_of_the_reference(self) -> None:
        """After every step, at every entry, and at every stamp."""
        TimelineMachine.checked += 1
        wanted = [int(belief.x[0]) for belief, *_ in self.replayed()]
        assert [value(entry) for entry in self.timeline.entries] == wanted
        ordered = sorted(self.keys)
        for stamp in range(self.timeline.start, 14):
            count = sum(key.stamp <= stamp for key in ordered)
            assert value(self.timeline.entry_at(stamp)) == wanted[count]


def test_any_steps_lead_to_the_states_of_the_reference() -> None:
    """Of a timeline that was given events in any order, cut and begun again."""
    run_state_machine_as_test(  # type: ignore[no-untyped-call]
        TimelineMachine, settings=examples(24)
    )
    assert TimelineMachine.checked > 100
