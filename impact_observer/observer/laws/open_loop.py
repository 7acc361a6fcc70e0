"""No correction at all: the yardstick of every other law."""

from typing import ClassVar

from impact_observer.dynamics import Motion
from impact_observer.observer.laws.law import Law
from impact_observer.states import Vector


class OpenLoop(Law):
    """The replica moves without contact and hears nothing of the plant."""

    name: ClassVar[str] = "open-loop"

    def impact(self, x: Vector, active: tuple[int, ...], closed: tuple[int, ...]) -> Vector:
        """The state as it was."""
        del active, closed
        return x

    def motion(self, t: float, x: Vector, closed: tuple[int, ...]) -> Motion:
        """The motion without contact."""
        del closed
        return super().motion(t, x, ())
