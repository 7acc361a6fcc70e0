"""What is found in a bag that is checked: how grave, what, what was wanted, and the remedy."""

from collections.abc import Iterable
from dataclasses import dataclass

ERROR, WARNING, NOTE = "error", "warning", "note"
SEVERITIES = (ERROR, WARNING, NOTE)
"""Gravest first. With an error no observer can use the bag; with a warning one can, but part of
it is lost or an option is needed; a note is good to know."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be, or good to know.

    Attributes:
        severity: ``error``, ``warning`` or ``note``.
        thing: the file, topic or contact.
        found: what was found.
        wanted: what was expected; empty where that is clear.
        remedy: what to do; empty where nothing need be done.
    """

    severity: str
    thing: str
    found: str
    wanted: str = ""
    remedy: str = ""

    @property
    def line(self) -> str:
        """All of it in one line."""
        parts = [f"{self.thing}: {self.found}"]
        if self.wanted:
            parts.append(f"expected {self.wanted}")
        if self.remedy:
            parts.append(self.remedy)
        return " ".join("; ".join(parts).split())


def gravest_first(findings: Iterable[Finding]) -> list[Finding]:
    """Ordered by severity, else as they came."""
    return sorted(findings, key=lambda each: SEVERITIES.index(each.severity))


def times(count: int, word: str, plural: str = "s") -> str:
    """``1 event``, ``2 events``; or another ending."""
    return f"{count} {word}{'' if count == 1 else plural}"


def listed(names: Iterable[str], most: int = 8) -> str:
    """Names in words; of a long list its beginning."""
    known = [*names]
    if len(known) > most:
        known = [*known[: most - 1], f"{len(known) - most + 1} more"]
    return ", ".join(known) or "none"


@dataclass(slots=True)
class Seen:
    """How often something was seen, and where first.

    Attributes:
        count: how often.
        first: where, in words; empty while never.
    """

    count: int = 0
    first: str = ""

    def note(self, where: str) -> None:
        """Once more."""
        self.count += 1
        self.first = self.first or where
