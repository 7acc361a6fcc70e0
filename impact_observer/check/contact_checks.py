"""What is wrong with the contacts that events tell of, in one pass and constant memory."""

from collections.abc import Iterator
from dataclasses import dataclass

from impact_observer.check.findings import ERROR, WARNING, Finding, Seen, listed, times
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System

_MOST_NAMES = 1000
"""Contacts that are told apart; a damaged bag may name any number."""
_MOST_LINES = 5
"""Contacts of one fault that have a line of their own."""
_FAST = 5_000_000
"""Hits of one contact that follow faster are hardly hits, ns: the dead time of a switch in the
detector."""
_CHATTER, _CHATTER_SHARE = 5, 0.1
"""So many such hits, and such a share of all, are more than chance."""
_OTHERS = "(other contacts)"


@dataclass(slots=True)
class _Contact:
    """What one contact has done.

    Attributes:
        switches: how many.
        closed: whether it is, as last told.
        at: stamp of its last switch, ns.
        hit: stamp of its last hit, ns.
        intervals: between its hits.
        fast: of them, those shorter than ``_FAST``.
        pending: those of the present row of fast ones: if it ends in rest, they are no chatter.
    """

    switches: int = 0
    closed: bool = False
    at: int = 0
    hit: int | None = None
    intervals: int = 0
    fast: int = 0
    pending: int = 0

    def begin(self) -> None:
        """The sender begins anew."""
        self.fast, self.pending = self.fast + self.pending, 0
        self.closed, self.at, self.hit = False, 0, None

    def strike(self, stamp: int) -> None:
        """A hit at ``stamp``, ns."""
        if self.hit is not None and stamp > self.hit:
            self.intervals += 1
            if stamp - self.hit < _FAST:
                self.pending += 1
            else:
                self.fast, self.pending = self.fast + self.pending, 0
        self.hit = stamp


class ContactCheck:
    """Listens to the switches of one sender, in bag order."""

    def __init__(self, topic: str) -> None:
        """Listen to the events of ``topic``."""
        self._topic = topic
        self._contacts: dict[str, _Contact] = {}
        self._open, self._shut, self._hit = Seen(), Seen(), Seen()

    def begin(self) -> None:
        """The sender begins anew: all contacts are open."""
        for contact in self._contacts.values():
            contact.begin()

    def hear(self, event: ImpactEvent, where: str) -> None:
        """One more event, and where it is, in words."""
        for switch in sorted(event.switches, key=lambda each: each.kind):
            name = switch.contact
            if name not in self._contacts and len(self._contacts) >= _MOST_NAMES:
                name = _OTHERS
            contact = self._contacts.setdefault(name, _Contact())
            contact.switches += 1
            # What comes late is put in order by an observer; here it would look like a fault.
            if event.stamp >= contact.at:
                self._switched(contact, switch, event, where)

    def _switched(self, contact: _Contact, switch: Switch, event: ImpactEvent, where: str) -> None:
        """A switch of a contact, none of whose later ones has come yet."""
        told, again = f"{switch.contact}, {where}", contact.hit == event.stamp
        if switch.kind is Kind.OPEN:
            if not contact.closed:
                self._open.note(told)
            contact.closed = False
        else:
            opens = Switch(switch.contact, Kind.OPEN) in event.switches
            if contact.closed and not again and not opens:
                (self._shut if switch.kind is Kind.CLOSE else self._hit).note(told)
            contact.strike(event.stamp)
            if switch.kind is Kind.CLOSE:
                contact.closed, contact.pending = True, 0
        contact.at = event.stamp

    def findings(self, system: System | None) -> Iterator[Finding]:
        """What is wrong, as far as it can be told with or without a ``system``."""
        yield from self._about_order()
        yield from self._about_chatter()
        if system is not None:
            yield from self._about_names(system)

    def _about_order(self) -> Iterator[Finding]:
        for seen, what, lost in (
            (self._open, "OPEN of a contact that is not closed", "a CLOSE was lost"),
            (self._shut, "CLOSE of a contact that is closed", "an OPEN was lost"),
            (self._hit, "IMPACT of a contact that is closed", "an OPEN was lost"),
        ):
            if seen.count:
                yield Finding(
                    WARNING,
                    self._topic,
                    f"{times(seen.count, what, '')}, first of {seen.first}",
                    "CLOSE and OPEN in turn",
                    lost,
                )

    def _about_chatter(self) -> Iterator[Finding]:
        for name, contact in self._contacts.items():
            fast = contact.fast + contact.pending
            if fast >= _CHATTER and fast > _CHATTER_SHARE * contact.intervals:
                yield Finding(
                    WARNING,
                    f"{self._topic} {name}",
                    f"{fast} of {contact.intervals} hits follow another in less than"
                    f" {_FAST / 1e6:g} ms",
                    remedy="a switch that is not debounced looks like this (run detect on its"
                    " signal, with a dead_time), and so do hits that die out (CLOSE tells rest)",
                )

    def _about_names(self, system: System) -> Iterator[Finding]:
        own = system.contact_names
        strange = [name for name in self._contacts if name not in own]
        if strange and len(strange) == len(self._contacts):
            yield Finding(
                ERROR,
                self._topic,
                f"none of its contacts ({listed(strange)}) is one of the model {system.name}",
                f"{listed(own)}",
                "name the model of this rig with --model",
            )
            return
        for name in strange[:_MOST_LINES]:
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
                f"this contact of the model {system.name} is never heard",
                remedy="if it was hit, its sensor is silent or has another name",
            )
