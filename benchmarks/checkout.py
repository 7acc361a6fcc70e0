# SPDX-License-Identifier: Apache-2.0
"""Rows of benchmarks, measured on a checkout by its commands.

A row runs ``.venv/bin/impact-observer`` of a checkout, so an older checkout can be measured beside
this one.
"""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parents[1]
_SHOWN = 300
"""Most letters of an error that is shown."""


class FailedError(Exception):
    """A command of a checkout failed; the message has its last line."""


class Done(NamedTuple):
    """What a command did.

    Attributes:
        output: standard output and errors.
        seconds: processor time of the command and the processes that it started, s.
    """

    output: str
    seconds: float


class Checkout:
    """A folder with the package and its ``.venv``."""

    def __init__(self, folder: Path) -> None:
        """Check that ``folder`` has the command.

        Raises:
            FailedError: it has none.
        """
        self.folder = folder.resolve()
        self.scripts = self.folder / ".venv" / "bin"
        if not (self.scripts / "impact-observer").exists():
            raise FailedError(f"{folder}: no .venv found; run ./dev setup there")

    @property
    def environment(self) -> dict[str, str]:
        """Of its processes: one thread for small matrices, and no package of this process."""
        return {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ""}

    def run(self, folder: Path, *words: object) -> Done:
        """Run a command in ``folder``.

        Raises:
            FailedError: its exit code is not 0.
        """
        command = [str(self.scripts / "impact-observer"), *map(str, words)]
        log = folder / "output.txt"
        with log.open("w", encoding="utf-8") as file:
            process = subprocess.Popen(
                command,
                cwd=folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output = log.read_text("utf-8", errors="replace")
        if process.returncode:
            last = (output.strip().splitlines() or [""])[-1]
            raise FailedError(f"{' '.join(command[1:])}: {last[-_SHOWN:]}")
        return Done(output, used.ru_utime + used.ru_stime)


class Figure(NamedTuple):
    """A measured number with its unit; empty for a ratio."""

    value: float
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.value:.3g} {self.unit}".rstrip()


Figures = dict[str, Figure]
"""Figures by their names."""


class Row(NamedTuple):
    """A benchmark.

    Attributes:
        name: on the command line.
        question: that it answers, one line.
        measure: makes the figures of a round of a checkout in an empty folder; rounds have numbers
            from 0, which are the seeds.
    """

    name: str
    question: str
    measure: Callable[[Checkout, Path, int], Figures]
