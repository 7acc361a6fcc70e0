# SPDX-License-Identifier: Apache-2.0
"""Checks of the contacts that events name, in one pass."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from impact_observer.check.findings import ERROR, WARNING, Finding, Occurrences
from impact_observer.check.hit_times import FAST, HitTimes, in_hertz, too_slow
from impact_observer.draw.reports import counted, listed
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.model.robot_description import RobotDescription
from impact_observer.stamps import NS_PER_S

_CHATTER, _CHATTER_SHARE = 5, 0.1
"""Least number of short intervals, and least share of all intervals, that count as chatter."""

_SWITCH = (
    "a switch that is not debounced looks like this (run detect on its signal, with a dead_time),"
    " and so do hits that die out (CLOSE reports rest)"
)
_SIMULATED = (
    "bounces of a simulation die out like this: let CLOSE report the rest (no --impacts-only, no"
    f" --missed), or keep the first of each row (--dead-time {FAST / NS_PER_S:g} of simulate)"
)
_ALTERNATE = "CLOSE and OPEN in turn"
CONTACT_FAULTS = {
    "not closed": (
        WARNING,
        "{count} OPEN of a contact that is not closed, first of {first}",
        _ALTERNATE,
        "a CLOSE was lost",
    ),
    "closed again": (
        WARNING,
        "{count} CLOSE of a contact that is closed, first of {first}",
        _ALTERNATE,
        "an OPEN was lost",
    ),
    "hit while closed": (
        WARNING,
        "{count} IMPACT of a contact that is closed, first of {first}",
        _ALTERNATE,
        "an OPEN was lost",
    ),
}
"""Faults in the order of switches: severity, fault, expectation, remedy."""


@dataclass(slots=True)
class _ContactHistory:
    """The switches of one contact.

    Attributes:
        switches: number of switches.
        closed: whether the last switch closed the contact.
        last_stamp: stamp of the last switch, ns.
        last_hit: stamp of the last hit, ns.
        hits: number of impacts and closings.
        intervals: number of intervals between hits.
        fast: number of intervals shorter than ``FAST``.
        pending: fast intervals since the last slow interval; before a CLOSE they are no chatter.
    """

    switches: int = 0
    closed: bool = False
    last_stamp: int = 0
    last_hit: int | None = None
    hits: int = 0
    intervals: int = 0
    fast: int = 0
    pending: int = 0

    def reset(self) -> None:
        """The sender starts again: the contact is open."""
        self.fast, self.pending = self.fast + self.pending, 0
        self.closed, self.last_stamp, self.last_hit = False, 0, None

    def add_hit(self, stamp: int) -> None:
        """A hit at ``stamp``, ns."""
        self.hits += 1
        if self.last_hit is not None and stamp > self.last_hit:
            self.intervals += 1
            if stamp - self.last_hit < FAST:
                self.pending += 1
            else:
                self.fast, self.pending = self.fast + self.pending, 0
        self.last_hit = stamp


class ContactCheck:
    """Checks the switches of one sender, in bag order."""

    def __init__(self, topic: str, faults: Mapping[str, Occurrences]) -> None:
        """Check the events of ``topic``; ``CONTACT_FAULTS`` are counted in ``faults``."""
        self._topic, self._faults = topic, faults
        self._contacts: defaultdict[str, _ContactHistory] = defaultdict(_ContactHistory)
        self._times = HitTimes()

    def reset(self) -> None:
        """The sender starts again: all contacts are open."""
        for contact in self._contacts.values():
            contact.reset()

    def check_event(self, event: ImpactEvent, where: str) -> None:
        """Check an event, at the place ``where`` of the bag."""
        self._times.add_event(event)
        for switch in sorted(event.switches, key=lambda each: each.kind):
            contact = self._contacts[switch.contact]
            contact.switches += 1
            # An observer sorts late events by stamp; here they would look like a fault.
            if event.stamp >= contact.last_stamp:
                self._check_order(contact, switch, event, f"{switch.contact}, {where}")

    def _check_order(
        self, contact: _ContactHistory, switch: Switch, event: ImpactEvent, where: str
    ) -> None:
        """Check that CLOSE and OPEN of a contact alternate."""
        if switch.kind is Kind.OPEN:
            if not contact.closed:
                self._faults["not closed"].count_at(where)
            contact.closed = False
        else:
            closes = switch.kind is Kind.CLOSE
            opens = Switch(switch.contact, Kind.OPEN) in event.switches
            if contact.closed and contact.last_hit != event.stamp and not opens:
                self._faults["closed again" if closes else "hit while closed"].count_at(where)
            contact.add_hit(event.stamp)
            if closes:
                contact.closed, contact.pending = True, 0
        contact.last_stamp = event.stamp

    def findings(
        self, system: System | RobotDescription | None, *, simulated: bool = False
    ) -> Iterator[Finding]:
        """Chatter, and unknown and silent contacts if a ``system`` is given.

        A switch of a ``simulated`` bag need not be debounced.
        """
        remedy = _SIMULATED if simulated else _SWITCH
        for name, contact in self._contacts.items():
            fast = contact.fast + contact.pending
            if fast >= _CHATTER and fast > _CHATTER_SHARE * contact.intervals:
                fault = f"{fast} of {contact.hits} impacts follow another in less than"
                fault += f" {FAST / 1e6:g} ms"
                yield Finding(WARNING, f"{self._topic} {name}", fault, remedy=remedy)
        if system is not None:
            if line := too_slow(self._times, system):
                yield Finding(WARNING, self._topic, line)
            for line in in_hertz(self._times, system) if isinstance(system, System) else ():
                yield Finding(WARNING, self._topic, line)
            yield from self._name_findings(system)

    def _name_findings(self, system: System | RobotDescription) -> Iterator[Finding]:
        own = system.contact_names
        unknown = [name for name in self._contacts if name not in own]
        if unknown and len(unknown) == len(self._contacts):
            names = listed(unknown, joint=", ")
            fault = f"none of its contacts ({names}) is one of the model {system.name}"
            remedy = "name the model of this rig with --model"
            yield Finding(ERROR, self._topic, fault, listed(own, joint=", "), remedy)
            return
        for name in unknown:
            events = counted(self._contacts[name].switches, "event")
            yield Finding(
                WARNING,
                f"{self._topic} {name}",
                f"{events} of a contact that the model {system.name} does not have",
                f"one of {listed(own, joint=', ')}",
                "they are not applied; rename it in the model or at the sender",
            )
        for name in [each for each in own if each not in self._contacts]:
            fault = f"this contact of the model {system.name} is never reported"
            remedy = "if it was hit, its sensor is silent or has another name"
            yield Finding(WARNING, f"{self._topic} {name}", fault, remedy=remedy)
