# SPDX-License-Identifier: Apache-2.0
"""The impacts in a bag by their verdict: reported, applied, rejected, inserted."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from impact_observer.events import ImpactEvent, Kind, Ruling, final_rulings
from impact_observer.io.reader import BagReader


class Mark(NamedTuple):
    """The contact of an impact, and the verdict on the impact.

    Attributes:
        contact: name of the contact.
        estimate: label of the estimate whose observer ruled; empty for a report of the sensor.
        ruling: of the verdict; None for a report of the sensor.
    """

    contact: str
    estimate: str = ""
    ruling: Ruling | None = None


def impact_marks(
    reader: BagReader, labels: Mapping[str, str], events: Sequence[ImpactEvent]
) -> dict[Mark, set[int]]:
    """Stamps of impacts, ns, by the final verdicts; by the sensor's reports without verdicts.

    Args:
        reader: the bag.
        labels: of the estimates, by the prefix of their topics.
        events: of the bag.

    Raises:
        BagError: a verdict is not valid.
    """
    marks = defaultdict[Mark, set[int]](set)
    for prefix, label in labels.items():
        for stamp, contact, ruling in _decided(reader, f"{prefix}/verdicts", events):
            marks[Mark(contact, label, ruling)].add(stamp)
    if not marks:
        for event in events:
            for switch in event.switches:
                if switch.kind is not Kind.OPEN:
                    marks[Mark(switch.contact)].add(event.stamp)
    return dict(marks)


def _decided(
    reader: BagReader, topic: str, events: Sequence[ImpactEvent]
) -> Iterator[tuple[int, str, Ruling]]:
    """Stamp, contact and final ruling of each impact that an observer ruled on."""
    if topic not in reader.topics:
        return
    switches = {(event.stamp, event.sequence): event.switches for event in events}
    reported = {event.stamp for event in events}
    for (stamp, sequence, contact), ruling in final_rulings(reader.verdicts(topic)).items():
        if ruling is Ruling.REJECTED and stamp not in reported:
            continue  # an insertion that was withdrawn
        kinds = {each.contact: each.kind for each in switches.get((stamp, sequence), ())}
        # A verdict without a contact is on the whole event.
        for name in [contact] if contact else kinds:
            if kinds.get(name) is not Kind.OPEN:
                yield stamp, name, ruling
