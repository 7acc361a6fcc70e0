# SPDX-License-Identifier: Apache-2.0
"""Persistent contact: which contacts stay closed.

``0 <= dgamma/dt _|_ lambda >= 0`` on contacts with ``g = 0, gamma = 0``. By Gauss's principle of
least constraint, the acceleration is the nearest to the free one, in the metric of ``M``, with
loads ``lambda >= 0``: a problem of least squares.

Where a load and the acceleration are zero the next derivatives decide, and so on: a contact whose
load has just fallen to zero opens if the load would fall further. A contact on which no derivative
decides is closed without load.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics.contact.complementarity import nonnegative
from impact_observer.dynamics.mechanism import Grip
from impact_observer.dynamics.phase import RANK, Phase, Phases, orthonormal, without
from impact_observer.errors import DynamicsError
from impact_observer.states import Vector

_ORDERS = 6
"""Derivatives that are examined before a contact counts as closed."""
_ZERO = 1e-11
"""Acceleration that counts as none, relative to the largest term of its sum."""


def persistent_contacts(
    phases: Phases, fixed: tuple[int, ...], t: float, x: Vector, contacts: tuple[int, ...]
) -> Grip:
    """Decide which of ``contacts`` stay closed at ``t``, s since the epoch.

    The state ``x`` (p, u), shape (2n,), has ``gamma = 0`` on them. The gaps of ``fixed`` contacts
    stay closed whether they are held or not; see ``phase.py``.

    Raises:
        DynamicsError: the loads cannot be found.
    """
    if not contacts:
        return Grip((), ())
    decisions = _Decisions([], list(contacts))
    unloaded = phases.unloaded(fixed)
    motion = list(x.reshape(2, -1))
    for _ in range(_ORDERS):
        free, size = phases.free(unloaded, t, motion)
        acceleration = decisions.decide(phases, free, _ZERO * size)
        if not decisions.undecided:
            break
        motion.append(phases.unwhite(acceleration))
    return decisions.grip(phases)


class _Decisions(NamedTuple):
    """Decisions: contacts that press, and contacts on which nothing has decided yet."""

    pressing: list[int]
    undecided: list[int]

    def decide(self, phases: Phases, free: Vector, zero: float) -> Vector:
        """Decide on the undecided by accelerations or a derivative of them.

        Returns the acceleration with all loads, as ``Phases.white``.
        """
        index = list(self.undecided)
        D = phases.B[:, index] / phases.length[index]
        if self.pressing:
            basis = orthonormal(phases.B[:, self.pressing])
            D, free = without(basis, D), without(basis, free)
        pushed = np.zeros(len(index))
        independent, size = np.linalg.norm(D, axis=0) > RANK, math.sqrt(free.dot(free))
        if size > 0 and independent.any():
            loads = nonnegative(D[:, independent], -free / size)
            if loads is None:
                raise _unsolved(phases, index)
            pushed[independent] = size * loads
        acceleration = free + D @ pushed
        away = acceleration.dot(D)
        self.undecided.clear()
        for i, push, rate in zip(index, pushed.tolist(), away.tolist(), strict=True):
            if push > zero:
                self.pressing.append(i)
            elif rate <= zero:
                self.undecided.append(i)
        return np.asarray(acceleration)

    def grip(self, phases: Phases) -> Grip:
        """The grip, in which undecided contacts stay closed."""
        closed = tuple(sorted([*self.pressing, *self.undecided]))
        return Grip(closed, phases.independent((*self.pressing, *self.undecided)))


def ended(phases: Phases, before: Phase, closed: tuple[int, ...], contacts: Iterable[int]) -> Grip:
    """The grip after a phase that has ended though ``persistent_contacts`` would not change it.

    A load that reaches zero too slowly to see its sign may not become negative: ``contacts`` are
    released.
    """
    released, held = set(contacts), dict.fromkeys((*before.held, *closed))
    kept = phases.independent(tuple(i for i in held if i not in released))
    return Grip(tuple(i for i in closed if i not in released), kept)


def _unsolved(phases: Phases, index: list[int]) -> DynamicsError:
    names = phases.system.contact_names
    return DynamicsError(
        f"contacts {', '.join(repr(names[i]) for i in index)}: the loads that hold them"
        " cannot be found"
    )
