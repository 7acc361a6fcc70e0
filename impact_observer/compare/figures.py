"""The figures of a comparison: one table for JSON, CSV, the printed tables and the report.

To add a figure, add a row to ``FIGURES``. It appears in ``--json`` and ``--csv`` under its key;
with a column also in that printed table and in the report. ``docs/comparing.md``
lists all figures with unit and meaning; a test holds it against ``FIGURES``.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from impact_observer.compare.comparison import Comparison
from impact_observer.events import Ruling

DISTANCE = "Estimates of {names}"
IMPACTS = "Impacts; samples late, and between the jumps of truth and estimate"
ERRORS = "Errors, estimate minus truth, SI units"
"""Titles of the printed tables. A table of errors has a row a state, the others a row a law."""


class Column(NamedTuple):
    """The column of a printed table that shows a figure.

    Attributes:
        table: title of the table.
        heading: of the column; ``{threshold}`` is filled in.
        cell: makes the text of one number.
    """

    table: str
    heading: str
    cell: Callable[[Any], str] = "{}".format


class FigureOfMerit(NamedTuple):
    """A figure that says how good an estimate is.

    Attributes:
        key: its name in JSON and CSV.
        value: computes it: a word, a number, a list with a number a state, or None where the
            figure has no meaning.
        meaning: in words, for the docs.
        unit: SI unit; empty for words, counts and ratios.
        column: where it is printed; None for nowhere.
    """

    key: str
    value: Callable[[Comparison], Any]
    meaning: str
    unit: str = ""
    column: Column | None = None


def _rate(value: float | None, without: str = "") -> str:
    return without if value is None else f"{value:.3g}" if value < 1 else f"{value:.2f}"


def _count(value: int | None) -> str:
    return "" if value is None else str(value)


def _switches(comparison: Comparison, ruling: Ruling) -> int | None:
    rulings = comparison.outcomes.rulings
    return None if rulings is None else rulings[ruling]


FIGURES = (
    FigureOfMerit("law", lambda c: c.law, "name of the law"),
    FigureOfMerit("samples", lambda c: c.samples, "samples that count"),
    FigureOfMerit("events_used", lambda c: c.events, "instants of used events, openings included"),
    FigureOfMerit(
        "impacts_used",
        lambda c: c.impacts,
        "impacts that the observer applied or inserted, by its last verdict on each",
        column=Column(IMPACTS, "used"),
    ),
    FigureOfMerit(
        "switches_rejected",
        lambda c: _switches(c, Ruling.REJECTED),
        "by its last verdict on each; empty where it published none",
        column=Column(IMPACTS, "rejected", _count),
    ),
    FigureOfMerit(
        "impacts_inserted",
        lambda c: _switches(c, Ruling.INSERTED),
        "missed impacts that it inserted and did not take back",
        column=Column(IMPACTS, "inserted", _count),
    ),
    FigureOfMerit(
        "late_samples",
        lambda c: c.late,
        "left out: estimates that were published before their event had arrived",
        column=Column(IMPACTS, "late"),
    ),
    FigureOfMerit(
        "stale_samples",
        lambda c: c.stale,
        "left out: states more than 10 s older than ones before them in the bag, as where a"
        " bag was recorded while another was played in a loop",
    ),
    FigureOfMerit("start_stamp_ns", lambda c: int(c.stamps[0]), "first sample", "ns"),
    FigureOfMerit("end_stamp_ns", lambda c: int(c.stamps[-1]), "last sample", "ns"),
    FigureOfMerit(
        "V_start",
        lambda c: float(c.V[0]),
        "Lyapunov distance of the first sample",
        "J",
        column=Column(DISTANCE, "V0 [J]", "{:.4g}".format),
    ),
    FigureOfMerit(
        "V_end",
        lambda c: float(c.V[-1]),
        "that of the last sample",
        "J",
        column=Column(DISTANCE, "V end [J]", "{:.3g}".format),
    ),
    FigureOfMerit(
        "V_ratio",
        lambda c: c.ratio,
        "V at the end over V at the start; undefined where plant and estimate start equal",
        column=Column(
            DISTANCE, "V/V0", lambda ratio: "undefined" if ratio is None else f"{ratio:.2e}"
        ),
    ),
    FigureOfMerit(
        "V_largest_rise",
        lambda c: c.largest_rise,
        "of V from one sample to the next, over V at the start; 0 where the theory holds",
    ),
    FigureOfMerit(
        "settling_time",
        lambda c: c.settling_time,
        "from the first sample until V stays below `--threshold` times V at the start",
        "s",
        column=Column(DISTANCE, "s to {threshold:g} V0", lambda seconds: _rate(seconds, "never")),
    ),
    FigureOfMerit(
        "rate_per_second",
        lambda c: c.rate_per_second,
        "fall of ln V until V is first within a factor of ten of its end: the floor that follows"
        " does not count",
        "1/s",
        column=Column(DISTANCE, "1/s", _rate),
    ),
    FigureOfMerit(
        "rate_per_impact",
        lambda c: c.rate_per_impact,
        "that fall per used impact",
        column=Column(DISTANCE, "1/impact", _rate),
    ),
    FigureOfMerit(
        "mismatch_windows",
        lambda c: c.mismatch.windows,
        "impacts with samples between the jumps of truth and estimate",
    ),
    FigureOfMerit(
        "mismatch_samples",
        lambda c: c.mismatch.samples,
        "left out: samples between the jumps",
        column=Column(IMPACTS, "between"),
    ),
    FigureOfMerit(
        "mismatch_longest",
        lambda c: c.mismatch.longest,
        "longest time between two jumps",
        "s",
        column=Column(
            IMPACTS, "longest", lambda seconds: f"{1e3 * seconds:.4g} ms" if seconds else ""
        ),
    ),
    FigureOfMerit(
        "mismatch_V_largest",
        lambda c: c.mismatch.V,
        "largest V between two jumps",
        "J",
        column=Column(IMPACTS, "V", lambda V: f"{V:.2e} J" if V else ""),
    ),
    FigureOfMerit(
        "rms",
        lambda c: c.rms.tolist(),
        "root mean square error of each coordinate, then of each velocity",
        "SI",
        column=Column(ERRORS, "rms", "{:.3e}".format),
    ),
    FigureOfMerit(
        "max",
        lambda c: c.largest.tolist(),
        "largest absolute error of each",
        "SI",
        column=Column(ERRORS, "largest", "{:.3e}".format),
    ),
    FigureOfMerit(
        "final",
        lambda c: c.final.tolist(),
        "error of each at the end",
        "SI",
        column=Column(ERRORS, "final", "{:+.3e}".format),
    ),
)


def columns_of(table: str) -> list[tuple[FigureOfMerit, Column]]:
    """The figures in the printed table with a title."""
    return [(each, each.column) for each in FIGURES if each.column and each.column.table == table]


def figures_of(comparison: Comparison) -> dict[str, Any]:
    """All figures of a comparison by key, as ``--json`` prints them."""
    return {figure.key: figure.value(comparison) for figure in FIGURES}
