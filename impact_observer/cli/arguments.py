"""Types of command line arguments: a value that cannot be used is an error of one line."""

import argparse
import math


def positive(text: str) -> float:
    """A finite number above zero."""
    value = _number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} found; expected a number above 0")
    return value


def stamp(text: str) -> int:
    """A stamp given in seconds, at least 1 ns, with up to nine exact decimals."""
    whole, _, part = text.partition(".")
    if not (whole.isascii() and whole.isdigit() and (part + "0").isdigit() and len(part) <= 9):
        raise argparse.ArgumentTypeError(
            f"{text} found; expected seconds with at most nine decimals, such as 1.5"
        )
    nanoseconds = int(whole) * 1_000_000_000 + int(part.ljust(9, "0"))
    if nanoseconds == 0:
        raise argparse.ArgumentTypeError("0 found; stamps start above zero")
    return nanoseconds


def seed(text: str) -> int:
    """A whole number, not below zero."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"{text} found; expected a whole number, 0 or more")
    return int(text)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} found; expected a number")
    return value
