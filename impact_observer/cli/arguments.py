# SPDX-License-Identifier: Apache-2.0
"""Arguments that several subcommands share; an unusable value is an error of one line."""

import argparse
import math
from collections.abc import Callable, Collection
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from impact_observer.errors import UsageError
from impact_observer.options import OBSERVER_OPTIONS, Option, Options, Value

if TYPE_CHECKING:
    from impact_observer.io.tables import TableForm

_ELSEWHERE = ("law", "history", "ensemble")
"""Options that subcommands replace by own arguments, or that are of no use with a bag."""


_MOST_DIGITS, _DECIMALS = 18, 9
"""Digits of a whole number, and decimals of a stamp in seconds."""


def add_observer_arguments(
    parser: "argparse._ActionsContainer", names: Collection[str] = (), *, initial_state: str = ""
) -> None:
    """Add the rows of ``OBSERVER_OPTIONS`` as arguments; ``observer_options`` reads them.

    Args:
        parser: of the subcommand, or a group of it.
        names: of the rows; none for all that change an estimate.
        initial_state: what ``--help`` calls the default of the initial state, if not the row's.
    """
    defaults = {
        "clock_error": "-1: learned",
        "epoch": "as in the bag",
        "initial_state": initial_state,
    }
    for each in OBSERVER_OPTIONS:
        if each.name not in names if names else each.name in _ELSEWHERE:
            continue
        add_option(parser, each, default=defaults.get(each.name, ""))


def add_option(parser: "argparse._ActionsContainer", option: Option, *, default: str = "") -> None:
    """Add one option as an argument; the value of an option that is not given is None.

    Args:
        parser: of the subcommand, or a group of it.
        option: the row.
        default: what ``--help`` calls the default, if not the row's.
    """
    flag = option.long_flag
    if option.type == "bool":
        parser.add_argument(
            flag, dest=option.name, action="store_true", default=None, help=option.meaning
        )
        return
    unit = "s" if option.unit == "ns" else option.unit
    shown = option.default if option.default not in ("", ()) else "none"
    allowed = f", {_limits(option)}" if option.high is not None else ""
    parser.add_argument(
        *([flag, f"--{option.short}"] if option.short else [flag]),
        dest=option.name,
        metavar=metavar(option),
        type=value_of(option),
        help=f"{option.meaning}{unit and f' [{unit}]'}{allowed} (default {default or shown})",
    )


def metavar(option: Option) -> str:
    """The word for the value of an option in ``--help``: the unit in capitals, or P or N."""
    if option.metavar:
        return option.metavar
    units = {"1/s": "HZ", "ns": "S", "": "N" if option.type == "int" else "P"}
    return units.get(option.unit, option.unit.upper())


def _limits(option: Option) -> str:
    """The values allowed, in the unit of the command line."""
    if option.unit != "ns" or option.high is None:
        return option.limits
    whole, part = divmod(int(option.high), 10**_DECIMALS)
    return f"0 to {whole}.{part:0{_DECIMALS}d}"


def value_of(option: Option) -> Callable[[str], Value]:
    """The argparse type of an option, which reads a value and checks its range."""

    def value(text: str) -> Value:
        is_stamp = option.unit == "ns"
        try:
            if is_stamp:
                read: Value = 0 if text == "0" else stamp(text)
            else:
                read = parsed(option, text)
            option.check(read)
        except ValueError:
            expected = option.metavar if option.type == "string[]" else option.expected
            expected = f"{_limits(option)} s" if is_stamp else expected
            raise argparse.ArgumentTypeError(f"{text} found; expected {expected}") from None
        return read

    return value


def parsed(option: Option, text: str) -> Value:
    """The value in ``text``, of the option's type, not checked yet.

    Raises:
        ValueError: it is not of that type.
    """
    if option.type == "bool":
        words = {"true": True, "yes": True, "false": False, "no": False}
        if text.lower() not in words:
            raise ValueError(text)
        return words[text.lower()]
    if option.type == "string[]":
        return names(text)
    if option.type == "string":
        return text
    if option.type == "int" and not (text.isascii() and text.isdigit()):
        raise ValueError(text)
    return int(text) if option.type == "int" else float(text)


def observer_options(args: argparse.Namespace, law: str) -> Options:
    """The options of an observer with ``law`` that were given, and defaults."""
    rows = {each.name for each in OBSERVER_OPTIONS} - {"law"}
    given = {name: value for name, value in vars(args).items() if name in rows}
    return Options(law, **{name: value for name, value in given.items() if value is not None})


def installed_laws(text: str) -> tuple[str, ...]:
    """The names in ``LAW,LAW,...``, each once; all installed laws of linear models for ``all``.

    Raises:
        UsageError: no law is named, or a law is not installed.
    """
    from impact_observer.model import System
    from impact_observer.observer import law_named, law_names

    if not text:
        raise UsageError("laws: none named; expected LAW,LAW,... or all")
    if text == "all":
        return tuple(name for name in law_names() if System in law_named(name).takes)
    names = [name.strip() for name in text.split(",")]
    for name in names:
        law_named(name)
    return tuple(dict.fromkeys(names))


def table_form(args: argparse.Namespace) -> "TableForm":
    """The form of a table, as far as the command has options of it."""
    from impact_observer.io.tables import TableForm

    given = {each.name: getattr(args, each.name, None) for each in fields(TableForm)}
    return TableForm(**{name: value for name, value in given.items() if value is not None})


def positive(text: str) -> float:
    """A finite number above zero."""
    value = number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} found; expected a number above 0")
    return value


def rate(text: str) -> Fraction:
    """An exact number of Hz above zero, as a decimal or a fraction."""
    try:
        value = Fraction(text)
    except (ValueError, ZeroDivisionError):
        value = Fraction(0)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} found; expected a number of Hz above 0")
    return value


def stamp(text: str) -> int:
    """A stamp given in seconds, at least 1 ns, with up to nine exact decimals."""
    whole, _, part = text.partition(".")
    is_short = len(whole) <= _MOST_DIGITS and len(part) <= _DECIMALS
    if not (text.isascii() and whole.isdigit() and (part + "0").isdigit() and is_short):
        raise argparse.ArgumentTypeError(
            f"{text} found; expected seconds with at most nine decimals, such as 1.5"
        )
    nanoseconds = int(whole) * 1_000_000_000 + int(part.ljust(_DECIMALS, "0"))
    if nanoseconds == 0:
        raise argparse.ArgumentTypeError("0 found; stamps start above zero")
    return nanoseconds


def stamp_or_zero(text: str) -> int:
    """A stamp in seconds, or 0."""
    return 0 if text.strip("0.") == "" and "0" in text else stamp(text)


def not_negative(text: str) -> float:
    """A finite number, not below zero."""
    value = number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} found; expected a number, 0 or more")
    return value


def count(text: str) -> int:
    """A whole number above zero."""
    return _whole(text, 1)


def seed(text: str) -> int:
    """A whole number, not below zero."""
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    is_whole = text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS
    if not (is_whole and int(text) >= least):
        digits = f", of at most {_MOST_DIGITS} digits" if len(text) > _MOST_DIGITS else ""
        expected = f"a whole number, {least} or more{digits}"
        raise argparse.ArgumentTypeError(f"{text} found; expected {expected}")
    return int(text)


def names(text: str) -> tuple[str, ...]:
    """One or more names with commas between them."""
    listed = tuple(name.strip() for name in text.split(","))
    if not all(listed):
        raise argparse.ArgumentTypeError(f"{text!r} found; expected NAME,NAME,...")
    return listed


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} found; expected a number")
    return value


SHARED: dict[str, dict[str, Any]] = {
    "bag": {"metavar": "BAG", "type": Path, "help": "a bag's folder, or a bare file"},
    "rig": {"metavar": "MODEL", "help": "a model file, or a sample: two_mass, ..."},
    "model": {
        "metavar": "MODEL",
        "help": "a model file or a sample (default: the one in the bag)",
    },
    "measurements": {
        "metavar": "FILE",
        "help": "what sensors measure beside the impacts: a file or a sample",
    },
    "rate": {"metavar": "HZ", "type": positive, "help": "estimates, Hz (default: as the truth)"},
    "start": {
        "metavar": "S",
        "type": not_negative,
        "help": "beginning of the part that is read, s after the epoch, or without one after the"
        " first impact (default: from the beginning)",
    },
    "duration": {
        "metavar": "S",
        "type": positive,
        "help": "length of the part that is read, s (default: to the end)",
    },
    "epoch": {
        "metavar": "S",
        "type": stamp,
        "help": "stamp of t = 0 of the forcing (default: that of the file's time 0)",
    },
    "clock-error": {
        "metavar": "S",
        "type": number,
        "default": -1.0,
        "help": "standard deviation of the stamps, s; negative: estimated from them (default -1)",
    },
    "sources": {
        "metavar": "FILE",
        "type": Path,
        "help": "the sensors (docs/detector.md), and under `table` how a table is to be read",
    },
    "seed": {
        "metavar": "N",
        "type": seed,
        "default": 0,
        "help": "of all that is random (default 0)",
    },
    "topics": {"metavar": "TOPIC", "nargs": "+", "help": "these topics only (default: all)"},
    "output": {"metavar": "BAG", "type": Path, "required": True, "help": "the folder to make"},
    "plot": {"metavar": "FILE", "type": Path, "help": "a picture to make: PNG, SVG or PDF"},
    "json": {"action": "store_true", "help": "print the results as JSON"},
    "time-zero": {
        "metavar": "S",
        "type": stamp_or_zero,
        "help": "stamp of the file's time 0 (default: 1 s, or 0 for times since 1970)",
    },
    "time-column": {
        "metavar": "NAME",
        "help": "of the column of time (default: time, or one such as t, Timestamp (ms), seconds)",
    },
    "frame-rate": {
        "metavar": "HZ",
        "type": rate,
        "help": "makes times of a column of frames or samples, such as 240 or 30000/1001; without"
        " such a column and without times the rows of a signal are counted",
    },
    "time-unit": {
        "choices": ("s", "ms", "us", "ns", "min", "h"),
        "help": "of the times (default: that in the header, else s)",
    },
    "skip-rows": {
        "metavar": "N",
        "type": seed,
        "default": 0,
        "help": "lines at the beginning that are not read (default: those above the header)",
    },
    "sort": {"action": "store_true", "help": "the rows may be in any order"},
    "separator": {
        "choices": ("tab", "semicolon", "comma", "blank"),
        "help": "of columns (default: the one that makes most rows alike)",
    },
    "decimal": {
        "choices": ("point", "comma"),
        "help": "of numbers (default: either, but point where commas separate columns)",
    },
}
"""How ``add_argument`` adds the arguments that several commands have."""
_FLAGS = {"bag": ("bag",), "rig": ("model",), "output": ("-o", "--output")}
"""Flags of arguments that are not called by their names."""
PART = ("start", "duration")
"""The part of a bag that a command reads."""
TABLE = ("time-zero", "time-column", "frame-rate")
"""The form of a table, beside what files of sensors have under ``table``."""
UNUSUAL_TABLE = ("time-unit", "skip-rows", "sort", "separator", "decimal")


def add_shared(parser: "argparse._ActionsContainer", *names: str, **meanings: str) -> None:
    """Add arguments of ``SHARED`` by their names; ``meanings`` are other texts of ``--help``."""
    for name in names:
        flags = _FLAGS.get(name, (f"--{name}",))
        meaning = meanings.get(name.replace("-", "_"), SHARED[name]["help"])
        parser.add_argument(*flags, **{**SHARED[name], "help": meaning})
