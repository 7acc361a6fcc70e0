# SPDX-License-Identifier: Apache-2.0
"""README and docs agree with the code."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs.tables import files
from impact_observer.cli.main import COMMANDS
from impact_observer.model import read_model
from impact_observer.observer import ReplicaLaw

ROOT = Path(__file__).parents[1]
TABLES = files()
COMMAND_PAGE = (ROOT / "docs" / "commands.md").read_text()


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of a language, without their indentation."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", text, re.MULTILINE | re.DOTALL)
    return [
        "".join(line[len(indent) :] for line in body.splitlines(keepends=True))
        for indent, body in found
    ]


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.name)
def test_tables_of_options_and_samples_of_parameters_are_those_of_the_code(path: Path) -> None:
    """Where they differ, ./dev docs writes them again."""
    assert path.read_text(encoding="utf-8") == TABLES[path]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_page_of_commands_lists_every_command(command: str) -> None:
    """With what it does."""
    assert re.search(rf"^\| `{command}[ `]", COMMAND_PAGE, re.MULTILINE)


def test_every_page_is_in_the_reading_order() -> None:
    """A page that no index names is not found."""
    index = (ROOT / "docs" / "README.md").read_text()
    docs = ROOT / "docs"
    pages = {str(path.relative_to(docs)) for path in docs.glob("*.md")} - {"README.md"}
    pages |= {str(path.relative_to(docs)) for path in docs.glob("theory/*.md")}
    assert pages == set(re.findall(r"\]\(([\w/]+\.md)\)", index))


def test_the_example_of_a_sweep_in_python_runs() -> None:
    """It makes rows that have figures."""
    (code,) = blocks((ROOT / "docs" / "compare.md").read_text(), "python")
    space: dict[str, object] = {}
    exec(compile(code, "compare.md", "exec"), space)
    rows = space["rows"]
    assert isinstance(rows, list)
    assert [row["error"] for row in rows] == [""] * 8


def test_the_law_of_the_page_of_laws_is_newtons_law() -> None:
    """Contact speeds are reversed, and nothing else receives an impulse."""
    space: dict[str, Any] = {}
    (code,) = blocks((ROOT / "docs" / "laws.md").read_text(), "python")
    exec(compile(code, "laws.md", "exec"), space)
    system = read_model("three_mass").system
    assert issubclass(space["Newton"], ReplicaLaw)
    law, x = space["Newton"](system), np.random.default_rng(1).normal(size=2 * system.n)
    for active in ((0,), tuple(range(system.m))):
        for closed in ((), active[:1]):
            after = law.impact(x, active, closed)
            jump = after - x
            speeds = system.contact_speed(after[system.n :])[list(active)]
            before = system.contact_speed(x[system.n :])[list(active)]
            rest = [0.0 if i in closed else system.eps[i] for i in active]
            np.testing.assert_allclose(speeds, -np.multiply(rest, before), atol=1e-12)
            np.testing.assert_array_equal(jump[: system.n], 0.0)
            impulse, W = system.M @ jump[system.n :], system.W[:, list(active)]
            unseen = impulse - W @ np.linalg.lstsq(W, impulse, rcond=None)[0]
            np.testing.assert_allclose(unseen, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    "document",
    [
        "README.md",
        "CONTRIBUTING.md",
        "QUALITY_DECLARATION.md",
        "bags/README.md",
        "examples/README.md",
        *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md")),
        *(f"docs/theory/{p.name}" for p in (ROOT / "docs" / "theory").glob("*.md")),
    ],
)
def test_links_between_documents_have_targets(document: str) -> None:
    """Every relative link names a file that is there."""
    path = ROOT / document
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text())
    missing = [link for link in links if not (path.parent / link).exists()]
    assert missing == []
    assert path.stat().st_size > 0
