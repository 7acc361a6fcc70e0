# SPDX-License-Identifier: Apache-2.0
"""No correction at all: the reference for every other law."""

from typing import ClassVar

from impact_observer.dynamics import Motion, Phase
from impact_observer.events import Contacts
from impact_observer.observer.laws.replica_law import ReplicaLaw
from impact_observer.states import Vector


class OpenLoop(ReplicaLaw):
    """The replica moves without contact and uses no events."""

    name: ClassVar[str] = "open-loop"
    uses_events: ClassVar[bool] = False

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """The same states."""
        del active, closed
        return x

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """The motion without contact."""
        del closed
        return super().motion(t, x, ())

    def phase(self, closed: Contacts) -> Phase | None:
        """The motion without contact, always."""
        del closed
        return self._free
