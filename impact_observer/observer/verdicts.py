# SPDX-License-Identifier: Apache-2.0
"""Verdicts on events: the ruling on each switch, and changes of earlier verdicts."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

from impact_observer.bank.note import Note
from impact_observer.events import REVISED, Ruling, Verdict
from impact_observer.observer.event_order import EventKey, OverruledSwitch
from impact_observer.observer.timeline import Entry, Insertion

_NEAR = 1_000
"""Resolution of the stamps of inserted impacts: closer ones are the same impact, ns."""


class Subject(NamedTuple):
    """The subject of a verdict: a contact in an event, or in an inserted impact."""

    event: tuple[int, int]
    contact: int
    inserted: bool = False


class IssuedVerdicts:
    """The latest verdict on each subject, so that a changed one is issued again."""

    def __init__(self, names: Sequence[str]) -> None:
        """Start with no verdict issued; ``names`` are those of the contacts."""
        self._names = names
        self._index = {name: i for i, name in enumerate(names)}
        self._issued: dict[Subject, Note] = {}
        self._notes: tuple[Note, ...] = ()

    def are_of(self, entry: Entry) -> bool:
        """Whether the latest verdicts are those of the likeliest hypothesis of ``entry``."""
        return _notes(entry) is self._notes

    def complete(
        self, received: Sequence[tuple[tuple[Verdict, ...], Insertion]], start: int
    ) -> tuple[list[tuple[Verdict, ...]], tuple[Verdict, ...]]:
        """The verdicts on the switches of inserted events with their outcome, and others.

        The others are on inserted impacts and earlier events; before ``start`` (ns) they are
        final. The events are ``received`` in order of their stamps, each with its verdicts.
        """
        notes: dict[Subject, Note] = {}
        others: tuple[Verdict, ...] = ()
        if received[0][1].entry.belief.weighs:
            owns = {insertion.entry.event for _, insertion in received}
            notes, others = self._revised(received[0][1], start, owns)
        return [self._completed(*each, notes) for each in received], others

    def _completed(
        self, verdicts: tuple[Verdict, ...], insertion: Insertion, notes: Mapping[Subject, Note]
    ) -> tuple[Verdict, ...]:
        entry = insertion.entry
        if not (notes or entry.overruled or insertion.overrules or entry.belief.innovations):
            return verdicts
        index = self._index
        own = [_with_outcome(v, index.get(v.contact, -1), insertion, notes) for v in verdicts]
        return tuple(own)

    def _revised(
        self, insertion: Insertion, start: int, owns: Collection[tuple[int, int]]
    ) -> tuple[dict[Subject, Note], tuple[Verdict, ...]]:
        """The notes of the likeliest hypothesis, and verdicts on other subjects than ``owns``."""
        notes, outdated = self._changed(insertion, start)
        verdicts = []
        for subject, latest in notes.items():
            issued = self._issued.get(subject)
            outdated.pop(subject, None)
            if issued is not None and issued.decision == latest.decision:
                continue
            note = latest if issued is None else latest._replace(stamp=issued.stamp)
            if subject.inserted or subject.event not in owns:
                verdicts.append(verdict_of(note, self._names, revises=issued is not None))
            self._issued[subject] = note
        for subject, note in outdated.items():
            del self._issued[subject]
            if subject.inserted:
                reason = f"{REVISED}no impact was missed here"
                name = self._names[note.contact]
                verdict = Verdict(note.stamp, Ruling.REJECTED, 0, name, reason, revises=True)
                verdicts.append(verdict)
        return notes, tuple(verdicts)

    def _changed(
        self, insertion: Insertion, start: int
    ) -> tuple[dict[Subject, Note], dict[Subject, Note]]:
        """Notes that may not have been issued, and issued ones that may be outdated."""
        last = insertion.later[-1] if insertion.later else insertion.entry
        before, self._notes = self._notes, _notes(last)
        added = () if insertion.later else _added(before, self._notes)
        notes = _by_subject(added) if added else _all_notes(insertion)
        current = {subject: n for subject, n in notes.items() if subject.event[0] >= start}
        if added or not current:  # the usual case: the same hypothesis goes on
            return current, {}
        since = min(subject.event for subject in current)
        return current, {s: note for s, note in self._issued.items() if s.event >= since}

    def forget_before(self, stamp: int) -> None:
        """Drop verdicts on subjects before ``stamp`` (ns), which are final."""
        for subject in [*takewhile(lambda each: each.event[0] < stamp, self._issued)]:
            del self._issued[subject]


def _with_outcome(
    verdict: Verdict, contact: int, insertion: Insertion, notes: Mapping[Subject, Note]
) -> Verdict:
    """``verdict`` with its ruling, its innovation, and the effect of other events.

    ``contact`` is its index, -1 for none; ``notes`` are those of the likeliest hypothesis.
    """
    entry = insertion.entry
    ruling, reason = verdict.ruling, verdict.reason
    innovation = entry.belief.innovations.get(contact, -1.0)
    note = notes.get(Subject(entry.event, contact)) if notes else None
    if note is not None:
        ruling, reason, innovation = note.ruling, note.reason, note.innovation
    verdict = Verdict(verdict.stamp, ruling, verdict.sequence, verdict.contact, reason, innovation)
    if not (entry.overruled or insertion.overrules):
        return verdict
    own = [each for each in entry.overruled if each.contact == contact]
    others = [(key, each) for key, each in insertion.overrules if each.contact == contact]
    reasons = [*map(_overruled, own), *(_overrules(*each) for each in others)]
    if any(each.is_superseded for each in own):
        verdict = verdict._replace(ruling=Ruling.REJECTED)
    if any(each.applied is None for each in own):
        verdict = verdict._replace(innovation=-1.0)
    return with_reasons(verdict, reasons)


def with_reasons(verdict: Verdict, reasons: Iterable[str]) -> Verdict:
    """``verdict`` with more ``reasons``."""
    return verdict._replace(reason="; ".join(filter(None, (verdict.reason, *reasons))))


def _overruled(each: OverruledSwitch) -> str:
    if each.is_superseded:
        return f"superseded by the CLOSE of {_event(each.by)}"
    return f"stamped after event {each.by}, which follows it: {each.effect}"


def _overrules(key: EventKey, each: OverruledSwitch) -> str:
    if each.is_superseded:
        return f"supersedes the IMPACT of {_event(key.sequence)}"
    return f"event {key.sequence}, which it follows, is stamped after it: {each.effect}"


def _event(sequence: int) -> str:
    return f"event {sequence}" if sequence else "its stamp"


def _notes(entry: Entry) -> tuple[Note, ...]:
    return entry.belief.notes


def _added(before: tuple[Note, ...], now: tuple[Note, ...]) -> tuple[Note, ...]:
    """The notes added since ``before``; empty if ``before`` is of another hypothesis."""
    for first, note in enumerate(before):
        if now and note is now[0]:
            kept = len(before) - first
            return now[kept:] if now[:kept] == before[first:] else ()
    return ()


def _all_notes(insertion: Insertion) -> dict[Subject, Note]:
    """The notes after the last event; on older subjects, those after the events before it."""
    collected: dict[Subject, Note] = {}
    for entry in (*reversed(insertion.later), insertion.entry):
        if notes := _notes(entry):
            first = min((subject.event for subject in collected), default=None)
            of_entry = _by_subject(notes).items()
            collected.update({s: n for s, n in of_entry if first is None or s.event < first})
    return collected


def _by_subject(notes: Sequence[Note]) -> dict[Subject, Note]:
    return {
        Subject(
            (n.stamp // _NEAR * _NEAR, 0) if n.is_inserted else n.event, n.contact, n.is_inserted
        ): n
        for n in notes
    }


def verdict_of(note: Note, names: Sequence[str], *, revises: bool = False) -> Verdict:
    """Returns the words of a ``note`` on the contact of one of these ``names``."""
    reason = note.reason
    if revises:
        reason = f"{REVISED}{reason or 'as reported'}"
    sequence = 0 if note.is_inserted else note.event[1]
    return Verdict(
        note.stamp,
        note.ruling,
        sequence,
        names[note.contact],
        reason,
        note.innovation,
        revises=revises,
    )
