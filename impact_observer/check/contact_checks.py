"""Checks of the contacts that events name, in one pass and constant memory."""

from collections.abc import Iterator
from dataclasses import dataclass

from impact_observer.check.findings import ERROR, WARNING, Finding, Occurrences, listed, times
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System

_MOST_NAMES = 1000
"""Most contacts that are counted by name; a damaged bag may name any number."""
_MOST_LINES = 5
"""Most contacts with the same fault that have a line of their own."""
_FAST = 5_000_000
"""Interval of two hits of one contact below which it may be bouncing, ns: the dead time of a
switch in the detector."""
_CHATTER, _CHATTER_SHARE = 5, 0.1
"""Chatter is at least so many short intervals, and more than such a share of all."""
_OTHERS = "(other contacts)"


@dataclass(slots=True)
class _Contact:
    """The switches of one contact.

    Attributes:
        switches: how many.
        closed: whether the last one closed it.
        at: stamp of the last one, ns.
        hit: stamp of the last hit, ns.
        intervals: between its hits.
        fast: of them, those shorter than ``_FAST``.
        pending: fast ones since the last slow one: if they end in a CLOSE, they are no chatter.
    """

    switches: int = 0
    closed: bool = False
    at: int = 0
    hit: int | None = None
    intervals: int = 0
    fast: int = 0
    pending: int = 0

    def reset(self) -> None:
        """The sender starts again: the contact is open."""
        self.fast, self.pending = self.fast + self.pending, 0
        self.closed, self.at, self.hit = False, 0, None

    def add_hit(self, stamp: int) -> None:
        """A hit at ``stamp``, ns."""
        if self.hit is not None and stamp > self.hit:
            self.intervals += 1
            if stamp - self.hit < _FAST:
                self.pending += 1
            else:
                self.fast, self.pending = self.fast + self.pending, 0
        self.hit = stamp


class ContactCheck:
    """Checks the switches of one sender, which are added in bag order."""

    def __init__(self, topic: str) -> None:
        """Check the events of ``topic``."""
        self._topic = topic
        self._contacts: dict[str, _Contact] = {}
        self._not_closed, self._closed_again, self._hit_closed = (Occurrences() for _ in range(3))

    def reset(self) -> None:
        """The sender starts again: all contacts are open."""
        for contact in self._contacts.values():
            contact.reset()

    def add(self, event: ImpactEvent, where: str) -> None:
        """Add an event, at the place ``where`` of the bag."""
        for switch in sorted(event.switches, key=lambda each: each.kind):
            name = switch.contact
            if name not in self._contacts and len(self._contacts) >= _MOST_NAMES:
                name = _OTHERS
            contact = self._contacts.setdefault(name, _Contact())
            contact.switches += 1
            # An observer sorts late events by stamp; here they would look like a fault.
            if event.stamp >= contact.at:
                self._check_order(contact, switch, event, f"{switch.contact}, {where}")

    def _check_order(
        self, contact: _Contact, switch: Switch, event: ImpactEvent, where: str
    ) -> None:
        """Check that CLOSE and OPEN of a contact alternate."""
        if switch.kind is Kind.OPEN:
            if not contact.closed:
                self._not_closed.add(where)
            contact.closed = False
        else:
            opens = Switch(switch.contact, Kind.OPEN) in event.switches
            if contact.closed and contact.hit != event.stamp and not opens:
                closes = switch.kind is Kind.CLOSE
                (self._closed_again if closes else self._hit_closed).add(where)
            contact.add_hit(event.stamp)
            if switch.kind is Kind.CLOSE:
                contact.closed, contact.pending = True, 0
        contact.at = event.stamp

    def findings(self, system: System | None) -> Iterator[Finding]:
        """The findings; names are checked where a ``system`` is given."""
        for fault, what, lost in (
            (self._not_closed, "OPEN of a contact that is not closed", "a CLOSE was lost"),
            (self._closed_again, "CLOSE of a contact that is closed", "an OPEN was lost"),
            (self._hit_closed, "IMPACT of a contact that is closed", "an OPEN was lost"),
        ):
            if fault.count:
                found = f"{fault.count} {what}, first of {fault.first}"
                yield Finding(WARNING, self._topic, found, "CLOSE and OPEN in turn", lost)
        yield from self._chatter_findings()
        if system is not None:
            yield from self._name_findings(system)

    def _chatter_findings(self) -> Iterator[Finding]:
        for name, contact in self._contacts.items():
            fast = contact.fast + contact.pending
            if fast >= _CHATTER and fast > _CHATTER_SHARE * contact.intervals:
                yield Finding(
                    WARNING,
                    f"{self._topic} {name}",
                    f"{fast} of {contact.intervals} hits follow another in less than"
                    f" {_FAST / 1e6:g} ms",
                    remedy="a switch that is not debounced looks like this (run detect on its"
                    " signal, with a dead_time), and so do hits that die out (CLOSE reports rest)",
                )

    def _name_findings(self, system: System) -> Iterator[Finding]:
        own = system.contact_names
        unknown = [name for name in self._contacts if name not in own]
        if unknown and len(unknown) == len(self._contacts):
            yield Finding(
                ERROR,
                self._topic,
                f"none of its contacts ({listed(unknown)}) is one of the model {system.name}",
                listed(own),
                "name the model of this rig with --model",
            )
            return
        for name in unknown[:_MOST_LINES]:
            yield Finding(
                WARNING,
                f"{self._topic} {name}",
                f"{times(self._contacts[name].switches, 'switch', 'es')} of a contact that the"
                f" model {system.name} does not have",
                f"one of {listed(own)}",
                "they are not applied; rename it in the model or at the sender",
            )
        for name in [each for each in own if each not in self._contacts][:_MOST_LINES]:
            yield Finding(
                WARNING,
                f"{self._topic} {name}",
                f"this contact of the model {system.name} is never reported",
                remedy="if it was hit, its sensor is silent or has another name",
            )
