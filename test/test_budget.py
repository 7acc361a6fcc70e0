# SPDX-License-Identifier: Apache-2.0
"""The totals of the table in docs/house.md do not grow."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_observer.bank.ladders import Numbers
from impact_observer.cli.main import COMMANDS, main

ROOT = Path(__file__).resolve().parents[1]
HOUSE = (ROOT / "docs" / "house.md").read_text(encoding="utf-8")
LIMITS = {name: int(total) for name, total in re.findall(r"(?m)^\| ([^|]+) \| (\d+) \|$", HOUSE)}


def lines(folder: str, *patterns: str) -> int:
    """Lines of the files below a folder whose names match."""
    files = [path for pattern in patterns for path in (ROOT / folder).rglob(pattern)]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)


def words() -> int:
    """Words of README and of the pages below docs."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    return sum(len(path.read_text(encoding="utf-8").split()) for path in pages)


def options(capsys: pytest.CaptureFixture[str]) -> int:
    """Options in the help of all commands."""
    for command in COMMANDS:
        with pytest.raises(SystemExit):
            main([command, "--help"])
    return len(re.findall(r"(?m)^  -", capsys.readouterr().out))


MEASURES: dict[str, Callable[[pytest.CaptureFixture[str]], int]] = {
    "lines of impact_observer/": lambda _: lines("impact_observer", "*.py"),
    "lines of test/": lambda _: lines("test", "*.py"),
    "lines of benchmarks/": lambda _: lines("benchmarks", "*.py", "*.cpp"),
    "words of README.md and docs/": lambda _: words(),
    "options of the commands": options,
    "tuned numbers, fields of `Numbers`": lambda _: len(Numbers._fields),
}


@pytest.mark.parametrize("name", MEASURES)
def test_a_total_is_at_most_that_in_the_house(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table in docs/house.md has a line of each total, which falls with the total."""
    measured = MEASURES[name](capsys)
    assert measured <= LIMITS[name], f"docs/house.md, {name}: {LIMITS[name]}, found {measured}"
