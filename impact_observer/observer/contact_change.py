# SPDX-License-Identifier: Apache-2.0
"""What the contacts do at one instant: closed before, impacting, closed afterwards."""

from collections.abc import Collection
from typing import NamedTuple

from impact_observer.dynamics import ImpactLaw
from impact_observer.events import Contacts, Kind
from impact_observer.states import Vector


class ContactChange(NamedTuple):
    """What the plant's contacts do at one instant, as it is reported to a law.

    Attributes:
        t: the instant, s since the epoch.
        before: contacts with ``chi = 1`` until now.
        hit: contacts that impact now; none where contacts only open.
        closed: contacts with ``chi = 1`` from now on.
        stamp: of the event, ns; 0 where it is not needed.
        sequence: of the event.
        flown: seconds since the event or the sample before.
    """

    t: float
    before: Contacts
    hit: Contacts
    closed: Contacts
    stamp: int = 0
    sequence: int = 0
    flown: float = 0.0

    @classmethod
    def of(
        cls,
        t: float,
        before: Contacts,
        switches: Collection[tuple[int, Kind]],
        *,
        stamp: int = 0,
        sequence: int = 0,
        flown: float = 0.0,
    ) -> "ContactChange":
        """What ``switches`` of contacts at ``t`` mean while the contacts ``before`` are closed.

        A contact that was closed and hits without ``CLOSE`` is open afterwards: an ``OPEN`` was
        missed.
        """
        hit = {contact for contact, kind in switches if kind is not Kind.OPEN}
        stay = {contact for contact, kind in switches if kind is Kind.CLOSE}
        opened = {contact for contact, kind in switches if kind is Kind.OPEN}
        closed = ({*before} - (hit - stay) | stay) - opened
        changed = tuple(sorted(hit)), tuple(sorted(closed))
        return cls(t, before, *changed, stamp, sequence, flown)

    @property
    def is_nothing(self) -> bool:
        """Whether no contact hits, closes or opens."""
        return not self.hit and self.before == self.closed

    @property
    def opened(self) -> Contacts:
        """Contacts that open."""
        return tuple(i for i in self.before if i not in self.closed)

    @property
    def contacts(self) -> Contacts:
        """All contacts of the event: those that hit, and those that open."""
        return tuple(sorted({*self.hit, *self.opened}))

    @property
    def switches(self) -> list[tuple[int, Kind]]:
        """How each contact switches: those that hit, then those that open."""
        hit = [(i, Kind.CLOSE if i in self.closed else Kind.IMPACT) for i in self.hit]
        return [*hit, *((i, Kind.OPEN) for i in self.opened)]

    @property
    def active(self) -> Contacts:
        """Contacts with ``chi = 1`` at this instant: closed ones take part in every impact."""
        return tuple(sorted({*self.before, *self.hit}))

    def pressed(self, newton: ImpactLaw, gamma: Vector) -> Contacts:
        """The contacts that take an impulse; those that stay closed have no speed afterwards.

        ``gamma`` are the speeds of those hit, shape (len(hit),), m/s; see ``ImpactLaw.pressed``.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        taking = newton.pressed(self.active, self.hit, gamma)
        return tuple(sorted({*taking, *({*self.before} & {*self.closed})}))
