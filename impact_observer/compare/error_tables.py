# SPDX-License-Identifier: Apache-2.0
"""The metrics of comparisons in printed tables."""

from collections.abc import Iterator, Mapping

import numpy as np

from impact_observer.compare.comparison import AFTER_HITS, Comparison
from impact_observer.compare.metrics import DISTANCE, ERRORS, IMPACTS, METRICS
from impact_observer.draw.reports import ReportLine, TextTable, listed, print_facts, print_table
from impact_observer.options import SETTLED
from impact_observer.plain_text import say

_ROUNDING = 1e-26
"""Largest ratio of V to the largest V that is rounding: V is a square, states have 16 digits."""


def print_tables(labelled: Mapping[str, Comparison]) -> None:
    """Print all tables, and remarks on what V does not show."""
    for table in (
        table_of_laws(DISTANCE, labelled),
        table_of_laws(IMPACTS, labelled),
        errors_table(labelled),
    ):
        print_table(table)
        say("")
    rounded = [label for label, comparison in labelled.items() if _is_rounding(comparison)]
    near = [label for label, comparison in labelled.items() if comparison.starts_near]
    print_facts([*distance_remarks(labelled), *_start_remarks(near), *_rounding_remarks(rounded)])


def _is_rounding(comparison: Comparison) -> bool:
    """Whether V at the end shows only by how much states are rounded."""
    end, largest = float(comparison.V[-1]), float(np.max(comparison.V))
    return 0 < end <= _ROUNDING * largest or 0 < largest <= _ROUNDING


def _rounding_remarks(labels: list[str]) -> Iterator[ReportLine]:
    if labels:
        names = listed(labels)
        text = f"V end of {names} is rounding: states have 16 digits, and V is a square"
        yield ReportLine("note", text)


def _start_remarks(labels: list[str]) -> Iterator[ReportLine]:
    if labels:
        text = f"V0 of {listed(labels)} is about zero, as the start was near the truth"
        yield ReportLine("note", f"{text}: no V/V0, settling and rates")


def distance_remarks(labelled: Mapping[str, Comparison]) -> Iterator[ReportLine]:
    """A remark on each system whose V is not its whole energy, and on the metrics of encoders."""
    systems = {comparison.system.name: comparison.system for comparison in labelled.values()}
    for name, system in systems.items():
        text = system.remark_on_distance
        if system.has_encoders:
            begin, end = (1e3 * each for each in AFTER_HITS)
            velocities = ", ".join(dict.fromkeys(system.state_units[system.n :]))
            text += f"; after hits: {begin:g} to {end:g} ms later, velocities in {velocities}"
        if text:
            yield ReportLine("note", f"{name} {text}")


def table_of_laws(title: str, labelled: Mapping[str, Comparison]) -> TextTable:
    """The table ``DISTANCE`` or ``IMPACTS``, with a row for each estimate by its label."""
    shown = [m for m in METRICS if m.table == title and m.is_shown(labelled.values())]
    return TextTable(
        ("law", *(metric.heading for metric in shown)),
        [
            (label, *(metric.cell(metric.value_of(comparison)) for metric in shown))
            for label, comparison in labelled.items()
        ],
        title=title.format(names=system_names(labelled), settled=SETTLED),
    )


def errors_table(labelled: Mapping[str, Comparison]) -> TextTable:
    """A table with a row for each state of each estimate."""
    shown = [m for m in METRICS if m.table == ERRORS and m.is_shown(labelled.values())]
    rows = []
    for label, comparison in labelled.items():
        nothing = [None] * len(comparison.states)
        columns = [map(metric.cell, metric.value_of(comparison) or nothing) for metric in shown]
        rows += [(label, *row) for row in zip(comparison.states, *columns, strict=True)]
    headings = ("law", "state", *(metric.heading for metric in shown))
    return TextTable(headings, rows, title=ERRORS, words=("state",))


def system_names(labelled: Mapping[str, Comparison]) -> str:
    """The systems of some comparisons, each once."""
    names = dict.fromkeys(comparison.system.name for comparison in labelled.values())
    return ", ".join(names)
