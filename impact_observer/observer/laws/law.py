"""What every law is."""

from abc import ABC, abstractmethod
from typing import ClassVar

from impact_observer.model import System
from impact_observer.states import Vector


class Law(ABC):
    """How a replica jumps at an instant at which the plant's contacts are closed.

    Attributes:
        name: what users choose it by.
    """

    name: ClassVar[str]

    def __init__(self, system: System) -> None:
        """Prepare the law for one ``system``."""
        self.system = system

    @abstractmethod
    def impact(self, x: Vector, active: tuple[int, ...]) -> Vector:
        """The replica's state after an impact of the plant.

        Args:
            x: the replica's state (q-, u-), shape (2n,); not changed.
            active: indices of the contacts with ``chi = 1``, ascending.

        Returns:
            (q+, u+), shape (2n,).

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
        """
