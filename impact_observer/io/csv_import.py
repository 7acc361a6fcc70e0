"""Impact times from a CSV file: its rows become events of a bag.

Times are read as decimals, not as floats, so that stamps are exact to the nanosecond.
"""

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain, groupby
from pathlib import Path
from typing import NamedTuple, NoReturn

from impact_observer import __version__
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import interfaces
from impact_observer.io.messages import bag_messages
from impact_observer.io.recordings import all_or_nothing
from impact_observer.io.writer import FLUSH
from impact_observer.model import Model
from impact_observer.stamps import MAX_STAMP, NS_PER_S, text

_UNITS = {"s": NS_PER_S, "ms": 1_000_000, "us": 1000, "ns": 1}
"""Nanoseconds of each unit of time."""
_SINCE_1970 = 100_000_000 * NS_PER_S
"""Times from here on are taken to count from 1970, smaller ones from the start of the
experiment."""
_TIME = re.compile(r"time(?:[ _]?[\[(]?(s|ms|us|ns)[\])]?)?", re.IGNORECASE)
_COLUMNS = ("time", "contact", "kind")
_FORM = "time[, contact[, kind]]"
_KINDS = {name: kind for kind in Kind for name in (kind.name.lower(), str(kind.value))}


class CsvRow(NamedTuple):
    """A row of the file.

    Attributes:
        line: where it ends in the file, from 1.
        time: ns after the file's zero.
        switch: of a contact.
    """

    line: int
    time: int
    switch: Switch


@dataclass(frozen=True, slots=True)
class Imported:
    """The result of an import.

    Attributes:
        events: written.
        rows: rows read.
        start: stamp of the file's time zero, ns.
        epoch: stamp of ``t = 0`` that the events carry, ns; 0 for unknown.
        first: stamp of the first event, ns.
        last: stamp of the last event, ns.
        ignored: names of the columns that were not read.
    """

    events: int
    rows: int
    start: int
    epoch: int
    first: int
    last: int
    ignored: tuple[str, ...]


class Table:
    """A file of impact times, read row by row; columns are separated by comma, semicolon or tab.

    Attributes:
        ignored: names of the columns that are not read; complete after the first row.
    """

    def __init__(
        self, path: Path, *, unit: str | None = None, contacts: Sequence[str] | None = None
    ) -> None:
        """Read ``path``.

        Args:
            path: a CSV file.
            unit: of time: s, ms, us or ns; None for that in the header, else seconds.
            contacts: those of the model; None without a model.
        """
        self.ignored: tuple[str, ...] = ()
        self._path = path
        self._unit = unit
        self._contacts = contacts
        self._line = 0
        self._separator = ","
        self._has_header = False
        self._columns: list[str] = []

    def rows(self) -> Iterator[CsvRow]:
        """The rows, one by one.

        Raises:
            UsageError: names the file, the line, what was found and what is expected.
        """
        try:
            with self._path.open(encoding="utf-8-sig", newline="") as file:
                yield from self._rows(file)
        except UnicodeDecodeError:
            raise UsageError(f"{self._path}: is no text in UTF-8; save it as CSV UTF-8") from None
        except OSError as error:
            raise UsageError(f"{self._path}: cannot be read: {error.strerror}") from None

    def _rows(self, file: Iterable[str]) -> Iterator[CsvRow]:
        lines = ("\n" if line.lstrip().startswith("#") else line for line in file)
        skipped, first = next(((k, line) for k, line in enumerate(lines) if line.strip()), (0, ""))
        if not first:
            raise UsageError(f"{self._path}: holds no impact; expected rows {_FORM}")
        self._separator = next((each for each in "\t;" if each in first), ",")
        reader = csv.reader(chain([first], lines), delimiter=self._separator, strict=True)
        try:
            for row in reader:
                self._line = skipped + reader.line_num
                cells = [cell.strip() for cell in row]
                if not any(cells):
                    continue
                if not self._columns:
                    self._read_columns(cells)
                    if self._has_header:
                        continue
                yield self._row(cells)
        except csv.Error as error:
            self._line = skipped + reader.line_num
            self._wrong(f"cannot be read as CSV: {error}")

    def _read_columns(self, cells: list[str]) -> None:
        """Read the columns and the unit from the first row, if it is a header."""
        times = [cell for cell in cells if _TIME.fullmatch(cell)]
        if not times:
            if self._number(cells[0]) is None:
                self._wrong(f"{cells[0]!r} found; expected a header with a column time, or a time")
            self._columns = [*_COLUMNS]
            return
        if len(times) > 1:
            self._wrong(f"two columns of time, {', '.join(times)}; expected one")
        names = ["time" if cell in times else cell.lower() for cell in cells]
        for name in _COLUMNS:
            if names.count(name) > 1:
                self._wrong(f"two columns {name} found; expected one")
        unit = _TIME.findall(times[0])[0].lower()
        if self._unit and unit and unit != self._unit:
            self._wrong(f"the header says {unit}, --time-unit {self._unit}; leave one out")
        self._unit = self._unit or unit
        self._columns, self._has_header = names, True
        named = zip(cells, names, strict=True)
        self.ignored = tuple(cell for cell, name in named if cell and name not in _COLUMNS)

    def _row(self, cells: list[str]) -> CsvRow:
        most = len(self._columns)
        if len(cells) > most:
            what = "the header has" if self._has_header else f"expected {_FORM}, at most"
            self._wrong(f"{len(cells)} columns found; {what} {most}")
        time, contact, kind = (
            dict(zip(self._columns, cells, strict=False)).get(name, "") for name in _COLUMNS
        )
        switch = Switch(self._contact(contact), self._kind(kind))
        return CsvRow(self._line, self._time(time), switch)

    def _number(self, cell: str) -> Decimal | None:
        """A time, ns; its decimal point may be a comma unless commas separate columns."""
        number = cell if self._separator == "," else cell.replace(",", ".")
        try:
            time = Decimal(number) * _UNITS[self._unit or "s"]
        except ArithmeticError:
            return None
        return time if time.is_finite() else None

    def _time(self, cell: str) -> int:
        """A time in ns after the file's zero, rounded to the nearest nanosecond."""
        if (time := self._number(cell)) is None:
            self._wrong(f"{cell!r} found; expected a time as a decimal number")
        if abs(time) > MAX_STAMP:
            self._wrong(f"time {cell} is too large; stamps end at {text(MAX_STAMP)} s")
        return round(time)

    def _contact(self, cell: str) -> str:
        """The contact with a name; without a name the model's only one."""
        contacts = self._contacts
        if not cell:
            if contacts is not None and len(contacts) == 1:
                return contacts[0]
            which = f"one of {', '.join(contacts)}" if contacts else "a column contact"
            remedy = "" if contacts else ", or a --model with one contact"
            self._wrong(f"names no contact; expected {which}{remedy}")
        if contacts is not None and cell not in contacts:
            expected = ", ".join(contacts) or "none"
            self._wrong(f"contact {cell!r} is none of the model's: {expected}")
        return cell

    def _kind(self, cell: str) -> Kind:
        """The kind of a switch; an impact if the cell is empty."""
        if cell and cell.lower() not in _KINDS:
            names = ", ".join(kind.name.lower() for kind in Kind)
            self._wrong(f"kind {cell!r} found; expected one of {names}")
        return _KINDS[cell.lower()] if cell else Kind.IMPACT

    def _wrong(self, problem: str) -> NoReturn:
        raise UsageError(f"{self._path}, line {self._line}: {problem}")


def import_csv(
    path: Path,
    output: Path,
    *,
    model: Model | None = None,
    unit: str | None = None,
    start: int | None = None,
    epoch: int | None = None,
    sort: bool = False,
    flush: float = FLUSH,
    progress: Callable[[int], None] = lambda _: None,
) -> Imported:
    """Write the impact times of a file to a bag.

    Rows of equal time are one event. Memory is constant, unless the rows are to be sorted.

    Args:
        path: the CSV file.
        output: the bag to make.
        model: to put into the bag; only its contacts are allowed. None for none.
        unit: of time: s, ms, us or ns; None for that in the header, else seconds.
        start: stamp of the file's time zero, ns. None for 0 where the first time lies after 1973,
            as times since 1970 do, and for 1 s elsewhere.
        epoch: stamp of ``t = 0`` of the forcing, ns; None for the file's time zero.
        sort: whether rows may stand in any order.
        flush: longest time until a message is on the disk, s.
        progress: called with the number of rows read.

    Raises:
        UsageError: the file has a mistake, or something is at ``output`` already.
        BagError: the bag cannot be written.
    """
    contacts = None if model is None else model.system.contact_names
    table = Table(path, unit=unit, contacts=contacts)
    rows = iter(sorted(table.rows(), key=lambda row: row.time) if sort else table.rows())
    first = next(rows, None)
    if first is None:
        raise UsageError(f"{path}: holds no impact; expected rows {_FORM} below the header")
    if start is None:
        start = 0 if first.time >= _SINCE_1970 else NS_PER_S
    zero = start if epoch is None else epoch
    count = events = stamp = 0
    make = bag_messages()
    with all_or_nothing(output, flush) as writer:
        if model is not None:
            text_of_model = model.text({"package": "impact_observer", "version": __version__})
            log_time = max(start + first.time, 1)
            writer.write(interfaces.PLANT_MODEL.topic, log_time, make.model(text_of_model))
        writer.declare(interfaces.IMPACTS.topic)
        for _, group in groupby(_ascending(path, chain([first], rows)), lambda row: row.time):
            together = list(group)
            stamp = _stamp(path, together[0], start, zero)
            events += 1
            event = ImpactEvent(stamp, _switches(path, together), events, 0, zero)
            writer.write(interfaces.IMPACTS.topic, stamp, make.event(event))
            count += len(together)
            progress(count)
    return Imported(events, count, start, zero, start + first.time, stamp, table.ignored)


def _ascending(path: Path, rows: Iterable[CsvRow]) -> Iterator[CsvRow]:
    """The same rows, checked not to go back in time."""
    before: CsvRow | None = None
    for row in rows:
        if before is not None and row.time < before.time:
            raise UsageError(
                f"{path}, line {row.line}: time {text(row.time)} s comes after"
                f" {text(before.time)} s; sort the rows, or say --sort"
            )
        before = row
        yield row


def _stamp(path: Path, row: CsvRow, start: int, epoch: int) -> int:
    """The stamp of a row, ns."""
    stamp = start + row.time
    if not max(epoch, 1) <= stamp <= MAX_STAMP:
        least = f"{text(epoch)} s, the epoch, or more" if epoch > 0 else "more than 0"
        raise UsageError(
            f"{path}, line {row.line}: the stamp would be {text(stamp)} s; expected {least}, at"
            f" most {text(MAX_STAMP)} s: choose --start, the stamp of time 0, or --epoch"
        )
    return stamp


def _switches(path: Path, rows: Sequence[CsvRow]) -> tuple[Switch, ...]:
    """The switches of one event, checked to be different."""
    found: dict[Switch, CsvRow] = {}
    for row in rows:
        if (other := found.setdefault(row.switch, row)) is not row:
            kind = row.switch.kind.name.lower()
            raise UsageError(
                f"{path}, line {row.line}: {kind} of {row.switch.contact!r} stands in line"
                f" {other.line} already, at the same time; remove one"
            )
    return tuple(found)
