# SPDX-License-Identifier: Apache-2.0
"""Findings of a bag check: severity, fault, expectation and remedy."""

from dataclasses import dataclass

ERROR, WARNING, NOTE = SEVERITIES = ("error", "warning", "note")
"""Severities, most severe first.

No observer can use a bag with an error. A warning means that part of the bag is lost, or that an
observer needs an option. A note is information only.
"""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a bag, or one remark on it.

    Attributes:
        severity: ``error``, ``warning`` or ``note``.
        thing: the file, topic or contact.
        found: the fault in words.
        wanted: the expectation; empty if obvious.
        remedy: advice to the user; empty if nothing need be done.
    """

    severity: str
    thing: str
    found: str
    wanted: str = ""
    remedy: str = ""

    @property
    def line(self) -> str:
        """The finding as one line."""
        parts = [f"{self.thing}: {self.found}"]
        if self.wanted:
            parts.append(f"expected {self.wanted}")
        if self.remedy:
            parts.append(self.remedy)
        return " ".join("; ".join(parts).split())


@dataclass(slots=True)
class Occurrences:
    """Number of occurrences of one fault, and the place of the first.

    Attributes:
        count: number of occurrences.
        first: the place of the first occurrence, in words; empty without an occurrence.
    """

    count: int = 0
    first: str = ""

    def count_at(self, where: str) -> None:
        """Count one more occurrence, at the place ``where``."""
        self.count += 1
        self.first = self.first or where
