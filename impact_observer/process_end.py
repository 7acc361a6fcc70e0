# SPDX-License-Identifier: Apache-2.0
"""How a process ends: in order after a signal, in one line after an error.

All commands and nodes run inside :func:`run`. A signal raises ``Interrupt`` once, so that the
``with`` and ``finally`` blocks of a command finish their work.
"""

import ctypes
import errno
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import final

from impact_observer.errors import ImpactObserverError
from impact_observer.input_files import shortened
from impact_observer.plain_text import printable, say

TRACEBACK = "IMPACT_OBSERVER_TRACEBACK"
"""Environment variable: if set, errors show their traceback too."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_OF_THE_NAME = {errno.ENAMETOOLONG, errno.ELOOP}
"""Errors of the system that are wrong use: no file can have such a name."""
_PR_SET_PDEATHSIG = 1
_PACKAGE = Path(__file__).resolve().parent


class Interrupt(KeyboardInterrupt):
    """A signal ends what is being done.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int, done: str = "") -> None:
        """By the signal ``number``; the line of the process ends with what was ``done``."""
        how = "interrupted" if number == signal.SIGINT else f"ended by {_name(number)}"
        super().__init__(f"{how}; {done}" if done else how)
        self.number = number


@final
class Stop:
    """Whether SIGINT (Ctrl-C), SIGTERM or SIGHUP has asked the process to end; a context manager.

    The first signal is noted, the second one raises ``Interrupt``. Outside the main thread, which
    receives signals, a block does nothing.

    Attributes:
        number: the signal that has come; 0 for none.
    """

    def __init__(self) -> None:
        """No signal has come."""
        self.number = 0
        self._handling = ExitStack()

    @property
    def requested(self) -> bool:
        """Whether a signal has come."""
        return self.number != 0

    def __enter__(self) -> "Stop":
        self._handling.enter_context(_handled_by(self._note))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._handling.close()

    def _note(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.number:
            _interrupt(number, frame)
        self.number = number


def _interrupt(number: int, _: FrameType | None) -> None:
    """Handle a signal: raise ``Interrupt``, once; the next signal ends the process."""
    for each in _SIGNALS:
        signal.signal(each, signal.SIG_DFL)
    raise Interrupt(number)


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Within the block, signals have a ``handler``; SIGHUP not where it is ignored (nohup)."""
    previous: dict[signal.Signals, signal._HANDLER] = {}
    if threading.current_thread() is threading.main_thread():
        for each in _SIGNALS:
            if each != signal.SIGHUP or signal.getsignal(each) is not signal.SIG_IGN:
                previous[each] = signal.signal(each, handler)
    try:
        yield
    finally:
        for each, before in previous.items():
            signal.signal(each, before)


def _name(number: int) -> str:
    """The name of a signal."""
    return signal.Signals(number).name


@contextmanager
def ends_within(seconds: float) -> Iterator[None]:
    """Within the block, end the process some ``seconds`` after a signal, whatever is being done.

    A thread waits for the signal and ends the process, with 128 and the number of the signal as
    exit code, unless one call into C holds the interpreter.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    read, write = os.pipe()
    os.set_blocking(write, False)
    is_over = threading.Event()

    def watch() -> None:
        if (received := os.read(read, 1)) and not is_over.wait(seconds):
            os.write(2, b"ended %g s after a signal, with work unfinished\n" % seconds)
            os._exit(128 + received[0])
        os.close(read)

    previous = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        is_over.set()
        signal.set_wakeup_fd(previous)
        os.close(write)


def run(program: str, job: Callable[[], int], *, own: bool = True) -> int:
    """Run ``job``; an error becomes one line on standard error and an exit code.

    Args:
        program: begin of the line.
        job: returns an exit code.
        own: whether the process ends after ``job``; signals then have their default effect.

    Returns:
        The exit code of ``job``; 2 for wrong use; 1 for another error, and after Ctrl-C; 128 and
        the number of another signal: 143 after SIGTERM.
    """
    with _handled_by(_interrupt):
        try:
            code = job()
        except SystemExit:
            raise
        except BaseException as error:  # noqa: BLE001 (every error is reported here)
            code = _report(program, error)
    if own and threading.current_thread() is threading.main_thread():
        for each in _SIGNALS:  # Python's own handler would show a traceback
            signal.signal(each, signal.SIG_DFL)
    return code


def end_with_parent(parent: int) -> None:
    """Have Linux send SIGTERM when the process ``parent`` ends.

    A process that is no child of ``parent`` gets no signal.
    """
    if parent == os.getppid():
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def one_line(error: BaseException) -> str:
    """An error in one line, without control characters.

    Errors of the package say what to do. The line of another error has the place in the package
    and asks for a report, or has the place in a user's own class, such as a law.
    """
    words = printable(" ".join(str(error).split()))
    if isinstance(error, ImpactObserverError):
        return words
    if isinstance(error, MemoryError):
        return f"not enough memory{words and f': {words}'}; use a smaller model, or shorter data"
    if isinstance(error, OSError) and error.strerror:
        return f"{printable(shortened(Path(error.filename or 'files')))}: {error.strerror}"
    kind, words = type(error).__name__, words and f": {words}"
    if (extension := _extension(error)) is not None:
        place = place_in(_root(extension), error) or f" after {extension.__qualname__}"
        return f"{kind}{place}{words}; {TRACEBACK}=1 shows all of it"
    place = place_in(_PACKAGE.name, error)
    return f"unforeseen {kind}{place}{words}; please report it, with what {TRACEBACK}=1 shows"


def place_in(package: str, error: BaseException) -> str:
    """The innermost line of a ``package`` in the traceback of an ``error``; empty if none.

    The text is such as `` in my_laws/law.py, line 3``, and begins with a space.
    """
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        if frame.f_globals.get("__name__", "").partition(".")[0] == package:
            path = Path(frame.f_code.co_filename).resolve()
            inside = path.is_relative_to(_PACKAGE)
            return f" in {path.relative_to(_PACKAGE.parent) if inside else path}, line {line}"
    return ""


def _root(cls: type) -> str:
    """The package or module at the top of the one that defines a class."""
    return cls.__module__.partition(".")[0]


def _extension(error: BaseException) -> type | None:
    """A user's class, derived from one of the package, whose method has raised the ``error``."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        cls = type(frame.f_locals.get("self"))
        if _root(cls) != _PACKAGE.name in map(_root, cls.__mro__):
            return cls
    return None


def _report(program: str, error: BaseException) -> int:
    """Write why a process ends, and return the exit code."""
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    if isinstance(error, BrokenPipeError):
        # The reader of our output has closed the pipe; Python would report the error at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    if isinstance(error, KeyboardInterrupt):
        error = error if isinstance(error, Interrupt) else Interrupt(signal.SIGINT)
        _say(f"{program}: {printable(str(error))}")
        return 1 if error.number == signal.SIGINT else 128 + error.number
    _say(f"{program}: {one_line(error)}")
    if isinstance(error, ImpactObserverError):
        return error.exit_code
    return 2 if isinstance(error, OSError) and error.errno in _OF_THE_NAME else 1


def _say(line: str) -> None:
    """Write a line to standard error, unless the stream is closed."""
    with suppress(OSError, ValueError):
        if sys.stderr is not None:
            say(line, file=sys.stderr)
