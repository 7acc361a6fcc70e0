# SPDX-License-Identifier: Apache-2.0
"""A plant's run with impacts: closed-form flow against integrators with event location."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from benchmarks import siconos_peer
from benchmarks.harness import Benchmark, Contest, DisagreementError, Goal, Job
from impact_observer.model import Model, System, read_model
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import from_seconds, grid, seconds_between
from impact_observer.states import Stamps

EPOCH = 1_000_000_000
DURATION = 30.0
RATE = 1000.0
SPARSE = 0.1
"""Between samples that Siconos must make, s."""
INSTANTS_AGREE = 1e-9
"""s"""
STATES_AGREE = 1e-8
"""m, m/s"""
TOLERANCE = 1e-10
"""Relative and absolute, of the integrator: the loosest decade that reaches ``INSTANTS_AGREE``."""

EVENTS_AGREE = 1e-11
"""s, with a peer that locates events as well as it integrates."""
SICONOS_TOLERANCE = 1e-12
"""Relative and absolute, of LSODAR: the loosest decade that reaches ``EVENTS_AGREE``."""

Array = NDArray[np.float64]


REPEATS = 5
"""Of each contestant in its turn: runs of milliseconds."""


class Prepared:
    """Our run, with a plant that is made beforehand, as Siconos' model is."""

    def __init__(self, model: Model, stamps: Stamps) -> None:
        """Of ``model``, with states at ``stamps``."""
        self._model, self._stamps = model, stamps

    def ready(self) -> None:
        """Make the plant of the next run."""
        self._plant = _plant(self._model.system, self._model)

    def run(self, _: Path) -> Run:
        """A ``Job``."""
        return simulate(self._plant, self._stamps)


@dataclass(frozen=True, slots=True)
class Integrated:
    """The integrator's impact times, s, and states on the grid, shape (samples, 2n)."""

    instants: list[float]
    states: Array


def prepare(folder: Path) -> Contest:
    """Run all contestants and compare every impact and every sample."""
    model = read_model("two_mass")
    stamps = grid(EPOCH, EPOCH + from_seconds(DURATION), RATE)
    run, ours = simulate(_plant(model.system, model), stamps), Prepared(model, stamps)
    siconos, absent, agreements = _siconos(model, run, 1 / RATE, folder)
    agreements.append(
        _agreement(
            "scipy", INSTANTS_AGREE, (_instants(run), run.states), _integrated(model, stamps)
        )
    )
    work = f"two_mass, {DURATION:g} s, {len(run.impacts)} impacts, {stamps.size} states"
    return Contest(
        f"{work}; {'; '.join(agreements)}",
        ours.run,
        {"solve_ivp, DOP853": lambda _: _integrated(model, stamps), **siconos},
        absent,
        ready=ours.ready,
        repeats=REPEATS,
    )


def prepare_impacts(folder: Path) -> Contest:
    """A run of which only the impacts are wanted, and the last state; from the matrices on."""
    model = read_model("two_mass")
    stamps = grid(EPOCH, EPOCH + from_seconds(DURATION), 1 / SPARSE)
    run = simulate(_plant(model.system, model), stamps)
    siconos, absent, agreements = _siconos(model, run, SPARSE, folder)
    work = f"two_mass, {DURATION:g} s, {len(run.impacts)} impacts, ours with making the model"
    return Contest(
        f"{work}, Siconos' grid {SPARSE:g} s; {'; '.join(agreements)}",
        lambda _: simulate(_plant(replace(model.system), model), stamps[[0, -1]]),
        siconos,
        absent,
        repeats=REPEATS,
    )


def _siconos(
    model: Model, run: Run, step: float, folder: Path
) -> tuple[dict[str, Job], dict[str, str], list[str]]:
    """Jobs of Siconos, why others are absent, and how well each agrees with our run."""
    problem = {**_problem(model), "step": step}
    found, absent = siconos_peer.start(problem, folder)
    agreements = []
    for name, each in found.items():
        each.run(folder)
        instants, samples = each.found(folder)
        theirs = Integrated(instants, samples[:, 1:])
        ours = _instants(run), run.states[1:]
        agreements.append(_agreement(name, EVENTS_AGREE, ours, theirs))
    return {name: each.run for name, each in found.items()}, absent, agreements


def _instants(run: Run) -> list[float]:
    """The impact times, s."""
    return [
        seconds_between(EPOCH, each.instant.stamp) + each.instant.remainder for each in run.impacts
    ]


def _agreement(
    name: str, within: float, ours: tuple[list[float], Array], theirs: Integrated
) -> str:
    """A sentence on how well a peer agrees with our impact times and states."""
    found, states = ours
    if len(found) != len(theirs.instants):
        raise DisagreementError(f"{len(found)} impacts, {len(theirs.instants)} by {name}")
    late = float(np.max(np.abs(np.subtract(found, theirs.instants))))
    off = float(np.max(np.abs(states - theirs.states)))
    if not (late < within and off < STATES_AGREE):
        raise DisagreementError(f"{name}: instants differ by {late:.1e} s, states by {off:.1e}")
    return f"{name} agrees to {late:.0e} s, states to {off:.0e}"


def _problem(model: Model) -> dict[str, Any]:
    """The problem for Siconos, in lists and numbers."""
    system, (position, velocity) = model.system, model.initial_state()
    arrays = {key: getattr(system, key).tolist() for key in ("M", "C", "K", "W", "q_r", "eps")}
    parts = ("constant", "frequency", "cosine", "sine")
    arrays |= {part: getattr(system.forcing, part).tolist() for part in parts}
    arrays |= {"position": position.tolist(), "velocity": velocity.tolist()}
    return {**arrays, "seconds": DURATION, "tolerance": SICONOS_TOLERANCE}


def _plant(system: System, model: Model) -> Plant:
    return Plant(system, *model.initial_state(), epoch=EPOCH)


def _integrated(model: Model, stamps: Stamps) -> Integrated:
    """The same run, phase by phase from event to event."""
    system = model.system
    q_r, w, reflect = float(system.q_r[0]), system.W[:, 0], _reflection(system)

    def gap(_: float, x: Array) -> float:
        return float(w @ x[: system.n]) + q_r

    gap.terminal, gap.direction = True, -1.0  # type: ignore[attr-defined]
    derivative, x = _derivative(system), np.concatenate(model.initial_state())
    times = (stamps - EPOCH) * 1e-9
    instants: list[float] = []
    pieces: list[Array] = []
    t = done = 0
    while done < times.size:
        phase = solve_ivp(
            derivative,
            (t, times[-1]),
            x,
            method="DOP853",
            t_eval=times[done:],
            events=gap,
            rtol=TOLERANCE,
            atol=TOLERANCE,
        )
        if phase.t.size:
            pieces.append(phase.y.T)
            done += phase.t.size
        if phase.t_events[0].size == 0:
            break
        t = phase.t_events[0][0]
        x = reflect @ phase.y_events[0][0]
        instants.append(float(t))
    return Integrated(instants, np.concatenate(pieces))


def _derivative(system: System) -> Callable[[float, Array], Array]:
    """``dx/dt = A x + B f(t)`` with one harmonic, in the fewest operations."""
    n, inverse = system.n, np.linalg.inv(system.M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ system.K, -inverse @ system.C]])
    forcing = system.forcing
    (omega,), (cosine,) = forcing.frequency, forcing.cosine
    if np.any(forcing.constant) or np.any(forcing.sine):
        raise DisagreementError(f"{system.name}: expected one cosine only")
    b = np.concatenate([np.zeros(n), inverse @ cosine])

    def derivative(t: float, x: Array) -> Array:
        return A @ x + b * math.cos(omega * t)

    return derivative


def _reflection(system: System) -> Array:
    """``u+ = u- - (1 + eps) M^-1 W (W^T M^-1 W)^-1 W^T u-`` of one contact, on (q, u)."""
    n, w = system.n, system.W[:, 0]
    direction = np.linalg.solve(system.M, w)
    jump = (1.0 + system.eps[0]) * np.outer(direction, w) / (w @ direction)
    R = np.eye(2 * n)
    R[n:, n:] -= jump
    return R


BENCHMARK = Benchmark(
    "plant",
    "how fast is a plant's run, with its impacts?",
    prepare,
    (Goal(0.03, "Siconos, C++"),),
)
IMPACTS = Benchmark(
    "plant_impacts",
    "how fast are the impacts alone?",
    prepare_impacts,
    (Goal(0.3, "Siconos, C++"),),
)
