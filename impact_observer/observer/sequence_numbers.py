"""Which of the numbers that a sender gives its events have come."""

_LEAST = 64
"""Numbers that need not be forgotten."""


class SequenceNumbers:
    """Sequence numbers with their events' stamps, back to a bounded past.

    Attributes:
        first: the lowest that has come; 0 before any.
        highest: that has come; 0 before any.
    """

    def __init__(self) -> None:
        """Nothing has come."""
        self.first = self.highest = self._count = self._forgotten = 0
        self._stamps: dict[int, int] = {}
        self._room = _LEAST

    def __len__(self) -> int:
        """How many are remembered."""
        return len(self._stamps)

    def __contains__(self, sequence: int) -> bool:
        """Whether it has come, and is remembered."""
        return sequence in self._stamps

    @property
    def missing(self) -> int:
        """Numbers that have not come in time, since the first that came."""
        return self.highest - self.first + 1 - self._count if self.highest else 0

    def gap(self, sequence: int) -> str:
        """What ``sequence`` reveals to be missing, in words; empty for nothing."""
        if self.highest and sequence > self.highest + 1:
            return _are_missing(self.highest + 1, sequence - 1, "before")
        if 0 < sequence < self.first - 1:
            return _are_missing(sequence + 1, self.first - 1, "after")
        return ""

    def note(self, sequence: int, stamp: int) -> None:
        """Note that ``sequence`` has come, with the stamp (ns) of its event."""
        if sequence > self._forgotten:
            self.highest = max(self.highest, sequence)
            if sequence < self.first or not self.first:
                self.first = sequence
            self._count += 1
            self._stamps[sequence] = stamp

    def undo(self, sequence: int) -> None:
        """``sequence`` is missing after all: its event could not be applied."""
        if self._stamps.pop(sequence, None) is not None:
            self._count -= 1

    def forget_before(self, stamp: int) -> None:
        """Drop what came with an earlier stamp (ns), but the highest; now and then, not each time.

        So each number is looked at a few times in all, however many there are.
        """
        if len(self._stamps) < self._room:
            return
        old = {k for k, at in self._stamps.items() if at < stamp and k != self.highest}
        self._forgotten = max(old, default=self._forgotten)
        self._stamps = {k: at for k, at in self._stamps.items() if k not in old}
        self._room = max(2 * len(self._stamps), _LEAST)

    def keep(self, most: int) -> None:
        """Drop all but the ``most`` highest; now and then, not each time."""
        if len(self._stamps) < 2 * most:
            return
        kept = sorted(self._stamps)[-most:]
        self._forgotten = max(self._forgotten, kept[0] - 1)
        self._stamps = {k: self._stamps[k] for k in kept}


def _are_missing(low: int, high: int, side: str) -> str:
    """Numbers ``low`` to ``high`` are missing before or after an event."""
    if low == high:
        return f"event {low} {side} it is missing"
    return f"events {low} to {high} {side} it are missing"
