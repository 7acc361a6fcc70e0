"""A page of HTML on a comparison: figures and pictures in one file that needs no network."""

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer import __version__
from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from impact_observer.compare.bag_comparison import BagComparison
    from impact_observer.compare.comparison import Comparison

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
    "below {threshold:g} of its start. The rates say by how much ln V falls, a second and an "
    "impact, until V is first within a factor of ten of its end."
)
_ABOUT_IMPACTS = (
    "Late samples were published before their event had arrived. Between the jumps: the truth had "
    "jumped at an impact and the estimate had not, or the other way round; how many samples, the "
    "longest such window and the largest V in one. Neither counts in any other figure."
)
_ABOUT_ERRORS = "Estimate minus truth. In a picture a gap says that the estimate is exact."


def write_report(
    path: Path,
    labelled: "dict[str, Comparison]",
    results: "Sequence[tuple[Path, BagComparison]]",
) -> None:
    """Write the page; one that is there is replaced.

    Args:
        path: of the page.
        labelled: every estimate, by its label.
        results: the bags and what came out of each.

    Raises:
        UsageError: the file cannot be written.
    """
    text = "\n".join(_page(labelled, results))
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def _page(
    labelled: "dict[str, Comparison]", results: "Sequence[tuple[Path, BagComparison]]"
) -> Iterator[str]:
    """The page, part by part."""
    from impact_observer.compare.error_tables import errors_table, impacts_table, table_of

    first = next(iter(labelled.values()))
    names = ", ".join(dict.fromkeys(each.system.name for each in labelled.values()))
    title = escape(f"Estimates of {names}")
    yield f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<style>{_STYLE}</style></head><body><h1>{title}</h1>"
    yield f'<p class="note">Made by impact_observer {escape(__version__)}.</p>'
    yield "<h2>Recordings</h2>"
    yield from _bags(results)
    yield "<h2>Distance from the truth</h2>"
    yield from _distances(labelled, results)
    yield from _rows(table_of(labelled))
    yield f'<p class="note">{_ABOUT_V.format(threshold=first.threshold)}</p>'
    yield "<h2>Impacts</h2>"
    yield from _rows(impacts_table(labelled))
    yield f'<p class="note">{_ABOUT_IMPACTS}</p>'
    yield "<h2>Errors of each state</h2>"
    yield from _errors(labelled, results)
    yield from _rows(errors_table(labelled))
    yield f'<p class="note">{_ABOUT_ERRORS}</p></body></html>'


def _bags(results: "Sequence[tuple[Path, BagComparison]]") -> Iterator[str]:
    """What was compared."""
    from impact_observer.stamps import seconds_between

    yield '<div class="scroll"><table><tr><th>bag</th><th>system</th><th>from [s]</th>'
    yield "<th>to [s]</th><th>impacts</th></tr>"
    for bag, result in results:
        stamps = [(each.stamps[0], each.stamps[-1]) for each in result.comparisons.values()]
        begin, end = int(min(a for a, _ in stamps)), int(max(b for _, b in stamps))
        impacts = ", ".join(f"{v.size} at {name}" for name, v in result.impacts.items()) or "none"
        cells = (
            escape(str(bag)),
            escape(result.system.name),
            f"{seconds_between(result.epoch, begin):.6g}",
            f"{seconds_between(result.epoch, end):.6g}",
            escape(impacts),
        )
        yield "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"
    yield '</table></div><p class="note">Times since the epoch of each recording.</p>'


def _distances(
    labelled: "dict[str, Comparison]", results: "Sequence[tuple[Path, BagComparison]]"
) -> Iterator[str]:
    """A picture of V."""
    from impact_observer.compare.error_pictures import distance_figure
    from impact_observer.draw.pictures import svg

    caption = f"V over time, {_listed([bag for bag, _ in results])}"
    yield from _figure(svg(distance_figure(labelled, results)), caption)


def _errors(
    labelled: "dict[str, Comparison]", results: "Sequence[tuple[Path, BagComparison]]"
) -> Iterator[str]:
    """A picture of the errors for each kind of system."""
    from impact_observer.compare.error_pictures import MOST_COORDINATES, error_figures
    from impact_observer.draw.pictures import svg

    for bags, n, figure in error_figures(labelled, results):
        most = f"; the {MOST_COORDINATES} coordinates with the largest"
        which = most if n > MOST_COORDINATES else ""
        yield from _figure(svg(figure), f"Sizes of the errors, {_listed(bags)}{which}")


def _listed(bags: Sequence[Path]) -> str:
    """Bags, each once."""
    return ", ".join(dict.fromkeys(map(str, bags)))


def _figure(picture: str, caption: str) -> Iterator[str]:
    text = escape(caption)
    described = picture.replace("<svg", f'<svg role="img" aria-label="{text}"', 1)
    yield f"<figure>{described}<figcaption>{text}</figcaption></figure>"


def _rows(table: "Table") -> Iterator[str]:
    """A table of the terminal as one of the page."""
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    headings = "".join(f"<th>{escape(str(column.header))}</th>" for column in table.columns)
    yield f'<div class="scroll"><table><tr>{headings}</tr>'
    for cells in zip(*columns, strict=True):
        yield "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
    yield "</table></div>"
