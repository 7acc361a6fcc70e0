# SPDX-License-Identifier: Apache-2.0
"""Plants and sensors that are not as declared, and exact ones: the rows of ``honest``.

Each misfit has two rows, on different rigs: one for tuning, one that is held out. A run is drawn
from its seed: the phases of the forcing, the initial state, and the size of the misfit, which is
half to one and a half of the nominal one, of either sign where both make sense.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from benchmarks import misfit_plants as plants
from benchmarks.misfit_bases import bases
from benchmarks.misfit_motion import (
    EPOCH,
    RATE,
    AccumulationError,
    Array,
    Motion,
    Stamps,
    Truth,
)
from benchmarks.misfit_plants import drawn, with_stops
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.kernel._kernel import TINY
from impact_observer.model import Forcing, System, parse_model
from impact_observer.options import Options
from impact_observer.plant import Plant, Switching, simulate
from impact_observer.stamps import from_seconds, grid

SECONDS = 60.0
LONGER = {"three_mass": 2.0, "plane-a": 2.0, "plane-b": 2.0}
"""Factors of the length of runs, by rig, where impacts are rare."""
EVERY = 2
"""Of the samples of ``misfit_motion``, those that are compared."""
DEFAULT = Options(law="minimum-variance", epoch=EPOCH)
CHANGE = 30.0
"""When a plant or a clock changes that is right before, s."""
FORGOTTEN = 2.3
"""Frequency of a forcing that is not in the model, over that of the first harmonic."""

PRESS = """
name: press
bodies: [{{name: ram, mass: {0}}}, {{name: tool, mass: {1}}}]
springs:
  - {{between: [ground, ram], stiffness: {2}, damping: 0.6}}
  - {{between: [ram, tool], stiffness: {3}, damping: 0.4}}
forces: [{{body: tool, constant: {4}}}, {{body: ram, amplitude: {5}, frequency: {6}}}]
stops: [{{name: die, body: tool, limit: 0.05, side: above, restitution: 0.3}}]
"""
PLANE = """
name: plane
coordinates: [x, y]
mass: [[{0}, 0], [0, 1]]
damping: [[{1}, 0], [0, 0.2]]
stiffness: [[{2}, {3}], [{3}, {4}]]
forcing:
  harmonics: [{{frequency: {5}, cosine: [{6}, 4], sine: [0, 0]}}]
contacts: [{{name: stop, direction: [0, -1], gap: {7}, restitution: 0.8}}]
"""


class Hit(NamedTuple):
    """A change of a contact, as the plant makes it or a sensor reports it.

    Attributes:
        stamp: ns.
        contact: name.
        kind: of the change.
        speed: of approach, m/s; 0 where it is not known.
    """

    stamp: int
    contact: str
    kind: Kind
    speed: float = 0.0


Size = float
Rng = np.random.Generator
Sensor = Callable[[Size, Sequence[Hit], Rng], Sequence[Hit]]
"""What a sensor reports of hits, by the size of its fault."""


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """In what a plant or its sensor is not as declared.

    Attributes:
        name: in the table.
        rigs: names of the rig for tuning and of the one that is held out.
        size: nominal.
        truth: of a size and the declared system; the declared plant by default.
        sensor: of the size; ideal by default.
        signed: whether the size has either sign.
        jitter: standard deviation of the stamps, s.
        declared: options of the observer.
        since: when the misfit begins, s.
        synchronized: least share of samples that should be synchronized; 0 for no goal.
        exact: whether nothing is wrong.
    """

    name: str
    rigs: tuple[str, str]
    size: Size = 0.0
    truth: Callable[[Size, System], Truth] = plants.exact
    sensor: Sensor | None = None
    signed: bool = True
    jitter: float = 0.0
    declared: Options = DEFAULT
    since: float = 0.0
    synchronized: float = 0.0
    exact: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A run of a plant.

    Attributes:
        model: what the observer is given.
        truth: the plant.
        events: what the sensor reports.
        stamps: of the samples, ns, shape (samples,).
        states: true (q, u) in the coordinates of the model, shape (samples, 2n).
        hits: true stamps, ns, ascending.
        size: of the misfit.
        start: the true (q, u) at the epoch in the coordinates of the model and of the plant.
    """

    model: System
    truth: Truth
    events: tuple[ImpactEvent, ...]
    stamps: Stamps
    states: Array
    hits: Stamps
    size: Size
    start: tuple[Array, Array]


@cache
def rigs() -> dict[str, System]:
    """The models, by name."""
    made = {
        "press-a": PRESS.format(2, 0.5, 30, 60, 4, 12, 2.2),
        "press-b": PRESS.format(1.2, 0.8, 45, 50, 5, 14, 2.9),
        "plane-a": PLANE.format(1, 0.1, 12, -1.5, 15, 3, 2, 0.25),
        "plane-b": PLANE.format(0.7, 0.15, 21, -2.5, 11, 2.6, 3, 0.3),
    }
    return bases() | {name: parse_model(text, name).system for name, text in made.items()}


def moved(truth: Truth, x: Array, seconds: float, rng: Rng) -> tuple[list[Hit], Stamps, Array]:
    """What the contacts do, sample stamps and states of a plant from ``x``.

    Linear plants with rigid stops are the package's own, which rest on stops; others move by
    ``misfit_motion``.
    """
    system = truth.system
    if truth.is_linear:
        stamps = grid(EPOCH, EPOCH + from_seconds(seconds), RATE / EVERY)
        run = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps)
        hits = [
            Hit(each.instant.stamp, switch.contact, switch.kind, speed_of(system, each, switch))
            for each in run.switchings
            for switch in each.switches
        ]
        return hits, stamps, run.states
    found = Motion(truth, x, seconds, rng).run()
    pairs = zip(found.stamps.tolist(), found.contacts.tolist(), strict=True)
    made = [Hit(stamp, system.contact_names[i], Kind.IMPACT) for stamp, i in pairs]
    return made, found.sample_stamps[::EVERY], found.states[::EVERY]


def speed_of(system: System, switching: Switching, switch: Switch) -> float:
    """The speed at which a contact closes, m/s."""
    speeds = system.W.T @ switching.before[system.n :]
    return float(-speeds[system.contact_names.index(switch.contact)])


def coupling(by: Size, system: System) -> Truth:
    """The stiffness between the first two coordinates is larger by a factor ``1 + by``."""
    K = np.array(system.K)
    K[[0, 1], [1, 0]] *= 1 + by
    return Truth(replace(system, K=K))


def first_mass(by: Size, system: System) -> Truth:
    """The first body is heavier by a factor ``1 + by``."""
    M = np.array(system.M)
    M[0, 0] *= 1 + by
    return Truth(replace(system, M=M))


def with_forcing(system: System, added: Forcing) -> Truth:
    """A plant with another force."""
    return Truth(replace(system, forcing=system.forcing.added(added)))


def constant_force(force: Size, system: System) -> Truth:
    """A constant force on the last coordinate, N."""
    return with_forcing(system, Forcing.none(system.n).plus(force * np.eye(system.n)[-1]))


def press_force(by: Size, system: System) -> Truth:
    """The constant force is larger by a factor ``1 + by``."""
    return with_forcing(system, Forcing.none(system.n).plus(by * system.forcing.constant))


def force_on(by: Size, system: System) -> Truth:
    """The forces on the first coordinate are larger by a factor ``1 + by``."""
    f, first = system.forcing, np.eye(system.n)[0]
    larger = {"cosine": f.cosine * (1 + by * first), "sine": f.sine * (1 + by * first)}
    return Truth(replace(system, forcing=replace(f, **larger)))


def force_phase(by: Size, system: System) -> Truth:
    """All forces are ahead by an angle, rad."""
    f = system.forcing
    c, s = np.cos(by), np.sin(by)
    ahead = {"cosine": c * f.cosine + s * f.sine, "sine": c * f.sine - s * f.cosine}
    return Truth(replace(system, forcing=replace(f, **ahead)))


def second_force(by: Size, system: System) -> Truth:
    """Another harmonic on all bodies, ``by`` of the first one."""
    f = system.forcing
    size = by * np.max(np.hypot(f.cosine[0], f.sine[0])) * np.ones((1, system.n))
    return with_forcing(
        system, Forcing(np.zeros(system.n), FORGOTTEN * f.frequency[:1], size, 0 * size)
    )


def gap_by(metres: Size, system: System) -> Truth:
    """All gaps are larger by so many m."""
    return Truth(with_stops(system, lambda c: replace(c, gap=c.gap + metres)))


def maxwell(by: Size, system: System) -> Truth:
    """A spring of ``by`` of the first body's stiffness, in series with a damper, holds it.

    Its force decays in 0.3 s; the joint between both has 1 g.
    """
    n = system.n
    k = by * system.K[0, 0]
    row = np.eye(n + 1)[n] - np.eye(n + 1)[0]
    M, C, K = (np.pad(matrix, (0, 1)) for matrix in (system.M, system.C, system.K))
    M[n, n], C[n, n] = 1e-3, C[n, n] + 0.3 * k
    wider = np.eye(n + 1, n)
    return Truth(
        System(
            system.name,
            (*system.coordinates, "joint"),
            M,
            C,
            K + k * np.outer(row, row),
            system.forcing.mapped(wider),
            tuple(replace(each, direction=wider @ each.direction) for each in system.contacts),
        )
    )


def forcing_ends(_: Size, system: System) -> Truth:
    """All forces end at ``CHANGE``."""
    return Truth(system, lambda t, _q, _u: (t >= CHANGE) * -system.forcing(t))


def spring_cracks(by: Size, system: System) -> Truth:
    """All springs are softer by ``by`` from ``CHANGE`` on."""
    return Truth(system, lambda t, q, _u: (t >= CHANGE) * by * (system.K @ q))


def coulomb(coefficient: Size, system: System) -> Truth:
    """The stop rubs, with Coulomb's coefficient."""
    return Truth(system, slip=coefficient)


def debounced(gap: Size, hits: Sequence[Hit], _: Rng) -> Sequence[Hit]:
    """A row of hits, less than ``gap`` s apart, is reported by its first edge.

    It is reported as CLOSE if the contact rests at the end of the row.
    """
    reported: list[Hit] = []
    last, wide = -np.inf, from_seconds(gap)
    for hit in hits:
        if hit.kind is Kind.OPEN or hit.stamp - last > wide:
            reported.append(hit)
        elif hit.kind is Kind.CLOSE:
            reported[-1] = reported[-1]._replace(kind=Kind.CLOSE)
        last = hit.stamp
    return reported


def echoed(share: Size, hits: Sequence[Hit], rng: Rng) -> Sequence[Hit]:
    """A share of hits is reported again, 5 to 50 ms later."""
    late = rng.uniform(5e-3, 5e-2, len(hits))
    again = rng.random(len(hits)) < share
    echoes = [
        hit._replace(stamp=hit.stamp + from_seconds(dt))
        for hit, dt, does in zip(hits, late.tolist(), again, strict=True)
        if does
    ]
    return [*hits, *echoes]


def missed(share: Size, hits: Sequence[Hit], rng: Rng) -> Sequence[Hit]:
    """A share of hits is not reported."""
    return [hit for hit in hits if rng.random() >= share]


def stepped(by: Size, hits: Sequence[Hit], _: Rng) -> Sequence[Hit]:
    """The sensor's clock is ahead by ``by`` s from ``CHANGE`` on."""
    since = EPOCH + from_seconds(CHANGE)
    return [h._replace(stamp=h.stamp + (h.stamp >= since) * from_seconds(by)) for h in hits]


def drifting(by: Size, hits: Sequence[Hit], _: Rng) -> Sequence[Hit]:
    """The sensor's clock is faster by a factor ``1 + by``."""
    return [h._replace(stamp=h.stamp + round(by * (h.stamp - EPOCH))) for h in hits]


def late_by_strength(by: Size, hits: Sequence[Hit], _: Rng) -> Sequence[Hit]:
    """A hit is reported ``by`` s over its speed in m/s later, at most 20 ms."""
    late = [min(by / max(h.speed, TINY), 0.02) for h in hits]
    return [h._replace(stamp=h.stamp + from_seconds(dt)) for h, dt in zip(hits, late, strict=True)]


PRESSES, PLANES = ("press-a", "press-b"), ("plane-a", "plane-b")
ONE, TWO, MANY = ("one_stop", "two_stops"), ("two_mass", "three_mass"), ("drill", "four_mass")
JITTERED, FEWER = replace(DEFAULT, clock_error=1e-3), replace(DEFAULT, missed=0.2)

MISFITS = (
    Misfit("press force 1 %", PRESSES, 0.01, press_force),
    Misfit("press force 3 %", PRESSES, 0.03, press_force),
    Misfit("press, debounced", PRESSES, 0.1, sensor=debounced, signed=False),
    Misfit("coupling 3 %", PLANES, 0.03, coupling),
    Misfit("x-force 10 %", PLANES, 0.1, force_on),
    Misfit("stop rubs, 0.2", PLANES, 0.2, coulomb, signed=False),
    Misfit(
        "stop rubs, jitter", PLANES, 0.2, coulomb, signed=False, jitter=1e-3, declared=JITTERED
    ),
    Misfit("constant force 0.2 N", TWO, 0.2, constant_force),
    Misfit("mass 5 %", MANY, 0.05, first_mass),
    Misfit("gap 1 mm", TWO, 1e-3, gap_by),
    Misfit("Maxwell branch 5 %", MANY, 0.05, maxwell, signed=False),
    Misfit("force 10 %", ONE, 0.1, plants.force_amplitude),
    Misfit("forcing ends", MANY, truth=forcing_ends, since=CHANGE),
    Misfit("clock steps 0.1 s", TWO, 0.1, sensor=stepped, since=CHANGE),
    Misfit("undeclared jitter", TWO, jitter=5e-4, synchronized=0.8),
    Misfit("echoes of 70 %", MANY, 0.7, sensor=echoed, signed=False, synchronized=0.8),
    Misfit("stiffness 2 %", MANY, 0.02, plants.stiffness),
    Misfit("damping 20 %", TWO, 0.2, plants.damping),
    Misfit("restitution 3 %", MANY, 0.03, plants.restitution),
    Misfit("restitution by speed", ONE, 0.1, plants.speed_power, signed=False),
    Misfit("random restitution", TWO, 0.03, plants.random_restitution),
    Misfit("pendulum 0.4 rad", TWO, 0.4, plants.pendulum, signed=False),
    Misfit("hidden mass 0.1 kg", MANY, 0.1, plants.hidden_mass, signed=False),
    Misfit("frequency 0.1 %", ONE, 1e-3, plants.force_frequency),
    Misfit("phase 0.05 rad", MANY, 0.05, force_phase),
    Misfit("second harmonic 5 %", TWO, 0.05, second_force),
    Misfit("contacts of 2 ms", ONE, 2e-3, plants.finite_contact, signed=False),
    Misfit("springs soften 3 %", TWO, 0.03, spring_cracks, signed=False, since=CHANGE),
    Misfit("clock fast by 1e-4", MANY, 1e-4, sensor=drifting),
    Misfit("late by strength", TWO, 1e-3, sensor=late_by_strength, signed=False),
    Misfit("exact", TWO, synchronized=0.95, exact=True),
    Misfit("exact, press", PRESSES, synchronized=0.95, exact=True),
    Misfit("exact, plane", PLANES, synchronized=0.95, exact=True),
    Misfit("exact, jitter", MANY, jitter=1e-3, declared=JITTERED, synchronized=0.95, exact=True),
    Misfit(
        "exact, missed",
        TWO,
        0.2,
        sensor=missed,
        signed=False,
        declared=FEWER,
        synchronized=0.95,
        exact=True,
    ),
)


class Row(NamedTuple):
    """A misfit on a rig.

    Attributes:
        misfit: which.
        rig: name of the model.
        held_out: whether it is held out from tuning.
    """

    misfit: Misfit
    rig: str
    held_out: bool

    @property
    def name(self) -> str:
        """On the command line."""
        return f"{self.misfit.name}, {self.rig}"


ROWS = tuple(
    Row(misfit, rig, held_out)
    for misfit in MISFITS
    for rig, held_out in zip(misfit.rigs, (False, True), strict=True)
)


def turned(system: System, by: float) -> System:
    """The same with a forcing that began ``by`` s earlier."""
    f, wave = system.forcing, (system.forcing.frequency * by)[:, None]
    return replace(
        system,
        forcing=replace(
            f,
            cosine=np.cos(wave) * f.cosine + np.sin(wave) * f.sine,
            sine=np.cos(wave) * f.sine - np.sin(wave) * f.cosine,
        ),
    )


def case(misfit: Misfit, rig: str, seed: int) -> Case:
    """A run, from the first initial state from which its integrator can make one."""
    rng = np.random.default_rng([2047, seed, *f"{misfit.name} {rig}".encode()])
    model = turned(rigs()[rig], rng.uniform(0.0, 60.0))
    size = misfit.size * rng.uniform(0.5, 1.5)
    if misfit.signed:
        size *= rng.choice((-1.0, 1.0))
    truth = misfit.truth(size, model)
    seen = np.arange(model.n)
    kept = np.append(seen, truth.system.n + seen)
    while True:
        x = drawn(truth.system, truth.system.n - model.n, rng)
        try:
            hits, stamps, states = moved(truth, x, SECONDS * LONGER.get(rig, 1.0), rng)
        except AccumulationError:
            continue
        break
    reported = hits if misfit.sensor is None else misfit.sensor(size, hits, rng)
    late = from_seconds(misfit.jitter) * rng.normal(size=len(reported))
    pairs = zip(reported, late, strict=True)
    sent = sorted(hit._replace(stamp=hit.stamp + round(dt)) for hit, dt in pairs)
    events = tuple(
        ImpactEvent(max(hit.stamp, EPOCH), (Switch(hit.contact, hit.kind),), k, 1, EPOCH)
        for k, hit in enumerate(sent, start=1)
    )
    true = np.array([hit.stamp for hit in hits], np.int64)
    return Case(model, truth, events, stamps, states[:, kept], true, size, (x[kept], x))
