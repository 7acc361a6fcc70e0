# SPDX-License-Identifier: Apache-2.0
"""Faulty event streams: late, duplicate, missing, and edges that are reported twice."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import EPOCH, PRESSED, event, examples, observer, reachable, switching, system

from impact_observer.compare.comparison import impacts_in
from impact_observer.errors import ImpactLawError
from impact_observer.events import ImpactEvent, Kind, Remark, Ruling, Switch, Verdict
from impact_observer.observer import Observer
from impact_observer.observer.event_order import impacts_of
from impact_observer.observer.laws import BUILT_IN
from impact_observer.stamps import NS_PER_S

LAWS = pytest.mark.parametrize("law", BUILT_IN)
UNILATERAL_SLOW = pytest.mark.parametrize(
    "law",
    [pytest.param(law, marks=pytest.mark.long if law == "unilateral" else ()) for law in BUILT_IN],
)
START = [0.3, -0.4, 1.0, -2.0]
TICK = NS_PER_S // 64
SPAN = 2 * 64
"""Length of a stream, in ticks."""
STAMPS = EPOCH + np.arange(0, SPAN + 40, 12) * TICK + 1


def watcher_of(law: str, events: Iterable[ImpactEvent] = (), **options: object) -> Observer:
    """An observer of ``PRESSED`` that has received ``events``, in that order."""
    given: dict[str, object] = {"ensemble": 2, "history": 60.0, "epoch": EPOCH, **options}
    watcher = observer(PRESSED, law, START, **given)
    for each in events:
        watcher.receive(each)
    return watcher


def bits(watcher: Observer, stamps: Sequence[int] = STAMPS.tolist()) -> list[object]:
    """The estimates at ``stamps``, by their bits, without the numbers of events."""
    found = [watcher.estimate(each) for each in stamps if each >= (watcher.start or 0)]
    others = [(e.closed, e.convergence, e.synchronized, e.bound, e.inconsistent) for e in found]
    arrays = [[x.tobytes() for x in (e.q, e.u, e.covariance)] for e in found]
    return [watcher.start, others, arrays]


def internal_state(watcher: Observer) -> list[object]:
    """Everything that later estimates and verdicts depend on."""
    timeline = watcher.timeline
    assert timeline is not None
    entries = timeline.entries
    events = [(e.key, e.since, e.closed, e.replaced, e.last) for e in entries]
    beliefs = [(e.belief.replicas.tobytes(), dict(e.belief.innovations)) for e in entries]
    results = [each.synchronization for each in entries]
    whole = [watcher.start, watcher.last_event, watcher.missing, watcher.epoch]
    return [whole, events, beliefs, results]


@st.composite
def streams(draw: st.DrawFn, *, numbered: bool = True) -> list[ImpactEvent]:
    """Messages by number: any kinds, stamps that contradict the numbers, some of them lost.

    Now and then a CLOSE comes with the stamp and contact of an IMPACT before it.
    """
    events: list[ImpactEvent] = []
    true = 8
    for sequence in range(1, draw(st.integers(3, 8)) + 1):
        true += draw(st.integers(0, 12))
        stamp = EPOCH + (true + draw(st.integers(-6, 6))) * TICK
        contacts = draw(st.sampled_from([("c1",), ("c2",), ("c1",), ("c1", "c2")]))
        switches = tuple(Switch(each, draw(st.sampled_from(Kind))) for each in contacts)
        edges = [(e.stamp, s) for e in events for s in e.switches if s.kind is Kind.IMPACT]
        if draw(st.booleans()) and edges:
            stamp, edge = draw(st.sampled_from(edges))
            switches = (replace(edge, kind=Kind.CLOSE),)
        events.append(ImpactEvent(stamp, switches, sequence * numbered, 0, EPOCH))
    lost = draw(st.sets(st.integers(0, len(events) - 1), max_size=2))
    return [each for i, each in enumerate(events) if i not in lost]


@st.composite
def arrivals(draw: st.DrawFn, events: list[ImpactEvent]) -> list[ImpactEvent]:
    """``events`` in any order, some of them several times."""
    twice = draw(st.lists(st.sampled_from(events), max_size=3))
    return draw(st.permutations([*events, *twice]))


def consistent(events: list[ImpactEvent]) -> list[ImpactEvent]:
    """The stream without replaced switches that has the effect of ``events``, all numbered."""
    ordered = sorted(events, key=lambda e: (e.stamp, e.sequence))
    first = min(each.sequence for each in events)
    plain: list[ImpactEvent] = []
    for k, each in enumerate(ordered):
        kinds = [(s.contact, effect(each, s, ordered, k)) for s in each.switches]
        switches = tuple(Switch(contact, kind) for contact, kind in kinds if kind is not None)
        if switches:
            plain.append(replace(each, switches=switches, sequence=first + len(plain)))
    return plain


def effect(event: ImpactEvent, switch: Switch, ordered: list[ImpactEvent], k: int) -> Kind | None:
    """What a switch of the k-th event does; None for nothing."""

    def numbers(others: list[ImpactEvent], *kinds: Kind) -> list[int]:
        found = ((e.sequence, s) for e in others for s in e.switches)
        return [n for n, s in found if s.contact == switch.contact and s.kind in kinds]

    of_stamp = [each for each in ordered if each.stamp == event.stamp]
    if switch.kind is Kind.IMPACT and numbers(of_stamp, Kind.CLOSE):
        return None
    if event.sequence >= max(numbers(ordered[:k], Kind.CLOSE, Kind.OPEN), default=0):
        return switch.kind
    return Kind.IMPACT if switch.kind is Kind.CLOSE else None


@pytest.mark.slow
@LAWS
@examples(4)
@given(data=st.data())
def test_order_of_arrival_and_duplicates_change_no_bit(law: str, data: st.DataObject) -> None:
    """Any permutation, with duplicates: equal estimates and equal internal state."""
    events = data.draw(streams(numbered=data.draw(st.booleans())))
    if not events[0].sequence:
        events = [each for i, each in enumerate(events) if each not in events[:i]]
    ordered = watcher_of(law, events)
    shuffled = watcher_of(law)
    rulings = [v.ruling for e in data.draw(arrivals(events)) for v in shuffled.receive(e)]
    assert set(rulings) <= {Ruling.APPLIED, Ruling.REJECTED, Ruling.DUPLICATE}
    assert bits(shuffled) == bits(ordered)
    assert internal_state(shuffled) == internal_state(ordered)


@UNILATERAL_SLOW
@examples(4)
@given(data=st.data())
def test_estimates_in_between_change_no_bit(law: str, data: st.DataObject) -> None:
    """Equal verdicts and estimates, whether or not estimates were made after every event."""
    events = data.draw(streams(numbered=data.draw(st.booleans())))
    order = data.draw(arrivals(events))
    reset = data.draw(st.integers(0, 2 * len(order)))
    history = data.draw(st.sampled_from([0.3, 60.0]))
    asked, silent = (watcher_of(law, history=history) for _ in range(2))
    for k, each in enumerate(order):
        assert asked.receive(each) == silent.receive(each)
        bits(asked, [each.stamp, each.stamp + TICK, each.stamp + 20 * TICK])
        if k == reset:
            for watcher in (asked, silent):
                watcher.set_state(each.stamp, START[:2], START[2:])
    assert asked.remarks == silent.remarks
    assert bits(asked) == bits(silent)
    assert internal_state(asked) == internal_state(silent)


@UNILATERAL_SLOW
@examples(4)
@given(data=st.data())
def test_a_close_replaces_the_impact_of_its_stamp_in_any_stream(
    law: str, data: st.DataObject
) -> None:
    """Equal in every bit to the stream without that impact."""
    events = data.draw(streams())
    plain = watcher_of(law, consistent(events))
    assert bits(watcher_of(law, data.draw(arrivals(events)))) == bits(plain)


@examples(20)
@given(data=st.data())
def test_impacts_are_listed_as_they_are_applied(data: st.DataObject) -> None:
    """Each once, in any order of arrival; those of two episodes separately.

    A closing is one where the contact was open before.
    """
    events = data.draw(streams())
    wanted, closed = list[tuple[int, str, Kind]](), set[str]()
    for each in consistent(events):
        for contact, kind in [(switch.contact, switch.kind) for switch in each.switches]:
            if kind is not Kind.OPEN:
                wanted.append((each.stamp, contact, Kind.IMPACT if contact in closed else kind))
        for switch in each.switches:
            closed.discard(switch.contact)
            closed |= {switch.contact} if switch.kind is Kind.CLOSE else set()
    again = [replace(each, episode=1) for each in events]
    assert list(impacts_of(data.draw(arrivals(events)))) == wanted
    assert list(impacts_of(data.draw(arrivals([*events, *again])))) == [*wanted, *wanted]
    stamps = {contact: [s for s, c, _ in wanted if c == contact] for _, contact, _ in wanted}
    assert {name: found.tolist() for name, found in impacts_in(events).items()} == stamps


def reasons(verdicts: Sequence[Verdict]) -> list[tuple[Ruling, str]]:
    """Ruling and reason of each verdict."""
    return [(each.ruling, each.reason) for each in verdicts]


def test_missing_numbers_are_counted_and_late_events_named() -> None:
    """The verdict on a late event has the number of events that were applied again."""
    watcher = watcher_of("geometric", [event(0.6, "c1", sequence=6)])
    found = []
    for sequence in (9, 8, 11, 3, 12):
        found += reasons(watcher.receive(event(0.1 * sequence, "c1", sequence=sequence)))
    assert found == [
        (Ruling.APPLIED, ""),
        (Ruling.APPLIED, "late: 1 event run again"),
        (Ruling.APPLIED, ""),
        (Ruling.APPLIED, "late: 4 events run again"),
        (Ruling.APPLIED, ""),
    ]
    assert watcher.missing == 4
    assert watcher.remarks[Remark.LATE] == 2


def test_every_refused_event_is_counted() -> None:
    """Each once, by its kind."""
    watcher = watcher_of("geometric", [replace(event(1.0, "c1", sequence=1), episode=1)])
    for stray in (
        event(1.0, "c1", sequence=1, episode=1),
        event(-1.0, "c1", sequence=2, episode=1),
        event(2.0, "wall", sequence=3, episode=1),
        event(2.0, "c1", sequence=4, episode=0),
        event(2.0, sequence=4, episode=1),
    ):
        before = bits(watcher)
        (verdict,) = watcher.receive(stray)
        assert verdict.ruling is not Ruling.APPLIED
        assert verdict.reason
        assert bits(watcher) == before
    kinds = Remark.DUPLICATE, Remark.TOO_LATE, Remark.UNKNOWN_CONTACT, Remark.OLD_RUN
    assert [watcher.remarks[each] for each in kinds] == [1, 1, 1, 1]
    assert watcher.missing == 0


def test_first_verdict_after_a_restart_has_the_reason() -> None:
    """A new episode, a new epoch, or a clock that jumped back; once each."""
    watcher = watcher_of("geometric", [event(1.0, "c1", sequence=1)])
    new = {"episode": 1, "epoch": EPOCH + 5}
    moved = "episode 1 of epoch 5.000000005 s is new: the observer is reset"
    assert reasons(watcher.receive(event(2.1, "wall", "c1", sequence=1, **new))) == [
        (Ruling.UNKNOWN_CONTACT, f"the model's contacts are c1, c2; {moved}"),
        (Ruling.APPLIED, ""),
    ]
    assert reasons(watcher.receive(event(2.2, "c1", sequence=2, **new))) == [(Ruling.APPLIED, "")]
    later = event(3.0, "c1", sequence=1, epoch=EPOCH + NS_PER_S)
    moved = "episode 0 of epoch 6.000000000 s is new: the observer is reset"
    assert reasons(watcher.receive(later)) == [(Ruling.APPLIED, moved)]
    watcher.restart("the clock jumped back")
    jumped = "the clock jumped back: the observer is reset"
    assert reasons(watcher.receive(event(0.5, "c1", sequence=1))) == [(Ruling.APPLIED, jumped)]
    assert reasons(watcher.receive(event(0.7, "c1", sequence=2))) == [(Ruling.APPLIED, "")]
    assert watcher.restarts == 2


def test_an_event_without_a_solution_acts_once_a_late_event_gives_it_one() -> None:
    """Until then it has no effect; the order of arrival changes no bit."""
    jammed = system(1, 0, 1, contacts=[([1], 0.0, 0.8), ([-1], 0.0, 0.5)])
    both, one = event(0.1, "c1", "c2"), event(0.1, "c1")
    without, late, ordered = (
        observer(jammed, "geometric", [0.0, -1.0], epoch=EPOCH) for _ in range(3)
    )
    with pytest.raises(ImpactLawError):
        late.receive(both)
    stamps = [EPOCH + NS_PER_S // 20, EPOCH + NS_PER_S]
    assert bits(late, stamps) == bits(without, stamps)
    assert late.receive(both)[0].ruling is Ruling.DUPLICATE
    for watcher, events in ((late, [one]), (ordered, [one, both])):
        for each in events:
            with suppress(ImpactLawError):
                watcher.receive(each)
    assert bits(late, stamps) == bits(ordered, stamps)


@LAWS
def test_events_after_a_set_state_act_on_it(law: str) -> None:
    """Whether received before or after it; chi is kept."""
    early = switching(("c1", Kind.CLOSE), seconds=0.5, sequence=3)
    later = switching(("c2", Kind.IMPACT), seconds=1.5, sequence=4)
    given = (EPOCH + NS_PER_S, [0.2, -0.1], [0.3, 0.0])
    first, last = watcher_of(law, [early, later]), watcher_of(law, [early])
    first.set_state(*given)
    last.set_state(*given)
    last.receive(later)
    for watcher in (first, last):
        assert watcher.estimate(EPOCH + 2 * NS_PER_S).closed == ("c1",)
    assert first.start == given[0]
    stamps = [given[0], given[0] + NS_PER_S]
    assert bits(first, stamps) == bits(last, stamps)


def test_numbers_of_events_with_unknown_contacts_are_kept_for_the_history_only() -> None:
    """Memory stays bounded for a sensor of contacts that the model does not have."""
    watcher = watcher_of("geometric", history=1.0, ensemble=1)
    early = 0
    for k in range(1, 1000):
        (verdict,) = watcher.receive(
            switching(("bolt", Kind.IMPACT), seconds=0.01 * k, sequence=k)
        )
        assert verdict.ruling is Ruling.UNKNOWN_CONTACT
        early = early or (k == 300 and reachable(watcher))
    assert reachable(watcher) <= early + 200
    assert watcher.missing == 0


def test_event_that_is_not_applied_does_not_shorten_the_past() -> None:
    """Whatever its stamp: duplicates of earlier events are still recognised."""
    watcher = watcher_of("geometric", history=100.0, ensemble=1)
    events = [switching(("c1", Kind.IMPACT), seconds=0.1 * k, sequence=k) for k in range(1, 101)]
    for each in (*events[:89], *events[90:]):
        watcher.receive(each)
    watcher.receive(switching(("bolt", Kind.IMPACT), seconds=1000.0, sequence=101))
    assert watcher.receive(events[90])[0].ruling is Ruling.DUPLICATE
    assert watcher.missing == 1
    assert watcher.receive(events[89])[0].ruling is Ruling.APPLIED
    assert watcher.missing == 0


@examples(4)
@given(data=st.data())
def test_events_received_together_have_the_effect_of_each(data: st.DataObject) -> None:
    """Equal in every bit, in any order and with duplicates; a verdict on each."""
    law = data.draw(st.sampled_from(["geometric", "minimum-variance"]))
    events = data.draw(streams(numbered=data.draw(st.booleans())))
    if not events[0].sequence:
        events = [each for i, each in enumerate(events) if each not in events[:i]]
    order = data.draw(arrivals(events))
    cut = data.draw(st.integers(0, len(order)))
    alone, together = watcher_of(law, order), watcher_of(law, order[:cut])
    found = [*chain.from_iterable(together.receiving(order[cut:]))]
    assert sorted(each.stamp for each, _ in found) == sorted(e.stamp for e in order[cut:])
    assert all(verdicts for _, verdicts in found)
    assert bits(together) == bits(alone)
    assert internal_state(together) == internal_state(alone)


def test_events_without_sequence_numbers_are_ordered_by_stamp() -> None:
    """Also among events with numbers."""
    watcher = watcher_of("geometric", [switching(("c1", Kind.CLOSE), seconds=1.0, sequence=1)])
    assert reasons(watcher.receive(switching(("c1", Kind.OPEN), seconds=1.5))) == [
        (Ruling.APPLIED, "")
    ]
    late = switching(("c1", Kind.CLOSE), seconds=1.2)
    assert reasons(watcher.receive(late)) == [(Ruling.APPLIED, "late: 1 event run again")]
    assert watcher.estimate(EPOCH + 2 * NS_PER_S).closed == ()


@LAWS
@pytest.mark.parametrize("numbered", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_close_replaces_the_impact_of_its_stamp(law: str, *, numbered: bool) -> None:
    """In either order of arrival; an IMPACT of another contact is left."""
    first = switching(("c1", Kind.IMPACT), seconds=0.5, sequence=1 * numbered)
    edge = switching(("c1", Kind.IMPACT), ("c2", Kind.IMPACT), seconds=1.0, sequence=2 * numbered)
    between = switching(("c1", Kind.IMPACT), seconds=1.3, sequence=3 * numbered)
    closing = switching(("c2", Kind.CLOSE), seconds=1.0, sequence=4 * numbered)
    forth, back = watcher_of(law, [first, edge, between]), watcher_of(law, [first, closing])
    assert reasons(forth.receive(closing)) == [(Ruling.APPLIED, "late: 1 event run again")]
    other, void = back.receive(edge)
    assert (other.ruling, void.ruling) == (Ruling.APPLIED, Ruling.REJECTED)
    assert "CLOSE" in void.reason
    assert void.innovation == -1.0
    back.receive(between)
    plain = watcher_of(law, [first, switching(("c1", Kind.IMPACT), seconds=1.0), closing, between])
    assert bits(forth) == bits(back) == bits(plain)
    assert forth.estimate(EPOCH + 2 * NS_PER_S).closed == ("c2",)


def test_replacing_the_latest_event_is_not_late() -> None:
    """IMPACT and CLOSE in a row, with one stamp."""
    watcher = watcher_of("geometric", [event(1.0, "c1", sequence=5)], epoch=0)
    closing = switching(("c1", Kind.CLOSE), seconds=1.0, sequence=6)
    assert reasons(watcher.receive(closing)) == [(Ruling.APPLIED, "")]
    assert watcher.receive(closing)[0].ruling is Ruling.DUPLICATE
    assert not watcher.remarks[Remark.LATE]


def test_impact_older_than_the_history_cannot_be_replaced() -> None:
    """The CLOSE is too late: the state before the IMPACT is not kept."""
    watcher = watcher_of("geometric", history=1.0)
    for k, seconds in enumerate((0.5, 1.0, 2.1)):
        watcher.receive(event(seconds, "c1", sequence=k + 1))
    before = bits(watcher, [EPOCH + 3 * NS_PER_S])
    verdict = watcher.receive(switching(("c1", Kind.CLOSE), seconds=1.0, sequence=4))[0]
    assert verdict.ruling is Ruling.TOO_LATE
    assert bits(watcher, [EPOCH + 3 * NS_PER_S]) == before


def test_events_that_overtake_each_other_within_a_batch_end_as_in_order() -> None:
    """A batch in reverse, among messages of older runs, gives the bits of the true order."""
    events = [event(0.01 * k, f"c{1 + k % 2}", sequence=k, episode=9) for k in range(1, 201)]
    foreign = [event(0.01 * k, "c1", sequence=k, episode=k // 30) for k in (30, 60, 90)]
    watcher = watcher_of("geometric", events[:1], ensemble=1)
    batch = [foreign[0], *events[:0:-1], *foreign[1:]]
    assert sum(map(len, watcher.receiving(batch))) == len(batch)
    assert bits(watcher) == bits(watcher_of("geometric", events, ensemble=1))


def test_a_flood_of_late_events_ends_as_in_order() -> None:
    """The estimates are the earlier ones until all late events are applied."""
    events = [event(0.01 * k, f"c{1 + k % 2}", sequence=k) for k in range(1, 401)]
    watcher = watcher_of("geometric", events[::2], ensemble=1)
    stamp = EPOCH + 3 * NS_PER_S
    before, seen = bits(watcher, [stamp]), 0
    for judged in watcher.receiving(events[1::2][::-1]):
        if not seen and not judged:
            assert bits(watcher, [stamp]) == before
        seen += len(judged)
    assert seen == 200
    assert bits(watcher) == bits(watcher_of("geometric", events, ensemble=1))
