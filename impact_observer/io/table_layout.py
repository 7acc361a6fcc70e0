# SPDX-License-Identifier: Apache-2.0
"""How a table is written: its separator, its rows of numbers, and its header above them."""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import NamedTuple, NoReturn

from impact_observer.errors import UsageError
from impact_observer.io.table_times import (
    is_dated,
    ns_of_clock,
    ns_of_date,
    time_rank,
    unit_named,
)
from impact_observer.stamps import NS_PER_S

SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": " "}
"""What separates columns, by name."""
_NONE = "\x1f"
"""A separator that stands in no table, of rows that are one cell."""
_SAMPLE = 1000
"""First rows that show how a table is written."""
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,6})?", re.IGNORECASE)
_WITH_COMMA = re.compile(r"[+-]?\d*,\d+(?:e[+-]?\d{1,6})?", re.IGNORECASE)
_TO_BE_SPLIT = re.compile(r"[+-]?\.?\d.*[\s;,]")
NO_NUMBERS = {"", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "∞"}
"""Texts of cells without a number that programs write into columns of numbers."""
_BLANK = " \t,;\x1a"
"""Characters of lines that hold nothing."""
_COMMENTS = "#\\"
"""First characters of comments, and of the frequencies among the labels of Audacity."""
_AXES = {"x-axis", "x axis", "x", "source", "t", "time"}
"""Names above ``second`` in tables of oscilloscopes."""
_SHOWN = 60
"""Letters of a cell in an error."""


@dataclass(frozen=True, slots=True)
class TableForm:
    """Options for reading a table; None, 0 and False leave the choice to the table.

    Attributes:
        unit: of time, a key of ``UNITS``; None for that in the header, else seconds.
        time_column: name of the column of time; None for one that is called a time.
        sort: whether rows may stand in any order.
        separator: of columns, a key of ``SEPARATORS``.
        decimal: ``point`` or ``comma``; None for either, where no commas separate columns.
        skip_rows: lines at the beginning that are not read.
        frame_rate: of the frames that a column, or the rows, count, Hz.
    """

    unit: str | None = None
    time_column: str | None = None
    sort: bool = False
    separator: str | None = None
    decimal: str | None = None
    skip_rows: int = 0
    frame_rate: Fraction | None = None


class Layout(NamedTuple):
    """How a table is written.

    Attributes:
        mark: what separates columns.
        decimal_comma: whether numbers may have a comma.
        first: line of the first row, from 1.
        header: line of the header; 0 without a header.
        names: of the columns; empty for a column that is not read.
        units: of the columns, from a row below the names; empty without such a row.
        start: time of the first row, ns, where the header has the ``step`` of the times.
        step: between two rows, ns; 0 where times stand in the rows.
    """

    mark: str
    decimal_comma: bool
    first: int
    header: int
    names: list[str]
    units: list[str]
    start: int = 0
    step: Fraction = Fraction(0)


class _Reading(NamedTuple):
    """What the first rows of a table are if columns are separated in a certain way.

    Attributes:
        mark: what separates columns.
        decimal_comma: whether numbers may have a comma.
        rows: cells of the rows.
        places: of the numbers and dates in most rows.
        alike: how many rows have numbers and dates in just these places.
    """

    mark: str
    decimal_comma: bool
    rows: list[list[str]]
    places: tuple[int, ...]
    alike: int

    @property
    def has_columns(self) -> bool:
        """Whether a row that is like most rows has several cells."""
        return any(len(r) > 1 for r in self.rows if _places(r, self.decimal_comma) == self.places)

    @property
    def first(self) -> int:
        """Which row is the first one of numbers; some of them may be missing there."""
        k = [_places(row, self.decimal_comma) for row in self.rows].index(self.places)
        while k and self._is_incomplete(self.rows[k - 1]):
            k -= 1
        return k

    def _is_incomplete(self, row: Sequence[str]) -> bool:
        found = {*_places(row, self.decimal_comma)}
        missing = [row[k].lower() for k in self.places if k < len(row) and k not in found]
        return bool(found & {*self.places}) and NO_NUMBERS.issuperset(missing)


def find_layout(
    path: Path, lines: Sequence[str], form: TableForm, expected: str, *, strict: bool
) -> Layout:
    """How a table is written, by its first rows.

    Args:
        path: of the file, for errors.
        lines: of the file.
        form: options.
        expected: columns, for errors.
        strict: whether columns of words, and numbers of frames in a table without a header, count.

    Raises:
        UsageError: no row has a number, or two readings are possible.
    """
    sample = [*islice(content(lines, form.skip_rows + 1), _SAMPLE)]
    reading = _best_reading(path, lines, sample, form)
    if not reading.alike:
        options = "; --separator and --decimal say how it is written" if sample else ""
        raise UsageError(f"{path}: holds no row of numbers; expected {expected}{options}")
    first = sample[reading.first]
    header, cells = _header(lines, first, reading, form)
    layout = Layout(reading.mark, reading.decimal_comma, first, header, cells, [])
    if not header:
        return layout._replace(names=_made_up_names(reading, form, strict=strict))
    above = _above(lines, header, form)
    upper = _cells(lines, above, reading.mark) if above else []
    if len(_trimmed(upper)) != len(_trimmed(cells)):
        return layout
    lower = [each.lower() for each in upper]
    if cells[0] == "Sequence" and {"start", "increment"} <= {*lower}:  # of Rigol
        start, step = (cells[lower.index(each)] for each in ("start", "increment"))
        if not (_NUMBER.fullmatch(start) and _NUMBER.fullmatch(step) and float(step)):
            wrong(path, header, "no start and increment of the times; expected numbers")
        return layout._replace(
            names=["sequence", *upper[1 : lower.index("start")]],
            start=round(Fraction(start) * NS_PER_S),
            step=Fraction(step) * NS_PER_S,
        )
    named = (unit_named(c) and name in _AXES for c, name in zip(cells, lower, strict=False))
    if any(named) or all(re.fullmatch(r"[\[(].*[\])]|", each) for each in cells):
        return layout._replace(names=upper, units=cells)
    return layout


def content(lines: Sequence[str], first: int) -> Iterator[int]:
    """Numbers of the lines from ``first`` on that are neither empty nor comments."""
    numbered = enumerate(islice(lines, first - 1, None), first)
    return (k for k, line in numbered if line.strip(_BLANK) and line[0] not in _COMMENTS)


def is_number(cell: str, *, decimal_comma: bool) -> bool:
    """Whether a cell is a decimal number."""
    return bool(_NUMBER.fullmatch(cell) or (decimal_comma and _WITH_COMMA.fullmatch(cell)))


def shown(cell: str) -> str:
    """A cell or line for an error."""
    return repr(cell if len(cell) <= _SHOWN else f"{cell[:_SHOWN]}...")


def wrong(path: Path, line: int, problem: str) -> NoReturn:
    """Raise the error of a line.

    Raises:
        UsageError: always.
    """
    raise UsageError(f"{path}, line {line}: {problem}")


def _best_reading(
    path: Path, lines: Sequence[str], sample: Sequence[int], form: TableForm
) -> _Reading:
    """The reading with most rows that are alike, if no other one is as good.

    Blanks stand beside other separators, too, so they are tried last.
    """
    texts = [lines[k - 1] for k in sample]
    if form.separator is not None:
        return _reading(texts, SEPARATORS[form.separator], form.decimal)
    marks = "\t;" if form.decimal == "comma" else "\t;,"
    several = [_reading(texts, mark, form.decimal) for mark in marks]
    one, blank = (_reading(texts, mark, form.decimal) for mark in (_NONE, " "))
    several = [reading for reading in several if reading.alike and reading.has_columns]
    best = max(several, key=lambda reading: reading.alike, default=one)
    if best.mark == "," and best.alike == one.alike:
        first = sample[best.first]
        above = _above(lines, first, form)
        name = lines[above - 1].strip("#" + _BLANK) if above else ""
        if "," not in name and not time_rank(name):
            found = f"{shown(texts[best.first])} is two columns, or one with a decimal comma"
            wrong(path, first, f"{found}; expected --separator comma or --decimal comma")
        best = best if "," in name else one
    return max(best, one, blank, key=lambda reading: reading.alike)


def _reading(lines: Sequence[str], mark: str, decimal: str | None) -> _Reading:
    comma = decimal == "comma" or (decimal is None and mark != ",")
    rows = [_split(line, mark) for line in lines]
    groups = Counter(places for row in rows if (places := _places(row, comma)))
    ((places, count),) = groups.most_common(1) or [((), 0)]
    return _Reading(mark, comma, rows, places, count)


def _split(line: str, mark: str) -> list[str]:
    """The cells of a line, without blanks around them; none if quotes are not closed."""
    if mark == " ":
        line = " ".join(line.split())
        line = line if '"' in line else re.sub(r" (?=[\[(])", "_", line)  # time (s)
    try:
        row = next(csv.reader([line], delimiter=mark, strict=True, skipinitialspace=True), [])
    except csv.Error:
        return []
    return [cell.strip() for cell in row]


def _places(cells: Sequence[str], decimal_comma: bool) -> tuple[int, ...]:
    """Places of the numbers and dates in a row; none if a cell should be split further."""
    known = [is_number(c, decimal_comma=decimal_comma) or is_dated(c) for c in cells]
    if any(_TO_BE_SPLIT.match(c) for c, good in zip(cells, known, strict=True) if not good):
        return ()
    return tuple(k for k, good in enumerate(known) if good)


def _above(lines: Sequence[str], line: int, form: TableForm) -> int:
    """Number of the last line above a line that is not empty; 0 for none."""
    numbers = range(line - 1, form.skip_rows, -1)
    return next((k for k in numbers if lines[k - 1].strip(_BLANK)), 0)


def _cells(lines: Sequence[str], line: int, mark: str) -> list[str]:
    """The cells of a line above the rows; a leading ``#`` is taken off."""
    return _split(lines[line - 1].lstrip("#"), mark)


def _header(
    lines: Sequence[str], first: int, reading: _Reading, form: TableForm
) -> tuple[int, list[str]]:
    """Line and cells of the header, the last line above the rows with as many cells.

    A comment is the header if it names a time. Without a header: line 0, no cells.
    """
    line = first
    while line := _above(lines, line, form):
        cells = _cells(lines, line, reading.mark)
        has_time = any(time_rank(each) or each == form.time_column for each in cells)
        if len(cells) > reading.places[-1] and (has_time or lines[line - 1][0] != "#"):
            return line, cells
    return 0, []


def _made_up_names(reading: _Reading, form: TableForm, *, strict: bool) -> list[str]:
    """Names of columns without a header: the first one of numbers is the time.

    In a strict table the first one without numbers is the contact, and the next one the kind.
    """
    row, places = reading.rows[reading.first], [*reading.places]
    width = max(map(len, reading.rows))
    kept = range(width) if strict else places
    names = [f"column{k + 1}" if k in kept else "" for k in range(width)]
    if form.frame_rate is None or strict:
        names[places[0]] = "time" if form.frame_rate is None else "frame"
        if len(places) > 1 and ns_of_date(row[places[0]]) and ns_of_clock(row[places[1]]):
            names[places[0]], names[places[1]] = "date", "time"
    values = [k for k in places if names[k] == f"column{k + 1}"]
    if len(values) == 1:
        names[values[0]] = "value"
    words = [k for k in range(places[0], width) if strict and k not in places]
    if words:
        names[words[0] : words[0] + 2] = ["contact", "kind"][: width - words[0]]
    return names


def _trimmed(cells: list[str]) -> list[str]:
    """The cells without empty ones at the end."""
    return cells[: max((k for k, cell in enumerate(cells, 1) if cell), default=0)]
