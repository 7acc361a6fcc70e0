"""What came out of a sweep, as a table and for ``--json``."""

import math
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from impact_observer.draw.text_tables import upright

if TYPE_CHECKING:
    from impact_observer.sweep.plan import Label, Sweep
    from impact_observer.sweep.summary import CaseGroup, Quartiles

_WIDTH = 140
"""Columns where there is no terminal."""
_WIDE = 1000
"""Columns in which any table has room."""


def figures(groups: "Sequence[CaseGroup]") -> list[dict[str, object]]:
    """What ``--json`` prints of the groups; SI units, None for never and for no figure."""
    return [
        {
            "law": group.law,
            **group.labels,
            "runs": group.runs,
            "failed": group.failed,
            "not_settled": group.not_settled,
            "settling_time": _three(group.settling_time),
            "V_ratio": _three(group.V_ratio),
        }
        for group in groups
    ]


def _three(values: "Quartiles | None") -> dict[str, float | None] | None:
    if values is None:
        return None
    return {
        name: value if math.isfinite(value) else None for name, value in values._asdict().items()
    }


def print_groups(sweep: "Sweep", groups: "Sequence[CaseGroup]") -> None:
    """A row for each law with each combination of what was swept."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDTH
    table = Table(
        box=box.SIMPLE_HEAD,
        title="Medians, and quartiles in brackets, over the runs",
        title_justify="left",
        collapse_padding=True,
        pad_edge=False,
    )
    table.add_column("law", overflow="fold")
    names = [*sweep.swept]
    failed = any(group.failed for group in groups)
    for heading in (
        *(sweep.title(name) for name in names),
        "runs",
        f"s to {sweep.threshold:g} V0",
        "not settled",
        "V/V0 at the end",
        *(["failed"] if failed else []),
    ):
        table.add_column(heading, justify="right", overflow="fold")
    for group in groups:
        share = group.not_settled
        table.add_row(
            group.law,
            *(_value(group.labels[name]) for name in names),
            str(group.runs),
            _shown(group.settling_time, ".3g", "never"),
            "" if share is None else f"{100 * share:.0f} %",
            _shown(group.V_ratio, ".1e", ""),
            *([str(group.failed)] if failed else []),
        )
    console = Console(highlight=False, markup=False, emoji=False, width=width)
    needed = console.measure(table, options=console.options.update(width=_WIDE)).maximum
    console.print(table if needed <= console.width else upright(table))


def _value(value: "Label") -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _shown(values: "Quartiles | None", form: str, infinite: str) -> str:
    """``4.2 (3.1, never)``."""
    if values is None:
        return ""
    low, median, high = (format(v, form) if math.isfinite(v) else infinite for v in values)
    return median if low == median == high else f"{median} ({low}, {high})"
