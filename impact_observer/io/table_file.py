# SPDX-License-Identifier: Apache-2.0
"""Files of rows with a time, as rigs, instruments, spreadsheets and loggers write them.

Times are read as decimals or dates, not as floats, so that stamps are exact to the nanosecond.
(pandas and pyarrow read numbers as floats, and guess.) What is left out is counted.
"""

import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple, NoReturn

from impact_observer.errors import UsageError
from impact_observer.input_files import open_input
from impact_observer.io.table_layout import (
    LINES,
    Layout,
    LayoutSearch,
    TableForm,
    number_of,
    split,
)
from impact_observer.io.table_times import GridTimes
from impact_observer.stamps import MAX_STAMP, NS_PER_S, seconds_between, text

_SINCE_1970 = 100_000_000 * NS_PER_S
"""Least time that counts from 1970, ns; smaller times count from the start of the experiment."""
_LONGEST = 10**6
"""Letters of a line that is too long."""
_PROBED = 4096
"""Bytes by which an encoding is recognised."""
_NO_TEXT = re.compile(rb"[\x01-\x08\x0e-\x19\x1c-\x1f]")
NO_NUMBERS = {
    "",
    "nan",
    "-nan",
    "nan(ind)",
    "-nan(ind)",
    "na",
    "n/a",
    "null",
    "none",
    "-",
    "--",
} | {sign + name for sign in ("", "+", "-") for name in ("inf", "infinity", "∞")}
"""Texts of cells without a number that programs and instruments write into columns of numbers."""
_FEW = 3
"""So many rows may repeat the time of the row before, or be alike, without a meaning."""
_ALIKE = 20
"""Last rows that must be alike to show that the one after them is cut."""
_SHARE = 100
"""A larger part of rows, one in so many, that repeats the time shows that digits were lost."""


class TableRow(NamedTuple):
    """A row of a table.

    Attributes:
        line: its number in the file, from 1.
        time: ns after the file's zero.
        cells: text by column; a column that the row does not reach is missing.
    """

    line: int
    time: int
    cells: Mapping[str, str]


@dataclass(slots=True)
class Omissions:
    """What is left out of a table: how much, and the first one.

    Attributes:
        count: how often.
        line: of the first one.
        problem: of the first one, words.
    """

    count: int = 0
    line: int = 0
    problem: str = ""

    def note(self, line: int, problem: str, count: int = 1) -> None:
        """Count one, or some from a line on."""
        if not self.count:
            self.line, self.problem = line, problem
        self.count += count

    def words(self, total: int, what: str) -> str:
        """The count and its part of a ``total``, and the first one."""
        first = "line" if self.count == 1 else "the first in line"
        part = f"{self.count} of {total} {what} left out ({100 * self.count / total:.2g} %)"
        return f"{part}, {first} {self.line}: {self.problem}"


class TableFile:
    """A table read row by row, whose layout is found in its first lines.

    Empty lines and lines that begin with ``#`` are left out.

    Attributes:
        columns: names without that of time and without nameless ones, in the file's order; those
            of ``wanted`` are spelled as there.
        header: line of the header; 0 without a header.
        times: words for the form of the times, such as ``times in ms``.
        is_grid: whether times are numbers of frames or rows at a constant rate.
        rows_read: rows with a time so far.
    """

    def __init__(
        self,
        path: Path,
        form: TableForm,
        wanted: Sequence[str],
        *,
        what: str,
        expected: str,
        bare: bool = False,
        strict: bool = True,
    ) -> None:
        """Read the first lines of ``path``.

        Args:
            path: the file.
            form: of its rows.
            wanted: names of columns besides time; none may stand in the header twice. Capitals do
                not matter.
            what: a row is, for errors.
            expected: columns, for errors.
            bare: whether the file may have no header; its columns are then time and ``wanted``.
            strict: whether a row that cannot be read is an error; such rows are counted and left
                out otherwise. A last line that is cut, and what a loss of power left, always are.

        Raises:
            UsageError: names the file, the line, what was found and what is expected.
        """
        self.rows_read = 0
        self._path, self._form, self._expected, self._strict = path, form, expected, strict
        self._is_latin = False
        self._rows_left_out = Omissions()
        self._values_left_out: dict[str, Omissions] = {}
        self._repeated = 0
        self._ends = [0, 0]
        self._lines_before = deque[str](maxlen=_ALIKE)
        self._texts = self._decoded()
        head = [*islice(self._texts, LINES)]
        content = [(k, line) for k, line in head if _has_content(line)]
        if not content:
            raise UsageError(f"{path}: holds no {what}; expected rows {expected}")
        search = LayoutSearch(
            [(k, line.strip("\r\n\0")) for k, line in content],
            form,
            wanted,
            self.wrong,
            bare=bare,
            counted=not strict,
        )
        self._layout: Layout = search.layout()
        layout = self._layout
        self.header, self.times = layout.header, layout.times.words
        if content[0][0] < (layout.header or layout.first):
            self.times += f", header in line {self.header}" if self.header else ", no header"
        self.is_grid = isinstance(layout.times, GridTimes)
        self._texts = chain((each for each in head if each[0] >= layout.first), self._texts)
        self._names = list(layout.names)
        below = (row.cells for row in search.rows if row.line >= layout.first)
        self._sample = [cells for cells in below if cells]
        if not layout.header:
            self._name_bare_columns()
        self.columns = tuple(name for name in self._names if name)

    def in_order(self, read: Callable[[], object] = lambda: None) -> Iterator[TableRow]:
        """The rows by time: as they stand, or sorted if the form says so.

        Args:
            read: called whenever a row was read.

        Raises:
            UsageError: they are not in order, or as of :meth:`records`.
        """
        if self._form.sort:
            yield from self._observed(sorted(self._noted(read), key=lambda record: record.time))
            return
        yield from self._observed(self._noted(read))

    def _observed(self, rows: Iterator[TableRow] | list[TableRow]) -> Iterator[TableRow]:
        """The rows, whose order is checked and whose equal times are counted."""
        before = None
        for row in rows:
            if before is not None and row.time < before:
                self.wrong(
                    row.line,
                    f"time {text(row.time)} s comes after {text(before)} s; sort the rows, or"
                    " say --sort",
                )
            self._repeated += row.time == before
            self._ends = [row.time if before is None else self._ends[0], row.time]
            before = row.time
            yield row

    def _noted(self, read: Callable[[], object]) -> Iterator[TableRow]:
        for record in self.records():
            read()
            yield record

    def records(self) -> Iterator[TableRow]:
        """The rows, one by one.

        Raises:
            UsageError: names the file, the line, what was found and what is expected.
        """
        counted, last, is_after_gap = 0, None, False
        for line, raw in self._texts:
            if not _has_content(raw):
                is_after_gap = is_after_gap or not raw.strip()
                if "\0" in raw:
                    self._rows_left_out.note(line, "NUL bytes, as a loss of power leaves them")
                continue
            if is_after_gap and self._begins_a_table(raw):
                rest = sum(_has_content(later) for _, later in self._texts)
                self._rows_left_out.note(line, "another table begins there", 1 + rest)
                return
            is_after_gap = False
            counted += 1
            row = self._row(line, raw.strip("\r\n"), counted - 1)
            if self._is_cut(raw, row, last):
                self._rows_left_out.note(line, f"{raw!r} is cut: the file ends in it")
            elif isinstance(row, str):
                if self._strict and "\0" not in raw:
                    self.wrong(line, row)
                self._rows_left_out.note(line, row)
            else:
                self._lines_before.append(raw)
                self.rows_read += 1
                last = row.time
                yield row

    def value(self, row: TableRow, column: str) -> float | None:
        """A number in a row; None where there is none, which is counted unless it is empty."""
        cell = row.cells.get(column, "")
        number = self.number(cell)
        if number is None and cell:
            left_out = self._values_left_out.setdefault(column, Omissions())
            left_out.note(row.line, f"{cell!r} is no finite number")
        return None if number is None else float(number)

    def remarks(self) -> list[str]:
        """What was left out or is doubtful, a line each; complete after the last row.

        Raises:
            UsageError: most rows cannot be read, or their times have lost their digits.
        """
        rows = self._rows_left_out
        total = self.rows_read + rows.count
        if rows.count > total / 2:
            self.wrong(rows.line, f"{rows.problem}; {rows.count} of {total} rows cannot be read")
        lines = [rows.words(total, "rows")] if rows.count else []
        for column, values in self._values_left_out.items():
            lines.append(values.words(self.rows_read, f"values of {column}"))
        if self._is_latin:
            lines.append("no text in UTF-8; names of columns are read as Windows-1252")
        return [f"{self._path}: {line}" for line in [*lines, *self._lost_digits()]]

    def _lost_digits(self) -> list[str]:
        """Why times that repeat make stamps wrong; empty where few do."""
        n, same = self.rows_read, self._repeated
        if self._strict or same <= _FEW or same * _SHARE <= n:
            return []
        different = n - same
        span = seconds_between(*self._ends)
        digits = "are their digits lost, as with %g? Write times with more digits"
        remedy = f"{digits}, or remove them and say --frame-rate HZ"
        if different * _SHARE <= n or different == 1:
            first = f"{text(self._ends[0])} s"
            seen = f"{n} rows have only {different} different times, the first {first}"
            if different == 1:
                seen = f"all {n} rows have the time {first}"
            raise UsageError(f"{self._path}: {seen}; {remedy}")
        step = span / (different - 1)
        seen = f"{same} of {n} rows have the time of the row before: times change every {step:.3g}"
        cost = f"rows come every {span / (n - 1):.3g} s, so stamps are up to {step:.3g} s off"
        return [f"{seen} s, {cost}; {remedy}"]

    def columns_of_numbers(self) -> list[str]:
        """Names of the columns with numbers in the first rows, else of those with nothing."""
        cells = {
            name: [c[k] for c in self._sample if k < len(c)] for k, name in enumerate(self._names)
        }
        named = {name: texts for name, texts in cells.items() if name}
        empty = [name for name, texts in named.items() if not any(texts)]
        return [name for name, texts in named.items() if self._are_numbers(texts)] or empty

    def _are_numbers(self, cells: Sequence[str]) -> bool:
        texts = [cell for cell in cells if cell.lower() not in NO_NUMBERS]
        return sum(self.number(cell) is not None for cell in texts) > len(texts) / 2

    def wrong(self, line: int, problem: str) -> NoReturn:
        """Raise the error of a line."""
        raise UsageError(f"{self._path}, line {line}: {problem}")

    def wrong_header(self, problem: str) -> NoReturn:
        """Raise the error of the header."""
        self.wrong(self.header, problem)

    def number(self, cell: str) -> Decimal | None:
        """A number; its decimal point may be a comma unless commas separate columns."""
        return number_of(cell, self._layout.separator)

    def _decoded(self) -> Iterator[tuple[int, str]]:
        """Numbers and texts of the lines after those that are skipped."""
        try:
            with open_input(self._path) as file:
                encoding = self._encoding(file.read(_PROBED))
            with self._path.open(encoding=encoding, errors="surrogateescape") as lines:
                for k, line in enumerate(iter(lambda: lines.readline(_LONGEST), ""), start=1):
                    if len(line) == _LONGEST:
                        self.wrong(k, f"is longer than {_LONGEST} letters; expected a table")
                    if k > self._form.skip_rows:
                        yield k, self._as_text(line)
        except (UnicodeDecodeError, OSError) as error:
            why = error.strerror if isinstance(error, OSError) else "its end is cut"
            raise UsageError(f"{self._path}: cannot be read: {why}") from None

    def _encoding(self, start: bytes) -> str:
        """The encoding of a file that begins with ``start``."""
        wide = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}.get(start[:2])
        nuls = start.count(0)
        if wide is None and start[1:2] == b"\0" and 3 * nuls > len(start):
            wide = "utf-16-le"
        if wide is None and (_NO_TEXT.search(start) or start[:1] == b"\0"):
            self._refuse("no text")
        return wide or "utf-8-sig"

    def _as_text(self, line: str) -> str:
        if line.isascii():
            return line
        try:
            line.encode()
        except UnicodeEncodeError:
            if self._strict:
                self._refuse("no text in UTF-8")
            self._is_latin = True
            return line.encode("utf-8", "surrogateescape").decode("cp1252", "replace")
        return line

    def _refuse(self, found: str) -> NoReturn:
        remedy = "save it as CSV UTF-8; a sound (WAV) is for impact-observer detect"
        raise UsageError(f"{self._path}: is {found}; {remedy}")

    def _name_bare_columns(self) -> None:
        """Name further columns of a table without a header, where all columns may be read."""
        first = next(iter(self._sample), [])
        if not self._strict and len(first) > len(self._names):
            time = self._names.count("") if self._layout.times.column >= 0 else 0
            extra = [f"column{k}" for k in range(time + 1, len(first) + 1)]
            self._names = [""] * time + extra

    def _row(self, line: int, raw: str, counted: int) -> TableRow | str:
        """The row in a line; words for its mistake otherwise."""
        cells = split(raw, self._layout.separator) if "\0" not in raw else None
        if cells is None:
            return "cannot be read as CSV: unexpected end of data"
        most = len(self._names)
        if any(cells[most:]):
            what = "the header has" if self.header else f"expected {self._expected}, at most"
            remedy = ", or --separator semicolon for decimal commas" if most == 1 else ""
            return f"{len(cells)} columns found; {what} {most}{remedy}"
        time = self._time(line, cells, counted)
        if isinstance(time, str):
            return time
        pairs = zip(self._names, cells, strict=False)
        return TableRow(line, time, {name: cell for name, cell in pairs if name})

    def _time(self, line: int, cells: list[str], counted: int) -> int | str:
        """A time in ns after the file's zero, rounded to the nearest nanosecond."""
        times = self._layout.times
        cell = cells[times.column] if times.column < len(cells) else ""
        number = self.number(cell) if times.column >= 0 else None
        time = times.ns(cells, number, counted) if times.column < len(cells) else None
        if time is None:
            kind = "as a date like the first one" if times.dated else "as a decimal number"
            return f"{cell!r} found; expected a time {kind}"
        if abs(time) <= MAX_STAMP:
            return time
        problem = (
            f"time {cell} is too large for {times.words}; stamps end at {text(MAX_STAMP)} s: is"
            " that its unit? --time-unit ms, us or ns"
        )
        if not self.rows_read:
            self.wrong(line, problem)
        return problem

    def _begins_a_table(self, raw: str) -> bool:
        """Whether a line after an empty one is the header of another table."""
        cells = split(raw.strip(), self._layout.separator) or []
        has_names = len(cells) > 1 and all(cells) and not any(map(self.number, cells))
        return has_names and not self._strict and self.rows_read > 0

    def _shape(self, raw: str) -> tuple[int, int]:
        """The number of cells and the length of the last one after its decimal point."""
        cells = split(raw.strip(), self._layout.separator) or [""]
        parts = re.split(r"[.,]", cells[-1]) if self.number(cells[-1]) is not None else [""]
        return len(cells), len(parts[1]) if len(parts) > 1 else 0

    def _is_cut(self, raw: str, row: TableRow | str, last: int | None) -> bool:
        """Whether a line without an end is shorter than those before, which are of one shape."""
        if raw.endswith("\n") or "\0" in raw or len(self._lines_before) < _FEW:
            return False
        if isinstance(row, str) or (last is not None and row.time < last):
            return True
        shapes = {self._shape(line) for line in self._lines_before}
        (cells, decimals), before = self._shape(raw), shapes.pop()
        return not shapes and (cells < before[0] or decimals < before[1])


def _has_content(line: str) -> bool:
    line = line.strip().strip("\0\x1a \t,;")
    return bool(line) and not line.startswith("#")


def later_zero(time: int) -> str:
    """The option that makes the stamp at a ``time`` of a file, ns, positive."""
    if time > 0:
        return "--time-zero"
    zero = 10 * NS_PER_S
    while zero + time <= 0:
        zero *= 10
    return f"--time-zero {zero // NS_PER_S}"


def start_of(first: int, start: int | None) -> int:
    """The stamp of a file's time zero, ns.

    Args:
        first: time in the file, ns.
        start: that is asked for; None for 0 where ``first`` counts from 1970, else 1 s.
    """
    if start is not None:
        return start
    return 0 if first >= _SINCE_1970 else NS_PER_S
