# SPDX-License-Identifier: Apache-2.0
"""How many sequence numbers of a sender are missing."""

from impact_observer.events import Remark
from impact_observer.observer.event_order import NEAR_NUMBERS


class SequenceNumbers:
    """Counts the gaps in the sequence numbers of events, each of which is noted once.

    A number that leaps by more than ``NEAR_NUMBERS`` counts once the next one is near it; what
    lies between is not counted.

    Attributes:
        first: the lowest number; 0 before any.
        highest: the highest number; 0 before any.
        missing: how many numbers between them have not come, or could not be applied.
    """

    def __init__(self) -> None:
        """Start with no number."""
        self.first = self.highest = self.missing = self._leap = 0

    def note(self, sequence: int) -> tuple[Remark, str] | None:
        """Count the number of an event, 0 for none; returns a gap beside it, or a leap."""
        step = sequence - self.highest
        if not sequence or not self.highest:
            self.first = self.highest = max(sequence, self.highest)
        elif abs(step) > NEAR_NUMBERS:
            if not 0 < sequence - self._leap <= NEAR_NUMBERS:
                self._leap, before = sequence, self.highest
                return Remark.LEAP, f"its number leaps from {before}"
            self.highest = sequence
        elif step > 0:
            self.highest, self.missing = sequence, self.missing + step - 1
            if step > 1:
                return Remark.GAP, _are_missing(sequence - step + 1, sequence - 1, "before")
        elif sequence < self.first:
            high, self.first = self.first - 1, sequence
            self.missing += high - sequence
            if sequence < high:
                return Remark.GAP, _are_missing(sequence + 1, high, "after")
        else:
            self.missing = max(self.missing - 1, 0)
        return None

    def discard(self, sequence: int) -> None:
        """Count a number that was noted as missing: its event could not be applied."""
        self.missing += sequence > 0


def _are_missing(low: int, high: int, side: str) -> str:
    if low == high:
        return f"event {low} {side} it is missing"
    return f"events {low} to {high} {side} it are missing"
