# SPDX-License-Identifier: Apache-2.0
"""Which sequence numbers of a sender have been received."""

from impact_observer.observer.event_order import NEAR_NUMBERS

_LEAST = 64
"""Fewer remembered numbers than this are not searched for old ones."""
_MOST_MISSING = 1_000_000
"""Most numbers skipped at once that count as missing; a larger step is a new count."""


class SequenceNumbers:
    """Sequence numbers with the stamps of their events, back to a bounded past.

    A number that leaps from the others counts once a second one confirms it.

    Attributes:
        first: the lowest number received; 0 before any.
        highest: the highest number received; 0 before any.
    """

    def __init__(self) -> None:
        """Start with no number."""
        self.first = self.highest = self._count = self._forgotten = self._leap = 0
        self._stamps: dict[int, int] = {}
        self._room = _LEAST

    def __len__(self) -> int:
        """How many numbers are remembered."""
        return len(self._stamps)

    def __contains__(self, sequence: int) -> bool:
        """Whether the number was received and is remembered."""
        return sequence in self._stamps

    def stamp_of(self, sequence: int) -> int:
        """The stamp of the first event with a number, ns; 0 if not remembered."""
        return self._stamps.get(sequence, 0)

    @property
    def missing(self) -> int:
        """How many numbers are missing since the first received."""
        return self.highest - self.first + 1 - self._count if self.highest else 0

    def follows(self, sequence: int) -> bool:
        """Whether a number is the next after the highest: the usual case."""
        return 0 < self.highest == sequence - 1

    def leaps(self, sequence: int) -> bool:
        """Whether a number is far from all others, the last leap included."""
        is_known = not sequence or not self.highest or self._is_near(sequence)
        return not (is_known or 0 < abs(sequence - self._leap) <= NEAR_NUMBERS)

    def _is_near(self, sequence: int) -> bool:
        return self.first - NEAR_NUMBERS <= sequence <= self.highest + NEAR_NUMBERS

    def gap(self, sequence: int) -> str:
        """The numbers that are missing beside ``sequence``, in words; empty for none."""
        low, high = self.highest + 1, sequence - 1
        if self.leaps(sequence) or not self.highest:
            return ""
        if low <= high and (self._is_near(sequence) or self._continues(sequence)):
            high = high if self._is_near(sequence) else min(high, self._leap - 1)
            return _are_missing(low, high, "before")
        if 0 < sequence < self.first - 1 and self._is_near(sequence):
            return _are_missing(sequence + 1, self.first - 1, "after")
        return ""

    def remember(self, sequence: int, stamp: int) -> None:
        """Remember the number of an event, with its stamp (ns); 0 is no number."""
        if not sequence:
            return
        numbers = [sequence]
        if self.highest and not self._is_near(sequence):
            if self.leaps(sequence):
                self._leap = sequence
                return
            numbers = [self._leap, sequence]
            if not self._continues(sequence):  # the sender counts from another number
                self.first = self.highest = self._count = self._forgotten = 0
                self._stamps = {}
        for each in numbers:
            if each > self._forgotten and each not in self._stamps:
                self.highest = max(self.highest, each)
                self.first = min(self.first or each, each)
                self._count += 1
                self._stamps[each] = stamp

    def _continues(self, sequence: int) -> bool:
        """Whether a number continues the count, which takes at least two numbers."""
        return self._count > 1 and self.highest < sequence <= self.highest + _MOST_MISSING

    def discard(self, sequence: int) -> None:
        """Count ``sequence`` as missing: its event could not be applied."""
        if self._stamps.pop(sequence, None) is not None:
            self._count -= 1

    def forget_before(self, stamp: int) -> None:
        """Drop numbers with earlier stamps (ns) except the highest, once many are remembered.

        So the cost per number is constant.
        """
        if len(self._stamps) < self._room:
            return
        old = {k for k, at in self._stamps.items() if at < stamp and k != self.highest}
        self._forgotten = max(old, default=self._forgotten)
        self._stamps = {k: at for k, at in self._stamps.items() if k not in old}
        self._room = max(2 * len(self._stamps), _LEAST)

    def keep_highest(self, most: int) -> None:
        """Drop all but the ``most`` highest numbers, once twice as many are remembered."""
        if len(self._stamps) < 2 * most:
            return
        kept = sorted(self._stamps)[-most:]
        self._forgotten = max(self._forgotten, kept[0] - 1)
        self._stamps = {k: self._stamps[k] for k in kept}


def _are_missing(low: int, high: int, side: str) -> str:
    if low == high:
        return f"event {low} {side} it is missing"
    return f"events {low} to {high} {side} it are missing"
