# SPDX-License-Identifier: Apache-2.0
"""Series of a recording: what is drawn over time, thinned so that no peak is lost."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from impact_observer.draw.estimates import chosen_observers, labels_by_law
from impact_observer.draw.plot.between_samples import FreeMotion, with_states_between
from impact_observer.draw.plot.impact_marks import Mark, impact_marks
from impact_observer.draw.plot.quantities import (
    Quantity,
    deviations_of,
    quantities_of,
    selected,
    values_of,
)
from impact_observer.errors import UnfitBagError
from impact_observer.io import interfaces
from impact_observer.io.columns import JointStates, ObserverStates
from impact_observer.io.live_inputs import epoch_in, with_recorded
from impact_observer.io.measured_samples import samples_in
from impact_observer.io.pairing import arrived
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, outcomes_in
from impact_observer.io.topic_names import first_block, states_of
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.observer.event_outcomes import EventOutcomes
from impact_observer.stamps import MAX_STAMP, NS_PER_S, from_seconds, text
from impact_observer.states import Matrix, Stamps, Vector

MOST_ESTIMATES = 6
"""Most estimates in one picture."""
MOST_COORDINATES = 8
"""Most coordinates that are drawn unless quantities are named."""
MOST_SAMPLES = 8192
"""Most samples of a curve that are kept; of longer ones the extremes."""
DENSE = 3
"""Samples of an estimate for one of the truth, from which on these are too few for a line."""
MOST_DOTS = 4000
"""Most samples of a sensor that are drawn."""
TRUTH = "truth"


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """The quantities of the plant or of an estimate over time.

    Attributes:
        label: its name in the picture.
        law: of an estimate, or what stands for it where it is not known; empty for the truth.
        seconds: since the epoch, ascending in each column, shape (N, k).
        values: of k quantities, shape (N, k).
        deviations: standard deviations, shape (N, k); NaN where there are none.
        samples: how many were read; more than N where the series is thinned, fewer where states
            were put in between.
    """

    label: str
    law: str
    seconds: Matrix
    values: Matrix
    deviations: Matrix
    samples: int


@dataclass(frozen=True, slots=True, eq=False)
class Dots:
    """Samples of a sensor.

    Attributes:
        name: of the sensor.
        seconds: since the epoch, ascending, shape (N,).
        values: of the quantity, shape (N,).
    """

    name: str
    seconds: Vector
    values: Vector


@dataclass(frozen=True, slots=True, eq=False)
class PlotContent:
    """What is drawn of a bag.

    Attributes:
        name: of the model; empty without one.
        quantities: k of them.
        series: the truth first, if there is one, then the estimates.
        marks: instants of impacts, s since the epoch, ascending.
        start: of what is drawn, s since the epoch.
        end: of what is drawn, s since the epoch.
        left_out: how many coordinates are not drawn as there are too many.
        dots: samples of sensors that measure one of the quantities, by its name.
    """

    name: str
    quantities: tuple[Quantity, ...]
    series: tuple[Series, ...]
    marks: Mapping[Mark, Vector]
    start: float
    end: float
    left_out: int = 0
    dots: Mapping[str, tuple[Dots, ...]] = field(default_factory=dict)


def read_recording(
    reader: BagReader,
    system: System | None,
    *,
    select: Sequence[str] | None = None,
    observers: Sequence[str] | None = None,
    start: float = 0.0,
    duration: float | None = None,
    measurements: Sequence[Measurement] = (),
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> PlotContent:
    """Read what is drawn of a bag, block by block.

    As in ``compare``, estimates that were published before their events arrived are left out.

    Args:
        reader: the bag.
        system: of the model; None where it is not known, and gaps then neither.
        select: words as of ``quantities.selected``; None for positions and velocities of the
            coordinates that move most.
        observers: prefixes of the estimates' topics; None for all.
        start: of the part that is drawn, s since the epoch.
        duration: of that part, s; None for all.
        measurements: whose samples are drawn as dots, where they are of one quantity.
        progress: called with the number of states read, and of all.

    Raises:
        UsageError: a quantity or an observer that is not there, or too many observers.
        BagError: there are no states, none in this part, or the bag is damaged.
    """
    topics = _topics(reader, observers)
    first = first_block(reader, topics)
    if first is None:
        raise UnfitBagError(
            f"{reader.path}: no states; expected true states on"
            f" {interfaces.PLANT_JOINT_STATES.topic} or estimates, as observe makes them"
        )
    names = first.names if system is None else system.coordinates
    every = quantities_of(names, system)
    shown = selected(every, ("positions", "velocities") if select is None else select)
    events = events_in(reader) if reader.find(interfaces.IMPACTS) is not None else []
    epoch = epoch_in(reader, events) or int(first.stamps[0])
    system = system and with_recorded(reader, system, epoch)
    low = epoch + from_seconds(start)
    high = MAX_STAMP if duration is None else low + from_seconds(duration)
    counts = {topic: reader.topics[topic].count for topic in topics}
    reported = np.unique(np.array([each.stamp for each in events], dtype=np.int64))
    free = None if system is None or system.guides else FreeMotion(system, epoch)
    curves = {
        topic: _Curve(
            shown,
            outcomes_in(reader, topic, events) if prefix else None,
            None if counts[topic] * DENSE <= max(counts.values()) else reported,
            lambda stamps: _gap_motion(system, stamps - epoch),
            free,
        )
        for topic, prefix in topics.items()
    }
    done, total = 0, sum(counts.values())
    for topic, block in reader.blocks(topics, names, covariance=True):
        curves[topic].add(block, (block.stamps >= low) & (block.stamps <= high))
        progress(done := done + block.stamps.size, total)
    laws = {prefix: curves[topic].law for topic, prefix in topics.items() if prefix}
    labels = labels_by_law(laws)
    series = tuple(
        curves[topic].series(labels.get(prefix, TRUTH), epoch)
        for topic, prefix in topics.items()
        if curves[topic].count
    )
    if not series:
        raise UnfitBagError(
            f"{reader.path}: no states from {text(low)} s on in the stretch that is asked for;"
            " choose another with --start and --duration"
        )
    recording = PlotContent(
        name="" if system is None else system.name,
        quantities=shown,
        series=series,
        marks={},
        start=min(float(each.seconds.min()) for each in series),
        end=max(float(each.seconds.max()) for each in series),
    )
    stamps = impact_marks(reader, {prefix: labels[prefix] for prefix in laws}, events)
    dots = _dots(reader, measurements, recording, epoch) if measurements else {}
    recording = replace(recording, marks=_within(recording, stamps, epoch), dots=dots)
    return _largest(recording) if select is None else recording


def _dots(
    reader: BagReader, measurements: Sequence[Measurement], recording: PlotContent, epoch: int
) -> dict[str, tuple[Dots, ...]]:
    """Samples by the quantity that their sensor measures, thinned to ``MOST_DOTS``."""
    found: dict[str, tuple[Dots, ...]] = {}
    samples = samples_in(reader, measurements).samples
    for i, each in enumerate(measurements):
        name, factor = _measured_alone(each)
        own = np.array([(s.stamp - epoch, s.value) for s in samples if s.sensor == i])
        if not (name and own.size):
            continue
        seconds, values = own[:, 0] / NS_PER_S, (own[:, 1] - each.offset) / factor
        inside = (seconds >= recording.start) & (seconds <= recording.end)
        kept = np.flatnonzero(inside)[:: 1 + int(inside.sum()) // MOST_DOTS]
        found[name] = (*found.get(name, ()), Dots(each.name, seconds[kept], values[kept]))
    return found


def _measured_alone(measurement: Measurement) -> tuple[str, float]:
    """The name of the one quantity that a sensor measures, and its factor; empty for others."""
    if measurement.gap:
        return f"g_{measurement.gap}", 1.0
    terms = [("q", *each) for each in measurement.position]
    terms += [("u", *each) for each in measurement.velocity]
    if len(terms) != 1 or measurement.acceleration:
        return "", 1.0
    ((kind, coordinate, factor),) = terms
    return f"{kind}_{coordinate}", factor


def _gap_motion(system: System | None, ns: Stamps) -> Matrix | None:
    """What moving grounds add to gaps, ns since the epoch; None where nothing moves."""
    return None if system is None or system.frame is None else system.gap_motion(ns)


def _topics(reader: BagReader, observers: Sequence[str] | None) -> dict[str, str]:
    """Topics of the states that are drawn, with the observer's prefix; the truth has none."""
    truth = reader.truth_topic()
    topics = {} if truth is None else {truth: ""}
    prefixes = chosen_observers(reader, observers, MOST_ESTIMATES)
    return topics | {states_of(reader, prefix): prefix for prefix in prefixes}


def _within(
    recording: PlotContent, marks: Mapping[Mark, Iterable[int]], epoch: int
) -> dict[Mark, Vector]:
    """The marks in the part that is drawn, s since ``epoch`` (ns)."""
    found = {}
    for mark, stamps in marks.items():
        seconds = (np.array(sorted(stamps), dtype=np.int64) - epoch) / NS_PER_S
        seconds = seconds[(seconds >= recording.start) & (seconds <= recording.end)]
        if seconds.size:
            found[mark] = seconds
    return found


def _largest(recording: PlotContent) -> PlotContent:
    """Positions and velocities of the coordinates that move most, where there are many."""
    n = len(recording.quantities) // 2
    if n <= MOST_COORDINATES:
        return recording
    motion = recording.series[0].values[:, :n].std(axis=0)
    chosen = np.sort(np.argsort(-motion, kind="stable")[:MOST_COORDINATES])
    both = np.concatenate([chosen, n + chosen])
    series = tuple(
        replace(
            each,
            seconds=each.seconds[:, both],
            values=each.values[:, both],
            deviations=each.deviations[:, both],
        )
        for each in recording.series
    )
    quantities = tuple(recording.quantities[i] for i in both)
    return replace(recording, quantities=quantities, series=series, left_out=n - chosen.size)


class _Curve:
    """Collects the quantities of one topic.

    Of too many samples every four next to each other become two in each column: the least and the
    greatest value.
    """

    def __init__(
        self,
        quantities: Sequence[Quantity],
        outcomes: EventOutcomes | None,
        reported: Stamps | None,
        motion: Callable[[Stamps], Matrix | None],
        free: FreeMotion | None = None,
    ) -> None:
        """Collect ``quantities`` of the truth, or with ``outcomes`` of an estimate.

        ``reported`` are the stamps of all events (ns); None to put no states between samples.
        ``motion`` is what moving grounds add to the gaps at stamps; see ``values_of``.
        ``free``: see ``with_states_between``.
        """
        self.count = 0
        self._motion = motion
        self._free = free
        self.law = ""
        self._quantities = quantities
        self._outcomes = outcomes
        self._jumps = outcomes.instants if outcomes and reported is not None else reported
        self._kept: list[tuple[Stamps, Matrix, Matrix]] = []

    def add(self, block: JointStates, rows: NDArray[np.bool_]) -> None:
        """Add the states of some rows of a block."""
        if isinstance(block, ObserverStates):
            self.law = block.law or self.law
            if self._outcomes is not None and block.last_event.any():
                used = self._outcomes.reported
                rows = rows & arrived(block.stamps, block.last_event, used)
        own = block.stamps[rows]
        x = np.hstack([block.q[rows], block.u[rows]])
        stamps = own
        if self._jumps is not None:
            stamps, x = with_states_between(own, x, self._jumps, self._free)
        values = values_of(self._quantities, x, self._motion(stamps))
        deviations = np.full(values.shape, np.nan)
        if isinstance(block, ObserverStates) and block.covariance.size:
            at_samples = deviations_of(self._quantities, block.covariance[rows])
            for k, column in enumerate(at_samples.T):
                deviations[:, k] = np.interp(stamps, own, column) if own.size else column
        self.count += own.size
        self._kept.append((np.broadcast_to(stamps[:, None], values.shape), values, deviations))
        while sum(len(stamps) for stamps, *_ in self._kept) > MOST_SAMPLES:
            self._kept = [_extremes(*self._joined())]

    def _joined(self) -> tuple[Stamps, Matrix, Matrix]:
        """All that is kept, by stamp."""
        stamps, values, deviations = map(np.concatenate, zip(*self._kept, strict=True))
        order = np.argsort(stamps, axis=0, kind="stable")
        return (
            np.take_along_axis(stamps, order, axis=0),
            np.take_along_axis(values, order, axis=0),
            np.take_along_axis(deviations, order, axis=0),
        )

    def series(self, label: str, epoch: int) -> Series:
        """The series; ``epoch`` is the stamp of time zero, ns."""
        stamps, values, deviations = self._joined()
        seconds = (stamps - epoch) / NS_PER_S
        law = self.law or label.removeprefix(TRUTH)
        return Series(label, law, seconds, values, deviations, self.count)


def _extremes(stamps: Stamps, values: Matrix, deviations: Matrix) -> tuple[Stamps, Matrix, Matrix]:
    """Of every four rows, in each column, those with the least and the greatest value."""
    whole, k = len(values) // 4 * 4, values.shape[1]
    groups = values[:whole].reshape(-1, 4, k)
    pair = np.sort(np.stack([groups.argmin(axis=1), groups.argmax(axis=1)], axis=1), axis=1)
    rows = (pair + 4 * np.arange(len(groups))[:, None, None]).reshape(-1, k)
    rows = np.concatenate([rows, np.tile(np.arange(whole, len(values))[:, None], k)])
    return (
        np.take_along_axis(stamps, rows, axis=0),
        np.take_along_axis(values, rows, axis=0),
        np.take_along_axis(deviations, rows, axis=0),
    )
