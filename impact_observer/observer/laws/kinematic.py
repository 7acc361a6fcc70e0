# SPDX-License-Identifier: Apache-2.0
"""Switched kinematic unilateral constraints: Baumann and Leine's first observer."""

from typing import ClassVar

import numpy as np

from impact_observer.dynamics import Phase
from impact_observer.events import Contacts
from impact_observer.observer.laws.replica_law import ReplicaLaw
from impact_observer.states import Vector


class Kinematic(ReplicaLaw):
    """A closed contact acts as a sprag clutch: velocities jump, positions never do.

    Reference [1] of the paper: Newton's impact law on the contacts with ``chi = 1`` and the
    replica's own contact speeds. There is no impulse where those separate. While ``chi`` stays 1,
    ``0 <= gamma _|_ lambda >= 0``.
    """

    name: ClassVar[str] = "kinematic"

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """``u+`` by Newton's law, ``q+ = q-``."""
        n = self.system.n
        after = self.newton.velocity_held(x[..., n:], active, closed)
        return np.concatenate([x[..., :n], after], axis=-1)

    def phase(self, closed: Contacts) -> Phase | None:
        """Free flight; None where clutches may slip, as they do at different times."""
        return None if closed else self._free
