# SPDX-License-Identifier: Apache-2.0
"""Verdicts on events: the ruling on each switch, and changes of earlier verdicts."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple, TypeAlias

from impact_observer.bank.balance import ImpactState
from impact_observer.bank.notes import Note
from impact_observer.events import REVISED, ImpactEvent, Kind, Remark, Ruling, Verdict
from impact_observer.observer.event_order import EventKey, Switches
from impact_observer.observer.timeline import Entry

_NEAR = 1_000
"""Resolution of the stamps of inserted impacts: closer ones are the same impact, ns."""
Judged: TypeAlias = tuple[ImpactEvent, tuple[Verdict, ...]]
"""An event and the verdicts on it."""


class Subject(NamedTuple):
    """The subject of a verdict: a contact in an event, or in an inserted impact."""

    event: tuple[int, int]
    contact: int
    inserted: bool = False


class EventVerdicts:
    """The verdicts on the events of a sender, and the latest one on each subject.

    A changed verdict is issued again. Only a law that weighs what each event was has notes, and
    so changes its verdicts.

    Attributes:
        remarks: how often the stream of events was irregular, by kind.
        notice: the reason of a restart, which the next verdict names; empty without one.
    """

    def __init__(self, names: Sequence[str]) -> None:
        """Start with no verdict issued; ``names`` are those of the contacts."""
        self.remarks: Counter[Remark] = Counter()
        self.notice = ""
        self._names, self._index = names, {name: i for i, name in enumerate(names)}
        self.begin_run()

    def begin_run(self) -> None:
        """Forget the verdicts on the events of the run before."""
        self._issued: dict[Subject, Note] = {}
        self._notes: tuple[Note, ...] = ()

    def forget_before(self, stamp: int) -> None:
        """Drop verdicts on subjects before ``stamp`` (ns), which are final."""
        for subject in [*takewhile(lambda each: each.event[0] < stamp, self._issued)]:
            del self._issued[subject]

    def on_switches(self, event: ImpactEvent) -> tuple[tuple[Verdict, ...], Switches]:
        """A verdict for each switch, and the switches of contacts of the model, in order."""
        if not event.switches:
            return (rejection(event, "it names no contact"),), ()
        verdicts: list[Verdict] = []
        switches: set[tuple[int, Kind]] = set()
        for switch in event.switches:
            verdict = Verdict(event.stamp, Ruling.APPLIED, event.sequence, switch.contact)
            index = self._index.get(switch.contact)
            if index is not None:
                switches.add((index, switch.kind))
            else:
                self.remarks[Remark.UNKNOWN_CONTACT] += 1
                reason = f"the model's contacts are {', '.join(self._index) or 'none'}"
                verdict = verdict._replace(ruling=Ruling.UNKNOWN_CONTACT, reason=reason)
            verdicts.append(verdict)
        return tuple(verdicts), tuple(sorted(switches))

    def refused(self, verdict: Verdict, remark: Remark) -> tuple[Verdict, ...]:
        """The ``verdict`` on an event that is refused, which is counted."""
        self.remarks[remark] += 1
        return self.with_notice((verdict,))

    def with_notice(self, verdicts: tuple[Verdict, ...]) -> tuple[Verdict, ...]:
        """``verdicts``, the first of them with the reason of a restart, if there was one."""
        notice, self.notice = self.notice, ""
        return (_with_reason(verdicts[0], notice), *verdicts[1:])

    def on_applied(
        self, new: Mapping[EventKey, Judged], entries: Sequence[Entry], start: int
    ) -> list[Judged]:
        """The verdicts on ``new`` events, in order; ``entries`` are those made.

        With the first come those on others that have changed, see ``changed``.
        """
        notes, others = self.changed(entries, start, {key[:2] for key in new})
        found, again = list[Judged](), 0
        for entry in reversed(entries):
            if entry.key not in new:
                again += bool(entry.key.switches)
                continue
            event, verdicts = new[entry.key]
            self.remarks[Remark.MISFIT] += bool(entry.belief.misfit)
            self.remarks[Remark.LATE] += again > 0
            late = f"late: {again} event{'s' * (again != 1)} run again" if again else ""
            made = [
                _with_outcome(each, self._index[each.contact], entry, notes)
                if each.contact in self._index
                else each
                for each in verdicts
            ]
            found.append((event, (_with_reason(made[0], late), *made[1:])))
        (event, own), *later = reversed(found)
        return [(event, (*self.with_notice(own), *others)), *later]

    def changed(
        self, entries: Sequence[Entry], start: int, owns: Collection[tuple[int, int]] = ()
    ) -> tuple[Mapping[Subject, Note], tuple[Verdict, ...]]:
        """The notes of the likeliest hypothesis, and verdicts on others than ``owns``.

        Args:
            entries: of the events that are new or were applied again, the last entry at the end.
            start: verdicts on what was before are final, ns.
            owns: stamps and sequences of the events that get their own verdict.
        """
        before, self._notes = self._notes, entries[-1].belief.noted
        if before is self._notes:
            return {}, ()
        added = _added(before, self._notes) if len(entries) == 1 else ()
        found = _by_subject(added) if added else _all_notes(entries)
        notes = {subject: note for subject, note in found.items() if subject.event[0] >= start}
        outdated = dict[Subject, Note]()
        if notes and not added:  # another hypothesis may be the likeliest now
            since = min(subject.event for subject in notes)
            known = self._issued.items()
            outdated = {s: n for s, n in known if s.event >= since and s not in notes}
        verdicts = []
        for subject, latest in notes.items():
            issued = self._issued.get(subject)
            if issued is not None and issued.decision == latest.decision:
                continue
            note = latest if issued is None else latest._replace(stamp=issued.stamp)
            if subject.inserted or subject.event not in owns:
                verdicts.append(self._verdict_of(note, revises=issued is not None))
            self._issued[subject] = note
        for subject, note in outdated.items():
            del self._issued[subject]
            if subject.inserted:
                reason = f"{REVISED}no impact was missed here"
                name = self._names[note.contact]
                verdict = Verdict(note.stamp, Ruling.REJECTED, 0, name, reason, revises=True)
                verdicts.append(verdict)
        self.remarks[Remark.REVISED] += sum(verdict.revises for verdict in verdicts)
        return notes, tuple(verdicts)

    def missed(self, stamp: int, contact: int) -> ImpactState | None:
        """The state at a missed impact of a ``stamp`` (ns); None where it is inserted no more."""
        note = self._issued.get(_insertion(stamp, contact))
        return None if note is None else note.state

    def _verdict_of(self, note: Note, *, revises: bool) -> Verdict:
        """A ``note`` in words."""
        reason = f"{REVISED}{note.reason or 'as reported'}" if revises else note.reason
        sequence, name = 0 if note.is_inserted else note.event[1], self._names[note.contact]
        return Verdict(
            note.stamp, note.ruling, sequence, name, reason, note.innovation, revises=revises
        )


def rejection(event: ImpactEvent, reason: str) -> Verdict:
    """The verdict that a whole event is rejected."""
    return Verdict(event.stamp, Ruling.REJECTED, event.sequence, reason=reason)


def _with_reason(verdict: Verdict, reason: str) -> Verdict:
    """``verdict`` with one more ``reason``, or the same if that is empty."""
    return verdict._replace(reason="; ".join(filter(None, (verdict.reason, reason))))


def _with_outcome(
    verdict: Verdict, contact: int, entry: Entry, notes: Mapping[Subject, Note]
) -> Verdict:
    """``verdict`` on a switch of a ``contact``, by index, with what became of it.

    The ``entry`` is that of the event, and ``notes`` are those of the likeliest hypothesis.
    """
    if entry.error is not None:
        return verdict._replace(ruling=Ruling.REJECTED, reason=str(entry.error))
    if contact in entry.replaced:
        reason = "a CLOSE of its stamp, or a later event of the contact, replaces it"
        return verdict._replace(ruling=Ruling.REJECTED, reason=reason)
    note = notes.get(Subject(entry.key[:2], contact))
    if note is not None:
        return verdict._replace(ruling=note.ruling, reason=note.reason, innovation=note.innovation)
    return verdict._replace(innovation=entry.belief.innovations.get(contact, -1.0))


def _added(before: tuple[Note, ...], now: tuple[Note, ...]) -> tuple[Note, ...]:
    """The notes added since ``before``; empty if ``before`` is of another hypothesis."""
    for first, note in enumerate(before):
        if now and note is now[0]:
            kept = len(before) - first
            return now[kept:] if now[:kept] == before[first:] else ()
    return ()


def _all_notes(entries: Sequence[Entry]) -> dict[Subject, Note]:
    """The notes after the last event; on older subjects, those after the events before it."""
    collected: dict[Subject, Note] = {}
    for entry in reversed(entries):
        first = min((subject.event for subject in collected), default=None)
        of_entry = _by_subject(entry.belief.noted).items()
        collected |= {s: n for s, n in of_entry if first is None or s.event < first}
    return collected


def _by_subject(notes: Sequence[Note]) -> dict[Subject, Note]:
    return {
        _insertion(n.stamp, n.contact) if n.is_inserted else Subject(n.event, n.contact): n
        for n in notes
    }


def _insertion(stamp: int, contact: int) -> Subject:
    return Subject((stamp // _NEAR * _NEAR, 0), contact, inserted=True)
