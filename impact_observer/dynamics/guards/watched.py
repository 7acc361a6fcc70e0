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

"""What is watched along a motion: functions that end a phase when they fall below zero."""

from dataclasses import dataclass

import numpy as np

from impact_observer.dynamics.flow.flow import Functions
from impact_observer.dynamics.flow.phase import Phase
from impact_observer.model import Forcing, System
from impact_observer.states import Matrix, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """Functions ``h = a p + b u + c f(t) + d`` of a motion (p, u), a row each.

    Attributes:
        position: ``a``, shape (w, n).
        velocity: ``b``, shape (w, n).
        force: ``c``, shape (w, n).
        constant: ``d``, shape (w,).
    """

    position: Matrix
    velocity: Matrix
    force: Matrix
    constant: Vector

    @classmethod
    def gaps(cls, system: System, contacts: list[int], phase: Phase | None = None) -> "Watched":
        """The gaps of ``contacts``: below zero they are penetrated.

        Args:
            system: whose contacts.
            contacts: indices.
            phase: in whose coordinates; None where these are the system's.
        """
        a, d = system.W[:, contacts].T, system.q_r[contacts]
        if phase is not None and phase.fixed:
            a, d = a @ phase.Q, d + a @ phase.rest
        return cls(a, np.zeros_like(a), np.zeros_like(a), d)

    def negated(self) -> "Watched":
        """The functions with the other sign."""
        return Watched(-self.position, -self.velocity, -self.force, -self.constant)

    @classmethod
    def speeds(cls, system: System, contacts: list[int]) -> "Watched":
        """The contact speeds of ``contacts``: at zero a slipping one is held."""
        return cls.of_velocity(system.W[:, contacts].T)

    @classmethod
    def of_velocity(cls, b: Matrix) -> "Watched":
        """``b u``, shape (w, n): reactions ``sigma`` of stops are such functions."""
        return cls(np.zeros_like(b), b, np.zeros_like(b), np.zeros(len(b)))

    @classmethod
    def loads(cls, phase: Phase) -> "Watched":
        """The loads ``lambda`` of the held contacts: below zero they are released."""
        which = [phase.held.index(i) for i in phase.pressed]
        return cls._of_loads(phase, phase.loads[which], np.zeros(len(which)))

    @classmethod
    def guides(cls, system: System, phase: Phase) -> "Watched":
        """What ends the guides' part in ``phase``, in the order of ``Rubbing.ends``.

        The load of one that sticks is at most its force in size, one that slips does not turn.
        """
        n, m, most = system.n, system.m, system.friction
        found = cls.of_velocity(np.zeros((0, n)))
        if phase.rubbing is None:
            return found
        for j, side in phase.rubbing.ends:
            if side:
                row = -side * phase.loads[[phase.held.index(m + j)]]
                one = cls._of_loads(phase, row, most[[j]])
            else:
                one = cls.of_velocity(-np.sign(phase.rubbing.loads[j]) * system.W_T[:, [j]].T)
            found = found.and_also(one)
        return found

    @classmethod
    def _of_loads(cls, phase: Phase, H: Matrix, constant: Vector) -> "Watched":
        """``constant - H (f - C u - K p)``, in which ``f`` has the constant loads of guides."""
        equations = phase.equations
        return cls(H @ equations.K, H @ equations.C, -H, constant)

    def and_also(self, other: "Watched") -> "Watched":
        """The functions of both, these first."""
        return Watched(
            np.vstack([self.position, other.position]),
            np.vstack([self.velocity, other.velocity]),
            np.vstack([self.force, other.force]),
            np.concatenate([self.constant, other.constant]),
        )

    def functions(self, forcing: Forcing) -> Functions:
        """The same functions under ``forcing``."""
        driven = np.vstack([forcing.constant, forcing.cosine, forcing.sine]) @ self.force.T
        driven[0] += self.constant
        return Functions(np.hstack([self.position, self.velocity]), driven.T, self.force)
