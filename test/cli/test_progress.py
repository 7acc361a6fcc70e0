# SPDX-License-Identifier: Apache-2.0
"""Progress of a command: on a terminal, and elsewhere."""

import os
import pty
import re
import subprocess
import sys
import time

import numpy as np
import pytest

from impact_observer.cli.progress import Progress

SCRIPT = """
import time
from impact_observer.cli.progress import Progress

with Progress() as progress:
    begin = time.monotonic()
    progress.line("a line [first]")
    while (passed := time.monotonic() - begin) < 0.5:
        progress.step("bag [of]\\x1b a rig", passed, 1.0)
        time.sleep(0.001)
    progress.line("a line that stays")
    progress.show("writing")
    time.sleep(0.15)
    {end}
"""
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def on_terminal(script: str, **variables: str) -> tuple[int, str]:
    """The exit code of a script on a terminal, and everything that the script writes there."""
    main, side = pty.openpty()
    environment = {**os.environ, "COLUMNS": "100", "TERM": "xterm", **variables}
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
    """The written lines, without colours and cursor movements."""
    return [line.rstrip() for line in re.split(r"[\r\n]+", CONTROL.sub("\r", written))]


def test_a_terminal_shows_the_share_of_the_work_done_below_the_lines() -> None:
    """Permanent lines stay above the bar, and names are printed literally."""
    code, written = on_terminal(SCRIPT.format(end=""))
    assert code == 0
    assert re.search(r"bag \[of\]\\x1b a rig .* \d+%", CONTROL.sub("", written))
    assert any(line.startswith("writing") for line in lines(written))
    assert "a line [first]" in lines(written)
    assert "a line that stays" in lines(written)


def test_an_error_removes_the_bar() -> None:
    """The error begins on an empty line, and the cursor is visible again."""
    code, written = on_terminal(SCRIPT.format(end="raise SystemExit('broken')"))
    assert code == 1
    assert [line for line in lines(written) if line][-1] == "broken"
    assert written.rfind("\x1b[?25h") > written.rfind("\x1b[?25l")


@pytest.mark.parametrize("forced", ["FORCE_COLOR", "TTY_COMPATIBLE"])
def test_a_file_gets_the_lines_only(forced: str) -> None:
    """Standard error has no bar unless it is a terminal, though colours are asked for."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(end="")],
        env=os.environ | {forced: "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "a line [first]\na line that stays\n"
    assert done.stderr == ""


def test_a_file_gets_a_line_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A minute of work in a tenth of a second steps: the share, on standard error alone."""
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with Progress() as progress:
        for k in range(601):
            now = k / 10
            progress.step("a bag", now, 60.0)
    said = capsys.readouterr()
    assert said.err.splitlines() == [f"a bag: {share:.0%}" for share in np.arange(1, 7) / 6]
    assert said.out == ""
