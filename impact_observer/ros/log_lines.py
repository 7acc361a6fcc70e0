# SPDX-License-Identifier: Apache-2.0
"""Lines of a node's log, so many at a time: a flood of messages is no flood of lines."""

import time
from collections import Counter

from rclpy.impl.rcutils_logger import RcutilsLogger

from impact_observer.plain_text import printable

_MOST = 20
"""Lines between two calls of ``restore``."""
_PAUSE = 10.0
"""How long a kind of line that was logged is counted only, s."""
_MOST_KINDS = 100
"""Kinds that are counted; contacts may be named by a stranger."""
_OTHERS = "other lines"
"""The kind of those for which there is no room."""


class LogLines:
    """Logs up to a number of lines, and then how many were left out.

    Lines of one kind, such as verdicts of chatter, are logged once in some seconds; then how many
    there were.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to ``logger``."""
        self._logger = logger
        self._count = 0
        self._begun: dict[str, float] = {}
        self._repeated = Counter[str]()

    def error(self, line: str) -> None:
        """Log an error."""
        if self._has_room():
            self._logger.error(printable(line))

    def warning(self, line: str, kind: str = "") -> None:
        """Log a warning, of a ``kind`` or none."""
        if self._is_new(kind) and self._has_room():
            self._logger.warning(printable(line))

    def info(self, line: str, kind: str = "") -> None:
        """Log what is usual, of a ``kind`` or none."""
        if self._is_new(kind) and self._has_room():
            self._logger.info(printable(line))

    def restore(self) -> None:
        """Begin to count again, as after a second; log how often a kind was repeated."""
        if self._count > _MOST:
            self._logger.warning(f"{self._count - _MOST} more lines are left out of this log")
        self._count = 0
        over = time.monotonic() - _PAUSE
        for kind in [each for each, begun in self._begun.items() if begun <= over]:
            del self._begun[kind]
            if more := self._repeated.pop(kind, 0):
                self.info(f"{kind}: {more} more in {_PAUSE:g} s")

    def _is_new(self, kind: str) -> bool:
        """Whether a line of a kind is to be logged."""
        if not kind:
            return True
        if kind not in self._begun and len(self._begun) >= _MOST_KINDS:
            kind = _OTHERS
        if kind in self._begun:
            self._repeated[kind] += 1
            return False
        self._begun[kind] = time.monotonic()
        return True

    def _has_room(self) -> bool:
        self._count += 1
        return self._count <= _MOST
