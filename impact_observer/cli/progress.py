"""Progress of a command: a bar at the bottom of the terminal, and permanent lines."""

import os
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, TextIO, final

from impact_observer.plain_text import printable, say

if TYPE_CHECKING:
    from impact_observer.cli.bars import Bars

_PERIOD = 0.1
"""Least time between two updates of the bar, s: a tight loop may call more often."""


@final
class Progress:
    """Shows how far a command is; a context manager.

    Work of less than half a second shows nothing. Without a terminal only permanent lines are
    written.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        """Write to ``stream``; None for standard output."""
        self._stream = stream or sys.stdout
        self._lively = self._stream.isatty() and os.environ.get("TERM") != "dumb"
        self._bars: Bars | None = None
        self._next = 0.0

    def __enter__(self) -> "Progress":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bars is not None:
            self._bars.stop()
            self._bars = None

    def step(self, what: str, done: float, total: float, unit: str = "") -> None:
        """Show a bar: the amount done, its share, the rate and the remaining time.

        Args:
            what: description; a new text starts a new bar.
            done: of ``total``, in the same unit.
            total: how much there is to do.
            unit: of both, ``s`` for simulated or recorded time; empty for a count.
        """
        if self._lively and (now := time.monotonic()) >= self._next:
            self._next = now + _PERIOD
            self._shown().step(printable(what), done, total, unit)

    def show(self, text: str) -> None:
        """Show ``text`` at the bottom, for work without a total."""
        if self._lively:
            self._shown().show(printable(text))

    def line(self, text: str) -> None:
        """Write a permanent line; control characters of names are escaped."""
        text = printable(text)
        if self._bars is None:
            say(text, file=self._stream)
        else:
            self._bars.line(text)

    def _shown(self) -> "Bars":
        """The bars, made at first use."""
        if self._bars is None:
            from impact_observer.cli.bars import Bars

            self._bars = Bars(self._stream)
            self._bars.start()
        return self._bars
