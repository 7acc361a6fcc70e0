# SPDX-License-Identifier: Apache-2.0
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
_SILENT = 2.0
"""Processor time after which a line without a terminal says how far the work is, s; the next one
comes after twice that, and so on."""


@final
class Progress:
    """Shows how far a command is; a context manager.

    Work of less than half a second shows nothing. Without a terminal permanent lines are written,
    and on standard error, now and then, how far long work is.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        """Write to ``stream``; None for standard output."""
        self._stream = stream or sys.stdout
        self._lively = self._stream.isatty() and os.environ.get("TERM") != "dumb"
        self._bars: Bars | None = None
        self._next = 0.0
        self._begun, self._silent = time.process_time(), _SILENT

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
        if (now := time.monotonic()) < self._next:
            return
        self._next = now + _PERIOD
        if self._lively:
            self._shown().step(printable(what), done, total, unit)
        else:
            self._say_now_and_then(f"{what}: {done:.4g} of {total:.4g} {unit}".rstrip())

    def show(self, text: str) -> None:
        """Show ``text`` at the bottom, for work without a total."""
        if self._lively:
            self._shown().show(printable(text))
        else:
            self._say_now_and_then(text)

    def _say_now_and_then(self, text: str) -> None:
        """Say how far long work is, where there is no terminal."""
        if time.process_time() - self._begun >= self._silent:
            self._silent *= 2
            say(printable(text), file=sys.stderr)

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
