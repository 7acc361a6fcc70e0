# SPDX-License-Identifier: Apache-2.0
"""Smooths the recording in a bag, and writes a bag with the result."""

import heapq
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np

from impact_observer.batch.explanation import Explanation
from impact_observer.batch.smoothed_run import SmoothedRun
from impact_observer.batch.smoothing import Progress, no_progress, smoothed_runs
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Ruling, final_rulings, rejected_impacts
from impact_observer.io import interfaces
from impact_observer.io.bag_part import assumed_epoch
from impact_observer.io.live_inputs import with_recorded
from impact_observer.io.measured_samples import samples_in
from impact_observer.io.messages import bag_messages
from impact_observer.io.observed_bag import (
    check_count,
    check_events,
    events_from,
    messages_of,
    sample_stamps,
    unseen_events,
)
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import all_or_nothing, carried_topics
from impact_observer.io.writer import BagWriter
from impact_observer.model import Model, System
from impact_observer.model.measurement import Measurement
from impact_observer.observer import Options
from impact_observer.stamps import MAX_STAMP
from impact_observer.states import Stamps

_ESTIMATES = tuple(
    f"/{each.name_under(interfaces.SMOOTHER)}"
    for each in (interfaces.OBSERVER_JOINT_STATES, interfaces.OBSERVER_STATES)
)
_VERDICTS = f"/{interfaces.OBSERVER_VERDICTS.name_under(interfaces.SMOOTHER)}"
_IMPACTS, _IMPACT_ESTIMATES = (
    each.topic for each in (interfaces.SMOOTHED_IMPACTS, interfaces.SMOOTHED_ESTIMATES)
)


@dataclass(frozen=True, slots=True)
class BagSmoothing:
    """The result of smoothing a bag.

    Attributes:
        runs: the smoothed motions, one for each run of the sender.
        estimates: their number.
        problems: topics that were not copied and samples that were left out, a line each.
    """

    runs: Sequence[SmoothedRun]
    estimates: int
    problems: Sequence[str]

    @property
    def rulings(self) -> Counter[Ruling]:
        """How many final verdicts there are of each kind."""
        return Counter(each.ruling for run in self.runs for each in run.verdicts)


def smooth_bag(
    reader: BagReader,
    model: Model,
    options: Options,
    output: Path,
    *,
    measurements: Sequence[Measurement] = (),
    rate: float | None = None,
    known: Explanation | None = None,
    text: str | None = None,
    progress: Progress = no_progress,
    tell: Callable[[str], object] = lambda _line: None,
) -> BagSmoothing:
    """Smooth the events of a bag; everything else in it is copied.

    Args:
        reader: the bag to read.
        model: the model of the recorded system.
        options: of the observer.
        output: the bag to make.
        measurements: measurements of sensors beside the impacts.
        rate: of the estimates, Hz; None for the stamps of the true states.
        known: the motion of the last run of the sender, where it was found before.
        text: of the model that the result carries; None for that of the bag.
        progress: see ``Progress``.
        tell: called with a note on time zero, where no epoch is known.

    Raises:
        UsageError, BagError: the bags cannot be used as asked.
    """
    events = events_from(reader, options.epoch)
    check_events(reader, events, model.system, options.epoch)
    samples = samples_in(reader, measurements)
    assumed = assumed_epoch(model.subject, events, samples.samples, options.epoch)
    options = replace(options, epoch=options.epoch or assumed.stamp)
    if assumed.note:
        tell(assumed.note)
    stamps = sample_stamps(reader, events, rate, options.epoch)
    check_count(reader, stamps)
    problems = list[str]()

    def connected(system: System, epoch: int) -> System:
        """Return the system with the live forces that the bag has."""
        return with_recorded(reader, system, epoch, problems.append)

    try:
        runs = smoothed_runs(
            model,
            events,
            options,
            measurements=measurements,
            samples=samples.samples,
            progress=progress,
            connected=connected,
            known=known,
        )
    except BagError as error:
        raise type(error)(f"{reader.path}: {error}") from None
    left_out = [*samples.problems, *problems]
    if rate is None and (line := unseen_events(events, stamps)):
        left_out.append(line)
    own = [*_ESTIMATES, _VERDICTS, _IMPACTS, _IMPACT_ESTIMATES]
    with all_or_nothing(output) as writer:
        if text is not None:
            topic = interfaces.PLANT_MODEL.topic
            own.append(topic)
            writer.declare(topic)
            writer.write(topic, events[0].stamp, bag_messages().model(text))
        topics, not_copied = carried_topics(reader, writer, own)
        copied = ((raw.log_time, raw.topic, raw.data) for raw in reader.raw(topics))
        estimates = _estimates(writer, model.subject.coordinates, runs, stamps, progress)
        made = heapq.merge(_decisions(writer, runs, events), estimates, key=itemgetter(0))
        for log_time, topic, data in heapq.merge(copied, made, key=itemgetter(0)):
            writer.write_raw(topic, log_time, data)
    return BagSmoothing(runs, int(np.sum(stamps >= runs[0].start)), [*not_copied, *left_out])


def _decisions(
    writer: BagWriter, runs: Iterable[SmoothedRun], events: Sequence[ImpactEvent]
) -> Iterator[tuple[int, str, bytes]]:
    """Messages of verdicts and impacts: log times (ns), topics, bytes; in order of stamps."""
    make, messages = bag_messages(), list[tuple[int, str, object]]()
    for run in runs:
        verdicts = run.verdicts
        estimates = [*run.impact_estimates(), *rejected_impacts(final_rulings(verdicts), events)]
        messages += [(each.stamp, _VERDICTS, make.verdict(each)) for each in verdicts]
        messages += [(each.stamp, _IMPACTS, make.smoothed_impact(each)) for each in run.impacts()]
        messages += [(e.stamp, _IMPACT_ESTIMATES, make.impact_estimate(e)) for e in estimates]
    for stamp, topic, message in sorted(messages, key=itemgetter(0)):
        yield stamp, topic, writer.serialized(topic, message)


def _estimates(
    writer: BagWriter,
    names: tuple[str, ...],
    runs: Sequence[SmoothedRun],
    stamps: Stamps,
    progress: Progress,
) -> Iterator[tuple[int, str, bytes]]:
    """Messages of the states at ``stamps``: log times (ns), topics, bytes."""
    done, total = 0, int(stamps.size)
    for k, run in enumerate(runs):
        end = runs[k + 1].start if k + 1 < len(runs) else MAX_STAMP + 1
        here = stamps[(stamps >= run.start) & (stamps < end)]
        for each in run.estimates(here):
            for estimate in each:
                yield from messages_of(estimate, names, writer.serialized, interfaces.SMOOTHER)
            done += each.stamps.size
            progress("states", done, total)
