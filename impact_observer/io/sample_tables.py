# SPDX-License-Identifier: Apache-2.0
"""Samples of sensors in tables: an encoder, a camera, a tracker beside impact times."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage, bag_messages
from impact_observer.io.signal_file import topic_of
from impact_observer.io.table_file import TableFile, TableRow, later_zero, start_of
from impact_observer.io.table_layout import TableForm
from impact_observer.stamps import MAX_STAMP, text


class SampleTable:
    """A table of samples, read row by row.

    The samples are messages of ``sensor_msgs/JointState`` on a topic named as the file. Each
    column of numbers is the position of a joint of its name, in the column's own unit; a joint
    without a number in a row is not in its message.

    Attributes:
        topic: of the samples.
        columns: names of the columns of numbers.
        is_grid: whether times are numbers of frames at a constant rate.
    """

    def __init__(self, path: Path, form: TableForm) -> None:
        """Read the first lines of ``path``.

        Raises:
            UsageError: the table has no column of numbers beside the time.
        """
        self._file = TableFile(
            path, form, ("value",), what="sample", expected="time, value", bare=True, strict=False
        )
        self._path, self.topic, self.is_grid = path, topic_of(path.stem), self._file.is_grid
        self.columns = tuple(self._file.columns_of_numbers())
        if not self.columns:
            self._file.wrong_header("no number beside the time; expected a column of samples")

    def messages(
        self, start: int, impact: int, read: Callable[[], object] = lambda: None
    ) -> Iterator[tuple[int, str, AnyMessage]]:
        """Stamps (ns), topic and messages of the rows with a number.

        Args:
            start: stamp of the file's time zero, ns.
            impact: time of the first impact, ns after that zero.
            read: called whenever a row was read.

        Raises:
            UsageError: names the file, the line, what was found and what is expected.
        """
        make = bag_messages()
        for row in self._file.in_order(read):
            self._check_clock(row, start, impact)
            numbers = {name: self._file.value(row, name) for name in self.columns}
            some = {name: value for name, value in numbers.items() if value is not None}
            if some:
                stamp = start + row.time
                yield stamp, self.topic, make.positions(stamp, [*some], [*some.values()])

    def _check_clock(self, row: TableRow, start: int, impact: int) -> None:
        if start_of(row.time, None) != start_of(impact, None):
            self._file.wrong(
                row.line,
                f"time {text(row.time)} s is of another clock than the first impact,"
                f" {text(impact)} s: only one of them counts from 1970",
            )
        if not 0 < (stamp := start + row.time) <= MAX_STAMP:
            self._file.wrong(
                row.line,
                f"the stamp would be {text(stamp)} s; expected more than 0, at most"
                f" {text(MAX_STAMP)} s: choose {later_zero(row.time)}, the stamp of time 0",
            )

    def remarks(self) -> list[str]:
        """What was left out or is doubtful, a line each; complete after the last row.

        Raises:
            UsageError: most rows cannot be read, or their times have lost their digits.
        """
        return self._file.remarks()


def sample_tables(paths: Sequence[Path], form: TableForm) -> list[SampleTable]:
    """The tables of samples.

    Raises:
        UsageError: two files have one topic, or a file has that of the package, or no numbers.
    """
    tables: list[SampleTable] = []
    for path in paths:
        topic = topic_of(path.stem)
        if interfaces.interface(topic) or topic in [each.topic for each in tables]:
            raise UsageError(f"{path}: topic {topic} is taken already; rename the file")
        tables.append(SampleTable(path, form))
    return tables
