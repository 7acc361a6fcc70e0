"""Which sequence numbers of a sender have been received."""

_LEAST = 64
"""Numbers that need not be forgotten."""


class SequenceNumbers:
    """Sequence numbers with the stamps of their events, back to a bounded past.

    Attributes:
        first: the lowest received; 0 before any.
        highest: the highest received; 0 before any.
    """

    def __init__(self) -> None:
        """Start with none received."""
        self.first = self.highest = self._count = self._forgotten = 0
        self._stamps: dict[int, int] = {}
        self._room = _LEAST

    def __len__(self) -> int:
        """How many are remembered."""
        return len(self._stamps)

    def __contains__(self, sequence: int) -> bool:
        """Whether it was received, and is remembered."""
        return sequence in self._stamps

    @property
    def missing(self) -> int:
        """How many numbers are missing since the first received."""
        return self.highest - self.first + 1 - self._count if self.highest else 0

    def gap(self, sequence: int) -> str:
        """The numbers that are missing beside ``sequence``, in words; empty for none."""
        if self.highest and sequence > self.highest + 1:
            return _are_missing(self.highest + 1, sequence - 1, "before")
        if 0 < sequence < self.first - 1:
            return _are_missing(sequence + 1, self.first - 1, "after")
        return ""

    def add(self, sequence: int, stamp: int) -> None:
        """Add ``sequence``, with the stamp (ns) of its event."""
        if sequence > self._forgotten:
            self.highest = max(self.highest, sequence)
            if sequence < self.first or not self.first:
                self.first = sequence
            self._count += 1
            self._stamps[sequence] = stamp

    def discard(self, sequence: int) -> None:
        """Count ``sequence`` as missing: its event could not be applied."""
        if self._stamps.pop(sequence, None) is not None:
            self._count -= 1

    def forget_before(self, stamp: int) -> None:
        """Drop numbers with earlier stamps (ns), but the highest; only when there are many.

        So the cost per number is constant, however many there are.
        """
        if len(self._stamps) < self._room:
            return
        old = {k for k, at in self._stamps.items() if at < stamp and k != self.highest}
        self._forgotten = max(old, default=self._forgotten)
        self._stamps = {k: at for k, at in self._stamps.items() if k not in old}
        self._room = max(2 * len(self._stamps), _LEAST)

    def keep_highest(self, most: int) -> None:
        """Drop all but the ``most`` highest, once there are twice as many."""
        if len(self._stamps) < 2 * most:
            return
        kept = sorted(self._stamps)[-most:]
        self._forgotten = max(self._forgotten, kept[0] - 1)
        self._stamps = {k: self._stamps[k] for k in kept}


def _are_missing(low: int, high: int, side: str) -> str:
    if low == high:
        return f"event {low} {side} it is missing"
    return f"events {low} to {high} {side} it are missing"
