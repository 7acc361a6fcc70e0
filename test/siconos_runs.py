# SPDX-License-Identifier: Apache-2.0
"""A run by Siconos, as a script of its own: ``python siconos_runs.py problem.json result.json``.

Siconos (Acary, Bonnefon, Bremond, Huber, Perignon and Sinclair, An Introduction to Siconos, INRIA
technical report 340) lives in the interpreter of the system, where this package need not be, so
this file imports neither the package nor the tests.
"""

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import siconos.kernel as sk

Problem = dict[str, Any]
"""``M C K W q_r eps constant frequency cosine sine position velocity seconds step method``."""

_NONSMOOTH = 2
"""What Siconos calls an event that is not one of its grid."""


class Scene(NamedTuple):
    """A problem as Siconos wants it; its first ``n`` coordinates are the problem's."""

    n: int
    seconds: float
    body: Any
    interactions: list[Any]
    system: Any


def main(problem: Path, result: Path) -> None:
    """Run the problem of one file; write what Siconos made of it into the other."""
    given = json.loads(problem.read_text("utf-8"))
    method = {"event-driven": event_driven, "time-stepping": time_stepping}[given["method"]]
    result.write_text(json.dumps(method(scene(given), given["step"])), "utf-8")


def scene(given: Problem) -> Scene:
    """The body with its contacts.

    Python cannot give Siconos a force that depends on time. So each harmonic is a coordinate more,
    ``p'' = -w^2 p`` from (1, 0), which is ``cos w t`` and drives the others one way.
    """
    n, h = len(given["position"]), len(given["frequency"])
    M, C, K = np.eye(n + h), np.zeros((n + h, n + h)), np.zeros((n + h, n + h))
    M[:n, :n], C[:n, :n], K[:n, :n] = given["M"], given["C"], given["K"]
    for k, frequency in enumerate(given["frequency"], n):
        K[k, k] = frequency**2
        K[:n, k] = -np.array(given["cosine"][k - n])
        C[:n, k] = np.array(given["sine"][k - n]) / frequency
    body = sk.LagrangianLinearTIDS(
        np.append(given["position"], np.ones(h)),
        np.append(given["velocity"], np.zeros(h)),
        M,
        K,
        C,
    )
    body.setFExtPtr(np.append(given["constant"], np.zeros(h)))
    system = sk.NonSmoothDynamicalSystem(0.0, given["seconds"])
    system.insertDynamicalSystem(body)
    interactions = []
    for w, gap, eps in zip(np.transpose(given["W"]), given["q_r"], given["eps"], strict=True):
        relation = sk.LagrangianLinearTIR(np.append(w, np.zeros(h))[None], np.array([gap]))
        interactions.append(sk.Interaction(sk.NewtonImpactNSL(eps), relation))
        system.link(interactions[-1], body)
    return Scene(n, given["seconds"], body, interactions, system)


def event_driven(made: Scene, step: float) -> Problem:
    """LSODAR from event to event: all instants at which an impulse acts."""
    run = sk.EventDriven(made.system, sk.TimeDiscretisation(0.0, step))
    run.insertIntegrator(sk.LsodarOSI())
    run.insertNonSmoothProblem(sk.LCP(), sk.SICONOS_OSNSP_ED_IMPACT)
    run.insertNonSmoothProblem(sk.LCP(), sk.SICONOS_OSNSP_ED_SMOOTH_ACC)
    impacts = []
    while run.hasNextEvent():
        run.advanceToEvent()
        nonsmooth = run.eventsManager().nextEvent().getType() == _NONSMOOTH
        before = velocity(made)
        run.processEvents()
        impulses = [float(interaction.lambda_(1)[0]) for interaction in made.interactions]
        if nonsmooth and any(impulses):
            impacts.append(
                {
                    "seconds": run.startingTime(),
                    "gaps": [float(interaction.y(0)[0]) for interaction in made.interactions],
                    "before": before,
                    "after": velocity(made),
                }
            )
    return {"impacts": impacts}


def time_stepping(made: Scene, step: float) -> Problem:
    """Moreau and Jean's scheme: the state at the end of every step, and the step's impulses."""
    run = sk.TimeStepping(
        made.system, sk.TimeDiscretisation(0.0, step), sk.MoreauJeanOSI(0.5), sk.LCP()
    )
    seconds, positions, velocities, impulses = [], [], [], []
    for _ in range(round(made.seconds / step)):
        run.computeOneStep()
        seconds.append(run.nextTime())
        positions.append(made.body.q()[: made.n].tolist())
        velocities.append(velocity(made))
        impulses.append([float(interaction.lambda_(1)[0]) for interaction in made.interactions])
        run.nextStep()
    return {
        "seconds": seconds,
        "positions": positions,
        "velocities": velocities,
        "impulses": impulses,
    }


def velocity(made: Scene) -> list[float]:
    """The velocity of the problem's coordinates now."""
    return [float(value) for value in made.body.velocity()[: made.n]]


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
