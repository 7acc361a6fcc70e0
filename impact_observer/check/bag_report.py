"""A bag check as lines of text, and as figures for ``--json``."""

import sys
from dataclasses import asdict

from rich.console import Console
from rich.table import Table
from rich.text import Text

from impact_observer.check.bag_check import Report
from impact_observer.check.findings import SEVERITIES, times

_STYLES = {"error": "bold red", "warning": "yellow", "note": "dim"}
_WIDTH = max(map(len, SEVERITIES))


def figures(report: Report) -> dict[str, object]:
    """What ``--json`` prints."""
    return {
        "path": str(report.path),
        "usable": report.usable,
        "readable": report.readable,
        "topics": dict(sorted(report.counts.items())),
        "findings": [asdict(each) | {"line": each.line} for each in report.findings],
    }


def print_report(report: Report) -> None:
    """Print each finding as one line; on a terminal folded beside its severity."""
    console = Console(highlight=False, markup=False, emoji=False)
    if sys.stdout.isatty():
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for each in report.findings:
            table.add_row(Text(each.severity, style=_STYLES[each.severity]), each.line)
        console.print(table)
    else:
        for each in report.findings:
            console.print(f"{each.severity:{_WIDTH}}  {each.line}", soft_wrap=True)
    counts = {s: sum(f.severity == s for f in report.findings) for s in SEVERITIES}
    found = ", ".join(times(count, s) for s, count in counts.items() if count)
    usable = "an observer can use it" if report.usable else "no observer can use it"
    verdict = f"{usable} ({found or 'nothing to remark'})"
    console.print(f"{report.path}: {verdict}", soft_wrap=True)
