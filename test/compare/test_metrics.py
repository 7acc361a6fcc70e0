# SPDX-License-Identifier: Apache-2.0
"""The table of metrics: what docs, tables, JSON and CSV have in common."""

from impact_observer.compare.metrics import METRICS
from impact_observer.resources import shared


def test_docs_list_every_metric_with_unit_and_meaning() -> None:
    """The table in docs/compare.md has these keys and headings, in the same order."""
    _, page = (shared("docs") / "compare.md").read_text("utf-8").split("| key |")
    rows = [r.split(" | ") for r in page.split("\n\n")[0].splitlines() if r.startswith("| `")]
    assert [(key, heading.strip()) for key, heading, _, _ in rows] == [
        (f"| `{each.key}`", each.heading) for each in METRICS
    ]
    assert all(meaning.strip(" |") for *_, meaning in rows)


def test_keys_and_headings_are_unique() -> None:
    """A key names one metric, a heading one column of its table."""
    keys = [each.key for each in METRICS]
    assert len(set(keys)) == len(keys)
    columns = [(each.table, each.heading) for each in METRICS if each.table]
    assert len(set(columns)) == len(columns)
