# SPDX-License-Identifier: Apache-2.0
"""Impact times and true states in tables, row by row."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from impact_observer.events import Kind, Switch
from impact_observer.io.table_file import TableFile
from impact_observer.io.table_layout import TableForm
from impact_observer.states import Vector, frozen

FORM = "time[, contact[, kind]]"
"""The columns of impact times."""
_COLUMNS = ("contact", "kind")
_KINDS = {name: kind for kind in Kind for name in (kind.name.lower(), str(kind.value))}


class ImpactRow(NamedTuple):
    """A row of impact times.

    Attributes:
        line: where it ends in the file, from 1.
        time: ns after the file's zero.
        switch: of a contact.
    """

    line: int
    time: int
    switch: Switch


class StateRow(NamedTuple):
    """A row of states.

    Attributes:
        line: where it ends in the file, from 1.
        time: ns after the file's zero.
        q: coordinates, shape (n,), m or rad.
        u: velocities, shape (n,), m/s or rad/s.
    """

    line: int
    time: int
    q: Vector
    u: Vector


class ImpactTable:
    """A file of impact times, read row by row.

    Attributes:
        is_grid: whether times are numbers of frames at a constant rate.
    """

    def __init__(
        self,
        path: Path,
        form: TableForm,
        contacts: Sequence[str] | None = None,
    ) -> None:
        """Read ``path``; ``contacts`` are those of the model, None without a model."""
        self._file = TableFile(path, form, _COLUMNS, what="impact", expected=FORM, bare=True)
        self.is_grid = self._file.is_grid
        self._contacts = contacts

    @property
    def ignored(self) -> tuple[str, ...]:
        """Names of the columns that are not read."""
        return tuple(name for name in self._file.columns if name not in _COLUMNS)

    @property
    def times(self) -> str:
        """Words for the form of the times, such as ``times in ms``."""
        return self._file.times

    def remarks(self) -> list[str]:
        """What was left out, a line each; complete after the last row."""
        return self._file.remarks()

    @property
    def signal(self) -> str:
        """Name of an unread column of numbers in a table without contacts; else empty."""
        if "contact" in self._file.columns:
            return ""
        numbers = (name for name in self.ignored if name in self._file.columns_of_numbers())
        return next(numbers, "")

    def rows(self, read: Callable[[], object] = lambda: None) -> Iterator[ImpactRow]:
        """The rows, one by one; ``read`` is called whenever one was read.

        Raises:
            UsageError: names the file, the line, what was found and what is expected.
        """
        for line, time, cells in self._file.in_order(read):
            contact = self._contact(line, cells.get("contact", ""))
            yield ImpactRow(line, time, Switch(contact, self._kind(line, cells.get("kind", ""))))

    def _contact(self, line: int, cell: str) -> str:
        """The contact with a name; without a name the model's only one."""
        contacts = self._contacts
        if not cell:
            if contacts is not None and len(contacts) == 1:
                return contacts[0]
            which = f"one of {', '.join(contacts)}" if contacts else "a column contact"
            remedy = "" if contacts else ", or a --model with one contact"
            self._file.wrong(line, f"names no contact; expected {which}{remedy}")
        if contacts is not None and cell not in contacts:
            expected = ", ".join(contacts) or "none"
            self._file.wrong(line, f"contact {cell!r} is none of the model's: {expected}")
        return cell

    def _kind(self, line: int, cell: str) -> Kind:
        """The kind of a switch; an impact if the cell is empty."""
        if cell and cell.lower() not in _KINDS:
            names = ", ".join(kind.name.lower() for kind in Kind)
            self._file.wrong(line, f"kind {cell!r} found; expected one of {names}")
        return _KINDS[cell.lower()] if cell else Kind.IMPACT


class StateTable:
    """A file of true states, read row by row.

    The position of a coordinate ``x1`` is in a column ``q_x1`` or ``x1``, its velocity in
    ``u_x1``.
    """

    def __init__(self, path: Path, form: TableForm, coordinates: Sequence[str]) -> None:
        """Read ``path``; ``coordinates`` are those of the model."""
        positions = [[f"q_{each}", each] for each in coordinates]
        self._names = positions + [[f"u_{each}"] for each in coordinates]
        wanted = [name for names in self._names for name in names]
        expected = ", ".join(["time", *(names[0] for names in self._names)])
        self._file = TableFile(path, form, wanted, what="state", expected=expected)

    def rows(self, read: Callable[[], object] = lambda: None) -> Iterator[StateRow]:
        """The rows, one by one; ``read`` is called whenever one was read.

        Raises:
            UsageError: names the file, the line, what was found and what is expected.
        """
        columns, n = self._columns(), len(self._names) // 2
        for line, time, cells in self._file.in_order(read):
            x = [self._value(line, name, cells.get(name, "")) for name in columns]
            yield StateRow(line, time, frozen(x[:n]), frozen(x[n:]))

    def _columns(self) -> list[str]:
        """The columns of positions and velocities, in the order of the model."""
        columns, missing = [], []
        for names in self._names:
            present = [name for name in names if name in self._file.columns]
            if len(present) > 1:
                self._file.wrong_header(f"columns {' and '.join(present)} found; expected one")
            columns += present
            missing += [] if present else [names[0]]
        if missing:
            self._file.wrong_header(
                f"no column {', '.join(missing)}; expected a position q_NAME and a velocity"
                " u_NAME of each coordinate of the model"
            )
        return columns

    def _value(self, line: int, column: str, cell: str) -> float:
        if (number := self._file.number(cell)) is None:
            self._file.wrong(line, f"{column} is {cell!r}; expected a finite number")
        return float(number)
