# SPDX-License-Identifier: Apache-2.0
"""Tables of text on a terminal, by ``rich``."""

import os
import sys
from collections.abc import Collection, Iterable
from typing import Any, Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.table import Column, Table
from rich.text import Text

from impact_observer.plain_text import printable

_FOLDED = 10
"""Least width of a column whose words may be folded."""


class LiteralConsole(Console):
    """A console that escapes the control characters of what it prints, such as of names."""

    def render_str(self, text: str, **style: Any) -> Text:  # noqa: ANN401 (as its base class has it)
        """Make a text, line by line."""
        return super().render_str("\n".join(map(printable, text.split("\n"))), **style)


def console(width: int = 140) -> Console:
    """A console for standard output that prints names literally: brackets are no markup.

    Args:
        width: columns to use where the output is no terminal and ``COLUMNS`` is not set.
    """
    if sys.stdout.isatty():
        return LiteralConsole(highlight=False, markup=False, emoji=False)
    # With a height too rich does not fall back to 80 columns where TERM is dumb.
    given = None if "COLUMNS" in os.environ else width
    return LiteralConsole(highlight=False, markup=False, emoji=False, width=given, height=25)


def ruled_table(title: str, *headings: str) -> Table:
    """An empty table with a title, a rule below the headings, and numbers in all columns but one.

    Args:
        title: above the table.
        headings: of the columns; the first one holds words.
    """
    table = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        collapse_padding=True,
        pad_edge=False,
    )
    table.add_column(headings[0], overflow="fold")
    for heading in headings[1:]:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def plain_table(*headings: str, names: Collection[str] = (), words: Collection[str] = ()) -> Table:
    """An empty table without a title and without rules.

    Args:
        headings: of the columns.
        names: those headings whose columns hold names, which are never folded.
        words: those headings whose columns hold words, which may be folded; the columns that are
            neither names nor words hold numbers.
    """
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for heading in headings:
        justify: Literal["left", "right"] = "left" if heading in {*names, *words} else "right"
        no_wrap = heading not in words
        table.add_column(heading, justify=justify, overflow="fold", no_wrap=no_wrap)
    return table


def facts_table(rows: Iterable[tuple[RenderableType, RenderableType]]) -> Table:
    """A table of names and values without headings; long values are folded."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def print_report(table: Table, sentences: Iterable[str], above: Iterable[str] = ()) -> None:
    """Print a table, with sentences ``above`` and below it."""
    terminal = console(100)
    for sentence in above:
        terminal.print(sentence)
        terminal.print()
    terminal.print(fitted(table, terminal.width))
    terminal.print()
    for sentence in sentences:
        terminal.print(sentence)


def fitted(table: Table, width: int) -> Table:
    """``table``, or the same upright where its columns need more than ``width``."""
    needed = sum(_least_width(column) + 2 for column in table.columns)
    return table if needed <= width else upright(table)


def _least_width(column: Column) -> int:
    """The width of what cannot be folded."""
    widths = [cell_len(str(cell)) for cell in (column.header, *column.cells)]
    return max(widths) if column.no_wrap else min(max(widths), _FOLDED)


def upright(table: Table) -> Table:
    """The same table for a narrow terminal: the cells of a row stand below each other."""
    upright = Table(box=None, title=table.title, title_justify="left", show_header=False)
    upright.add_column()
    upright.add_column(overflow="fold")
    headings = [str(column.header) for column in table.columns]
    for row in zip(*(column.cells for column in table.columns), strict=True):
        for heading, cell in zip(headings, row, strict=True):
            if cell:
                upright.add_row(heading, str(cell))
        upright.add_row("", "")
    return upright
