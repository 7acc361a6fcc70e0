# SPDX-License-Identifier: Apache-2.0
"""Checks of the events of a topic: numbers, stamps and epochs, in one pass."""

from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import partial
from itertools import pairwise

from impact_observer.check.contact_checks import CONTACT_FAULTS, ContactCheck
from impact_observer.check.findings import ERROR, NOTE, WARNING, Finding, Occurrences
from impact_observer.draw.reports import counted
from impact_observer.events import ImpactEvent, Switch
from impact_observer.model import System
from impact_observer.model.robot_description import RobotDescription
from impact_observer.observer.event_order import NEAR_STAMPS
from impact_observer.observer.sender_runs import SenderRuns
from impact_observer.stamps import LATE_EPOCH, NS_PER_S, text

_FAR = 3600 * NS_PER_S
"""Difference of stamps and log times beyond which their clocks differ, ns."""

_FAULTS = {
    "duplicate": (WARNING, "{messages} came twice, the first is {first}", "", "each counts once"),
    "number reused": (
        WARNING,
        "{messages} with a sequence number that another event had, the first is {first}",
        "+1 a message",
        (
            "an observer applies them, and remarks on it; was the bag made of two? Then let the"
            " second have a higher episode"
        ),
    ),
    "not numbered": (
        NOTE,
        "{messages} without a sequence number",
        "numbers from 1 on",
        "without them nobody notices what is lost or comes twice",
    ),
    "out of order": (
        NOTE,
        "{events} stamped before an earlier message, by up to {back:.3g} s, the first is {first}",
        "",
        "they are put in the order of their stamps",
    ),
    "same stamp and contact": (
        WARNING,
        "{events} with the stamp and contact of another one, the first is {first}",
        "",
        "are stamps too coarse, or was an event sent twice under two numbers?",
    ),
    "before epoch": (
        WARNING,
        "{events} stamped before their epoch, the first is {first}",
        "stamps after the epoch, {epoch} s",
        LATE_EPOCH,
    ),
    "without effect": (
        WARNING,
        "{events} without effect, of another run of the sender, the first is {first}",
        "",
        "no others bear them out (docs/events.md); is it one sender, or are messages corrupt?",
    ),
    **CONTACT_FAULTS,
}
"""Faults of events: severity, fault, expectation, remedy."""


class EventCheck:
    """Checks all events of a topic, in bag order.

    The check keeps every sequence number, stamp and switch, some hundred bytes an event.

    Attributes:
        topic: the absolute name.
        count: messages, valid or not.
        valid: messages with a valid event.
        first: the earliest stamp, ns; 0 before any.
        last: the latest stamp, ns; 0 before any.
    """

    def __init__(self, topic: str) -> None:
        """Check ``topic``."""
        self.topic = topic
        self.count = self.valid = self.first = self.last = 0
        self._run: tuple[int, int] | None = None
        self._newest = self._largest_step_back = 0
        self._least_delay: int | None = None
        self._invalid: defaultdict[str, Occurrences] = defaultdict(Occurrences)
        self._faults: defaultdict[str, Occurrences] = defaultdict(Occurrences)
        # Stamps by sequence number, for each run of the sender: epoch and episode.
        self._runs: defaultdict[tuple[int, int], dict[int, int]] = defaultdict(dict)
        self._switches: set[tuple[int, Switch]] = set()
        self._epochs: Counter[int] = Counter()
        self._contacts = ContactCheck(topic, self._faults)
        self._senders = SenderRuns()
        self._without_effect: dict[ImpactEvent, str] = {}

    def count_invalid(self, reason: str) -> None:
        """Count a message without a valid event."""
        self._invalid[reason.partition(" is ")[0]].count_at(f"message {self.count}: {reason}")
        self.count += 1

    def check_event(self, event: ImpactEvent, log_time: int) -> None:
        """Check a valid ``event``, recorded at ``log_time`` (ns)."""
        where = f"message {self.count} at {text(event.stamp)} s"
        self.count += 1
        self.valid += 1
        delay = log_time - event.stamp
        if self._least_delay is None or abs(delay) < abs(self._least_delay):
            self._least_delay = delay
        self._epochs[event.epoch] += 1
        if event.stamp < event.epoch:
            self._faults["before epoch"].count_at(where)
        if event.epoch - event.stamp <= NEAR_STAMPS:
            self._weigh(event, where)
        if not self._is_repeated(event, where):
            self._check_new(event, where)

    def _weigh(self, event: ImpactEvent, where: str) -> None:
        """Note an event without effect, until later events agree with it."""
        weighed = self._senders.weigh(event)
        for each in (*weighed.released, event):
            self._without_effect.pop(each, None)
        if weighed.reason:
            self._without_effect[event] = f"{where}: {weighed.reason}"

    def _is_repeated(self, event: ImpactEvent, where: str) -> bool:
        """Whether the sequence number was received before; a new number is kept."""
        if not event.sequence:
            self._faults["not numbered"].count_at(where)
            return False
        stamps = self._runs[event.epoch, event.episode]
        if (earlier := stamps.get(event.sequence)) is None:
            stamps[event.sequence] = event.stamp
            return False
        self._faults["duplicate" if earlier == event.stamp else "number reused"].count_at(where)
        return True

    def _check_new(self, event: ImpactEvent, where: str) -> None:
        """Check the order and the contacts of an event that is no duplicate."""
        run = event.epoch, event.episode
        if run != self._run:
            self._run, self._newest = run, event.stamp
            self._contacts.reset()
        if event.stamp < self._newest:
            self._faults["out of order"].count_at(where)
            self._largest_step_back = max(self._largest_step_back, self._newest - event.stamp)
        switches = {(event.stamp, each) for each in event.switches}
        if not self._switches.isdisjoint(switches):
            self._faults["same stamp and contact"].count_at(where)
        self._switches |= switches
        self._contacts.check_event(event, where)
        self._newest = max(self._newest, event.stamp)
        self.first = min(self.first or event.stamp, event.stamp)
        self.last = max(self.last, event.stamp)

    def findings(
        self, system: System | RobotDescription | None, *, simulated: bool = False
    ) -> Iterator[Finding]:
        """The findings; contacts and epoch are checked where a ``system`` is given."""
        if not self.valid:
            yield Finding(
                ERROR,
                self.topic,
                f"has none but invalid messages ({self.count})" if self.count else "no events",
                "at least one impact",
                "was the sender running, and was it subscribed to reliably, transient local?",
            )
        for invalid in self._invalid.values():
            fault = f"{counted(invalid.count, 'message')} cannot be used, the first is"
            remedy = "mend the sender and record again"
            yield Finding(ERROR, self.topic, f"{fault} {invalid.first}", remedy=remedy)
        if self.valid:
            places = [*self._without_effect.values()]
            self._faults["without effect"] = Occurrences(len(places), *places[:1])
            yield from self._fault_findings()
            yield from self._run_findings()
            yield from self._clock_findings(system)
            yield from self._contacts.findings(system, simulated=simulated)

    def _fault_findings(self) -> Iterator[Finding]:
        epoch = text(min(self._epochs.keys() - {0}, default=0))
        for name, (severity, what, wanted, remedy) in _FAULTS.items():
            if count := self._faults[name].count:
                fault = what.format(
                    count=count,
                    events=counted(count, "event"),
                    messages=counted(count, "message"),
                    first=self._faults[name].first,
                    back=self._largest_step_back / NS_PER_S,
                )
                yield Finding(severity, self.topic, fault, wanted.format(epoch=epoch), remedy)

    def _run_findings(self) -> Iterator[Finding]:
        """Missing numbers and episodes."""
        note = partial(Finding, NOTE, self.topic)
        gaps = [
            (stamps[after], before + 1, after - before - 1)
            for stamps in self._runs.values()
            for before, after in pairwise(sorted(stamps))
            if after > before + 1
        ]
        if gaps:
            count = sum(size for _, _, size in gaps)
            stamp, number, _ = min(gaps)
            yield Finding(
                WARNING,
                self.topic,
                f"{counted(count, 'event')} missing by the sequence numbers, the first is number"
                f" {number}, before {text(stamp)} s",
                remedy="record with reliable quality of service and a depth of 2000",
            )
        if (lowest := min(map(min, self._runs.values()), default=1)) > 1:
            yield note(f"the first sequence number is {lowest}: what was before is not here")
        if len(episodes := {episode for _, episode in self._runs}) > 1:
            yield note(f"{len(episodes)} episodes: at each, an observer starts again")

    def _clock_findings(self, system: System | RobotDescription | None) -> Iterator[Finding]:
        """Stamps of another clock, and epochs."""
        warning = partial(Finding, WARNING, self.topic)
        if self._least_delay is not None and abs(self._least_delay) > _FAR:
            hours = self._least_delay / NS_PER_S / 3600
            side = "before" if hours > 0 else "after"
            yield warning(
                f"stamps are {abs(hours):.4g} h {side} the log times",
                "both of one clock",
                "estimates follow the stamps; to play it, record again with use_sim_time where"
                " time is simulated",
            )
        epochs, without = sorted(self._epochs.keys() - {0}), self._epochs[0]
        if without and system is not None and system.depends_on_time:
            some = f"{without} of {self.valid} events do not say" if epochs else "no event says"
            yield warning(
                f"{some} the epoch, and the forcing of {system.name} depends on time",
                "the stamp of t = 0 in every event",
                "give it with --epoch S; without it the first pulse on phase_reference counts",
            )
        if len(epochs) > 1:
            span = f"{text(epochs[0])} to {text(epochs[-1])} s"
            fault = f"{len(epochs)} epochs, {span}: at each later one, an observer starts again"
            yield Finding(NOTE, self.topic, fault)
