# SPDX-License-Identifier: Apache-2.0
"""Tables of rows with a time, as rigs, instruments, spreadsheets and loggers write them.

A table is read whole into arrays. Its cells are read as text, so that no digit of a time is lost.
Where two readings are possible, an error names the option that decides.
"""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from textwrap import shorten
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import UsageError
from impact_observer.input_files import open_input
from impact_observer.io.table_times import (
    NO_TIME,
    UNDERSTOOD,
    UNITS,
    UnknownUnitError,
    counts_frames,
    is_day,
    ns_of_clock,
    ns_of_date,
    ns_of_numbers,
    time_rank,
    unit_in,
    unit_named,
    unit_words,
)
from impact_observer.plain_text import part_left_out
from impact_observer.stamps import MAX_STAMP, NS_PER_S, seconds_between, text
from impact_observer.states import Stamps, Vector

SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": " "}
"""What separates columns, by name."""
_NONE = "\x1f"
"""A separator that stands in no table: each row is one cell."""
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d{1,6})?", re.IGNORECASE)
_WITH_COMMA = re.compile(r"[+-]?\d*,\d+(?:e[+-]?\d{1,6})?", re.IGNORECASE)
_TO_BE_SPLIT = re.compile(r"[+-]?\.?\d.*[\s;,]")
_NO_NUMBERS = {"", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "∞"}
"""Texts of cells without a number that programs write into columns of numbers."""
_NOTHING = " \t,;\x1a"
"""Characters of lines without content."""
_COMMENTS = "#\\"
"""First characters of comments, and of the frequencies among the labels of Audacity."""
_NO_TEXT = re.compile(rb"[\x01-\x08\x0e-\x19\x1c-\x1f]")
_SAMPLE = 1000
"""First rows, or filled cells of a column, that show how a table is written."""
_LAST, _FEW = 20, 3
"""How many rows are compared with a last one that may be cut, at most and at least."""
_SHOWN = 60
"""Letters of a cell in an error."""
_Cells = NDArray[np.object_]

_FEW_CELLS = 3
"""Most cells of a file with a single row, such as of one impact: time, contact, kind."""


@dataclass(frozen=True, slots=True)
class TableForm:
    """Options for reading a table; None, 0 and False leave the choice to the table.

    Attributes:
        time_unit: a key of ``UNITS``; None for that in the header, else seconds.
        time_column: name of the column of time; None for one that is called a time.
        sort: whether rows may stand in any order.
        separator: of columns, a key of ``SEPARATORS``.
        decimal: ``point`` or ``comma``; None for either, where no commas separate columns.
        skip_rows: lines at the beginning that are not read.
        frame_rate: of the frames that a column, or the rows, count, Hz.
    """

    time_unit: str | None = None
    time_column: str | None = None
    sort: bool = False
    separator: str | None = None
    decimal: str | None = None
    skip_rows: int = 0
    frame_rate: Fraction | None = None


@dataclass(frozen=True, eq=False)
class Table:
    """The rows of a table by time.

    Attributes:
        path: the file.
        times: ns after the file's time zero, ascending, shape (rows,).
        lines: where the rows stand in the file, from 1, shape (rows,).
        cells: texts by the name of a column, each of shape (rows,), without columns of time. Names
            that stand in the header twice have ``.1`` and ``.2`` at their ends.
        header: line of the header; 0 without a header.
        words: how times were read, such as ``times in ms``.
        is_counted: whether times are those of frames or rows at a constant rate.
        decimal_comma: whether numbers may have a comma.
        remarks: what was left out, a line each.
    """

    path: Path
    times: Stamps
    lines: NDArray[np.int64]
    cells: Mapping[str, _Cells]
    header: int
    words: str
    is_counted: bool
    decimal_comma: bool
    remarks: tuple[str, ...]

    def find(self, name: str) -> str | None:
        """The column of a name, which may have other capitals; None without the column.

        Raises:
            UsageError: two columns have the name.
        """
        found = [each for each in self.cells if each.lower() == name.lower()]
        if f"{name}.1".lower() in map(str.lower, self.cells) or len(found) > 1:
            self.wrong(self.header, f"two columns {name} found; expected one")
        return found[0] if found else None

    def numbers(self, name: str) -> Vector:
        """The numbers in a column, shape (rows,); NaN where a cell has no finite number."""
        return _floats(_with_points(self.cells[name].tolist(), self.decimal_comma))

    def columns_of_numbers(self) -> list[str]:
        """Names of the columns of which most of the first filled cells are numbers."""
        return [name for name, cells in self.cells.items() if self._are_numbers(cells)]

    def _are_numbers(self, cells: _Cells) -> bool:
        filled = (cell for cell in cells if cell.lower() not in _NO_NUMBERS)
        known = [is_number(each, self.decimal_comma) for each in islice(filled, _SAMPLE)]
        return 2 * sum(known) > len(known)

    def omission(self, name: str, values: Vector) -> str:
        """How many filled cells of a column are no finite number, a line; empty for none."""
        cells = self.cells[name]
        bad = [k for k in np.flatnonzero(np.isnan(values)).tolist() if cells[k]]
        if not bad:
            return ""
        first = f"the first, in line {self.lines[bad[0]]}, is {shown(cells[bad[0]])}"
        why = f"no finite numbers; {first}"
        return f"{self.path}: {part_left_out(len(bad), len(values), f'values of {name}', why)}"

    def wrong(self, line: int, problem: str) -> NoReturn:
        """Raise the error of a line."""
        raise UsageError(f"{self.path}, line {line}: {problem}")


def read_table(path: Path, form: TableForm, expected: str, *, strict: bool = False) -> Table:
    """Read a table with the ``expected`` columns, which errors name.

    A row that cannot be read is an error if ``strict``; else such rows are counted and left out.
    A last line that is cut, and what a loss of power left, always are.

    Raises:
        UsageError: names the file, the line, what was found, and what is expected.
    """
    return _Reader(path, form, strict=strict).table(expected)


def is_number(cell: str, decimal_comma: bool) -> bool:
    """Whether a cell is a decimal number."""
    return bool(_NUMBER.fullmatch(cell) or (decimal_comma and _WITH_COMMA.fullmatch(cell)))


def shown(cell: str) -> str:
    """A cell or line for an error."""
    return repr(cell if len(cell) <= _SHOWN else f"{cell[:_SHOWN]}...")


class _Reading(NamedTuple):
    """The first rows of a table if columns are separated by a mark."""

    mark: str
    decimal_comma: bool
    rows: list[list[str]]
    places: tuple[int, ...]
    """Of the numbers and dates in most rows."""
    alike: int
    """How many rows have numbers and dates in just these places."""

    @classmethod
    def of(cls, lines: Sequence[str], mark: str, decimal: str | None) -> "_Reading":
        """Split the lines."""
        comma = decimal == "comma" or (decimal is None and mark != ",")
        rows = [_split(line, mark) for line in lines]
        groups = Counter(places for row in rows if (places := _places(row, comma)))
        ((places, alike),) = groups.most_common(1) or [((), 0)]
        return cls(mark, comma, rows, places, alike)

    def has_columns(self) -> bool:
        """Whether a row that is like most rows has several cells."""
        return any(len(r) > 1 for r in self.rows if _places(r, self.decimal_comma) == self.places)

    def first(self) -> int:
        """Which row is the first one of numbers; some of them may be missing there."""
        k = [_places(row, self.decimal_comma) for row in self.rows].index(self.places)
        while k and self._is_incomplete(self.rows[k - 1]):
            k -= 1
        return k

    def _is_incomplete(self, row: Sequence[str]) -> bool:
        found = {*_places(row, self.decimal_comma)}
        missing = [row[k].lower() for k in self.places if k < len(row) and k not in found]
        return bool(found & {*self.places}) and _NO_NUMBERS.issuperset(missing)


class _Reader:
    """Reads a table step by step; :meth:`table` has the order of the steps."""

    header: int
    """Line of the header; 0 without a header."""
    names: list[str]
    """Of the columns, as they stand there."""
    rows: NDArray[np.int64]
    """Lines of the rows."""
    cells: list[_Cells]
    """Texts of each column."""
    start, step = 0, Fraction(0)
    """Of the times of frames and rows, ns."""

    def __init__(self, path: Path, form: TableForm, *, strict: bool) -> None:
        """Read the lines of the file."""
        self.path, self.form, self.strict = path, form, strict
        self.remarks: list[str] = []
        self.lost: dict[int, str] = {}  # why lines are left out, by their numbers
        self.bad: dict[int, str] = {}  # of these: an error in a strict table
        with open_input(path) as file:
            data = file.read()
        is_wide = data[:2] in {b"\xff\xfe", b"\xfe\xff"}
        if not is_wide and (_NO_TEXT.search(data[:4096]) or data[:1] == b"\0"):
            remedy = "save it as CSV UTF-8; a sound has the suffix .wav"
            raise UsageError(f"{path}: is no text; {remedy}")
        try:
            decoded = data.decode("utf-16" if is_wide else "utf-8-sig")
        except UnicodeDecodeError:
            decoded = data.decode("cp1252", "replace")
            self.remarks.append("is no text in UTF-8; read as Windows-1252")
        self.lines = decoded.replace("\r\n", "\n").replace("\r", "\n").split("\n")

    def table(self, expected: str) -> Table:
        """The table, as of :func:`read_table`."""
        self.find_rows(expected)
        self.find_names()
        self.split_rows()
        times, columns = self.read_times()
        kept = np.flatnonzero(~np.isin(self.rows, [*self.lost]))
        kept = kept[self.order(times[kept], self.rows[kept])]
        if self.above(begin := self.header or self.first):
            self.words += f", {'header' if self.header else 'first row'} in line {begin}"
        return Table(
            path=self.path,
            times=times[kept],
            lines=self.rows[kept],
            cells={name: cells[kept] for name, cells in columns.items()},
            header=self.header,
            words=self.words,
            is_counted=bool(self.step),
            decimal_comma=self.reading.decimal_comma,
            remarks=tuple(f"{self.path}: {each}" for each in self.remarks),
        )

    def wrong(self, line: int, problem: str) -> NoReturn:
        """Raise the error of a line."""
        raise UsageError(f"{self.path}, line {line}: {problem}")

    def content(self, first: int) -> Iterator[int]:
        """Numbers of the lines from ``first`` on that are neither empty nor comments."""
        numbered = enumerate(islice(self.lines, first - 1, None), first)
        return (k for k, line in numbered if line.strip(_NOTHING) and line[0] not in _COMMENTS)

    def above(self, line: int) -> int:
        """Number of the last line above a line that is not empty; 0 for none."""
        numbers = range(line - 1, self.form.skip_rows, -1)
        return next((k for k in numbers if self.lines[k - 1].strip(_NOTHING)), 0)

    def find_rows(self, expected: str) -> None:
        """Find the reading with most rows that are alike, and the first row."""
        sample = [*islice(self.content(self.form.skip_rows + 1), _SAMPLE)]
        lines, decimal = [self.lines[k - 1] for k in sample], self.form.decimal
        marks = [*"\t;,", _NONE, " "]  # of equally good ones the first is taken
        if self.form.separator is not None:
            marks = [SEPARATORS[self.form.separator]]
        elif decimal == "comma":
            marks.remove(",")
        found = [_Reading.of(lines, mark, decimal) for mark in marks]
        if len(marks) > 1:
            found = [each for each in found if each.mark == _NONE or each.has_columns()]
        best = max(found, key=lambda each: each.alike)
        if not best.alike:
            problem = f"{self.path}: holds no row of numbers; expected {expected}"
            if sample:
                problem += f"; line {sample[-1]} is {shown(lines[-1])} (separator, decimal)"
            raise UsageError(problem)
        self.reading, self.first = best, sample[best.first()]
        above = self.above(self.first)
        is_plain = any(each.mark == _NONE and each.alike == best.alike for each in found)
        if best.mark == "," and is_plain and (not above or "," not in self.lines[above - 1]):
            row = shown(self.lines[self.first - 1])
            problem = f"{row} is two columns, or one with a decimal comma"
            self.wrong(self.first, f"{problem}; expected `separator` or `decimal` to be comma")

    def find_names(self) -> None:
        """Find the header: the last line above the rows that names a time or has as many cells.

        A row of units may be below the names.
        """
        line, cells = self.first, list[str]()
        while line := self.above(line):
            cells = self.cells_above(line)
            has_time = any(time_rank(each) or each == self.form.time_column for each in cells)
            is_long = len(cells) > self.reading.places[-1] and self.lines[line - 1][0] != "#"
            if has_time or is_long:
                break
        self.header, self.names = line, cells if line else self.made_up_names()
        above = self.above(line) if line else 0
        cells, upper = _trimmed(cells), _trimmed(self.cells_above(above) if above else [])
        if not above or len(upper) != len(cells):
            return
        pairs = [*zip(upper, cells, strict=True)]
        if {"Start", "Increment"} <= {*upper}:  # of Rigol
            start, step = (cells[upper.index(each)] for each in ("Start", "Increment"))
            if not (_NUMBER.fullmatch(start) and _NUMBER.fullmatch(step) and float(step)):
                self.wrong(line, "no start and increment of the times; expected numbers")
            self.start, self.step = round(Fraction(start) * NS_PER_S), Fraction(step) * NS_PER_S
            self.names = [cells[0], *upper[1 : upper.index("Start")]]
        elif all(re.fullmatch(r"[\[(].*[\])]|", each) for each in cells):
            self.names = [f"{name} {unit}".strip() for name, unit in pairs]
        elif any(map(unit_named, cells)) and max(map(time_rank, cells)) < 2:
            self.names = [f"{name} ({unit})" if unit else name for name, unit in pairs]

    def cells_above(self, line: int) -> list[str]:
        """The cells of a line above the rows, without a ``#`` before them."""
        return _split(self.lines[line - 1].lstrip("#"), self.reading.mark)

    def made_up_names(self) -> list[str]:
        """Names of columns without a header: the first one of numbers is the time.

        In a strict table the first one without numbers is the contact, and the next one the kind.
        """
        places, width = self.reading.places, max(map(len, self.reading.rows))
        kept = range(width) if self.strict else places
        names = [f"column{k + 1}" if k in kept else "" for k in range(width)]
        values = [*places]
        if self.form.frame_rate is None or self.strict:
            names[values.pop(0)] = "time"
        if len(values) == 1:
            names[values[0]] = "value"
        words = [k for k in range(places[0], width) if k not in places]
        if words and self.strict:
            names[words[0] : words[0] + 2] = ["contact", "kind"][: width - words[0]]
        return names

    def split_rows(self) -> None:
        """Split the rows, each into as many cells as there are names."""
        numbers = [*self.content(self.first)]
        if self.lines[-1] and self.is_cut(numbers):
            self.lost[numbers[-1]] = f"{shown(self.lines[-1])} is cut: the file ends in it"
        for line in numbers:
            if "\0" in self.lines[line - 1]:
                self.lost[line] = "NUL bytes, as a loss of power leaves them"
        numbers = [line for line in numbers if line not in self.lost]
        if not numbers:
            self.wrong(self.first, self.lost[self.first])
        known, rows = len(self.names), list[list[str]]()
        for line in numbers:
            if not (row := _split(self.lines[line - 1], self.reading.mark)):
                self.wrong(line, "a quotation mark is not closed")
            if (width := len(_trimmed(row))) > known:
                self.bad[line] = f"{width} columns found; the header has {known}"
            rows.append([*row[:known], *[""] * (known - len(row))])
        if len(rows) == 1 and not self.header and known > _FEW_CELLS:
            self.wrong(self.first, f"{known} cells in one line found; expected a line for each")
        self.rows = np.array(numbers, dtype=np.int64)
        self.cells = [np.array(column, dtype=object) for column in zip(*rows, strict=True)]

    def is_cut(self, numbers: Sequence[int]) -> bool:
        """Whether the last line ends earlier than those before, of equally many decimals."""
        decimals = r"[.,](\d[\deE+-]*)$" if self.reading.decimal_comma else r"[.](\d[\deE+-]*)$"
        lines = (self.lines[line - 1].rstrip() for line in numbers[-_LAST:])
        *before, last = (len("".join(re.findall(decimals, line))) for line in lines)
        return len(before) >= _FEW and len({*before}) == 1 and last < before[0]

    def read_times(self) -> tuple[Stamps, dict[str, _Cells]]:
        """Times of the rows, ns, and all other columns by their names, told apart."""
        places, rate = self.places_of_time(), self.form.frame_rate
        if rate and (not places or self.form.time_column or counts_frames(self.names[places[0]])):
            self.step = NS_PER_S / rate
        texts = self.cells[places[0]].tolist() if places else [*map(str, range(len(self.rows)))]
        first = next((each for each in texts if each.lower() not in _NO_NUMBERS), "")
        self.is_clock = not self.step and ns_of_clock(first) is not None
        is_dated = not self.step and ns_of_date(first) is not None
        days = [k for k, name in enumerate(self.names) if self.is_clock and is_day(name)]
        if days:
            texts = [f"{day} {time}" for day, time in zip(self.cells[days[0]], texts, strict=True)]
            is_dated, self.is_clock = True, False
        if is_dated or self.is_clock:
            if self.form.time_unit is not None:
                problem = f"--time-unit {self.form.time_unit} given for dates; leave it out"
                self.wrong(self.header or self.first, problem)
            self.words = "times as dates in UTC" if is_dated else "times as h:min:s"
            read = map(ns_of_date if is_dated else ns_of_clock, texts)
            known = [NO_TIME if t is None or abs(t) > MAX_STAMP else t for t in read]
            times = np.array(known, dtype=np.int64)
        else:
            times = self.times_of_numbers(texts, places)
        is_in_unit = not (self.step or is_dated or self.is_clock)
        self.leave_out(times, texts, " (--time-unit)" if is_in_unit else "")
        named = enumerate(_told_apart(self.names))
        return times, {n: self.cells[k] for k, n in named if n and k not in (*places, *days)}

    def times_of_numbers(self, texts: Sequence[str], places: Sequence[int]) -> Stamps:
        """Times that are numbers, of frames or in a unit, ns; NO_TIME where there is none."""
        if self.step:
            what, hertz = "frames" if places else "rows", float(NS_PER_S / self.step)
            unit, self.words = self.step, f"times of {what} at {hertz:.10g} Hz"
        else:
            unit = self.unit(self.names[places[0]])
            self.words = f"times in {unit_words(unit)}"
        numbers = _with_points(texts, self.reading.decimal_comma)
        times = ns_of_numbers(numbers, _floats(numbers), unit)
        return np.where(times == NO_TIME, times, times + self.start)

    def places_of_time(self) -> list[int]:
        """Places of the columns of time, which are alike; none where rows are counted."""
        given, told = self.form.time_column, _told_apart(self.names)
        ranks = [time_rank(name) for name in self.names]
        places = [k for k, rank in enumerate(ranks) if rank and rank == max(ranks)]
        if given is not None:
            places = [k for k, name in enumerate(told) if given in (name, self.names[k])]
        elif self.step or self.form.frame_rate:
            frames = [k for k, name in enumerate(self.names) if counts_frames(name)]
            places = frames if len(frames) == 1 else places
        if not (places or given or self.form.frame_rate):
            dates = [k for k, cells in enumerate(self.cells) if _is_dated(cells[0])]
            places = [0] if self.strict and len(told) == 1 else dates[:1]
        listed = ", ".join(told[k] for k in places or range(len(told)))
        listed, line = shorten(listed, 5 * _SHOWN, placeholder=" ..."), self.header
        if any((self.cells[k] != self.cells[places[0]]).any() for k in places[1:]):
            self.wrong(line, f"several columns of time, {listed}; expected --time-column NAME")
        if not places and (given or self.strict or not self.form.frame_rate):
            remedy = "--time-column NAME, --frame-rate HZ for numbers of frames, or --skip-rows N"
            found = f"no column {given or 'of time'} in {listed}"
            self.wrong(line or self.first, f"{found}; expected {remedy}")
        return places

    def unit(self, name: str) -> Fraction:
        """The unit of a column of time, ns: that of the form, else of its name, else a second."""
        if self.form.time_unit is not None:
            return Fraction(UNITS[self.form.time_unit])
        try:
            return unit_in(name) or Fraction(NS_PER_S)
        except UnknownUnitError as unknown:
            problem = f"{name}: {str(unknown)!r} is no unit of time that is understood"
            raise UsageError(
                f"{self.path}, line {self.header}: {problem}; {UNDERSTOOD}, or --time-unit"
            ) from None

    def leave_out(self, times: Stamps, texts: Sequence[str], option: str) -> None:
        """Note the rows without a time, and all from another table on.

        Raises:
            UsageError: most rows cannot be read; or one of them, in a strict table.
        """
        numbers = self.rows.tolist()
        for k in np.flatnonzero(times == NO_TIME).tolist():
            above = self.lines[numbers[k] - 2]
            if k and not self.strict and not above.strip() and texts[k][:1].isalpha():
                self.lost |= dict.fromkeys(numbers[k:], "another table begins: split the file")
                break
            expected = f"{self.words}{option}, at most {text(MAX_STAMP)} s"
            self.bad[numbers[k]] = f"{shown(texts[k])} found; expected {expected}"
        if self.strict and self.bad:
            self.wrong(min(self.bad), self.bad[min(self.bad)])
        total = len({*numbers, *self.lost})
        self.lost |= self.bad
        if self.lost:
            first, count = min(self.lost), len(self.lost)
            if 2 * count > total:
                self.wrong(first, f"{self.lost[first]}; {count} of {total} rows cannot be read")
            why = f"in line {first}, {self.lost[first]}"
            self.remarks.append(part_left_out(count, total, "rows", why))

    def order(self, times: Stamps, lines: NDArray[np.int64]) -> NDArray[np.intp]:
        """The places of times by time.

        Raises:
            UsageError: times are out of order without ``sort``, or by more than they last.
        """
        steps = np.diff(times)
        if not np.any(steps < 0):
            return np.arange(len(times))
        k = int(np.argmin(steps))
        before, after = times[: k + 1], times[k + 1 :]
        is_apart = min(len(before), len(after)) > 1 and after.max() < before.min()
        remedy = "mend the line if its time is garbled; else `sort` puts the rows in order"
        if self.is_clock:
            remedy = "times of day need a date where they pass midnight"
        elif is_apart and -2 * steps[k] > np.ptp(times):
            remedy = "`sort` would swap the rows before and after the step; mend the times"
            if self.words.startswith("times as dates"):
                remedy = "dates need a zone where summer time ends"
        elif self.form.sort:
            return np.argsort(times, kind="stable")
        step = f"{seconds_between(int(times[k + 1]), int(times[k])):.9g} s"
        ends = f"from {text(int(times[k]))} to {text(int(times[k + 1]))} s"
        where = f"{self.path}, line {lines[k + 1]}"
        raise UsageError(f"{where}: the clock steps back by {step}, {ends}; {remedy}")


def _split(line: str, mark: str) -> list[str]:
    """The cells of a line, without blanks around them; none if quotes are not closed."""
    if mark == " ":
        line = " ".join(line.split())
        line = line if '"' in line else re.sub(r" (?=[\[(])", "_", line)  # time (s)
    row = line.split(mark)
    if '"' in line:
        try:
            row = next(csv.reader([line], delimiter=mark, strict=True, skipinitialspace=True))
        except csv.Error:
            return []
    return [cell.strip() for cell in row]


def _trimmed(cells: list[str]) -> list[str]:
    """The cells without empty ones at the end."""
    return cells[: max((k for k, cell in enumerate(cells, 1) if cell), default=0)]


def _places(cells: Sequence[str], decimal_comma: bool) -> tuple[int, ...]:
    """Places of the numbers and dates in a row; none if a cell should be split further."""
    known = [is_number(cell, decimal_comma) or _is_dated(cell) for cell in cells]
    if any(_TO_BE_SPLIT.match(c) for c, good in zip(cells, known, strict=True) if not good):
        return ()
    return tuple(k for k, good in enumerate(known) if good)


def _is_dated(cell: str) -> bool:
    """Whether a cell is a date, with or without a time, or a time of day."""
    return ns_of_clock(cell) is not None or ns_of_date(cell) is not None


def _told_apart(names: Sequence[str]) -> list[str]:
    """The names, of which those that stand there twice get a number."""
    counts, seen, told = Counter(names), Counter[str](), []
    for name in names:
        seen[name] += 1
        told.append(f"{name}.{seen[name]}" if name and counts[name] > 1 else name)
    return told


def _with_points(texts: Sequence[str], decimal_comma: bool) -> list[str]:
    """Decimals with a point."""
    return [each.replace(",", ".") for each in texts] if decimal_comma else [*texts]


def _floats(texts: Sequence[str]) -> Vector:
    """Decimals with a point as float64; NaN where there is no finite number."""
    values = np.full(len(texts), np.nan)
    for k, each in enumerate(texts):
        with suppress(ValueError):
            values[k] = float(each)
    values[np.isinf(values)] = np.nan
    return values
