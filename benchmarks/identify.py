# SPDX-License-Identifier: Apache-2.0
"""How well parameters are estimated from impact times: ``./dev bench identify``.

A minute of the sample models. The initial model has restitutions off by 0.1, stiffness by 3 % and
gaps by 2 %; no state is given. Of a restitution by speed the exponent is off by 0.1 too.
docs/identify.md and docs/laws.md quote these six tables, without timing:

- exact stamps (rounded to 1 ns): the largest relative error of a parameter;
- jitter of 1 ms, over the seeds: the normalised squared error of all parameters over their number,
  on average, which should be 1; the probability of a sum that far from it; the median of errors
  over standard errors, which should be 0.67; the median and largest relative error;
- V of observers with ideal stamps and a stiffness that is 2 % off, before and after it was
  identified, and where minimum-variance estimates it on line: medians of the last half minute;
- minimum-variance that estimates parameters on line, over the starts, every event accepted: V / V0
  at 30 s without estimated parameters, with right initial values, and with wrong ones drawn from
  the declared distribution; with jitter, the mean normalised squared error of the parameters, and
  their standard deviations over the Cramer-Rao bound;
- one impact in ten spurious, without jitter and with 1 ms: the relative errors over the seeds, in
  how many runs the largest was above 1 %, and in how many the fit reported that it had failed;
- plants that are not the model (``benchmarks.misfit_plants`` without MuJoCo's), restitution,
  stiffness and gap fitted one after the other: how many of the parameters in which a plant does
  not differ from its model are within some standard errors, before these are widened and after.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy import stats

from benchmarks.harness import new_file
from benchmarks.impacts import energy
from benchmarks.misfit_plants import WrongPlant, plants
from impact_observer.errors import IdentificationError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.identify.identification import Identification, identify
from impact_observer.identify.shooting import shoot
from impact_observer.model import System, read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.rebounds.power_law import PowerLaw
from impact_observer.observer import Observer, initial_state, law_named, replay
from impact_observer.plant import Plant, Run, SensorModel, simulate, simulate_sensor
from impact_observer.stamps import NS_PER_S, from_seconds, grid, seconds_between
from impact_observer.states import Estimate
from impact_observer.trajectory.linearised_system import FlightEnd

EPOCH = 5 * NS_PER_S
END = 60.0
MODELS = ("two_mass", "three_mass")
FREE = ("restitution", "stiffness-scale", "gap")
BY_SPEED = "yielding_stop"
"""A model whose restitution falls with the speed; its exponent is free too, and off by 0.1."""
NAMES = (*MODELS, BY_SPEED)
STIFFNESS, RESTITUTION, GAP = 1.03, 0.1, 1.02
JITTER = 1e-3
SPURIOUS = 0.1
LAWS = ("geometric", "unilateral", "minimum-variance")
WRONG_CLOCK = 1e-4
DIFFERS = {
    "stiffness": "stiffness",
    "stiffness-drift": "stiffness",
    "pendulum": "stiffness",
    "hardening": "stiffness",
    "restitution": "restitution",
    "restitution-by-speed": "restitution",
    "random-restitution": "restitution",
    "restitution-drift": "restitution",
    "finite-contact": "restitution",
    "gap": "gap",
    "force-amplitude": "gap",  # of a motion in another size
}
"""In what the plants of each kind differ from their models, among fitted parameters."""
HALF = 30 * NS_PER_S
ON_LINE = ("restitution=0.1", "stiffness-scale=0.03")


@lru_cache
def recorded(name: str) -> Run:
    """A minute of a model."""
    model = read_model(name)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    return simulate(plant, grid(EPOCH, EPOCH + from_seconds(END), 20.0))


def events_of(name: str, sensor: SensorModel, seed: int) -> list[ImpactEvent]:
    """The events of a sensor on that run, by stamp."""
    run, model = recorded(name), read_model(name).system
    sensed = simulate_sensor(
        sensor, model, run.switchings, epoch=EPOCH, last=int(run.stamps[-1]), seed=seed
    )
    return sorted((each.event for each in sensed), key=lambda each: each.stamp)


def family_of(name: str) -> ParametricFamily:
    """The initial model of an identification, and what is free."""
    free = (*FREE, "restitution-exponent") if name == BY_SPEED else FREE
    return parametric_family(wrong(read_model(name).system), free)


def wrong(model: System) -> System:
    """The initial model of a sample."""
    return replace(
        model,
        K=STIFFNESS * model.K,
        contacts=tuple(
            replace(c, gap=GAP * c.gap, restitution=c.restitution + RESTITUTION * (-1) ** i)
            if not isinstance(c.rebound, PowerLaw)
            else replace(c, gap=GAP * c.gap, rebound=flatter(c.rebound))
            for i, c in enumerate(model.contacts)
        ),
    )


def flatter(curve: PowerLaw) -> PowerLaw:
    """A power law with a wrong value and exponent."""
    exponent = curve.exponent + RESTITUTION
    return replace(curve, value=curve.value + RESTITUTION, exponent=exponent)


def errors(found: Identification, model: System) -> np.ndarray:
    """The errors of the parameters, in their units."""
    true = {"stiffness-scale": 1 / STIFFNESS}
    for contact in model.contacts:
        true[f"restitution.{contact.name}"] = contact.restitution
        true[f"gap.{contact.name}"] = contact.gap
        if isinstance(contact.rebound, PowerLaw):
            true[f"restitution-exponent.{contact.name}"] = contact.rebound.exponent
    return np.asarray(found.values - np.array([true[name] for name in found.family.names]))


def exact(name: str) -> dict[str, object]:
    """A row of the first table."""
    found = identify(family_of(name), events_of(name, SensorModel(), 0))
    error = errors(found, read_model(name).system)
    return {
        "model": name,
        "impacts": len(found.shifts),
        "largest_relative_error": float(np.max(np.abs(error / (found.values - error)))),
        "residual_s": found.rms,
    }


def jittered(name: str, seeds: int) -> dict[str, object]:
    """A row of the second table."""
    model, family = read_model(name).system, family_of(name)
    weights, sizes, ratios = [], [], []
    for seed in track(range(seeds), f"{name}: jitter", console=Console(stderr=True)):
        events = events_of(name, SensorModel(jitter=JITTER), seed)
        found = identify(family, events, clock=JITTER, trust_events=True)
        error, own = errors(found, model), found.covariance[found.start.size :, found.start.size :]
        weights.append(float(error @ np.linalg.solve(own, error)))
        ratios.append(np.abs(error) / found.errors)
        sizes.append(float(np.max(np.abs(error / (found.values - error)))))
    p = family.size
    tail = float(stats.chi2.sf(sum(weights), seeds * p))
    return {
        "model": name,
        "seeds": seeds,
        "normalised": sum(weights) / (seeds * p),
        "probability": 2 * min(tail, 1 - tail),
        "median_error_over_its_own": float(np.median(ratios)),
        "median_relative_error": float(np.median(sizes)),
        "largest_relative_error": max(sizes),
    }


def spurious(name: str, jitter: float, seeds: int) -> dict[str, object]:
    """A row of the last table."""
    model = read_model(name).system
    family = parametric_family(wrong(model), FREE)
    rate = SPURIOUS * len(recorded(name).events) / END
    sizes, failed = [], 0
    for seed in track(range(seeds), f"{name}: spurious", console=Console(stderr=True)):
        events = events_of(name, SensorModel(jitter=jitter, spurious=rate), seed)
        try:
            found = identify(family, events)
        except IdentificationError:
            failed += 1
            continue
        failed += not found.converged
        error = errors(found, model)
        sizes.append(float(np.max(np.abs(error / (found.values - error)))))
    return {
        "model": name,
        "jitter_s": jitter,
        "seeds": seeds,
        "median_relative_error": float(np.median(sizes)),
        "largest_relative_error": max(sizes),
        "above_1_percent": sum(size > 0.01 for size in sizes),
        "failed": failed,
    }


def floors(name: str) -> Iterator[dict[str, object]]:
    """The rows of the third table for a model."""
    model = read_model(name).system
    off = replace(model, K=1.02 * model.K)
    events = events_of(name, SensorModel(), 0)
    found = identify(parametric_family(off, ["stiffness-scale"]), events)
    exact = Uncertainty(clock_error=0.0)
    learning = replace(exact, unknowns=UnknownParameters.named(off, ["stiffness-scale=0.03"]))
    for law in LAWS:
        learns = law_named(law).learns
        yield {
            "model": name,
            "law": law,
            "before_J": _floor(name, law, off, events, exact),
            "after_J": _floor(name, law, found.system, events, exact),
            "on_line_J": _floor(name, law, off, events, learning) if learns else "",
        }


def _floor(
    name: str, law: str, model: System, events: list[ImpactEvent], declared: Uncertainty
) -> float:
    """The median V in the last half, with the true model, J."""
    run = recorded(name)
    chosen = law_named(law)(model, declared)
    observer = Observer(model, chosen, *initial_state("random:1", model), ensemble=1)
    late = run.stamps >= EPOCH + from_seconds(END / 2)
    return float(np.median(_distances(name, observer, events, late)[0]))


def _distances(
    name: str, observer: Observer, events: list[ImpactEvent], wanted: np.ndarray
) -> tuple[np.ndarray, Estimate]:
    """V at the wanted samples of a run, J, and the last estimate."""
    run, true = recorded(name), read_model(name).system
    stamps = run.stamps[wanted]
    estimates = [x for x in replay(observer, events, stamps) if isinstance(x, Estimate)]
    states = np.array([np.concatenate([x.q, x.u]) for x in estimates])
    return energy(true, states - run.states[wanted]), estimates[-1]


def misfits(seconds: float = 40.0) -> Iterator[dict[str, object]]:
    """The rows of the table of plants that are not the model."""
    wrong = [plant for plant in plants() if plant.kind != "exact"]
    for clock in (WRONG_CLOCK, None):
        found: list[tuple[float, float]] = []
        for plant in track(wrong, "plants that are not the model", console=Console(stderr=True)):
            run = plant.run(0, seconds)
            rows = zip(run.stamps.tolist(), run.contacts.tolist(), strict=True)
            names = plant.model.contact_names
            events = [
                ImpactEvent(stamp, (Switch(names[i], Kind.IMPACT),), sequence=k + 1, epoch=EPOCH)
                for k, (stamp, i) in enumerate(rows)
            ]
            for free in FREE:
                if not free.startswith(DIFFERS.get(plant.kind, "none")):
                    found.extend(_normalised(plant, free, events, clock))
        plain, widened = np.array(found).T
        for title, z in (("before", plain), ("widened", widened)):
            yield {
                "declared_s": "" if clock is None else clock,
                "standard_errors": title,
                "parameters": len(z),
                "median": float(np.median(z)),
                **{f"within {k}": float(np.mean(z < k)) for k in (2, 3, 5)},
            }


def _normalised(
    plant: WrongPlant, free: str, events: list[ImpactEvent], clock: float | None
) -> Iterator[tuple[float, float]]:
    """Errors of the parameters over standard errors, before these are widened and after."""
    family = parametric_family(plant.model, [free])
    try:
        found = identify(family, events, clock=clock, trust_events=True, held_back=0.0)
    except IdentificationError:
        return
    if found.converged:
        for z in (np.abs(found.values - family.nominal) / found.errors).tolist():
            yield z * found.widened, z


def _learned(last: Estimate, unknowns: UnknownParameters) -> list[tuple[str, float, float]]:
    """Those of an estimate's parameters that are the model's, in the order of ``unknowns``."""
    return [each for each in last.parameters if each[0] in unknowns.family.names]


def on_line(name: str, free: str, jitter: float, starts: int) -> dict[str, object]:
    """A row of the fourth table."""
    true = read_model(name).system
    right = UnknownParameters.named(true, [free])
    plain, learning, wrong, squares, ratios = [], [], [], [], []
    least = _least(name, right, jitter) if jitter else np.full(right.family.size, np.nan)
    for seed in track(range(starts), f"{name}: {free} on line", console=Console(stderr=True)):
        rng = np.random.default_rng(seed)
        events = events_of(name, SensorModel(jitter=jitter), seed)
        declared = Uncertainty(clock_error=jitter, missed=0.0, spurious=0.0, mislabelled=0.0)
        start, learns = f"random:{seed}", replace(declared, unknowns=right)
        plain.append(_ended(name, _observer(true, start, declared), events)[0])
        V, last = _ended(name, _observer(true, start, learns), events)
        learning.append(V)
        ratios.append([each[2] for each in _learned(last, right)] / least)
        off = np.clip(rng.normal(size=right.family.size), -2, 2) * right.deviations
        model = right.family.system_at(right.family.nominal + off)
        learns = replace(declared, unknowns=UnknownParameters.named(model, [free]))
        V, last = _ended(name, _observer(model, start, learns), events)
        wrong.append(V)
        for (_, value, deviation), given, by in zip(
            _learned(last, right), right.family.nominal.tolist(), off.tolist(), strict=True
        ):
            true_value = given / (given + by) if "scale" in free else given
            squares.append(((value - true_value) / deviation) ** 2)
    return {
        "model": name,
        "learned": free,
        "jitter_s": jitter,
        "V/V0 plain": float(np.median(plain)),
        "V/V0 right": float(np.median(learning)),
        "V/V0 wrong": float(np.median(wrong)),
        # without jitter the rounding to 1 ns is the same for all starts: there is no mean
        "normalised": float(np.mean(squares)) if jitter else "",
        "deviation_over_least": float(np.median(ratios)) if jitter else "",
    }


def _least(name: str, unknowns: UnknownParameters, jitter: float) -> np.ndarray:
    """The Cramer-Rao bound of the parameters' deviations after 30 s."""
    true, run = read_model(name).system, recorded(name)
    events = [each for each in run.events if each.stamp <= EPOCH + HALF]
    t = np.array([seconds_between(EPOCH, each.stamp) for each in events])
    index = {contact: i for i, contact in enumerate(true.contact_names)}
    hits = [(index[each.switches[0].contact],) for each in events]
    moments = [FlightEnd(at, hit, hit) for at, hit in zip(t.tolist(), hits, strict=True)]
    start = np.append(run.states[0], unknowns.family.nominal)
    shot = shoot(unknowns.family, start, moments, t, 0.0)
    scales = [np.ones(2 * true.n), unknowns.deviations, np.full(t.size, jitter)]
    scale = np.concatenate(scales)
    # changes of start, parameters and stamps that keep all gaps at zero
    _, _, rest = np.linalg.svd(np.hstack([shot.by_start, shot.by_instant]) * scale)
    free = np.linalg.norm(rest[t.size :] * scale, axis=0)
    return np.asarray(free[2 * true.n : start.size])


def _observer(model: System, start: str, declared: Uncertainty) -> Observer:
    """An observer with ``minimum-variance``, one replica."""
    law = law_named("minimum-variance")(model, declared)
    return Observer(model, law, *initial_state(start, model), ensemble=1)


def _ended(name: str, observer: Observer, events: list[ImpactEvent]) -> tuple[float, Estimate]:
    """V after 30 s over the initial V, and the estimate then."""
    stamps = recorded(name).stamps
    wanted = np.isin(np.arange(stamps.size), np.searchsorted(stamps, (EPOCH, EPOCH + HALF)))
    V, last = _distances(name, observer, events, wanted)
    return float(V[-1] / V[0]), last


def main(args: Sequence[str] | None = None) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="./dev bench identify", description=__doc__)
    parser.add_argument("--seeds", type=int, default=50, metavar="N", help="(default 50)")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every metric to FILE")
    parser.add_argument("--models", nargs="+", choices=NAMES, default=NAMES, help="only these")
    given = parser.parse_args(args)
    samples = [name for name in MODELS if name in given.models]
    tables = {
        "exact stamps": [exact(name) for name in given.models],
        "stamps that jitter by 1 ms": [jittered(name, given.seeds) for name in given.models],
        "V with a stiffness 2 % off": [row for name in samples for row in floors(name)],
        "parameters learned on line": [
            on_line(name, free, jitter, given.seeds)
            for name in samples
            for free in ON_LINE
            for jitter in (0.0, JITTER)
        ],
        "one impact in ten is spurious": [
            spurious(name, jitter, max(given.seeds // 5, 1))
            for name in samples
            for jitter in (0.0, JITTER)
        ],
        "plants that are not the model": [*misfits()] if samples else [],
    }
    for title, rows in tables.items():
        if not rows:
            continue
        table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
        for key in rows[0]:
            table.add_column(key)
        for row in rows:
            table.add_row(*(f"{v:.2g}" if isinstance(v, float) else str(v) for v in row.values()))
        Console().print(table)
    if given.json:
        given.json.write_text(json.dumps(tables, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
