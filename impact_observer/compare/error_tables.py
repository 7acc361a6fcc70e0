# SPDX-License-Identifier: Apache-2.0
"""The metrics of comparisons in printed tables and as CSV."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.table import Table

from impact_observer.compare.comparison import Comparison
from impact_observer.compare.metrics import DISTANCE, ERRORS, IMPACTS, METRICS, metrics_of
from impact_observer.draw.text_tables import console, fitted, ruled_table
from impact_observer.dynamics.lyapunov import is_seminorm
from impact_observer.errors import UsageError
from impact_observer.plain_text import say

_ROUNDING = 1e-26
"""V over the largest V, below which it is rounding; V is a square, states have 16 digits."""


def write_csv(labelled: Mapping[str, Comparison], path: Path) -> None:
    """Write the metrics, a line an estimate; errors have a column a state.

    Raises:
        UsageError: the file cannot be written.
    """
    rows = []
    for label, each in labelled.items():
        row: dict[str, object] = {"estimate": label, "system": each.system.name}
        for key, value in metrics_of(each).items():
            if isinstance(value, list):
                row |= {f"{key}_{s}": v for s, v in zip(each.states, value, strict=True)}
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


def print_tables(labelled: Mapping[str, Comparison]) -> None:
    """Print all tables, and the systems in which V does not depend on every error."""
    terminal = console()
    of_laws = [table_of_laws(title, labelled) for title in (DISTANCE, IMPACTS)]
    for table in (*of_laws, errors_table(labelled)):
        terminal.print(fitted(table, terminal.width))
    print_blindness(labelled)
    if rounded := [label for label, each in labelled.items() if _is_rounding(each)]:
        names = ", ".join(rounded)
        say(f"V end of {names} is rounding: states have 16 digits, and V is a square")


def _is_rounding(compared: Comparison) -> bool:
    """Whether V at the end says nothing but by how much states are rounded."""
    end, largest = float(compared.V[-1]), float(np.max(compared.V))
    return 0 < end <= _ROUNDING * largest or 0 < largest <= _ROUNDING


def print_blindness(labelled: Mapping[str, Comparison]) -> None:
    """Name the systems whose V does not depend on every error."""
    systems = {each.system.name: each.system for each in labelled.values()}
    for name, system in systems.items():
        if is_seminorm(system):
            say(f"{name} has a rigid-body mode: V does not see an error of its position")


def table_of_laws(title: str, labelled: Mapping[str, Comparison]) -> Table:
    """A row a law with the metrics of the table ``DISTANCE`` or ``IMPACTS``."""
    names, settled = system_names(labelled), next(iter(labelled.values())).settled
    shown = [m for m in METRICS if m.table == title and m.is_shown(labelled.values())]
    title = title.format(names=names, settled=settled)
    table = ruled_table(title, "law", *(metric.heading for metric in shown))
    for label, each in labelled.items():
        table.add_row(label, *(metric.cell(metric.value(each)) for metric in shown))
    return table


def errors_table(labelled: Mapping[str, Comparison]) -> Table:
    """A row a state with the metrics that every state has."""
    shown = [metric for metric in METRICS if metric.table == ERRORS]
    table = ruled_table(ERRORS, "law", "state", *(metric.heading for metric in shown))
    table.columns[1].justify = "left"
    for label, each in labelled.items():
        cells = [map(metric.cell, metric.value(each)) for metric in shown]
        for i, (state, *of_state) in enumerate(zip(each.states, *cells, strict=True)):
            table.add_row("" if i else label, state, *of_state)
        table.add_section()
    return table


def system_names(labelled: Mapping[str, Comparison]) -> str:
    """The systems of some comparisons, each once."""
    return ", ".join(dict.fromkeys(each.system.name for each in labelled.values()))
