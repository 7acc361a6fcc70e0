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

"""Persistent contact: which contacts at rest on their stops stay closed, and which carry loads.

``0 <= dgamma/dt _|_ lambda >= 0`` on contacts with ``g = 0, gamma = 0``: by Gauss's principle of
least constraint, the acceleration is the nearest to the free one, in the metric of ``M``, that
closes no gap. This is a nonnegative least squares problem. Where both are zero the next
derivatives decide, and so on: a contact whose load has just fallen to zero opens if the load would
fall further. A contact on which no derivative decides is closed without load.
"""

import math

import numpy as np

from impact_observer.dynamics.contact.complementarity import nonnegative
from impact_observer.dynamics.contact.friction import Grip, grip
from impact_observer.dynamics.flow.phase import RANK, Phases, orthonormal, without
from impact_observer.errors import DynamicsError
from impact_observer.states import Matrix, Vector

_ORDERS = 6
"""Derivatives that are examined before a contact counts as closed without load."""
_ZERO = 1e-11
"""Acceleration that counts as none, relative to the largest term of its sum."""


def persistent_contacts(
    phases: Phases, fixed: tuple[int, ...], t: float, x: Vector, contacts: tuple[int, ...]
) -> Grip:
    """Decide which of ``contacts`` stay closed at ``t``, s since the epoch, and what guides do.

    The state ``x`` (p, u), shape (2n,), has ``gamma = 0`` on them. The gaps of ``fixed`` contacts
    stay closed whether they are held or not; see ``phase.py``.

    Raises:
        DynamicsError: the loads cannot be found.
    """
    if phases.system.guides:
        return grip(phases, fixed, t, x, contacts)
    if not contacts:
        return Grip((), ())
    unloaded, n = phases.unloaded(fixed), phases.system.n
    motion = [x[:n], x[n:]]
    pressing: list[int] = []
    undecided = list(contacts)
    for _ in range(_ORDERS):
        free, size = phases.free(unloaded, t, motion)
        directions = phases.B[:, undecided]
        if pressing:
            basis = orthonormal(phases.B[:, pressing])
            directions, free = without(basis, directions), without(basis, free)
        directions = directions / phases.length[undecided]
        pushed, acceleration = _least(phases, undecided, directions, free)
        separating = acceleration.dot(directions)
        motion.append(phases.unwhite(acceleration))
        decided = zip(undecided, pushed.tolist(), separating.tolist(), strict=True)
        undecided = []
        for i, load, away in decided:
            if load > _ZERO * size:
                pressing.append(i)
            elif away <= _ZERO * size:
                undecided.append(i)
        if not undecided:
            break
    closed = tuple(sorted([*pressing, *undecided]))
    return Grip(closed, phases.independent((*pressing, *undecided)))


def _least(
    phases: Phases, contacts: list[int], directions: Matrix, free: Vector
) -> tuple[Vector, Vector]:
    """Loads on unit ``directions``, and the acceleration with them, both of length as energy."""
    independent = np.linalg.norm(directions, axis=0) > RANK
    pushed = np.zeros(len(contacts))
    size = math.sqrt(free.dot(free))
    if size > 0 and independent.any():
        loads = nonnegative(directions[:, independent], -free / size)
        if loads is None:
            names = ", ".join(repr(phases.system.contact_names[i]) for i in contacts)
            raise DynamicsError(
                f"contacts {names}: the loads that hold them cannot be found;"
                " are their directions almost the same?"
            )
        pushed[independent] = size * loads
    return pushed, free + directions @ pushed
