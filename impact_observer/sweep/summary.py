"""The outcomes of a sweep in groups: medians and quartiles over the runs."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.plan import Label, Sweep


class SummaryFigure(NamedTuple):
    """A figure of the outcomes that is summarized.

    Attributes:
        name: the field of ``Outcome``.
        heading: in the table; it may contain ``{threshold}``.
        form: of its numbers in the table.
        never: the word for a missing value, which counts as infinite; if empty, missing values
            are left out.
    """

    name: str
    heading: str
    form: str
    never: str = ""


SETTLING = SummaryFigure("settling_time", "s to {threshold:g} V0", ".3g", never="never")
SUMMARY = (SETTLING, SummaryFigure("V_ratio", "V/V0 at the end", ".1e"))
"""What table and JSON show of each group."""


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
        labels: values of what is swept besides, by name.
        runs: number of outcomes.
        failed: number of those without figures, which do not count below.
        not_settled: share of the runs with figures that have not settled; None if there is none.
        quartiles: of each figure of ``SUMMARY``, by name; None without values.
    """

    law: str
    labels: Mapping[str, Label]
    runs: int
    failed: int
    not_settled: float | None
    quartiles: Mapping[str, Quartiles | None]


def groups_of(sweep: Sweep, outcomes: Iterable[Outcome]) -> list[CaseGroup]:
    """The outcomes in groups, in the order of the sweep."""
    return [*_groups(sweep, {each.case: each for each in outcomes})]


def _groups(sweep: Sweep, by_number: Mapping[int, Outcome]) -> Iterator[CaseGroup]:
    names = [*sweep.swept]
    gathered: list[Outcome] = []
    for case in sweep.cases():
        if case.number in by_number:
            gathered.append(by_number[case.number])
        if case.run == sweep.runs - 1:
            if gathered:
                labels = case.labels
                yield _group(case.options.law, {name: labels[name] for name in names}, gathered)
            gathered = []


def _group(law: str, labels: Mapping[str, Label], outcomes: Sequence[Outcome]) -> CaseGroup:
    good = [each for each in outcomes if not each.error]
    not_settled = sum(each.settling_time is None for each in good)
    return CaseGroup(
        law=law,
        labels=labels,
        runs=len(outcomes),
        failed=len(outcomes) - len(good),
        not_settled=not_settled / len(good) if good else None,
        quartiles={each.name: quartiles(_values(each, good)) for each in SUMMARY},
    )


def _values(figure: SummaryFigure, outcomes: Sequence[Outcome]) -> list[float]:
    """The values of a figure; missing ones are infinite or left out."""
    found = [getattr(each, figure.name) for each in outcomes]
    if figure.never:
        return [math.inf if value is None else value for value in found]
    return [value for value in found if value is not None]


def quartiles(values: Sequence[float]) -> Quartiles | None:
    """The quartiles of ``values``, some of which may be infinite; None without values."""
    if not values:
        return None
    ascending = sorted(values)
    return Quartiles(*(_quantile(ascending, share) for share in (0.25, 0.5, 0.75)))


def _quantile(ascending: Sequence[float], share: float) -> float:
    """Linear between the two nearest values; infinite if the upper one is infinite."""
    place = share * (len(ascending) - 1)
    below, part = int(place), place - int(place)
    if part == 0:
        return ascending[below]
    one, other = ascending[below : below + 2]
    return one + part * (other - one) if math.isfinite(other) else math.inf
