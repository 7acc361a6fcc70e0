"""The outcomes of a sweep in groups: medians and quartiles over the runs."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.plan import Label, Sweep


class Quartiles(NamedTuple):
    """Of some numbers; infinite where too many of them are.

    Attributes:
        low: a quarter is not above it.
        median: half is not above it.
        high: three quarters are not above it.
    """

    low: float
    median: float
    high: float


@dataclass(frozen=True, slots=True)
class CaseGroup:
    """Cases that differ in nothing but their run.

    Attributes:
        law: of the observers.
        labels: values of what is swept besides, by name.
        runs: how many outcomes there are.
        failed: of which so many have no figures, and do not count below.
        settled: how many have settled.
        settling_time: s since the epoch; an estimate that never settles takes infinitely long.
        V_ratio: V at the end over V at the start.
    """

    law: str
    labels: Mapping[str, Label]
    runs: int
    failed: int
    settled: int
    settling_time: Quartiles | None
    V_ratio: Quartiles | None

    @property
    def not_settled(self) -> float | None:
        """Their share of the runs that have figures; None where none has."""
        count = self.runs - self.failed
        return 1.0 - self.settled / count if count else None


def groups_of(sweep: Sweep, outcomes: Iterable[Outcome]) -> list[CaseGroup]:
    """The outcomes there are, in groups, in the order of the sweep."""
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
    times = [math.inf if e.settling_time is None else e.settling_time for e in good]
    return CaseGroup(
        law=law,
        labels=labels,
        runs=len(outcomes),
        failed=len(outcomes) - len(good),
        settled=sum(math.isfinite(time) for time in times),
        settling_time=quartiles(times),
        V_ratio=quartiles([each.V_ratio for each in good if each.V_ratio is not None]),
    )


def quartiles(values: Sequence[float]) -> Quartiles | None:
    """Those of ``values``, of which some may be infinite; None where there are none."""
    if not values:
        return None
    ordered = sorted(values)
    return Quartiles(*(_quantile(ordered, share) for share in (0.25, 0.5, 0.75)))


def _quantile(ordered: Sequence[float], share: float) -> float:
    """Between the two nearest in proportion; infinite where it touches an infinite one."""
    place = share * (len(ordered) - 1)
    below, part = int(place), place - int(place)
    if part == 0:
        return ordered[below]
    one, other = ordered[below : below + 2]
    return one + part * (other - one) if math.isfinite(other) else math.inf
