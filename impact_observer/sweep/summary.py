# SPDX-License-Identifier: Apache-2.0
"""The outcomes of a sweep in groups, with quartiles over the runs; as table and JSON."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np

from impact_observer.draw.reports import TextTable, print_table
from impact_observer.plain_text import say
from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.plan import Label, Sweep

_NEVER = 1e300
"""Substitute for infinity in the quartiles of numpy: infinities have no difference."""


class Quartiles(NamedTuple):
    """The quartiles of numbers, some of which may be infinite.

    Attributes:
        low: the first quartile.
        median: the second quartile.
        high: the third quartile.
    """

    low: float
    median: float
    high: float


@dataclass(frozen=True, slots=True)
class CaseGroup:
    """Cases that differ only in their run.

    Attributes:
        law: of the observers.
        labels: values of the other swept quantities, by name.
        runs: number of outcomes.
        failed: number of outcomes without metrics, which do not count below.
        not_settled: share of the runs with metrics that have not settled; None if there is none.
        settling_time: s; infinite for runs that never settle; None without values.
        V_ratio: V at the end over V at the start; None without values.
    """

    law: str
    labels: Mapping[str, Label]
    runs: int
    failed: int
    not_settled: float | None
    settling_time: Quartiles | None
    V_ratio: Quartiles | None


def groups_of(sweep: Sweep, outcomes: Iterable[Outcome]) -> list[CaseGroup]:
    """The outcomes in groups, in the order of the sweep."""
    by_number = {each.case: each for each in outcomes}
    present = (case for case in sweep.cases() if case.number in by_number)
    names, groups = [*sweep.swept], []
    for _, group in groupby(present, lambda case: case.number // sweep.runs):
        cases = [*group]
        labels = {name: cases[0].labels[name] for name in names}
        own = [by_number[case.number] for case in cases]
        groups.append(_group(cases[0].observer.law, labels, own))
    return groups


def _group(law: str, labels: Mapping[str, Label], outcomes: Sequence[Outcome]) -> CaseGroup:
    good = [each for each in outcomes if not each.error]
    times = [math.inf if each.settling_time is None else each.settling_time for each in good]
    return CaseGroup(
        law=law,
        labels=labels,
        runs=len(outcomes),
        failed=len(outcomes) - len(good),
        not_settled=times.count(math.inf) / len(good) if good else None,
        settling_time=quartiles(times),
        V_ratio=quartiles([each.V_ratio for each in good if each.V_ratio is not None]),
    )


def quartiles(values: Sequence[float]) -> Quartiles | None:
    """The quartiles of ``values``, some of which may be infinite; None without values.

    A quartile between two values is infinite if the upper one is.
    """
    if not values:
        return None
    cuts = np.quantile(np.minimum(values, _NEVER), (0.25, 0.5, 0.75)).tolist()
    return Quartiles(*(math.inf if value > _NEVER / 8 else value for value in cuts))


def document(sweep: Sweep, groups: Sequence[CaseGroup], impacts: int) -> dict[str, object]:
    """The values of ``--json``: SI units, None for never and for no metric.

    Args:
        sweep: the sweep.
        groups: the outcomes of the sweep.
        impacts: number of impacts of the plant.
    """
    return {
        "cases": sweep.size,
        "failed": sum(group.failed for group in groups),
        "impacts": impacts,
        "settled": sweep.settled,
        "groups": [
            {
                "law": group.law,
                **group.labels,
                "runs": group.runs,
                "failed": group.failed,
                "not_settled": group.not_settled,
                "settling_time": _finite(group.settling_time),
                "V_ratio": _finite(group.V_ratio),
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
    """Print a row for each law with each combination of swept values."""
    metrics = (
        "runs",
        "settling time [s]",
        "not settled",
        "V/V0 at the end",
    )
    failed = ["failed"] if any(group.failed for group in groups) else []
    title = f"Medians (quartiles) over the runs; settled while V stays below {sweep.settled:g} V0"
    headings = ("law", *map(sweep.title, sweep.swept), *metrics, *failed)
    rows = [
        (
            group.law,
            *map(_value, group.labels.values()),
            str(group.runs),
            _quartiles(group.settling_time, ".3g"),
            "" if group.not_settled is None else f"{100 * group.not_settled:.0f} %",
            _quartiles(group.V_ratio, ".1e"),
            *(str(group.failed) for _ in failed),
        )
        for group in groups
    ]
    print_table(TextTable(headings, rows, title=title))
    say("")


def _value(value: Label) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _quartiles(values: Quartiles | None, form: str) -> str:
    """``4.2 (3.1, never)``."""
    if values is None:
        return ""
    low, median, high = (
        format(value, form) if math.isfinite(value) else "never" for value in values
    )
    return median if low == median == high else f"{median} ({low}, {high})"
