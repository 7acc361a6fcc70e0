"""The table of figures: what docs, tables, JSON and CSV have in common."""

from impact_observer.compare.figures import FIGURES
from impact_observer.resources import shared


def test_docs_list_every_figure_with_unit_and_meaning() -> None:
    """The table in docs/comparing.md has these rows, in the same order."""
    lines = (shared("docs") / "comparing.md").read_text("utf-8").splitlines()
    rows = [line for line in lines if line.startswith("| `")]
    assert rows == [
        f"| `{each.key}` | {each.heading.format(threshold=0.01)} | {each.unit} | {each.meaning} |"
        for each in FIGURES
    ]


def test_keys_are_unique_and_headings_belong_to_tables() -> None:
    """A figure is in a printed table just if it has a heading."""
    keys = [each.key for each in FIGURES]
    assert len(set(keys)) == len(keys)
    assert all((each.table is None) == (each.heading == "") for each in FIGURES)
