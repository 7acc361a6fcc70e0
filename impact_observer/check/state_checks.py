# SPDX-License-Identifier: Apache-2.0
"""Checks of the true states in a bag, in one pass and constant memory."""

from collections.abc import Callable, Iterator

from impact_observer.check.findings import (
    ERROR,
    NOTE,
    WARNING,
    Finding,
    Occurrences,
)
from impact_observer.draw.reports import counted, listed
from impact_observer.errors import BagError
from impact_observer.io.messages import AnyMessage, MessageError, read_joint_state
from impact_observer.io.reader import RawMessage
from impact_observer.model import System
from impact_observer.model.robot_description import RobotDescription
from impact_observer.stamps import NS_PER_S, text

_FAR = 3600 * NS_PER_S
"""Difference of the stamps of two states in a row beyond which one of them is wrong, ns."""


class StateCheck:
    """Checks all joint states of a topic, in bag order.

    Attributes:
        topic: the absolute name.
        count: messages, valid or not.
        first: the earliest stamp, ns; 0 before any.
        last: the latest stamp, ns; 0 before any.
    """

    def __init__(self, topic: str, deserialize: Callable[[bytes], AnyMessage]) -> None:
        """Check ``topic``.

        Args:
            topic: the absolute name.
            deserialize: makes a message of bytes, or raises ``BagError``.
        """
        self.topic = topic
        self.count = self.first = self.last = 0
        self._deserialize = deserialize
        self._invalid, self._renamed, self._far = Occurrences(), Occurrences(), Occurrences()
        self._previous = 0
        self._names: tuple[str, ...] = ()

    def check_message(self, raw: RawMessage) -> None:
        """Check a message."""
        where = f"message {self.count}"
        self.count += 1
        try:
            state = read_joint_state(self._deserialize(raw.data))
        except (BagError, MessageError) as error:
            self._invalid.count_at(f"{where}: {error}")
            return
        if self._previous and abs(state.stamp - self._previous) > _FAR:
            hours = (state.stamp - self._previous) / NS_PER_S / 3600
            side = "after" if hours > 0 else "before"
            self._far.count_at(f"{where}, {abs(hours):.4g} h {side} the one before it")
        self._previous = state.stamp
        self._names = self._names or state.names
        if len(set(state.names)) < len(state.names) or set(state.names) != set(self._names):
            self._renamed.count_at(f"{where}: {listed(state.names, joint=', ')}")
        self.first = min(self.first or state.stamp, state.stamp)
        self.last = max(self.last, state.stamp)

    def findings(
        self, system: System | RobotDescription | None, events: tuple[int, int] | None
    ) -> Iterator[Finding]:
        """The findings.

        Args:
            system: system of the model; None without a model.
            events: first and last stamp of the impacts, ns; None without any.
        """
        for tally, what in ((self._invalid, "no state"), (self._renamed, "other coordinates")):
            if tally.count:
                have = "has" if tally.count == 1 else "have"
                yield Finding(
                    ERROR,
                    self.topic,
                    f"{counted(tally.count, 'message')} {have} {what}, the first is {tally.first}",
                    "one finite position and velocity for every coordinate, the same throughout",
                    "observe and compare refuse it; record again, or leave the topic out",
                )
        if self._far.count:
            jumps = counted(self._far.count, "jump")
            fault = f"{jumps} of the stamps, the first is {self._far.first}"
            remedy = "observe --rate makes estimates up to the last stamp; record again"
            yield Finding(WARNING, self.topic, fault, "stamps of one clock", remedy)
        if self._names and system is not None and set(self._names) != set(system.coordinates):
            fault = f"states of {listed(self._names, joint=', ')}"
            coordinates = listed(system.coordinates, joint=", ")
            wanted = f"the coordinates {coordinates} of the model {system.name}"
            remedy = "compare cannot use them; name the model's coordinates alike"
            yield Finding(WARNING, self.topic, fault, wanted, remedy)
        if events is not None and self.last:
            yield from self._time_findings(*events)

    def _time_findings(self, first: int, last: int) -> Iterator[Finding]:
        """Whether the truth covers the events, except for one sample at each end."""
        step = (self.last - self.first) // max(self.count - 1, 1)
        if self.first - step <= first and last <= self.last + step:
            return
        truth = f"the truth is from {text(self.first)} to {text(self.last)} s"
        fault = f"{truth}, the impacts are from {text(first)} to {text(last)} s"
        if last < self.first or self.last < first:
            remedy = "nothing can be compared; are both stamped by one clock?"
            yield Finding(WARNING, self.topic, fault, remedy=remedy)
        else:
            yield Finding(NOTE, self.topic, fault, remedy="only what is common can be compared")
