# SPDX-License-Identifier: Apache-2.0
"""Runs an observer on the events of a bag, and writes a bag with its estimates."""

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import TypeAlias

import numpy as np

from impact_observer.errors import BagError, UnfitBagError, UsageError
from impact_observer.events import (
    DECIDING,
    ImpactEvent,
    MeasurementVerdict,
    Ruling,
    Verdict,
    final_rulings,
    rejected_impacts,
)
from impact_observer.io import interfaces
from impact_observer.io.live_inputs import efforts_on, first_pulse, give_recorded
from impact_observer.io.measured_samples import NO_SENSORS, RecordedSamples
from impact_observer.io.messages import bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import PLANT_TOPICS, all_or_nothing, events_in
from impact_observer.io.writer import BagWriter
from impact_observer.model import System
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.event_outcomes import count_rulings
from impact_observer.observer.replay import Impacts, noting_impacts
from impact_observer.observer.sender_runs import used_of
from impact_observer.stamps import grid, text
from impact_observer.states import Estimate, Estimates, Stamps

_MOST_ESTIMATES = 10_000_000
"""Most estimates that are made, those of one day at 100 Hz: a wrong stamp could fill the disk."""
_MOST_NAMES = 5
"""Contacts that an error names."""
OBSERVER = "observer"
"""The node that publishes estimates, where no other is named."""
Serialize: TypeAlias = Callable[[str, object], bytes]
"""Makes bytes of a topic and a message of its type."""
_COPIED = (*PLANT_TOPICS, interfaces.FORCING, interfaces.PHASE_REFERENCE)
_Judged: TypeAlias = Verdict | MeasurementVerdict
_Message: TypeAlias = tuple[int, str, bytes]
"""Log time (ns), topic and bytes."""


def observe_bag(
    reader: BagReader,
    observer: Observer,
    output: Path,
    *,
    rate: float | None = None,
    epoch: int = 0,
    measured: RecordedSamples = NO_SENSORS,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    warn: Callable[[str], None] = lambda _: None,
) -> tuple[int, Counter[Ruling]]:
    """Run ``observer`` on a bag's events; impacts, true states and model are copied.

    Args:
        reader: the bag to read.
        observer: has received no event yet.
        output: the bag to make.
        rate: of the estimates, Hz; None for the stamps of the true states.
        epoch: stamp of the forcing's ``t = 0``, ns; 0 to take it from the events.
        measured: the samples of sensors.
        progress: called with the number of estimates made, and of all estimates.
        warn: called with what was wrong with samples of live forces and grounds, and where events
            come after the last estimate.

    Returns:
        The number of estimates, and the number of final verdicts of each kind.

    Raises:
        UsageError, BagError: the bags cannot be used as asked: also where no event names a contact
            of the system, and where none was applied. Then no bag is left.
    """
    events = events_from(reader, epoch)
    check_events(reader, events, observer.system, epoch)
    stamps = sample_stamps(reader, events, rate, epoch)
    if reader.low and min((each.sequence for each in events), default=0) > 1:
        # What happened before the part is unknown: the initial state holds at its first stamp.
        known = [each.stamp for each in events] + [each.stamp for each in measured.samples[:1]]
        stamps = stamps[stamps >= min(known)]
    check_count(reader, stamps)
    if rate is None and (line := unseen_events(events, stamps)):
        warn(line)
    for line in give_inputs(reader, observer):
        warn(line)
    topics = [topic for each in _COPIED if (topic := reader.find(each)) is not None]
    topics += [topic for topic in measured.topics if topic not in topics]
    verdicts, impacts = list[Verdict](), Impacts()
    with all_or_nothing(output) as writer:
        for topic in topics:
            info = reader.topics[topic]
            own = info.definition if topic in measured.topics else ""
            writer.declare(topic, type_name=info.type, quality=info.quality, definition=own)
        copied = ((raw.log_time, raw.topic, raw.data) for raw in reader.raw(topics))
        items = replay_batches(observer, events, stamps, rejects=True, samples=measured.samples)
        items = noting_impacts(items, observer, impacts)
        done, log_time = 0, 0
        ordered = in_log_order(_with_samples(items, observer, measured.published))
        made = _messages(ordered, writer, observer.system.coordinates, verdicts)
        for log_time, topic, data in heapq.merge(copied, made, key=itemgetter(0)):
            writer.write_raw(topic, log_time, data)
            if topic == interfaces.OBSERVER_STATES.topic:
                done += 1
                progress(done, stamps.size)
        final = final_rulings(verdicts)
        every = [*impacts.values(), *rejected_impacts(final, events)]
        for each in sorted(every, key=attrgetter("stamp")):  # the last verdict decides on each
            message = bag_messages().impact_estimate(each)
            writer.write(interfaces.OBSERVER_IMPACTS.topic, log_time, message)
        observer.require_start()
        is_later = stamps.size and stamps[-1] > observer.last_event > 0
        if is_later and (silence := observer.silence(int(stamps[-1]))):
            warn(f"after the last event, {text(observer.last_event)} s, {silence}")
        rulings = count_rulings(final, {event.stamp for event in events})
        if rulings and not rulings[Ruling.APPLIED]:
            refused = next(each for each in verdicts if each.ruling is not Ruling.APPLIED)
            words = [refused.ruling.name.lower().replace("_", " "), refused.reason]
            raise BagError(
                f"{reader.path}: none of its {sum(rulings.values())} impacts and releases was"
                f" applied; the first: {', '.join(filter(None, words))}"
            )
    others = Counter(each.ruling for each in verdicts if each.ruling not in DECIDING)
    return done, +(others + rulings)


def check_events(
    reader: BagReader, events: Sequence[ImpactEvent], system: System, epoch: int
) -> None:
    """Check that events of a bag can be of a model.

    Raises:
        UnfitBagError: there are none and no epoch, or all are of other contacts.
    """
    if not events and not epoch:
        raise UnfitBagError(
            f"{reader.path}: no impact in it, so that nothing is estimated; expected impacts, or"
            " the --epoch at which the initial state holds"
        )
    named = {switch.contact for event in events for switch in event.switches}
    if named and named.isdisjoint(system.contact_names):
        some, own = sorted(named)[:_MOST_NAMES], system.contact_names[:_MOST_NAMES]
        raise UnfitBagError(
            f"{reader.path}: its impacts are of {', '.join(some)}; expected contacts of the model"
            f" {system.name}: {', '.join(own) or 'it has none'}; name the model of this rig with"
            " --model"
        )


def _with_samples(
    items: Iterable[Estimates | Verdict], observer: Observer, published: Collection[str]
) -> Iterator[Estimates | _Judged]:
    """``items``, and the verdicts on samples of the sensors of these names before them."""
    for item in items:
        yield from (each for each in observer.samples.take() if each.name in published)
        yield item
    yield from (each for each in observer.samples.take() if each.name in published)


def events_from(reader: BagReader, epoch: int) -> list[ImpactEvent]:
    """The events of a bag whose forcing begins at ``epoch`` (ns); 0 to take it from the events.

    If no event has an epoch, the first pulse of the drive is the epoch, if the bag has a pulse.

    Raises:
        UsageError: the events say another epoch.
        BagError: the bag is damaged.
    """
    events = events_in(reader)
    epochs = {event.epoch for event in events if event.epoch}
    if not (epoch or epochs) and (pulse := first_pulse(reader)):
        return [replace(event, epoch=pulse) for event in events]
    if epoch and epochs and epoch not in epochs:
        raise UsageError(
            f"{reader.path}: epoch {text(epoch)} s asked for, but its events say"
            f" {text(min(epochs))} s; leave --epoch out, or repeat with it what made the events"
        )
    return events


def sample_stamps(
    reader: BagReader, events: Sequence[ImpactEvent], rate: float | None, epoch: int
) -> Stamps:
    """Stamps of the estimates: at ``rate`` (Hz) from the epoch on, or of the true states."""
    truth = reader.truth_topic()
    if rate is None:
        if truth is None or not reader.topics[truth].count:
            raise UsageError(f"{reader.path}: carries no truth to sample with; give --rate")
        return np.unique([*reader.all_stamps([truth])])
    if not (used := used_of(events)):
        return np.empty(0, dtype=np.int64)
    start = max(epoch or used[0].epoch or used[0].stamp, reader.low)
    last = max(each.stamp for each in used)
    if truth:
        last = max([last, *reader.all_stamps([truth])])
    return grid(start, last, rate)


def unseen_events(events: Sequence[ImpactEvent], stamps: Stamps) -> str:
    """A warning if events come after the last estimate; otherwise empty."""
    end = int(stamps.max()) if stamps.size else 0
    used = used_of(events)
    if not (later := sum(each.stamp > end for each in used)):
        return ""
    return (
        f"{later} of {len(used)} events are stamped after the last estimate, {text(end)} s, where"
        " the true states end; --rate makes estimates up to the last event"
    )


def give_inputs(reader: BagReader, observer: Observer) -> Iterator[str]:
    """Give an observer all live samples of a bag; a line for each reason why some are left out."""
    forces = None if observer.robot is None else observer.robot.description.forces
    if forces is None:
        return give_recorded(reader, observer.live)
    return give_recorded(reader, observer.live, efforts_on(interfaces.absolute(forces[0])))


def check_count(reader: BagReader, stamps: Stamps) -> None:
    """Refuse more estimates than ``_MOST_ESTIMATES``, as UsageError."""
    if stamps.size > _MOST_ESTIMATES:
        raise UsageError(
            f"{reader.path}: {stamps.size} estimates; expected at most {_MOST_ESTIMATES}; they"
            f" would go on until {text(int(stamps[-1]))} s; lower --rate, or take parts by --start"
            " and --duration"
        )


def in_log_order(
    items: Iterable[Estimates | _Judged],
) -> Iterator[tuple[int, Estimate | _Judged]]:
    """Yields estimates and verdicts with log times (ns) that never go back.

    The log time of an estimate is its stamp. A verdict that is given before the estimates up to
    its stamp waits for them. A verdict on an earlier stamp, a revision, is logged when given.
    """
    waiting: list[tuple[int, int, _Judged]] = []
    last = 0
    for k, item in enumerate(items):
        if not isinstance(item, Estimates):
            heapq.heappush(waiting, (max(item.stamp, last), k, item))
            continue
        for estimate in item:
            while waiting and waiting[0][0] <= estimate.stamp:
                last, _, verdict = heapq.heappop(waiting)
                yield last, verdict
            last = estimate.stamp
            yield last, estimate
    for log_time, _, verdict in sorted(waiting):
        yield log_time, verdict


def messages_of(
    estimate: Estimate, names: tuple[str, ...], serialize: Serialize, owner: str = OBSERVER
) -> Iterator[_Message]:
    """Log times (ns), topics and bytes of the two messages of an estimate of the node ``owner``.

    Raises:
        MessageError: a message cannot carry the estimate.
    """
    make = bag_messages()
    state = make.estimate(estimate, names)
    for own, message in (
        (interfaces.OBSERVER_JOINT_STATES, make.joint_state_of(state)),
        (interfaces.OBSERVER_STATES, state),
    ):
        topic = f"/{own.name_under(owner)}"
        yield estimate.stamp, topic, serialize(topic, message)


def _messages(
    items: Iterable[tuple[int, Estimate | _Judged]],
    writer: BagWriter,
    names: tuple[str, ...],
    verdicts: list[Verdict],
) -> Iterator[_Message]:
    """The messages of estimates, with bound and misfit where these are new, and of verdicts.

    Verdicts on events are added to ``verdicts``.
    """
    make, bound, misfit = bag_messages(), -1.0, ""
    for log_time, item in items:
        others: list[tuple[interfaces.Interface, object]] = []
        if isinstance(item, Verdict):
            verdicts.append(item)
            others = [(interfaces.OBSERVER_VERDICTS, make.verdict(item))]
        elif isinstance(item, MeasurementVerdict):
            others = [(interfaces.OBSERVER_MEASUREMENTS, make.measurement_verdict(item))]
        else:
            yield from messages_of(item, names, writer.serialized)
            if item.bound != bound:
                bound = item.bound
                others.append((interfaces.OBSERVER_BOUND, make.bound(item)))
            if item.misfit != misfit:
                misfit = item.misfit
                diagnosed = make.misfit(item, f"/{OBSERVER}")
                others.append((interfaces.DIAGNOSTIC_ARRAYS, diagnosed))
        for own, message in others:
            yield log_time, own.topic, writer.serialized(own.topic, message)
