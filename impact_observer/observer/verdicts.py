"""What became of an event, in words."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple, TypeAlias

from impact_observer.estimation.hypotheses import Note
from impact_observer.events import SECOND_THOUGHT, Ruling, Verdict
from impact_observer.observer.event_order import EventKey, OverruledSwitch
from impact_observer.observer.timeline import Entry, Insertion

_NEAR = 1_000
"""Between stamps of an inserted impact that need not be told apart, ns."""


def because(verdict: Verdict, reasons: Iterable[str]) -> Verdict:
    """``verdict`` with more ``reasons``."""
    return verdict._replace(reason="; ".join(filter(None, (verdict.reason, *reasons))))


class Matter(NamedTuple):
    """What may be ruled upon: a contact in an event, or what was inserted at an instant."""

    event: tuple[int, int]
    contact: int
    inserted: bool = False


Notes: TypeAlias = Mapping[Matter, Note]
"""What is believed of the latest matters."""


def judged(verdict: Verdict, contact: int, placed: Insertion, believed: Notes) -> Verdict:
    """``verdict`` with its innovation, and with what its event and others made of each other.

    Args:
        verdict: on a switch.
        contact: index of its contact; -1 for none.
        placed: what its event did.
        believed: then.
    """
    entry = placed.entry
    ruling, reason = verdict.ruling, verdict.reason
    innovation = entry.belief.innovations.get(contact, -1.0)
    note = believed.get(Matter(entry.event, contact)) if believed else None
    if note is not None:
        ruling, reason, innovation = note.ruling, note.reason, note.innovation
    verdict = Verdict(verdict.stamp, ruling, verdict.sequence, verdict.contact, reason, innovation)
    if not (entry.overruled or placed.overrules):
        return verdict
    own = [each for each in entry.overruled if each.contact == contact]
    others = [(key, each) for key, each in placed.overrules if each.contact == contact]
    reasons = [*map(_overruled, own), *(_overruling(*each) for each in others)]
    if any(each.is_superseded for each in own):
        verdict = verdict._replace(ruling=Ruling.REJECTED)
    if any(each.acts is None for each in own):
        innovation = -1.0
    return because(verdict, reasons)._replace(innovation=innovation)


def _overruled(each: OverruledSwitch) -> str:
    """What another event made of a switch."""
    if each.is_superseded:
        return f"superseded by the CLOSE of {_event(each.by)}"
    return f"stamped after event {each.by}, which follows it: {each.effect}"


def _overruling(key: EventKey, each: OverruledSwitch) -> str:
    """What an event made of a switch of another."""
    if each.is_superseded:
        return f"supersedes the IMPACT of {_event(key.sequence)}"
    return f"event {key.sequence}, which it follows, is stamped after it: {each.effect}"


def _event(sequence: int) -> str:
    return f"event {sequence}" if sequence else "its stamp"


class Rulings:
    """What was told of events and of what was inserted, so that a change of mind is told too."""

    def __init__(self) -> None:
        """Nothing was told yet."""
        self._told: dict[Matter, Note] = {}
        self._account: tuple[Note, ...] = ()

    def after(
        self, placed: Insertion, start: int, names: Sequence[str]
    ) -> tuple[Notes, tuple[Verdict, ...]]:
        """What is believed, and what is to be told of others, once an event is in its place.

        Args:
            placed: what it did. Its own switches have their verdicts already.
            start: stamp where the known past begins, ns; what is older is settled.
            names: of the contacts.

        Returns:
            Notes, among them those on the event itself, and verdicts.
        """
        believed, before = self._changed(placed, start)
        verdicts, own = [], placed.entry.event
        for matter, latest in believed.items():
            told = self._told.get(matter)
            before.pop(matter, None)
            if told is not None and told.gist == latest.gist:
                continue
            note = latest if told is None else latest._replace(stamp=told.stamp)
            if matter.inserted or matter.event != own:
                verdicts.append(_verdict(note, names, revises=told is not None))
            self._told[matter] = note
        for matter, note in before.items():
            del self._told[matter]
            if matter.inserted:
                verdicts.append(_withdrawn(note, names))
        return believed, tuple(verdicts)

    def _changed(
        self, placed: Insertion, start: int
    ) -> tuple[dict[Matter, Note], dict[Matter, Note]]:
        """What is believed that may not have been told, and what was told in its stead."""
        last = placed.later[-1] if placed.later else placed.entry
        account, self._account = self._account, _account(last)
        fresh = () if placed.later else _continued(account, self._account)
        found = _matters(fresh) if fresh else _notes(placed)
        believed = {m: n for m, n in found.items() if m.event[0] >= start}
        if fresh or not believed:  # nearly always the same account goes on
            return believed, {}
        since = min(matter.event for matter in believed)
        return believed, {m: note for m, note in self._told.items() if m.event >= since}

    def forget_before(self, stamp: int) -> None:
        """Drop what lies before ``stamp`` (ns): it will not change any more."""
        if not self._told:  # as of laws that never think again
            return
        for matter in [*takewhile(lambda each: each.event[0] < stamp, self._told)]:
            del self._told[matter]


def _account(entry: Entry) -> tuple[Note, ...]:
    """The notes of the likeliest account after an event."""
    hypotheses = entry.belief.hypotheses
    return hypotheses[0].notes if hypotheses else ()


def _continued(before: tuple[Note, ...], now: tuple[Note, ...]) -> tuple[Note, ...]:
    """What an account has noted since ``before``; nothing if it was another one then."""
    for first, note in enumerate(before):
        if now and note is now[0]:
            kept = len(before) - first
            return now[kept:] if now[:kept] == before[first:] else ()
    return ()


def _notes(placed: Insertion) -> Notes:
    """What is believed of the latest matters once an event is in its place: by the last account.

    Of what that does not remember any more, by the last that does.
    """
    found: dict[Matter, Note] = {}
    for entry in (*reversed(placed.later), placed.entry):
        if account := _account(entry):
            first = min((matter.event for matter in found), default=None)
            of_entry = _matters(account).items()
            found.update({m: n for m, n in of_entry if first is None or m.event < first})
    return found


def _matters(notes: Sequence[Note]) -> dict[Matter, Note]:
    """Notes by what they are on."""
    return {
        Matter(
            (n.stamp // _NEAR * _NEAR, 0) if n.is_inserted else n.event, n.contact, n.is_inserted
        ): n
        for n in notes
    }


def _verdict(note: Note, names: Sequence[str], *, revises: bool) -> Verdict:
    """The verdict that a note is."""
    reason = note.reason
    if revises:
        reason = f"{SECOND_THOUGHT}{reason or 'as it was told'}"
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
    reason = f"{SECOND_THOUGHT}nothing was missed here"
    return Verdict(note.stamp, Ruling.REJECTED, 0, names[note.contact], reason, revises=True)
