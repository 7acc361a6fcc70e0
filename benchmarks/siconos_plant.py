# SPDX-License-Identifier: Apache-2.0
"""As ``siconos_plant.cpp``, in Siconos' Python: for an interpreter that has Siconos.

``python siconos_plant.py problem.json``. It takes no force that depends on time, so the harmonic
is one more coordinate; see ``test/siconos_runs.py``, which this runs with a tolerance.
"""

import json
import sys
from pathlib import Path
from typing import Any

import siconos.kernel as sk

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
from siconos_runs import Problem, scene, velocity

_NONSMOOTH = 2


def built(given: Problem) -> tuple[Any, Any]:
    """The scene of a problem, and its simulation."""
    made = scene(given)
    run = sk.EventDriven(made.system, sk.TimeDiscretisation(0.0, given["step"]))
    integrator = sk.LsodarOSI()
    integrator.setTol(1, given["tolerance"], given["tolerance"])
    run.insertIntegrator(integrator)
    run.insertNonSmoothProblem(sk.LCP(), sk.SICONOS_OSNSP_ED_IMPACT)
    run.insertNonSmoothProblem(sk.LCP(), sk.SICONOS_OSNSP_ED_SMOOTH_ACC)
    return made, run


def simulated(made: Any, run: Any) -> tuple[list[float], list[list[float]]]:  # noqa: ANN401
    """Impact times and samples (t, q, u)."""
    impacts, samples = [], []
    while run.hasNextEvent():
        run.advanceToEvent()
        impact = run.eventsManager().nextEvent().getType() == _NONSMOOTH
        run.processEvents()
        if impact:
            impacts.append(run.startingTime())
        else:
            position = made.body.q()[: made.n].tolist()
            samples.append([run.startingTime(), *position, *velocity(made)])
    return impacts, samples


def main(problem: Path) -> None:
    """Build the simulation, and run it at each command on the standard input."""
    given = json.loads(problem.read_text("utf-8"))
    following = built(given)
    found: tuple[list[float], list[list[float]]] = ([], [])
    print("ready", flush=True)
    for command in sys.stdin:
        if command.strip() == "run":
            found = simulated(*following)
            print("done", flush=True)
            following = built(given)
            continue
        rows = [found[0], *found[1]]
        text = "".join(" ".join(map(repr, row)) + "\n" for row in rows)
        Path(command.strip().removeprefix("save ")).write_text(text, "utf-8")
        print("saved", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
