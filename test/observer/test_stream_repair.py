# SPDX-License-Identifier: Apache-2.0
"""Faulty event streams: late, duplicate, missing, and stamps that contradict sequence numbers."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

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
    events = [(e.key, e.since, e.closed, dict(e.latest), e.overruled) for e in entries]
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
    """The stream without contradictions that has the effect of ``events``, all numbered."""
    ordered = sorted(events, key=lambda e: (e.stamp, e.sequence))
    first = min(each.sequence for each in events)
    plain: list[ImpactEvent] = []
    for i, each in enumerate(ordered):
        kinds = [effect_of(ordered[: i + 1], switch, ordered[i + 1 :]) for switch in each.switches]
        switches = tuple(
            Switch(switch.contact, kind)
            for switch, kind in zip(each.switches, kinds, strict=True)
            if kind is not None
        )
        if switches:
            plain.append(replace(each, switches=switches, sequence=first + len(plain)))
    return plain


def effect_of(upto: list[ImpactEvent], switch: Switch, later: list[ImpactEvent]) -> Kind | None:
    """The effect of a switch of the last of ``upto``, by the rules of docs/nodes.md."""
    closing = Switch(switch.contact, Kind.CLOSE)
    if switch.kind is Kind.IMPACT and any(
        e.stamp == upto[-1].stamp and closing in e.switches for e in later
    ):
        return None
    latest = [(e.sequence, s) for e in upto for s in e.switches if s.contact == switch.contact]
    number, newest = max(latest, key=lambda each: each[0])
    if number == upto[-1].sequence:
        return switch.kind
    if switch.kind is Kind.OPEN:
        return None
    return Kind.CLOSE if newest.kind is Kind.CLOSE else Kind.IMPACT


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
def test_contradictory_stream_acts_as_its_consistent_one(law: str, data: st.DataObject) -> None:
    """Equal in every bit: superseded switches have no effect, stale ones another kind."""
    events = data.draw(streams())
    plain = watcher_of(law, consistent(events))
    assert bits(watcher_of(law, data.draw(arrivals(events)))) == bits(plain)


@examples(20)
@given(data=st.data())
def test_chi_is_set_by_the_event_with_the_highest_sequence_number(data: st.DataObject) -> None:
    """At every instant, and long after the last event."""
    events = data.draw(streams())
    watcher = watcher_of("open-loop", data.draw(arrivals(events)), ensemble=1)
    stamps = [*STAMPS.tolist(), EPOCH + 100 * NS_PER_S]
    for stamp in [each for each in stamps if each >= (watcher.start or 0)]:
        latest = {"c1": (0, Kind.OPEN), "c2": (0, Kind.OPEN)}
        for each in events:
            for switch in each.switches if each.stamp <= stamp else ():
                latest[switch.contact] = max(latest[switch.contact], (each.sequence, switch.kind))
        closed = tuple(contact for contact, (_, kind) in latest.items() if kind is Kind.CLOSE)
        assert watcher.estimate(stamp).closed == closed


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


@pytest.mark.parametrize(
    ("early", "late", "effect", "acts"),
    [
        (Kind.CLOSE, Kind.IMPACT, "a hit, and it stays closed", Kind.CLOSE),
        (Kind.OPEN, Kind.CLOSE, "a hit, and it stays open", Kind.IMPACT),
        (Kind.IMPACT, Kind.IMPACT, "a hit, and it stays open", Kind.IMPACT),
        (Kind.CLOSE, Kind.OPEN, "its OPEN does nothing", None),
    ],
)
def test_verdict_names_stamps_that_contradict_sequence_numbers(
    early: Kind, late: Kind, effect: str, acts: Kind | None
) -> None:
    """Events 8 and 9 with stamps in the other order; the one that arrives second says so."""
    eight = switching(("c1", late), seconds=1.001, sequence=8)
    nine = switching(("c1", early), seconds=1.0, sequence=9)
    before = switching(("c2", Kind.OPEN), seconds=0.0, sequence=1)
    plain = [before, nine]
    if acts is not None:
        plain.append(switching(("c1", acts), seconds=1.001, sequence=10))
    forth, back = (watcher_of("geometric", [before]) for _ in range(2))
    forth.receive(eight)
    assert reasons(forth.receive(nine)) == [
        (
            Ruling.APPLIED,
            f"event 8, which it follows, is stamped after it: {effect}; late: 1 event run again",
        )
    ]
    back.receive(nine)
    assert reasons(back.receive(eight)) == [
        (
            Ruling.APPLIED,
            f"stamped after event 9, which follows it: {effect}; late: 0 events run again",
        )
    ]
    assert bits(forth) == bits(back) == bits(watcher_of("geometric", plain))
    assert forth.remarks[Remark.DISORDER] == back.remarks[Remark.DISORDER] == 1


def test_events_without_sequence_numbers_are_ordered_by_stamp() -> None:
    """None of them is stale, also among events with numbers."""
    watcher = watcher_of("geometric", [switching(("c1", Kind.CLOSE), seconds=1.0, sequence=1)])
    assert reasons(watcher.receive(switching(("c1", Kind.OPEN), seconds=1.5))) == [
        (Ruling.APPLIED, "")
    ]
    late = switching(("c1", Kind.CLOSE), seconds=1.2)
    assert reasons(watcher.receive(late)) == [(Ruling.APPLIED, "late: 1 event run again")]
    assert watcher.estimate(EPOCH + 2 * NS_PER_S).closed == ()
    assert not watcher.remarks[Remark.DISORDER]


@LAWS
@pytest.mark.parametrize("numbered", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_close_supersedes_the_impact_of_its_stamp(law: str, *, numbered: bool) -> None:
    """In either order of arrival; an IMPACT of another contact is left."""
    first = switching(("c1", Kind.IMPACT), seconds=0.5, sequence=1 * numbered)
    edge = switching(("c1", Kind.IMPACT), ("c2", Kind.IMPACT), seconds=1.0, sequence=2 * numbered)
    between = switching(("c1", Kind.IMPACT), seconds=1.3, sequence=3 * numbered)
    closing = switching(("c2", Kind.CLOSE), seconds=1.0, sequence=4 * numbered)
    which = ("event 2", "event 4") if numbered else ("its stamp", "its stamp")
    forth, back = watcher_of(law, [first, edge, between]), watcher_of(law, [first, closing])
    assert reasons(forth.receive(closing)) == [
        (Ruling.APPLIED, f"supersedes the IMPACT of {which[0]}; late: 1 event run again")
    ]
    other, void = back.receive(edge)
    assert (other.ruling, void.ruling) == (Ruling.APPLIED, Ruling.REJECTED)
    assert void.reason == f"superseded by the CLOSE of {which[1]}"
    assert void.innovation == -1.0
    back.receive(between)
    plain = watcher_of(law, [first, switching(("c1", Kind.IMPACT), seconds=1.0), closing, between])
    assert bits(forth) == bits(back) == bits(plain)
    assert forth.remarks[Remark.SUPERSEDED] == back.remarks[Remark.SUPERSEDED] == 1
    assert forth.estimate(EPOCH + 2 * NS_PER_S).closed == ("c2",)


def test_superseding_the_latest_event_is_not_late() -> None:
    """IMPACT and CLOSE in a row, with one stamp."""
    watcher = watcher_of("geometric", [event(1.0, "c1", sequence=5)], epoch=0)
    closing = switching(("c1", Kind.CLOSE), seconds=1.0, sequence=6)
    wanted = [(Ruling.APPLIED, "supersedes the IMPACT of event 5")]
    assert reasons(watcher.receive(closing)) == wanted
    assert watcher.receive(closing)[0].ruling is Ruling.DUPLICATE
    assert not watcher.remarks[Remark.LATE]


def test_impact_older_than_the_history_cannot_be_superseded() -> None:
    """The CLOSE is too late: the state before the IMPACT is not kept."""
    watcher = watcher_of("geometric", history=1.0)
    for k, seconds in enumerate((0.5, 1.0, 2.1)):
        watcher.receive(event(seconds, "c1", sequence=k + 1))
    before = bits(watcher, [EPOCH + 3 * NS_PER_S])
    verdict = watcher.receive(switching(("c1", Kind.CLOSE), seconds=1.0, sequence=4))[0]
    assert verdict.ruling is Ruling.TOO_LATE
    assert bits(watcher, [EPOCH + 3 * NS_PER_S]) == before


def test_verdict_names_missing_events_before_its_own() -> None:
    """The verdict on a late event has the number of events that were applied again."""
    watcher = watcher_of("geometric", [event(0.6, "c1", sequence=6)])
    found = []
    for sequence in (9, 8, 11, 3, 12):
        found += reasons(watcher.receive(event(0.1 * sequence, "c1", sequence=sequence)))
    assert found == [
        (Ruling.APPLIED, "events 7 to 8 before it are missing"),
        (Ruling.APPLIED, "late: 1 event run again"),
        (Ruling.APPLIED, "event 10 before it is missing"),
        (Ruling.APPLIED, "events 4 to 5 after it are missing; late: 4 events run again"),
        (Ruling.APPLIED, ""),
    ]
    assert watcher.missing == 4
    assert (watcher.remarks[Remark.GAP], watcher.remarks[Remark.LATE]) == (3, 2)


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
    kinds = Remark.DUPLICATE, Remark.TOO_LATE, Remark.UNKNOWN_CONTACT, Remark.UNCONFIRMED
    assert [watcher.remarks[each] for each in kinds] == [1, 1, 1, 1]
    assert watcher.missing == 0


def test_first_verdict_after_a_restart_has_the_reason() -> None:
    """A new episode, a new epoch, or a clock that jumped back; once each."""
    watcher = watcher_of("geometric", [event(1.0, "c1", sequence=1)])
    new = {"episode": 1, "epoch": EPOCH + 5}
    needed = "is not in use: it takes effect with two events in a row"
    assert reasons(watcher.receive(event(2.0, "c1", sequence=1, **new))) == [
        (Ruling.REJECTED, f"epoch 5.000000005 s {needed}")
    ]
    unknown = "the model's contacts are c1, c2"
    assert reasons(watcher.receive(event(2.1, "wall", "c1", sequence=2, **new))) == [
        (Ruling.UNKNOWN_CONTACT, f"{unknown}; episode 1 is new: the observer is reset"),
        (Ruling.APPLIED, ""),
        (Ruling.APPLIED, "revised: as reported"),
    ]
    later = [event(3.0 + k, "c1", sequence=k, epoch=EPOCH + NS_PER_S) for k in (1, 2)]
    watcher.receive(later[0])
    moved = "epoch 6.000000000 s is new: the observer is reset"
    assert reasons(watcher.receive(later[1])) == [
        (Ruling.APPLIED, moved),
        (Ruling.APPLIED, "revised: as reported"),
    ]
    watcher.restart("the clock jumped back")
    jumped = "the clock jumped back: the observer is reset"
    assert reasons(watcher.receive(event(0.5, "c1", sequence=1))) == [(Ruling.APPLIED, jumped)]
    assert reasons(watcher.receive(event(0.7, "c1", sequence=2))) == [(Ruling.APPLIED, "")]
    assert (watcher.remarks[Remark.EPISODE], watcher.remarks[Remark.EPOCH]) == (1, 1)
    assert watcher.restarts == 2


def test_missing_events_before_a_failing_event_are_named_once() -> None:
    """The verdict on the next event does not repeat it."""
    jammed = system(1, 0, 1, contacts=[([1], 0.0, 0.8), ([-1], 0.0, 0.5)])
    watcher = observer(jammed, "geometric", [0.0, -1.0], epoch=EPOCH)
    watcher.receive(event(0.0, "c1", sequence=1))
    watcher.set_state(EPOCH, [0.0], [-1.0])
    with pytest.raises(ImpactLawError):
        watcher.receive(event(0.0, "c1", "c2", sequence=3))
    assert watcher.missing == 2
    assert reasons(watcher.receive(event(0.5, "c1", sequence=4))) == [(Ruling.APPLIED, "")]


@LAWS
def test_events_after_a_set_state_act_on_it(law: str) -> None:
    """Whether received before or after it; chi and the sequence numbers are kept."""
    early = switching(("c1", Kind.CLOSE), seconds=0.5, sequence=3)
    later = switching(("c2", Kind.IMPACT), seconds=1.5, sequence=4)
    stale = switching(("c1", Kind.OPEN), seconds=1.2, sequence=2)
    given = (EPOCH + NS_PER_S, [0.2, -0.1], [0.3, 0.0])
    first, last = watcher_of(law, [early, later]), watcher_of(law, [early])
    first.set_state(*given)
    last.set_state(*given)
    last.receive(later)
    for watcher in (first, last):
        assert "does nothing" in watcher.receive(stale)[0].reason
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
    found = [item for item in together.receiving(order[cut:]) if item is not None]
    assert sorted(each.stamp for each, _ in found) == sorted(e.stamp for e in order[cut:])
    assert all(verdicts for _, verdicts in found)
    assert bits(together) == bits(alone)
    assert internal_state(together) == internal_state(alone)


def test_events_that_overtake_each_other_within_a_batch_end_as_in_order() -> None:
    """A batch in reverse, among messages of other runs, gives the bits of the true order."""
    events = [event(0.01 * k, f"c{1 + k % 2}", sequence=k) for k in range(1, 201)]
    foreign = [event(0.01 * k, "c1", sequence=k, episode=7 + k) for k in (30, 60, 90)]
    watcher = watcher_of("geometric", events[:1], ensemble=1)
    batch = [foreign[0], *events[:0:-1], *foreign[1:]]
    found = [item for item in watcher.receiving(batch) if item is not None]
    assert len(found) == len(batch)
    assert bits(watcher) == bits(watcher_of("geometric", events, ensemble=1))


def test_events_too_old_by_the_end_of_their_batch_are_refused() -> None:
    """They came in time, but behind one with which the past is shortened."""
    events = [event(at, "c1", sequence=k) for k, at in enumerate((0.1, 9.0, 5.0, 70.0), 1)]
    foreign = event(0.2, "c1", sequence=1, episode=9)
    watcher = watcher_of("geometric", events[:1], ensemble=1, history=10.0)
    batch = watcher.receiving([foreign, *events[1:]])
    rulings = {item[0].stamp: item[1][0].ruling for item in batch if item is not None}
    assert rulings[events[2].stamp] is Ruling.TOO_LATE
    assert rulings[events[3].stamp] is Ruling.APPLIED


def test_a_flood_of_late_events_ends_as_in_order() -> None:
    """The estimates are the earlier ones until all late events are applied."""
    events = [event(0.01 * k, f"c{1 + k % 2}", sequence=k) for k in range(1, 401)]
    watcher = watcher_of("geometric", events[::2], ensemble=1)
    stamp = EPOCH + 3 * NS_PER_S
    before, seen = bits(watcher, [stamp]), 0
    for item in watcher.receiving(events[1::2][::-1]):
        if not seen and item is None:
            assert bits(watcher, [stamp]) == before
        seen += item is not None
    assert seen == 200
    assert bits(watcher) == bits(watcher_of("geometric", events, ensemble=1))
