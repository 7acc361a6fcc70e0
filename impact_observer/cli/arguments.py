# SPDX-License-Identifier: Apache-2.0
"""Arguments that several subcommands share; an unusable value is an error of one line."""

import argparse
import math
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import fields
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from impact_observer.errors import UsageError
from impact_observer.options import OBSERVER_OPTIONS, Option, Options, Value

if TYPE_CHECKING:
    from impact_observer.io.tables import TableForm

_ELSEWHERE = ("law", "history", "ensemble")
"""Options that subcommands replace by own arguments, or that are of no use with a bag."""
_T = TypeVar("_T")
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

    def allows(value: Value) -> bool:
        option.check(value)
        return True

    if option.unit == "ns":
        return argument(_nanoseconds, allows, f"{_limits(option)} s")
    return argument(partial(parsed, option), allows, option.expected)


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
    readers: dict[str, Callable[[str], Value]]
    readers = {"string[]": names, "string": str, "int": _whole, "double": float}
    return readers[option.type](text)


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


def _whole(text: str) -> int:
    """Digits alone, not too many."""
    if not (text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS):
        raise ValueError(text)
    return int(text)


def _nanoseconds(text: str) -> int:
    """Seconds with up to nine exact decimals, in ns."""
    whole, _, part = text.partition(".")
    if len(part) > _DECIMALS:
        raise ValueError(text)
    return _whole(whole) * 1_000_000_000 + _whole(part.ljust(_DECIMALS, "0"))


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


def argument(
    read: Callable[[str], _T], allows: Callable[[_T], bool], expected: str
) -> Callable[[str], _T]:
    """An argparse type: of what ``read`` makes, the values that it ``allows``."""

    def value(text: str) -> _T:
        with suppress(ValueError, ZeroDivisionError):
            if allows(found := read(text)):
                return found
        raise argparse.ArgumentTypeError(f"{text} found; expected {expected}")

    return value


number = argument(float, math.isfinite, "a number")
positive = argument(float, lambda x: 0 < x < math.inf, "a number above 0")
not_negative = argument(float, lambda x: 0 <= x < math.inf, "a number, 0 or more")
count = argument(_whole, lambda n: n > 0, "a whole number, 1 or more")
seed = argument(_whole, lambda n: n >= 0, "a whole number, 0 or more")
rate = argument(Fraction, lambda hertz: hertz > 0, "a number of Hz above 0")
names = argument(_names, all, "NAME,NAME,...")
stamp = argument(_nanoseconds, lambda ns: ns > 0, "seconds above zero, with nine decimals at most")
stamp_or_zero = argument(_nanoseconds, lambda ns: ns >= 0, "seconds, with nine decimals at most")

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
    "file": {"metavar": "FILE", "type": Path, "required": True, "help": "the file to make"},
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
_OUTPUT = ("-o", "--output")
_FLAGS = {"bag": ("bag",), "rig": ("model",), "output": _OUTPUT, "file": _OUTPUT}
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
