# SPDX-License-Identifier: Apache-2.0
"""What a fit does at present, and how much it may still try."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf

from impact_observer.errors import IdentificationError


class FitProgress:
    """Steps of a fit, reported to a listener, and the flights that a search may still compute.

    A search that ends after so many flights, and not after so many seconds, has the same answer
    on every machine.
    """

    def __init__(self, listener: Callable[[str], None] = lambda _: None) -> None:
        """Progress that ``listener`` receives in words."""
        self._listener, self._stage, self._left = listener, "", inf

    def stage(self, text: str) -> None:
        """Name the next step by ``text``."""
        self._stage = text
        self._listener(text)

    def __call__(self, text: str) -> None:
        """Report how far the present step is."""
        self._listener(f"{self._stage}: {text}")

    @contextmanager
    def at_most(self, flights: float) -> Iterator[None]:
        """Compute at most so many flights."""
        before, self._left = self._left, flights
        try:
            yield
        finally:
            self._left = before

    def spend(self, flights: int) -> None:
        """Count flights that are about to be computed.

        Raises:
            IdentificationError: they are more than are left, as all further ones will be.
        """
        if flights > self._left:
            self._left = 0.0
            raise IdentificationError("the search has tried all that it may; begin nearer")
        self._left -= flights
