"""What every law is."""

from abc import ABC, abstractmethod
from typing import ClassVar

from impact_observer.dynamics import Clutches, Motion
from impact_observer.model import System
from impact_observer.states import Vector


class Law(ABC):
    """What a replica does while contacts of the plant are closed.

    Attributes:
        name: what users choose it by.
    """

    name: ClassVar[str]

    def __init__(self, system: System) -> None:
        """Prepare the law for one ``system``."""
        self.system = system
        self._clutches = Clutches(system)

    @abstractmethod
    def impact(self, x: Vector, active: tuple[int, ...], closed: tuple[int, ...]) -> Vector:
        """The replica's state after an impact of the plant.

        Args:
            x: the replica's state (q-, u-), shape (2n,); not changed.
            active: indices of the contacts with ``chi = 1`` at this instant, ascending.
            closed: indices of those with ``chi = 1`` from now on, a part of ``active``.

        Returns:
            (q+, u+), shape (2n,).

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
        """

    def motion(self, t: float, x: Vector, closed: tuple[int, ...]) -> Motion:
        """The replica's motion until the next event: sprag clutches, unless a law says else.

        Args:
            t: s since the epoch.
            x: the replica's state (q, u), shape (2n,).
            closed: indices of the contacts with ``chi = 1`` meanwhile, ascending.
        """
        return self._clutches.motion(t, x, closed, fix=False)
