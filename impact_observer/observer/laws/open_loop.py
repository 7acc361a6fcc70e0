"""No correction at all: the yardstick of every other law."""

from typing import ClassVar

from impact_observer.observer.laws.law import Law
from impact_observer.states import Vector


class OpenLoop(Law):
    """The replica moves without contact and hears nothing of the plant."""

    name: ClassVar[str] = "open-loop"

    def impact(self, x: Vector, active: tuple[int, ...]) -> Vector:
        """The state as it was."""
        del active
        return x
