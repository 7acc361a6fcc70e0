# SPDX-License-Identifier: Apache-2.0
"""Guard functions along a motion: a phase ends when a guard function falls below zero.

``RootSearch`` finds the first root of all guard functions and misses none (``roots.py``).
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum, auto
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics.phase import Phase
from impact_observer.dynamics.roots import Guards
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

DEPTH = 1e-13
"""Depth below zero that may be missed, relative to the terms of a function."""


class End(IntEnum):
    """The kinds of guard functions: how a phase ends."""

    GAP = auto()
    SPEED = auto()
    LOAD = auto()
    REACTION = auto()


class Watch(NamedTuple):
    """Watched functions of the motions of one phase.

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


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """Functions ``h = a p + b u + c f(t) + d`` of a motion (p, u), a row each.

    Attributes:
        ends: kind and index of each function; see ``Watch``.
        position: ``a``, shape (w, n).
        velocity: ``b``, shape (w, n).
        force: ``c``, shape (w, n).
        constant: ``d``, shape (w,).
    """

    ends: tuple[tuple[End, int], ...]
    position: Matrix
    velocity: Matrix
    force: Matrix
    constant: Vector

    @classmethod
    def gaps(
        cls, system: System, contacts: Iterable[int], phase: Phase | None = None
    ) -> "Watched":
        """The gaps of ``contacts``: a gap below zero is a penetration.

        Args:
            system: the system of the contacts.
            contacts: indices.
            phase: the phase with the coordinates ``p``; None for coordinates of the system.
        """
        which = list(contacts)
        a, d = system.W[:, which].T, system.q_r[which]
        if phase is not None and phase.fixed:
            a, d = a @ phase.Q, d + a @ phase.rest
        return cls(_each(End.GAP, which), a, np.zeros_like(a), np.zeros_like(a), d)

    @classmethod
    def speeds(cls, system: System, contacts: Iterable[int]) -> "Watched":
        """The contact speeds of ``contacts``: at zero a slipping contact is held."""
        return cls._of_velocity(_each(End.SPEED, contacts), system.W[:, list(contacts)].T)

    @classmethod
    def reactions(cls, system: System, phase: Phase, R: Matrix, stopped: int) -> "Watched":
        """The reactions ``sigma`` of the last ``stopped`` contacts fixed in ``phase``.

        ``R`` gives the reactions of all fixed contacts by their gaps, shape (fixed, fixed).
        """
        first, fixed = len(phase.fixed) - stopped, list(phase.fixed)
        ends = _each(End.REACTION, fixed[first:])
        return cls._of_velocity(ends, -R[first:] @ system.W[:, fixed].T)

    @classmethod
    def loads(cls, phase: Phase) -> "Watched":
        """The loads ``lambda`` of the held contacts: below zero a contact is released."""
        equations, H = phase.equations, phase.loads
        ends, none = _each(End.LOAD, phase.held), np.zeros(len(H))
        return cls(ends, H @ equations.K, H @ equations.C, -H, none)

    @classmethod
    def _of_velocity(cls, ends: tuple[tuple[End, int], ...], b: Matrix) -> "Watched":
        return cls(ends, np.zeros_like(b), b, np.zeros_like(b), np.zeros(len(b)))

    def and_also(self, *others: "Watched") -> "Watched":
        """These functions, then the functions of ``others``."""
        every = [each for each in (self, *others) if each.ends] or [self]
        return Watched(
            sum((each.ends for each in every), ()),
            np.vstack([each.position for each in every]),
            np.vstack([each.velocity for each in every]),
            np.vstack([each.force for each in every]),
            np.concatenate([each.constant for each in every]),
        )

    def along(self, phase: Phase) -> Watch:
        """The same functions along the motions of ``phase``."""
        forcing = phase.equations.forcing
        squares = [] if forcing.squares is None else [forcing.squares.force]
        forces = np.vstack([forcing.constant, forcing.cosine, forcing.sine, *squares])
        waves = forces @ self.force.T
        waves[0] += self.constant
        rows = np.hstack([self.position, self.velocity])
        return Watch(phase.flow.guards(rows, waves.T, self.force), self.ends)


def _each(end: End, which: Iterable[int]) -> tuple[tuple[End, int], ...]:
    return tuple((end, i) for i in which)
