# SPDX-License-Identifier: Apache-2.0
"""The result of a bag check: its values for ``--json``, and its lines of text."""

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.text import Text

from impact_observer.check.findings import ERROR, SEVERITIES, Finding, times
from impact_observer.draw.text_tables import console, facts_table

_STYLES = {"error": "bold red", "warning": "yellow", "note": "dim"}


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
        """What ``--json`` prints."""
        return {
            "path": str(self.path),
            "usable": self.usable,
            "readable": self.readable,
            "topics": dict(sorted(self.counts.items())),
            "findings": [asdict(each) | {"line": each.line} for each in self.findings],
        }

    def print(self) -> None:
        """Print each finding as one line; on a terminal folded beside its severity."""
        output = console()
        if sys.stdout.isatty():
            rows = [(Text(f.severity, _STYLES[f.severity]), f.line) for f in self.findings]
            output.print(facts_table(rows))
        else:
            for each in self.findings:
                output.print(f"{each.severity:7}  {each.line}", soft_wrap=True)
        counts = Counter(each.severity for each in self.findings)
        found = ", ".join(times(counts[s], s) for s in SEVERITIES if counts[s])
        usable = "an observer can use it" if self.usable else "no observer can use it"
        verdict = f"{usable} ({found or 'no findings'})"
        output.print(f"{self.path}: {verdict}", soft_wrap=True)
