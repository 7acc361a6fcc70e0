# SPDX-License-Identifier: Apache-2.0
"""Series of a recording over time, read from a bag and thinned without losing a peak."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

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
from impact_observer.io.bag_part import TimeZero, time_zero
from impact_observer.io.live_inputs import with_recorded
from impact_observer.io.measured_samples import samples_in
from impact_observer.io.pairing import arrived
from impact_observer.io.reader import BagReader, first_block, states_of
from impact_observer.io.recordings import events_in, outcomes_in
from impact_observer.io.state_arrays import JointStates, ObserverStates
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.observer.event_outcomes import EventOutcomes
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Stamps, Vector

MOST_ESTIMATES = 6
"""Most estimates in one picture."""
MOST_COORDINATES = 8
"""Most coordinates in a plot for which no quantities are named."""
MOST_SAMPLES = 8192
"""Most samples of a curve; of longer curves the extremes are kept."""
DENSE = 3
"""Samples of an estimate for one of the truth, from which on a line through the truth is wrong."""
MOST_DOTS = 4000
"""Most samples of a sensor in a plot."""
TRUTH = "truth"


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """The quantities of the plant or of an estimate over time.

    Attributes:
        label: name in the legend.
        law: of an estimate, or its topic's prefix if the law is not known; empty for the truth.
        seconds: since time zero, ascending in each column, shape (N, k).
        values: of k quantities, shape (N, k).
        deviations: standard deviations, shape (N, k); NaN of states without a covariance.
        samples: number of samples in the bag; more than N if the series is thinned, fewer if
            states were put between the samples.
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
        seconds: since time zero, ascending, shape (N,).
        values: of the quantity, shape (N,).
    """

    name: str
    seconds: Vector
    values: Vector


@dataclass(frozen=True, slots=True, eq=False)
class PlotContent:
    """The content of a plot.

    Attributes:
        name: of the model; empty without one.
        quantities: k of them.
        series: the truth, if the bag has one, then the estimates.
        marks: instants of impacts, s since time zero, ascending.
        start: of the plot, s since time zero.
        end: of the plot, s since time zero.
        left_out: number of coordinates that are not drawn, because they move less than others.
        dots: samples of sensors, by the name of the quantity that they measure.
        zero: time zero.
    """

    name: str
    quantities: tuple[Quantity, ...]
    series: tuple[Series, ...]
    marks: Mapping[Mark, Vector]
    start: float
    end: float
    left_out: int = 0
    dots: Mapping[str, tuple[Dots, ...]] = field(default_factory=dict)
    zero: TimeZero = field(default_factory=lambda: TimeZero(0))


def read_recording(
    reader: BagReader,
    system: System | Robot | None,
    *,
    select: Sequence[str] | None = None,
    observers: Sequence[str] | None = None,
    measurements: Sequence[Measurement] = (),
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    warn: Callable[[str], object] = lambda _line: None,
) -> PlotContent:
    """Read the content of a plot from a bag, block by block.

    As in ``compare``, estimates that were published before their events arrived are left out.

    Args:
        reader: the bag.
        system: of the model; None for an unknown model, whose gaps cannot be drawn.
        select: words of ``quantities.selected``; None for positions and velocities of the
            coordinates that move most.
        observers: prefixes of the estimates' topics; None for all.
        measurements: sensors; samples of sensors that measure one quantity are drawn as dots.
        progress: called with the number of states read, and of all.
        warn: called with a line for each reason why samples were left out.

    Raises:
        UsageError: a quantity or an observer that the bag lacks, or too many observers.
        BagError: the bag has no states, or is damaged.
    """
    topics = topics_drawn(reader, observers)
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
    zero = time_zero(reader)
    epoch = zero.stamp
    if isinstance(system, System):
        system = with_recorded(reader, system, epoch, warn)
    counts = {topic: reader.topics[topic].count for topic in topics}
    reported = np.unique(np.array([each.stamp for each in events], dtype=np.int64))
    free = None
    if isinstance(system, System) and not system.guides:
        free = FreeMotion(system, epoch)
    has_gaps = any(each.contact is not None for each in shown)
    gaps = _Gaps(system if has_gaps else None, epoch)
    curves = {
        topic: _Curve(
            shown,
            outcomes_in(reader, topic, events) if prefix else None,
            None if counts[topic] * DENSE <= max(counts.values()) else reported,
            gaps,
            free,
        )
        for topic, prefix in topics.items()
    }
    done, total = 0, sum(counts.values())
    for topic, block in reader.blocks(topics, names, covariance=True):
        curves[topic].take_states(block)
        progress(done := done + block.stamps.size, total)
    laws = {prefix: curves[topic].law for topic, prefix in topics.items() if prefix}
    labels = labels_by_law(laws)
    series = tuple(
        curves[topic].series(labels.get(prefix, TRUTH), epoch)
        for topic, prefix in topics.items()
        if curves[topic].count
    )
    recording = PlotContent(
        name="" if system is None else system.name,
        quantities=shown,
        series=series,
        marks={},
        start=min(float(each.seconds.min()) for each in series),
        end=max(float(each.seconds.max()) for each in series),
        zero=zero,
    )
    stamps = impact_marks(reader, {prefix: labels[prefix] for prefix in laws}, events)
    dots = _dots(reader, measurements, recording, epoch, warn) if measurements else {}
    recording = replace(recording, marks=_within(recording, stamps, epoch), dots=dots)
    return _largest(recording) if select is None else recording


def _dots(
    reader: BagReader,
    measurements: Sequence[Measurement],
    recording: PlotContent,
    epoch: int,
    warn: Callable[[str], object],
) -> dict[str, tuple[Dots, ...]]:
    """Samples of sensors by the quantity that they measure, thinned to ``MOST_DOTS``."""
    dots: dict[str, tuple[Dots, ...]] = {}
    samples, _, problems = samples_in(reader, measurements)
    for line in problems:
        warn(line)
    for i, each in enumerate(measurements):
        name, factor = _measured_alone(each)
        own = np.array([(s.stamp - epoch, s.value) for s in samples if s.sensor == i])
        if not (name and own.size):
            continue
        seconds, values = own[:, 0] / NS_PER_S, (own[:, 1] - each.offset) / factor
        inside = (seconds >= recording.start) & (seconds <= recording.end)
        kept = np.flatnonzero(inside)[:: 1 + int(inside.sum()) // MOST_DOTS]
        dots[name] = (*dots.get(name, ()), Dots(each.name, seconds[kept], values[kept]))
    return dots


def _measured_alone(measurement: Measurement) -> tuple[str, float]:
    """Name and factor of the quantity of a sensor; an empty name if several are measured."""
    if measurement.gap:
        return f"g_{measurement.gap}", 1.0
    terms = [("q", *each) for each in measurement.position]
    terms += [("u", *each) for each in measurement.velocity]
    if len(terms) != 1 or measurement.acceleration:
        return "", 1.0
    ((kind, coordinate, factor),) = terms
    return f"{kind}_{coordinate}", factor


class _Gaps(NamedTuple):
    """The part of gaps that is not linear in the state.

    Attributes:
        system: of the model; None if no gap is drawn.
        epoch: stamp of ``t = 0``, ns.
    """

    system: System | Robot | None
    epoch: int

    def motion(self, stamps: Stamps, x: Matrix) -> Matrix | None:
        """``motion`` of ``values_of`` at ``stamps`` (ns) in the states ``x``, shape (N, 2n)."""
        if self.system is None:
            return None
        ns = stamps - self.epoch
        if isinstance(self.system, Robot):
            return self.system.gaps_at(ns, x)
        return None if self.system.frame is None else self.system.gap_motion(ns)

    def gradients(self, x: Matrix) -> NDArray[np.float64] | None:
        """``gradients`` of ``deviations_of`` in the states ``x``, shape (N, 2n)."""
        if not isinstance(self.system, Robot):
            return None
        n, m = self.system.n, self.system.m
        W = [self.system.directions(each[:n]) for each in x]
        return np.array(W).reshape(len(x), n, m)


def topics_drawn(reader: BagReader, observers: Sequence[str] | None) -> dict[str, str]:
    """The observers' prefixes by the topics of their states; the prefix of the truth is empty."""
    truth = reader.truth_topic()
    topics = {} if truth is None else {truth: ""}
    prefixes = chosen_observers(reader, observers, MOST_ESTIMATES)
    return topics | {states_of(reader, prefix): prefix for prefix in prefixes}


def _within(
    recording: PlotContent, marks: Mapping[Mark, Iterable[int]], epoch: int
) -> dict[Mark, Vector]:
    """The marks in the part that the plot shows, s since ``epoch`` (ns)."""
    within = {}
    for mark, stamps in marks.items():
        seconds = (np.array(sorted(stamps), dtype=np.int64) - epoch) / NS_PER_S
        seconds = seconds[(seconds >= recording.start) & (seconds <= recording.end)]
        if seconds.size:
            within[mark] = seconds
    return within


def _largest(recording: PlotContent) -> PlotContent:
    """The plot of the coordinates that move most; the same plot if there are few coordinates."""
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

    If the samples are too many, the least and the greatest value of every four neighbours are kept
    in each column.
    """

    def __init__(
        self,
        quantities: Sequence[Quantity],
        outcomes: EventOutcomes | None,
        reported: Stamps | None,
        gaps: _Gaps,
        free: FreeMotion | None = None,
    ) -> None:
        """Begin with no samples.

        Args:
            quantities: of the plot.
            outcomes: of the events, for an estimate; None for the truth.
            reported: stamps of all events, ns; None to put no states between samples.
            gaps: what of the gaps is not linear.
            free: as of ``with_states_between``.
        """
        self.count = 0
        self._gaps = gaps
        self._free = free
        self.law = ""
        self._quantities = quantities
        self._outcomes = outcomes
        self._jumps = outcomes.instants if outcomes and reported is not None else reported
        self._kept: list[tuple[Stamps, Matrix, Matrix]] = []

    def take_states(self, block: JointStates) -> None:
        """Take the states of a block."""
        rows = np.ones(block.stamps.size, dtype=bool)
        if isinstance(block, ObserverStates):
            self.law = block.law or self.law
            if self._outcomes is not None and block.last_event.any():
                used = self._outcomes.reported
                rows = arrived(block.stamps, block.last_event, used)
        own = block.stamps[rows]
        x = np.hstack([block.q[rows], block.u[rows]])
        stamps, at_own = own, x
        if self._jumps is not None:
            stamps, x = with_states_between(own, x, self._jumps, self._free)
        values = values_of(self._quantities, x, self._gaps.motion(stamps, x))
        deviations = np.full(values.shape, np.nan)
        if isinstance(block, ObserverStates) and block.covariance.size:
            gradients = self._gaps.gradients(at_own)
            at_samples = deviations_of(self._quantities, block.covariance[rows], gradients)
            for k, column in enumerate(at_samples.T):
                deviations[:, k] = np.interp(stamps, own, column) if own.size else column
        self.count += own.size
        self._kept.append((np.broadcast_to(stamps[:, None], values.shape), values, deviations))
        while sum(len(stamps) for stamps, *_ in self._kept) > MOST_SAMPLES:
            self._kept = [_extremes(*self._joined())]

    def _joined(self) -> tuple[Stamps, Matrix, Matrix]:
        """Stamps, values and deviations that are kept, in order of the stamps."""
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
    """The rows with the least and the greatest value of every four rows, in each column."""
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
