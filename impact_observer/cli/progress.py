# SPDX-License-Identifier: Apache-2.0
"""Progress of a command: a bar on standard error where that is a terminal, else a few lines."""

import sys
import time
from collections.abc import Iterable
from itertools import islice
from typing import final

from rich.console import Console
from rich.progress import (
    BarColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichProgress

from impact_observer.plain_text import printable, say

_PERIOD = 0.1
"""Least time between two updates of the bar, s: a tight loop may call more often."""
_MOST_WARNINGS = 3
_LINES = 10.0
"""Time between two lines where standard error is no terminal, s."""


@final
class Progress:
    """Shows how far a command is; a context manager. The bar disappears at the end."""

    def __init__(self) -> None:
        """Show nothing before the first call."""
        self._bar = RichProgress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=sys.stdout.isatty(),
        )
        self._task: TaskID | None = None
        self._shown = ""
        self._next = 0.0
        self._next_line = time.monotonic() + _LINES

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        if self._task is not None:
            self._bar.stop()

    def step(self, what: str, done: float, total: float) -> None:
        """Show a bar with the share of the work done and the remaining time.

        Args:
            what: description; a new text starts a new bar.
            done: of ``total``, in the same unit.
            total: how much there is to do.
        """
        if (now := time.monotonic()) >= self._next:
            self._next = now + _PERIOD
            self._draw(what, done, total)

    def show(self, text: str) -> None:
        """Show ``text``, for work without a total."""
        self._draw(text, 0.0, None)

    def _draw(self, what: str, done: float, total: float | None) -> None:
        """Draw the bar; where standard error is no terminal, write a line now and then."""
        # FORCE_COLOR and TTY_COMPATIBLE make any file a terminal for rich.
        if not (sys.stderr.isatty() and self._bar.console.is_terminal):
            if (now := time.monotonic()) >= self._next_line:
                self._next_line = now + _LINES
                share = f": {done / total:.0%}" if total else ""
                sys.stderr.write(f"{printable(what)}{share}\n")
                sys.stderr.flush()
            return
        self._bar.start()
        if self._task is None or what != self._shown:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._task, self._shown = self._bar.add_task(printable(what), total=total), what
        self._bar.update(self._task, completed=done, total=total)

    @staticmethod
    def line(text: str) -> None:
        """Write a permanent line to standard output; control characters are escaped."""
        say(printable(text))

    def warn(self, lines: Iterable[str]) -> None:
        """Write the first three different lines as warnings."""
        for line in islice(dict.fromkeys(lines), _MOST_WARNINGS):
            self.line(f"warning: {line}")
