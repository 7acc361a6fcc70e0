"""What is wrong with the events of a topic, in one pass and constant memory."""

from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from impact_observer.check.contact_checks import ContactCheck
from impact_observer.check.findings import ERROR, NOTE, WARNING, Finding, Seen, times
from impact_observer.events import ImpactEvent, Switch
from impact_observer.model import System
from impact_observer.stamps import NS_PER_S, text

_RECENT = 50_000
"""Events remembered, so that one that comes twice is known again."""
_MOST = 1000
"""Runs, epochs and faults that are told apart; a damaged bag may have any number."""
_FAR = 3600 * NS_PER_S
"""Stamps farther than this from the log times are of another clock, ns."""

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class _Recent(Generic[_Key, _Value]):
    """The last ``_RECENT`` entries of a dictionary."""

    def __init__(self) -> None:
        self._entries: OrderedDict[_Key, _Value] = OrderedDict()

    def get(self, key: _Key) -> _Value | None:
        """What was put last."""
        return self._entries.get(key)

    def put(self, key: _Key, value: _Value) -> None:
        """Put an entry, for the oldest one if need be."""
        self._entries[key] = value
        if len(self._entries) > _RECENT:
            self._entries.popitem(last=False)


@dataclass(slots=True)
class _Run:
    """The numbers of one run of a sender.

    Attributes:
        lowest: number that has come.
        highest: number that has come.
        count: numbers that have come.
        missing: of the numbers passed over, the first ones that have not come since.
    """

    lowest: int
    highest: int
    count: int = 1
    missing: dict[int, int] = field(default_factory=dict)


class EventCheck:
    """Listens to all events of a topic, in bag order.

    Attributes:
        topic: the absolute name.
        count: messages, valid or not.
        valid: messages with a valid event.
        first: the earliest stamp, ns; 0 before any.
        last: the latest stamp, ns; 0 before any.
    """

    def __init__(self, topic: str) -> None:
        """Listen to ``topic``."""
        self.topic = topic
        self.count = self.valid = self.first = self.last = 0
        self._run: tuple[int, int] | None = None
        self._newest = self._worst = 0
        self._nearest: int | None = None
        self._invalid: dict[str, Seen] = {}
        self._numbers: _Recent[tuple[int, int, int], int] = _Recent()
        self._stamps: _Recent[int, frozenset[Switch]] = _Recent()
        self._late, self._twice, self._reused = Seen(), Seen(), Seen()
        self._beside, self._again = Seen(), Seen()
        self._uncounted, self._empty, self._before = Seen(), Seen(), Seen()
        self._runs: dict[tuple[int, int], _Run] = {}
        self._epochs: Counter[int] = Counter()
        self._contacts = ContactCheck(topic)

    def refuse(self, reason: str) -> None:
        """One more message, which has no valid event."""
        self.count += 1
        kind = reason.partition(" is ")[0]
        if len(self._invalid) < _MOST or kind in self._invalid:
            self._invalid.setdefault(kind, Seen()).note(f"message {self.count - 1}: {reason}")

    def hear(self, event: ImpactEvent, log_time: int) -> None:
        """One more message, with its event and log time (ns)."""
        self.count += 1
        self.valid += 1
        where = f"message {self.count - 1} at {text(event.stamp)} s"
        away = log_time - event.stamp
        if self._nearest is None or abs(away) < abs(self._nearest):
            self._nearest = away
        self._note_epoch(event, where)
        if self._is_known(event, where):
            return
        run_of = event.epoch, event.episode
        if run_of != self._run:
            self._run, self._newest = run_of, event.stamp
            self._contacts.begin()
        if event.stamp < self._newest:
            self._late.note(where)
            self._worst = max(self._worst, self._newest - event.stamp)
        self._note_stamp(event, where)
        self._contacts.hear(event, where)
        self._newest = max(self._newest, event.stamp)
        self.first = min(self.first or event.stamp, event.stamp)
        self.last = max(self.last, event.stamp)

    def _note_epoch(self, event: ImpactEvent, where: str) -> None:
        if len(self._epochs) < _MOST or event.epoch in self._epochs:
            self._epochs[event.epoch] += 1
        if event.stamp < event.epoch:
            self._before.note(where)
        if not event.switches:
            self._empty.note(where)

    def _is_known(self, event: ImpactEvent, where: str) -> bool:
        """Whether its number has come; if not, note it."""
        number, run_of = event.sequence, (event.epoch, event.episode)
        if not number:
            self._uncounted.note(where)
            return False
        earlier = self._numbers.get((*run_of, number))
        if earlier is not None:
            (self._twice if earlier == event.stamp else self._reused).note(where)
            return True
        self._numbers.put((*run_of, number), event.stamp)
        run = self._runs.get(run_of)
        if run is None:
            if len(self._runs) < _MOST:
                self._runs[run_of] = _Run(number, number)
            return False
        run.count += 1
        run.missing.pop(number, None)
        for skipped in range(run.highest + 1, min(number, run.highest + _MOST)):
            if len(run.missing) < _MOST:
                run.missing[skipped] = event.stamp
        run.lowest, run.highest = min(run.lowest, number), max(run.highest, number)
        return False

    def _note_stamp(self, event: ImpactEvent, where: str) -> None:
        """Note what has the stamp of another message."""
        earlier = self._stamps.get(event.stamp)
        now = frozenset(event.switches)
        if earlier is not None:
            same = earlier & now
            if same or not event.sequence:
                self._again.note(where)
            elif not {each.contact for each in earlier} & {each.contact for each in now}:
                self._beside.note(where)
        self._stamps.put(event.stamp, now | (earlier or frozenset()))

    def findings(self, system: System | None) -> Iterator[Finding]:
        """What is wrong, as far as it can be told with or without a ``system``."""
        if not self.valid:
            found = f"has none but invalid messages ({self.count})" if self.count else "no events"
            yield self._error(
                found,
                "at least one impact",
                "was the sender running, and was it subscribed to reliably, transient local?",
            )
        for seen in self._invalid.values():
            yield self._error(
                f"{times(seen.count, 'message')} cannot be used, the first is {seen.first}",
                remedy="mend the sender and record again",
            )
        if self.valid:
            yield from self._about_numbers()
            yield from self._about_stamps()
            yield from self._about_epochs(system)
            yield from self._contacts.findings(system)

    def _about_numbers(self) -> Iterator[Finding]:
        if seen := self._twice.count:
            yield self._warning(
                f"{times(seen, 'message')} came twice, the first is {self._twice.first}",
                remedy="each counts once",
            )
        if seen := self._reused.count:
            yield self._warning(
                f"{times(seen, 'message')} with a sequence number that another event had, the"
                f" first is {self._reused.first}",
                "+1 a message",
                "they are taken for duplicates and lost; was the bag made of two?"
                " Then let the second have a higher episode",
            )
        missing = [each for run in self._runs.values() for each in run.missing.items()]
        if missing:
            count = sum(r.highest - r.lowest + 1 - r.count for r in self._runs.values())
            number, stamp = min(missing, key=lambda each: each[1])
            yield self._warning(
                f"{times(count, 'event')} missing by the sequence numbers, the first is number"
                f" {number}, before {text(stamp)} s",
                remedy="record with reliable quality of service and a depth of 2000",
            )
        if (lowest := min((r.lowest for r in self._runs.values()), default=1)) > 1:
            yield self._note(f"the first sequence number is {lowest}: what was before is not here")
        if seen := self._uncounted.count:
            yield self._note(
                f"{times(seen, 'message')} without a sequence number",
                "numbers from 1 on",
                "without them nobody notices what is lost or comes twice",
            )
        if len(episodes := {episode for _, episode in self._runs}) > 1:
            yield self._note(f"{len(episodes)} episodes: at each, an observer begins anew")

    def _about_stamps(self) -> Iterator[Finding]:
        if seen := self._late.count:
            yield self._note(
                f"{times(seen, 'event')} stamped before an earlier message, by up to"
                f" {self._worst / NS_PER_S:.3g} s, the first is {self._late.first}",
                remedy="they are put in the order of their stamps",
            )
        if seen := self._again.count:
            yield self._warning(
                f"{times(seen, 'event')} with the stamp and contact of another one, the first is"
                f" {self._again.first}",
                remedy="are stamps too coarse, or was an event sent twice under two numbers?",
            )
        if seen := self._beside.count:
            yield self._note(
                f"{times(seen, 'event')} with the stamp of another one, the first is"
                f" {self._beside.first}",
                remedy="they act one after the other; what is simultaneous belongs into one"
                " message",
            )
        if self._nearest is not None and abs(self._nearest) > _FAR:
            hours = self._nearest / NS_PER_S / 3600
            side = "before" if hours > 0 else "after"
            yield self._warning(
                f"stamps are {abs(hours):.4g} h {side} the log times",
                "both of one clock",
                "estimates follow the stamps; to play it, record again with use_sim_time where"
                " time is simulated",
            )

        if seen := self._empty.count:
            yield self._warning(
                f"{times(seen, 'event')} without a contact, the first is {self._empty.first}",
                "the names of the contacts that switch",
                "they tell an observer nothing",
            )

    def _about_epochs(self, system: System | None) -> Iterator[Finding]:
        known = sorted(self._epochs.keys() - {0})
        unknown = self._epochs[0]
        forced = system is not None and system.forcing.depends_on_time
        if unknown and forced and system is not None:
            some = "no event says" if not known else f"{unknown} of {self.valid} events do not say"
            yield self._warning(
                f"{some} the epoch, and the forcing of {system.name} depends on time",
                "the stamp of t = 0 in every event",
                "give it with --epoch S",
            )
        if len(known) > 1:
            yield self._note(
                f"{len(known)} epochs, {text(known[0])} to {text(known[-1])} s: at each later one,"
                " an observer begins anew"
            )
        if seen := self._before.count:
            yield self._warning(
                f"{times(seen, 'event')} stamped before their epoch, the first is"
                f" {self._before.first}",
                f"stamps after the epoch, {text(known[0])} s",
                "such events are not applied; is the epoch of another clock?",
            )

    def _error(self, found: str, wanted: str = "", remedy: str = "") -> Finding:
        return Finding(ERROR, self.topic, found, wanted, remedy)

    def _warning(self, found: str, wanted: str = "", remedy: str = "") -> Finding:
        return Finding(WARNING, self.topic, found, wanted, remedy)

    def _note(self, found: str, wanted: str = "", remedy: str = "") -> Finding:
        return Finding(NOTE, self.topic, found, wanted, remedy)
