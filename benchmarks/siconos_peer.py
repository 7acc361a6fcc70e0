# SPDX-License-Identifier: Apache-2.0
"""Siconos' event-driven scheme as a peer: LSODAR, Newton's impact law, an event at every sample.

Siconos (Acary, Bonnefon, Bremond, Huber, Perignon and Sinclair, INRIA technical report 340) gives
states on a grid only if each stamp is an event. Imports, compilation and building the model are
not timed. A process waits for commands; what is timed is one command, the simulation and one
answer.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_HEADERS = Path("/usr/include/siconos")
_SOURCES = Path(__file__).parent
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class AbsentError(Exception):
    """Siconos, or a tool that it needs, is not installed."""


class Siconos:
    """A process that simulates one problem at each command."""

    def __init__(self, command: list[str]) -> None:
        """Start it and wait until its model is built."""
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            env=os.environ | _ONE_THREAD,
        )
        self._wait_for("ready")

    def run(self, _: Path) -> None:
        """Simulate; a ``Job``."""
        self._command("run", "done")

    def found(self, folder: Path) -> tuple[list[float], Array]:
        """Impact times of the last run, s, and its samples (t, q, u), shape (samples, 1 + 2n)."""
        path = folder / "siconos.txt"
        self._command(f"save {path}", "saved")
        first, _, rest = path.read_text("utf-8").partition("\n")
        samples = [[float(value) for value in row.split()] for row in rest.splitlines()]
        return [float(t) for t in first.split()], np.array(samples)

    def _command(self, command: str, answer: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        self._wait_for(answer)

    def _wait_for(self, answer: str) -> None:
        """Wait for an answer; Siconos prints other lines, too."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.strip() == answer:
                return
        raise AbsentError(f"Siconos ended with exit code {self._process.wait()}")


def start(problem: Mapping[str, Any], folder: Path) -> tuple[dict[str, Siconos], dict[str, str]]:
    """The peers that can be started, and why the others cannot, by name.

    Args:
        problem: as for ``test/siconos_runs.py``, with one contact and one cosine, a
            ``tolerance`` and a ``step``, s.
        folder: for the problem's files and the compiled program.
    """
    peers = {
        "Siconos, C++": _started(_compiled, problem, folder),
        "Siconos, Python": _started(_interpreted, problem, folder),
    }
    started = {name: each for name, each in peers.items() if isinstance(each, Siconos)}
    absent = {name: each for name, each in peers.items() if isinstance(each, str)}
    return started, absent


def _started(
    command: Callable[[Mapping[str, Any], Path], list[str]],
    problem: Mapping[str, Any],
    folder: Path,
) -> Siconos | str:
    """A peer, or why there is none."""
    try:
        return Siconos(command(problem, folder))
    except AbsentError as error:
        return str(error)


def _compiled(problem: Mapping[str, Any], folder: Path) -> list[str]:
    """The command of the program in C++, compiled into ``folder``."""
    compiler = shutil.which("g++")
    if compiler is None or not (_HEADERS / "kernel" / "SiconosKernel.hpp").exists():
        raise AbsentError("no g++ or no headers: apt install g++ libsiconos-kernel-dev")
    program, given = folder / "siconos_plant", folder / "problem.txt"
    folders = [_HEADERS, *(each for each in _HEADERS.rglob("*") if each.is_dir())]
    command = [compiler, "-O3", "-DNDEBUG", "-std=c++17", *(f"-I{each}" for each in folders)]
    command += [str(_SOURCES / "siconos_plant.cpp"), "-o", str(program)]
    command += ["-lsiconos_kernel", "-lsiconos_numerics"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        wrong = [line for line in done.stderr.splitlines() if "error" in line]
        raise AbsentError(f"it does not compile: {wrong[0] if wrong else done.returncode}")
    plain = [problem[key] for key in ("seconds", "step", "tolerance")]
    plain += [problem[key][0] for key in ("frequency", "q_r", "eps")]
    keys = ("M", "C", "K", "W", "cosine", "position", "velocity")
    numbers = [len(problem["position"]), *plain, *(v for k in keys for v in np.ravel(problem[k]))]
    given.write_text(" ".join(map(str, numbers)) + "\n", "utf-8")
    return [str(program), str(given)]


def _interpreted(problem: Mapping[str, Any], folder: Path) -> list[str]:
    """The command of the program in Python, by an interpreter that has Siconos."""
    named = os.environ.get("SICONOS_PYTHON")
    for interpreter in [named] if named else [sys.executable, "/usr/bin/python3"]:
        command = [interpreter, "-c", "import siconos.kernel"]
        try:
            done = subprocess.run(command, capture_output=True, timeout=60, check=False)
        except OSError:
            continue
        if done.returncode == 0:
            given = folder / "problem.json"
            given.write_text(json.dumps(dict(problem)), "utf-8")
            return [interpreter, str(_SOURCES / "siconos_plant.py"), str(given)]
    raise AbsentError("apt install python3-siconos, or name an interpreter in SICONOS_PYTHON")
