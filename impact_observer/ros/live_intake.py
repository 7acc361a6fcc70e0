# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of a node to the live forces and grounds of its model, and to a drive."""

import time
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial

from rclpy.node import Node
from rclpy.subscription import Subscription

from impact_observer.io import interfaces
from impact_observer.io.live_inputs import give, read_pulse
from impact_observer.io.messages import AnyMessage, MessageError
from impact_observer.model.live_signals import LiveSignals
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.qos import qos_profile
from impact_observer.ros.subscribing import (
    SLICE,
    Ahead,
    Polled,
    slice_of_waiting,
    with_waiting,
)
from impact_observer.stamps import MAX_STAMP, NS_PER_S, from_seconds

_MOST_AHEAD = 2000
"""Messages that wait for the clock."""


class LiveIntake:
    """Gives the samples that a node receives to the signals of its model.

    What is too far ahead of the clock is used once that has come near enough: it may be the clock
    that is late.

    Attributes:
        counts: ``samples``: those received; ``invalid samples``: those that cannot be used.
    """

    def __init__(
        self,
        node: Node,
        live: LiveSignals | None,
        on_problem: Callable[[str], None],
        clock: tuple[Callable[[], int], float],
        *,
        polled: bool = False,
        on_samples: Callable[[int], None] = lambda _: None,
        on_pulse: Callable[[int], None] | None = None,
    ) -> None:
        """Subscribe to what ``live`` needs, and to pulses of a drive where ``on_pulse`` does.

        Args:
            node: whose subscriptions they are.
            live: signals; None where the model has none.
            on_problem: called with the line on a sample that cannot be used.
            clock: the time, ns, and how far ahead of it a stamp may be, s.
            polled: whether samples of forces and grounds wait for ``take_waiting``, which costs a
                third of taking each when it arrives.
            on_samples: called after new samples with the stamp from which on they change what is
                known, ns.
            on_pulse: called with the stamp of each pulse of a drive, ns.
        """
        self._live = live
        self._on_problem, self._on_samples, self._on_pulse = on_problem, on_samples, on_pulse
        self._now, self._future = clock
        self.counts: Counter[str] = Counter()
        self._ahead = Ahead[Callable[[], int]](_MOST_AHEAD)
        self._is_early = False
        self._polled: list[tuple[interfaces.Interface, Subscription]] = []
        self._subscriptions = [*self._subscribed(node, polled=polled)]

    def _subscribed(self, node: Node, *, polled: bool) -> Iterable[Subscription]:
        live = self._live
        for interface, is_needed in (
            (interfaces.FORCING, live is not None and live.inputs),
            (interfaces.GROUND_MOTION, live is not None and live.grounds),
            (interfaces.PHASE_REFERENCE, self._on_pulse or (live is not None and live.drive)),
        ):
            if not is_needed:
                continue
            waits = polled and interface is not interfaces.PHASE_REFERENCE
            found = self._subscription(node, interface, Polled() if waits else None)
            if waits:
                self._polled.append((interface, found))
            yield found

    def _subscription(
        self, node: Node, interface: interfaces.Interface, group: Polled | None
    ) -> Subscription:
        """A subscription that takes all that waits at once: the executor is slow."""

        def take(message: AnyMessage) -> None:
            since = self._take_no_longer_ahead()
            for each in with_waiting(message, subscription, interface.quality.depth):
                since = min(since, self._take(interface, each))
            self._on_samples(since)

        quality = qos_profile(interface.quality)
        subscription: Subscription = node.create_subscription(
            message_class(interface.type), interface.name, take, quality, callback_group=group
        )
        return subscription

    def take_waiting(self) -> bool:
        """Take the samples that wait where subscriptions are polled; whether more may wait."""
        end, since = time.monotonic_ns() + SLICE, self._take_no_longer_ahead()
        for interface, subscription in self._polled:
            for message in slice_of_waiting(subscription, interface.quality.depth):
                since = min(since, self._take(interface, message))
        if since < MAX_STAMP:
            self._on_samples(since)
        return time.monotonic_ns() >= end

    def _take(self, interface: interfaces.Interface, message: AnyMessage) -> int:
        """Give what is in a message; the stamp from which on that changes something, ns."""
        if interface is interfaces.PHASE_REFERENCE:
            self.counts["samples"] += 1
            try:
                stamp = read_pulse(message)
            except MessageError as error:
                self._refuse(interface, [str(error)])
                return MAX_STAMP
            return self._now_or_later(interface, stamp, partial(self._give_pulse, stamp))
        stamp = int(message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec)
        self.counts["samples"] += len(message.name)
        return self._now_or_later(
            interface, stamp, partial(self._give_samples, interface, message, stamp)
        )

    def _now_or_later(
        self, interface: interfaces.Interface, stamp: int, gives: Callable[[], int]
    ) -> int:
        """Give what holds at ``stamp`` (ns) if the clock is near enough, else later."""
        since = MAX_STAMP
        if self._live is None or stamp > max(self._live.newest):  # else no need to read the clock
            now = self._now()
            if now and (ahead := (stamp - now) / NS_PER_S) > self._future:
                self._wait(interface, stamp, ahead, gives)
                return MAX_STAMP
            since = self._take_no_longer_ahead(now)  # these come first
        self._is_early = False
        return min(since, gives())

    def _wait(
        self, interface: interfaces.Interface, stamp: int, ahead: float, gives: Callable[[], int]
    ) -> None:
        """Give it once the clock is near enough; the first of several is logged."""
        what = f"{interface.name}: stamped {ahead:.3f} s after the clock"
        if not self._is_early:
            self._on_problem(f"{what}; future allows {self._future:g} s, and it waits")
        self._is_early = True
        if self._ahead.add(stamp, gives) is not None:
            self._refuse(interface, [f"more than {_MOST_AHEAD} messages are ahead of the clock"])

    def _take_no_longer_ahead(self, now: int = 0) -> int:
        """Give what the clock has come to; the stamp from which on it changes something, ns."""
        since = MAX_STAMP
        latest = (now or self._now()) + from_seconds(self._future) if self._ahead else 0
        while (gives := self._ahead.taken(latest)) is not None:
            since = min(since, gives())
        return since

    def clear(self) -> None:
        """Forget what waits for the clock, as when that has jumped back."""
        self._ahead.clear()

    def _give_samples(
        self, interface: interfaces.Interface, message: AnyMessage, stamp: int
    ) -> int:
        assert self._live is not None, "there are signals"
        self._refuse(interface, give(self._live, interface, message))
        return stamp

    def _give_pulse(self, stamp: int) -> int:
        """The stamp from which on the phase of the drive changes, ns."""
        if self._on_pulse is not None:
            self._on_pulse(stamp)
        if self._live is None or self._live.drive is None:
            return MAX_STAMP
        problems = filter(None, [self._live.add_pulse(stamp)])
        self._refuse(interfaces.PHASE_REFERENCE, problems)
        return self._live.turned_from

    def _refuse(self, interface: interfaces.Interface, problems: Iterable[str]) -> None:
        """Tell why samples cannot be used."""
        for problem in problems:
            self.counts["invalid samples"] += 1
            self._on_problem(f"{interface.name}: {problem}")

    def ages(self, now: int) -> dict[str, float]:
        """How old the newest sample of each signal is at ``now`` (ns), s; infinite without any."""
        if self._live is None:
            return {}
        return {
            name: (now - newest) / NS_PER_S if newest else float("inf")
            for name, newest in zip(self._live.names, self._live.newest, strict=True)
        }

    def silent(self, now: int, timeout: float) -> str:
        """Which signals have had no sample for longer than ``timeout`` (s), in one line."""
        old = {name: age for name, age in self.ages(now).items() if age > timeout}
        parts = [
            f"no sample of {name} for {age:.3g} s" if age < float("inf") else f"none of {name} yet"
            for name, age in old.items()
        ]
        return f"{', '.join(parts)}; input_timeout is {timeout:g} s" if parts else ""
