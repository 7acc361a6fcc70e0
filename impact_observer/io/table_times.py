# SPDX-License-Identifier: Apache-2.0
"""Times in tables, to the nanosecond: decimals with units in names, dates, clocks, frames."""

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from datetime import date
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

from impact_observer.stamps import NS_PER_S

UNITS = {
    "s": NS_PER_S,
    "ms": 1_000_000,
    "us": 1000,
    "ns": 1,
    "min": 60 * NS_PER_S,
    "h": 3600 * NS_PER_S,
}
"""Nanoseconds of each unit of time."""
UNDERSTOOD = "expected s, ms, us, ns, min or h, also in words or with a number, as in (100 ms)"
_SPELLINGS = {
    "s": "s sec secs second seconds",
    "ms": "ms msec msecs millis millisec millisecond milliseconds",
    "us": "us µs μs usec usecs micros microsec microsecond microseconds",
    "ns": "ns nsec nsecs nanos nanosec nanosecond nanoseconds",
    "min": "min mins minute minutes",
    "h": "h hr hrs hour hours",
}
_UNIT_OF = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
_DOUBTFUL = {"min", "h", "ticks", "jiffies", "cycles", "counts", "samples", "frames"}
"""Last words of a name that may be no unit, or are none of time."""
_TIME = {"time", "zeit", "uhrzeit", "temps", "heure", "tiempo", "hora"}
"""The word for time as European instruments and spreadsheets write it."""
_DAYS = {"date", "day", "datum", "fecha"}
_TIME_NAMES = (
    {"times", "timestamp", "time stamp", "stamp", "elapsed", "elapsed time"}
    | {*("time elapsed", "datetime", "date time", "utc", "utc time", "zeitstempel")}
    | (_DAYS - {"day"})
)
_FRAMES = {"frame", "frames", "sample", "samples", "sequence", "index"}
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_AMOUNT = re.compile(r"(\d+(?:[.,]\d+)?)?\s*([^\W\d_]+)\.?")
_WORDS = re.compile(r"[^\W_]+")
_HUMPS = re.compile(r"(?<=[a-z])(?=[A-Z])")
_GLUED = re.compile(r"time(s|ms|us|ns)", re.IGNORECASE)

_DAY = (
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)|(?P<D>\d\d?)\.(?P<M>\d\d?)\.(?P<Y>\d{4}))"
)
_CLOCK = r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,:](?P<part>\d+))?)?"
_ZONE = r"\s*(?P<zone>Z|UTC|GMT|[+-]\d\d:?\d\d)?"
_DATE = re.compile(f"{_DAY}(?:(?:T|\\s+|,\\s*){_CLOCK}{_ZONE})?", re.IGNORECASE)
_TIME_OF_DAY = re.compile(
    r"(?P<hour>\d{1,9}):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,:](?P<part>\d+))?"
)
_EPOCH = date(1970, 1, 1).toordinal()
_MINUTES = 60


class Unit(NamedTuple):
    """A unit of time.

    Attributes:
        name: such as ``ms`` or ``100 ms``.
        ns: its length, ns.
    """

    name: str
    ns: Decimal


class UnknownUnitError(ValueError):
    """A name has a unit that is not understood; the text is that unit."""


def unit_named(text: str) -> Unit | None:
    """The unit that is written as ``msec``, ``100ms``, ``µs`` or ``Seconds``; None for no unit."""
    match = _AMOUNT.fullmatch(text.strip().strip("()[]").strip())
    unit = match and _UNIT_OF.get(match[2].lower())
    if not match or not unit:
        return None
    amount = Decimal((match[1] or "1").replace(",", "."))
    return Unit(unit if amount == 1 else f"{match[1]} {unit}", amount * UNITS[unit])


def unit_in(name: str) -> Unit | None:
    """The unit in the name of a column of time; None where the name has no unit.

    Raises:
        UnknownUnitError: there is a unit that is not understood, or a word that may be one.
    """
    brackets = [text for text in _BRACKETS.findall(name) if text.strip()]
    for text in brackets:
        if (unit := unit_named(text)) is not None:
            return unit
    if brackets:
        raise UnknownUnitError(brackets[-1])
    if glued := _GLUED.fullmatch(name):
        return unit_named(glued[1])
    last = _words(name)[-1:]
    if last and last[0] in _DOUBTFUL:
        raise UnknownUnitError(last[0])
    return unit_named(last[0]) if last else None


def time_rank(name: str) -> int:
    """2 for ``time`` and ``t`` with a unit, 1 for other names of times, 0 for all others."""
    try:
        unit = unit_in(name)
    except UnknownUnitError:
        unit = None
    if _GLUED.fullmatch(name):
        return 2
    words = _words(_BRACKETS.sub("", name))
    if words and (words[-1] in _UNIT_OF if unit else len(words) > 1 and words[-1] in _DOUBTFUL):
        words = words[:-1]
    base = " ".join(words)
    if base == "t" and unit is None:
        return int(name.strip() == "t")  # a capital T alone may be a temperature
    if base in _TIME | {"t"}:
        return 2
    is_word = unit is not None and name[0].isalpha() and len(name) > len("ms")
    return int(base in _TIME_NAMES or (not base and is_word))


def is_date(name: str) -> bool:
    """Whether a column may hold the day of times of day."""
    words = _words(name)
    return len(words) == 1 and words[0] in _DAYS


def counts_frames(name: str) -> bool:
    """Whether a column is named as one that counts frames or samples."""
    return bool(_FRAMES & {*_words(name)[:1]})


def _words(name: str) -> list[str]:
    return [word.lower() for word in _WORDS.findall(_HUMPS.sub(" ", name))]


def ns_of_date(text: str) -> int | None:
    """Nanoseconds from 1970 to a date with a time, in UTC unless a zone is named; else None."""
    match = _DATE.fullmatch(text.strip())
    if match is None:
        return None
    year, month, day = (match[a] or match[b] for a, b in ("yY", "mM", "dD"))
    try:
        days = date(int(year), int(month), int(day)).toordinal() - _EPOCH
    except ValueError:
        return None
    zone, offset = (match["zone"] or "").upper(), 0
    if zone[:1] in {"+", "-"}:
        offset = int(zone[1:3]) * _MINUTES + int(zone[-2:])
        offset *= -60 if zone[0] == "-" else 60
    return (days * 86_400 - offset) * NS_PER_S + _since_midnight(match)


def ns_of_clock(text: str) -> int | None:
    """Nanoseconds of ``h:mm:ss`` with any number of decimals; None for another text."""
    match = _TIME_OF_DAY.fullmatch(text.strip())
    return None if match is None else _since_midnight(match)


def _since_midnight(match: re.Match[str]) -> int:
    whole = (int(match["hour"] or 0) * 60 + int(match["minute"] or 0)) * 60
    whole += int(match["second"] or 0)
    return whole * NS_PER_S + round(Decimal(f"0.{match['part'] or 0}") * NS_PER_S)


def is_dated(text: str) -> bool:
    """Whether a text is a date, with or without a time, or a time of day."""
    return ns_of_date(text) is not None or ns_of_clock(text) is not None


class CellTimes(ABC):
    """The times in the cells of a row.

    Attributes:
        column: place of the time in a row; -1 where rows are counted.
        day: place of the day of times of day; -1 without such a column.
        words: how times were read, such as ``times in ms``.
        dated: whether times are dates since 1970.
    """

    words: str
    dated: bool = False

    def __init__(self, column: int, day: int = -1) -> None:
        self.column, self.day = column, day

    @abstractmethod
    def ns(self, cells: Sequence[str], number: Decimal | None, row: int) -> int | None:
        """The time of a row in ns, rounded to the nearest; None for a text that is no time.

        Args:
            cells: of the row.
            number: the cell of the time as a number, if it is one.
            row: how many rows were before.
        """


class NumberTimes(CellTimes):
    """Decimal numbers in a unit."""

    def __init__(self, column: int, unit: Unit) -> None:
        super().__init__(column)
        self._ns = unit.ns
        self.words = f"times in {unit.name}"

    def ns(self, cells: Sequence[str], number: Decimal | None, row: int) -> int | None:
        """The number times the unit."""
        del cells, row
        return None if number is None else round(number * self._ns)


class DateTimes(CellTimes):
    """Dates with times, or times of day with the day in another column or without a day."""

    def __init__(self, column: int, day: int = -1, *, of_day: bool = False) -> None:
        super().__init__(column, day)
        self._of_day = of_day
        self.dated = not of_day
        self.words = "times as h:min:s" if of_day else "times as dates in UTC"

    def ns(self, cells: Sequence[str], number: Decimal | None, row: int) -> int | None:
        """The time since 1970, or since midnight."""
        del number, row
        cell = cells[self.column]
        if self._of_day:
            return ns_of_clock(cell)
        if self.day < 0:
            return ns_of_date(cell)
        return ns_of_date(f"{cells[self.day]} {cell}") if self.day < len(cells) else None


class GridTimes(CellTimes):
    """Numbers of frames or samples, or rows that are counted, at a constant rate."""

    def __init__(self, column: int, rate: Fraction, start: Decimal = Decimal(0)) -> None:
        super().__init__(column)
        self._ns, self._start = NS_PER_S / rate, round(start * NS_PER_S)
        what = "rows" if column < 0 else "frames"
        self.words = f"times of {what} at {float(rate):.10g} Hz"

    def ns(self, cells: Sequence[str], number: Decimal | None, row: int) -> int | None:
        """The number of the frame, or of the row from 0, over the rate."""
        del cells
        if self.column < 0:
            return self._start + round(row * self._ns)
        return None if number is None else self._start + round(Fraction(number) * self._ns)
