# SPDX-License-Identifier: Apache-2.0
"""The intake of an observer node that receives more events than it can apply."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticStatus

from impact_observer.events import ImpactEvent, Ruling, Switch, Verdict
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer
from impact_observer.observer.verdicts import Judged
from impact_observer.ros import event_intake
from impact_observer.ros.event_intake import MOST_WAITING, PATIENCE, EventIntake
from impact_observer.ros.observer_diagnostics import ObserverDiagnostics
from impact_observer.stamps import NS_PER_S


@dataclass
class SlowObserver:
    """Applies each event after some seconds of a clock that only this observer advances.

    Attributes:
        seconds: for each event, s.
        batches: how many events were given together.
        now: the monotonic clock, ns.
    """

    seconds: float
    batches: list[int] = field(default_factory=list)
    now: int = NS_PER_S

    def receiving(self, events: Sequence[ImpactEvent]) -> Iterator[list[Judged]]:
        """Apply events as ``Observer.receiving`` does."""
        self.batches.append(len(events))
        for each in events:
            self.now += round(self.seconds * NS_PER_S)
            yield [(each, (Verdict(each.stamp, Ruling.APPLIED, each.sequence),))]

    def monotonic_ns(self) -> int:
        """Time of this clock, as of ``time.monotonic_ns``."""
        return self.now


def intake_of(observer: SlowObserver, monkeypatch: pytest.MonkeyPatch) -> EventIntake:
    """The intake of a slow observer, by the clock of the observer."""
    monkeypatch.setattr(event_intake, "time", observer)
    return EventIntake(observer, Counter())  # type: ignore[arg-type]


def event(number: int) -> ImpactEvent:
    """An event with a number, one a second."""
    return ImpactEvent(NS_PER_S + number * NS_PER_S, (Switch("stop"),), number, 0, NS_PER_S)


def taken(intake: EventIntake) -> list[Judged]:
    """Take all waiting events, and return them with their verdicts."""
    found: list[Judged] = []
    while intake.is_busy:
        found.extend(intake.apply_waiting())
    return found


def test_a_slow_observer_refuses_what_has_waited_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """The backlog never exceeds the patience and a batch; later events are applied."""
    slow = SlowObserver(seconds=0.5)
    intake = intake_of(slow, monkeypatch)
    for number in range(1, 501):
        intake.take(event(number))
    rulings = Counter(verdicts[0].ruling for _, verdicts in taken(intake))
    applied = rulings[Ruling.APPLIED]
    assert rulings == {Ruling.APPLIED: applied, Ruling.REJECTED: 500 - applied}
    assert intake.counts["waited too long"] == 500 - applied
    assert PATIENCE / NS_PER_S <= applied * slow.seconds <= 2 * PATIENCE / NS_PER_S
    intake.take(event(501))
    ((last, (verdict,)),) = taken(intake)
    assert last.sequence == 501
    assert verdict.ruling is Ruling.APPLIED


def test_events_that_wait_together_are_given_to_the_observer_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So that late events cost one run; no event is refused."""
    quick = SlowObserver(seconds=1e-5)
    intake = intake_of(quick, monkeypatch)
    for number in range(1, MOST_WAITING + 1):
        intake.take(event(number))
    assert all(verdict.ruling is Ruling.APPLIED for _, (verdict,) in taken(intake))
    assert quick.batches == [MOST_WAITING]


def test_of_too_many_events_those_that_are_left_are_in_order_and_evenly_spread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is dropped is counted; later ones are all applied."""
    slow = SlowObserver(seconds=1e-3)
    intake = intake_of(slow, monkeypatch)
    for number in range(1, 10_001):
        intake.take(event(number))
    assert intake.backlog()[0] <= MOST_WAITING
    numbers = [each.sequence for each, _ in taken(intake)]
    assert len(numbers) + intake.counts["dropped"] == 10_000
    assert len(numbers) >= MOST_WAITING // 2
    assert numbers == sorted(numbers)
    apart = {b - a for a, b in pairwise(numbers)}
    assert max(apart) <= 2 * min(apart)
    for number in range(10_001, 10_101):
        intake.take(event(number))
    assert len(taken(intake)) == 100


def test_a_past_that_comes_at_once_is_applied_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two senders, one after the other: the second one's events are all late."""
    slow = SlowObserver(seconds=0.05)
    intake = intake_of(slow, monkeypatch)
    for _ in range(2):
        for number in range(1, 51):
            intake.take(event(number))
    assert len(taken(intake)) == 100
    assert not intake.counts["dropped"]


def test_the_backlog_is_what_is_not_applied_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Events given to the observer count until they are applied; the age is the oldest event's."""
    slow = SlowObserver(seconds=0.5)
    intake = intake_of(slow, monkeypatch)
    assert intake.backlog() == (0, 0.0)
    for number in range(1, 21):
        intake.take(event(number))
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

    def status(name: str, level: bytes, message: str, *_: object) -> DiagnosticStatus:
        return DiagnosticStatus(name=name, level=level, message=message)

    behind = f"7 events wait, the oldest for 24.1 s: the observer cannot keep up{remedy}"
    diagnostics = ObserverDiagnostics(status, observer)
    assert not diagnostics.note_backlog(2, 0.9)
    assert diagnostics.note_backlog(7, 24.1) == behind
    found = diagnostics.status(NS_PER_S, None)
    assert (found.level, found.message) == (DiagnosticStatus.WARN, behind)
    assert not diagnostics.note_backlog(3, 0.9)
    assert diagnostics.status(NS_PER_S, None).message == "no impact has come yet"
