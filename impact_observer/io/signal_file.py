# SPDX-License-Identifier: Apache-2.0
"""Signals over time in a file that is no bag: a table (CSV) or a sound (WAV, FLAC, OGG)."""

import re
from collections.abc import Iterator, Sequence
from itertools import chain, takewhile
from pathlib import Path

from impact_observer.errors import UsageError
from impact_observer.io.bag_part import BagPart, TimeZero
from impact_observer.io.bag_topics import SOUND_FILES
from impact_observer.io.sound_file import SoundFile
from impact_observer.io.table_file import TableFile, later_zero, start_of
from impact_observer.io.table_layout import TableForm
from impact_observer.stamps import MAX_STAMP, NS_PER_S, text

_BARE = "value"
"""Name of the column of numbers in a table without a header."""
_FORM = f"time, {_BARE}"


class SignalFile:
    """The numbers in a file, row by row. Each column, or channel, has a name like a topic's.

    Attributes:
        path: the file.
        topics: by the name of a column of numbers, the topic that it is taken for.
        start: stamp of the file's time zero, ns.
        first: stamp of the first row, ns.
        times: words for the form of the times, such as ``times in ms``; empty of a sound.
        part: the part to which ``rows`` keeps; None for all.
    """

    times = ""
    part: BagPart | None = None

    def __init__(
        self, path: Path, form: TableForm | None = None, start: int | None = None
    ) -> None:
        """Open ``path``.

        Args:
            path: the file; a sound if its suffix is one of ``SOUND_FILES``, else a table.
            form: of a table.
            start: stamp of the file's time zero, ns. None for 0 where the first row lies after
                1973, as times since 1970 do, and for 1 s elsewhere.

        Raises:
            UsageError: the file cannot be read, or has no column of numbers.
        """
        self.path = path
        self._is_table = path.suffix.lower() not in SOUND_FILES
        if self._is_table:
            self._open_table(form or TableForm(), start)
        elif form not in (None, TableForm()):
            raise UsageError(f"{path}: a sound has its times itself; leave out options of a table")
        else:
            self._open_sound(NS_PER_S if start is None else start)
        if not 0 < self.first <= MAX_STAMP:
            raise UsageError(
                f"{path}: its first stamp would be {text(self.first)} s; expected more than 0, at"
                f" most {text(MAX_STAMP)} s: choose {later_zero(self.first - self.start)}, the"
                " stamp of time 0"
            )

    @property
    def zero(self) -> TimeZero:
        """The file's time zero."""
        return TimeZero(self.start, "the file's time 0")

    def rows(self, columns: Sequence[str]) -> Iterator[tuple[int, tuple[float | None, ...]]]:
        """Stamps (ns) and numbers of these columns; None where a cell is empty. Only once.

        Raises:
            UsageError: names the line, what was found and what is expected.
        """
        rows = self._table_rows(columns) if self._is_table else self._sound_rows(columns)
        if (part := self.part) is None:
            return rows
        until = takewhile(lambda row: row[0] <= part.high, rows)
        return (row for row in until if row[0] >= part.low)

    def _open_table(self, form: TableForm, start: int | None) -> None:
        what = "row of a signal"
        self._table = TableFile(
            self.path, form, (_BARE,), what=what, expected=_FORM, bare=True, strict=False
        )
        if form.frame_rate is not None and not self._table.is_grid:
            self._table.wrong_header("has a column of time; leave out --frame-rate, or the column")
        self._rows = self._table.in_order()
        if (first := next(self._rows, None)) is None:
            self.remarks()
            raise UsageError(f"{self.path}: holds no row; expected {_FORM} below the header")
        numbers = self._table.columns_of_numbers()
        if not numbers:
            self._table.wrong(first.line, f"no number beside the time; expected {_FORM}")
        self.topics = {name: topic_of(name) for name in numbers}
        if len({*self.topics.values()}) < len(numbers):
            problem = f"two columns of one name in {', '.join(numbers)}; rename one"
            self._table.wrong_header(f"{problem}: only letters and digits count")
        self.start = start_of(first.time, start)
        self.first = self.start + first.time
        self.times = self._table.times
        self._rows = chain([first], self._rows)

    def _table_rows(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[int, tuple[float | None, ...]]]:
        for row in self._rows:
            numbers = tuple(self._table.value(row, name) for name in columns)
            yield self.start + row.time, numbers

    def remarks(self) -> list[str]:
        """What was left out or is doubtful, a line each; complete after the last row.

        Raises:
            UsageError: most rows cannot be read, or their times have lost their digits.
        """
        return self._table.remarks() if self._is_table else self._sound.remarks

    def _open_sound(self, start: int) -> None:
        self._sound = SoundFile(self.path)
        names = [f"channel{k}" for k in range(1, self._sound.channels + 1)]
        self.topics = {name: topic_of(name) for name in names}
        self.start = self.first = start

    def _sound_rows(self, columns: Sequence[str]) -> Iterator[tuple[int, tuple[float, ...]]]:
        chosen, rate = [[*self.topics].index(name) for name in columns], self._sound.rate
        k = 0
        for block in self._sound.blocks():
            for values in block[chosen].T.tolist():
                yield self.start + (k * NS_PER_S + rate // 2) // rate, tuple(values)
                k += 1


def topic_of(column: str) -> str:
    """The topic of a column: ``/az`` of ``az``, ``/a_z_m_s_2`` of ``a z (m/s^2)``.

    Letters and digits stay.
    """
    name = re.sub(r"\W+", "_", column, flags=re.ASCII).strip("_")
    return f"/{name}" if name[:1].isalpha() else f"/column_{name}"
