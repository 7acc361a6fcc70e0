"""The summary of a sweep as a table and as JSON."""

import math
from collections.abc import Sequence

from impact_observer.draw.text_tables import console, ruled_table, upright
from impact_observer.sweep.plan import Label, Sweep
from impact_observer.sweep.summary import SUMMARY, CaseGroup, Quartiles, SummaryFigure

_WIDE = 1000
"""Columns in which any table has room."""


def document(sweep: Sweep, groups: Sequence[CaseGroup], impacts: int) -> dict[str, object]:
    """What ``--json`` prints: SI units, None for never and for no figure.

    Args:
        sweep: what was run.
        groups: its outcomes.
        impacts: number of impacts of the plant.
    """
    return {
        "cases": sweep.size,
        "failed": sum(group.failed for group in groups),
        "impacts": impacts,
        "threshold": sweep.threshold,
        "groups": [
            {
                "law": group.law,
                **group.labels,
                "runs": group.runs,
                "failed": group.failed,
                "not_settled": group.not_settled,
                **{name: _finite(found) for name, found in group.quartiles.items()},
            }
            for group in groups
        ],
    }


def _finite(values: Quartiles | None) -> dict[str, float | None] | None:
    if values is None:
        return None
    return {
        name: value if math.isfinite(value) else None for name, value in values._asdict().items()
    }


def print_groups(sweep: Sweep, groups: Sequence[CaseGroup]) -> None:
    """Print a row for each law with each combination of what was swept."""
    failed = any(group.failed for group in groups)
    title = "Medians, and quartiles in brackets, over the runs"
    table = ruled_table(title, "law", *_headings(sweep, failed=failed))
    for group in groups:
        table.add_row(group.law, *_cells(group, failed=failed))
    output = console()
    needed = output.measure(table, options=output.options.update(width=_WIDE)).maximum
    output.print(table if needed <= output.width else upright(table))


def _headings(sweep: Sweep, *, failed: bool) -> list[str]:
    """The headings of all columns but the first."""
    headings = [*map(sweep.title, sweep.swept), "runs"]
    for figure in SUMMARY:
        headings.append(figure.heading.format(threshold=sweep.threshold))
        headings += ["not settled"] if figure.never else []
    return [*headings, "failed"] if failed else headings


def _cells(group: CaseGroup, *, failed: bool) -> list[str]:
    """The cells of a group below these headings."""
    cells = [*map(_value, group.labels.values()), str(group.runs)]
    share = group.not_settled
    for figure in SUMMARY:
        cells.append(_quartiles(group.quartiles[figure.name], figure))
        cells += ["" if share is None else f"{100 * share:.0f} %"] if figure.never else []
    return [*cells, str(group.failed)] if failed else cells


def _value(value: Label) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _quartiles(values: Quartiles | None, figure: SummaryFigure) -> str:
    """``4.2 (3.1, never)``."""
    if values is None:
        return ""
    low, median, high = (
        format(value, figure.form) if math.isfinite(value) else figure.never for value in values
    )
    return median if low == median == high else f"{median} ({low}, {high})"
