# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of a node to live forces and efforts of its model, and to its epoch."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface
from impact_observer.io.live_inputs import give
from impact_observer.io.messages import AnyMessage, MessageError, read_pulse
from impact_observer.model.live_signals import LiveSignals
from impact_observer.ros.base_node import BaseNode, ClockGate, Receiver
from impact_observer.stamps import MAX_STAMP, NS_PER_S

_MOST_AHEAD = 2000
"""Messages that wait for the clock."""


class LiveIntake:
    """Gives the samples that a node receives to the signals of its model.

    A sample that is too far ahead of the clock is used once the clock is near: perhaps the clock
    is late.

    Attributes:
        counts: ``samples``: samples received; ``invalid samples``: samples that cannot be used.
    """

    def __init__(
        self,
        node: BaseNode,
        live: LiveSignals | None,
        *,
        now: Callable[[], int],
        future: float,
        on_problem: Callable[[str], None],
        on_samples: Callable[[int], None],
        on_pulse: Callable[[int], None] | None = None,
        efforts: Interface | None = None,
        subscribes: bool = True,
    ) -> None:
        """Subscribe to the topics of ``live``, and to a drive if there is ``on_pulse``.

        Args:
            node: owner of the subscriptions.
            live: signals of the model; None if the model has none.
            now: time of the node's clock, ns; 0 while there is none.
            future: how far ahead of the clock a stamp may be, s.
            on_problem: called with a line on samples that cannot be used.
            on_samples: called after new samples with the stamp from which on they change what is
                known, ns.
            on_pulse: called with the stamp of each pulse of a drive, ns.
            efforts: topic of the forces, which may have others too; None for ``FORCING``.
            subscribes: whether to subscribe to the topic of ``efforts``; else ``take_efforts``.
        """
        self._efforts = efforts
        self._live = live
        self._on_problem, self._on_samples, self._on_pulse = on_problem, on_samples, on_pulse
        self.counts: Counter[str] = Counter()
        self._ahead = ClockGate[tuple[Interface, AnyMessage]](now, future, _MOST_AHEAD)
        for interface, is_needed in (
            (efforts or interfaces.FORCING, live is not None and live.inputs and subscribes),
            (interfaces.PHASE_REFERENCE, on_pulse),
        ):
            if is_needed:
                take = partial(self.take_messages, interface)
                Receiver(node, interface.name, take).connect(interface.type, interface.quality)

    def take_messages(self, interface: Interface, messages: Sequence[AnyMessage]) -> None:
        """Use the samples in ``messages`` of one topic, or keep them until the clock is near."""
        self._tell_samples(self._use(interface, messages))

    def take_efforts(self, messages: Sequence[AnyMessage]) -> None:
        """Use the efforts in ``messages`` whose other samples are used next."""
        if self._live is not None and self._efforts is not None:
            self._use(self._efforts, messages)

    def _use(self, interface: Interface, messages: Sequence[AnyMessage]) -> int:
        since = self._give_what_was_ahead()
        for message in messages:
            self.counts["samples"] += (
                1 if interface is interfaces.PHASE_REFERENCE else len(message.name)
            )
            stamp = _stamp_in(interface, message)
            if not (reason := self._ahead.reason(stamp)):
                since = min(since, self._give(interface, message, stamp))
                continue
            self._on_problem(f"{interface.name}: {reason}")
            if self._ahead.keep(stamp, (interface, message)) is not None:
                self._refuse(
                    interface, [f"more than {_MOST_AHEAD} messages are ahead of the clock"]
                )
        return since

    def take_what_was_ahead(self) -> None:
        """Use the samples to which the clock has come near."""
        self._tell_samples(self._give_what_was_ahead())

    def clear(self) -> None:
        """Forget the samples that wait for the clock, as after a jump of the clock."""
        self._ahead.clear()

    def ages(self, now: int) -> dict[str, float]:
        """Age of the newest sample of each signal at ``now`` (ns), s; infinite without any."""
        if self._live is None:
            return {}
        return {
            name: (now - newest) / NS_PER_S if newest else float("inf")
            for name, newest in zip(self._live.inputs, self._live.newest, strict=True)
        }

    def silent(self, now: int, timeout: float) -> str:
        """The signals without a sample for longer than ``timeout`` (s), in one line."""
        old = {name: age for name, age in self.ages(now).items() if age > timeout}
        parts = [
            f"no sample of {name} for {age:.3g} s" if age < float("inf") else f"none of {name} yet"
            for name, age in old.items()
        ]
        return f"{', '.join(parts)}; input_timeout is {timeout:g} s" if parts else ""

    def _tell_samples(self, since: int) -> None:
        if since < MAX_STAMP:
            self._on_samples(since)

    def _give_what_was_ahead(self) -> int:
        """Use the samples to which the clock has come near; see ``_give``."""
        since = MAX_STAMP
        for interface, message in self._ahead.near():
            since = min(since, self._give(interface, message, _stamp_in(interface, message)))
        return since

    def _give(self, interface: Interface, message: AnyMessage, stamp: int) -> int:
        """Give a message to the signals.

        Returns:
            The stamp from which on the samples change what is known, ns; else ``MAX_STAMP``.
        """
        is_pulse = interface is interfaces.PHASE_REFERENCE
        if is_pulse and self._on_pulse is not None:
            try:
                self._on_pulse(read_pulse(message))
            except MessageError as error:
                self._refuse(interface, [str(error)])
                return MAX_STAMP
        if self._live is None or is_pulse:
            return MAX_STAMP
        self._refuse(interface, give(self._live, interface, message))
        return stamp

    def _refuse(self, interface: Interface, problems: Iterable[str]) -> None:
        """Count and report samples that cannot be used."""
        for problem in problems:
            self.counts["invalid samples"] += 1
            self._on_problem(f"{interface.name}: {problem}")


def _stamp_in(interface: Interface, message: AnyMessage) -> int:
    """The unchecked stamp of a message, ns."""
    time = (message if interface is interfaces.PHASE_REFERENCE else message.header).stamp
    return int(time.sec) * NS_PER_S + int(time.nanosec)
