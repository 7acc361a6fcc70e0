# SPDX-License-Identifier: Apache-2.0
"""The plant beside Siconos, which shares nothing with it; skipped where it is not installed."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import contact_cases as cases
import numpy as np
import pytest
from contact_cases import Case
from numpy.typing import NDArray
from systems import run

from impact_observer.events import Kind
from impact_observer.plant import Switching

Siconos = Callable[[Case, str, float], Any]

_SCRIPT = Path(__file__).parents[1] / "siconos_runs.py"
_STEP = 1e-3
"""Step of the time-stepping scheme, s."""


def importing(interpreter: str) -> str:
    """Why ``interpreter`` cannot import Siconos; empty if it can."""
    command = [interpreter, "-c", "import siconos.kernel"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{interpreter}: {error}"
    last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
    return f"{interpreter}: {last[0]}" if done.returncode else ""


@pytest.fixture(scope="module")
def interpreter() -> str:
    """An interpreter that has Siconos: SICONOS_PYTHON's, this one or the system's."""
    named = os.environ.get("SICONOS_PYTHON")
    refusals = []
    for candidate in [named] if named else [sys.executable, "/usr/bin/python3"]:
        if not (refusal := importing(candidate)):
            return candidate
        refusals.append(refusal)
    pytest.skip(
        f"no Siconos ({'; '.join(refusals)}): apt install python3-siconos, or name an interpreter"
        " that has it in SICONOS_PYTHON"
    )


@pytest.fixture
def siconos(interpreter: str, tmp_path: Path) -> Siconos:
    """Runs a case by a method, with a step in s."""

    def simulated(case: Case, method: str, step: float) -> Any:  # noqa: ANN401
        problem, result = tmp_path / "problem.json", tmp_path / "result.json"
        problem.write_text(json.dumps(described(case) | {"method": method, "step": step}), "utf-8")
        command = [interpreter, str(_SCRIPT), str(problem), str(result)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(result.read_text("utf-8"))

    return simulated


def described(case: Case) -> dict[str, Any]:
    """A case in lists and numbers."""
    model = case.system
    arrays = {name: getattr(model, name).tolist() for name in ("M", "C", "K", "W", "q_r", "eps")}
    parts = ("constant", "frequency", "cosine", "sine")
    arrays |= {name: getattr(model.forcing, name).tolist() for name in parts}
    start = {"position": case.position.tolist(), "velocity": case.velocity.tolist()}
    return {**arrays, **start, "seconds": case.seconds}


@pytest.mark.parametrize(
    ("case", "count"),
    [
        pytest.param(cases.ball, 26, marks=pytest.mark.slow),
        pytest.param(cases.oscillator, 40, marks=pytest.mark.slow),
        pytest.param(cases.floor_and_ceiling, 23, marks=pytest.mark.slow),
        pytest.param(cases.collapsing_beads, 37, marks=pytest.mark.slow),
        pytest.param(cases.thrown_beads, 28, marks=pytest.mark.slow),
        (cases.resting_beads, 4),
    ],
)
def test_event_driven_siconos_finds_the_same_impacts(
    siconos: Siconos, case: Callable[[], Case], count: int
) -> None:
    """The same contacts, instants and speeds, to the 1e-8 that LSODAR integrates with."""
    given = case()
    n = given.system.n
    ours = cases.impacts(given)
    theirs = siconos(given, "event-driven", given.seconds / 20)["impacts"]
    assert len(ours) == len(theirs) == count
    speed = np.max(np.abs([one.before[n:] for one in ours]))
    for one, other in zip(ours, theirs, strict=True):
        assert one.contacts == tuple(np.flatnonzero(np.abs(other["gaps"]) < 1e-9))
        assert cases.seconds(one) == pytest.approx(other["seconds"], rel=0, abs=1e-8)
        for speeds, others in ((one.before, other["before"]), (one.after, other["after"])):
            np.testing.assert_allclose(speeds[n:], others, rtol=0, atol=1e-8 * speed)


def persistent(found: list[Switching], end: float) -> list[tuple[float, float]]:
    """When the first contact closed for good and opened again, s; the last may last to the end."""
    closes = [cases.seconds(one) for one in found if Kind.CLOSE in cases.kinds(one)]
    opens = [cases.seconds(one) for one in found if Kind.OPEN in cases.kinds(one)]
    return list(zip(closes, [*opens, end][: len(closes)], strict=True))


def loaded(result: Any) -> NDArray[np.int64]:  # noqa: ANN401
    """Spans of steps in all of which the first contact took an impulse: first, last + 1."""
    pressed = np.array(result["impulses"])[:, 0] > 0
    return np.flatnonzero(np.diff(np.concatenate([[0], pressed, [0]]))).reshape(-1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("case", [cases.pressed_mass, cases.pulled_mass])
@pytest.mark.parametrize("eps", [0.0, 0.3])
def test_time_stepping_siconos_closes_and_opens_at_the_same_times(
    siconos: Siconos, case: Callable[[float], Case], eps: float
) -> None:
    """Contacts close and open within some steps, speeds and positions stay as near.

    The scheme is of first order. Where impacts accumulate it does not see flights shorter than
    some steps, so it closes earlier.
    """
    given = case(eps)
    theirs = siconos(given, "time-stepping", _STEP)
    spans = loaded(theirs)
    seconds = np.array([0.0, *theirs["seconds"]])
    closes, opens = seconds[spans[np.diff(spans, axis=1)[:, 0] > 20]].T
    ours = persistent(cases.switchings(given), given.seconds)
    assert len(ours) == len(closes) > 0
    early = 15 if eps else 5
    np.testing.assert_allclose([one for one, _ in ours], closes, rtol=0, atol=early * _STEP)
    np.testing.assert_allclose([one for _, one in ours], opens, rtol=0, atol=5 * _STEP)
    n = given.system.n
    speeds = [one.after[n:] for one in cases.impacts(given)[:3]]
    others = np.array(theirs["velocities"])[spans[:3, 0]]
    np.testing.assert_allclose(speeds, others, rtol=0, atol=10 * _STEP)
    found = run(
        given.system, given.position, given.velocity, seconds=given.seconds, rate=1 / _STEP
    )
    positions = found.states[1:, :n]
    np.testing.assert_allclose(theirs["positions"], positions, rtol=0, atol=15 * _STEP)
