# SPDX-License-Identifier: Apache-2.0
"""Single keys from a terminal, whose settings are restored."""

import os
import re
import select
import signal
import sys
import termios
import threading
import tty
from types import FrameType, TracebackType
from typing import Any, TextIO, final

_KEY = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.DOTALL)
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_SIGNALS = (signal.SIGTSTP, signal.SIGQUIT, signal.SIGHUP)
"""Signals that stop or end the command while the terminal is changed."""


def keys_in(text: str) -> list[str]:
    """The keys in the characters of a terminal: arrows are ``up``, ``right``, ...

    Other keys of several characters are omitted.
    """
    found = _KEY.findall(text)
    names = [key if len(key) == 1 else _ARROWS.get(key[-1]) for key in found]
    return [name for name in names if name]


@final
class Keyboard:
    """Reads keys as they are pressed, without echo; a context manager.

    Without a terminal, or in the background, there are no keys. Ctrl-C stays a signal. Signals
    that stop or end the process restore the terminal first.

    Attributes:
        available: whether keys can be read; valid within the block.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        """Read from ``stream``; None for standard input."""
        self.available = False
        self._stream = stream or sys.stdin
        self._saved: list[Any] = []
        self._file = -1
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> "Keyboard":
        try:
            self._file = self._stream.fileno()
            self._saved = termios.tcgetattr(self._file)
        except (OSError, ValueError, termios.error):  # closed, or no terminal
            return self
        if threading.current_thread() is threading.main_thread():
            for each in _SIGNALS:
                if signal.getsignal(each) is signal.SIG_DFL:
                    self._handlers[each] = signal.signal(each, self._on_signal)
        self._take()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._restore()
        for each, handler in self._handlers.items():
            signal.signal(each, handler)
        self._handlers.clear()

    def pressed(self) -> list[str]:
        """The keys since the last call, as :func:`keys_in` names them."""
        if not (
            self.available
            and self._in_foreground()
            and select.select([self._file], [], [], 0.0)[0]
        ):
            return []
        if not (data := os.read(self._file, 64)):
            self.available = False  # the terminal is gone
        return keys_in(data.decode(errors="ignore"))

    def _in_foreground(self) -> bool:
        """Whether this process is in the foreground; otherwise changing the terminal stops it."""
        try:
            return os.tcgetpgrp(self._file) == os.getpgrp()
        except OSError:
            return False

    def _take(self) -> None:
        """Have keys delivered without a line's end, and without echo."""
        if self._in_foreground():
            tty.setcbreak(self._file, termios.TCSANOW)
            self.available = True

    def _restore(self) -> None:
        """Restore the terminal's settings."""
        if self.available and self._in_foreground():
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._saved)
        self.available = False

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        """Restore the terminal and apply the signal's default; take keys again after a stop."""
        self._restore()
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(signal.Signals(number))
        signal.signal(number, self._on_signal)
        self._take()
