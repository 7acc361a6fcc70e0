# SPDX-License-Identifier: Apache-2.0
"""The impacts of a recording: found in a signal, read from a table of times, or in a bag."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from impact_observer.detector import Source
from impact_observer.detector.bag_detection import BagDetection, detect_bag
from impact_observer.detector.sensors import SignalTrace
from impact_observer.detector.signal_detection import detect_signal
from impact_observer.detector.source import ARRIVAL, PEAK
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.io import interfaces
from impact_observer.io.bag_files import SIGNAL_FILES, SOUND_FILES
from impact_observer.io.import_table import import_table
from impact_observer.io.live_inputs import first_pulse
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import epoch_of
from impact_observer.io.signals import Signal, check_stamps, read_signal, signal_of_table, topic_of
from impact_observer.io.tables import TableForm, read_table
from impact_observer.message_fields import header_stamp, numbers_at
from impact_observer.model import Model
from impact_observer.observer import Options
from impact_observer.recording.crosstalk import crosstalk
from impact_observer.recording.detection_choice import (
    ChosenSource,
    choose_detection,
    expected_impacts,
    simulated_impacts,
    usual_dead_time,
)
from impact_observer.recording.sources_file import table_keys
from impact_observer.recording.switch_choice import choose_switch, is_switch
from impact_observer.stamps import NS_PER_S, seconds_between
from impact_observer.states import Stamps, Vector

_EVEN = 0.05
"""Largest usual deviation of the intervals between samples of a signal, over their median."""
_USUAL = 60.0
"""Time for which the impacts of the model are simulated where there is no signal, s."""


@dataclass(frozen=True, slots=True)
class Task:
    """A recording, and what the user says about it.

    Attributes:
        path: a sound, a table of a signal or of times, or a bag of impacts or of sensors.
        model: the model of the rig.
        sources: sensors, as declared; without any the only column, or topic, is the sensor.
        form: how a table is to be read.
        zero: stamp of time 0 of a file that is no bag, ns; None for the usual one.
        epoch: stamp of ``t = 0``, ns; None where the user gives none.
    """

    path: Path
    model: Model
    sources: Sequence[Source] = ()
    form: TableForm | None = None
    zero: int | None = None
    epoch: int | None = None

    @property
    def contact(self) -> str:
        """The contact of a sensor that nobody declared."""
        return self.model.noticed[0]


@dataclass(frozen=True, slots=True)
class RecordedImpacts:
    """The impacts of a recording in a bag.

    Attributes:
        bag: the bag.
        lines: what was read, and the options with which impacts were found.
        doubts: what may be wrong with the impacts.
        knows_epoch: whether the user or the recording says the epoch.
        epoch: stamp of ``t = 0``, ns; shortly before the first impact where nothing says it.
        zero: stamp of time 0 of the file, ns; 0 of a bag.
        mislabelled: probability that an impact is reported for another contact.
        resolution: time between samples, s; 0 of a table.
        sources: declarations of the sensors that were used, complete.
        traces: the signals of ``sources``.
        refused: of each, stamps of the highest peaks that are no impacts, ns.
    """

    bag: Path
    lines: Sequence[str]
    doubts: Sequence[str]
    knows_epoch: bool
    epoch: int = 0
    zero: int = 0
    mislabelled: float = Options.mislabelled
    resolution: float = 0.0
    sources: Sequence[Source] = ()
    traces: Sequence[SignalTrace] = ()
    refused: Sequence[Stamps] = ()


def read_recording(
    task: Task, bag: Path, show: Callable[[str], None] = lambda _: None
) -> RecordedImpacts:
    """Write a ``bag`` with the impacts of a recording; ``show`` receives what is being done.

    Raises:
        UsageError, BagError: the recording cannot be read, has no impact, or does not go with the
            model.
    """
    show(f"reading {task.path}")
    if task.path.suffix.lower() not in SIGNAL_FILES:
        return _from_bag(task, bag)
    try:
        return _from_file(task, bag)
    except UsageError as error:
        if not (keys := table_keys(str(error))):
            raise
        table = f"table: {{{', '.join(f'{key}: ...' for key in keys)}}}"
        raise UsageError(f"{error}; of fit in a file for --sources: {table}") from None


def _from_file(task: Task, bag: Path) -> RecordedImpacts:
    """Find the impacts in a signal, or take those of a table of times."""
    path = task.path
    if (signal := _signal(task)) is not None:
        return _from_signal(task, signal, bag)
    imported = import_table(
        path, bag, model=task.model, form=task.form, start=task.zero, epoch=task.epoch or 0
    )
    line = f"{path}: {len(imported.events)} impacts, {imported.times}"
    return RecordedImpacts(
        bag,
        [line],
        imported.remarks,
        task.epoch is not None,
        epoch=task.epoch or _before(imported.events),
        zero=imported.start,
    )


def _before(events: Sequence[ImpactEvent]) -> int:
    """Return a stamp before the first impact by a tenth of the time to the next one, ns."""
    first, *later = sorted({each.stamp for each in events})
    return first - max((min(later, default=first) - first) // 10, 1)


def _signal(task: Task) -> Signal | None:
    """Return the signal in a file; None where a table has times of impacts."""
    if task.path.suffix.lower() in SOUND_FILES:
        return read_signal(task.path, task.form, task.zero)
    try:
        table = read_table(task.path, task.form or TableForm(), "time, value")
    except UsageError:
        if task.sources:
            raise
        return None  # a table of nothing but times; of other tables import says what is wrong
    intervals = np.diff(table.times)
    usual = np.median(intervals) if intervals.size else 0.0
    is_even = bool(usual) and np.median(np.abs(intervals - usual)) < _EVEN * usual
    is_signal = is_even and table.columns_of_numbers() and table.find("contact") is None
    if not task.sources and not is_signal:
        return None
    zero, first = task.zero, int(table.times[0])
    if zero is None and first < 0:  # an oscilloscope begins before its trigger
        zero = NS_PER_S * (1 - first // NS_PER_S)
    signal = signal_of_table(table, zero)
    check_stamps(task.path, signal.stamps, signal.zero)
    return signal


def _from_signal(task: Task, signal: Signal, bag: Path) -> RecordedImpacts:
    """Find the impacts in a signal; without an epoch the first sample is it."""
    columns = {topic: name for name, topic in signal.topics.items()}
    moving = {topic: name for topic, name in columns.items() if np.ptp(signal.columns[name]) > 0}
    declared = task.sources or [Source(task.contact, _only(task.path, moving or columns))]
    arrays = dict[str, tuple[Stamps, Vector]]()
    for source in declared:
        if (topic := topic_of(source.topic)) in columns:
            values = signal.columns[columns[topic]]
            known = np.isfinite(values)
            arrays[source.topic] = signal.stamps[known], values[known]
    choice = _chosen(task, declared, arrays)
    epoch = task.epoch or (int(signal.stamps[0]) if task.model.system.depends_on_time else 0)
    found = detect_signal(signal, choice.sources, bag, model=task.model, epoch=epoch, traced=True)
    impacts = _found(task, bag, found, choice, epoch=epoch, knows_epoch=task.epoch is not None)
    interval = float(np.median(np.diff(signal.stamps))) / NS_PER_S
    return replace(impacts, resolution=interval, zero=signal.zero)


def _from_bag(task: Task, bag: Path) -> RecordedImpacts:
    """Take the impacts of a bag, or find them with its sensors."""
    with BagReader(task.path) as reader:
        known = task.epoch or first_pulse(reader)
        topic = reader.find(interfaces.IMPACTS)
        if topic is not None and not task.sources:
            events = [*reader.events(topic)]
            known = known or epoch_of(events)
            line = f"{task.path}: {len(events)} events"
            if not events:
                raise BagError(f"{task.path}: no impact on {topic}; expected some")
            return RecordedImpacts(
                task.path, [line], [], bool(known), epoch=known or _before(events)
            )
        foreign = {each: each for each in reader.topics if interfaces.interface(each) is None}
        declared = _with_kinds(
            reader, task.sources or [Source(task.contact, _only(task.path, foreign))]
        )
        known = known or reader.start
        choice = _chosen(task, declared, _signals_in(reader, declared))
        found = detect_bag(reader, choice.sources, bag, model=task.model, epoch=known, traced=True)
    return _found(task, bag, found, choice, epoch=known, knows_epoch=known != reader.start)


def _with_kinds(reader: BagReader, sources: Sequence[Source]) -> list[Source]:
    """Return the sensors with their kinds, where the types of their topics tell the kinds."""
    types = {topic: each.type for topic, each in reader.topics.items()}
    topics = [interfaces.absolute(each.topic) for each in sources]
    return [
        replace(each, kind=each.kind_on(types[topic]) or None) if topic in types else each
        for each, topic in zip(sources, topics, strict=True)
    ]


def _signals_in(reader: BagReader, sources: Sequence[Source]) -> dict[str, tuple[Stamps, Vector]]:
    """Return stamps, ns, and values of peaks and switches in a bag; of a vector the norm."""
    arrays = dict[str, tuple[Stamps, Vector]]()
    for source in sources:
        topic = interfaces.absolute(source.topic)
        if topic not in reader.topics or source.kind == ARRIVAL:
            continue
        complete = replace(source, threshold=source.threshold or 1.0)
        path = complete.complete(reader.topics[topic].type).path()
        rows = [
            (header_stamp(message) or log_time, numbers_at(message, path))
            for log_time, message in reader.messages(topic)
        ]
        if not rows:
            continue
        values = np.array([row[1] for row in rows])
        values = values[:, 0] if values.shape[1] == 1 else np.linalg.norm(values, axis=1)
        arrays[source.topic] = np.array([row[0] for row in rows], np.int64), values
    return arrays


@dataclass(frozen=True, slots=True)
class _Choice:
    """Declarations of all sensors, with what was chosen, refused and doubted."""

    sources: Sequence[Source]
    refused: Sequence[Stamps]
    doubts: Sequence[str]


def _chosen(
    task: Task, declared: Sequence[Source], arrays: Mapping[str, tuple[Stamps, Vector]]
) -> _Choice:
    """Choose what sensors do not declare, by their signals and the impacts of the model."""
    sources, refused, doubts = list[Source](), list[Stamps](), list[str]()
    ends = [(int(stamps[0]), int(stamps[-1])) for stamps, _ in arrays.values()]
    seconds = max((seconds_between(*each) for each in ends), default=_USUAL)
    simulated = simulated_impacts(task.model, seconds)
    for given in declared:
        own = task.model.noticed if len(declared) < len(task.model.noticed) else (given.contact,)
        expected = expected_impacts(simulated, own)
        chosen = ChosenSource(given, np.zeros(0, np.int64), ())
        signal = arrays.get(given.topic)
        if given.kind == ARRIVAL and given.dead_time is None:
            dead = float(f"{usual_dead_time(expected):.3g}")
            chosen = replace(chosen, source=replace(given, dead_time=dead))
        elif signal and is_switch(given, signal[1]):
            chosen = replace(chosen, source=choose_switch(given, *signal))
        elif signal and given.kind in (None, PEAK):
            chosen = choose_detection(given, *signal, expected)
        sources.append(chosen.source)
        refused.append(chosen.refused)
        doubts += chosen.doubts
    return _Choice(sources, refused, doubts)


def _found(
    task: Task,
    bag: Path,
    found: BagDetection,
    choice: _Choice,
    *,
    epoch: int,
    knows_epoch: bool,
) -> RecordedImpacts:
    """Return the impacts that a detector has found; one sensor of many contacts mislabels."""
    contacts = len(task.model.subject.contact_names)
    if not epoch:
        with BagReader(bag) as reader:
            epoch = _before([*reader.events()])
    lines = [
        f"{task.path}: {count.impacts} impacts of {source.contact}; {_words(source)}"
        for source, count in zip(found.sources, found.counts, strict=True)
    ]
    return RecordedImpacts(
        bag,
        lines,
        [*choice.doubts, *found.doubts, *found.problems, *crosstalk(found.sources, found.traces)],
        knows_epoch,
        epoch=epoch,
        mislabelled=1 - 1 / contacts if len(found.sources) < contacts else Options.mislabelled,
        sources=found.sources,
        traces=found.traces,
        refused=choice.refused,
    )


def _only(path: Path, names: Mapping[str, object]) -> str:
    """Return the only name of a column or a topic."""
    if len(names) != 1:
        given = f"sources: [{{contact: NAME, topic: {next(iter(names), 'TOPIC')}}}]"
        raise UsageError(
            f"{path}: {', '.join(names) or 'nothing'} found; name the sensors in a file for"
            f" --sources, such as {given}"
        )
    return next(iter(names))


def _words(source: Source) -> str:
    """Return the options with which a sensor's impacts were found."""
    if source.kind != PEAK:
        inverted = ", inverted" if source.inverted else ""
        return f"{source.kind}{inverted}, dead time {source.dead_time:g} s"
    keys = ("threshold", "dead_time", "decay", "baseline")
    numbers = [f"--{key.replace('_', '-')} {getattr(source, key):g}" for key in keys]
    return " ".join([*numbers, f"--instant {source.instant}"])
