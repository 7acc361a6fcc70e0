"""What is wrong with the true states of a bag, in one pass and constant memory."""

from collections.abc import Callable, Iterator
from typing import cast

import numpy as np

from impact_observer.check.findings import ERROR, NOTE, WARNING, Finding, Seen, listed, times
from impact_observer.errors import BagError
from impact_observer.io.interfaces import JOINT_STATE
from impact_observer.io.messages import JointStateMessage, MessageError, read_joint_state
from impact_observer.io.state_blocks import decode
from impact_observer.model import System
from impact_observer.stamps import MAX_STAMP, text
from impact_observer.states import Stamps

_BLOCK = 1024
"""Messages that are looked at together."""


class StateCheck:
    """Listens to all joint states of a topic, in bag order.

    Attributes:
        topic: the absolute name.
        count: messages, valid or not.
        first: the earliest stamp, ns; 0 before any.
        last: the latest stamp, ns; 0 before any.
    """

    def __init__(self, topic: str, deserialize: Callable[[bytes], object]) -> None:
        """Listen to ``topic``.

        Args:
            topic: the absolute name.
            deserialize: makes a message of bytes, or raises ``BagError``.
        """
        self.topic = topic
        self.count = self.first = self.last = 0
        self._deserialize = deserialize
        self._pending: list[bytes] = []
        self._invalid, self._renamed = Seen(), Seen()
        self._names: tuple[str, ...] | None = None

    def hear(self, data: bytes) -> None:
        """One more message, serialized."""
        self._pending.append(data)
        if len(self._pending) == _BLOCK:
            self._look()

    def findings(self, system: System | None, events: tuple[int, int] | None) -> Iterator[Finding]:
        """What is wrong.

        Args:
            system: of the model, if one is known.
            events: first and last stamp of the impacts, ns; None without any.
        """
        self._look()
        for seen, what in ((self._invalid, "no state"), (self._renamed, "other coordinates")):
            if seen.count:
                have = "has" if seen.count == 1 else "have"
                yield Finding(
                    ERROR,
                    self.topic,
                    f"{times(seen.count, 'message')} {have} {what}, the first is {seen.first}",
                    "one finite position and velocity for every coordinate, the same throughout",
                    "observe and compare refuse it; record again, or leave the topic out",
                )
        names = self._names or ()
        if self._names and system is not None and set(names) != set(system.coordinates):
            yield Finding(
                WARNING,
                self.topic,
                f"states of {listed(names)}",
                f"the coordinates {listed(system.coordinates)} of the model {system.name}",
                "compare cannot use them; name the model's coordinates alike",
            )
        if events is not None and self.last:
            yield from self._about_time(*events)

    def _about_time(self, first: int, last: int) -> Iterator[Finding]:
        """Whether the truth is there when there are events, but for one of its steps."""
        step = (self.last - self.first) // max(self.count - 1, 1)
        if self.first - step <= first and last <= self.last + step:
            return
        differences = last < self.first or self.last < first
        yield Finding(
            WARNING if differences else NOTE,
            self.topic,
            f"the truth is from {text(self.first)} to {text(self.last)} s, the impacts are from"
            f" {text(first)} to {text(last)} s",
            remedy="nothing can be compared; are both stamped by one clock?"
            if differences
            else "only what is common can be compared",
        )

    def _look(self) -> None:
        """Look at what has been heard."""
        block, self._pending = self._pending, []
        together, alone = decode(JOINT_STATE, block)
        for rows in together:
            try:
                self._note_names(block, int(rows.at[0]))
            except BagError:  # names that are no text: all of these have them
                alone += rows.at.tolist()
                continue
            sound = rows.sound
            if not sound.all():
                alone += rows.at[~sound].tolist()
            self._note_stamps(rows.stamps[sound])
        for i in sorted(alone):
            self._note_alone(block, i)
        self.count += len(block)

    def _note_names(self, block: list[bytes], i: int) -> None:
        """Compare the coordinates of a message, and all of its shape, with the first ones."""
        names = tuple(cast("JointStateMessage", self._deserialize(block[i])).name)
        if self._names is None:
            self._names = names
        if sorted(names) != sorted(self._names) or len(set(names)) < len(names):
            self._renamed.note(f"message {self.count + i}: {listed(names)}")

    def _note_alone(self, block: list[bytes], i: int) -> None:
        """Note a message that is out of the ordinary."""
        try:
            state = read_joint_state(cast("JointStateMessage", self._deserialize(block[i])))
        except (BagError, MessageError) as error:
            self._invalid.note(f"message {self.count + i}: {error}")
            return
        self._note_names(block, i)
        self._note_stamps(np.array([state.stamp]))

    def _note_stamps(self, stamps: Stamps) -> None:
        if stamps.size:
            self.first = min(self.first or MAX_STAMP, int(stamps.min()))
            self.last = max(self.last, int(stamps.max()))
