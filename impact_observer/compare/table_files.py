# SPDX-License-Identifier: Apache-2.0
"""Tables as CSV or Parquet files, written block by block."""

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import UsageError
from impact_observer.io.bag_part import TimeZero
from impact_observer.output_files import replacing
from impact_observer.stamps import NS_PER_S, text
from impact_observer.states import Stamps

if TYPE_CHECKING:
    import pyarrow as pa


class TableBlock(NamedTuple):
    """Rows with stamps (ns) of a topic; all blocks of one table have the same columns."""

    topic: str
    zero: TimeZero
    stamps: Stamps
    words: Mapping[str, Sequence[str]]
    numbers: Mapping[str, NDArray[np.float64] | NDArray[np.int64]]


def write_table(path: Path, blocks: Iterable[TableBlock]) -> Counter[str]:
    """Write a table; an existing file is replaced when all rows are written, and not before.

    Args:
        path: the file; ``.csv`` or ``.parquet``.
        blocks: the rows, at least one block.

    Returns:
        Number of rows by topic.

    Raises:
        UsageError: another ending, the file may not be written, or ``pyarrow`` is not installed.
        OutputError: the disk is full or gone.
    """
    write = {".csv": _write_csv, ".parquet": _write_parquet}.get(path.suffix.lower())
    if write is None:
        raise UsageError(f"{path}: expected a file's name that ends with .csv or .parquet")
    if write is _write_parquet:
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError as error:
            raise UsageError(
                f"{path}: Parquet needs pyarrow ({error}); pip install pyarrow"
            ) from None
    written: Counter[str] = Counter()

    def counted() -> Iterator[TableBlock]:
        for block in blocks:
            yield block
            written[block.topic] += block.stamps.size

    with replacing(path) as temporary:
        write(temporary, counted())
    return written


def _write_csv(path: Path, blocks: Iterable[TableBlock]) -> None:
    """Write CSV; numbers are read back bit by bit."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for block in blocks:
            if file.tell() == 0:
                writer.writerow([*block.words, "stamp_ns", "time_s", *block.numbers])
            stamps = block.stamps.tolist()
            times = [text(stamp - block.zero.stamp) for stamp in stamps]
            numbers = [_cells(column) for column in block.numbers.values()]
            writer.writerows(zip(*block.words.values(), stamps, times, *numbers, strict=True))


def _cells(column: NDArray[np.float64] | NDArray[np.int64]) -> list[float | str]:
    """The numbers of a column; NaN is an empty cell."""
    none = np.isnan(column)
    cells: list[float | str] = column.tolist()
    return ["" if n else v for n, v in zip(none, cells, strict=True)] if none.any() else cells


def _write_parquet(path: Path, blocks: Iterable[TableBlock]) -> None:
    """Write Parquet; each block becomes a row group."""
    import pyarrow.parquet as pq

    tables = map(_arrow_table, blocks)
    first = next(tables)
    with pq.ParquetWriter(path, first.schema, compression="zstd") as writer:
        for table in chain([first], tables):
            writer.write_table(table)


def _arrow_table(block: TableBlock) -> "pa.Table":
    import pyarrow as pa

    columns = {name: pa.array(words, pa.string()) for name, words in block.words.items()}
    columns["stamp_ns"] = pa.array(block.stamps)
    # Integers are subtracted first: a float of seconds since 1970 has no nanoseconds left.
    columns["time_s"] = pa.array((block.stamps - block.zero.stamp) / NS_PER_S)
    for name, numbers in block.numbers.items():
        columns[name] = pa.array(np.ascontiguousarray(numbers))
    instant = block.zero.instant.removeprefix("the ").replace(" ", "_")
    return pa.table(columns, metadata={f"{instant}_ns": str(block.zero.stamp)})
