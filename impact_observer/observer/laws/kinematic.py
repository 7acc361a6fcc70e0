"""Switched kinematic unilateral constraints: Baumann and Leine's first observer."""

from typing import ClassVar

import numpy as np

from impact_observer.dynamics import ImpactLaw
from impact_observer.model import System
from impact_observer.observer.laws.law import Law
from impact_observer.states import Vector


class Kinematic(Law):
    """A closed contact acts as a sprag clutch: velocities jump, positions never do.

    Reference [1] of the paper: Newton's impact law on the contacts with ``chi = 1``, with the
    replica's own contact speeds, so without impulse where those separate. While ``chi`` stays 1,
    ``0 <= gamma _|_ lambda >= 0``.
    """

    name: ClassVar[str] = "kinematic"

    def __init__(self, system: System) -> None:
        """Prepare Newton's law."""
        super().__init__(system)
        self._newton = ImpactLaw(system)

    def impact(self, x: Vector, active: tuple[int, ...], closed: tuple[int, ...]) -> Vector:
        """``u+`` by Newton's law, ``q+ = q-``."""
        n = self.system.n
        return np.concatenate([x[:n], self._newton.velocity_held(x[n:], active, closed)])
