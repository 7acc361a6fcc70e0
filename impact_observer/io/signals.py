# SPDX-License-Identifier: Apache-2.0
"""Signals over time in a file that is no bag: a table (CSV) or a sound (WAV, FLAC, OGG)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import quote

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.input_files import check_input
from impact_observer.io.bag_files import SOUND_FILES
from impact_observer.io.bag_part import FILE_ZERO, BagPart, TimeZero
from impact_observer.io.tables import Table, TableForm, read_table
from impact_observer.plain_text import part_left_out
from impact_observer.stamps import MAX_STAMP, NS_PER_S, seconds_between, text
from impact_observer.states import Matrix, Stamps, Vector

_SINCE_1970 = 100_000_000 * NS_PER_S
"""Least time that counts from 1970, ns; smaller times count from the start of the experiment."""
_AT_ONCE = 1024
"""Frames of a sound that are lost together where they cannot be decoded."""
_UNKNOWN = 2**62
"""Numbers of frames from here on stand for an unknown one."""
_WRONG_LENGTH = re.compile(r"data : \d+ \(should be \d+\)|Calculated frame count .*")
"""What libsndfile says of a header whose length is not that of the file."""
_FEW, _SHARE = 3, 100
"""So many rows may repeat the time of the row before, and one in so many, without a meaning."""


@dataclass(frozen=True, eq=False)
class Signal:
    """Numbers over time. Each column, or channel of a sound, has a name.

    Attributes:
        path: the file.
        stamps: of the rows, ns, ascending, shape (rows,).
        columns: the numbers by the name of a column, each of shape (rows,), in their own units;
            NaN where a cell has no finite number. A sound is in parts of full scale.
        zero: stamp of the file's time zero, ns.
        omissions: by the name of a column, how many of its filled cells are no finite numbers.
        remarks: what was left out or is doubtful, a line each.
        times: words for the form of the times, such as ``times in ms``; empty of a sound.
        is_counted: whether times are those of frames or rows at a constant rate.
    """

    path: Path
    stamps: Stamps
    columns: Mapping[str, Vector]
    zero: int
    omissions: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    times: str = ""
    is_counted: bool = False

    @property
    def topics(self) -> dict[str, str]:
        """By the name of a column, the topic that the column is taken for."""
        return {name: topic_of(name) for name in self.columns}

    @property
    def time_zero(self) -> TimeZero:
        """The file's time zero."""
        return TimeZero(self.zero, FILE_ZERO)

    def within(self, part: BagPart) -> "Signal":
        """The rows of a part."""
        first = np.searchsorted(self.stamps, part.low)
        rows = slice(int(first), int(np.searchsorted(self.stamps, part.high, "right")))
        columns = {name: values[rows] for name, values in self.columns.items()}
        return replace(self, stamps=self.stamps[rows], columns=columns)


def read_signal(path: Path, form: TableForm | None = None, zero: int | None = None) -> Signal:
    """Read a sound, if the suffix is one of ``SOUND_FILES``, else a table.

    Args:
        path: the file.
        form: options of a table.
        zero: stamp of the file's time zero, ns. None for 0 where the first row lies after 1973,
            as times since 1970 do, and for 1 s elsewhere.

    Raises:
        UsageError: the file cannot be read, or has no column of numbers.
    """
    if path.suffix.lower() not in SOUND_FILES:
        signal = signal_of_table(read_table(path, form or TableForm(), "time, value"), zero)
    elif form in (None, TableForm()):
        signal = _sound(path, NS_PER_S if zero is None else zero)
    else:
        raise UsageError(f"{path}: a sound has its times itself; leave out options of a table")
    check_stamps(path, signal.stamps, signal.zero)
    return signal


def signal_of_table(table: Table, zero: int | None) -> Signal:
    """The columns of numbers in a table; ``zero`` (ns) as for :func:`read_signal`.

    Raises:
        UsageError: there is no column of numbers, two are of one name, or most times have lost
            their digits.
    """
    columns = {name: table.numbers(name) for name in table.columns_of_numbers()}
    if not columns:
        found = ", ".join(table.cells) or "no column"
        table.wrong(table.header or 1, f"{found} beside the time found; expected numbers")
    omissions = {name: table.omission(name, values) for name, values in columns.items()}
    if len({*map(topic_of, columns)}) < len(columns):
        problem = f"two columns of one name in {', '.join(columns)}; rename one"
        raise UsageError(f"{table.path}: {problem}: only letters and digits count")
    zero = zero_of(int(table.times[0]), zero)
    return Signal(
        path=table.path,
        stamps=zero + table.times,
        columns=columns,
        zero=zero,
        omissions={name: line for name, line in omissions.items() if line},
        remarks=(*table.remarks, *_lost_digits(table)),
        times=table.words,
        is_counted=table.is_counted,
    )


def _lost_digits(table: Table) -> list[str]:
    """Why times that repeat make stamps wrong; empty where few do. UsageError if nearly all do."""
    steps = np.diff(table.times)
    rows, same = len(table.times), int(np.count_nonzero(steps == 0))
    if same <= _FEW or same * _SHARE <= rows:
        return []
    times, span = rows - same, seconds_between(int(table.times[0]), int(table.times[-1]))
    seen = f"{table.path}: {same} of {rows} rows have the time of the row before"
    remedy = "write times with more digits, or remove them and say --frame-rate HZ"
    if times * _SHARE <= rows or times == 1:
        raise UsageError(f"{seen}: their digits are lost; {remedy}")
    step, mean = span / (times - 1), span / (rows - 1)
    found = f"times change every {step:.3g} s, rows come every {mean:.3g} s"
    return [f"{seen}: {found}, so stamps are up to {step:.3g} s off; {remedy}"]


def _sound(path: Path, zero: int) -> Signal:
    """All channels of a sound, up to a place that cannot be decoded."""
    import soundfile  # noqa: PLC0415 (loads a library)

    check_input(path)
    blocks, total, rate, log = list[Matrix](), 0, 0, ""
    try:
        with soundfile.SoundFile(path) as sound:
            rate, total, log = sound.samplerate, int(sound.frames), sound.extra_info
            while len(block := sound.read(_AT_ONCE, dtype="float64", always_2d=True)):
                blocks.append(block)
    except soundfile.LibsndfileError as error:
        if not total:
            why = f"is no sound that can be read: {error.error_string}"
            convert = f"`ffmpeg -i {quote(str(path))} NEW.wav` converts other sounds"
            raise UsageError(f"{path}: {why}; {convert}") from None
    if not blocks:
        why = "holds no frame; where a recorder left no length in the header"
        raise UsageError(f"{path}: {why}, `ffmpeg -i {quote(str(path))} NEW.wav` mends it")
    frames = np.concatenate(blocks)
    count, remarks = len(frames), []
    if 0 < (missing := total - count) < _UNKNOWN:
        part = f"{missing} of {total} frames are missing ({100 * missing / total:.2g} %)"
        remarks.append(f"{path}: is cut or damaged: {part}, the last {missing / rate:.3g} s")
    if found := _WRONG_LENGTH.search(log):
        seen = f"is cut, or has no length in its header ({found[0].strip()})"
        remarks.append(f"{path}: {seen}; the {count} frames that are there are read")
    stamps = zero + (np.arange(count, dtype=np.int64) * NS_PER_S + rate // 2) // rate
    columns, omissions = dict[str, Vector](), dict[str, str]()
    for k, values in enumerate(frames.T, start=1):
        columns[name := f"channel{k}"] = np.ascontiguousarray(values)
        if bad := int(np.count_nonzero(~np.isfinite(values))):
            part = part_left_out(bad, count, f"frames of {name}", "no finite numbers")
            omissions[name] = f"{path}: {part}"
    return Signal(path, stamps, columns, zero, omissions, tuple(remarks))


def topic_of(column: str) -> str:
    """The topic of a column: ``/az`` of ``az``, ``/a_z_m_s_2`` of ``a z (m/s^2)``.

    Letters and digits stay.
    """
    name = re.sub(r"\W+", "_", column, flags=re.ASCII).strip("_")
    return f"/{name}" if name[:1].isalpha() else f"/column_{name}"


def check_stamps(path: Path, stamps: Stamps, zero: int, epoch: int = 0) -> None:
    """Check that messages may have the ``stamps`` of a file, and that none is before an epoch.

    ``stamps`` ascend; ``zero`` is that of the file's time zero, ``epoch`` is 0 for none; all ns.

    Raises:
        UsageError: names the first or last stamp, and a time zero.
    """
    first, last = int(stamps[0]), int(stamps[-1])
    if max(epoch, 1) <= first and last <= MAX_STAMP:
        return
    stamp = last if last > MAX_STAMP else first
    least = f"{text(epoch)} s, the epoch, or more" if epoch > 0 else "more than 0"
    remedy = f"--time-zero {1 - (first - zero) // NS_PER_S}" if first < zero else "--time-zero"
    raise UsageError(
        f"{path}: a stamp would be {text(stamp)} s; expected {least}, at most {text(MAX_STAMP)} s:"
        f" choose {remedy}, the stamp of time 0, or --epoch"
    )


def zero_of(first: int, zero: int | None) -> int:
    """The stamp of a file's time zero, ns, where its ``first`` time is this, ns.

    If no ``zero`` is given: 0 where the first lies after 1973, as times since 1970 do, else 1 s.
    """
    if zero is not None:
        return zero
    return 0 if first >= _SINCE_1970 else NS_PER_S
