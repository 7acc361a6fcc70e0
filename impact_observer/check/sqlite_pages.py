"""The rows of an sqlite3 file page by page, for files that sqlite3 itself will not open.

A database that was cut short has lost pages that lead to others. Rows lie in the leaf pages of
tables, which say so themselves; they are read in the order of the file. The layout is that of
https://www.sqlite.org/fileformat2.html.
"""

from collections.abc import Iterator
from typing import BinaryIO, NamedTuple, TypeAlias

MAGIC = b"SQLite format 3\0"
_HEADER = 100
_LEAF_OF_TABLE = 0x0D
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
"""Bytes of an integer by its serial type."""

Value: TypeAlias = int | float | str | bytes | None


class Row(NamedTuple):
    """A row of some table.

    Attributes:
        number: its rowid.
        values: its columns; an ``INTEGER PRIMARY KEY`` is None, for it is the rowid.
    """

    number: int
    values: tuple[Value, ...]


class Pages:
    """The pages of a database file.

    Attributes:
        size: bytes of a page.
        promised: pages that the header says there are.
        count: whole pages that there are.
        lost: cells that could not be read.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Read the header of ``file``.

        Raises:
            ValueError: it is no database.
        """
        header = file.read(_HEADER)
        size = int.from_bytes(header[16:18], "big")
        self.size = 65536 if size == 1 else size
        if header[:16] != MAGIC or self.size < 512 or self.size & (self.size - 1):
            raise ValueError
        self._file = file
        self._usable = self.size - header[20]
        self.promised = int.from_bytes(header[28:32], "big")
        self.count = file.seek(0, 2) // self.size
        self.lost = 0

    def rows(self) -> Iterator[Row]:
        """The rows of all tables, in the order of the file; what is broken is passed over."""
        for number in range(1, self.count + 1):
            page = self._page(number)
            begin = _HEADER if number == 1 else 0
            if page[begin] != _LEAF_OF_TABLE:
                continue
            for k in range(int.from_bytes(page[begin + 3 : begin + 5], "big")):
                place = begin + 8 + 2 * k
                try:
                    yield self._row(page, int.from_bytes(page[place : place + 2], "big"))
                except (ValueError, IndexError):
                    self.lost += 1

    def _page(self, number: int) -> bytes:
        """A page, counted from 1."""
        if not 1 <= number <= self.count:
            raise ValueError
        self._file.seek((number - 1) * self.size)
        return self._file.read(self.size)

    def _row(self, page: bytes, at: int) -> Row:
        """The row in the cell at a place of a page."""
        size, at = _varint(page, at)
        number, at = _varint(page, at)
        most = self._usable - 35
        if size > self.count * self.size:
            raise ValueError
        if size <= most:
            return Row(number, _values(page[at : at + size], size))
        least = (self._usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (self._usable - 4)
        local = local if local <= most else least
        payload = bytearray(page[at : at + local])
        following = int.from_bytes(page[at + local : at + local + 4], "big")
        while len(payload) < size:
            more = self._page(following)
            following = int.from_bytes(more[:4], "big")
            payload += more[4 : min(self._usable, 4 + size - len(payload))]
        return Row(number, _values(bytes(payload), size))


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, and where it ends."""
    value = 0
    for k in range(8):
        value = value << 7 | data[at + k] & 0x7F
        if data[at + k] < 0x80:
            return value, at + k + 1
    return value << 8 | data[at + 8], at + 9


def _values(record: bytes, size: int) -> tuple[Value, ...]:
    """The columns in a record of ``size`` bytes."""
    if len(record) != size:
        raise ValueError
    end, at = _varint(record, 0)
    place, values = end, []
    while at < end:
        kind, at = _varint(record, at)
        value, place = _value(record, place, kind)
        values.append(value)
    if place != size:
        raise ValueError
    return tuple(values)


def _value(record: bytes, at: int, kind: int) -> tuple[Value, int]:
    """A column by its serial type, and where it ends."""
    if kind in (8, 9):
        return kind - 8, at
    if kind >= 12:
        end = at + (kind - 12) // 2
        data = record[at:end]
        return (data.decode() if kind % 2 else data), end
    if kind in _INTEGERS:
        end = at + _INTEGERS[kind]
        return int.from_bytes(record[at:end], "big", signed=True), end
    if kind == 0:
        return None, at
    raise ValueError  # a float, which no table of a bag has, or nothing at all
