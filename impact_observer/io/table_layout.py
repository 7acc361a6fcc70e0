# SPDX-License-Identifier: Apache-2.0
"""What a table looks like: its separator, its header, its column of time.

Instruments write lines before the header, a row of units below it, or the start and the step of
the times into the header. Nothing is guessed: a column is that of time if its name says so.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from sys import float_info
from typing import NamedTuple, NoReturn

from impact_observer.io.table_times import (
    UNDERSTOOD,
    UNITS,
    CellTimes,
    DateTimes,
    GridTimes,
    NumberTimes,
    Unit,
    UnknownUnitError,
    counts_frames,
    is_date,
    is_dated,
    ns_of_clock,
    ns_of_date,
    time_rank,
    unit_in,
    unit_named,
)

SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": " "}
"""What separates columns, by name; the first one is taken where two fit equally well."""
LINES = 1000
"""Lines of the beginning of a table in which its header is looked for."""
_BELOW = 5
"""Rows below a header among which two must have a time."""
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d{1,6})?", re.IGNORECASE)
_NUMERIC = re.compile(r"[+-]?\.?\d")
_AXES = {"x-axis", "x axis", "x", "source", "t", "time"}
"""Names above ``second`` in tables of oscilloscopes, whose row of names is the one above."""
_SECOND = Unit("s", Decimal(UNITS["s"]))
_TEK = "record length"
_TEK_TIME, _TEK_VALUE = 3, 4
"""Columns of the time and the value in tables of Tektronix with the header beside the rows."""


@dataclass(frozen=True, slots=True)
class TableForm:
    """Options for reading a table; None, 0 and False leave the choice to the table.

    Attributes:
        unit: of time, one of ``UNITS``; None for that in the header, else seconds.
        time_column: name of the column of time; None for one that is called a time.
        sort: whether rows may stand in any order.
        separator: of columns, one of ``SEPARATORS``.
        skip_rows: lines at the beginning that are not read.
        frame_rate: of the frames that a column, or the rows, count, Hz.
    """

    unit: str | None = None
    time_column: str | None = None
    sort: bool = False
    separator: str | None = None
    skip_rows: int = 0
    frame_rate: Fraction | None = None


class TextRow(NamedTuple):
    """A row of a table that is not empty.

    Attributes:
        line: its number in the file, from 1.
        cells: its texts; none for a line that is no CSV.
    """

    line: int
    cells: list[str]


@dataclass(frozen=True, slots=True)
class Layout:
    """What a table looks like.

    Attributes:
        separator: of columns.
        header: line of the header; 0 without a header.
        first: line from which on rows are read.
        names: of the columns, by place; empty for a column that is left out.
        times: reader of the times.
    """

    separator: str
    header: int
    first: int
    names: tuple[str, ...]
    times: CellTimes


def split(line: str, separator: str) -> list[str] | None:
    """The cells of a line, without blanks around them; None if quotes are not closed."""
    if separator == " ":
        line = re.sub(r"\s+(?=[\[(])", "_", " ".join(line.split())) if '"' not in line else line
    try:
        row = next(csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True), [])
    except csv.Error:
        return None
    return [cell.strip() for cell in row]


def number_of(cell: str, separator: str) -> Decimal | None:
    """A finite number; its decimal point may be a comma unless commas separate columns."""
    cell = cell if separator == "," else cell.replace(",", ".")
    number = Decimal(cell) if _NUMBER.fullmatch(cell) else None
    return None if number is None or number.adjusted() > float_info.max_10_exp else number


def _looks_like_data(cells: list[str] | None, separator: str) -> bool:
    """Whether a row has a number or a date, and no cell that should be split further."""
    if cells is None:
        return False
    known = [number_of(c, separator) is not None or is_dated(c) for c in cells]
    others = (c for c, good in zip(cells, known, strict=True) if not good)
    return any(known) and not any(_NUMERIC.match(c) and re.search(r"[\s;,]", c) for c in others)


def _separator(lines: Sequence[str]) -> str:
    """The separator that makes the most rows of data with two columns or more.

    Blanks count half, as they stand beside other separators too.
    """
    counts = dict.fromkeys(SEPARATORS.values(), 0.0)
    for each in counts:
        rows = (split(line, each) for line in lines)
        found = sum(r is not None and len(r) > 1 and _looks_like_data(r, each) for r in rows)
        counts[each] = found / 2 if each == " " else found
    best = max(counts, key=lambda each: counts[each])
    in_header = next((each for each in "\t;," if lines and each in lines[0]), ",")
    return best if counts[best] else in_header


class LayoutSearch:
    """Finds the layout in the first lines of a table."""

    def __init__(
        self,
        lines: Sequence[tuple[int, str]],
        form: TableForm,
        wanted: Sequence[str],
        wrong: Callable[[int, str], NoReturn],
        *,
        bare: bool,
        counted: bool,
    ) -> None:
        """Split the ``lines``.

        Args:
            lines: numbers and texts of lines that are neither empty nor comments.
            form: as given.
            wanted: names of columns besides time; capitals do not matter.
            wrong: raises the error of a line.
            bare: whether the table may have no header; its columns are then time and ``wanted``.
            counted: whether rows may be counted at the frame rate, where no column counts frames.
        """
        self._form, self._wanted, self._wrong = form, wanted, wrong
        self._bare, self._counted = bare, counted
        texts = [text for _, text in lines]
        self.separator = SEPARATORS[form.separator] if form.separator else _separator(texts)
        self.rows = [TextRow(line, split(text, self.separator) or []) for line, text in lines]

    def layout(self) -> Layout:
        """The layout.

        Raises:
            UsageError: the table has no column of time, or two readings are possible.
        """
        if self._form.time_column is None:
            found = self._of_rigol() or self._of_tektronix() or self._of_frames()
            if found:
                return found
        header = self._header()
        if header is not None:
            return self._under(header)
        if self._form.time_column is None:
            if self._form.frame_rate is not None and self._counted:
                return self._of_counted_rows(self._form.frame_rate)
            if self._bare and self._is_time(self.rows[0].cells, 0):
                return self._without_header(self.rows[0])
        return self._no_time()

    # How a header is found.

    def _header(self) -> int | None:
        """The place of the first row with a name of time above a time; None without one."""
        named = [k for k, row in enumerate(self.rows) if self._time_places(row.cells)]
        for k in named:
            place = self._time_places(self.rows[k].cells)[0]
            if self._is_above_times(k, place):
                return k
        return 0 if named[:1] == [0] else None

    def _is_above_times(self, k: int, place: int) -> bool:
        """Whether two of the next rows have a time at a place, or one where the table ends."""
        below = self.rows[k + 1 : k + 1 + _BELOW]
        count = sum(self._is_time(row.cells, place) for row in below)
        return count > (len(below) == _BELOW)

    def _time_places(self, cells: Sequence[str]) -> list[int]:
        """Places of the columns that are called a time; of the best names, if some are better."""
        if self._form.time_column is not None:
            return [k for k, cell in enumerate(cells) if cell == self._form.time_column]
        ranks = [time_rank(cell) for cell in cells]
        return [k for k, rank in enumerate(ranks) if rank and rank == max(ranks)]

    def _is_time(self, cells: Sequence[str], place: int) -> bool:
        return place < len(cells) and (
            self._number(cells[place]) is not None or is_dated(cells[place])
        )

    def _number(self, cell: str) -> Decimal | None:
        return number_of(cell, self.separator)

    # Layouts.

    def _under(self, k: int) -> Layout:
        """The layout of a table with a header at place ``k``."""
        row, units = self.rows[k], self._units_below(k)
        cells = row.cells
        places = self._time_places(cells)
        if len({cells[place] for place in places}) > 1:
            both = ", ".join(cells[place] for place in places)
            self._wrong(row.line, f"two columns of time, {both}; expected one: --time-column NAME")
        place, names = places[0], cells
        above = self.rows[k - 1].cells if k else None
        if above and self._is_row_of_units(cells, above, place):
            names = above
        names = self._spelled(row.line, names)
        first = units.line + 1 if units else row.line + 1
        times = self._times(row, place, units)
        for each in places if times.day < 0 else [*places, times.day]:
            names[each] = ""
        return Layout(self.separator, row.line, first, tuple(names), times)

    def _is_row_of_units(self, cells: Sequence[str], above: Sequence[str], place: int) -> bool:
        """Whether a header is the row of units below the names, as in ``second,Volt``."""
        is_named = all(name or not unit for name, unit in zip(above, cells, strict=False))
        same = len(cells) == len(above) and is_named
        return same and unit_named(cells[place]) is not None and above[place].lower() in _AXES

    def _units_below(self, k: int) -> TextRow | None:
        """The row of units below a header, if any; dates and times of day have none."""
        place = self._time_places(self.rows[k].cells)[0]
        row = self.rows[k + 1] if k + 1 < len(self.rows) else None
        if row is None or place >= len(row.cells):
            return None
        cell = row.cells[place]
        bracketed = [re.fullmatch(r"[\[(].*[\])]", each) for each in row.cells]
        is_unit = unit_named(cell) is not None or bracketed[place] or (not cell and any(bracketed))
        return row if is_unit else None

    def _spelled(self, line: int, names: Sequence[str]) -> list[str]:
        """The names; those that are wanted as they are wanted, and repeated ones with a number."""
        lower = {each.lower(): each for each in self._wanted}
        spelled = [
            each if each in self._wanted else lower.get(each.lower(), each) for each in names
        ]
        for name in self._wanted:
            if spelled.count(name) > 1:
                self._wrong(line, f"two columns {name} found; expected one")
        counts = Counter[str]()
        for k, name in enumerate(spelled):
            counts[name] += 1
            if name and counts[name] > 1:
                spelled[k] = f"{name}.{counts[name]}"
        return spelled

    def _times(self, row: TextRow, place: int, units: TextRow | None) -> CellTimes:
        """The reader of the times in the column at ``place`` below the header ``row``."""
        cells = row.cells
        if self._form.frame_rate is not None and self._form.time_column is not None:
            return GridTimes(place, self._form.frame_rate)
        sample = self._sample(row.line, place)
        cell = sample[place] if sample else ""
        if self._number(cell) is not None or not is_dated(cell):
            return NumberTimes(place, self._unit(row, place, units))
        if self._form.unit:
            self._wrong(row.line, f"--time-unit {self._form.unit} given for dates; leave it out")
        if ns_of_clock(cell) is None:
            return DateTimes(place)
        days = [k for k, name in enumerate(cells) if is_date(name) and k != place]
        if days and sample and ns_of_date(sample[days[0]]) is not None:
            return DateTimes(place, days[0])
        if days and sample:
            self._wrong(
                row.line,
                f"column {cells[days[0]]} has {sample[days[0]]!r}, in which day and month may be"
                " read in two ways; expected YYYY-MM-DD or DD.MM.YYYY",
            )
        return DateTimes(place, of_day=True)

    def _sample(self, line: int, place: int) -> list[str] | None:
        """The first row with a time below a line."""
        rows = (row.cells for row in self.rows if row.line > line)
        return next((cells for cells in rows if self._is_time(cells, place)), None)

    def _unit(self, row: TextRow, place: int, units: TextRow | None) -> Unit:
        """The unit of a column of time: that of the form, of the header or of the row of units."""
        given, name = self._form.unit, row.cells[place]
        try:
            unit = unit_in(name)
            if unit is None and units is not None and units.cells[place]:
                name = units.cells[place]
                if (unit := unit_named(name)) is None:
                    raise UnknownUnitError(name.strip("()[]"))
        except UnknownUnitError as unknown:
            if not given:
                problem = f"{name}: {str(unknown)!r} is no unit of time that is understood"
                self._wrong(row.line, f"{problem}; {UNDERSTOOD}, or --time-unit")
            unit = None
        if given and unit and unit.name != given:
            self._wrong(
                row.line, f"the header says {unit.name}, --time-unit {given}; leave one out"
            )
        if given:
            return Unit(given, Decimal(UNITS[given]))
        return unit or _SECOND

    def _without_header(self, first: TextRow) -> Layout:
        """The layout of a table of rows alone: the time, then the columns that are wanted."""
        line, cells = first
        unit = self._form.unit or "s"
        times: CellTimes = NumberTimes(0, Unit(unit, Decimal(UNITS[unit])))
        names = ["", *self._wanted]
        if self._number(cells[0]) is None:
            split_day = len(cells) > 1 and ns_of_clock(cells[1]) is not None
            of_day = ns_of_clock(cells[0]) is not None
            times = DateTimes(1, 0) if split_day else DateTimes(0, of_day=of_day)
            names = ["", "", *self._wanted] if split_day else names
        return Layout(self.separator, 0, line, tuple(names), times)

    def _of_rigol(self) -> Layout | None:
        """The layout with a column of numbers of samples, and start and step in the header."""
        for row, below in zip(self.rows, self.rows[1:3], strict=False):
            cells, values = row.cells, below.cells
            lower = [cell.lower() for cell in cells]
            if not {"start", "increment"} <= {*lower} or values[:1] != ["Sequence"]:
                continue
            places = [lower.index("start"), lower.index("increment")]
            numbers = [self._number(values[k]) if k < len(values) else None for k in places]
            start, step = numbers
            if start is None or not step:
                self._wrong(below.line, "no start and increment of the times; expected numbers")
            names = [name if 0 < k < places[0] else "" for k, name in enumerate(cells)]
            times = GridTimes(0, 1 / Fraction(step), start)
            return Layout(self.separator, row.line, below.line + 1, tuple(names), times)
        return None

    def _of_tektronix(self) -> Layout | None:
        """The layout of old oscilloscopes of Tektronix, whose header stands beside the rows."""
        line, cells = self.rows[0]
        if len(cells) <= _TEK_VALUE or cells[0].lower() != _TEK:
            return None
        if not all(self._number(cells[k]) is not None for k in (_TEK_TIME, _TEK_VALUE)):
            return None
        beside = {row.cells[0].lower(): row.cells[1] for row in self.rows if len(row.cells) > 1}
        unit = unit_named(beside.get("horizontal units", "s")) or _SECOND
        names = ("", "", "", "", beside.get("source") or "value")
        return Layout(self.separator, line, line, names, NumberTimes(_TEK_TIME, unit))

    def _of_frames(self) -> Layout | None:
        """The layout of a table with a column that counts frames, at the given rate."""
        rate = self._form.frame_rate
        for k, row in enumerate(self.rows if rate else []):
            cells = row.cells
            places = [i for i, cell in enumerate(cells) if counts_frames(cell)]
            if len(places) == 1 and self._is_above_times(k, places[0]):
                names = self._spelled(row.line, cells)
                names[places[0]] = ""
                assert rate is not None
                times = GridTimes(places[0], rate)
                return Layout(self.separator, row.line, row.line + 1, tuple(names), times)
        return None

    def _of_counted_rows(self, rate: Fraction) -> Layout:
        """The layout of a table without times, whose rows are counted at the given rate."""
        k = self._first_data() or 0
        line, cells = self.rows[k]
        header, above = self.rows[k - 1] if k else TextRow(0, [])
        if len(above) == len(cells) and not any(map(self._number, above)):
            return Layout(self.separator, header, line, tuple(above), GridTimes(-1, rate))
        names = [f"column{i}" for i in range(1, len(cells) + 1)] if cells[1:] else self._wanted
        return Layout(self.separator, 0, line, tuple(names), GridTimes(-1, rate))

    def _first_data(self) -> int | None:
        """The place of the first row of data that a row of as many columns follows."""
        for k, row in enumerate(self.rows):
            below = self.rows[k + 1] if k + 1 < len(self.rows) else row
            alike = len(row.cells) == len(below.cells)
            if alike and all(_looks_like_data(r.cells, self.separator) for r in (row, below)):
                return k
        return None

    def _no_time(self) -> NoReturn:
        """Raise the error of a table without a column of time."""
        place = self._last_above_data()
        line, cells = self.rows[place]
        seen = ", ".join(cells) if self._form.time_column else repr(cells[0] if cells else "")
        remedy = self._remedy(place, cells) if self._form.time_column is None else ""
        name = self._form.time_column or "time"
        self._wrong(line, f"{seen} found; expected a header with a column {name}{remedy}")

    def _remedy(self, place: int, cells: Sequence[str]) -> str:
        """How the row ``cells`` at ``place`` may yet have a column of time."""
        if frames := next(filter(counts_frames, cells), ""):
            return f"; {frames} counts frames? --frame-rate HZ makes times of them"
        if named := self._like_time(place):
            return f"; --time-column '{named}' names it, if that is the time"
        if not self._bare:
            return ""
        return (
            ", or a time; remove lines before it (--skip-rows), or name it: --time-column,"
            f" one of {', '.join(cells)}"
        )

    def _last_above_data(self) -> int:
        """The place of the last row above the data with as many columns, or of the first row."""
        k = self._first_data() or 0
        width = len(self.rows[k].cells)
        alike = (i for i in range(k - 1, -1, -1) if len(self.rows[i].cells) == width)
        return next(alike, 0)

    def _like_time(self, place: int) -> str:
        """A name of the row at ``place`` with a unit of time, in brackets or below it."""
        row = self.rows[place].cells
        units = [""] * len(row)
        if place and any(unit_named(cell) is not None for cell in row):
            row, units = self.rows[place - 1].cells, row
        for name, unit in zip(row, units, strict=False):
            try:
                has_unit = unit_in(name) is not None or unit_named(unit) is not None
            except UnknownUnitError:
                has_unit = False
            if has_unit:
                return name
        return ""
