# SPDX-License-Identifier: Apache-2.0
"""The topics of an observer and of the plant and monitor beside it, by the names of nodes."""

from collections import deque
from dataclasses import dataclass
from itertools import islice

from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface
from impact_observer.io.reader import BagReader
from impact_observer.observer.laws import OWN_LAWS, OpenLoop
from impact_observer.options import Options
from impact_observer.stamps import NS_PER_S

_TAIL = 2 * NS_PER_S
"""Length of the end of a bag in which an observer's last state is searched, ns."""

_LEARNED = ("clock_error", "model error", "bounce error")
"""Names of the parameters that a filter with its defaults estimates besides the state."""


@dataclass(frozen=True, slots=True)
class ObserverTopics:
    """The topics of an observer, and of the plant and the monitor in its namespace.

    Attributes:
        prefix: the node's absolute name, such as ``/rig/observer_geometric``.
        bounded: whether the observer certifies a bound of V.
        filters: whether the observer has a covariance.
        learned: names of the parameters that the observer estimates with the state.
    """

    prefix: str
    bounded: bool = True
    filters: bool = False
    learned: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The node's name with its namespace, without the first slash."""
        return self.prefix.lstrip("/")

    def topic(self, interface: Interface) -> str:
        """The absolute name of an interface of the observer, its monitor or its plant.

        The monitor of ``observer_<law>`` is ``monitor_<law>``.
        """
        if interface.name.startswith("observer/"):
            return interface.name_under(self.prefix)
        namespace, _, node = self.prefix.rpartition("/")
        if interface.name.startswith("monitor/"):
            suffix = node.removeprefix("observer") if node.startswith("observer") else f"_{node}"
            return interface.name_under(f"{namespace}/monitor{suffix}")
        return (
            interface.name if interface.name.startswith("/") else f"{namespace}/{interface.name}"
        )

    @classmethod
    def of_node(cls, name: str) -> "ObserverTopics":
        """The topics of a node called ``name``; the name ``observer_<law>`` gives the law.

        Raises:
            UsageError: no node can be called ``name``.
        """
        prefix = name if name.startswith("/") else f"/{name}"
        if not all(part.isidentifier() and part.isascii() for part in prefix[1:].split("/")):
            raise UsageError(f"observer {name!r}: no name of a node; expected such as observer")
        node = prefix.rpartition("/")[2]
        name = node.removeprefix("observer").lstrip("_").replace("_", "-") or Options.law
        law = OWN_LAWS.get(name, OpenLoop)  # a law of another package counts as open loop
        filters = law.has_covariance
        return cls(prefix, law.has_bound, filters, _LEARNED if filters else ())


def observers_in(reader: BagReader) -> tuple[ObserverTopics, ...]:
    """The observers of a bag, with the topics that each observer publishes.

    Raises:
        BagError: the bag is damaged.
    """
    return tuple(_observer_in(reader, prefix) for prefix in reader.observers())


def _observer_in(reader: BagReader, prefix: str) -> ObserverTopics:
    """One observer, described by its last state."""
    bound = interfaces.OBSERVER_BOUND.name_under(prefix)
    bounded = bound in reader.topics and reader.topics[bound].count > 0
    state = interfaces.OBSERVER_STATES.name_under(prefix)
    if state not in reader.topics:
        return ObserverTopics(prefix, bounded)
    tail = deque(reader.raw([state], max(reader.end - _TAIL, 0)), maxlen=1)
    messages = tail or list(islice(reader.raw([state]), 1))
    if not messages:
        return ObserverTopics(prefix, bounded)
    message = reader.decoder(state)(messages[0].data)
    filters = len(message.covariance) > 0
    return ObserverTopics(prefix, bounded, filters, tuple(message.parameter_name))
