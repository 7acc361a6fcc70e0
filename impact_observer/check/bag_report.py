# SPDX-License-Identifier: Apache-2.0
"""The result of a bag check: its values for ``--json``, and its lines of text."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from impact_observer.check.findings import ERROR, SEVERITIES, Finding
from impact_observer.draw.reports import counted, listed, print_facts
from impact_observer.plain_text import say


@dataclass(frozen=True, slots=True)
class Report:
    """The result of a check.

    Attributes:
        path: the bag.
        readable: whether the bag can be read as a whole, without salvage.
        counts: messages of each topic that can be read.
        findings: the most severe first.
    """

    path: Path
    readable: bool
    counts: Mapping[str, int]
    findings: list[Finding]

    @property
    def usable(self) -> bool:
        """Whether an observer can use the bag."""
        return all(each.severity != ERROR for each in self.findings)

    def for_json(self) -> dict[str, object]:
        """The report as the dictionary that ``--json`` prints."""
        return {
            "path": str(self.path),
            "usable": self.usable,
            "readable": self.readable,
            "topics": dict(sorted(self.counts.items())),
            "findings": [asdict(each) | {"line": each.line} for each in self.findings],
        }

    def print(self) -> None:
        """Print each finding beside its severity, and whether an observer can use the bag."""
        print_facts((each.severity, each.line) for each in self.findings)
        counts = Counter(each.severity for each in self.findings)
        numbers = listed(counted(counts[s], s) for s in SEVERITIES if counts[s])
        usable = "an observer can use it" if self.usable else "no observer can use it"
        verdict = f"{usable} ({numbers if self.findings else 'no findings'})"
        say(f"{self.path}: {verdict}")
