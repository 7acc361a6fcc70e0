# SPDX-License-Identifier: Apache-2.0
"""Whether parameters with deviations leave the covariance honest: ``./dev bench deviations``.

    ./dev bench deviations                   # ten runs of each row
    ./dev bench deviations --runs 3

Drawn: each plant has parameters of its own, drawn from the declared deviations, and the observer
has the mean. NEES over 2n of ``minimum-variance`` should be 1; beside it that of an observer that
takes the mean for exact, and the medians of the deviations over the rms of the motion.

Fitted: ``identify`` fits parameters to a recording, and ``observe`` and ``smooth`` have the same
recording: the share of the samples of the worst component that are within two deviations, and the
median of NEES over 2n, with the covariance of the fit and with its values alone.

Undeclared: the plant's scales, gaps and restitutions are off by a relative 1e-6, stamps are exact,
and the model declares nothing: the share of the samples of the worst component that are within
two published deviations, and that of an observer to which the model is exact.

Options are the defaults, the jitter is declared. Samples of the first third, and within five
deviations of a stamp from an impact, do not count.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.impacts import EPOCH
from benchmarks.silence import model_named
from impact_observer.events import ImpactEvent
from impact_observer.identify.identification import identify
from impact_observer.model import Model
from impact_observer.model.free_parameters import parameters_beside, parametric_family
from impact_observer.model.parameter_uncertainty import ParameterUncertainty
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer import make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, Run, simulate
from impact_observer.smooth.recording import smoothed_runs
from impact_observer.stamps import NS_PER_S, from_seconds, grid
from impact_observer.states import Estimate

SETTLED = 1 / 3
"""Part of a run after which estimates count."""
DRAWN: tuple[tuple[str, float, float, dict[str, float]], ...] = (
    ("two_mass", 40.0, 1e-3, {"restitution.stop": 0.02}),
    ("two_mass", 40.0, 1e-3, {"stiffness-scale": 0.005, "gap.stop": 0.002}),
    ("two_mass", 40.0, 1e-3, {"mass-scale": 0.005, "forcing-amplitude.1": 0.01}),
    ("two_mass", 40.0, 1e-3, {"forcing-phase.1": 0.02, "constant-force.x1": 0.02}),
    ("three_mass", 40.0, 1e-3, {"restitution.left": 0.02, "restitution.right": 0.02}),
    ("three_mass", 40.0, 1e-3, {"stiffness-scale": 0.005, "damping-scale": 0.05}),
    ("hammer", 20.0, 1e-4, {"restitution.anvil": 0.01, "gap.anvil": 1e-5}),
    ("drill", 10.0, 2e-5, {"restitution.stop": 0.01, "mass-scale": 0.002}),
)
"""Models, durations (s), jitters (s), and deviations of parameters."""
FITTED = (
    ("two_mass", 40.0, 5e-5, ["restitution"]),
    ("two_mass", 40.0, 1e-3, ["restitution", "stiffness-scale"]),
    ("three_mass", 60.0, 1e-4, ["restitution"]),
    ("hammer", 20.0, 5e-5, ["restitution"]),
    ("drill", 3.0, 5e-5, ["restitution"]),
)
"""Models, durations (s), jitters (s), and what ``identify`` fits."""
UNDECLARED = (
    ("two_mass", 30.0),
    ("three_mass", 30.0),
    ("hammer", 10.0),
    ("bouncing_ball", 5.0),
)
"""Models and durations (s)."""
_ERRING = (
    *("stiffness-scale", "mass-scale", "damping-scale", "forcing-amplitude"),
    *("gap", "restitution"),
)
_SMALL_ERROR, _ENOUGH = 1e-6, 0.8
Array = NDArray[np.float64]


class Recording(NamedTuple):
    """The run of a plant and what its sensor reported."""

    run: Run
    events: list[ImpactEvent]
    jitter: float

    @classmethod
    def simulated(cls, model: Model, seconds: float, jitter: float, seed: int) -> "Recording":
        """A run from the model's initial state, with its own errors of stamps."""
        stamps = grid(EPOCH, EPOCH + from_seconds(seconds), 199 / seconds)
        run = simulate(Plant(model.system, *model.initial_state(), epoch=EPOCH), stamps)
        late = jitter * NS_PER_S * np.random.default_rng(seed).normal(size=len(run.events))
        pairs = zip(run.events, np.rint(late).astype(int).tolist(), strict=True)
        stamped = sorted(((max(e.stamp + by, EPOCH), e) for e, by in pairs), key=itemgetter(0))
        events = [
            replace(each, stamp=stamp, sequence=k + 1) for k, (stamp, each) in enumerate(stamped)
        ]
        return cls(run, events, jitter)

    def errors(self, estimates: Sequence[Estimate], since: int) -> tuple[Array, Array]:
        """Errors in deviations, shape (samples, 2n), and NEES over 2n, shape (samples,)."""
        truth = dict(zip(self.run.stamps.tolist(), self.run.states, strict=True))
        hits = np.array([each.stamp for each in self.run.events])
        z, nees = [], []
        for each in estimates:
            near = np.min(np.abs(hits - each.stamp)) < 5 * self.jitter * NS_PER_S
            if near or each.stamp < since or each.stamp > hits[-1]:
                continue
            assert each.covariance is not None
            error = np.concatenate([each.q, each.u]) - truth[each.stamp]
            deviations = np.sqrt(np.diag(each.covariance))
            correlation = each.covariance / np.outer(deviations, deviations)
            z.append(error / deviations)
            nees.append(z[-1] @ np.linalg.pinv(correlation, hermitian=True) @ z[-1] / error.size)
        return np.array(z), np.array(nees)


def observed(model: Model, recording: Recording, seed: int, clock: float | None) -> list[Estimate]:
    """Estimates of an observer that begins elsewhere; the ``clock`` error is None for unknown."""
    options = Options("minimum-variance", f"random:{seed}", epoch=EPOCH, history=1e4)
    options = options if clock is None else replace(options, clock_error=clock)
    observer = make_observer(model, options)
    for each in recording.events:
        observer.receive(each)
    return [observer.estimate(int(each)) for each in recording.run.stamps]


def drawn(which: int, seed: int) -> tuple[float, float, float]:
    """NEES over 2n with and without deviations, and the deviation over the motion, of one run."""
    name, seconds, jitter, deviations = DRAWN[which]
    model, sizes = model_named(name), np.array([*deviations.values()])
    names, rng = tuple(deviations), np.random.default_rng([which, seed])
    known = replace(model, uncertainty=ParameterUncertainty(names, np.diag(sizes**2)))
    family = parametric_family(model.system, names, model.elements)
    plant = family.system_at(family.nominal + sizes * rng.normal(size=sizes.size))
    recording = Recording.simulated(replace(model, linear=plant), seconds, jitter, seed)
    since = EPOCH + from_seconds(SETTLED * seconds)
    ours, exact = (observed(each, recording, seed, jitter) for each in (known, model))
    mine, its = (float(np.mean(recording.errors(each, since)[1])) for each in (ours, exact))
    variances = np.array([np.diag(np.asarray(e.covariance)) for e in ours if e.stamp > since])
    motion = np.sqrt(np.mean(recording.run.states**2, axis=0))
    return mine, its, float(np.median(np.sqrt(variances) / motion))


def fitted(which: int, seed: int) -> list[float]:
    """Share within two deviations and NEES: observed, smoothed; then by the values alone."""
    name, seconds, jitter, free = FITTED[which]
    model, size = model_named(name), 2 * model_named(name).system.n
    recording = Recording.simulated(model, seconds, jitter, seed)
    family = parametric_family(model.system, free, model.elements)
    fit = identify(family, recording.events, clock=jitter)
    ends = recording.events[0].stamp, recording.events[-1].stamp
    known = ParameterUncertainty(family.names, fit.covariance[size:, size:], ends)
    found = list[float]()
    for uncertainty in (known, None):
        own = replace(model, linear=fit.system, uncertainty=uncertainty)
        declared = Options(clock_error=jitter, epoch=EPOCH)
        (motion,) = smoothed_runs(own, recording.events, declared)
        smoothed = [e for some in motion.estimates(recording.run.stamps) for e in some]
        since = EPOCH + from_seconds(SETTLED * seconds)
        for estimates, begin in (
            (observed(own, recording, seed, jitter), since),
            (smoothed, EPOCH),
        ):
            z, nees = recording.errors(estimates, begin)
            found += [float(np.min(np.mean(np.abs(z) < 2, axis=0))), float(np.median(nees))]
    return found


def undeclared(which: int, seed: int) -> tuple[float, float]:
    """The shares within two deviations, of what is published and of an exact model."""
    name, seconds = UNDECLARED[which]
    model, rng = model_named(name), np.random.default_rng([which, seed])
    everything = parameters_beside(ParametricFamily(model.system, ()))
    some = tuple(p for p in everything if p.name.partition(".")[0] in _ERRING)
    family = ParametricFamily(model.system, some)
    errors = _SMALL_ERROR * (np.abs(family.nominal) + (family.nominal == 0) * family.sizes)
    plant = family.system_at(family.nominal + errors * rng.normal(size=errors.size))
    recording = Recording.simulated(replace(model, linear=plant), seconds, 0.0, seed)
    since = EPOCH + from_seconds(SETTLED * seconds)
    exact = replace(model, uncertainty=ParameterUncertainty(family.names[:1], np.zeros((1, 1))))
    ours, other = (
        float(np.min(np.mean(np.abs(recording.errors(found, since)[0]) < 2, axis=0)))
        for found in (observed(each, recording, seed, None) for each in (model, exact))
    )
    return ours, other


def main(arguments: Sequence[str] | None = None) -> int:
    """Print all tables."""
    parser = argparse.ArgumentParser(prog="./dev bench deviations", description=__doc__)
    parser.add_argument("--runs", type=int, default=10, help="of each row")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(arguments)
    table = Table("rig", "deviations", "NEES/2n", "exact: NEES/2n", "deviation/motion")
    fits = Table(
        "rig", "free", "observe", "NEES/2n", "smooth", "NEES/2n", "values: observe", "smooth"
    )
    silent = Table("rig", "within two", "exact", "runs with 80 %", "exact")
    with Parallel(args.processes) as pool:
        for k, (name, _, _, deviations) in enumerate(DRAWN):
            rows = np.array(pool(delayed(drawn)(k, seed) for seed in range(args.runs)))
            means = [*np.mean(rows[:, :2], axis=0), np.median(rows[:, 2])]
            names = ", ".join(f"{key} {value:g}" for key, value in deviations.items())
            table.add_row(name, names, *(f"{each:.2g}" for each in means))
        for k, (name, _, _, free) in enumerate(FITTED):
            rows = np.array(pool(delayed(fitted)(k, seed) for seed in range(args.runs)))
            mean, middle = np.mean(rows, axis=0), np.median(rows, axis=0)
            cells = (f"{mean[0]:.0%}", f"{middle[1]:.2g}", f"{mean[2]:.0%}", f"{middle[3]:.2g}")
            fits.add_row(name, ", ".join(free), *cells, f"{mean[4]:.0%}", f"{mean[6]:.0%}")
        for k, (name, _) in enumerate(UNDECLARED):
            pairs = np.array(pool(delayed(undeclared)(k, seed) for seed in range(args.runs)))
            enough = np.mean(pairs >= _ENOUGH, axis=0)
            silent.add_row(
                name,
                *(f"{each:.0%}" for each in np.median(pairs, axis=0)),
                *(f"{each:.0%}" for each in enough),
            )
    Console().print(table, fits, silent)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
