"""What became of an event, in words."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from impact_observer.events import Ruling, Verdict
from impact_observer.observer.belief import Note
from impact_observer.observer.order import Key, Overruled
from impact_observer.observer.timeline import Entry, Placed


def because(verdict: Verdict, reasons: Iterable[str]) -> Verdict:
    """``verdict`` with more ``reasons``."""
    return replace(verdict, reason="; ".join(filter(None, (verdict.reason, *reasons))))


def judged(verdict: Verdict, contact: int, placed: Placed) -> Verdict:
    """``verdict`` with its innovation, and with what its event and others made of each other.

    Args:
        verdict: on a switch.
        contact: index of its contact; -1 for none.
        placed: what its event did.
    """
    entry = placed.entry
    innovation = entry.belief.innovations.get(contact, -1.0)
    for note in _notes(entry):
        if (note.event, note.contact) == (entry.event, contact) and not note.is_inserted:
            verdict = replace(verdict, ruling=note.ruling, reason=note.reason)
    if not (entry.overruled or placed.overrules):
        return verdict if innovation < 0 else replace(verdict, innovation=innovation)
    own = [each for each in entry.overruled if each.contact == contact]
    others = [(key, each) for key, each in placed.overrules if each.contact == contact]
    reasons = [*map(_overruled, own), *(_overruling(*each) for each in others)]
    if any(each.is_superseded for each in own):
        verdict = replace(verdict, ruling=Ruling.REJECTED)
    if any(each.acts is None for each in own):
        innovation = -1.0
    return replace(because(verdict, reasons), innovation=innovation)


def _overruled(each: Overruled) -> str:
    """What another event made of a switch."""
    if each.is_superseded:
        return f"superseded by the CLOSE of {_event(each.by)}"
    return f"stamped after event {each.by}, which follows it: {each.effect}"


def _overruling(key: Key, each: Overruled) -> str:
    """What an event made of a switch of another."""
    if each.is_superseded:
        return f"supersedes the IMPACT of {_event(key.sequence)}"
    return f"event {key.sequence}, which it follows, is stamped after it: {each.effect}"


def _event(sequence: int) -> str:
    return f"event {sequence}" if sequence else "its stamp"


def _notes(entry: Entry) -> tuple[Note, ...]:
    """What the likeliest account after ``entry`` makes of the latest events."""
    hypotheses = entry.belief.hypotheses
    return hypotheses[0].notes if hypotheses else ()


class Rulings:
    """What was told of events and of what was inserted, so that a change of mind is told too."""

    def __init__(self) -> None:
        """Nothing was told yet."""
        self._told: dict[_Matter, Note] = {}

    def after(self, placed: Placed, start: int, names: Sequence[str]) -> tuple[Verdict, ...]:
        """What is to be told of others, once an event is in its place.

        Args:
            placed: what it did. Its own switches have their verdicts already.
            start: stamp where the known past begins, ns; what is older is settled.
            names: of the contacts.
        """
        believed: dict[_Matter, Note] = {}
        for entry in (placed.entry, *placed.later):
            known = [note for note in _notes(entry) if note.event[0] >= start]
            believed.update(_matters(known))
        since = min((matter.event for matter in believed), default=None)
        if since is None:
            return ()
        before = {m: note for m, note in self._told.items() if m.event >= since}
        own = placed.entry.event
        verdicts = [
            _verdict(note, names, revises=matter in before)
            for matter, note in believed.items()
            if (matter.inserted or matter.event != own)
            and (matter not in before or before[matter].gist != note.gist)
        ]
        gone = [n for matter, n in before.items() if matter.inserted and matter not in believed]
        for matter in before:
            del self._told[matter]
        self._told |= believed
        return (*verdicts, *(_withdrawn(note, names) for note in gone))

    def forget_before(self, stamp: int) -> None:
        """Drop what lies before ``stamp`` (ns): it will not change any more."""
        for matter in list(self._told):
            if matter.event[0] >= stamp:
                break
            del self._told[matter]


class _Matter(NamedTuple):
    """What may be ruled upon: a contact in an event, or the i-th thing inserted before it."""

    event: tuple[int, int]
    contact: int
    inserted: int = 0


def _matters(notes: Sequence[Note]) -> dict[_Matter, Note]:
    """Notes by what they are on."""
    found: dict[_Matter, Note] = {}
    for note in notes:
        matter = _Matter(note.event, note.contact, int(note.is_inserted))
        while matter.inserted and matter in found:
            matter = matter._replace(inserted=matter.inserted + 1)
        found[matter] = note
    return found


def _verdict(note: Note, names: Sequence[str], *, revises: bool) -> Verdict:
    """The verdict that a note is."""
    reason = note.reason
    if revises:
        reason = f"on second thought: {reason or 'as it was told'}"
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


def _withdrawn(note: Note, names: Sequence[str]) -> Verdict:
    """The verdict on something inserted that is not believed any more."""
    reason = "on second thought: nothing was missed here"
    return Verdict(note.stamp, Ruling.REJECTED, 0, names[note.contact], reason, revises=True)
