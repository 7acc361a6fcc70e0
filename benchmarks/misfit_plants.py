# SPDX-License-Identifier: Apache-2.0
"""Plants that are not the model which the observer is given, and exact ones as control.

``plants()`` lists them. Half of them are for tuning, half are held back: each kind of misfit is in
both groups, on different models. The observer is given ``WrongPlant.model`` and the stamps and
contacts of a ``Recording``, and should start at zero; the plant starts at random. A run is a
function of its seed.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Literal

import numpy as np

from benchmarks.misfit_bases import LARGEST, bases
from benchmarks.misfit_motion import AccumulationError, Array, Force, Motion, Recording, Truth
from impact_observer.model import Contact, Forcing, System

Group = Literal["tuned", "held back"]
Run = Callable[[int, float], Recording]
Attempt = Callable[[Array, float, np.random.Generator], Recording]
"""A run of some length, s, from an initial state."""
_TRIES = 50
"""Initial states that are drawn before a run is given up."""


@dataclass(frozen=True, slots=True, eq=False)
class WrongPlant:
    """A plant beside the model of it.

    Attributes:
        name: without spaces.
        kind: of the misfit; ``exact`` for none.
        what: differs from the model, in a line.
        group: what it is for.
        model: what the observer is given.
        run: of a seed and a length in s.
    """

    name: str
    kind: str
    what: str
    group: Group
    model: System
    run: Run


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of misfit.

    Attributes:
        name: of the kind.
        what: differs, with a place for the size.
        truth: of a size and a model.
        rows: sizes, each with the names of the models for tuning and held back.
    """

    name: str
    what: str
    truth: Callable[[float, System], Truth]
    rows: tuple[tuple[float, str, str], ...]


def drawn(system: System, hidden: int, rng: np.random.Generator) -> Array:
    """An initial state inside no stop.

    Hidden bodies start with the displacement and velocity of the first body.
    """
    n = system.n - hidden
    while True:
        q, u = rng.normal(size=(2, n)) * np.array([[0.2], [0.7]])
        x = np.concatenate([q, np.repeat(q[0], hidden), u, np.repeat(u[0], hidden)])
        if np.all(system.gap(x[: system.n]) > 0.01):
            return x


def run(attempt: Attempt, system: System, hidden: int, seed: int, seconds: float) -> Recording:
    """A run whose impacts do not accumulate, from the first such initial state.

    Raises:
        AccumulationError: they do from every state that is tried.
    """
    start, n = np.random.default_rng([2014, seed]), system.n
    for _ in range(_TRIES):
        x = drawn(system, hidden, start)
        try:
            found = attempt(x, seconds, np.random.default_rng([2026, seed]))
        except AccumulationError:
            continue
        seen = np.arange(n - hidden)
        return replace(found, states=found.states[:, np.append(seen, n + seen)])
    raise AccumulationError(f"{system.name}: impacts accumulate from {_TRIES} states")


def follow(truth: Truth, x: Array, seconds: float, rng: np.random.Generator) -> Recording:
    """A run of a plant from ``x``."""
    return Motion(truth, x, seconds, rng).run()


def exact(_: float, system: System) -> Truth:
    """No misfit."""
    return Truth(system)


def stiffness(by: float, system: System) -> Truth:
    """All springs are stiffer by a factor ``1 + by``."""
    return Truth(replace(system, K=(1 + by) * system.K))


def damping(by: float, system: System) -> Truth:
    """All dampers are stronger by a factor ``1 + by``."""
    return Truth(replace(system, C=(1 + by) * system.C))


def with_stops(system: System, changed: Callable[[Contact], Contact]) -> System:
    """The same with other stops."""
    return replace(system, contacts=tuple(map(changed, system.contacts)))


def restitution(by: float, system: System) -> Truth:
    """All restitutions are larger by a factor ``1 + by``."""
    return Truth(with_stops(system, lambda c: replace(c, restitution=(1 + by) * c.restitution)))


def gap(by: float, system: System) -> Truth:
    """All gaps at rest are larger by a factor ``1 + by``."""
    return Truth(with_stops(system, lambda c: replace(c, gap=(1 + by) * c.gap)))


def speed_power(power: float, system: System) -> Truth:
    """Restitution is the model's over (speed in m/s) to a power, at most 0.98."""
    return Truth(system, restitution=lambda eps, v, _t, _rng: min(eps / v**power, 0.98))


def random_restitution(deviation: float, system: System) -> Truth:
    """Each impact has a restitution of its own, at most 0.98."""
    return Truth(
        system,
        restitution=lambda eps, _v, _t, rng: min(eps * (1 + deviation * rng.normal()), 0.98),
    )


def restitution_drift(by: float, system: System) -> Truth:
    """Restitution falls linearly, by a factor ``1 - by`` after 60 s."""
    return Truth(system, restitution=lambda eps, _v, t, _rng: eps * (1 - by * t / 60))


def stiffness_drift(by: float, system: System) -> Truth:
    """All stiffness grows linearly, by a factor ``1 + by`` after 60 s."""
    return Truth(system, force=lambda t, q, _: -by * t / 60 * (system.K @ q))


def first_spring(system: System, change: Callable[[float], float]) -> Force:
    """The force by which the spring from the ground to the first body is not linear.

    ``change`` gives its elongation, m, that a linear spring would need for the same force.
    """
    k, axis = float(np.sum(system.K[0])), np.eye(system.n)[0]
    return lambda _t, q, _u: np.asarray(k * (q[0] - change(q[0])) * axis)


def pendulum(angle: float, system: System) -> Truth:
    """The first body is a pendulum that reaches ``angle``, rad: ``k l sin(q / l)``."""
    length = LARGEST[system.name] / angle
    return Truth(system, first_spring(system, lambda q: length * float(np.sin(q / length))))


def hardening(by: float, system: System) -> Truth:
    """The first spring has a cubic part, ``by`` of its force at the largest displacement."""
    cubic = by / LARGEST[system.name] ** 2
    return Truth(system, first_spring(system, lambda q: q + cubic * q**3))


def friction(by: float, system: System) -> Truth:
    """The first body has dry friction, ``by`` of the largest amplitude of a force.

    It has its sign within 0.02 m/s.
    """
    forcing = system.forcing
    largest = float(np.max(np.hypot(forcing.cosine, forcing.sine)))
    axis = np.eye(system.n)[0]
    return Truth(system, lambda _t, _q, u: -by * largest * np.tanh(u[0] / 0.02) * axis)


def finite_contact(seconds: float, system: System) -> Truth:
    """Stops are springs with dampers that give the model's restitution in this time."""
    return Truth(system, contact_time=seconds)


def hidden_mass(mass: float, system: System) -> Truth:
    """A body of this mass, kg, on a spring at the first body, with an eigenfrequency of 11 rad/s.

    The first body is lighter by as much.
    """
    n, k, c = system.n, mass * 11.0**2, 0.1 * mass * 11.0
    row = np.eye(n + 1)[n] - np.eye(n + 1)[0]
    M, C, K = (np.pad(matrix, (0, 1)) for matrix in (system.M, system.C, system.K))
    M[n, n], M[0, 0] = mass, M[0, 0] - mass
    f = system.forcing
    return Truth(
        System(
            system.name,
            (*system.coordinates, "hidden"),
            M,
            C + c * np.outer(row, row),
            K + k * np.outer(row, row),
            Forcing(
                np.pad(f.constant, (0, 1)),
                f.frequency,
                np.pad(f.cosine, ((0, 0), (0, 1))),
                np.pad(f.sine, ((0, 0), (0, 1))),
            ),
            tuple(
                replace(each, direction=np.pad(each.direction, (0, 1))) for each in system.contacts
            ),
        )
    )


def force_amplitude(by: float, system: System) -> Truth:
    """All forces are larger by a factor ``1 + by``."""
    f = system.forcing
    return Truth(
        replace(system, forcing=replace(f, cosine=(1 + by) * f.cosine, sine=(1 + by) * f.sine))
    )


def force_frequency(by: float, system: System) -> Truth:
    """All forces are faster by a factor ``1 + by``."""
    f = system.forcing
    return Truth(replace(system, forcing=replace(f, frequency=(1 + by) * f.frequency)))


KINDS = (
    Kind(
        "exact",
        "nothing",
        exact,
        (
            (0, "two_mass", "three_mass"),
            (0, "one_stop", "two_stops"),
            (0, "four_mass", "drill"),
        ),
    ),
    Kind(
        "stiffness",
        "springs are stiffer by {:.1%}",
        stiffness,
        (
            (0.001, "two_mass", "four_mass"),
            (0.01, "three_mass", "two_mass"),
            (0.05, "drill", "three_mass"),
        ),
    ),
    Kind(
        "damping",
        "dampers are stronger by {:.0%}",
        damping,
        ((0.05, "three_mass", "one_stop"), (0.3, "two_stops", "two_mass")),
    ),
    Kind(
        "restitution",
        "restitutions are larger by {:.1%}",
        restitution,
        (
            (0.001, "three_mass", "drill"),
            (0.01, "two_mass", "three_mass"),
            (0.05, "four_mass", "two_stops"),
        ),
    ),
    Kind(
        "restitution-by-speed",
        "restitution is proportional to speed to the power -{:g}",
        speed_power,
        ((0.05, "two_mass", "four_mass"), (0.1, "one_stop", "two_mass")),
    ),
    Kind(
        "random-restitution",
        "each impact has its own restitution, deviation {:.0%}",
        random_restitution,
        ((0.03, "three_mass", "two_mass"),),
    ),
    Kind(
        "pendulum",
        "the first body is a pendulum, to {:g} rad",
        pendulum,
        ((0.25, "four_mass", "one_stop"), (0.5, "two_mass", "three_mass")),
    ),
    Kind(
        "hardening",
        "the first spring is cubic, by {:.0%} at the largest displacement",
        hardening,
        ((0.02, "three_mass", "drill"), (0.1, "two_stops", "two_mass")),
    ),
    Kind(
        "friction",
        "the first body has dry friction, {:.0%} of the forcing",
        friction,
        ((0.01, "two_mass", "three_mass"), (0.05, "one_stop", "four_mass")),
    ),
    Kind(
        "finite-contact",
        "contacts last {:g} s",
        finite_contact,
        (
            (0.001, "two_mass", "three_mass"),
            (0.002, "drill", "two_stops"),
            (0.004, "three_mass", "two_mass"),
            (0.0003, "drill", "two_stops"),
        ),
    ),
    Kind(
        "hidden-mass",
        "{:g} kg of the first body are on a spring",
        hidden_mass,
        ((0.03, "two_mass", "four_mass"), (0.1, "three_mass", "drill")),
    ),
    Kind(
        "stiffness-drift",
        "stiffness grows by {:.0%} in 60 s",
        stiffness_drift,
        ((0.02, "three_mass", "two_mass"),),
    ),
    Kind(
        "restitution-drift",
        "restitution falls by {:.0%} in 60 s",
        restitution_drift,
        ((0.02, "two_mass", "three_mass"),),
    ),
    Kind(
        "force-amplitude",
        "forces are larger by {:.0%}",
        force_amplitude,
        ((0.02, "four_mass", "two_mass"),),
    ),
    Kind(
        "force-frequency",
        "forces are faster by {:.2%}",
        force_frequency,
        ((0.0005, "two_mass", "three_mass"),),
    ),
    Kind("gap", "gaps are larger by {:.0%}", gap, ((0.01, "three_mass", "two_mass"),)),
)


@cache
def plants() -> tuple[WrongPlant, ...]:
    """All plants, in the order of the table."""
    return tuple(_plants())


def _plants() -> Iterator[WrongPlant]:
    groups: tuple[Group, Group] = ("tuned", "held back")
    for kind in KINDS:
        for size, *names in kind.rows:
            for group, base in zip(groups, names, strict=True):
                model = bases()[base]
                name = f"{base}-{kind.name}" + (f"-{size:g}" if size else "")
                job = _run_of(kind, size, model)
                yield WrongPlant(name, kind.name, kind.what.format(size), group, model, job)


def _run_of(kind: Kind, size: float, model: System) -> Run:
    truth = kind.truth(size, model)
    return partial(run, partial(follow, truth), truth.system, truth.system.n - model.n)
