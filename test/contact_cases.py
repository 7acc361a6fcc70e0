# SPDX-License-Identifier: Apache-2.0
"""Motions with simultaneous impacts and persistent contact, for tests against other programs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from systems import EPOCH, Harmonic, forcing, system

from impact_observer.events import Kind
from impact_observer.model import Forcing, System
from impact_observer.plant import Plant, Switching
from impact_observer.stamps import from_seconds

Array = NDArray[np.float64]


class Case(NamedTuple):
    """A system and where it starts."""

    system: System
    position: Array
    velocity: Array
    seconds: float


def ball() -> Case:
    """A ball, eps 0.9, dropped from 1 m: 26 impacts."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.9)], force=forcing(1, -9.81))
    return Case(model, np.array([1.0]), np.zeros(1), 8.0)


def oscillator() -> Case:
    """Siconos' example LinearOscillatorED: m 1e-3, k 100, gravity, eps 0.9; 40 impacts."""
    model = system(1e-3, 0, 100, contacts=[([1], 0.0, 0.9)], force=forcing(1, -9.81e-3))
    return Case(model, np.array([1.0]), np.zeros(1), 0.401)


def floor_and_ceiling() -> Case:
    """Siconos' example of a ball between two stops, here with eps 1 at the ceiling."""
    contacts = [([1], 0.0, 0.95), ([-1], 1.5, 1.0)]
    model = system(1, 0, 0, contacts=contacts, force=forcing(1, -10.0))
    return Case(model, np.array([1.0]), np.array([10.0]), 5.0)


def beads(
    gaps: Array, velocity: Array, *, eps: Array, load: float = 0.0, stiffness: float = 0.0
) -> tuple[System, Array, Array]:
    """Unit masses in a row before a wall, joined by springs; coordinates start at zero.

    Contact 0 is the first bead with the wall, contact i the beads i and i + 1.
    """
    n = len(gaps)
    directions = np.eye(n) - np.eye(n, k=-1)
    between = directions[1:]
    contacts = [(w, gap, e) for w, gap, e in zip(directions, gaps, eps, strict=True)]
    model = system(
        np.eye(n),
        np.zeros((n, n)),
        stiffness * between.T @ between,
        contacts=contacts,
        force=forcing(n, load),
    )
    return model, np.zeros(n), velocity


def collapsing_beads() -> Case:
    """Ten beads whose ten contacts, the wall's too, all close after exactly one second.

    A load on all of them brings them back afterwards.
    """
    gaps = np.array([4, 2, 5, 1, 3, 2, 6, 1, 2, 3]) / 16
    eps = np.array([6, 4, 7, 2, 5, 3, 6, 1, 4, 5]) / 8
    return Case(*beads(gaps, 0.25 - np.cumsum(gaps), eps=eps, load=-0.5), 4.0)


def thrown_beads() -> Case:
    """Ten beads with springs; of six that are closed at the start five hit and one separates."""
    gaps = np.array([8, 0, 0, 2, 0, 0, 3, 0, 0, 5]) / 16
    velocity = np.array([2, 0, -1, -6, 0, -4, -4, -5, -8, -8]) / 4
    return Case(*beads(gaps, velocity, eps=np.full(10, 0.6), stiffness=2.0), 0.45)


def resting_beads() -> Case:
    """Ten beads: nine rest on the wall and on each other, the tenth falls on them."""
    gaps = np.append(np.zeros(9), 0.5)
    return Case(*beads(gaps, np.zeros(10), eps=np.full(10, 0.5), load=-9.81), 0.9)


def pressed_mass(eps: float) -> Case:
    """A mass on its stop, pressed by ``3 cos t - 2``: the contact opens at ``cos t = 2/3``."""
    model = system(
        1, 0.1, 1, contacts=[([1], 0.0, eps)], force=forcing(1, -2.0, [Harmonic(1.0, [3.0], [0])])
    )
    return Case(model, np.array([0.5]), np.zeros(1), 20.0)


def pulled_mass(eps: float) -> Case:
    """Two masses: the forced one pulls the other off its stop by a spring."""
    model = system(
        np.diag([1.0, 0.5]),
        [[0.3, -0.2], [-0.2, 0.2]],
        [[6.0, -5.0], [-5.0, 5.0]],
        contacts=[([1, 0], 0.0, eps)],
        force=forcing(2, [-1.0, 0.0], [Harmonic(1.5, [0.0, 2.0], [0.0, 1.0])]),
    )
    return Case(model, np.array([0.25, 0.0]), np.zeros(2), 15.0)


def switchings(case: Case) -> list[Switching]:
    """All that the plant does in a case."""
    plant = Plant(case.system, case.position, case.velocity, epoch=EPOCH)
    found: list[Switching] = []
    while (one := plant.next_switching(EPOCH + from_seconds(case.seconds))) is not None:
        plant.cross(one)
        found.append(one)
        assert len(found) < 1000, "impacts that accumulate never end"
    return found


def impacts(case: Case) -> list[Switching]:
    """Switchings with a velocity jump; contacts closed at the start have none."""
    return [
        one
        for one in switchings(case)
        if not np.allclose(one.before, one.after, rtol=1e-12, atol=1e-12)
    ]


def seconds(switching: Switching) -> float:
    """Its instant since the epoch, s."""
    return -switching.instant.until(EPOCH)


def approach(model: System, impact: Switching) -> float:
    """``gamma-`` of the first contact."""
    return float(model.contact_speed(impact.before[model.n :])[impact.contacts[0]])


def kinds(switching: Switching) -> set[Kind]:
    """Kinds of its switches."""
    return {switch.kind for switch in switching.switches}


def kinds_in_order(switching: Switching) -> list[Kind]:
    """Kinds of its switches, in the order of the contacts."""
    return [switch.kind for switch in switching.switches]


def free(n: int, *, force: Forcing, contacts: Sequence[tuple[ArrayLike, float, float]]) -> System:
    """Unit masses without springs and dampers."""
    return system(np.eye(n), np.zeros((n, n)), np.zeros((n, n)), contacts=contacts, force=force)
