"""Single keys from a terminal, which is put back as it was."""

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
_ENDS = (signal.SIGTSTP, signal.SIGQUIT, signal.SIGHUP)
"""Signals that take the terminal away from the command without asking it."""


def keys_in(text: str) -> list[str]:
    """The keys in what a terminal sends: characters, and arrows as ``up``, ``right``, ...

    Other keys that are more than a character are left out.
    """
    found = _KEY.findall(text)
    return [key if len(key) == 1 else _ARROWS[key[-1]] for key in found if _known(key)]


def _known(key: str) -> bool:
    """Whether a key is a character or an arrow."""
    return len(key) == 1 or key[-1] in _ARROWS


@final
class Keyboard:
    """Reads keys as they are pressed, without echo; a context manager.

    Where the input is no terminal, or another program's, no key ever comes. Ctrl-C stays a
    signal; Ctrl-Z and the like find the terminal as it was.

    Attributes:
        there: whether keys can come; known within the block.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        """Read from ``stream``; None for standard input."""
        self.there = False
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
            for each in _ENDS:
                if signal.getsignal(each) is signal.SIG_DFL:
                    self._handlers[each] = signal.signal(each, self._leave)
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
        """The keys since the last call: characters, ``up``, ``down``, ``right``, ``left``."""
        if not (self.there and self._ours() and select.select([self._file], [], [], 0.0)[0]):
            return []
        if not (data := os.read(self._file, 64)):
            self.there = False  # the terminal is gone
        return keys_in(data.decode(errors="ignore"))

    def _ours(self) -> bool:
        """Whether the terminal is ours: from the background, touching it would stop us."""
        try:
            return os.tcgetpgrp(self._file) == os.getpgrp()
        except OSError:
            return False

    def _take(self) -> None:
        """Have keys come at once and unseen."""
        if self._ours():
            tty.setcbreak(self._file, termios.TCSANOW)
            self.there = True

    def _restore(self) -> None:
        """Leave the terminal as it was found."""
        if self.there and self._ours():
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._saved)
        self.there = False

    def _leave(self, number: int, _frame: FrameType | None) -> None:
        """Restore the terminal, and let the signal do what it does; if it was a stop, go on."""
        self._restore()
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(signal.Signals(number))
        signal.signal(number, self._leave)
        self._take()
