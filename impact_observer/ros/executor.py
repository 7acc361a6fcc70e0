"""An executor that goes from the middleware to a callback in one step."""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from impact_observer.stamps import NS_PER_S

_FOREVER = -1
_KINDS = {
    "subscription": "subscriptions",
    "guard_condition": "guards",
    "timer": "timers",
    "client": "clients",
    "service": "services",
}
"""What a node can wait for, in the order in which a wait set is told how many: here and there."""


class DirectExecutor(SingleThreadedExecutor):
    """Calls subscriptions and timers itself, subscriptions first.

    For each callback ``rclpy`` makes two sets of all that a node can wait for, with much ado about
    each: three quarters of the time of a node that publishes at a kilohertz. What is rare is left
    to it, so that nothing is lost: services, clients, guards, events of the middleware, tasks.
    Callbacks of subscriptions and timers must be plain functions, and nodes have no actions.
    """

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until something has come, and call for all of it.

        Args:
            timeout_sec: how long to wait at most, s; None for as long as it takes.

        Raises:
            ExternalShutdownException: ROS was shut down meanwhile.
        """
        if not self._context.ok():
            raise ExternalShutdownException
        timeout = _FOREVER if timeout_sec is None else int(timeout_sec * NS_PER_S)
        waited = _Waited(self.get_nodes(), (self._guard, self._sigint_gc), self._context)
        waited.wait(0 if self._tasks else timeout)
        if not self._context.ok():
            raise ExternalShutdownException
        for subscription in waited.ready("subscription"):
            _hear(subscription)
        for timer in waited.ready("timer"):
            _tick(timer)
        if waited.others_are_ready() or self._tasks:
            super().spin_once(0.0)


class _Waited:
    """All that nodes can wait for."""

    def __init__(
        self, nodes: list[Node], own: tuple[GuardCondition, ...], context: Context
    ) -> None:
        """Gather it, with the executor's ``own`` guards behind those of the nodes."""
        self._every = {
            kind: [each for node in nodes for each in getattr(node, name)]
            for kind, name in _KINDS.items()
        }
        self._events = [each for node in nodes for each in node.waitables]
        guards = self._every["guard_condition"]
        self._guards = [*guards]
        guards += own
        counts = map(len, (*self._every.values(), self._events))
        self._set = rclpy_implementation.WaitSet(*counts, context.handle)
        self._set.clear_entities()
        for kind, entities in self._every.items():
            add = getattr(self._set, f"add_{kind}")
            for each in entities:
                add(each.handle)
        for event in self._events:
            event.add_to_wait_set(self._set)

    def wait(self, timeout: int) -> None:
        """Wait until something has come, at most ``timeout``, ns."""
        self._set.wait(timeout)

    def ready(self, kind: str) -> Iterator[Any]:
        """What has come of a kind."""
        for i, each in enumerate(self._every[kind]):
            if self._set.is_ready(kind, i):
                yield each

    def others_are_ready(self) -> bool:
        """Whether anything has come that is left to ``rclpy``."""
        events = [event.is_ready(self._set) for event in self._events]  # each notes it
        found = any(events)
        for guard in self.ready("guard_condition"):
            if guard in self._guards:
                guard._executor_triggered = found = True  # noqa: SLF001 (waiting has taken it)
        return found or any(self._set.get_ready_entities(kind) for kind in ("client", "service"))


def _hear(subscription: Subscription) -> None:
    """Take a message and call for it; nothing where it was gone, or the subscription is."""
    taken = None
    with suppress(InvalidHandle), subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is None:
        return
    kind = subscription._callback_type  # noqa: SLF001 (what its signature told)
    told = 1 if kind is Subscription.CallbackType.MessageOnly else 2
    subscription.callback(*taken[:told])


def _tick(timer: Timer) -> None:
    """Call for a timer, unless it was cancelled meanwhile or is gone."""
    ready = False
    with suppress(InvalidHandle), timer.handle:
        if ready := timer.handle.is_timer_ready():
            timer.handle.call_timer()
    if ready:
        timer.callback()
