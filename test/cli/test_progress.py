# SPDX-License-Identifier: Apache-2.0
"""Progress of a command: on a terminal, and elsewhere."""

import io
import itertools
import os
import pty
import re
import subprocess
import sys
import time

import pytest

from impact_observer.cli.progress import Progress

WORK = """
import sys, time
from impact_observer.cli.progress import Progress

with Progress() as progress:
    begin = time.monotonic()
    progress.line("a line [first]")
    while (passed := time.monotonic() - begin) < {seconds}:
        progress.step("bag_of_a_rig_状態: observing", passed * 1000, {seconds} * 1000)
        time.sleep(0.001)
    progress.line("a line that stays")
    while time.monotonic() < begin + {seconds} + 0.2:
        progress.step("simulating", 12.0, 60.0, "s")
        time.sleep(0.01)
    progress.show("writing")
    time.sleep(0.15)
    {end}
"""
QUICK = """
from impact_observer.cli.progress import Progress

with Progress() as progress:
    for k in range(1000):
        progress.step("working", k, 1000)
    progress.line("done")
"""
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def on_terminal(script: str, columns: int, **variables: str) -> tuple[int, str]:
    """The exit code of a script on a terminal so wide, and all that it writes there."""
    main, side = pty.openpty()
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": "xterm", **variables}
    process = subprocess.Popen(
        [sys.executable, "-c", script], env=environment, stdin=side, stdout=side, stderr=side
    )
    os.close(side)
    written = b""
    try:
        while chunk := os.read(main, 65536):
            written += chunk
    except OSError:  # Linux: the other end is closed
        pass
    finally:
        os.close(main)
        process.wait()
    return process.returncode, written.decode()


def lines(written: str) -> list[str]:
    """Everything that was written on a line, without colours and cursor movements."""
    return [line.rstrip() for line in re.split(r"[\r\n]+", CONTROL.sub("\r", written))]


@pytest.mark.slow
@pytest.mark.parametrize("columns", [60, 160])
def test_bar_says_what_is_done_its_share_the_rate_and_the_time_left(columns: int) -> None:
    """Within one line of the terminal; and what stays, stays above it."""
    code, written = on_terminal(WORK.format(seconds=1.2, end=""), columns)
    assert code == 0
    shown = CONTROL.sub("", written)
    assert re.search(r"\d+/1200 +\d+%  (\d+|1(\.\d+)?k)/s  0:00:0\d", shown)
    assert re.search(r"simulating .*12\.0/60\.0 s +20%", shown)
    assert "writing" in shown
    if columns == 160:
        assert "bag_of_a_rig_状態: observing" in shown
    assert "a line [first]" in lines(written)
    assert "a line that stays" in lines(written)
    widest = max(len(line) for line in shown.replace("\r", "\n").split("\n"))
    assert widest <= columns


def test_quick_work_shows_nothing() -> None:
    """Work of half a second has no progress bar."""
    _, written = on_terminal(QUICK, 80)
    assert "working" not in written
    assert "done" in lines(written)


@pytest.mark.slow
def test_an_error_removes_the_bar() -> None:
    """The error begins on an empty line, and the cursor was never hidden."""
    code, written = on_terminal(WORK.format(seconds=0.6, end="raise SystemExit('broken')"), 80)
    assert code == 1
    assert lines(written)[-2:] == ["broken", ""] or lines(written)[-1] == "broken"
    assert "\x1b[?25l" not in written


@pytest.mark.slow
@pytest.mark.parametrize("terminal", [True, False])
def test_without_cursor_movement_only_lines_are_written(terminal: bool) -> None:
    """Into a file, and on a terminal that cannot move its cursor."""
    script = WORK.format(seconds=0.1, end="")
    if terminal:
        _, written = on_terminal(script, 80, TERM="dumb")
    else:
        written = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True
        ).stdout
    assert written.replace("\r", "") == "a line [first]\na line that stays\n"


def test_long_work_without_a_terminal_says_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After two seconds, and less and less often; on standard error."""
    seconds = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: next(seconds))
    with Progress() as progress:
        for k in range(100):
            progress.show(f"row {k}\x1b")
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.splitlines() == [f"row {k}\\x1b" for k in (1, 3, 7, 15, 31, 63)]


def test_a_tight_loop_is_not_slowed() -> None:
    """A call before the next update only reads the clock: a microsecond, ten are allowed."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    with Progress(stream) as progress:
        progress.step("working", 0, 100_000)
        begin = time.perf_counter()
        for k in range(100_000):
            progress.step("working", k, 100_000)
        took = time.perf_counter() - begin
    assert took < 1.0
