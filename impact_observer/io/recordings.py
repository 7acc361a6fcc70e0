# SPDX-License-Identifier: Apache-2.0
"""Recordings: write a plant's run to a bag, and read the model and the events of a bag."""

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType

from impact_observer import __version__
from impact_observer.errors import ImpactObserverError, ModelError, UnfitBagError
from impact_observer.events import ImpactEvent
from impact_observer.io import interfaces
from impact_observer.io.messages import JointState, bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.simulated_samples import SimulatedMessage
from impact_observer.io.writer import BagWriter, check_free
from impact_observer.model import Model, parse_model
from impact_observer.model.model_file import ModelText, model_text
from impact_observer.model.multibody import Multibody
from impact_observer.observer.event_outcomes import EventOutcomes, outcomes_of
from impact_observer.observer.sender_runs import in_order
from impact_observer.output_files import temporary_beside
from impact_observer.plant import IDEAL, Run, SensorModel, simulate_sensor

PLANT_TOPICS = (interfaces.PLANT_MODEL, interfaces.IMPACTS, interfaces.PLANT_JOINT_STATES)
"""Topics that ``write_run`` writes, and ``observe_bag`` copies."""


def published_model(
    model: Model,
    seed: int,
    sensor: SensorModel = IDEAL,
    true_parameters: Mapping[str, float] = MappingProxyType({}),
) -> str:
    """The model file as a plant publishes it: with the version, seed and integrator used.

    Faults of the sensor are listed, and parameters of the plant that are not those of the model.
    """
    provenance: dict[str, object] = {
        "package": "impact_observer",
        "version": __version__,
        "seed": seed,
        "integrator": "event-driven",
    }
    if sensor.faults:
        provenance["sensor"] = sensor.faults
    if true_parameters:
        provenance["true_parameters"] = dict(true_parameters)
    return model.text(provenance)


@contextmanager
def all_or_nothing(path: Path) -> Iterator[BagWriter]:
    """A :class:`BagWriter` whose bag is beside ``path``, and appears there after no exception."""
    check_free(path)
    with temporary_beside(path) as folder:
        with BagWriter(path, folder) as writer:
            yield writer
        folder.replace(path)


def carried_topics(
    reader: BagReader, writer: BagWriter, without: Collection[str]
) -> tuple[list[str], list[str]]:
    """Declare the topics of a bag that are to be copied: all but those ``without``.

    Returns:
        Their names, and a line for each that the writer cannot carry.
    """
    copied, problems = [], []
    for topic, info in reader.topics.items():
        if topic in without:
            continue
        try:
            writer.declare(
                topic, type_name=info.type, quality=info.quality, definition=info.definition
            )
            copied.append(topic)
        except ImpactObserverError as error:
            problems.append(f"{info.count} messages on {topic} are not carried along: {error}")
    return copied, problems


def write_run(
    path: Path,
    model: Model,
    run: Run,
    *,
    seed: int,
    sensor: SensorModel = IDEAL,
    samples: Sequence[SimulatedMessage] = (),
    types: Mapping[str, str] = MappingProxyType({}),
    true_parameters: Mapping[str, float] = MappingProxyType({}),
    system: Multibody | None = None,
    progress: Callable[[int], object] = lambda _: None,
) -> list[ImpactEvent]:
    """Write a plant's run to a bag: the model, the sensor's events, the true states.

    The log time of an event is its time of reception; of a state, its stamp.

    Args:
        path: the bag to make.
        model: of the plant.
        run: its states and impacts.
        seed: seed of all random numbers in the bag.
        sensor: its faults.
        samples: messages of sensors beside the impacts, as they arrive.
        types: of these messages, by topic.
        true_parameters: of the plant by name, where they are not those of the model.
        system: what hits, by default the model's linear system.
        progress: called with the stamp (ns) of each message that is written.

    Returns:
        The events, in the order of their reception.

    Raises:
        UsageError: ``path`` cannot be made, or the sensor does not fit the model.
        BagError: the bag cannot be written.
    """
    system = model.system if system is None else system
    make, names, n = bag_messages(), system.coordinates, system.n
    received = simulate_sensor(
        sensor,
        system,
        run.switchings,
        sensors=model.sensors,
        epoch=run.epoch,
        last=int(run.stamps[-1]),
        seed=seed,
    )
    # At equal stamps the event is first: the state is the state after the event.
    messages = heapq.merge(
        ((each.arrival, interfaces.IMPACTS.topic, make.event(each.event)) for each in received),
        (
            (
                stamp,
                interfaces.PLANT_JOINT_STATES.topic,
                make.joint_state(JointState(stamp, names, x[:n], x[n:])),
            )
            for stamp, x in zip(run.stamps.tolist(), run.states, strict=True)
        ),
        samples,
        key=itemgetter(0),
    )
    with all_or_nothing(path) as writer:
        for each in PLANT_TOPICS:
            writer.declare(each.topic)
        for topic, kind in types.items():
            writer.declare(topic, type_name=kind, quality=interfaces.SENSORS)
        text = published_model(model, seed, sensor, true_parameters)
        writer.write(interfaces.PLANT_MODEL.topic, int(run.stamps[0]), make.model(text))
        for stamp, topic, message in messages:
            writer.write(topic, stamp, message)
            progress(stamp)
    return [each.event for each in received]


def text_of_model(reader: BagReader, model: str | None) -> ModelText:
    """The text of the model file or sample ``model``, or if None of the model in the bag.

    Raises:
        BagError: the bag has no model.
        UsageError: the file does not exist.
    """
    if model is not None:
        return model_text(model)
    if (content := reader.model_text()) is None:
        raise UnfitBagError(f"{reader.path}: carries no model; name one with --model")
    return ModelText(content, f"{reader.path} ({interfaces.PLANT_MODEL.topic})")


def model_of(reader: BagReader, model: str | None = None) -> Model:
    """The model file or sample ``model``, or if None the model in the bag.

    Raises:
        ModelError: the model is not valid; others as of :func:`text_of_model`.
    """
    try:
        return parse_model(*text_of_model(reader, model))
    except ModelError as error:
        remedy = "" if model else "; name another one with --model"
        raise ModelError(error.key, error.problem + remedy) from None


def events_in(reader: BagReader) -> list[ImpactEvent]:
    """All events of a bag, by run of the sender, stamp and sequence (``sender_runs.in_order``).

    Raises:
        BagError: the bag has no topic of impacts, or several.
    """
    topic = reader.find(interfaces.IMPACTS)
    if topic is None:
        in_bag = ", ".join(reader.topics) or "none"
        raise UnfitBagError(
            f"{reader.path}: has no impacts; expected {interfaces.IMPACT_EVENT} on"
            f" {interfaces.IMPACTS.topic}, topics in the bag: {in_bag}; impact-observer detect"
            " makes them of a sensor's signal"
        )
    return in_order(reader.events(topic))


def outcomes_in(reader: BagReader, topic: str, events: Sequence[ImpactEvent]) -> EventOutcomes:
    """Outcome of each of the ``events`` of a bag, for the observer with the states on ``topic``.

    Raises:
        BagError: a verdict is not valid.
    """
    prefix = topic.rpartition("/")[0]
    verdicts = f"{prefix}/verdicts"
    outcomes = outcomes_of(
        events, reader.verdicts(verdicts) if verdicts in reader.topics else None
    )
    if f"{prefix}/measurements" not in reader.topics:
        return outcomes
    verdicts_on_samples = reader.messages(f"{prefix}/measurements")
    used = Counter(bool(each.accepted) for _, each in verdicts_on_samples)
    return replace(outcomes, measured=(used[True], used[False]))


def epoch_of(events: Iterable[ImpactEvent]) -> int:
    """The stamp of ``t = 0`` in the events, ns; 0 if no event has an epoch."""
    return next((event.epoch for event in events if event.epoch), 0)
