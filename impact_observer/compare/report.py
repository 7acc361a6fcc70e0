# SPDX-License-Identifier: Apache-2.0
"""The report of a comparison: metrics and pictures in one HTML file that needs no network."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from impact_observer import __version__
from impact_observer.compare.bag_comparison import BagComparison
from impact_observer.compare.comparison import AFTER_HITS, Comparison
from impact_observer.compare.error_pictures import (
    MOST_COORDINATES,
    distance_picture,
    error_pictures,
    hits_picture,
    instants_of,
)
from impact_observer.compare.error_tables import errors_table, system_names, table_of_laws
from impact_observer.compare.metrics import DISTANCE, IMPACTS
from impact_observer.draw.pictures import svg
from impact_observer.draw.reports import TextTable, listed
from impact_observer.output_files import replacing
from impact_observer.plain_text import markup
from impact_observer.robots.robot import Robot
from impact_observer.stamps import seconds_between

_STYLE = """
body { font: 16px/1.5 sans-serif; color: #111; background: #fff; max-width: 60rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
table { border-collapse: collapse; margin: 0.8rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: 0.15rem 0.8rem; text-align: right; border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #555; } th:first-child, td:first-child { text-align: left; }
figure { margin: 1rem 0; } figure svg { width: 100%; height: auto; }
figcaption, p.note { color: #444; font-size: 0.9rem; }
.scroll { overflow-x: auto; }
@media print { body { margin: 0; max-width: none; } }
"""

_ABOUT_V = (
    "V is the energy of the difference between estimate and truth, &frac12; "
    "du<sup>T</sup> M du + &frac12; dq<sup>T</sup> K dq. An estimate has settled when V stays "
    "below {settled:g} of its start. The rates are the fall of ln V per second and per impact, "
    "until V is first within a factor of ten of its end."
)
_ABOUT_V_OF_ROBOTS = (
    "Of a robot V is &frac12; du<sup>T</sup> M(q) du + &frac12; dq<sup>T</sup> M(q) dq / "
    "s<sup>2</sup> with the true q."
)
_ABOUT_IMPACTS = (
    "Late samples were published before their event had arrived. Between the jumps: the truth had "
    "jumped at an impact and the estimate had not, or the other way round; number of samples, the "
    "longest such window and the largest V in one. Neither counts in any other metric."
)
_ABOUT_ERRORS = "Estimate minus truth. A gap in a curve means that the estimate is exact there."


def write_report(
    path: Path,
    labelled: Mapping[str, Comparison],
    results: Sequence[tuple[Path, BagComparison]],
) -> None:
    """Write the page; an existing file is replaced.

    Raises:
        UsageError: the file may not be written.
        OutputError: the disk is full or gone.
    """
    text = "\n".join(_page(labelled, results))
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _page(
    labelled: Mapping[str, Comparison], results: Sequence[tuple[Path, BagComparison]]
) -> Iterator[str]:
    title = markup(f"Estimates of {system_names(labelled)}")
    settled = next(iter(labelled.values())).settled
    bags = [bag for bag, _ in results]
    yield f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<style>{_STYLE}</style></head><body><h1>{title}</h1>"
    yield _note(f"Made by impact_observer {markup(__version__)}.")
    yield "<h2>Recordings</h2>"
    yield _html(_bags_table(results))
    yield _note(f"Times since {instants_of(results)} of each recording.")
    yield "<h2>Distance from the truth</h2>"
    picture = svg(distance_picture(labelled, results))
    yield _figure(picture, f"V over time, {_names(bags)}")
    yield _html(table_of_laws(DISTANCE, labelled))
    yield _note(_ABOUT_V.format(settled=settled))
    if any(isinstance(each.system, Robot) for each in labelled.values()):
        yield _note(_ABOUT_V_OF_ROBOTS)
    yield "<h2>Impacts</h2>"
    yield _html(table_of_laws(IMPACTS, labelled))
    yield _note(_ABOUT_IMPACTS)
    if (around_hits := hits_picture(labelled)) is not None:
        begin, end = (1e3 * each for each in AFTER_HITS)
        yield _figure(svg(around_hits), "Errors of the velocities after hits, all hits together")
        yield _note(f"After hits: the errors from {begin:g} to {end:g} ms after each hit.")
    yield "<h2>Errors of each state</h2>"
    for shown, n, figure in error_pictures(labelled, results):
        most = f"; the {MOST_COORDINATES} coordinates with the largest"
        which = most if n > MOST_COORDINATES else ""
        yield _figure(svg(figure), f"Sizes of the errors, {_names(shown)}{which}")
    yield _html(errors_table(labelled))
    yield _note(_ABOUT_ERRORS) + "</body></html>"


def _bags_table(results: Sequence[tuple[Path, BagComparison]]) -> TextTable:
    """The bags: system, time that is compared, and impacts."""
    rows = []
    for bag, result in results:
        begin = min(int(each.stamps[0]) for each in result.comparisons.values())
        end = max(int(each.stamps[-1]) for each in result.comparisons.values())
        row = (
            str(bag),
            result.system.name,
            f"{seconds_between(result.zero.stamp, begin):.6g}",
            f"{seconds_between(result.zero.stamp, end):.6g}",
            listed(f"{stamps.size} at {name}" for name, stamps in result.impacts.items()),
        )
        rows.append(row)
    return TextTable(("bag", "system", "from [s]", "to [s]", "impacts"), rows)


def _names(bags: Sequence[Path]) -> str:
    """The bags, each once."""
    return ", ".join(dict.fromkeys(map(str, bags)))


def _note(text: str) -> str:
    return f'<p class="note">{text}</p>'


def _figure(picture: str, caption: str) -> str:
    text = markup(caption)
    described = picture.replace("<svg", f'<svg role="img" aria-label="{text}"', 1)
    return f"<figure>{described}<figcaption>{text}</figcaption></figure>"


def _html(table: TextTable) -> str:
    """A table as HTML."""
    head = "".join(f"<th>{markup(heading)}</th>" for heading in table.headings)
    lines = ["".join(f"<td>{markup(cell)}</td>" for cell in row) for row in table.rows]
    body = "".join(f"<tr>{line}</tr>\n" for line in [head, *lines])
    return f'<div class="scroll"><table>{body}</table></div>'
