"""The figures of comparisons as tables, as CSV and for ``--json``."""

import csv
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from impact_observer.compare.comparison import Comparison

_NARROW = 80
"""Columns of a terminal below which figures would be cut."""
_WIDTH = 140
"""Columns where there is no terminal."""


def figures(comparison: "Comparison") -> dict[str, object]:
    """What ``--json`` prints of one estimate; SI units, None where a figure has no meaning."""
    from impact_observer.events import Ruling

    mismatch, rulings = comparison.mismatch, comparison.heard.rulings
    counts = {r: None if rulings is None else rulings[r] for r in Ruling}
    return {
        "law": comparison.law,
        "samples": comparison.samples,
        "late_samples": comparison.late,
        "stale_samples": comparison.stale,
        "events_used": comparison.events,
        "impacts_used": comparison.heard.until(int(comparison.stamps[-1])),
        "switches_rejected": counts[Ruling.REJECTED],
        "impacts_inserted": counts[Ruling.INSERTED],
        "start_stamp_ns": int(comparison.stamps[0]),
        "end_stamp_ns": int(comparison.stamps[-1]),
        "V_start": float(comparison.V[0]),
        "V_end": float(comparison.V[-1]),
        "V_ratio": comparison.ratio,
        "V_largest_rise": comparison.largest_rise,
        "settling_time": comparison.settling_time,
        "rate_per_second": comparison.rate_per_second,
        "rate_per_impact": comparison.rate_per_impact,
        "mismatch_windows": mismatch.windows,
        "mismatch_samples": mismatch.samples,
        "mismatch_longest": mismatch.longest,
        "mismatch_V_largest": mismatch.V,
        "rms": comparison.rms.tolist(),
        "max": comparison.largest.tolist(),
        "final": comparison.final.tolist(),
    }


def write_csv(labelled: "dict[str, Comparison]", path: Path) -> None:
    """Write the figures of each estimate as a line; errors have a column a state.

    Raises:
        UsageError: the file cannot be written.
    """
    rows = []
    for label, each in labelled.items():
        row: dict[str, object] = {"estimate": label, "system": each.system.name}
        for key, value in figures(each).items():
            if isinstance(value, list):
                row |= {f"{key}_{s}": v for s, v in zip(states_of(each), value, strict=True)}
            else:
                row[key] = value
        rows.append(row)
    columns = dict.fromkeys(key for row in rows for key in row)
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, [*columns])
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def print_tables(labelled: "dict[str, Comparison]") -> None:
    """Tables of V, of the impacts, and of the errors coordinate by coordinate."""
    from rich.console import Console

    # Names of bags are no markup. What is not on a terminal has room for them.
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDTH
    console = Console(highlight=False, markup=False, emoji=False, width=width)
    for table in (table_of(labelled), impacts_table(labelled), errors_table(labelled)):
        console.print(table if console.width >= _NARROW else upright(table))
    print_blindness(labelled)


def upright(table: "Table") -> "Table":
    """A table for a narrow terminal: the figures of a row stand below each other."""
    from rich.table import Table

    upright = Table(box=None, title=table.title, title_justify="left", show_header=False)
    upright.add_column()
    upright.add_column(overflow="fold")
    headings = [str(column.header) for column in table.columns]
    for row in zip(*(column.cells for column in table.columns), strict=True):
        for heading, cell in zip(headings, row, strict=True):
            if cell:
                upright.add_row(heading, str(cell))
        upright.add_row("", "")
    return upright


def table_of(labelled: "dict[str, Comparison]") -> "Table":
    """V of each estimate, when it settled and how fast it fell."""
    names = ", ".join(dict.fromkeys(each.system.name for each in labelled.values()))
    threshold = next(iter(labelled.values())).threshold
    headings = ("V0 [J]", "V end [J]", "V/V0", f"s to {threshold:g} V0", "1/s", "1/impact")
    table = _table(f"Estimates of {names}", *headings)
    for label, each in labelled.items():
        table.add_row(
            label,
            f"{each.V[0]:.4g}",
            f"{each.V[-1]:.3g}",
            "undefined" if each.ratio is None else f"{each.ratio:.2e}",
            _number(each.settling_time, "never"),
            _number(each.rate_per_second),
            _number(each.rate_per_impact),
        )
    return table


def impacts_table(labelled: "dict[str, Comparison]") -> "Table":
    """What became of the impacts, and the samples that do not count."""
    from impact_observer.events import Ruling

    title = "Impacts; samples late, and between the jumps of truth and estimate"
    table = _table(title, "used", "rejected", "inserted", "late", "between", "longest", "V")
    for label, each in labelled.items():
        rulings, mismatch = each.heard.rulings, each.mismatch
        table.add_row(
            label,
            str(each.heard.until(int(each.stamps[-1]))),
            "" if rulings is None else str(rulings[Ruling.REJECTED]),
            "" if rulings is None else str(rulings[Ruling.INSERTED]),
            str(each.late),
            str(mismatch.samples),
            f"{1e3 * mismatch.longest:.4g} ms" if mismatch.windows else "",
            f"{mismatch.V:.2e} J" if mismatch.windows else "",
        )
    return table


def errors_table(labelled: "dict[str, Comparison]") -> "Table":
    """Errors of each state."""
    from rich import box
    from rich.table import Table

    errors = Table(
        box=box.SIMPLE_HEAD, title="Errors, estimate minus truth, SI units", title_justify="left"
    )
    errors.add_column("law", overflow="fold")
    errors.add_column("state")
    for heading in ("rms", "largest", "final"):
        errors.add_column(heading, justify="right")
    for label, each in labelled.items():
        for row in _error_rows(label, each):
            errors.add_row(*row)
        errors.add_section()
    return errors


def _table(title: str, *headings: str) -> "Table":
    """An empty table with a row a law."""
    from rich import box
    from rich.table import Table

    table = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        collapse_padding=True,
        pad_edge=False,
    )
    table.add_column("law", overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _number(value: float | None, without: str = "") -> str:
    return without if value is None else f"{value:.3g}" if value < 1 else f"{value:.2f}"


def print_blindness(labelled: "dict[str, Comparison]") -> None:
    """Say of which systems V does not see everything."""
    from impact_observer.dynamics.lyapunov import is_seminorm

    systems = {each.system.name: each.system for each in labelled.values()}
    for name, system in systems.items():
        if is_seminorm(system):
            print(f"{name} has a rigid-body mode: V does not see an error of its position")


def states_of(comparison: "Comparison") -> list[str]:
    """Names of the states: coordinates, then their velocities."""
    coordinates = comparison.system.coordinates
    return [*coordinates, *(f"d{name}/dt" for name in coordinates)]


def _error_rows(label: str, comparison: "Comparison") -> "list[tuple[str, ...]]":
    states, final = states_of(comparison), comparison.final
    figures_of = zip(states, comparison.rms, comparison.largest, final, strict=True)
    return [
        ("" if i else label, state, f"{rms:.3e}", f"{largest:.3e}", f"{final:+.3e}")
        for i, (state, rms, largest, final) in enumerate(figures_of)
    ]
