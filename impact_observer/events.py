# SPDX-License-Identifier: Apache-2.0
"""The input of an observer: the switching function ``chi`` as a stream of events.

The classes mirror ``impact_observer_msgs/ImpactEvent`` and ``EventVerdict`` without ROS.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple, TypeAlias

from numpy.typing import ArrayLike

from impact_observer.errors import UsageError
from impact_observer.stamps import NS_PER_S, nanoseconds, whole_stamp

Contacts: TypeAlias = tuple[int, ...]
"""Indices of contacts in their system, ascending."""


class Kind(IntEnum):
    """How ``chi`` of one contact switches; the numbers are those of ``ContactSwitch``."""

    IMPACT = 0
    """``chi`` is 1 at this instant only."""
    CLOSE = 1
    """An impact, and ``chi`` stays 1 from now on."""
    OPEN = 2
    """``chi`` becomes 0."""


@dataclass(frozen=True, slots=True)
class Switch:
    """One contact that switches.

    Raises:
        UsageError: ``kind`` is no ``Kind``.
    """

    contact: str
    kind: Kind = Kind.IMPACT

    def __post_init__(self) -> None:
        """Check the kind: a caller may give the name of a kind."""
        if type(self.kind) is not Kind:
            names = ", ".join(f"Kind.{each.name}" for each in Kind)
            raise UsageError(f"kind: {self.kind!r} found; expected one of {names}")


@dataclass(frozen=True, slots=True)
class ImpactEvent:
    """Everything that switches at one instant.

    Attributes:
        stamp: the instant itself, ns.
        switches: the contacts that switch.
        sequence: +1 a message; 0 when the sender does not count.
        episode: +1 at every reset of the sender.
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 when unknown to the sender.

    Raises:
        UsageError: a stamp is no integer, or one of ``switches`` is no ``Switch``.
    """

    stamp: int
    switches: tuple[Switch, ...]
    sequence: int = 0
    episode: int = 0
    epoch: int = 0

    def __post_init__(self) -> None:
        """Check the types: a caller may give seconds, or a contact's name."""
        for name in ("stamp", "epoch"):
            if type(value := getattr(self, name)) is not int:
                object.__setattr__(self, name, whole_stamp(value, name))
        for each in self.switches:
            if type(each) is not Switch:
                raise UsageError(
                    f"switches: {self.switches!r} found; expected a tuple of Switch, such as"
                    " (Switch('stop'),)"
                )


class Ruling(IntEnum):
    """Kind of a verdict on an event; the numbers are those of ``EventVerdict``."""

    APPLIED = 0
    REJECTED = 1
    INSERTED = 2
    DUPLICATE = 3
    TOO_LATE = 4
    UNKNOWN_CONTACT = 5


class Remark(Enum):
    """Irregularities of a stream of events that are counted; values are names of the counts."""

    DUPLICATE = "duplicates"
    LATE = "late events"
    TOO_LATE = "too late"
    UNKNOWN_CONTACT = "unknown contacts"
    OLD_RUN = "of an older episode or epoch"
    BEFORE_EPOCH = "stamped before their epoch"
    REVISED = "revised verdicts"
    MISFIT = "events the model does not explain"


class Verdict(NamedTuple):
    """An observer's verdict on one switch of an event.

    Attributes:
        stamp: the event's instant, ns.
        ruling: kind of the verdict.
        sequence: the event's sequence number.
        contact: the contact; empty when the verdict is on the whole event.
        reason: why, in plain words; empty when applied like any other.
        innovation: normalised innovation in standard deviations; -1 where a law has none.
        revises: whether this verdict replaces an earlier one.
    """

    stamp: int
    ruling: Ruling
    sequence: int = 0
    contact: str = ""
    reason: str = ""
    innovation: float = -1.0
    revises: bool = False

    @property
    def hit_contact(self) -> str:
        """Name of the contact that has hit: another one than reported if mislabelled."""
        other = self.reason.partition(MISLABELLED)[2].partition(";")[0]
        return other or self.contact


class SmoothedImpact(NamedTuple):
    """An impact or a release, by all events; mirrors ``impact_observer_msgs/SmoothedImpact``.

    Attributes:
        stamp: the instant, ns.
        reported: the sensor's stamp, ns; 0 for a missed detection.
        sequence: number of the event; 0 without an event, or if the sender does not count.
        contact: name of the contact.
        ruling: applied, or inserted for a missed detection.
        deviation: standard deviation of the instant, s.
    """

    stamp: int
    reported: int
    sequence: int
    contact: str
    ruling: Ruling
    deviation: float


class ImpactEstimate(NamedTuple):
    """The estimate of an impact of one contact; mirrors ``impact_observer_msgs/ImpactEstimate``.

    Speeds are relative to the stop. Of contacts of angles m is rad and N is N m. Standard
    deviations are -1 where a law has none. A rejected event was no impact: all numbers are 0.

    Attributes:
        stamp: the instant, estimated, ns; of a rejected event the reported one.
        contact: name of the contact; empty where a whole event is rejected.
        ruling: applied, inserted for a missed detection, or rejected.
        sequence: number of the event; 0 without an event, or if the sender does not count.
        speed_before: of approach, m/s: positive where the gap closes.
        speed_after: of separation, m/s: positive where the gap opens.
        impulse: N s.
        energy_loss: share of the contact in the kinetic energy that the impact takes, J.
        speed_before_deviation: standard deviation, m/s.
        speed_after_deviation: standard deviation, m/s.
        impulse_deviation: standard deviation, N s.
        energy_loss_deviation: standard deviation, J.
    """

    stamp: int
    contact: str
    ruling: Ruling
    sequence: int = 0
    speed_before: float = 0.0
    speed_after: float = 0.0
    impulse: float = 0.0
    energy_loss: float = 0.0
    speed_before_deviation: float = -1.0
    speed_after_deviation: float = -1.0
    impulse_deviation: float = -1.0
    energy_loss_deviation: float = -1.0


class MeasurementVerdict(NamedTuple):
    """The verdict on a sample of a sensor; mirrors ``impact_observer_msgs/MeasurementVerdict``.

    Attributes:
        stamp: when the sample holds, ns.
        name: name of the sensor.
        value: the value measured.
        innovation: the value minus its prediction by the estimate, in the same unit.
        normalized: magnitude of the innovation in standard deviations; -1 if a law has none.
        accepted: whether the sample was used.
        reason: why the sample was not used, or only in part; empty otherwise.
    """

    stamp: int
    name: str
    value: float
    innovation: float = 0.0
    normalized: float = -1.0
    accepted: bool = False
    reason: str = ""


MISLABELLED = "mislabelled: it hit "
"""Prefix of the reason of a verdict on an impact of another contact, whose name follows."""
REVISED = "revised: "
"""Prefix of the reason of a verdict that replaces an earlier one."""


DECIDING = (Ruling.APPLIED, Ruling.REJECTED, Ruling.INSERTED)
"""Rulings that decide about a switch; the last one counts."""


def events_at(
    times: Mapping[str, ArrayLike] | ArrayLike, names: Sequence[str], epoch: int = 0
) -> tuple[int, list[ImpactEvent]]:
    """Events of impacts at ``times``, s since the epoch, in order, and the epoch, ns.

    Args:
        times: by contact; or those of the only contact, shape (impacts,).
        names: of the contacts.
        epoch: stamp of time zero, ns; 0 for one with which all events have stamps above 0.

    Raises:
        UsageError: another contact, times of none of several, or times that are no seconds.
    """
    expected = f"expected a mapping from {', '.join(names)} to seconds"
    if not isinstance(times, Mapping):
        if len(names) != 1:
            raise UsageError(f"times: of no contact; {expected}")
        times = {names[0]: times}
    for contact in times:
        if contact not in names:
            raise UsageError(f"times: contact {contact!r} found; {expected}")
    found = {name: nanoseconds(own, f"times of {name}") for name, own in times.items()}
    earliest = min((int(own.min(initial=0)) for own in found.values()), default=0)
    epoch = epoch or NS_PER_S * (1 - earliest // NS_PER_S)
    stamps = [(epoch + ns, contact) for contact, own in found.items() for ns in own.tolist()]
    return epoch, [
        ImpactEvent(stamp, (Switch(contact),), k, 1, epoch)
        for k, (stamp, contact) in enumerate(sorted(stamps), start=1)
    ]


def final_rulings(verdicts: Iterable[Verdict]) -> dict[tuple[int, int, str], Ruling]:
    """The last deciding ruling on each switch, by stamp, sequence and contact.

    A message that came twice or too late does not change an earlier ruling.
    """
    last: dict[tuple[int, int, str], Ruling] = {}
    for each in verdicts:
        if each.ruling in DECIDING:
            last[each.stamp, each.sequence, each.contact] = each.ruling
    return last


def rejected_impacts(
    final: Mapping[tuple[int, int, str], Ruling], events: Iterable[ImpactEvent]
) -> list[ImpactEstimate]:
    """The impacts among ``events`` that are rejected by the ``final_rulings``."""
    hits = {
        (each.stamp, each.sequence, contact)
        for each in events
        for contact in ("", *(s.contact for s in each.switches if s.kind is not Kind.OPEN))
    }
    return [
        ImpactEstimate(stamp, contact, ruling, sequence)
        for (stamp, sequence, contact), ruling in final.items()
        if ruling is Ruling.REJECTED and (stamp, sequence, contact) in hits
    ]
