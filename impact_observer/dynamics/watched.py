# SPDX-License-Identifier: Apache-2.0
"""Guards along the motions of a phase: it ends where the first of them falls below zero.

A guard is a linear function of the augmented state ``z`` of a flow, a row. ``RootSearch`` finds
the first root of all guards and misses none (``roots.py``).
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from enum import IntEnum, auto
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics.phase import Phase
from impact_observer.dynamics.roots import Guards
from impact_observer.model import System
from impact_observer.states import Matrix

DEPTH = 1e-13
"""Depth below zero that may be missed, relative to the terms of a function."""


class End(IntEnum):
    """The kinds of guards: how a phase ends."""

    GAP = auto()
    SPEED = auto()
    LOAD = auto()
    REACTION = auto()


class Watch(NamedTuple):
    """The guards of the motions of one phase.

    Attributes:
        guards: the functions.
        ends: kind of each function, and index of the contact.
    """

    guards: Guards
    ends: tuple[tuple[End, int], ...]

    def crossed(self, which: Iterable[int]) -> dict[End, set[int]]:
        """Indices of the contacts of the functions ``which``, by kind."""
        indices: dict[End, set[int]] = defaultdict(set)
        for end, i in map(self.ends.__getitem__, which):
            indices[end].add(i)
        return indices


def watch(
    system: System,
    phase: Phase,
    gaps: Sequence[int] = (),
    speeds: Sequence[int] = (),
    reactions: tuple[int, Matrix] | None = None,
) -> Watch:
    """The loads of the held contacts of a ``phase``, and further guards.

    Args:
        system: the system of the contacts.
        phase: the phase.
        gaps: contacts whose gaps may not become negative.
        speeds: contacts that slip until their speeds are zero.
        reactions: number of the last contacts fixed in the phase whose reactions ``sigma`` may
            not become negative, and the reactions by the gaps of all of them, (fixed, fixed).
    """
    n, equations, H, W = system.n, phase.equations, phase.loads, system.W
    F = phase.flow.drive.F
    loads = np.hstack([H @ equations.K, H @ equations.C, -H @ F])
    parts = [(End.LOAD, phase.held, loads)]
    if speeds:
        rows = np.zeros((len(speeds), loads.shape[1]))
        rows[:, n : 2 * n] = W[:, list(speeds)].T
        parts.append((End.SPEED, tuple(speeds), rows))
    if reactions is not None:
        count, R = reactions
        fixed = phase.fixed
        rows = np.zeros((count, loads.shape[1]))
        rows[:, n : 2 * n] = -R[len(fixed) - count :] @ W[:, list(fixed)].T
        parts.append((End.REACTION, fixed[len(fixed) - count :], rows))
    if gaps:
        directions, which = W[:, list(gaps)].T, list(gaps)
        rows = np.zeros((len(gaps), loads.shape[1]))
        rows[:, :n] = directions @ phase.Q if phase.fixed else directions
        rows[:, -1] = system.q_r[which] + (directions @ phase.rest if phase.fixed else 0.0)
        parts.append((End.GAP, tuple(gaps), rows))
    ends = tuple((end, i) for end, contacts, _ in parts for i in contacts)
    return Watch(Guards(phase.flow.exponential, np.vstack([rows for *_, rows in parts])), ends)
