"""Tables as Parquet files, by ``pyarrow``."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from impact_observer.compare.tables_of_bag import Block
from impact_observer.stamps import NS_PER_S

_GROUP = 2**16
"""Rows that are written together."""


class ParquetSink:
    """A Parquet file, written a row group at a time."""

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: it cannot be made.
        """
        self._file = path.open("wb")
        self._writer: pq.ParquetWriter | None = None
        self._waiting: list[pa.RecordBatch] = []
        self._rows = 0
        self._epoch = 0

    def write(self, block: Block) -> None:
        """Add rows."""
        columns = {name: pa.array(block.words(name), pa.string()) for name in block.texts}
        columns["stamp_ns"] = pa.array(block.stamps)
        # Integers are subtracted first: seconds since 1970 leave a float no nanoseconds.
        columns["time_s"] = pa.array((block.stamps - block.epoch) / NS_PER_S)
        for name, numbers in block.numbers.items():
            columns[name] = pa.array(np.ascontiguousarray(numbers))
        self._waiting.append(pa.RecordBatch.from_pydict(columns))
        self._rows += block.stamps.size
        self._epoch = block.epoch
        if self._rows >= _GROUP:
            self._flush()

    def close(self) -> None:
        """Write what is left and the footer; closing twice does no harm."""
        if not self._file.closed:
            try:
                if self._waiting:
                    self._flush()
                if self._writer is not None:
                    self._writer.close()
            finally:
                self._file.close()

    def _flush(self) -> None:
        """Write a row group."""
        table = pa.Table.from_batches(self._waiting)
        table = table.replace_schema_metadata({"epoch_ns": str(self._epoch)})
        if self._writer is None:
            self._writer = pq.ParquetWriter(self._file, table.schema, compression="zstd")
        self._writer.write_table(table, row_group_size=_GROUP)
        self._waiting, self._rows = [], 0
