"""The figures of a comparison: one table for JSON, CSV, the printed tables and the report.

To add a figure, add a row to ``FIGURES``. It appears in ``--json`` and ``--csv`` under its key;
with a column also in that printed table and in the report. ``docs/comparing.md``
lists all figures with unit and meaning; a test holds its keys and headings against ``FIGURES``.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from impact_observer.compare.comparison import Comparison
from impact_observer.events import Ruling

DISTANCE = "Estimates of {names}"
IMPACTS = "Impacts; samples late, and between the jumps of truth and estimate"
ERRORS = "Errors, estimate minus truth, SI units"
"""Titles of the printed tables. A table of errors has a row a state, the others a row a law."""


class FigureOfMerit(NamedTuple):
    """A figure that says how good an estimate is.

    Attributes:
        key: its name in JSON and CSV.
        value: computes it: a word, a number, a list with a number a state, or None where the
            figure has no meaning.
        table: title of the table in which it is printed; empty for none.
        heading: of its column; ``{threshold}`` is filled in.
        cell: makes the text of one number.
    """

    key: str
    value: Callable[[Comparison], Any]
    table: str = ""
    heading: str = ""
    cell: Callable[[Any], str] = "{}".format


def _rate(value: float | None, without: str = "") -> str:
    return without if value is None else f"{value:.3g}" if value < 1 else f"{value:.2f}"


def _count(value: int | None) -> str:
    return "" if value is None else str(value)


def _ratio(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.2e}"


def _switches(comparison: Comparison, ruling: Ruling) -> int | None:
    rulings = comparison.outcomes.rulings
    return None if rulings is None else rulings[ruling]


FIGURES = (
    FigureOfMerit("law", lambda c: c.law),
    FigureOfMerit("samples", lambda c: c.samples),
    FigureOfMerit("events_used", lambda c: c.events),
    FigureOfMerit("impacts_used", lambda c: c.outcomes.until(int(c.stamps[-1])), IMPACTS, "used"),
    FigureOfMerit(
        "switches_rejected", lambda c: _switches(c, Ruling.REJECTED), IMPACTS, "rejected", _count
    ),
    FigureOfMerit(
        "impacts_inserted", lambda c: _switches(c, Ruling.INSERTED), IMPACTS, "inserted", _count
    ),
    FigureOfMerit("late_samples", lambda c: c.late, IMPACTS, "late"),
    FigureOfMerit("stale_samples", lambda c: c.stale),
    FigureOfMerit("start_stamp_ns", lambda c: int(c.stamps[0])),
    FigureOfMerit("end_stamp_ns", lambda c: int(c.stamps[-1])),
    FigureOfMerit("V_start", lambda c: float(c.V[0]), DISTANCE, "V0 [J]", "{:.4g}".format),
    FigureOfMerit("V_end", lambda c: float(c.V[-1]), DISTANCE, "V end [J]", "{:.3g}".format),
    FigureOfMerit("V_ratio", lambda c: c.ratio, DISTANCE, "V/V0", _ratio),
    FigureOfMerit("V_largest_rise", lambda c: c.largest_rise),
    FigureOfMerit(
        "settling_time",
        lambda c: c.settling_time,
        DISTANCE,
        "s to {threshold:g} V0",
        lambda seconds: _rate(seconds, "never"),
    ),
    FigureOfMerit("rate_per_second", lambda c: c.rate_per_second, DISTANCE, "1/s", _rate),
    FigureOfMerit("rate_per_impact", lambda c: c.rate_per_impact, DISTANCE, "1/impact", _rate),
    FigureOfMerit("mismatch_windows", lambda c: c.mismatch.windows),
    FigureOfMerit("mismatch_samples", lambda c: c.mismatch.samples, IMPACTS, "between"),
    FigureOfMerit(
        "mismatch_longest",
        lambda c: c.mismatch.longest,
        IMPACTS,
        "longest",
        lambda seconds: f"{1e3 * seconds:.4g} ms" if seconds else "",
    ),
    FigureOfMerit(
        "mismatch_V_largest",
        lambda c: c.mismatch.V,
        IMPACTS,
        "V",
        lambda V: f"{V:.2e} J" if V else "",
    ),
    FigureOfMerit("rms", lambda c: c.rms.tolist(), ERRORS, "rms", "{:.3e}".format),
    FigureOfMerit("max", lambda c: c.largest.tolist(), ERRORS, "largest", "{:.3e}".format),
    FigureOfMerit("final", lambda c: c.error[-1].tolist(), ERRORS, "final", "{:+.3e}".format),
)


def figures_of(comparison: Comparison) -> dict[str, Any]:
    """All figures of a comparison by key, as ``--json`` prints them."""
    return {figure.key: figure.value(comparison) for figure in FIGURES}
