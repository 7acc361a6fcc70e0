# SPDX-License-Identifier: Apache-2.0
"""How a node takes in events, samples and forces: one receiver a topic, which waits for the clock.

A message passes four doors: its size, its type, ``read``, and the clock. What does not pass is
counted and told by the node; what is stamped ahead of the clock waits.
"""

from bisect import insort
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Generic, TypeVar

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impact_observer.errors import UsageError
from impact_observer.io.interfaces import Interface, Quality
from impact_observer.io.messages import AnyMessage, MessageError
from impact_observer.ros.topics import (
    MessageInfo,
    PolledGroup,
    common_offer,
    message_class,
    qos_profile,
    waiting_messages,
)
from impact_observer.stamps import NS_PER_S, from_seconds

if TYPE_CHECKING:
    from impact_observer.ros.base_node import BaseNode

MOST_TOGETHER = 200
"""Messages that one call of a callback takes at most: then timers and services have their turn."""
MOST_AHEAD = 2000
"""Items of a topic that wait for the clock: the depth of the topics."""
_QUIET = SubscriptionEventCallbacks(use_default_callbacks=False)
"""No log line of the middleware about a publisher that does not fit: ``fault`` says so."""
_Item = TypeVar("_Item")


class ClockGate(Generic[_Item]):
    """Items stamped too far ahead of a clock wait until the clock is near: it may be late."""

    def __init__(self, now: Callable[[], int], future: float, most: int) -> None:
        """Let at most ``most`` items wait, those with the least stamps.

        Args:
            now: time of the clock, ns; 0 while there is none.
            future: how far ahead of the clock a stamp may be, s.
            most: items that wait.
        """
        self._now, self._future, self._most = now, from_seconds(future), most
        self._items: list[tuple[int, int, _Item]] = []
        self._number = 0

    def reason(self, stamp: int) -> str:
        """Why an item with a ``stamp`` (ns) has to wait; empty if it has not."""
        if not (now := self._now()):
            return "no /clock has come, by which to judge its stamp; it is taken then"
        if (ahead := stamp - now) <= self._future:
            return ""
        most = f"future allows {self._future / NS_PER_S:g} s, and it waits"
        return f"stamped {ahead / NS_PER_S:.3f} s after the clock; {most}"

    def keep(self, stamp: int, item: _Item) -> _Item | None:
        """Let ``item`` wait for ``stamp`` (ns).

        Returns:
            The item with the largest stamp if there is no room for it; else None.
        """
        self._number += 1
        insort(self._items, (stamp, self._number, item))
        return self._items.pop()[2] if len(self._items) > self._most else None

    def near(self) -> Iterator[_Item]:
        """Yields the items that need not wait any more, by stamp, then in order of arrival."""
        while self._items and not self.reason(self._items[0][0]):
            yield self._items.pop(0)[2]

    def clear(self) -> None:
        """Forget all items."""
        self._items.clear()


class Receiver(Generic[_Item]):
    """Hands over what is read of the messages of one topic, once the clock is near its stamp.

    The publishers are followed, whatever types and qualities of service they change to. Messages
    are taken as bytes. One that is longer than the parameter ``max_message`` is refused before its
    conversion, which may take seconds; so is one that cannot be converted or read.

    Attributes:
        topic: absolute name of the topic.
        offers: by type, the quality that all publishers offer, as of the last ``follow``. One that
            was volatile stays so while there is a publisher: past messages would come again.
        type_name: type of the messages that are received; empty while none are.
    """

    def __init__(
        self,
        node: "BaseNode",
        interface: Interface,
        on_items: Callable[[list[_Item]], object],
        *,
        read: Callable[[AnyMessage, MessageInfo], Iterable[_Item]],
        stamp: Callable[[_Item], int] | None = None,
        on_ahead: Callable[[_Item, str], object] | None = None,
        now: Callable[[], int] | None = None,
        choose: Callable[[str, Quality], Quality] | None = None,
        is_polled: bool = False,
        most_together: int = MOST_TOGETHER,
    ) -> None:
        """Subscribe; a topic without a type of its own once it has a publisher.

        Args:
            node: owner of the subscription, with the parameters ``max_message`` and ``future``.
            interface: topic, quality of service to ask for, and type; the type may be empty.
            on_items: called with what is read of messages that wait together, in the order of
                arrival; at least one item.
            read: the items in a message; may raise an error, which refuses the message.
            stamp: the stamp of an item, ns; None for items that do not wait for the clock.
            on_ahead: called with an item that waits for the clock, and why; None for a log line.
            now: time of the clock, ns; None for that of the node.
            choose: the quality to ask for of publishers of a type with a common offer; raises
                UsageError for a type without use. None for that of the ``interface``.
            is_polled: whether messages wait for ``take_arrived``.
            most_together: messages whose items are handed over together at most.
        """
        self._node, self._interface = node, interface
        self._on_items, self._read, self._stamp = on_items, read, stamp
        self._on_ahead = on_ahead or (lambda _, why: node.lines.error(f"{self.topic}: {why}"))
        self._choose = choose or self._as_declared
        self._group = PolledGroup() if is_polled else None
        self._most_together = most_together
        self._gate: ClockGate[_Item] | None = None
        if stamp is not None:
            self._gate = ClockGate(now or node.stamp_now, node.values["future"], MOST_AHEAD)
        self._quality: Quality | None = None
        self._subscription: Subscription | None = None
        self._problem = ""
        self.topic: str = node.resolve_topic_name(interface.name)
        self.offers: dict[str, Quality] = {}
        self.type_name = ""
        if interface.type:
            self._connect(interface.type, interface.quality)
        node.receivers.append(self)

    @property
    def fault(self) -> str:
        """What is wrong with the publishers, as of the last ``follow``; empty for nothing."""
        if not self.offers:
            return f"no node publishes {self.topic}"
        if self._problem:
            return self._problem
        others = ", ".join(each for each in self.offers if each != self.type_name)
        return f"{self.topic}: {others} is published and not received" if others else ""

    def follow(self) -> None:
        """Look at the publishers; ask for what they offer where they or their offers change."""
        before, self.offers = self.offers, self._common_offers()
        for name, offer in self.offers.items():
            keeps = offer.transient_local and before.get(name, offer).transient_local
            self.offers[name] = replace(offer, transient_local=keeps)
        if self.offers == before or not self.offers:
            return
        self._problem = ""
        for name in {self.type_name} & self.offers.keys() or self.offers:
            try:
                quality = self._choose(name, self.offers[name])
                self._connect(name, quality)
            except UsageError as error:
                self._problem = str(error)
                continue
            self._problem = ""
            if quality.reliable and not self.offers[name].reliable:
                self._problem = f"a publisher of {self.topic} is best effort; expected reliable"
            break
        if self.fault:
            self._node.lines.error(self.fault)

    def _common_offers(self) -> dict[str, Quality]:
        """The quality that all publishers of each type offer now."""
        by_type: dict[str, list[TopicEndpointInfo]] = {}
        for each in self._node.get_publishers_info_by_topic(self.topic):
            by_type.setdefault(each.topic_type, []).append(each)
        return {name: common_offer(self.topic, some) for name, some in by_type.items()}

    def _as_declared(self, type_name: str, offer: Quality) -> Quality:
        """The quality of the interface; without past messages where a publisher keeps none.

        Raises:
            UsageError: it is another type.
        """
        if type_name != self._interface.type:
            raise UsageError(f"{self.topic}: {type_name} is published and not received")
        wanted = self._interface.quality
        return replace(wanted, transient_local=wanted.transient_local and offer.transient_local)

    def _connect(self, type_name: str, quality: Quality) -> None:
        """Receive messages of a type, with a quality of service, from now on.

        Raises:
            UsageError: the type is not installed.
        """
        if (type_name, quality) == (self.type_name, self._quality):
            return
        kind = message_class(type_name)
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self.type_name, self._quality = type_name, quality
        self._subscription = self._node.create_subscription(
            kind,
            self.topic,
            self._take,
            qos_profile(quality),
            callback_group=self._group,
            event_callbacks=_QUIET,
            raw=True,
        )

    def _take(self, data: bytes, info: MessageInfo) -> None:
        """Hand over the items of a message and of those that wait behind it."""
        if items := [*self._items(data, info), *self.arrived(self._most_together - 1)]:
            self._on_items(items)

    def take_arrived(self) -> None:
        """Hand over the items to which the clock has come near, and those that have arrived."""
        if items := [*self.no_longer_ahead(), *self.arrived(self._most_together)]:
            self._on_items(items)

    def arrived(self, most: int) -> list[_Item]:
        """The items in up to ``most`` messages that have arrived, but none ahead of the clock."""
        if self._subscription is None:
            return []
        taken = waiting_messages(self._subscription, most)
        return [item for each in taken for item in self._items(*each)]

    def no_longer_ahead(self) -> list[_Item]:
        """The items to which the clock has come near."""
        return [] if self._gate is None else [*self._gate.near()]

    def clear(self) -> None:
        """Forget the items that wait for the clock, as after a jump of the clock."""
        if self._gate is not None:
            self._gate.clear()

    def _items(self, data: bytes, info: MessageInfo) -> Iterator[_Item]:
        """Yields the items of a message that need not wait for the clock."""
        try:
            if len(data) > (most := self._node.values["max_message"]):
                raise MessageError(f"a message of {len(data)} bytes; max_message allows {most}")
            items = [*self._read(deserialize_message(data, message_class(self.type_name)), info)]
        except Exception as error:  # noqa: BLE001 (anybody may publish anything)
            self._refuse(str(error))
            return
        for item in items:
            if self._gate is None or self._stamp is None:
                yield item
            elif why := self._gate.reason(stamp := self._stamp(item)):
                self._on_ahead(item, why)
                if self._gate.keep(stamp, item) is not None:
                    self._refuse(f"more than {MOST_AHEAD} are ahead of the clock")
            else:
                yield item

    def _refuse(self, why: str) -> None:
        """Let the node count and tell what is refused."""
        self._node.note(f"{self.topic}: refused", f"{self.topic}: {why}")
