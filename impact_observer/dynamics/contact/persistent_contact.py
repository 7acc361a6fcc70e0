# SPDX-License-Identifier: Apache-2.0
"""Persistent contact and dry friction: which contacts stay closed, which guides stick.

``0 <= dgamma/dt _|_ lambda >= 0`` on contacts with ``g = 0, gamma = 0``. A guide of prescribed
load has ``-lambda in a d|gamma|``, ``gamma = W_T^T u``: it slips with the constant load
``-a sign(gamma)``, or sticks with ``gamma = 0`` and ``|lambda| <= a``. By Gauss's principle of
least constraint, the acceleration is the nearest to the free one, in the metric of ``M``, with
loads ``lambda >= 0`` of contacts and ``|lambda| <= a`` of guides: a problem of least squares.

Where a load is at its bound and the acceleration zero the next derivatives decide, and so on: a
contact whose load has just fallen to zero opens if the load would fall further. There a guide is
like a contact: its load may only go back, its speed only on. A contact on which no derivative
decides is closed without load, and such a guide sticks.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics.contact.complementarity import bounded, nonnegative, vertex
from impact_observer.dynamics.flow.phase import RANK, Phase, Phases, orthonormal, without
from impact_observer.errors import DynamicsError
from impact_observer.states import Vector

_ORDERS = 6
"""Derivatives that are examined before a contact counts as closed, and a guide as sticking."""
_ZERO = 1e-11
"""Acceleration that counts as none, relative to the largest term of its sum."""


class Grip(NamedTuple):
    """The closed contacts, and the loads of contacts and guides.

    Attributes:
        closed: contacts that stay closed, as indices.
        held: contacts and guides that carry the loads, independent of each other, as indices.
        loads: loads of guides that are not held, N.
    """

    closed: tuple[int, ...]
    held: tuple[int, ...]
    loads: tuple[float, ...] = ()


def persistent_contacts(
    phases: Phases, fixed: tuple[int, ...], t: float, x: Vector, contacts: tuple[int, ...]
) -> Grip:
    """Decide which of ``contacts`` stay closed at ``t``, s since the epoch, and what guides do.

    The state ``x`` (p, u), shape (2n,), has ``gamma = 0`` on them. The gaps of ``fixed`` contacts
    stay closed whether they are held or not; see ``phase.py``.

    Raises:
        DynamicsError: the loads cannot be found.
    """
    slow, loads = phases.guides(x)
    if not (contacts or slow):
        return Grip((), (), tuple(loads.tolist()))
    decisions = _Decisions([], [], [(i, 1.0) for i in contacts], loads)
    unloaded = phases.unloaded(fixed, tuple(loads.tolist()))
    motion = list(x.reshape(2, -1))
    for _ in range(_ORDERS):
        free, size = phases.free(unloaded, t, motion)
        if slow and len(motion) == 2:
            acceleration = decisions.decide_guides(phases, slow, free, _ZERO * size)
        else:
            acceleration = decisions.decide(phases, free, _ZERO * size)
        if not decisions.undecided:
            break
        motion.append(phases.unwhite(acceleration))
    return decisions.grip(phases)


class _Decisions(NamedTuple):
    """Decisions: contacts that press, guides that stick, and loads of guides.

    Each undecided contact or guide has the sign of the direction in which it would open or slip.
    """

    pressing: list[int]
    sticking: list[int]
    undecided: list[tuple[int, float]]
    loads: Vector

    def decide_guides(
        self, phases: Phases, slow: tuple[int, ...], free: Vector, zero: float
    ) -> Vector:
        """Decide by the accelerations, with ``slow`` guides.

        Returns the acceleration with all loads, as ``Phases.white``.
        """
        m, most = phases.system.m, phases.system.friction
        contacts = [i for i, _ in self.undecided]
        index = [*contacts, *(m + j for j in slow)]
        length = phases.lengths[index]
        D = phases.B[:, index] / length
        high = np.array([np.inf] * len(contacts) + [most[j] for j in slow]) * length
        low = np.where(np.isfinite(high), -high, 0.0)
        pushed = vertex(D, bounded(D, -free, low, high), low, high, zero)
        acceleration = free + D @ pushed
        away = (D.T @ acceleration).tolist()
        self.undecided.clear()
        for i, push, rate in zip(contacts, pushed.tolist(), away, strict=False):
            if push > zero:
                self.pressing.append(i)
            elif max(push, rate) <= zero:
                self.undecided.append((i, 1.0))
        last = len(contacts)
        for j, push, rate, bound, unit in zip(
            slow, pushed[last:], away[last:], high[last:], length[last:], strict=True
        ):
            side = float(np.sign(push)) if bound - abs(push) <= zero else 0.0
            self.loads[j] = side * most[j] if side else push / unit
            if not side:
                self.sticking.append(m + j)
            elif -side * rate <= zero:
                self.undecided.append((m + j, -side))
        return acceleration

    def decide(self, phases: Phases, free: Vector, zero: float) -> Vector:
        """Decide on the undecided by accelerations or a derivative of them."""
        waiting = list(self.undecided)
        index = [i for i, _ in waiting]
        D = phases.B[:, index] / (phases.lengths[index] * [sign for _, sign in waiting])
        if self.pressing or self.sticking:
            basis = orthonormal(phases.B[:, [*self.pressing, *self.sticking]])
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
        for (i, sign), push, rate in zip(waiting, pushed.tolist(), away.tolist(), strict=True):
            if push > zero:
                (self.pressing if i < phases.system.m else self.sticking).append(i)
            elif rate <= zero:
                self.undecided.append((i, sign))
        return np.asarray(acceleration)

    def grip(self, phases: Phases) -> Grip:
        """The grip, in which undecided contacts stay closed and undecided guides stick."""
        m = phases.system.m
        idle = [i for i, _ in self.undecided]
        closed = tuple(sorted([*self.pressing, *(i for i in idle if i < m)]))
        held = phases.independent((*self.pressing, *self.sticking, *idle))
        loads = [0.0 if m + j in held else load for j, load in enumerate(self.loads.tolist())]
        return Grip(closed, held, tuple(loads))


def ended(
    phases: Phases,
    before: Phase,
    closed: tuple[int, ...],
    contacts: Iterable[int],
    ends: Iterable[int],
) -> Grip:
    """The grip after a phase that has ended though ``persistent_contacts`` would not change it.

    A load that reaches its bound too slowly to see its sign may not go beyond it, and a speed that
    vanishes may not turn: ``contacts`` are released, and of the guides' ``Rubbing.ends`` those
    with the indices ``ends`` slip or stick.
    """
    m, most = phases.system.m, phases.system.friction
    released, loads, held = set(contacts), list(before.rubbing.loads), [*before.held, *closed]
    for each in ends:
        j, side = before.rubbing.ends[each]
        if side:
            released.add(m + j)
            loads[j] = side * float(most[j])
        else:
            held.append(m + j)
    kept = phases.independent(tuple(i for i in dict.fromkeys(held) if i not in released))
    loads = [0.0 if m + j in kept else load for j, load in enumerate(loads)]
    return Grip(tuple(i for i in closed if i not in released), kept, tuple(loads))


def _unsolved(phases: Phases, index: list[int]) -> DynamicsError:
    system = phases.system
    names = [*system.contact_names, *(each.name for each in system.guides)]
    kinds = "contacts and guides" if system.guides else "contacts"
    return DynamicsError(
        f"{kinds} {', '.join(repr(names[i]) for i in index)}: the loads that hold them"
        " cannot be found; are their directions almost the same?"
    )
