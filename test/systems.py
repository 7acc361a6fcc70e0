# SPDX-License-Identifier: Apache-2.0
"""Systems, motions and switching sequences for the tests of the core.

The strategies draw every number by itself, from a grid of multiples of 1/64, so that a failing
example shrinks to one with small whole numbers and zeros.
"""

import gc
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from types import FunctionType, ModuleType
from typing import NamedTuple

import numpy as np
from hypothesis import assume, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from impact_observer.dynamics import Flow, Phases, lyapunov
from impact_observer.errors import ImpactLawError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import Contact, Forcing, Model, System, parse_model, read_model
from impact_observer.model.force_samples import Samples
from impact_observer.model.grounds import Grounds
from impact_observer.model.system import moving_system
from impact_observer.observer import Observer, ReplicaLaw, law_named
from impact_observer.observer.belief import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.plant import Plant, Run, simulate
from impact_observer.plant.switching import Switching
from impact_observer.stamps import NS_PER_S, grid

Array = NDArray[np.float64]

EPOCH = 5 * NS_PER_S
"""An epoch that is not zero, ns."""


def state_matrix(model: System) -> Array:
    """``A`` of ``d(q, u)/dt = A (q, u)``."""
    stiff, damped = (np.linalg.solve(model.M, part) for part in (model.K, model.C))
    return np.block([[np.zeros_like(stiff), np.eye(model.n)], [-stiff, -damped]])


def examples(count: int) -> settings:
    """Settings with the same ``count`` examples on every machine; a part of them on request."""
    part = int(os.environ.get("FEWER_EXAMPLES", "1"))  # as ./dev test sets it
    count = -(-count // part)
    return settings(max_examples=count, derandomize=True, deadline=None, database=None)


@cache
def sample(name: str) -> Model:
    """A sample model by its name."""
    return read_model(name)


class Harmonic(NamedTuple):
    """``cosine cos(frequency t) + sine sin(frequency t)``."""

    frequency: float
    cosine: Sequence[float]
    sine: Sequence[float]


def forcing(n: int, constant: ArrayLike = 0.0, harmonics: Sequence[Harmonic] = ()) -> Forcing:
    """A forcing of ``n`` coordinates."""
    h = len(harmonics)
    return Forcing(
        np.broadcast_to(np.asarray(constant, dtype=float), (n,)),
        np.array([part.frequency for part in harmonics], dtype=float),
        np.reshape([part.cosine for part in harmonics], (h, n)).astype(float),
        np.reshape([part.sine for part in harmonics], (h, n)).astype(float),
    )


def system(
    M: ArrayLike,
    C: ArrayLike,
    K: ArrayLike,
    *,
    contacts: Sequence[tuple[ArrayLike, float, float]] = (),
    force: Forcing | None = None,
) -> System:
    """A system from its matrices and contacts ``(direction, gap, restitution)``."""
    M, C, K = (np.atleast_2d(np.asarray(matrix, dtype=float)) for matrix in (M, C, K))
    n = len(M)
    return System(
        name="test",
        coordinates=tuple(f"x{i + 1}" for i in range(n)),
        M=M,
        C=C,
        K=K,
        forcing=Forcing.none(n) if force is None else force,
        contacts=tuple(
            Contact(f"c{i + 1}", np.asarray(direction, dtype=float), gap, eps)
            for i, (direction, gap, eps) in enumerate(contacts)
        ),
    )


def jammed(floor: float, ceiling: float, velocity: float) -> str:
    """A model file: a mass between two stops without play, of two restitutions."""
    return f"""
name: jammed
bodies: [{{name: x, mass: 1}}]
stops:
  - {{name: floor, body: x, limit: 0, side: below, restitution: {floor}}}
  - {{name: ceiling, body: x, limit: 0, side: above, restitution: {ceiling}}}
initial_state: {{position: [0], velocity: [{velocity}]}}
"""


def press(force: float = 4.5, restitution: float = 0.3) -> Model:
    """A tool that a ram presses onto its die in every period, where it bounces until it rests."""
    return parse_model(
        "name: press\n"
        "bodies: [{name: ram, mass: 1.6}, {name: tool, mass: 0.6}]\n"
        "springs:\n"
        "  - {between: [ground, ram], stiffness: 38, damping: 0.5}\n"
        "  - {between: [ram, tool], stiffness: 55, damping: 0.5}\n"
        "forces:\n"
        f"  - {{body: tool, constant: {force}}}\n"
        "  - {body: ram, amplitude: 13, frequency: 2.5}\n"
        "stops: [{name: die, body: tool, limit: 0.05, side: above,"
        f" restitution: {restitution}}}]\n",
        "press",
    )


def chain(n: int, stiffness: float = 10.0, damping: float = 0.1, **others: object) -> System:
    """``n`` unit masses between two walls, joined by equal springs and dampers."""
    laplacian = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return system(np.eye(n), damping * laplacian, stiffness * laplacian, **others)  # type: ignore[arg-type]


PRESSED = chain(
    2,
    damping=0.3,
    contacts=[([0, -1], 0.1, 0.5), ([1, 0], 0.2, 0.3)],
    force=forcing(2, [-3.0, 3.0], [Harmonic(1.3, [-4.0, 5.0], [1.0, 0])]),
)
"""Two masses, each pressed against a stop and released in turn."""

LAPLACIAN = np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
"""Stiffness of three bodies joined by two springs; it has a rigid mode."""


def flow_of(model: System) -> Flow:
    """The flow of ``model`` while no contact is held."""
    return Phases(model).phase().flow


def delassus(model: System) -> Array:
    """``G = W^T M^-1 W``."""
    return np.asarray(model.W.T @ np.linalg.solve(model.M, model.W))


@cache  # hypothesis checks each new strategy
def numbers(low: float = -2.0, high: float = 2.0) -> st.SearchStrategy[float]:
    """Multiples of 1/64 in [low, high]."""
    return st.integers(round(low * 64), round(high * 64)).map(lambda k: k / 64)


@cache
def vectors(n: int, low: float = -2.0, high: float = 2.0) -> st.SearchStrategy[Array]:
    """Vectors of ``n`` such numbers, drawn at once: every draw costs a tenth of a millisecond."""
    simplest_first = sorted(range(round(low * 64), round(high * 64) + 1), key=abs)
    values = np.array(simplest_first) / 64
    drawn = st.binary(min_size=2 * n, max_size=2 * n)
    return drawn.map(lambda each: values[np.frombuffer(each, ">u2") % values.size])


@cache
def matrices(rows: int, columns: int) -> st.SearchStrategy[Array]:
    """Matrices of numbers."""
    return vectors(rows * columns).map(lambda values: np.reshape(values, (rows, columns)))


@cache
def restitutions() -> st.SearchStrategy[float]:
    """Multiples of 1/8 in [0, 1]."""
    return st.integers(0, 8).map(lambda k: k / 8)


@st.composite
def forcings(draw: st.DrawFn, n: int) -> Forcing:
    """A constant and up to two harmonics."""
    frequencies = [draw(numbers(0.25, 6.0)) for _ in range(draw(st.integers(0, 2)))]
    parts = [Harmonic(each, *draw(matrices(2, n)).tolist()) for each in frequencies]
    return forcing(n, draw(vectors(n)), parts)


@st.composite
def systems(
    draw: st.DrawFn,
    *,
    max_n: int = 4,
    contacts: tuple[int, int] = (1, 3),
    rigid: bool | None = None,
    common_restitution: bool | None = None,
    gaps: tuple[float, float] = (-1.0, 2.0),
    forced: bool = True,
    damped: bool = True,
) -> System:
    """A valid system with everything in it that the theory allows.

    Args:
        draw: from hypothesis.
        max_n: most coordinates.
        contacts: fewest and most contacts.
        rigid: whether ``K`` is singular; None for either.
        common_restitution: whether all contacts have the same; None for either.
        gaps: range of the gaps in the rest position.
        forced: whether to force it.
        damped: whether to damp it, with a gyroscopic part.
    """
    n = draw(st.integers(1, max_n))
    m = draw(st.integers(*contacts))
    root = draw(matrices(n, n))
    singular = draw(st.booleans()) if rigid is None else rigid
    rows = draw(st.integers(0, n - 1)) if singular else n
    springs = draw(matrices(rows, n))
    dampers, turning = draw(matrices(n, n)), draw(matrices(n, n))
    equal = draw(st.booleans()) if common_restitution is None else common_restitution
    eps = draw(restitutions())
    directions, room = draw(matrices(m, n)), draw(vectors(m, *gaps))
    return system(
        root @ root.T + np.eye(n) / 2,
        (dampers.T @ dampers + turning - turning.T) / 8 if damped else np.zeros((n, n)),
        4 * springs.T @ springs + (0.0 if singular else 0.5) * np.eye(n),
        contacts=[
            (
                w if np.any(w) else np.eye(n)[i % n],
                float(room[i]),
                eps if equal else draw(restitutions()),
            )
            for i, w in enumerate(directions)
        ],
        force=draw(forcings(n)) if forced else None,
    )


def ground_motion(draw: st.DrawFn) -> Forcing:
    """A harmonic of each of two grounds."""
    size, omega = np.array([[draw(numbers(0.0, 0.5)), draw(numbers(0.5, 4.0))] for _ in "ab"]).T
    return Forcing(np.zeros(2), omega, np.diag(size * np.cos(1)), np.diag(-size * np.sin(1)))


@st.composite
def moving_systems(draw: st.DrawFn, /, **others: object) -> System:
    """As ``systems``, the stops on grounds that move by harmonics and by samples."""
    base, k = draw(systems(**others)), 2  # type: ignore[arg-type]
    motion = ground_motion(draw)
    if draw(st.booleans()):
        jets = draw(vectors(4 * 3 * k, -1.0, 1.0)).reshape(4, 3, k)
        motion = motion.added(Forcing.of_samples(Samples.of_jets(np.arange(3.0), jets)))
    shift, stiffness, damping = (draw(matrices(base.n, k)) for _ in range(3))
    factors = -(base.W.T @ shift)
    return moving_system(base, Grounds(("a", "b"), motion, (0, 1), stiffness, damping, factors))


@st.composite
def whole_numbers(draw: st.DrawFn) -> tuple[System, Array]:
    """A system and a state of zeros and ones, in which many quantities vanish or coincide."""
    n, m = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    whole = st.lists(st.integers(-1, 1), min_size=n, max_size=n)
    W = [draw(whole) for _ in range(m)]
    springs = np.diag(np.abs(draw(whole)))
    push = [draw(whole) for _ in range(3)]
    model = system(
        np.eye(n),
        draw(st.sampled_from([0.0, 0.25])) * springs,
        springs,
        contacts=[(w if any(w) else np.eye(n)[i % n], 0.0, 0.5) for i, w in enumerate(W)],
        force=forcing(n, push[0], [Harmonic(2.0, push[1], push[2])]),
    )
    return model, np.array([*draw(whole), *draw(whole)], float)


class Step(NamedTuple):
    """One step of a switching sequence, as no plant would make it.

    Attributes:
        wait: since the last step, s.
        hit: contacts that impact; none where contacts only open.
        stay: contacts that stay closed if they are closed at the instant.
    """

    wait: float
    hit: tuple[int, ...]
    stay: tuple[int, ...]


def switchings(m: int, most: int = 8, seconds: float = 5.0) -> st.SearchStrategy[list[Step]]:
    """Any sequence of pulses and intervals of ``m`` contacts, none longer than ``seconds``."""
    some = st.sets(st.integers(0, m - 1)).map(lambda found: tuple(sorted(found)))
    step = st.builds(Step, numbers(0.0, seconds / most), some, some)
    return st.lists(step, max_size=most)


def crossed(plant: Plant, seconds: float, most: int = 1000) -> list[Switching]:
    """The switchings of a plant until ``seconds`` after its epoch, at most ``most``."""
    found: list[Switching] = []
    last = plant.epoch + round(seconds * NS_PER_S)
    while len(found) < most and (switching := plant.next_switching(last)) is not None:
        plant.cross(switching)
        found.append(switching)
    return found


def distance(model: System, one: Array, two: Array) -> float:
    """``V`` of two states."""
    return float(lyapunov.distance(model, *np.split(one - two, 2)))


def passes_eigenvalue_test(model: System) -> bool:
    """``G - E G E >= 0``, or a common restitution: then every impact is non-expansive."""
    G, E = delassus(model), np.diag(model.eps)
    return bool(np.ptp(model.eps) == 0 or np.linalg.eigvalsh(G - E @ G @ E)[0] >= 0)


def switched(
    law: ReplicaLaw, states: list[Array], steps: Sequence[Step], t: float = 0.0
) -> Iterator[tuple[list[Array], bool]]:
    """The states of replicas from ``t`` on, and whether they are those just after a switching.

    They are given amid each flight, at its end and after the switching there, whose impacts must
    have a solution.
    """
    closed: tuple[int, ...] = ()
    for wait, hit, stay in steps:
        moving = [law.motion(t, x, closed) for x in states]
        for s in (wait / 3, wait):
            states = [motion.state(s) for motion in moving]
            yield states, False
        t += wait
        stays = tuple(i for i in sorted({*closed, *hit}) if i in stay)
        change, closed = ContactChange(t, closed, hit, stays), stays
        try:
            states = list(law.correct(change, Belief.of(np.array(states))).replicas)
        except ImpactLawError:
            assume(False)
        yield states, True


def largest_rise(law: ReplicaLaw, x: Array, y: Array, seconds: float = 4.0) -> float:
    """By how much V of a replica from ``y`` to a plant from ``x`` rises beyond rounding at most.

    Under the true switching.
    """
    model, t = law.system, 0.0
    plant = Plant(replace(model, live=None), *np.split(x, 2), epoch=EPOCH)
    y = law.admissible(y)
    first = last = distance(model, model.to_frame(np.zeros(1, dtype=np.int64), x[None])[0], y)
    motion = law.motion(0.0, y, ())
    closed: tuple[int, ...] = ()
    rise = -np.inf
    for _ in range(25):
        try:
            switching = plant.next_switching(EPOCH + round(seconds * NS_PER_S))
        except ImpactLawError:
            break
        if switching is None:
            break
        plant.cross(switching)
        now = -switching.instant.until(EPOCH)
        y = motion.state(now - t)
        size = 1e-9 * (first + 1e-3) + 1e-12 * float(np.max(np.abs(y))) ** 2
        before = distance(model, switching.before, y)
        rise = max(rise, before - last - size)
        last = distance(model, switching.after, y)
        if switching.contacts or switching.closed != closed:
            true = switching.before
            if switching.contacts:
                try:
                    y = law.impact(y, switching.contacts, switching.closed)
                    true = Kinematic(model).impact(true, switching.contacts, switching.closed)
                except ImpactLawError:
                    assume(False)
            closed = switching.closed
            # Where impacts accumulate the plant leaves out the last of them.
            cut = distance(model, switching.after, true)
            last = distance(model, switching.after, y)
            rise = max(rise, last - before - size - 2 * np.sqrt(cut * before) - cut)
            t, motion = now, law.motion(now, y, closed)
    return float(rise)


def started(model: System, position: ArrayLike, velocity: ArrayLike) -> Plant:
    """A plant at ``EPOCH``."""
    return Plant(model, np.asarray(position, float), np.asarray(velocity, float), epoch=EPOCH)


def run(
    model: System, position: ArrayLike, velocity: ArrayLike, *, seconds: float, rate: float = 100.0
) -> Run:
    """A run of the plant from ``EPOCH`` on."""
    return simulate(
        started(model, position, velocity), grid(EPOCH, EPOCH + round(seconds * NS_PER_S), rate)
    )


def without_faults(**declared: object) -> Uncertainty:
    """Of an exact model and a sensor without faults but for its clock: every event is accepted."""
    right = {
        "model_error": 0.0,
        "clock_error": 0.0,
        "missed": 0.0,
        "spurious": 0.0,
        "mislabelled": 0.0,
    }
    return Uncertainty(**{**right, **declared})  # type: ignore[arg-type]


def observer(model: System, law: str, x: ArrayLike, **options: object) -> Observer:
    """An observer that starts at ``x``, of one replica, of a sensor ``without_faults``."""
    start = np.asarray(x, float)
    options = {"ensemble": 1, **options}
    declared = options.pop("uncertainty", None) or without_faults()
    return Observer(
        model,
        law_named(law)(model, declared),  # type: ignore[arg-type]
        start[: model.n],
        start[model.n :],
        **options,  # type: ignore[arg-type]
    )


def estimates(watcher: Observer, stamps: NDArray[np.int64]) -> Array:
    """States (q, u) that an observer estimates at ``stamps``, shape (samples, 2n)."""
    found = [watcher.estimate(int(stamp)) for stamp in stamps]
    return np.array([np.concatenate([estimate.q, estimate.u]) for estimate in found])


def event(
    seconds: float, *contacts: str, sequence: int = 0, episode: int = 0, epoch: int = EPOCH
) -> ImpactEvent:
    """An impact of ``contacts`` at ``seconds`` since ``EPOCH``."""
    switches = tuple(Switch(contact) for contact in contacts)
    stamp = EPOCH + round(seconds * NS_PER_S)
    return ImpactEvent(stamp, switches, sequence, episode, epoch)


def switching(
    *switches: tuple[str, Kind], seconds: float, sequence: int = 0, epoch: int = EPOCH
) -> ImpactEvent:
    """An event with ``switches`` of any kind at ``seconds`` since ``EPOCH``."""
    stamp = EPOCH + round(seconds * NS_PER_S)
    return ImpactEvent(stamp, tuple(Switch(*each) for each in switches), sequence, 0, epoch)


def reachable(thing: object) -> int:
    """How many objects an object holds, itself included, without code, classes and modules."""
    seen: dict[int, object] = {}
    waiting = [thing]
    while waiting:
        each = waiting.pop()
        if id(each) not in seen and not isinstance(each, (type, ModuleType, FunctionType)):
            seen[id(each)] = each
            waiting += gc.get_referents(each)
    return len(seen)
