# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The table of metrics: what docs, tables, JSON and CSV have in common."""

from impact_observer.compare.metrics import METRICS
from impact_observer.resources import shared


def test_docs_list_every_metric_with_unit_and_meaning() -> None:
    """The table in docs/comparing.md has these keys and headings, in the same order."""
    lines = (shared("docs") / "comparing.md").read_text("utf-8").splitlines()
    rows = [line.split(" | ") for line in lines if line.startswith("| `")]
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
