# SPDX-License-Identifier: Apache-2.0
"""The intake of an observer node that receives more events than it can apply."""

import random
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticStatus

from impact_observer.events import REVISED, ImpactEvent, Ruling, Switch, Verdict
from impact_observer.io.messages import AnyMessage, MessageLimits
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer
from impact_observer.ros import event_intake
from impact_observer.ros.event_intake import MOST_WAITING, PATIENCE, EventIntake
from impact_observer.ros.flood import MOST_DENSE
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.observer_diagnostics import ObserverDiagnostics
from impact_observer.stamps import NS_PER_S

LATER = 10_000 * NS_PER_S
"""Later than all stamps, ns."""
Item = tuple[ImpactEvent, tuple[Verdict, ...]]


@dataclass
class SlowObserver:
    """Applies each event after some seconds of a clock that only this observer advances.

    Attributes:
        seconds: for each event, s.
        batches: how many events were given together.
        now: the monotonic clock, ns.
        applied: the events that are applied.
    """

    seconds: float
    batches: list[int] = field(default_factory=list)
    now: int = NS_PER_S
    applied: list[ImpactEvent] = field(default_factory=list)

    def receiving(self, events: Sequence[ImpactEvent]) -> Iterator[Item | None]:
        """Apply events as ``Observer.receiving`` does."""
        self.batches.append(len(events))
        for each in events:
            self.now += round(self.seconds * NS_PER_S)
            self.applied.append(each)
            yield each, (Verdict(each.stamp, Ruling.APPLIED, each.sequence),)

    def withdraw(self, is_withdrawn: Callable[[int], bool]) -> None:
        """Forget events, as ``Observer.withdraw`` does."""
        self.applied = [each for each in self.applied if not is_withdrawn(each.stamp)]

    def monotonic_ns(self) -> int:
        """Time of this clock, as of ``time.monotonic_ns``."""
        return self.now


def intake_of(observer: SlowObserver, monkeypatch: pytest.MonkeyPatch) -> EventIntake:
    """The intake of a slow observer, by the clock of the observer."""
    monkeypatch.setattr(event_intake, "time", observer)
    return EventIntake(observer, lambda: LATER, NS_PER_S, MessageLimits(), Counter())  # type: ignore[arg-type]


def message(number: int, apart: int = NS_PER_S) -> AnyMessage:
    """An event with a number; the stamps of successive numbers are ``apart``, ns."""
    event = ImpactEvent(NS_PER_S + number * apart, (Switch("stop"),), number, 0, NS_PER_S)
    return ros_messages().event(event)


def taken(intake: EventIntake) -> list[Item]:
    """Take all waiting events, and return them with their verdicts."""
    found: list[Item] = []
    while intake.is_busy:
        found.extend(intake.apply_waiting())
    return found


def test_a_slow_observer_refuses_what_has_waited_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """The backlog never exceeds the patience and a batch; later events are applied."""
    slow = SlowObserver(seconds=0.5)
    intake = intake_of(slow, monkeypatch)
    for number in range(1, 501):
        assert not intake.take_message(message(number))
    rulings = Counter(verdicts[0].ruling for _, verdicts in taken(intake))
    applied = rulings[Ruling.APPLIED]
    assert rulings == {Ruling.APPLIED: applied, Ruling.REJECTED: 500 - applied}
    assert intake.counts["waited"] == 500 - applied
    assert PATIENCE / NS_PER_S <= applied * slow.seconds <= 2 * PATIENCE / NS_PER_S
    intake.take_message(message(501))
    ((event, (verdict,)),) = taken(intake)
    assert event.sequence == 501
    assert verdict.ruling is Ruling.APPLIED


def test_a_quick_observer_is_given_ever_more_events_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Batches grow, so that late events cost few runs; no event is refused."""
    quick = SlowObserver(seconds=1e-5)
    intake = intake_of(quick, monkeypatch)
    for number in range(1, MOST_WAITING + 1):
        intake.take_message(message(number))
    assert all(verdict.ruling is Ruling.APPLIED for _, (verdict,) in taken(intake))
    assert sum(quick.batches) == MOST_WAITING
    assert len(quick.batches) < 10


def test_of_a_flood_only_few_events_are_applied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of its quarter of a second are shed and counted, those of other times are applied."""
    slow = SlowObserver(seconds=0.1)
    intake = intake_of(slow, monkeypatch)
    for number in range(1, 6):
        intake.take_message(message(number))
    assert len(taken(intake)) == 5
    for number in range(1001, 2001):
        intake.take_message(message(number, apart=100_000))
    intake.take_message(message(7))
    assert not taken(intake)  # held, as the flood may go on
    assert intake.is_behind
    slow.now += NS_PER_S // 2
    found = taken(intake)
    assert intake.counts["shed"] == 1000 - len(found) + 1
    assert len(found) <= MOST_DENSE + 1
    assert any(event.sequence == 7 for event, _ in found)
    slow.now += NS_PER_S
    assert not intake.is_behind


def test_a_flooded_quarter_of_a_second_has_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of its events that were applied before the flood was seen are withdrawn, in words."""
    slow = SlowObserver(seconds=0.1)
    intake = intake_of(slow, monkeypatch)
    found = list[Item]()
    intake.take_message(message(1))
    for number in range(300, 340):  # in 0.2 s, of which each takes half of that
        intake.take_message(message(number, apart=5_000_000))
        if number % 10 == 9:
            found += intake.apply_waiting()
    slow.now += NS_PER_S
    intake.take_message(message(7))
    found += taken(intake)
    assert [each.sequence for each in slow.applied] == [1, 7]
    withdrawn = [v for _, verdicts in found for v in verdicts if v.ruling is Ruling.REJECTED]
    applied = {e.sequence for e, verdicts in found if verdicts[0].ruling is Ruling.APPLIED}
    assert {each.sequence for each in withdrawn} == applied - {1, 7}
    assert withdrawn
    assert all(v.revises and v.reason == f"{REVISED}of a flood" for v in withdrawn)
    assert intake.counts["shed"] == 40


def test_late_events_that_keep_coming_do_not_keep_the_others_waiting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """40 a second, of any stamp of the last 9 s; each takes as long as three need to come."""
    slow, draw = SlowObserver(seconds=0.08), random.Random(1)
    intake, start, waited = intake_of(slow, monkeypatch), slow.now, dict[int, float]()
    coming = deque(
        (25 * k, 25 * k - (draw.randrange(300, 9000) if k % 20 else 0)) for k in range(200)
    )
    while coming or intake.is_busy:
        while coming and slow.now - start >= coming[0][0] * 1_000_000:
            intake.take_message(message(20_000 + coming.popleft()[1], apart=1_000_000))
        for event, _ in intake.apply_waiting():
            waited[event.sequence - 20_000] = (slow.now - start) / NS_PER_S
        slow.now += 1_000_000
    for k in range(0, 200, 20):
        assert waited[25 * k] - k / 40 < 2.0
    assert intake.counts["shed"] > 100
    slow.now += NS_PER_S
    intake.take_message(message(20_000, apart=1_000_000))
    assert len(taken(intake)) == 1  # one that is late, with no flood, is applied


def test_a_past_that_comes_at_once_is_applied_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two senders, one after the other: the second one's events are all late."""
    slow = SlowObserver(seconds=0.05)
    intake = intake_of(slow, monkeypatch)
    for _ in range(2):
        for number in range(1, 51):
            intake.take_message(message(number))
    assert len(taken(intake)) == 100
    assert not intake.counts["shed"]


def test_the_backlog_is_what_is_not_applied_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Events given to the observer count until they are applied; the age is the oldest event's."""
    slow = SlowObserver(seconds=0.5)
    intake = intake_of(slow, monkeypatch)
    assert intake.backlog() == (0, 0.0)
    for number in range(1, 21):
        intake.take_message(message(number))
    next(intake.apply_waiting())
    assert intake.backlog() == (19, 0.5)
    taken(intake)
    assert intake.backlog() == (0, 0.0)


@pytest.mark.parametrize(
    ("options", "remedy"),
    [
        (Options(law="minimum-variance"), "; declare clock_error, or take geometric"),
        (Options(law="minimum-variance", clock_error=1e-4), "; take geometric"),
        (Options(law="geometric"), ""),
    ],
)
def test_an_observer_that_cannot_keep_up_warns_once(options: Options, remedy: str) -> None:
    """The warning has a remedy, and holds until no event waits for long."""
    observer = make_observer(read_model("two_mass").system, options)
    diagnostics = ObserverDiagnostics("observer", observer)
    behind = f"7 events wait, the oldest for 24.1 s: the observer cannot keep up{remedy}"
    assert not diagnostics.note_backlog(2, 0.9)
    assert diagnostics.note_backlog(7, 24.1) == behind
    status = diagnostics.status(NS_PER_S, None)
    assert (status.level, status.message) == (DiagnosticStatus.WARN, behind)
    assert not diagnostics.note_backlog(3, 0.9)
    assert diagnostics.behind
    assert diagnostics.note_backlog(1, 0.1) == "the observer has caught up with the events"
    assert diagnostics.status(NS_PER_S, None).message == "no impact has come yet"
