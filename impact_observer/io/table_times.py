# SPDX-License-Identifier: Apache-2.0
"""Times in the cells of tables: units in names of columns, and texts to the nanosecond."""

import re
from collections.abc import Sequence
from datetime import date
from decimal import Decimal
from fractions import Fraction

import numpy as np

from impact_observer.stamps import MAX_STAMP, NS_PER_S
from impact_observer.states import Stamps, Vector

UNITS = {
    "s": NS_PER_S,
    "ms": 10**6,
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
_NO_UNITS = {"ticks", "jiffies", "cycles", "counts", "samples", "frames"}
_DOUBTFUL = {"min", "h", *_NO_UNITS}
"""Last words of a name that may be no unit, or are none of time."""
_TIME = {"time", "t", "zeit", "uhrzeit", "temps", "heure", "tiempo", "hora"}
"""Words for time, as European instruments and spreadsheets write them."""
_DAYS = {"date", "day", "datum", "fecha"}
_LIKE_TIME = _DAYS - {"day"} | {
    *("times", "timestamp", "time stamp", "stamp", "elapsed", "elapsed time", "time elapsed"),
    *("datetime", "date time", "utc", "utc time", "zeitstempel", "x value"),
}
_FRAMES = {"frame", "frames", "sample", "samples", "sequence", "index"}
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_AMOUNT = re.compile(r"(\d+(?:[.,]\d+)?)?\s*([^\W\d_]+)\.?")
_WORDS = re.compile(r"[^\W_]+")
_HUMPS = re.compile(r"(?<=[a-z])(?=[A-Z])")
_DAY = (
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)|(?P<D>\d\d?)\.(?P<M>\d\d?)\.(?P<Y>\d{4}))"
)
_CLOCK = r"(?P<hour>\d{1,4}):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,:](?P<part>\d+))?)?"
_ZONE = r"\s*(?P<zone>Z|UTC|GMT|[+-]\d\d:?\d\d)?"
_DATE = re.compile(rf"{_DAY}(?:(?:T|\s+|,\s*){_CLOCK}{_ZONE})?", re.IGNORECASE)
_TIME_OF_DAY = re.compile(_CLOCK)
_FIRST_DAY = date(1970, 1, 1).toordinal()


class UnknownUnitError(ValueError):
    """A name has a unit that is not understood; the text is that unit."""


def unit_named(text: str) -> Fraction | None:
    """Nanoseconds of a unit such as ``msec``, ``100ms``, ``(µs)`` or ``Seconds``; else None."""
    match = _AMOUNT.fullmatch(text.strip().strip("()[]").strip())
    unit = match and _UNIT_OF.get(match[2].lower())
    if not match or not unit:
        return None
    return Fraction((match[1] or "1").replace(",", ".")) * UNITS[unit]


def unit_in(name: str) -> Fraction | None:
    """Nanoseconds of the unit in the name of a column of time; None for a name without a unit.

    Raises:
        UnknownUnitError: there is a unit that is not understood, or a word that may be one.
    """
    bracketed = [text for text in _BRACKETS.findall(name) if text.strip()]
    units = [unit for text in bracketed if (unit := unit_named(text)) is not None]
    if bracketed and not units:
        raise UnknownUnitError(bracketed[-1])
    last = "" if units else "".join(_words(name)[-1:])
    if last in _DOUBTFUL:
        raise UnknownUnitError(last)
    return units[0] if units else unit_named(last)


def unit_words(unit: Fraction) -> str:
    """A unit such as ``ms`` or ``100 ms``."""
    name = next((each for each, ns in UNITS.items() if ns == unit), "")
    return name or f"{float(unit / UNITS['ms']):.10g} ms"


def time_rank(name: str) -> int:
    """2 for a column called time or t, 1 for other names of times, 0 for all other names."""
    words = _words(_BRACKETS.sub("", name))
    try:
        unit = unit_in(name)
    except UnknownUnitError:
        unit = None
    if words and (words[-1] in _UNIT_OF if unit else words[-1] in _DOUBTFUL and words[1:]):
        words.pop()
    base = " ".join(words)
    if base in _TIME:
        return 2 if unit or name.strip() != "T" else 0  # a capital T alone may be a temperature
    is_unit = not base and unit is not None and name[0].isalpha() and len(name) > len("ms")
    return int(base in _LIKE_TIME or is_unit)


def is_day(name: str) -> bool:
    """Whether a column may hold the day of times of day."""
    return " ".join(_words(name)) in _DAYS


def counts_frames(name: str) -> bool:
    """Whether a column is named as one that counts frames or samples."""
    return bool(_FRAMES & {*_words(name)[:1]})


def _words(name: str) -> list[str]:
    return [word.lower() for word in _WORDS.findall(_HUMPS.sub(" ", name))]


def ns_of_date(text: str) -> int | None:
    """Nanoseconds from 1970 to a date with or without a time, in UTC unless a zone is named."""
    match = _DATE.fullmatch(text.strip())
    if match is None:
        return None
    year, month, day = (int(match[a] or match[b]) for a, b in ("yY", "mM", "dD"))
    try:
        days = date(year, month, day).toordinal() - _FIRST_DAY
    except ValueError:
        return None
    zone = match["zone"] or ""
    minutes = int(zone[1:3]) * 60 + int(zone[-2:]) if zone[:1] in {"+", "-"} else 0
    minutes *= -1 if zone[:1] == "-" else 1
    return (days * 24 * 60 - minutes) * 60 * NS_PER_S + _since_midnight(match)


def ns_of_clock(text: str) -> int | None:
    """Nanoseconds of ``h:mm:ss`` with any number of decimals; None for another text."""
    match = _TIME_OF_DAY.fullmatch(text.strip())
    return _since_midnight(match) if match is not None and match["second"] else None


def is_dated(text: str) -> bool:
    """Whether a text is a date, with or without a time, or a time of day."""
    return ns_of_date(text) is not None or ns_of_clock(text) is not None


def _since_midnight(match: re.Match[str]) -> int:
    whole = (int(match["hour"] or 0) * 60 + int(match["minute"] or 0)) * 60
    part = round(Decimal(f"0.{match['part'] or 0}") * NS_PER_S)
    return (whole + int(match["second"] or 0)) * NS_PER_S + part


def ns_of_numbers(cells: Sequence[str], values: Vector, unit: Fraction) -> Stamps:
    """Times in a unit (ns), rounded to the nanosecond once; -1 - MAX_STAMP where there is none.

    Args:
        cells: decimals, with a point.
        values: the same as floats, which only say where there is a number that is not too large.
        unit: ns.
    """
    scale, divisor = Decimal(unit.numerator), unit.denominator
    fits = np.abs(values) * float(unit) <= MAX_STAMP  # no NaN does
    return np.array(
        [
            round(Decimal(cell) * scale / divisor) if good else NO_TIME
            for cell, good in zip(cells, fits.tolist(), strict=True)
        ],
        dtype=np.int64,
    )


NO_TIME = -1 - MAX_STAMP
"""Stands for a time that could not be read, ns: no stamp is as early."""
