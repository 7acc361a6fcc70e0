# SPDX-License-Identifier: Apache-2.0
"""How right and how honest are ``identify`` and ``smooth``, and how long do they take.

Plants have other parameters than the models that are fitted, and white jitter of the stamps. They
start at random or at rest, of which the fit knows nothing. Everything is computed here, by this
checkout.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.checkout import Checkout, Figure, Figures, Row
from benchmarks.misfit_bases import bases
from benchmarks.misfit_motion import EPOCH, Motion
from benchmarks.misfit_plants import WrongPlant, plants, random_restitution
from impact_observer.batch.identification import Identification, identify
from impact_observer.batch.smoothing import smoothed_runs
from impact_observer.errors import DynamicsError, IdentificationError
from impact_observer.events import ImpactEvent
from impact_observer.model import Model, ParameterUncertainty, System, read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer import Options, make_observer, replay_batches
from impact_observer.observer.uncertainty import suggested_deviation
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimates

Array = NDArray[np.float64]
DRAWS = 20
"""Recordings of a row."""
_AWAY = 0.005
"""Seconds from an impact within which states do not count."""


class Plant(NamedTuple):
    """A model, and the plant of it.

    Attributes:
        model: of which some numbers are wrong.
        change: the true numbers, by their names.
        free: names of parameters that are fitted.
        seconds: length of a recording.
        start: deviations of position and velocity at the start; zeros begin at rest.
    """

    model: Model
    change: dict[str, float]
    free: tuple[str, ...]
    seconds: float
    start: tuple[float, float] = (0.0, 0.0)

    @property
    def family(self) -> ParametricFamily:
        """The model with the numbers that are fitted."""
        return parametric_family(self.model.system, self.free, self.model.elements)

    @property
    def true_system(self) -> System:
        """The plant."""
        family = parametric_family(self.model.system, tuple(self.change), self.model.elements)
        return family.system_at(np.array([self.change[each] for each in family.names]))

    def errors(self, found: Identification) -> Array:
        """Errors of the fitted numbers over their standard errors."""
        given = zip(found.family.names, found.family.nominal.tolist(), strict=True)
        true = np.array([self.change.get(name, value) for name, value in given])
        return np.asarray((found.values - true) / found.errors)


@cache
def rigs() -> dict[str, Plant]:
    """The plants of the rows."""
    free = "restitution", "gap", "stiffness-scale"
    two, three, hammer, ball = map(
        read_model, ("two_mass", "three_mass", "hammer", "bouncing_ball")
    )
    stiffer = {"stiffness-scale": 1.05}
    return {
        "two_mass": Plant(two, {"restitution.stop": 0.66, **stiffer}, free, 60.0, (0.2, 0.7)),
        "three_mass": Plant(three, {"restitution.left": 0.7, **stiffer}, free, 60.0, (0.1, 0.5)),
        "hammer": Plant(hammer, {"restitution.anvil": 0.65, **stiffer}, free, 20.0),
        "drill": Plant(
            Model(bases()["drill"]), {"restitution.rock": 0.75, **stiffer}, free, 40.0, (0.1, 0.3)
        ),
        "ball": Plant(ball, {"restitution.floor": 0.88}, ("restitution",), 6.0),
    }


class Recorded(NamedTuple):
    """Events, and stamps and states of the truth."""

    events: list[ImpactEvent]
    stamps: NDArray[np.int64]
    states: Array


def recorded(plant: Plant, seed: int, jitter: float, scatter: float = 0.0) -> Recorded:
    """A recording whose stamps jitter, of a plant whose restitution scatters."""
    rng, system = np.random.default_rng([7, seed]), plant.true_system
    if any(plant.start):
        q, u = rng.normal(size=(2, system.n)) * np.reshape(plant.start, (2, 1))
        while np.any(system.gap(q) <= 0):
            q, u = rng.normal(size=(2, system.n)) * np.reshape(plant.start, (2, 1))
    else:
        q, u = plant.model.initial_state()
    truth = random_restitution(scatter, system)
    run = Motion(truth, np.concatenate([q, u]), plant.seconds, rng).run()
    late = np.round(jitter * NS_PER_S * rng.normal(size=run.stamps.size)).astype(np.int64)
    order = np.argsort(run.stamps + late)
    moved = replace(run, stamps=(run.stamps + late)[order], contacts=run.contacts[order])
    kept = run.away(_AWAY)
    return Recorded([*moved.events(system)], run.sample_stamps[kept], run.states[kept])


def tried(plant: Plant, events: Sequence[ImpactEvent], **how: float) -> Identification | None:
    """What ``identify`` finds; None if nothing."""
    try:
        return identify(plant.family, events, **how)  # type: ignore[arg-type]
    except (DynamicsError, IdentificationError):
        return None


def figures_of(plant: Plant, found: Sequence[Identification | None], seconds: float) -> Figures:
    """Errors over standard errors of all draws, and how many fit."""
    those = [each for each in found if each is not None]
    errors = np.array([plant.errors(each) for each in those])
    return {
        "errors over standard errors, rms": Figure(float(np.sqrt(np.mean(errors**2)))),
        "fits": Figure(sum(each.verdict.fits for each in those) / len(found)),
        "processor time of one": Figure(seconds / len(found), "s"),
    }


def draws(
    _: Checkout, _folder: Path, seed: int, *, name: str, jitter: float, scatter: float
) -> Figures:
    """Parameters of 20 recordings."""
    plant = rigs()[name]
    every = [recorded(plant, DRAWS * seed + k, jitter, scatter).events for k in range(DRAWS)]
    begun = time.process_time()
    found = [tried(plant, events) for events in every]
    return figures_of(plant, found, time.process_time() - begun)


def printed(events: list[ImpactEvent], _: np.random.Generator) -> list[ImpactEvent]:
    """Times with five digits."""
    return [replace(each, stamp=round(each.stamp, -4)) for each in events]


def echoes(events: list[ImpactEvent], rng: np.random.Generator) -> list[ImpactEvent]:
    """A third of the impacts has an echo within 5 ms."""
    echo = [
        replace(each, stamp=each.stamp + int(rng.integers(10**6, 5 * 10**6)))
        for each in events
        if rng.random() < 1 / 3
    ]
    return numbered([*events, *echo])


def missed(events: list[ImpactEvent], rng: np.random.Generator) -> list[ImpactEvent]:
    """A tenth of the impacts is missing."""
    return numbered([each for each in events if rng.random() > 0.1])


def late(events: list[ImpactEvent], _: np.random.Generator) -> list[ImpactEvent]:
    """The recording begins after a third of the time."""
    begin = events[len(events) // 3].stamp - 1000
    return [replace(each, sequence=0) for each in events if each.stamp > begin]


def numbered(events: list[ImpactEvent]) -> list[ImpactEvent]:
    """Events in order, as a sensor numbers them."""
    ordered = sorted(events, key=lambda each: each.stamp)
    return [replace(each, sequence=k) for k, each in enumerate(ordered, start=1)]


def as_they_are(events: list[ImpactEvent], _: np.random.Generator) -> list[ImpactEvent]:
    """All events."""
    return events


TROUBLES: dict[str, Callable[[list[ImpactEvent], np.random.Generator], list[ImpactEvent]]] = {
    "printed digits": printed,
    "echoes": echoes,
    "10 % missed": missed,
    "late recording": late,
    "unknown phase": as_they_are,
}


def troubled(_: Checkout, _folder: Path, seed: int, *, name: str, trouble: str) -> Figures:
    """Parameters of 20 recordings by sensors with faults; exact stamps but for these."""
    plant, made = rigs()[name], list[list[ImpactEvent]]()
    if trouble == "unknown phase":
        plant = plant._replace(free=(*plant.free, "forcing-phase"))
    for k in range(DRAWS):
        rng = np.random.default_rng([8, DRAWS * seed + k])
        if trouble == "unknown phase":
            change = {**plant.change, "forcing-phase.1": float(rng.uniform(-np.pi, np.pi))}
            own = plant._replace(change=change)
            made.append(recorded(own, DRAWS * seed + k, 1e-6).events)
            continue
        events = recorded(plant, DRAWS * seed + k, 1e-6).events
        made.append(TROUBLES[trouble](events, rng))
    begun = time.process_time()
    found = [tried(plant, events) for events in made]
    seconds = time.process_time() - begun
    figures = figures_of(plant, found, seconds)
    if trouble == "unknown phase":
        del figures["errors over standard errors, rms"]  # each draw has a phase of its own
    return figures


def frequency(_: Checkout, _folder: Path, seed: int, *, name: str) -> Figures:
    """A frequency that is off by 1e-4: whether it is named, and whether a fit with it fits."""
    plant = rigs()[name]
    key = "forcing-frequency.1"
    given = float(plant.model.system.forcing.frequency[0])
    plant = plant._replace(change={**plant.change, key: given * (1 + 1e-4)})
    named = freed = rejected = 0
    for k in range(DRAWS):
        events = recorded(plant, DRAWS * seed + k, 1e-6).events
        found = tried(plant, events)
        rejected += found is not None and not found.verdict.fits
        named += found is not None and any(each.name == key and each.fits for each in found.causes)
        also = tried(plant._replace(free=(*plant.free, key)), events)
        freed += also is not None and also.verdict.fits
    return {
        "says no": Figure(rejected / DRAWS),
        "named": Figure(named / DRAWS),
        "fits when freed": Figure(freed / DRAWS),
    }


def share_within(estimates: Sequence[Estimates], recording: Recorded, settled: float) -> float:
    """Share of the numbers of states that are within two deviations of the truth."""
    found = {each.first.stamp: each.first for each in estimates}
    first = recording.stamps[0] + settled * (recording.stamps[-1] - recording.stamps[0])
    within = list[Array]()
    for stamp, x in zip(recording.stamps.tolist(), recording.states, strict=True):
        if stamp in found and stamp >= first:
            own = found[stamp]
            deviation = np.sqrt(np.diag(np.asarray(own.covariance)))
            within.append(np.abs(np.append(own.q, own.u) - x) <= 2 * deviation)
    return float(np.mean(within))


def elsewhere(_: Checkout, _folder: Path, seed: int, *, name: str, jitter: float) -> Figures:
    """After ``identify``: states by ``observe`` and ``smooth`` on another recording."""
    plant, shares = rigs()[name], list[list[float]]()
    for k in range(DRAWS // 4):
        one, other = (recorded(plant, 1000 * (seed + 1) + 2 * k + i, jitter) for i in (0, 1))
        found = identify(plant.family, one.events)
        d = found.start.size
        known = ParameterUncertainty(found.family.names, found.covariance[d:, d:])
        given = replace(plant.model, uncertainty=None)
        model = Model(
            plant.family.system_at(found.values), uncertainty=known, elements=given.elements
        )
        options = Options(
            epoch=EPOCH,
            clock_error=found.verdict.clock,
            initial_deviation=suggested_deviation(model.system) or Options.initial_deviation,
        )
        smoothed = [
            share_within(
                [*smoothed_runs(model, each.events, options)[0].estimates(each.stamps)], each, 0.0
            )
            for each in (one, other)
        ]
        observer = make_observer(model, replace(options, law="minimum-variance"))
        made = replay_batches(observer, other.events, other.stamps)
        observed = [each for each in made if isinstance(each, Estimates)]
        shares.append([*smoothed, share_within(observed, other, 0.25)])
    names = "smooth, same recording", "smooth, another", "observe, another"
    return {
        f"within two deviations, {each}": Figure(value)
        for each, value in zip(names, np.mean(shares, axis=0).tolist(), strict=True)
    }


def wrong(_: Checkout, _folder: Path, seed: int, *, which: WrongPlant) -> Figures:
    """A wrong plant: whether the verdict is no, and smoothed states within two deviations."""
    recording = which.run(seed, 60.0)
    events = [*recording.events(which.model)]
    kept = recording.away(_AWAY)
    truth = Recorded(events, recording.sample_stamps[kept][::5], recording.states[kept][::5])
    options = Options(
        epoch=EPOCH,
        initial_deviation=suggested_deviation(which.model) or Options.initial_deviation,
    )
    begun = time.process_time()
    (run,) = smoothed_runs(which.model, events, options)
    seconds = time.process_time() - begun
    sizes = run.found.fit.sizes
    return {
        "says no": Figure(float(bool(run.misfit))),
        "within two deviations": Figure(share_within([*run.estimates(truth.stamps)], truth, 0.0)),
        "clock": Figure(sizes.clock, "s"),
        "scatter": Figure(sizes.scatter),
        "model": Figure(sizes.model),
        "processor time an impact": Figure(seconds / len(events), "s"),
    }


def durations(_: Checkout, _folder: Path, seed: int, *, hits: int) -> Figures:
    """Processor times of ``identify`` and ``smooth``."""
    plant = rigs()["two_mass"]._replace(seconds=1.4 * hits)
    recording = recorded(plant, seed, 1e-5)
    events = recording.events[:hits]
    found = dict[str, Figure]()

    def timed(what: str, action: Callable[[], object]) -> None:
        begun = time.process_time()
        action()
        found[what] = Figure(time.process_time() - begun, "s")

    found["hits"] = Figure(float(len(events)))
    timed("identify, right set", lambda: tried(plant, events))
    timed("identify, wrong set", lambda: tried(plant._replace(free=("restitution",)), events))
    right = plant.true_system
    usual = suggested_deviation(right) or Options.initial_deviation
    options = Options(epoch=EPOCH, clock_error=1e-5, initial_deviation=usual)
    timed("smooth", lambda: smoothed_runs(right, events, options)[0].fit.covariance)
    rng = np.random.default_rng(seed)
    spread = np.cumsum(rng.uniform(0.3, 2.5, len(events)) * NS_PER_S).astype(np.int64)
    odd = [replace(e, stamp=EPOCH + int(by)) for e, by in zip(events, spread, strict=True)]
    timed("identify, hits that nothing explains", lambda: tried(plant, odd))
    return found


ROWS = (
    *(
        Row(
            f"fit, {name}, jitter {jitter:g} s",
            "are standard errors right?",
            partial(draws, name=name, jitter=jitter, scatter=0.0),
        )
        for name in rigs()
        for jitter in (1e-5, 1e-4, 1e-3)
    ),
    *(
        Row(
            f"fit, {name}, restitution scatters",
            "are standard errors right where the restitution scatters by 0.02?",
            partial(draws, name=name, jitter=1e-5, scatter=0.02),
        )
        for name in rigs()
    ),
    *(
        Row(
            f"fit, two_mass, {trouble}",
            "does it fit with faults of the sensor?",
            partial(troubled, name="two_mass", trouble=trouble),
        )
        for trouble in TROUBLES
    ),
    Row(
        "fit, two_mass, frequency",
        "is a wrong frequency named?",
        partial(frequency, name="two_mass"),
    ),
    *(
        Row(
            f"fit, {name}, elsewhere",
            "are estimates honest on other recordings?",
            partial(elsewhere, name=name, jitter=1e-4),
        )
        for name in ("two_mass", "three_mass", "hammer", "drill")
    ),
    *(
        Row(f"fit of {hits} hits", "how long does it take?", partial(durations, hits=hits))
        for hits in (100, 1000)
    ),
    *(
        Row(f"smooth, {each.name}, {each.group}", each.what, partial(wrong, which=each))
        for each in plants()
    ),
)
"""Rows of ``./dev bench fits``."""
