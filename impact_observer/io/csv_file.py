# SPDX-License-Identifier: Apache-2.0
"""Files of rows with a time: CSV as rigs, spreadsheets and loggers write it.

Times are read as decimals, not as floats, so that stamps are exact to the nanosecond.
"""

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain
from pathlib import Path
from typing import NamedTuple, NoReturn

from impact_observer.errors import UsageError
from impact_observer.stamps import MAX_STAMP, NS_PER_S, text

_UNITS = {"s": NS_PER_S, "ms": 1_000_000, "us": 1000, "ns": 1}
"""Nanoseconds of each unit of time."""
_TIME = re.compile(
    r"time(?:[ _]?[\[(]?(?:s|ms|us|ns)[\])]?)?|t(?:[ _]?[\[(]|[ _])(?:s|ms|us|ns)[\])]?",
    re.IGNORECASE,
)
_LIKE_TIME = {"t", "stamp", "timestamp", "seconds", "sec"}
"""Names of columns that may be times."""
_UNIT = re.compile(r"(?:[ _]?[\[(]|[ _])(s|ms|us|ns)[\])]?|time(s|ms|us|ns)", re.IGNORECASE)


_SINCE_1970 = 100_000_000 * NS_PER_S
"""Least time that counts from 1970, ns; smaller times count from the start of the experiment."""


@dataclass(frozen=True, slots=True)
class CsvForm:
    """Options for reading a file: unit and column of time, and order of rows.

    Attributes:
        unit: of time: s, ms, us or ns; None for that in the header, else seconds.
        time_column: name of the column of time; None for one that is called time.
        sort: whether rows may stand in any order.
    """

    unit: str | None = None
    time_column: str | None = None
    sort: bool = False


class CsvRecord(NamedTuple):
    """A row of a file.

    Attributes:
        line: where it ends in the file, from 1.
        time: ns after the file's zero.
        cells: text by column; a column that the row does not reach is missing.
    """

    line: int
    time: int
    cells: Mapping[str, str]


class CsvFile:
    """A file read row by row; columns are separated by comma, semicolon or tab.

    Empty lines and lines that begin with ``#`` are left out.

    Attributes:
        columns: names in the header without that of time, in the file's order; those of
            ``wanted`` are spelled as there. Complete when the first record is there.
    """

    def __init__(
        self,
        path: Path,
        form: CsvForm,
        wanted: Sequence[str],
        *,
        what: str,
        expected: str,
        bare: bool = False,
    ) -> None:
        """Read ``path``.

        Args:
            path: the file.
            form: of its rows.
            wanted: names of columns besides time; none may stand in the header twice. Capitals do
                not matter.
            what: a row is, for errors.
            expected: columns, for errors.
            bare: whether the file may have no header; its columns are then time and ``wanted``.
        """
        self.columns: tuple[str, ...] = ()
        self._path = path
        self._form = form
        self._wanted = wanted
        self._what = what
        self._expected = expected
        self._bare = bare
        self._unit = form.unit
        self._line = 0
        self._header = 0
        self._separator = ","
        self._names: list[str] = []

    @property
    def unit(self) -> str:
        """Unit of time, by the form or the header, else seconds; known with the first record."""
        return self._unit or "s"

    def in_order(self, read: Callable[[], object] = lambda: None) -> Iterator[CsvRecord]:
        """The rows by time: as they stand, or sorted if the form says so.

        Args:
            read: called whenever a row was read.

        Raises:
            UsageError: they are not in order, or as of :meth:`records`.
        """
        if self._form.sort:
            yield from sorted(self._noted(read), key=lambda record: record.time)
            return
        before = None
        for record in self._noted(read):
            if before is not None and record.time < before:
                self.wrong(
                    record.line,
                    f"time {text(record.time)} s comes after {text(before)} s; sort the rows, or"
                    " say --sort",
                )
            before = record.time
            yield record

    def _noted(self, read: Callable[[], object]) -> Iterator[CsvRecord]:
        for record in self.records():
            read()
            yield record

    def records(self) -> Iterator[CsvRecord]:
        """The rows, one by one.

        Raises:
            UsageError: names the file, the line, what was found and what is expected.
        """
        try:
            with self._path.open(encoding="utf-8-sig", newline="") as file:
                yield from self._records(file)
        except UnicodeDecodeError:
            remedy = "save it as CSV UTF-8; a sound (WAV) is for impact-observer detect"
            raise UsageError(f"{self._path}: is no text in UTF-8; {remedy}") from None
        except OSError as error:
            raise UsageError(f"{self._path}: cannot be read: {error.strerror}") from None

    def wrong(self, line: int, problem: str) -> NoReturn:
        """Raise the error of a line."""
        raise UsageError(f"{self._path}, line {line}: {problem}")

    def wrong_header(self, problem: str) -> NoReturn:
        """Raise the error of the header."""
        self.wrong(self._header, problem)

    def number(self, cell: str) -> Decimal | None:
        """A number; its decimal point may be a comma unless commas separate columns."""
        try:
            number = Decimal(cell if self._separator == "," else cell.replace(",", "."))
        except ArithmeticError:
            return None
        return number if number.is_finite() else None

    def _records(self, file: Iterable[str]) -> Iterator[CsvRecord]:
        lines = ("\n" if line.lstrip().startswith("#") else line for line in file)
        skipped, first = next(((k, line) for k, line in enumerate(lines) if line.strip()), (0, ""))
        if not first:
            raise UsageError(
                f"{self._path}: holds no {self._what}; expected rows {self._expected}"
            )
        self._separator = next((each for each in "\t;" if each in first), ",")
        reader = csv.reader(chain([first], lines), delimiter=self._separator, strict=True)
        try:
            for row in reader:
                self._line = skipped + reader.line_num
                cells = [cell.strip() for cell in row]
                if not any(cells):
                    continue
                if not self._names:
                    self._read_columns(cells)
                    if self._header:
                        continue
                yield self._record(cells)
        except csv.Error as error:
            self.wrong(skipped + reader.line_num, f"cannot be read as CSV: {error}")

    def _read_columns(self, cells: list[str]) -> None:
        """Read the columns and the unit from the first row, if it is a header."""
        if self._form.time_column is None:
            times = [cell for cell in cells if _TIME.fullmatch(cell)]
        else:
            times = [cell for cell in cells if cell == self._form.time_column]
        if not times:
            if self._bare and self._form.time_column is None and self.number(cells[0]) is not None:
                self._names = ["time", *self._wanted]
                return
            name = self._form.time_column or "time"
            remedy = ""
            if self._bare and self._form.time_column is None:
                remedy = ", or a time; remove lines before it, or name it: --time-column NAME"
            seen = repr(cells[0]) if self._form.time_column is None else ", ".join(cells)
            if named := next((cell for cell in cells if cell.lower() in _LIKE_TIME), ""):
                remedy = f"; --time-column {named} names it, if that is the time"
            self.wrong(self._line, f"{seen} found; expected a header with a column {name}{remedy}")
        if len(times) > 1:
            self.wrong(self._line, f"two columns of time, {', '.join(times)}; expected one")
        lower = {each.lower(): each for each in self._wanted}
        names = [cell if cell in self._wanted else lower.get(cell.lower(), cell) for cell in cells]
        for name in self._wanted:
            if names.count(name) > 1:
                self.wrong(self._line, f"two columns {name} found; expected one")
        self._read_unit(times[0])
        self.columns = tuple(name for name in names if name and name not in times)
        self._names = [
            "time" if cell in times else name for cell, name in zip(cells, names, strict=True)
        ]
        self._header = self._line

    def _read_unit(self, column: str) -> None:
        """Read the unit of time from the column's name."""
        match = _UNIT.search(column)
        unit = (match[1] or match[2]).lower() if match and match.end() == len(column) else ""
        if self._unit and unit and unit != self._unit:
            problem = f"the header says {unit}, --time-unit {self._unit}; leave one out"
            self.wrong(self._line, problem)
        self._unit = self._unit or unit

    def _record(self, cells: list[str]) -> CsvRecord:
        most = len(self._names)
        if len(cells) > most:
            what = "the header has" if self._header else f"expected {self._expected}, at most"
            self.wrong(self._line, f"{len(cells)} columns found; {what} {most}")
        named = dict(zip(self._names, cells, strict=False))
        return CsvRecord(self._line, self._time(named.pop("time", "")), named)

    def _time(self, cell: str) -> int:
        """A time in ns after the file's zero, rounded to the nearest nanosecond."""
        if (number := self.number(cell)) is None:
            self.wrong(self._line, f"{cell!r} found; expected a time as a decimal number")
        time = number * _UNITS[self.unit]
        if abs(time) > MAX_STAMP:
            problem = (
                f"time {cell} is too large in {self.unit}; stamps end at {text(MAX_STAMP)} s: is"
                " that its unit? --time-unit ms, us or ns"
            )
            self.wrong(self._line, problem)
        return round(time)


def start_of(first: int, start: int | None) -> int:
    """The stamp of a file's time zero, ns.

    Args:
        first: time in the file, ns.
        start: that is asked for; None for 0 where ``first`` counts from 1970, else 1 s.
    """
    if start is not None:
        return start
    return 0 if first >= _SINCE_1970 else NS_PER_S
