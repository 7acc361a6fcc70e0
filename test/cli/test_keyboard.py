# SPDX-License-Identifier: Apache-2.0
"""Single keys of a terminal, and the state of the terminal afterwards."""

import io
import os
import pty
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from impact_observer.cli.keyboard import Keyboard, keys_in

READ = """
import fcntl, sys, termios, time
from impact_observer.cli.keyboard import Keyboard

fcntl.ioctl(0, termios.TIOCSCTTY, 0)
with Keyboard() as keyboard:
    print("ready", keyboard.available, flush=True)
    while True:
        for key in keyboard.pressed():
            print("key", repr(key), flush=True)
            if key == "q":
                sys.exit(0)
            if key == "x":
                raise ValueError("broken")
        time.sleep(0.01)
"""
PATIENCE = 90.0


class Session:
    """A script on a terminal of its own."""

    def __init__(self) -> None:
        self.main, self.side = pty.openpty()
        self.before = termios.tcgetattr(self.side)
        self.output = ""
        self.process = subprocess.Popen(
            [sys.executable, "-c", READ],
            stdin=self.side,
            stdout=self.side,
            stderr=self.side,
            start_new_session=True,
        )

    def until(self, wanted: str) -> None:
        """Read until something is output."""
        latest = time.monotonic() + PATIENCE
        while wanted not in self.output:
            assert time.monotonic() < latest, self.output
            self.output += os.read(self.main, 4096).decode(errors="replace")

    def press(self, keys: bytes) -> None:
        """Type."""
        os.write(self.main, keys)

    def restored(self) -> bool:
        """Whether the terminal is as it was."""
        return bool(termios.tcgetattr(self.side) == self.before)


@contextmanager
def session() -> Iterator[Session]:
    """A session, killed at the end if it still runs."""
    running = Session()
    try:
        running.until("ready True")
        yield running
    finally:
        running.process.kill()
        running.process.wait()
        os.close(running.main)
        os.close(running.side)


@pytest.mark.parametrize(
    ("sent", "keys"),
    [
        ("q n", ["q", " ", "n"]),
        ("\x1b[A\x1b[B\x1b[C\x1b[D", ["up", "down", "right", "left"]),
        ("\x1bOA\x1b[1;5C", ["up", "right"]),
        ("a\x1b[5~b\x1bOPc", ["a", "b", "c"]),
        ("\x1b", ["\x1b"]),
        ("ä状", ["ä", "状"]),
        ("", []),
    ],
)
def test_arrows_have_names_and_other_long_keys_none(sent: str, keys: list[str]) -> None:
    """As terminals of both kinds send them."""
    assert keys_in(sent) == keys


def test_keys_are_read_at_once_without_echo() -> None:
    """No line end is needed; afterwards the terminal echoes again."""
    with session() as terminal:
        assert not terminal.restored()
        terminal.press(b"n\x1b[C")
        terminal.until("key 'right'")
        terminal.press(b"q")
        assert terminal.process.wait(PATIENCE) == 0
        assert terminal.restored()
        assert terminal.output.replace("\r", "").startswith("ready True\nkey 'n'\nkey 'right'")


def test_an_error_restores_the_terminal() -> None:
    """Before the error is printed."""
    with session() as terminal:
        terminal.press(b"x")
        assert terminal.process.wait(PATIENCE) == 1
        assert terminal.restored()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT, signal.SIGHUP])
def test_a_signal_restores_the_terminal(number: signal.Signals) -> None:
    """The process still ends by the signal."""
    with session() as terminal:
        terminal.process.send_signal(number)
        assert terminal.process.wait(PATIENCE) == -number
        assert terminal.restored()


def test_a_stopped_command_gives_the_terminal_back_and_takes_it_again() -> None:
    """As Ctrl-Z and fg do."""
    with session() as terminal:
        terminal.process.send_signal(signal.SIGTSTP)
        terminal.process.send_signal(signal.SIGCONT)
        terminal.press(b"n")
        terminal.until("key 'n'")
        terminal.press(b"q")
        assert terminal.process.wait(PATIENCE) == 0
        assert terminal.restored()


def test_without_a_terminal_no_key_comes() -> None:
    """From a pipe, a closed file or none."""
    read, write = os.pipe()
    with os.fdopen(read) as pipe, Keyboard(pipe) as keyboard:
        os.write(write, b"q")
        assert not keyboard.available
        assert keyboard.pressed() == []
    os.close(write)
    with Keyboard(io.StringIO("q")) as keyboard:
        assert keyboard.pressed() == []
