# SPDX-License-Identifier: Apache-2.0
"""Reports of commands: counts, lists, figures, facts and tables as text.

On a terminal ``rich`` folds long facts. Each row of a table, and where standard output is no
terminal each fact, is one line as long as its text. Nothing is cut off. Control characters of
names are escaped.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import floor, inf, isfinite, log10
from typing import NamedTuple

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from impact_observer.plain_text import printable

_ROUNDING = 1e-12
"""A deviation, relative to its value, that is rounding."""
_UNLIMITED = 10**6
"""Columns of a line that is not folded."""
_STYLES = {"error": "bold red", "warning": "yellow", "note": "dim", "ok": "green"}
"""Styles of the kinds of remarks on a terminal."""


class ReportLine(NamedTuple):
    """A fact with its consequence.

    Attributes:
        kind: ``ok``, ``note``, ``warning`` or ``error``.
        text: one or two sentences.
    """

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table whose cells are text.

    Attributes:
        headings: of the columns. The first column holds words.
        rows: a cell for each column.
        title: above the table; empty for none.
        words: headings of the other columns that hold words; the rest hold numbers, which are
            aligned at the right.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    words: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check that every row has a cell for each column.

        Raises:
            ValueError: a row has fewer or more cells.
        """
        for row in self.rows:
            if len(row) != len(self.headings):
                raise ValueError(f"row {row}: expected {len(self.headings)} cells")


def counted(number: int, noun: str, ending: str = "s") -> str:
    """A number with its noun: ``1 event``, ``2 events``; ``ending`` makes the plural."""
    return f"{number} {noun}{'' if number == 1 else ending}"


def listed(words: Iterable[str], most: int = 8, joint: str = " and ") -> str:
    """Words as a list, such as ``a, b and c``; ``none`` for no word.

    Args:
        words: the entries.
        most: largest number of entries; of more words the last entry is their number, such as
            ``5 more``.
        joint: what stands before the last entry.
    """
    shown = [*words]
    if len(shown) > most:
        kept = max(most - 1, 1)
        shown = [*shown[:kept], f"{len(shown) - kept} more"]
    if not shown:
        return "none"
    *first, last = shown
    return f"{', '.join(first)}{joint}{last}" if first else last


def figure(value: float, unit: str = "", deviation: float = 0.0) -> str:
    """A number with its unit: three digits, or digits to the second one of its deviation.

    With a standard deviation the text is, for example, ``0.7006 +- 0.0039 m``. A deviation of 0,
    such as that of a parameter at its bound, is not written, nor one that is rounding.
    """
    if not (isfinite(value) and _ROUNDING * abs(value) < deviation < inf):
        return f"{value:.3g} {unit}".rstrip()
    spread = f"{deviation:.2g}"
    last = floor(log10(float(spread))) - 1  # the place of its second digit
    first = floor(log10(abs(value))) if value else last
    digits = min(max(first - last + 1, 1), 15)
    shown = f"{value:#.{digits}g}".replace(".e", "e").rstrip(".")
    if not value:
        shown = f"{0:.{max(-last, 0)}f}"
    return f"{shown} +- {spread} {unit}".rstrip()


def print_facts(facts: Iterable[tuple[str, str]]) -> None:
    """Print names, or the kinds of remarks, with a text beside each.

    Args:
        facts: names with texts; an empty name continues the fact before.
    """
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    for name, text in facts:
        grid.add_row(literal_text(name, _STYLES.get(name, "")), literal_text(text))
    if grid.row_count:
        _print(grid)


def print_table(table: TextTable) -> None:
    """Print a table; of a table with a title the title first."""
    if table.title:
        _print(literal_text(table.title))
    drawn = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for place, heading in enumerate(table.headings):
        is_words = place == 0 or heading in table.words
        drawn.add_column(literal_text(heading), justify="left" if is_words else "right")
    for row in table.rows:
        drawn.add_row(*map(literal_text, row))
    _print(drawn, _UNLIMITED)


def literal_text(text: str, style: str = "") -> Text:
    """Text for a terminal: control characters are escaped, and brackets are no markup."""
    return Text("\n".join(map(printable, text.split("\n"))), style)


def _print(lines: RenderableType, width: int | None = None) -> None:
    """Print lines without spaces at their ends, folded to the terminal or a ``width``."""
    if width is None and not sys.stdout.isatty():
        width = _UNLIMITED
    # A given height keeps rich from assuming 80 columns on a dumb terminal.
    console = Console(highlight=False, width=width, height=25)
    with console.capture() as capture:
        console.print(lines)
    for line in capture.get().splitlines():
        sys.stdout.write(f"{line.rstrip()}\n")
    sys.stdout.flush()
