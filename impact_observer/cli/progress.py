"""A line at the bottom of the terminal that is written over, and lines that stay."""

import shutil
import sys
from types import TracebackType
from typing import TextIO, final

_CLEAR = "\r\x1b[K"


@final
class Progress:
    """Shows how far a command is; a context manager.

    On anything but a terminal only the lines that stay are written.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        """Write to ``stream``; None for standard output."""
        self._stream = stream or sys.stdout
        self._lively = self._stream.isatty()

    def __enter__(self) -> "Progress":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.show("")

    def show(self, text: str) -> None:
        """Write ``text`` over the line at the bottom."""
        if self._lively:
            width = shutil.get_terminal_size().columns - 1  # a longer line would not be one
            print(f"{_CLEAR}{text[:width]}", end="", file=self._stream, flush=True)

    def line(self, text: str) -> None:
        """Write a line that stays."""
        print(f"{_CLEAR if self._lively else ''}{text}", file=self._stream, flush=True)
