"""What became of an event, in words."""

from collections.abc import Iterable
from dataclasses import replace

from impact_observer.events import Ruling, Verdict
from impact_observer.observer.order import Key, Overruled
from impact_observer.observer.timeline import Placed


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
