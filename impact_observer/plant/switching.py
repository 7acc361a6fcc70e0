# SPDX-License-Identifier: Apache-2.0
"""Changes of the contacts of a plant at one instant."""

from collections.abc import Sequence
from dataclasses import dataclass

from impact_observer.events import Contacts, Kind, Switch
from impact_observer.stamps import Instant
from impact_observer.states import Vector


@dataclass(frozen=True, slots=True, eq=False)
class Switching:
    """All changes of contacts at one instant.

    Attributes:
        instant: the instant of the changes.
        contacts: indices of the contacts that take part in an impact: all that are closed at the
            instant; empty if contacts only open.
        closed: indices of the contacts that are closed after the instant.
        held: indices of the contacts that take the loads, independent of each other.
        before: state (q, u-) in the system's frame, shape (2n,).
        after: state (q, u+) in the system's frame, shape (2n,).
        switches: the changes of ``chi``; empty if only loads move.
    """

    instant: Instant
    contacts: Contacts
    closed: Contacts
    held: Contacts
    before: Vector
    after: Vector
    switches: tuple[Switch, ...]


def switches(
    names: Sequence[str], was_closed: Contacts, contacts: Contacts, closed: Contacts
) -> tuple[Switch, ...]:
    """The changes of ``chi``, in the order of the contacts; ``names`` are those of all.

    Contacts ``was_closed`` before, ``contacts`` impact, and ``closed`` are closed afterwards.
    """
    changes = []
    for i in sorted({*was_closed, *contacts}):
        kind = {
            (False, False): Kind.IMPACT,
            (False, True): Kind.CLOSE,
            (True, False): Kind.OPEN,
            (True, True): None,
        }[i in was_closed, i in closed]
        if kind is not None:
            changes.append(Switch(names[i], kind))
    return tuple(changes)
