# SPDX-License-Identifier: Apache-2.0
"""Times in tables, to the nanosecond: decimals with the unit in their column's name, and dates."""

import re
from collections.abc import Sequence
from datetime import date
from decimal import Decimal
from fractions import Fraction

import numpy as np

from impact_observer.stamps import MAX_STAMP, NS_PER_S
from impact_observer.states import Stamps, Vector

UNITS = {"s": NS_PER_S, "ms": 10**6, "us": 1000, "ns": 1, "min": 60 * NS_PER_S}
UNITS["h"] = 60 * UNITS["min"]
"""Nanoseconds of each unit of time."""
UNDERSTOOD = "expected s, ms, us, ns, min or h, also in words or with a number, as in (100 ms)"
NO_TIME = -1 - MAX_STAMP
"""Stands for a time that could not be read, ns: no stamp is as early."""
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
_TIME = {"time", "t", "zeit", "uhrzeit", "temps", "heure", "tiempo", "hora"}
_DAYS = {"date", "day", "datum", "fecha"}
_STAMPS = _DAYS | {"times", "timestamp", "time stamp", "stamp", "elapsed", "elapsed time"}
_STAMPS |= {"time elapsed", "datetime", "date time", "utc", "utc time", "zeitstempel", "x value"}
_FRAMES = {"frame", "frames", "sample", "samples", "sequence", "index"}
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_AMOUNT = re.compile(r"(\d+(?:[.,]\d+)?)?\s*([^\W\d_]+)\.?")
_DATE = re.compile(
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)|(\d\d?)\.(\d\d?)\.(\d{4}))"
    r"(?:(?:T|\s+|,\s*)([\d:.,]+)\s*(Z|UTC|GMT|[+-]\d\d:?\d\d)?)?",
    re.IGNORECASE,
)
_CLOCK = re.compile(r"(\d{1,4}):(\d\d)(?::(\d\d)(?:[.,:](\d+))?)?")


class UnknownUnitError(ValueError):
    """A name has a unit that is not understood; the text is that unit."""


def unit_named(text: str) -> Fraction | None:
    """Nanoseconds of a unit such as ``msec``, ``100ms``, ``µs`` or ``Seconds``; else None."""
    match = _AMOUNT.fullmatch(text.strip())
    unit = match and _UNIT_OF.get(match[2].lower())
    return Fraction((match[1] or "1").replace(",", ".")) * UNITS[unit] if match and unit else None


def unit_in(name: str) -> Fraction | None:
    """Nanoseconds of the unit in the name of a column of time; None for a name without a unit.

    Raises:
        UnknownUnitError: there is a unit that is not understood, or a word that may be one.
    """
    bracketed = [text for text in _BRACKETS.findall(name) if text.strip()]
    last = bracketed[-1] if bracketed else "".join(_words(name)[-1:])
    unit = next((unit for each in bracketed if (unit := unit_named(each))), None)
    if unit is None and (bracketed or last in _DOUBTFUL):
        raise UnknownUnitError(last)
    return unit or unit_named(last)


def unit_words(unit: Fraction) -> str:
    """A unit such as ``ms`` or ``100 ms``."""
    name = next((each for each, ns in UNITS.items() if ns == unit), "")
    return name or f"{float(unit / UNITS['ms']):.10g} ms"


def time_rank(name: str) -> int:
    """2 for a column called time or t, 1 for stamps and units of time, 0 for all other names."""
    words = _words(_BRACKETS.sub("", name))
    has_unit = any(unit_named(each) for each in _BRACKETS.findall(name))
    if words[-1:] and (words[-1] in _UNIT_OF or words[-1] in _DOUBTFUL) and len(name) > len("ms"):
        has_unit |= not words[1:] and words[-1] not in _DOUBTFUL
        words.pop()
    base = " ".join(words)
    if base in _TIME and name.strip() != "T":  # which may be a temperature
        return 2
    return int(has_unit or (base in _STAMPS and base != "day"))


def is_day(name: str) -> bool:
    """Whether a column may hold the day of times of day."""
    return name.strip().lower() in _DAYS


def counts_frames(name: str) -> bool:
    """Whether a column is named as one that counts frames or samples."""
    return "".join(_words(name)[:1]) in _FRAMES


def _words(name: str) -> list[str]:
    return re.findall(r"[^\W_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())


def ns_of_date(text: str) -> int | None:
    """Nanoseconds from 1970 to a date with or without a time, in UTC unless a zone is named."""
    match = _DATE.fullmatch(text.strip())
    if match is None:
        return None
    y, m, d, d_of_dmy, m_of_dmy, y_of_dmy, clock, zone = match.groups()
    since_midnight = _ns_of_clock(clock or "0:00")
    try:
        day = date(int(y or y_of_dmy), int(m or m_of_dmy), int(d or d_of_dmy)).toordinal()
    except ValueError:
        return None
    east = 0
    if zone and zone[0] in "+-":
        east = int(zone[0] + "1") * (int(zone[1:3]) * 60 + int(zone[-2:])) * UNITS["min"]
    days = (day - date(1970, 1, 1).toordinal()) * 24 * UNITS["h"]
    return None if since_midnight is None else days + since_midnight - east


def ns_of_clock(text: str) -> int | None:
    """Nanoseconds of ``h:mm:ss`` with any number of decimals; None for another text."""
    return _ns_of_clock(text) if text.count(":") > 1 else None


def _ns_of_clock(text: str) -> int | None:
    match = _CLOCK.fullmatch(text.strip())
    if match is None:
        return None
    hours, minutes, seconds, part = match.groups("0")
    whole = int(hours) * UNITS["h"] + int(minutes) * UNITS["min"] + int(seconds) * NS_PER_S
    return whole + round(Decimal(f"0.{part}") * NS_PER_S)


def ns_of_numbers(cells: Sequence[str], values: Vector, unit: Fraction) -> Stamps:
    """Times in a unit (ns), each rounded to the nanosecond once; NO_TIME where there is none.

    Args:
        cells: decimals, with a point.
        values: the same as floats, which say where there is a number that is not too large.
        unit: ns.
    """
    times = np.full(len(cells), NO_TIME, dtype=np.int64)
    fits = np.flatnonzero(np.abs(values) <= MAX_STAMP / float(unit))  # no NaN does
    scale, divisor = Decimal(unit.numerator), unit.denominator
    times[fits] = [round(Decimal(cells[k]) * scale / divisor) for k in fits.tolist()]
    return times
