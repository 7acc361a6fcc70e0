# SPDX-License-Identifier: Apache-2.0
"""What a hypothesis decides on a contact of an event."""

from typing import NamedTuple

from impact_observer.events import Kind, Ruling


class Note(NamedTuple):
    """What a hypothesis decides on one contact of an event, or on an impact it inserts.

    Attributes:
        event: stamp (ns) and sequence of the event at which it was decided.
        stamp: of the impact, ns: that of the event, or an earlier one for an inserted impact.
        contact: index.
        ruling: applied, rejected or inserted.
        reason: in plain words; empty for an event that is accepted as it was reported.
        innovation: in standard deviations; -1 where there is none.
        switched: index of the contact that has switched: another one where it was mislabelled.
        kind: how it has switched, of an inserted one; of others CLOSE where a contact has settled
            though it was reported to bounce on.
        is_dead: whether it was in the sensor's dead time, which could not report it, or the CLOSE
            that began a row of bounces that the sensor does not report.
    """

    event: tuple[int, int]
    stamp: int
    contact: int
    ruling: Ruling
    reason: str = ""
    innovation: float = -1.0
    switched: int = -1
    kind: Kind = Kind.IMPACT
    is_dead: bool = False

    @property
    def is_inserted(self) -> bool:
        """Whether it is on a missed impact that the hypothesis inserts."""
        return self.ruling is Ruling.INSERTED

    @property
    def decision(self) -> tuple[object, ...]:
        """The decision without its numbers, which follow the colon of the reason."""
        return self.event, self.contact, self.ruling, self.reason.partition(":")[0]
