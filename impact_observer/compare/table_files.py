"""Tables as CSV or Parquet files, written block by block."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import BagError, UsageError
from impact_observer.stamps import NS_PER_S, text
from impact_observer.states import Stamps

if TYPE_CHECKING:
    pass

Numbers: TypeAlias = NDArray[np.float64] | NDArray[np.int64]
SUFFIXES = (".csv", ".parquet")
_GROUP = 2**16
"""Rows of a Parquet file that are written together."""


@dataclass(frozen=True, slots=True, eq=False)
class TableBlock:
    """Rows of a table.

    Attributes:
        topic: that they are from.
        epoch: stamp of ``t = 0``, ns.
        stamps: ns, shape (rows,).
        texts: columns of words; one word for all rows, or one a row.
        numbers: columns of numbers, shape (rows,).
    """

    topic: str
    epoch: int
    stamps: Stamps
    texts: Mapping[str, str | Sequence[str]]
    numbers: Mapping[str, Numbers] = field(default_factory=dict)

    def words(self, name: str) -> Sequence[str]:
        """A column of words, one a row."""
        column = self.texts[name]
        return [column] * self.stamps.size if isinstance(column, str) else column


class TableFile(Protocol):
    """A file of rows; every block has the same columns."""

    def write(self, block: TableBlock) -> None:
        """Add rows."""

    def close(self) -> None:
        """Finish the file; closing twice does no harm."""


class CsvFile:
    """A CSV file; numbers are written so that they are read back bit by bit."""

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: it cannot be made.
        """
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._has_header = False

    def write(self, block: TableBlock) -> None:
        """Add rows, below a header."""
        if not self._has_header:
            self._writer.writerow([*block.texts, "stamp_ns", "time_s", *block.numbers])
            self._has_header = True
        stamps = block.stamps.tolist()
        self._writer.writerows(
            zip(
                *(block.words(name) for name in block.texts),
                stamps,
                (text(stamp - block.epoch) for stamp in stamps),
                *(column.tolist() for column in block.numbers.values()),
                strict=True,
            )
        )

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class ParquetFile:
    """A Parquet file, written a row group at a time."""

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: it cannot be made.
            ImportError: ``pyarrow`` is not installed.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        self._pa, self._pq = pa, pq
        self._file = path.open("wb")
        self._writer: pq.ParquetWriter | None = None
        self._waiting: list[pa.Table] = []
        self._rows = 0

    def write(self, block: TableBlock) -> None:
        """Add rows."""
        pa = self._pa
        columns = {name: pa.array(block.words(name), pa.string()) for name in block.texts}
        columns["stamp_ns"] = pa.array(block.stamps)
        # Integers are subtracted first: a float of seconds since 1970 has no nanoseconds left.
        columns["time_s"] = pa.array((block.stamps - block.epoch) / NS_PER_S)
        for name, numbers in block.numbers.items():
            columns[name] = pa.array(np.ascontiguousarray(numbers))
        self._waiting.append(pa.table(columns, metadata={"epoch_ns": str(block.epoch)}))
        self._rows += block.stamps.size
        if self._rows >= _GROUP:
            self._flush()

    def close(self) -> None:
        """Write the last rows and the footer."""
        if self._file.closed:
            return
        with self._file:
            if self._waiting:
                self._flush()
            if self._writer is not None:
                self._writer.close()

    def _flush(self) -> None:
        """Write a row group."""
        table = self._pa.concat_tables(self._waiting)
        if self._writer is None:
            self._writer = self._pq.ParquetWriter(self._file, table.schema, compression="zstd")
        self._writer.write_table(table, row_group_size=_GROUP)
        self._waiting, self._rows = [], 0


@contextmanager
def table_file(path: Path) -> Iterator[TableFile]:
    """A file that replaces the one at ``path`` when all rows are written, and not before.

    Args:
        path: its ending says the format.

    Raises:
        UsageError: another ending, the file cannot be made, or ``pyarrow`` is not installed.
        BagError: the disk is full or gone.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: expected a file's name that ends with {' or '.join(SUFFIXES)}")
    part = path.with_name(f".{path.name}.part")
    try:
        file = ParquetFile(part) if path.suffix.lower() == ".parquet" else CsvFile(part)
    except ImportError as error:
        raise UsageError(
            f"{path}: Parquet needs pyarrow ({error}); pip install impact_observer[parquet]"
        ) from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be made: {error.strerror or error}") from None
    try:
        yield file
        file.close()
        part.replace(path)
    except OSError as error:
        raise BagError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            file.close()
        with suppress(OSError):
            part.unlink()
