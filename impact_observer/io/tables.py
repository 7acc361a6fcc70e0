# SPDX-License-Identifier: Apache-2.0
"""Tables of rows with a time, as rigs, instruments, spreadsheets and loggers write them.

A table is read whole into arrays. Its cells are read as text, so that no digit of a time is lost.
Where two readings are possible, an error names the option that decides.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from io import StringIO
from itertools import islice, repeat
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import UsageError
from impact_observer.input_files import open_input
from impact_observer.io.table_layout import (
    NO_NUMBERS,
    Layout,
    TableForm,
    content,
    find_layout,
    is_number,
    shown,
    wrong,
)
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
from impact_observer.stamps import MAX_STAMP, NS_PER_S, seconds_between, text
from impact_observer.states import Stamps, Vector

Texts = NDArray[np.object_]
_NO_TEXT = re.compile(rb"[\x01-\x08\x0e-\x19\x1c-\x1f]")
_SAMPLE = 1000
"""First filled cells that show whether a column has numbers."""
_LAST, _FEW = 20, 3
"""How many rows are compared with a last one that may be cut, at most and at least."""


@dataclass(frozen=True, eq=False)
class Table:
    """The rows of a table by time.

    Attributes:
        path: the file.
        times: ns after the file's time zero, ascending, shape (rows,).
        lines: where the rows stand in the file, from 1, shape (rows,).
        cells: texts by the name of a column, each of shape (rows,), without columns of time.
            Names that stand in the header twice have ``.1`` and ``.2`` at their ends.
        header: line of the header; 0 without a header.
        words: how times were read, such as ``times in ms``.
        is_counted: whether times are those of frames or rows at a constant rate.
        decimal_comma: whether numbers may have a comma.
        remarks: what was left out, a line each.
    """

    path: Path
    times: Stamps
    lines: NDArray[np.int64]
    cells: Mapping[str, Texts]
    header: int
    words: str
    is_counted: bool
    decimal_comma: bool
    remarks: tuple[str, ...]

    def find(self, name: str) -> str | None:
        """The column of a name, which may have other capitals there; None without the column.

        Raises:
            UsageError: two columns have the name.
        """
        found = [each for each in self.cells if each.lower() == name.lower()]
        if f"{name}.1".lower() in map(str.lower, self.cells) or len(found) > 1:
            self.wrong(self.header, f"two columns {name} found; expected one")
        return found[0] if found else None

    def numbers(self, name: str) -> Vector:
        """The numbers in a column, shape (rows,); NaN where a cell has no finite number."""
        return _floats(self.cells[name].tolist(), decimal_comma=self.decimal_comma)

    def columns_of_numbers(self) -> list[str]:
        """Names of the columns of which most of the first filled cells are numbers."""
        return [name for name, cells in self.cells.items() if self._are_numbers(cells)]

    def _are_numbers(self, cells: Texts) -> bool:
        filled = (cell.strip() for cell in cells if cell.strip().lower() not in NO_NUMBERS)
        known = [
            is_number(each, decimal_comma=self.decimal_comma) for each in islice(filled, _SAMPLE)
        ]
        return 2 * sum(known) > len(known)

    def omission(self, name: str, values: Vector) -> str:
        """How many filled cells of a column are no finite number, a line; empty for none."""
        cells = self.cells[name]
        bad = [k for k in np.flatnonzero(np.isnan(values)).tolist() if cells[k].strip()]
        if not bad:
            return ""
        what = left_out(f"values of {name}", len(bad), len(values))
        first = f"the first, in line {self.lines[bad[0]]}, is {shown(cells[bad[0]])}"
        return f"{self.path}: {what}: no finite numbers; {first}"

    def wrong(self, line: int, problem: str) -> NoReturn:
        """Raise the error of a line."""
        wrong(self.path, line, problem)


def left_out(what: str, count: int, total: int) -> str:
    """Words for what is left out: its count and its part of a total."""
    return f"{count} of {total} {what} left out ({100 * count / total:.2g} %)"


def read_table(path: Path, form: TableForm, expected: str, *, strict: bool = False) -> Table:
    """Read a table.

    Args:
        path: the file.
        form: options.
        expected: columns, for errors.
        strict: whether a row that cannot be read is an error; else such rows are counted and left
            out. A last line that is cut, and what a loss of power left, always are.

    Raises:
        UsageError: names the file, the line, what was found, and what is expected.
    """
    lines, remarks = _lines(path)
    layout = find_layout(path, lines, form, expected, strict=strict)
    rows = _rows(path, lines, layout)
    names = _told_apart(layout.names)
    times = _times(path, layout, rows, names, form, strict=strict)
    lost = _lost(path, lines, rows, times, strict=strict)
    if lost:
        first, total = min(lost), len(rows.lines) + len(rows.cut)
        what = left_out("rows", len(lost), total)
        remarks.append(f"{what}, the first in line {first}: {lost[first]}")
        if 2 * len(lost) > total:
            wrong(path, first, f"{lost[first]}; {len(lost)} of {total} rows cannot be read")
    kept = np.flatnonzero(~np.isin(rows.lines, [*lost]))
    order = _order(path, times, rows.lines, kept, sort=form.sort)
    return Table(
        path=path,
        times=times.ns[order],
        lines=rows.lines[order],
        cells={
            name: rows.cells[k][order]
            for k, name in enumerate(names)
            if name and k not in times.places
        },
        header=layout.header,
        words=times.words,
        is_counted=times.is_counted,
        decimal_comma=layout.decimal_comma,
        remarks=tuple(f"{path}: {each}" for each in remarks),
    )


def _lines(path: Path) -> tuple[list[str], list[str]]:
    """The lines of a file, and remarks on how they are encoded."""
    with open_input(path) as file:
        data = file.read()
    is_wide = data[:2] in {b"\xff\xfe", b"\xfe\xff"}
    if not is_wide and (_NO_TEXT.search(data[:4096]) or data[:1] == b"\0"):
        remedy = "save it as CSV UTF-8; a sound (WAV) is for impact-observer detect"
        raise UsageError(f"{path}: is no text; {remedy}")
    remarks = []
    try:
        decoded = data.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError:
        decoded = data.decode("cp1252", "replace")
        remarks.append("is no text in UTF-8; read as Windows-1252")
    return decoded.replace("\r\n", "\n").replace("\r", "\n").split("\n"), remarks


class _TextRows(NamedTuple):
    """The rows of a table as text.

    Attributes:
        lines: where they stand, from 1, shape (rows,).
        cells: of each column, each of shape (rows,); empty where a row does not reach the column.
        cut: why other lines are left out, by their numbers.
        extra: what is wrong with rows that have more cells than the header, by their lines.
    """

    lines: NDArray[np.int64]
    cells: list[Texts]
    cut: dict[int, str]
    extra: dict[int, str]


def _rows(path: Path, lines: Sequence[str], layout: Layout) -> _TextRows:
    """Split all rows."""
    import pandas as pd  # noqa: PLC0415 (takes a third of a second)

    numbers = [*content(lines, layout.first)]
    nul = "NUL bytes, as a loss of power leaves them"
    cut = {k: nul for k in numbers if "\0" in lines[k - 1]}
    if lines[-1] and _is_cut([lines[k - 1] for k in numbers[-_LAST:]], layout):
        cut[numbers[-1]] = f"{shown(lines[-1])} is cut: the file ends in it"
    numbers = [k for k in numbers if k not in cut]
    texts, mark, known = [lines[k - 1] for k in numbers], layout.mark, len(layout.names)
    if mark == " ":
        most = max((len(each.split()) for each in texts), default=0)
    else:
        most = max(map(str.count, texts, repeat(mark)), default=0) + 1
    width = max(most, known)
    try:
        frame = pd.read_csv(
            StringIO("\n".join(texts)),
            sep=r"\s+" if mark == " " else mark,
            header=None,
            names=range(width),
            index_col=False,
            dtype=object,
            na_filter=False,
            skip_blank_lines=False,
            skipinitialspace=True,
        )
    except pd.errors.ParserError:
        frame = pd.DataFrame()
    if len(frame) != len(texts):
        odd = next((k for k in numbers if lines[k - 1].count('"') % 2), layout.first)
        wrong(path, odd, "a quotation mark is not closed")
    extra = {}
    for k in range(known, width):
        for row in np.flatnonzero(frame[k] != ""):
            extra[numbers[row]] = f"{k + 1} columns found; the header has {known}"
    cells = [frame[k].to_numpy(object) for k in range(known)]
    return _TextRows(np.array(numbers, dtype=np.int64), cells, cut, extra)


def _is_cut(lines: Sequence[str], layout: Layout) -> bool:
    """Whether the last line ends earlier than those before, which have equally many decimals."""
    point = "[.,]" if layout.decimal_comma else "[.]"
    tails = [re.search(rf"{point}(\d[\deE+-]*)$", line.rstrip()) for line in lines]
    *before, last = (len(tail[1]) if tail else 0 for tail in tails)
    return len(before) >= _FEW and len({*before}) == 1 and last < before[0]


class _Times(NamedTuple):
    """The times of rows.

    Attributes:
        ns: times, ns; NO_TIME where there is none, shape (rows,).
        texts: that were read, one of each row.
        places: of the columns of times and days.
        words: how times are read.
        expected: form of a text.
        remedy: what helps where a clock steps back and the rows must not be sorted.
        is_counted: whether times are those of frames or rows.
        can_sort: whether rows may stand in any order if the user says so.
    """

    ns: Stamps
    texts: list[str]
    places: list[int]
    words: str
    expected: str = "a time as a decimal number"
    remedy: str = "--sort would swap the rows before and after the step, so mend the times"
    is_counted: bool = False
    can_sort: bool = True


def _times(
    path: Path, layout: Layout, rows: _TextRows, names: list[str], form: TableForm, *, strict: bool
) -> _Times:
    """The times of rows, in the form of the first one."""
    places = _places_of_time(path, layout, rows, names, form, strict=strict)
    counts = not places or form.time_column or counts_frames(layout.names[places[0]])
    step = NS_PER_S / form.frame_rate if form.frame_rate and counts else layout.step
    texts = [str(k) for k in range(len(rows.lines))]
    if places:
        texts = [each.strip() for each in rows.cells[places[0]]]
    if step:
        words = f"times of {'frames' if places else 'rows'} at {float(NS_PER_S / step):.10g} Hz"
        ns = _scaled(texts, step, layout)
        ns = np.where(ns == NO_TIME, ns, ns + layout.start)
        return _Times(ns, texts, places, words, is_counted=True)
    first = next((each for each in texts if each.lower() not in NO_NUMBERS), "")
    if ns_of_clock(first) is None and ns_of_date(first) is None:
        unit = _unit(path, layout, places[0], form)
        ns, words = _scaled(texts, unit, layout), f"times in {unit_words(unit)}"
        return _Times(ns, texts, places, words)
    if form.unit is not None:
        option = f"--time-unit {form.unit}"
        wrong(path, layout.header or layout.first, f"{option} given for dates; leave it out")
    days = [k for k, name in enumerate(layout.names) if is_day(name) and k not in places]
    if ns_of_date(first) is None and not days:
        ns = _each(ns_of_clock, texts)
        remedy = "times of day need a date where they pass midnight"
        words, expected = "times as h:min:s", "a time as h:min:s"
        return _Times(ns, texts, places, words, expected, remedy, can_sort=False)
    if ns_of_date(first) is None:
        texts = [f"{a.strip()} {b}" for a, b in zip(rows.cells[days[0]], texts, strict=True)]
        places = [*places, days[0]]
    expected = "a time as a date, YYYY-MM-DD h:min:s or DD.MM.YYYY h:min:s"
    remedy = "dates need a zone, such as +01:00, where summer time ends"
    ns = _each(ns_of_date, texts)
    return _Times(ns, texts, places, "times as dates in UTC", expected, remedy)


def _places_of_time(
    path: Path, layout: Layout, rows: _TextRows, names: list[str], form: TableForm, *, strict: bool
) -> list[int]:
    """Places of the columns of time, which are alike; none where rows are counted."""
    line, listed = layout.header or layout.first, ", ".join(filter(None, names))
    if layout.step:
        return [0]
    if form.time_column is not None:
        pairs = zip(layout.names, names, strict=True)
        places = [k for k, pair in enumerate(pairs) if form.time_column in pair]
        if not places:
            wrong(path, line, f"{listed} found; expected a column {form.time_column}")
    else:
        frames = [k for k, name in enumerate(layout.names) if counts_frames(name)]
        if form.frame_rate is not None and len(frames) == 1:
            return frames
        units = layout.units + [""] * len(names)
        ranks = [
            max(time_rank(a), time_rank(b)) for a, b in zip(layout.names, units, strict=False)
        ]
        places = [k for k, rank in enumerate(ranks) if rank and rank == max(ranks)]
    if any((rows.cells[k] != rows.cells[places[0]]).any() for k in places[1:]):
        both = ", ".join(names[k] for k in places)
        wrong(path, line, f"two columns of time, {both}; expected one: --time-column NAME")
    if not places and (form.frame_rate is None or strict):
        remedy = "--time-column NAME, --frame-rate HZ for numbers of frames, or --skip-rows N"
        wrong(path, line, f"no column of time in {listed}; expected {remedy}")
    return places


def _unit(path: Path, layout: Layout, place: int, form: TableForm) -> Fraction:
    """The unit of a column of time, ns: that of the form, of its name or of the row of units."""
    name, given, unit = layout.names[place], form.unit, None
    try:
        unit = unit_in(name)
        if unit is None and layout.units and (name := layout.units[place]):
            unit = unit_named(name)
            if unit is None:
                raise UnknownUnitError(name.strip("()[]"))
    except UnknownUnitError as unknown:
        if given is None:
            problem = f"{name}: {str(unknown)!r} is no unit of time that is understood"
            wrong(path, layout.header, f"{problem}; {UNDERSTOOD}, or --time-unit")
    if given is None:
        return unit or Fraction(NS_PER_S)
    if unit not in (None, UNITS[given]):
        says = f"the header says {unit_words(unit)}, --time-unit {given}"
        wrong(path, layout.header, f"{says}; leave one out")
    return Fraction(UNITS[given])


def _scaled(texts: Sequence[str], unit: Fraction, layout: Layout) -> Stamps:
    """Numbers in a unit (ns) as times, ns; NO_TIME where there is none."""
    if layout.decimal_comma:
        texts = [each.replace(",", ".") for each in texts]
    return ns_of_numbers(texts, _floats(texts, decimal_comma=False), unit)


def _each(read: Callable[[str], int | None], texts: Sequence[str]) -> Stamps:
    """Texts as times, ns; NO_TIME where there is none."""
    times = (read(each) for each in texts)
    known = [NO_TIME if t is None or abs(t) > MAX_STAMP else t for t in times]
    return np.array(known, dtype=np.int64)


def _floats(texts: Sequence[str], *, decimal_comma: bool) -> Vector:
    """Decimals as float64; NaN where there is no finite number."""
    if decimal_comma:
        texts = [each.replace(",", ".") for each in texts]
    try:
        values = np.array([float(each) for each in texts], dtype=np.float64)
    except ValueError:
        values = np.array([_float(each) for each in texts], dtype=np.float64)
    values[np.isinf(values)] = np.nan
    return values


def _float(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _told_apart(names: Sequence[str]) -> list[str]:
    """The names, of which those that stand there twice get a number."""
    counts, seen, told = Counter(names), Counter[str](), []
    for name in names:
        seen[name] += 1
        told.append(f"{name}.{seen[name]}" if name and counts[name] > 1 else name)
    return told


def _lost(
    path: Path, lines: Sequence[str], rows: _TextRows, times: _Times, *, strict: bool
) -> dict[int, str]:
    """Why rows are left out, by their lines.

    Raises:
        UsageError: the table is strict, and a row cannot be read.
    """
    bad = dict(rows.extra)
    for k in np.flatnonzero(times.ns == NO_TIME).tolist():
        line, cell = int(rows.lines[k]), times.texts[k]
        if k and not (strict or lines[line - 2].strip()) and cell[:1].isalpha():
            bad |= dict.fromkeys(
                rows.lines[k:].tolist(), "another table begins there: split the file"
            )
            break
        bad[line] = f"{shown(cell)} found; expected {times.expected}"
        if re.fullmatch(r"[+-]?\d[\d.,]*(e\+?\d+)?", cell, re.IGNORECASE):
            bad[line] = (
                f"time {shown(cell)} is too large for {times.words}; stamps end at"
                f" {text(MAX_STAMP)} s: is that its unit? --time-unit ms, us or ns"
            )
    if strict and bad:
        wrong(path, min(bad), bad[min(bad)])
    return {**rows.cut, **bad}


def _order(
    path: Path, times: _Times, lines: NDArray[np.int64], kept: NDArray[np.intp], *, sort: bool
) -> NDArray[np.intp]:
    """The rows that are kept, by time.

    Rows are out of order by less than they last, else a clock was set back.

    Raises:
        UsageError: rows are out of order, or a clock steps back.
    """
    ns = times.ns[kept]
    steps = np.diff(ns)
    if not np.any(steps < 0):
        return kept
    k = int(np.argmin(steps))
    before, after = ns[: k + 1], ns[k + 1 :]
    is_apart = min(len(before), len(after)) > 1 and after.max() < before.min()
    can_sort = times.can_sort and not (is_apart and -2 * steps[k] > np.ptp(ns))
    if not (sort and can_sort):
        step = f"{seconds_between(int(ns[k + 1]), int(ns[k])):.9g} s"
        ends = f"from {text(int(ns[k]))} to {text(int(ns[k + 1]))} s"
        remedy = "--sort puts the rows in order" if can_sort else times.remedy
        wrong(path, int(lines[kept[k + 1]]), f"the clock steps back by {step}, {ends}; {remedy}")
    return kept[np.argsort(ns, kind="stable")]
