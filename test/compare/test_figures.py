"""The table of figures: what docs, tables, JSON and CSV have in common."""

from impact_observer.compare.comparison import SETTLED
from impact_observer.compare.figures import FIGURES, FigureOfMerit
from impact_observer.resources import shared


def heading(figure: FigureOfMerit) -> str:
    """Of its column, for the default threshold."""
    return figure.column.heading.format(threshold=SETTLED) if figure.column else ""


def test_docs_list_every_figure_with_unit_and_meaning() -> None:
    """The table in docs/comparing.md has these rows, in the same order."""
    lines = (shared("docs") / "comparing.md").read_text("utf-8").splitlines()
    rows = [line for line in lines if line.startswith("| `")]
    assert rows == [
        f"| `{each.key}` | {heading(each)} | {each.unit} | {each.meaning} |" for each in FIGURES
    ]


def test_keys_and_headings_are_unique() -> None:
    """A key names one figure, a heading one column of its table."""
    keys = [each.key for each in FIGURES]
    assert len(set(keys)) == len(keys)
    columns = [each.column[:2] for each in FIGURES if each.column]
    assert len(set(columns)) == len(columns)
