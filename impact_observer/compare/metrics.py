# SPDX-License-Identifier: Apache-2.0
"""The metrics of a comparison: one table for ``--json`` and the printed tables.

To add a metric, add a row to ``METRICS``. The metric appears in ``--json`` under its
key. A metric with a heading is also a column of the printed table that it names.
``docs/compare.md`` lists all metrics with unit and meaning; a test compares the keys and
headings of that page with ``METRICS``.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from impact_observer.compare.comparison import COVERED, Comparison
from impact_observer.events import Ruling
from impact_observer.states import Vector

DISTANCE = "Estimates of {names}; settled: V < {settled:g} V0; rates: fall of ln V"
IMPACTS = "Impacts; samples left out: late, or between the jumps of truth and estimate"
ERRORS = "Errors, estimate minus truth, SI units"
"""Titles of the printed tables. The table of errors has a row a state, the others a row a law."""


class Metric(NamedTuple):
    """A number that says how good an estimate is.

    Attributes:
        key: its name in ``--json``.
        value: computes the metric: a word, a number, a list with a number a state, or None
            without a meaning.
        table: title of the printed table that has the metric; empty for none.
        heading: of its column.
        cell: makes the text of one number.
        optional: whether the column is left out if no comparison has a value.
        of_encoders: whether only systems with encoders have the metric.
    """

    key: str
    value: Callable[[Comparison], Any]
    table: str = ""
    heading: str = ""
    cell: Callable[[Any], str] = "{}".format
    optional: bool = False
    of_encoders: bool = False

    def is_shown(self, comparisons: Iterable[Comparison]) -> bool:
        """Whether the printed table of some ``comparisons`` has a column for the metric.

        Of systems with encoders no column is empty: their V falls with no rate.
        """
        some = list(comparisons)
        have_encoders = all(each.system.has_encoders for each in some)
        if not (self.optional or self.of_encoders or have_encoders):
            return True
        return any(self.value_of(each) is not None for each in some)

    def value_of(self, comparison: Comparison) -> Any:  # noqa: ANN401 (as ``value`` gives it)
        """The value; None where the system has no such metric."""
        return self.value(comparison) if self.applies_to(comparison) else None

    def applies_to(self, comparison: Comparison) -> bool:
        """Whether the compared system has the metric."""
        return not self.of_encoders or comparison.system.has_encoders


def _rate(value: float | None, without: str = "") -> str:
    return without if value is None else f"{value:.3g}" if value < 1 else f"{value:.2f}"


def _count(value: int | None) -> str:
    return "" if value is None else str(value)


def _ratio(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.2e}"


def _listed(values: Vector | None) -> list[float] | None:
    return None if values is None else values.tolist()


def _switches(comparison: Comparison, ruling: Ruling) -> int | None:
    rulings = comparison.outcomes.rulings
    return None if rulings is None else rulings[ruling]


METRICS = (
    Metric("law", lambda c: c.law),
    Metric("samples", lambda c: c.samples),
    Metric("events_used", lambda c: c.events),
    Metric("impacts_used", lambda c: c.outcomes.until(int(c.stamps[-1])), IMPACTS, "used"),
    Metric(
        "switches_rejected", lambda c: _switches(c, Ruling.REJECTED), IMPACTS, "rejected", _count
    ),
    Metric(
        "impacts_inserted", lambda c: _switches(c, Ruling.INSERTED), IMPACTS, "inserted", _count
    ),
    Metric(
        "measurements_used",
        lambda c: c.outcomes.measured and c.outcomes.measured[0],
        IMPACTS,
        "measured",
        _count,
        optional=True,
    ),
    Metric(
        "measurements_not_used",
        lambda c: c.outcomes.measured and c.outcomes.measured[1],
        IMPACTS,
        "not used",
        _count,
        optional=True,
    ),
    Metric("late_samples", lambda c: c.late, IMPACTS, "late"),
    Metric("stale_samples", lambda c: c.stale),
    Metric("start_stamp_ns", lambda c: int(c.stamps[0])),
    Metric("end_stamp_ns", lambda c: int(c.stamps[-1])),
    Metric("V_start", lambda c: float(c.V[0]), DISTANCE, "V0 [J]", "{:.4g}".format),
    Metric("V_end", lambda c: float(c.V[-1]), DISTANCE, "V end [J]", "{:.3g}".format),
    Metric("V_ratio", lambda c: c.ratio, DISTANCE, "V/V0", _ratio),
    Metric("V_largest_rise", lambda c: c.largest_rise),
    Metric(
        "settling_time",
        lambda c: c.settling_time,
        DISTANCE,
        "settling [s]",
        lambda seconds: _rate(seconds, "never"),
    ),
    Metric("rate_per_second", lambda c: c.rate_per_second, DISTANCE, "1/s", _rate),
    Metric("rate_per_impact", lambda c: c.rate_per_impact, DISTANCE, "1/impact", _rate),
    Metric("mismatch_windows", lambda c: c.mismatch.windows),
    Metric("mismatch_samples", lambda c: c.mismatch.samples, IMPACTS, "between"),
    Metric(
        "mismatch_longest",
        lambda c: c.mismatch.longest,
        IMPACTS,
        "longest",
        lambda seconds: f"{1e3 * seconds:.4g} ms" if seconds else "-",
    ),
    Metric(
        "mismatch_V_largest",
        lambda c: c.mismatch.V,
        IMPACTS,
        "largest V",
        lambda V: f"{V:.2e} J" if V else "-",
    ),
    Metric("rms", lambda c: c.rms.tolist(), ERRORS, "rms", "{:.3e}".format),
    Metric("max", lambda c: c.largest.tolist(), ERRORS, "largest", "{:.3e}".format),
    Metric("final", lambda c: c.error[-1].tolist(), ERRORS, "final", "{:+.3e}".format),
    Metric(
        "rms_after_hits",
        lambda c: _listed(c.rms_after_hits),
        ERRORS,
        "rms after hits",
        lambda rms: "" if rms is None else f"{rms:.3e}",
        of_encoders=True,
    ),
    Metric(
        "coverage",
        lambda c: _listed(c.coverage),
        ERRORS,
        f"within {COVERED:g} deviations",
        lambda share: "" if share is None else f"{share:.1%}",
        of_encoders=True,
    ),
    Metric(
        "velocity_after_hits",
        lambda c: c.velocity_after_hits,
        IMPACTS,
        "after hits",
        lambda rms: "" if rms is None else f"{rms:.3g}",
        of_encoders=True,
    ),
)


def metrics_of(comparison: Comparison) -> dict[str, Any]:
    """All metrics of a comparison by key, as ``--json`` prints them."""
    return {each.key: each.value(comparison) for each in METRICS if each.applies_to(comparison)}
