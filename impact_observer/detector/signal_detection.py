# SPDX-License-Identifier: Apache-2.0
"""Runs the detector on a signal in a file, and writes a bag with events."""

from collections import deque
from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from impact_observer.detector import Detector, Source
from impact_observer.detector.bag_detection import (
    BagDetection,
    check_contacts,
    detecting,
    present,
    write_events,
    write_model,
)
from impact_observer.detector.sensors import MAX_DELAY, Sample, SampleTime
from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.bag_part import BagPart
from impact_observer.io.messages import bag_messages
from impact_observer.io.signals import Signal
from impact_observer.io.writer import BagWriter
from impact_observer.model import Model
from impact_observer.stamps import seconds_between

_TYPE = "a column of numbers"
_LEVELS = 0.25, 0.5, 0.75
"""Of a column's range: below a pulse, at its edge, and in it."""


def detect_signal(
    signal: Signal,
    sources: Sequence[Source],
    output: Path,
    *,
    model: Model | None = None,
    epoch: int = 0,
    pulses: Sequence[int] = (),
    part: BagPart | None = None,
    traced: bool = False,
    progress: Callable[[int], None] = lambda _: None,
) -> BagDetection:
    """Write a bag with the impacts in a signal, which is not copied.

    Args:
        signal: the signal.
        sources: the sensors, as declared; the topic of each is that of a column.
        output: the bag to make.
        model: the model of the new bag, or None.
        epoch: stamp of the forcing's ``t = 0``, ns; 0 for unknown.
        pulses: stamps of the index pulses of a drive, ns, ascending; written to
            ``phase_reference``.
        part: that is read; None for all.
        traced: whether to keep the signals, for a picture.
        progress: called with the number of rows read.

    Raises:
        UsageError: the file has a mistake, a source does not fit it or the model, or something
            is at ``output``.
        BagError: no impact was found, or the bag cannot be written. Then no bag is left.
    """
    present_sources, problems = present(
        signal.path, dict.fromkeys(signal.topics.values(), _TYPE), sources
    )
    if model is not None:
        check_contacts(model, present_sources)
    begin = int(signal.stamps[0])
    is_late = part is not None and part.low > begin
    chosen = signal if part is None else signal.within(part)
    if part is not None and not len(chosen.stamps):
        problem = f"no row from {part.words}; choose another part with --start and --duration"
        raise UsageError(f"{signal.path}: {problem}")
    detector = Detector(present_sources, epoch=epoch, traced=traced, joins_late=is_late)
    made = detecting(signal.path, detector, output, problems, part=part, model=model)
    with made as (writer, result):
        result.zero, result.rows = signal.time_zero, len(chosen.stamps)
        result.seconds = seconds_between(int(chosen.stamps[0]), int(chosen.stamps[-1]))
        if model is not None:
            write_model(writer, model, max(begin, part.low if part else 0))
        writer.declare(interfaces.IMPACTS.topic)
        if pulses:
            writer.declare(interfaces.PHASE_REFERENCE.topic)
        columns = {topic: name for name, topic in signal.topics.items()}
        names = [columns[source.topic] for source in detector.sources]
        _run(chosen, names, writer, detector, pulses=pulses, progress=progress)
        result.doubts += signal.remarks
        result.doubts += [signal.omissions[n] for n in {*names} & {*signal.omissions}]
    return result


def pulses_in(signal: Signal, column: str) -> list[int]:
    """Stamps of the rising edges of a column, such as a drive's index pulses, ns.

    An edge goes from the lowest to the highest quarter of the column's range. Its instant is
    where the line between two samples crosses the middle. The topic of a column may be given.

    Raises:
        UsageError: the file has no such column, or the column has no rising edge.
    """
    names = {topic: name for name, topic in signal.topics.items()}
    name = names.get(column, column)
    if name not in signal.topics:
        raise UsageError(f"pulses: no column {column}; columns: {', '.join(signal.topics)}")
    there = np.isfinite(signal.columns[name])
    stamps, values = signal.stamps[there], signal.columns[name][there]
    low, middle, high = (float(x) for x in np.quantile([values.min(), values.max()], _LEVELS))
    level = np.where(values >= high, 1, np.where(values <= low, -1, 0))
    known = np.flatnonzero(level)
    rises = known[1:][(level[known[1:]] > 0) & (level[known[:-1]] < 0)]
    crossings = np.flatnonzero((values[:-1] < middle) & (values[1:] >= middle))
    if low == high or not rises.size:
        raise UsageError(f"pulses: {column} has no rising edge; expected pulses of a drive")
    k = crossings[np.searchsorted(crossings, rises) - 1]
    share = (middle - values[k]) / (values[k + 1] - values[k])
    after = np.round(share * (stamps[k + 1] - stamps[k])).astype(np.int64)
    return [int(stamp) for stamp in stamps[k] + after]


def _run(
    signal: Signal,
    columns: Sequence[str],
    writer: BagWriter,
    detector: Detector,
    *,
    pulses: Sequence[int],
    progress: Callable[[int], None],
) -> None:
    """Feed the detector with every row, as if each were received at its stamp.

    ``columns`` are those of the detector's sources.
    """
    waiting = deque(pulses)
    stamps = signal.stamps.tolist()
    rows = zip(*(signal.columns[name].tolist() for name in columns), strict=True)
    for done, (stamp, values) in enumerate(zip(stamps, rows, strict=True), start=1):
        while waiting and waiting[0] <= stamp:
            pulse = waiting.popleft()
            message = bag_messages().pulse(pulse)
            writer.write(interfaces.PHASE_REFERENCE.topic, pulse, message)
        for index, value in enumerate(values):
            if isfinite(value):
                sample = Sample(SampleTime(stamp, stamp), (value,))
                write_events(writer, detector.take(index, sample))
        progress(done)
    # After the longest delay no message can be missing any more, as in a bag.
    write_events(writer, detector.advance(stamps[-1] + MAX_DELAY))
