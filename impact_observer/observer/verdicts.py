# SPDX-License-Identifier: Apache-2.0
"""Verdicts on events: the ruling on each switch, and changes of earlier verdicts."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

from impact_observer.bank.notes import Note
from impact_observer.events import REVISED, Ruling, Verdict
from impact_observer.observer.timeline import Entry

_NEAR = 1_000
"""Resolution of the stamps of inserted impacts: closer ones are the same impact, ns."""


class Subject(NamedTuple):
    """The subject of a verdict: a contact in an event, or in an inserted impact."""

    event: tuple[int, int]
    contact: int
    inserted: bool = False


class IssuedVerdicts:
    """The latest verdict on each subject, so that a changed one is issued again.

    Only a law that weighs what each event was has notes, and so changes its verdicts.
    """

    def __init__(self, names: Sequence[str]) -> None:
        """Start with no verdict issued; ``names`` are those of the contacts."""
        self._names = names
        self._issued: dict[Subject, Note] = {}
        self._notes: tuple[Note, ...] = ()

    def issue(
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
        return notes, tuple(verdicts)

    def forget_before(self, stamp: int) -> None:
        """Drop verdicts on subjects before ``stamp`` (ns), which are final."""
        for subject in [*takewhile(lambda each: each.event[0] < stamp, self._issued)]:
            del self._issued[subject]

    def _verdict_of(self, note: Note, *, revises: bool) -> Verdict:
        """A ``note`` in words."""
        reason = f"{REVISED}{note.reason or 'as reported'}" if revises else note.reason
        sequence, name = 0 if note.is_inserted else note.event[1], self._names[note.contact]
        return Verdict(
            note.stamp, note.ruling, sequence, name, reason, note.innovation, revises=revises
        )


def with_outcome(
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


def with_reasons(verdict: Verdict, reasons: Iterable[str]) -> Verdict:
    """``verdict`` with more ``reasons``."""
    return verdict._replace(reason="; ".join(filter(None, (verdict.reason, *reasons))))


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
        Subject(
            (n.stamp // _NEAR * _NEAR, 0) if n.is_inserted else n.event, n.contact, n.is_inserted
        ): n
        for n in notes
    }
