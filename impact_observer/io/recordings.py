"""Whole recordings: a plant's run written to a bag, a bag observed into another one."""

import heapq
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from impact_observer import __version__
from impact_observer.errors import BagError, UsageError
from impact_observer.events import DECIDING, ImpactEvent, Ruling, Verdict, final_rulings
from impact_observer.integrators import EVENT_DRIVEN
from impact_observer.io import interfaces
from impact_observer.io.estimate_messages import in_log_order, messages_of
from impact_observer.io.messages import JointState, bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.writer import BagWriter
from impact_observer.model import Model, System, parse_model
from impact_observer.model.model_file import ModelText, model_text
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.event_outcomes import EventOutcomes, count_rulings, outcomes_of
from impact_observer.plant import IDEAL, Run, SensorModel, simulate_sensor
from impact_observer.stamps import grid, text
from impact_observer.states import Estimates, Stamps

_CARRIED = (interfaces.PLANT_MODEL, interfaces.IMPACTS, interfaces.PLANT_JOINT_STATES)


def carried_text(
    model: Model, seed: int, integrator: str = EVENT_DRIVEN, sensor: SensorModel = IDEAL
) -> str:
    """The model file that a plant publishes and a bag carries: it says who made it, and how.

    Of the sensor it says what was wrong with it, and nothing where nothing was.
    """
    provenance: dict[str, object] = {
        "package": "impact_observer",
        "version": __version__,
        "seed": seed,
        "integrator": integrator,
    }
    if sensor.faults:
        provenance["sensor"] = sensor.faults
    return model.text(provenance)


@contextmanager
def all_or_nothing(path: Path) -> Iterator[BagWriter]:
    """A writer whose bag stays when everything has come into it, or as far as Ctrl-C let it come.

    Raises:
        KeyboardInterrupt: as it came, with the bag's name; the bag is whole as far as it goes.
    """
    with BagWriter(path) as writer:
        try:
            yield writer
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{path} holds what was done until then") from None
        except BaseException:
            writer.close()
            shutil.rmtree(path, ignore_errors=True)
            raise


def write_run(
    path: Path,
    model: Model,
    run: Run,
    *,
    seed: int,
    integrator: str = EVENT_DRIVEN,
    sensor: SensorModel = IDEAL,
) -> int:
    """Write a plant's run to a bag: model, impacts as a sensor tells them, true states.

    The log time of an impact is its arrival, that of a state its stamp.

    Args:
        path: the bag to make.
        model: of the plant.
        run: what it did.
        seed: of everything random in it.
        integrator: what it was integrated by, in words.
        sensor: what is wrong with the sensor.

    Returns:
        How many events the sensor told.

    Raises:
        UsageError: something is at ``path`` already, or its parent is no folder; or the sensor
            cannot be one of the model.
        BagError: the bag cannot be written.
    """
    make, names = bag_messages(), model.system.coordinates
    n, last = model.system.n, int(run.stamps[-1])
    told = simulate_sensor(
        sensor, model.system, run.switchings, epoch=run.epoch, last=last, seed=seed
    )
    with all_or_nothing(path) as writer:
        for each in _CARRIED:
            writer.declare(each.topic)
        start = int(run.stamps[0])
        model_message = make.model(carried_text(model, seed, integrator, sensor))
        writer.write(interfaces.PLANT_MODEL.topic, start, model_message)
        # At equal stamps the event comes first: the state there is the one after it.
        events = (
            (each.arrival, 0, interfaces.IMPACTS.topic, make.event(each.event)) for each in told
        )
        states = (
            (
                stamp,
                1,
                interfaces.PLANT_JOINT_STATES.topic,
                make.joint_state(JointState(stamp, names, x[:n], x[n:])),
            )
            for stamp, x in zip(run.stamps.tolist(), run.states, strict=True)
        )
        for stamp, _, topic, message in heapq.merge(events, states, key=lambda item: item[:2]):
            writer.write(topic, stamp, message)
    return len(told)


def text_of_model(reader: BagReader, model: str | None) -> ModelText:
    """The text of a model file or sample that is named, else of the model in the bag.

    Raises:
        BagError: none is named, and the bag carries none.
        UsageError: there is no such file.
    """
    if model is not None:
        return model_text(model)
    carried = reader.model_text()
    if carried is None:
        raise BagError(f"{reader.path}: carries no model; name one with --model")
    return ModelText(carried, f"{reader.path} ({interfaces.PLANT_MODEL.topic})")


def model_of(reader: BagReader, model: str | None = None) -> Model:
    """A model file or sample that is named, else the model in the bag.

    Raises:
        BagError: none is named, and the bag carries none.
        UsageError, ModelError: the model cannot be read, or is none.
    """
    return parse_model(*text_of_model(reader, model))


def system_of(reader: BagReader, model: str | None) -> System:
    """The system of ``model_of``."""
    return model_of(reader, model).system


def events_in(reader: BagReader) -> list[ImpactEvent]:
    """All events of a bag, in order of episode, stamp and sequence.

    Raises:
        BagError: the bag has no topic of impacts, or several.
    """
    topic = reader.find(interfaces.IMPACTS)
    if topic is None:
        found = ", ".join(reader.topics) or "none"
        raise BagError(
            f"{reader.path}: has no impacts; expected {interfaces.IMPACT_EVENT} on"
            f" {interfaces.IMPACTS.topic}, topics in the bag: {found}"
        )
    return sorted(reader.events(topic), key=lambda e: (e.episode, e.stamp, e.sequence))


def outcomes_in(reader: BagReader, topic: str, events: Sequence[ImpactEvent]) -> EventOutcomes:
    """What the observer whose states are on a topic made of the events of a bag.

    Args:
        reader: the bag.
        topic: of its states; its verdicts are beside them, if it gave any.
        events: all of the bag.

    Raises:
        BagError: a verdict is none.
    """
    verdicts = f"{topic.rpartition('/')[0]}/verdicts"
    return outcomes_of(events, reader.verdicts(verdicts) if verdicts in reader.topics else None)


def epoch_of(events: Iterable[ImpactEvent]) -> int:
    """The stamp of ``t = 0`` that events say, ns; 0 where none does."""
    return next((event.epoch for event in events if event.epoch), 0)


def sample_stamps(
    reader: BagReader, events: list[ImpactEvent], rate: float | None, epoch: int
) -> Stamps:
    """Where to estimate: at ``rate`` (Hz) from the epoch on, or at the stamps of the truth.

    Raises:
        UsageError: there is neither a rate nor truth.
    """
    truth = reader.truth_topic()
    if rate is None:
        if truth is None:
            raise UsageError(f"{reader.path}: carries no truth to sample with; give --rate")
        return _stamps_of(reader, truth)
    if not events:
        return np.empty(0, dtype=np.int64)
    start = epoch or events[0].epoch or events[0].stamp
    last = int(_stamps_of(reader, truth).max()) if truth else events[-1].stamp
    return grid(start, last, rate)


def _stamps_of(reader: BagReader, topic: str) -> Stamps:
    """All stamps of a topic of states, ns, ascending, each once."""
    return np.unique(np.concatenate([block.stamps for _, block in reader.blocks([topic])]))


def observe_bag(
    reader: BagReader,
    observer: Observer,
    output: Path,
    *,
    rate: float | None = None,
    epoch: int = 0,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> tuple[int, Counter[Ruling]]:
    """Run ``observer`` on a bag's events; impacts, truth and model are carried along.

    Args:
        reader: the bag to read.
        observer: has seen nothing yet.
        output: the bag to make.
        rate: samples per second, Hz; None for the stamps of the truth.
        epoch: stamp of the forcing's ``t = 0``, ns; 0 where the events say it.
        progress: told the estimates made and the stamps to make them for.

    Returns:
        The number of estimates, and how many verdicts of each kind hold in the end.

    Raises:
        UsageError, BagError: the bags cannot be used as asked.
        ImpactLawError: the replica cannot follow an event.
    """
    events = events_in(reader)
    said = {event.epoch for event in events if event.epoch}
    if epoch and said and epoch not in said:
        raise UsageError(
            f"{reader.path}: epoch {text(epoch)} s asked for, but its events say"
            f" {text(min(said))} s; leave --epoch out"
        )
    stamps = sample_stamps(reader, events, rate, epoch)
    carried = [topic for each in _CARRIED if (topic := reader.find(each)) is not None]
    with all_or_nothing(output) as writer:
        for topic in carried:
            info = reader.topics[topic]
            writer.declare(topic, type_name=info.type, quality=info.quality)
        as_they_are = ((raw.log_time, raw.topic, raw.data) for raw in reader.raw(carried))
        watched = _Said(
            writer, observer.system.coordinates, lambda done: progress(done, stamps.size)
        )
        made = watched.messages(replay_batches(observer, events, stamps))
        for log_time, topic, data in heapq.merge(as_they_are, made, key=itemgetter(0)):
            writer.write_raw(topic, log_time, data)
    return watched.count, +(
        watched.told + count_rulings(watched.settled, {event.stamp for event in events})
    )


class _Said:
    """What an observer says, while it is written.

    Attributes:
        count: estimates so far.
        told: how many verdicts of each kind were no rulings on the plant's events.
        settled: those that are, the last on each event and contact.
    """

    def __init__(
        self, writer: BagWriter, names: tuple[str, ...], progress: Callable[[int], None]
    ) -> None:
        self.count = 0
        self.told = Counter[Ruling]()
        self.settled: dict[tuple[int, int, str], Ruling] = {}
        self._serialize = writer.serialized
        self._names = names
        self._progress = progress
        self._bound = -1.0

    def messages(self, items: Iterable[Estimates | Verdict]) -> Iterator[tuple[int, str, bytes]]:
        """Log times (ns), topics and messages of ``items``."""
        make, serialize = bag_messages(), self._serialize
        for log_time, item in in_log_order(items):
            if isinstance(item, Verdict):
                topic = interfaces.OBSERVER_VERDICTS.topic
                yield log_time, topic, serialize(topic, make.verdict(item))
                self.settled |= final_rulings([item])
                self.told[item.ruling] += item.ruling not in DECIDING
                continue
            told = messages_of(item, self._names, serialize)
            yield from islice(told, 2)  # of the first estimate
            if item.first.bound != self._bound:
                self._bound = item.first.bound
                topic = interfaces.OBSERVER_BOUND.topic
                yield log_time, topic, serialize(topic, make.bound(item.first))
            yield from told
            self.count += item.stamps.size
            self._progress(self.count)
