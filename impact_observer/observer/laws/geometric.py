"""Switched geometric unilateral constraints: the paper's contribution."""

from typing import ClassVar

import numpy as np

from impact_observer.dynamics import ImpactLaw, Motion, PositionProjection
from impact_observer.model import System
from impact_observer.observer.laws.law import Law
from impact_observer.states import Vector


class Geometric(Law):
    """Positions jump too: onto ``g = 0`` of the closed contacts, as little as ``K`` allows.

    Baumann and Leine (ENOC 2014), equations (2) to (5): ``Sigma = -L^-1 g_A(q-)`` and
    ``q+ = q- + K^-1 W_A Sigma``, with Newton's impact law on the velocities. While ``chi`` stays
    1, ``sigma = -L^-1 gamma_A`` keeps ``g_A = 0`` (``dynamics.phase``). For singular ``K`` see
    ``dynamics.projection``.
    """

    name: ClassVar[str] = "geometric"

    def __init__(self, system: System) -> None:
        """Prepare Newton's law and the projection."""
        super().__init__(system)
        self._newton = ImpactLaw(system)
        self._projection = PositionProjection(system)

    def impact(self, x: Vector, active: tuple[int, ...], closed: tuple[int, ...]) -> Vector:
        """``q+`` by projection, ``u+`` by Newton's law."""
        n = self.system.n
        position = self._projection.position_after(x[:n], active)
        if closed != active:  # gaps that cannot all be zero are told: those that stay count
            position = self._projection.position_after(position, closed)
        return np.concatenate([position, self._newton.velocity_held(x[n:], active, closed)])

    def motion(self, t: float, x: Vector, closed: tuple[int, ...]) -> Motion:
        """Sprag clutches whose gaps stay closed."""
        return self._clutches.motion(t, x, closed, fix=True)
