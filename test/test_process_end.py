# SPDX-License-Identifier: Apache-2.0
"""Signals are noted or raised once; whatever ends a process is one line."""

import errno
import os
import signal
import subprocess
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_observer.errors import ImpactObserverError, ModelError, UsageError
from impact_observer.plain_text import printable
from impact_observer.process_end import TRACEBACK, Interrupt, Stop, ends_within, one_line, run

LATE = """
import signal, time
from impact_observer.process_end import run
def job():
    try:
        print("begun", flush=True)
        time.sleep(60)
    finally:
        print("ending", flush=True)
        for _ in range(600):
            time.sleep(0.1)
raise SystemExit(run("job", job))
"""
BUSY = """
from impact_observer.process_end import Stop, ends_within
with Stop(), ends_within(0.2):
    print("begun", flush=True)
    while True:
        pass
"""


def test_the_first_signal_is_noted_and_the_second_raises() -> None:
    """So that a user who is in a hurry presses Ctrl-C twice."""
    with Stop() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        assert stop.number == signal.SIGINT


def test_a_second_signal_ends_a_command_at_once_without_a_traceback() -> None:
    """The first ends the command in order."""
    with subprocess.Popen(
        [sys.executable, "-c", LATE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "ending\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=90)
        assert (process.returncode, errors) == (-signal.SIGINT, "")


def test_work_that_goes_on_after_a_signal_is_ended() -> None:
    """The exit code is that of the signal."""
    with subprocess.Popen(
        [sys.executable, "-c", BUSY], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=90)
        assert process.returncode == 128 + signal.SIGTERM
        assert "work unfinished" in errors


def test_a_process_that_ends_in_order_is_left_alone() -> None:
    """Nothing ends the process later, and later signals have their effects again."""
    with Stop() as stop, ends_within(0.05):
        signal.raise_signal(signal.SIGTERM)
        assert stop.requested
    time.sleep(0.1)


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (UsageError("a: wrong"), 2, "a: wrong"),
        (ModelError("mass", "is\x1b[31m odd"), 2, "mass: is\\x1b[31m odd"),
        (ImpactObserverError("two\nlines"), 1, "two lines"),
        (
            OSError(errno.ENAMETOOLONG, "File name too long", "x\ny"),
            2,
            "x\\ny: File name too long",
        ),
        (
            MemoryError("72 TiB"),
            1,
            "not enough memory: 72 TiB; use a smaller model, or shorter data",
        ),
        (MemoryError(), 1, "not enough memory; use a smaller model, or shorter data"),
        (Interrupt(signal.SIGINT, "x holds it"), 1, "interrupted; x holds it"),
        (Interrupt(signal.SIGTERM), 143, "ended by SIGTERM"),
        (KeyboardInterrupt(), 1, "interrupted"),
    ],
)
def test_an_error_is_one_line_and_an_exit_code(
    error: BaseException, code: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a user can mend says how; control characters are escaped."""

    def job() -> int:
        raise error

    assert run("program", job, own=False) == code
    assert capsys.readouterr().err == f"program: {line}\n"


def test_an_unforeseen_error_names_its_place_and_asks_for_a_report(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line; all of it with IMPACT_OBSERVER_TRACEBACK."""

    def job() -> int:
        printable(None)  # type: ignore[arg-type]
        return 0

    assert run("program", job, own=False) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        "program: unforeseen AttributeError in impact_observer/plain_text.py, line "
    )
    assert line.endswith(f"; please report it, with what {TRACEBACK}=1 shows")
    monkeypatch.setenv(TRACEBACK, "1")
    assert run("program", job, own=False) == 1
    assert "Traceback (most recent call last)" in capsys.readouterr().err


def test_a_reader_that_is_gone_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of ``impact-observer check BAG | head``."""
    replaced: list[int] = []
    monkeypatch.setattr(os, "dup2", lambda _, target: replaced.append(target))
    monkeypatch.setattr(sys, "stdout", sys.__stdout__)

    def job() -> int:
        raise BrokenPipeError

    assert run("program", job, own=False) == 1
    assert len(replaced) == 1


@given(st.text())
def test_printable_text_cannot_control_a_terminal(text: str) -> None:
    """No control character is left, and what has none is unchanged."""
    shown = printable(text)
    assert not any(ord(each) < 32 or 127 <= ord(each) < 160 for each in shown)
    assert len(shown.splitlines()) <= 1
    if text.isascii() and text.isprintable():
        assert shown == text
    assert one_line(UsageError(text)) == printable(" ".join(text.split()))
