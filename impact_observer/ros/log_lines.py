# SPDX-License-Identifier: Apache-2.0
"""Lines of a node's log, each kind once in some seconds: a flood of messages floods no log."""

import re
import time
from collections import Counter

from rclpy.impl.rcutils_logger import RcutilsLogger

from impact_observer.plain_text import printable

_PAUSE = 10.0
"""How long further lines of a kind are counted and not logged, s."""
_MOST_KINDS = 20
"""Kinds of lines within the pause; strangers may name contacts."""
_OTHERS = "other lines"
"""The kind of the lines for which there is no room."""


class LogLines:
    """Logs the first line of each kind, and later the number of further lines."""

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to ``logger``."""
        self._logger = logger
        self._begun: dict[str, float] = {}
        self._repeated = Counter[str]()

    def error(self, line: str, kind: str = "") -> None:
        """Log an error; see ``warning``."""
        if self._is_new(line, kind):
            self._logger.error(printable(line))

    def warning(self, line: str, kind: str = "") -> None:
        """Log a warning.

        Args:
            line: what to log.
            kind: the kind of line; empty for the line itself without its numbers.
        """
        if self._is_new(line, kind):
            self._logger.warning(printable(line))

    def info(self, line: str, kind: str = "") -> None:
        """Log a usual event; see ``warning``."""
        if self._is_new(line, kind):
            self._logger.info(printable(line))

    def end_second(self) -> None:
        """Log how often a kind was repeated whose pause is over; to be called every second."""
        over = time.monotonic() - _PAUSE
        for kind in [each for each, begun in self._begun.items() if begun <= over]:
            del self._begun[kind]
            if more := self._repeated.pop(kind, 0):
                self._logger.info(printable(f"{kind}: {more} more in {_PAUSE:g} s"))

    def _is_new(self, line: str, kind: str) -> bool:
        """Whether no line of this kind was logged within the pause."""
        kind = kind or without_numbers(line)
        if kind not in self._begun and len(self._begun) >= _MOST_KINDS:
            kind = _OTHERS
        if kind in self._begun:
            self._repeated[kind] += 1
            return False
        self._begun[kind] = time.monotonic()
        return True


def without_numbers(line: str) -> str:
    """The line with N for each number."""
    return re.sub(r"-?\d+(\.\d+)?(e[+-]?\d+)?", "N", line)
