# SPDX-License-Identifier: Apache-2.0
"""The motion in a bag as `plot` draws it: states of plant and observers, and impacts."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import ModelError, UnfitBagError
from impact_observer.events import ImpactEvent, Kind, Ruling, final_rulings
from impact_observer.io import interfaces
from impact_observer.io.bag_part import TimeZero, time_zero
from impact_observer.io.pairing import arrived
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of, outcomes_in
from impact_observer.io.state_arrays import RecordedStates
from impact_observer.model import System
from impact_observer.model.system import UNKNOWN_UNIT, per_second
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Vector

TRUTH = "truth"
Marks: TypeAlias = dict[str, dict[Ruling | None, list[float]]]
"""Instants of impacts, s since time zero, by contact (of several observers also by the observer)
and final verdict; the verdict is None for reports of the sensor that no observer ruled on."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionCurve:
    """The states of the plant or of an observer.

    Attributes:
        label: in the legend: ``truth``, or the law, with the observer where laws repeat.
        law: of the observer, empty where none is recorded; None for the truth.
        seconds: since time zero, ascending, shape (N,).
        x: states (q, u), shape (N, 2n), SI units.
        deviations: standard deviations of the states, shape (N, 2n); NaN without a covariance.
    """

    label: str
    law: str | None
    seconds: Vector
    x: Matrix
    deviations: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMotion:
    """The motion in a bag.

    Attributes:
        coordinates: names, n of them.
        units: of the states (q, u), 2n of them.
        curves: the truth, if the bag has one, then the estimates.
        marks: impacts within the time of the curves.
        zero: time zero.
    """

    coordinates: tuple[str, ...]
    units: tuple[str, ...]
    curves: tuple[MotionCurve, ...]
    marks: Marks
    zero: TimeZero

    @property
    def ends(self) -> tuple[float, float]:
        """The first and the last instant of all curves, s since time zero."""
        at = [float(each.seconds[k]) for each in self.curves for k in (0, -1)]
        return min(at), max(at)


def read_motion(
    reader: BagReader,
    progress: Callable[[int, int], object] = lambda _done, _all: None,
) -> RecordedMotion:
    """Read the motion in a bag, without a truth too.

    As in ``compare``, estimates that were published before their events arrived are left out.

    Args:
        reader: the bag.
        progress: called with the number of states read, and of all.

    Raises:
        BagError: the bag has no states, or is damaged.
    """
    topics = reader.state_topics()
    first = reader.first_state(topics)
    if first is None:
        raise UnfitBagError(
            f"{reader.path}: no states; expected true states on"
            f" {interfaces.PLANT_JOINT_STATES.topic} or estimates, as observe makes them"
        )
    events = [] if reader.find(interfaces.IMPACTS) is None else events_in(reader)
    zero, states = time_zero(reader), reader.states(topics, first.names, progress)
    laws = {prefix: states[topic].law for topic, prefix in topics.items() if prefix}
    labels, curves = _labels(laws), list[MotionCurve]()
    for topic, each in states.items():
        rows = np.ones(each.stamps.size, dtype=bool)
        if (prefix := topics[topic]) and each.last_event.any():
            reported = outcomes_in(reader, topic, events).reported
            rows = arrived(each.stamps, each.last_event, reported)
        if rows.any():
            curves.append(_curve(labels[prefix], laws.get(prefix), each, rows, zero.stamp))
    motion = RecordedMotion(first.names, _units(reader, first.names), tuple(curves), {}, zero)
    return replace(motion, marks=_marks(reader, labels, events, zero.stamp, motion.ends))


def _curve(
    label: str, law: str | None, states: RecordedStates, rows: NDArray[np.bool_], zero: int
) -> MotionCurve:
    """Some rows of states in order of their stamps; of equal stamps the last one counts."""
    places = np.flatnonzero(rows)[::-1]
    at, last = np.unique(states.stamps[places], return_index=True)
    kept = places[last]
    seconds = (at - zero) / NS_PER_S
    return MotionCurve(label, law, seconds, states.x[kept], states.deviations[kept])


def _labels(laws: Mapping[str, str]) -> dict[str, str]:
    """The label of each prefix: its law, with the prefix where laws repeat; else the prefix."""
    labels, count = {"": TRUTH}, Counter(laws.values())
    for prefix, law in laws.items():
        name = prefix.lstrip("/")
        labels[prefix] = (f"{law} ({name})" if count[law] > 1 else law) if law else name
    return labels


def _marks(
    reader: BagReader,
    labels: Mapping[str, str],
    events: Sequence[ImpactEvent],
    zero: int,
    ends: tuple[float, float],
) -> Marks:
    """The impacts within ``ends``, s since ``zero``, ns; reports where there are no verdicts."""
    ruled = [prefix for prefix in labels if f"{prefix}/verdicts" in reader.topics]
    found = [
        (f"{contact}, {labels[prefix]}" if len(ruled) > 1 else contact, ruling, stamp)
        for prefix in ruled
        for contact, ruling, stamp in _ruled(reader, f"{prefix}/verdicts", events)
    ] or [
        (each.contact, None, event.stamp)
        for event in events
        for each in event.switches
        if each.kind is not Kind.OPEN
    ]
    marks: Marks = {}
    for row, verdict, stamp in sorted(found, key=lambda each: (each[0], each[2])):
        if ends[0] <= (seconds := (stamp - zero) / NS_PER_S) <= ends[1]:
            marks.setdefault(row, {}).setdefault(verdict, []).append(seconds)
    return marks


def _ruled(
    reader: BagReader, topic: str, events: Sequence[ImpactEvent]
) -> Iterator[tuple[str, Ruling | None, int]]:
    """Contact, final ruling and stamp of each impact that an observer ruled on."""
    switches = {(event.stamp, event.sequence): event.switches for event in events}
    for (stamp, sequence, contact), ruling in final_rulings(reader.verdicts(topic)).items():
        kinds = {each.contact: each.kind for each in switches.get((stamp, sequence), ())}
        if ruling is Ruling.REJECTED and not kinds:
            continue  # an insertion that was withdrawn
        # A verdict without a contact is on the whole event.
        for name in [contact] if contact else kinds:
            if kinds.get(name) is not Kind.OPEN:
                yield name, ruling, stamp


def _units(reader: BagReader, names: Sequence[str]) -> tuple[str, ...]:
    """The units of the states, by the model in the bag if that can be read."""
    try:
        subject = model_of(reader).subject
    except (UnfitBagError, ModelError):
        units = {}
    else:
        each = (subject.unit,) * subject.n if isinstance(subject, System) else subject.units
        units = dict(zip(subject.coordinates, each, strict=True))
    positions = tuple(units.get(name, UNKNOWN_UNIT) for name in names)
    return (*positions, *map(per_second, positions))
