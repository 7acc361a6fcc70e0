# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Dry friction of prescribed load: which guides stick, which slip, and which contacts stay closed.

A guide has ``-lambda in a d|gamma|``, ``gamma = W_T^T u``: it slips with the constant load
``-a sign(gamma)``, or sticks with ``gamma = 0`` and ``|lambda| <= a``. At rest the acceleration
decides, together with that of closed contacts: by Gauss's principle of least constraint it is the
nearest to the free one, in the metric of ``M``, with loads ``lambda >= 0`` of contacts and
``|lambda| <= a`` of guides. Where a load is at its bound and the acceleration zero the next
derivatives decide. There a guide is like a contact: its load may only go back, its speed only on.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy

from impact_observer.dynamics.contact.complementarity import nonnegative
from impact_observer.dynamics.flow.phase import RANK, Phase, Phases, without
from impact_observer.errors import DynamicsError
from impact_observer.states import Matrix, Vector

_ORDERS = 6
"""Derivatives that are examined before a contact counts as closed, and a guide as sticking."""
_ZERO = 1e-11
"""Acceleration that counts as none, relative to the largest term of its sum."""


class Grip(NamedTuple):
    """What closed contacts and guides do.

    Attributes:
        closed: contacts that stay closed, as indices.
        held: contacts and guides that carry the loads, independent of each other, as indices.
        loads: those of guides that are not held, N.
    """

    closed: tuple[int, ...]
    held: tuple[int, ...]
    loads: tuple[float, ...] = ()


class _Undecided(NamedTuple):
    """A contact or guide on which no derivative has decided yet.

    ``number`` is its index, ``sign`` that of its direction in which it would open, or slip, and
    ``at`` its load.
    """

    number: int
    sign: float
    at: float


def grip(
    phases: Phases, fixed: tuple[int, ...], t: float, x: Vector, contacts: tuple[int, ...]
) -> Grip:
    """Decide which of ``contacts`` stay closed at ``t``, s since the epoch, and what guides do.

    The state ``x`` (p, u), shape (2n,), has ``gamma = 0`` on the contacts. The gaps of ``fixed``
    contacts stay closed whether they are held or not; see ``phase.py``.

    Raises:
        DynamicsError: the loads cannot be found.
    """
    system, n = phases.system, x.size // 2
    slow, most = phases.slow_guides(x), system.friction
    loads = -most * np.sign(system.W_T.T @ x[n:])
    loads[list(slow)] = 0.0
    found = _Found([], [], [], loads)
    if not (contacts or slow):
        return found.grip(phases)
    unloaded = phases.unloaded(fixed, tuple(loads.tolist()))
    motion = [x[:n], x[n:]]
    for k in range(_ORDERS):
        free, size = phases.free(unloaded, t, motion)
        if k == 0:
            acceleration = found.decide(phases, contacts, slow, free, _ZERO * size)
        else:
            acceleration = found.decide_next(phases, free, _ZERO * size)
        motion.append(phases.unwhite(acceleration))
        if not found.undecided:
            break
    return found.grip(phases)


class _Found(NamedTuple):
    """What has been decided: contacts that press, guides that stick; undecided ones; loads."""

    pressing: list[int]
    sticking: list[int]
    undecided: list[_Undecided]
    loads: Vector

    def decide(
        self,
        phases: Phases,
        contacts: tuple[int, ...],
        slow: tuple[int, ...],
        free: Vector,
        zero: float,
    ) -> Vector:
        """Decide by the accelerations; returns that with all loads, as ``Phases.white``."""
        m, most = phases.system.m, phases.system.friction
        index = [*contacts, *(m + j for j in slow)]
        if not index:
            return free
        length = phases.lengths[index]
        D = phases.B[:, index] / length
        high = np.array([np.inf] * len(contacts) + [most[j] for j in slow]) * length
        low = np.where(np.isfinite(high), -high, 0.0)
        pushed = _vertex(D, bounded(D, -free, low, high), low, high, zero)
        acceleration = free + D @ pushed
        away = D.T @ acceleration
        for i, push, rate, bound, unit in zip(
            index, pushed.tolist(), away.tolist(), high.tolist(), length.tolist(), strict=True
        ):
            load = push / unit
            if i < m:
                if push > zero:
                    self.pressing.append(i)
                elif max(push, rate) <= zero:
                    self.undecided.append(_Undecided(i, 1.0, 0.0))
                continue
            self.loads[i - m] = load
            side = np.sign(push) if bound - abs(push) <= zero else 0.0
            if not side:
                self.sticking.append(i)
                continue
            self.loads[i - m] = side * most[i - m]
            if -side * rate <= zero:
                self.undecided.append(_Undecided(i, -float(side), float(self.loads[i - m])))
        return acceleration

    def decide_next(self, phases: Phases, free: Vector, zero: float) -> Vector:
        """The same by a derivative of the accelerations: of those that are undecided."""
        m, waiting = phases.system.m, list(self.undecided)
        basis = np.linalg.qr(phases.B[:, [*self.pressing, *self.sticking]])[0]
        index = [each.number for each in waiting]
        length = phases.lengths[index]
        signs = np.array([each.sign for each in waiting])
        D = without(basis, phases.B[:, index] * signs) / length
        rest = without(basis, free)
        pushed = np.zeros(len(index))
        independent, size = np.linalg.norm(D, axis=0) > RANK, float(np.linalg.norm(rest))
        if size > 0 and independent.any():
            found = nonnegative(D[:, independent], -rest / size)
            if found is None:
                raise _unsolved(phases, index)
            pushed[independent] = size * found
        acceleration = rest + D @ pushed
        away = D.T @ acceleration
        self.undecided.clear()
        for each, push, rate in zip(waiting, pushed.tolist(), away.tolist(), strict=True):
            if push > zero:
                (self.pressing if each.number < m else self.sticking).append(each.number)
            elif rate <= zero:
                self.undecided.append(each)
        return np.asarray(acceleration)

    def grip(self, phases: Phases) -> Grip:
        """What is left undecided stays closed, or sticks."""
        m = phases.system.m
        idle = [each.number for each in self.undecided]
        closed = tuple(sorted([*self.pressing, *(i for i in idle if i < m)]))
        held = phases.independent((*self.pressing, *self.sticking, *idle))
        loads = [0.0 if m + j in held else load for j, load in enumerate(self.loads.tolist())]
        return Grip(closed, held, tuple(loads))


def bounded(D: Matrix, target: Vector, low: Vector, high: Vector) -> Vector:
    """The least squares solution ``low <= y <= high`` of ``D y = target``.

    Those at a bound are exactly there.
    """
    size = float(np.linalg.norm(target))
    if size == 0.0:
        return np.clip(np.zeros(low.size), low, high)
    # Bounds beyond any load do not count, and equal units keep the method's tolerance relative.
    found = scipy.optimize.lsq_linear(
        D, target / size, (low / size, high / size), method="bvls", tol=1e-15
    )
    return np.clip(np.asarray(found.x) * size, low, high)


def _vertex(D: Matrix, y: Vector, low: Vector, high: Vector, zero: float) -> Vector:
    """Loads with the same ``D y`` of which those within their bounds are independent.

    Where contacts and guides depend on each other, loads are not unique. As with vertices of a
    linear programme, their number is finite: so is that of changes from one to another.
    """
    while True:
        inside = np.flatnonzero((y > low + zero) & (y < high - zero))
        if inside.size <= 1:
            return y
        _, singular, right = np.linalg.svd(D[:, inside])
        rank = int(np.sum(singular > RANK))
        if rank == inside.size:
            return y
        way = np.zeros(y.size)
        way[inside] = right[-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(way > 0, (high - y) / way, np.where(way < 0, (low - y) / way, np.inf))
            back = np.where(way < 0, (high - y) / -way, np.where(way > 0, (y - low) / way, np.inf))
        step, sign = (room, 1.0) if np.min(room) <= np.min(back) else (back, -1.0)
        first = int(np.argmin(step))
        y = y + sign * step[first] * way
        y[first] = high[first] if sign * way[first] > 0 else low[first]


def ended(
    phases: Phases,
    before: Phase,
    closed: tuple[int, ...],
    contacts: Iterable[int],
    ends: Iterable[int],
) -> Grip:
    """What ``closed`` contacts and guides do where it would be what it was, though it has ended.

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
    return DynamicsError(
        f"contacts and guides {', '.join(repr(names[i]) for i in index)}: the loads that hold them"
        " cannot be found; are their directions almost the same?"
    )
