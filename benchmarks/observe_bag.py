"""Observing a bag against merely reading it and writing as many messages of the same types."""

from pathlib import Path

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys.store import Typestore

from benchmarks.harness import Benchmark, Contest, DisagreementError
from impact_observer.bag import interfaces
from impact_observer.bag.reader import BagReader
from impact_observer.bag.recordings import observe_bag, write_run
from impact_observer.bag.typestores import new_typestore
from impact_observer.events import Ruling
from impact_observer.model import Model, read_model
from impact_observer.observer import Observer, initial_state, law_named
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import from_seconds, grid

EPOCH = 1_000_000_000
DURATION = 30.0
RATE = 1000.0
MADE = (
    interfaces.OBSERVER_JOINT_STATES,
    interfaces.OBSERVER_STATES,
    interfaces.OBSERVER_VERDICTS,
    interfaces.OBSERVER_BOUND,
)
"""What an observer adds to a bag: two messages a state of the truth, two an impact."""


def prepare(folder: Path) -> Contest:
    """Record a bag; check that both make bags of the same messages, as many and as long."""
    model, bag = read_model("three_mass"), folder / "bag"
    stamps = grid(EPOCH, EPOCH + from_seconds(DURATION), RATE)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    write_run(bag, model, simulate(plant, stamps), seed=0)
    _observed(model, bag, folder / "ours")
    _copied(bag, folder / "theirs")
    ours, theirs = _contents(folder / "ours"), _contents(folder / "theirs")
    if ours != theirs:
        raise DisagreementError(f"ours {ours}, copied {theirs}")
    written = sum(count for count, _ in ours.values())
    return Contest(
        f"three_mass, {DURATION:g} s, {ours[interfaces.IMPACTS.topic][0]} impacts,"
        f" {stamps.size} estimates, {written} messages written",
        lambda place: _observed(model, bag, place / "bag"),
        {"reading and writing": lambda place: _copied(bag, place / "bag")},
    )


def _observed(model: Model, bag: Path, output: Path) -> None:
    with BagReader(bag) as reader:
        law = law_named("geometric")(model.system)
        observer = Observer(model.system, law, *initial_state("random:1", model.system))
        observe_bag(reader, observer, output)


def _copied(bag: Path, output: Path) -> None:
    """What no observer could do without, with ``rosbags`` alone.

    Impacts and truth are read as messages; everything is written again; and for each state of
    the truth and each impact the messages of an observer, made from what was read.
    """
    store = new_typestore()
    with (
        Reader(bag) as reader,
        Writer(output, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        copies = {c.id: _connect(writer, store, c.topic, c.msgtype) for c in reader.connections}
        joint_states, states, verdicts = (
            _connect(writer, store, each.topic, each.type) for each in MADE
        )
        for connection, log_time, data in reader.messages():
            writer.write(copies[connection.id], log_time, data)
            if connection.topic == interfaces.PLANT_JOINT_STATES.topic:
                truth = store.deserialize_cdr(data, connection.msgtype)
                _write(writer, store, joint_states, log_time, truth)
                _write(writer, store, states, log_time, _state(store, truth))
            elif connection.topic == interfaces.IMPACTS.topic:
                event = store.deserialize_cdr(data, connection.msgtype)
                _write(writer, store, verdicts, log_time, _verdict(store, event))


def _connect(writer: Writer, store: Typestore, topic: str, type_name: str) -> Connection:
    return writer.add_connection(topic, type_name, typestore=store)


def _write(
    writer: Writer, store: Typestore, connection: Connection, log_time: int, message: object
) -> None:
    writer.write(connection, log_time, store.serialize_cdr(message, connection.msgtype))


def _state(store: Typestore, truth):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """A state of an observer that would know the truth."""
    return store.types[interfaces.OBSERVER_STATE](
        header=truth.header,
        law="geometric",
        name=truth.name,
        position=truth.position,
        velocity=truth.velocity,
        covariance=np.empty(0),
        closed=[],
        convergence=0.0,
        synchronized=False,
        clock_offset=0.0,
        last_sequence=0,
        last_event=truth.header.stamp,
        parameter_name=[],
        parameter=np.empty(0),
        parameter_deviation=np.empty(0),
    )


def _verdict(store: Typestore, event):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """That an event was applied."""
    return store.types[interfaces.EVENT_VERDICT](
        header=event.header,
        verdict=int(Ruling.APPLIED),
        sequence=event.sequence,
        contact=event.switches[0].contact,
        reason="",
        innovation=-1.0,
        latency=0.0,
    )


def _contents(bag: Path) -> dict[str, tuple[int, int]]:
    """Messages and bytes of each topic."""
    contents: dict[str, tuple[int, int]] = {}
    with BagReader(bag) as reader:
        for topic, _, data in reader.raw():
            count, size = contents.get(topic, (0, 0))
            contents[topic] = (count + 1, size + len(data))
    return contents


BENCHMARK = Benchmark("observe", "what does observing a bag add to copying it?", prepare)
