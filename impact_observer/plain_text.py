# SPDX-License-Identifier: Apache-2.0
"""Text without control characters: names may come from a file or a node of a stranger."""

import sys
import unicodedata
from typing import TextIO

_CONTROL = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Categories of characters that control, direct or break a text and are not visible."""


def printable(text: str) -> str:
    """``text`` with its control characters escaped, so that it cannot control a terminal.

    Line ends and tabs are escaped too: the text stays one line.
    """
    if text.isprintable():
        return text
    return "".join(
        each.encode("unicode_escape").decode("ascii")
        if unicodedata.category(each) in _CONTROL
        else each
        for each in text
    )


def printable_lines(text: str) -> str:
    """``text`` with all control characters escaped but the ends of its lines."""
    return "\n".join(map(printable, text.split("\n")))


def part_left_out(count: int, total: int, what: str, why: str) -> str:
    """Words for what was not used, such as ``3 of 60 samples left out (5 %): not finite``."""
    return f"{count} of {total} {what} left out ({100 * count / total:.2g} %): {why}"


def say(text: str, *, file: TextIO | None = None) -> None:
    """Print lines, on standard output unless another ``file`` is given."""
    print(printable_lines(text), file=file or sys.stdout, flush=True)
