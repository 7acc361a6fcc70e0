# SPDX-License-Identifier: Apache-2.0
"""What ``./dev soak`` attacks: each reader of something foreign, with examples of what it reads.

A later file, message or command is covered by a line in ``TARGETS``.
"""

import argparse
import math
import random
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import soak_commands, soak_files
from benchmarks.soak_files import EPOCH, Attack, S
from benchmarks.soak_inputs import mutated
from impact_observer.check.bag_check import check_bag
from impact_observer.cli.arguments import value_of
from impact_observer.detector.sensor_file import parse_sources
from impact_observer.errors import ImpactObserverError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import BagReader, JointState
from impact_observer.io.import_table import import_table
from impact_observer.io.interfaces import JOINT_STATE
from impact_observer.io.measured_samples import SensorReader
from impact_observer.io.messages import (
    AnyMessage,
    MessageError,
    MessageLimits,
    bag_messages,
    read_event,
)
from impact_observer.io.observed_bag import observe_bag
from impact_observer.io.typestores import deserialize, new_typestore, typestore
from impact_observer.model import parse_model, read_model
from impact_observer.model.measurement import Measurement
from impact_observer.model.measurements_file import parse_measurements
from impact_observer.observer import Observer, Options, make_observer
from impact_observer.options import OBSERVER_OPTIONS, Option
from impact_observer.resources import shared
from impact_observer.ros import parameters
from impact_observer.ros.event_intake import EventIntake
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import MAX_STAMP

_MODELS = ("two_mass", "three_mass", "bouncing_ball")
_TABLE = b"time,x1,x2\n0,0,1\n0.5,1e-3,-2\n1,0,4\n"
_IMPACTS = b"time,contact,kind,sequence\n0.5,stop,impact,1\n0.9,stop,close,2\n1.25,stop,open,3\n"
_MEASURED = b"""measurements:
  - {name: laser, topic: /range, field: a.b[3], position: {x2: -1}, offset: 0.5, deviation: 0.1}
  - {name: probe, topic: /probe, joint: x, quantity: velocity, gap: stop, deviation: 1.0e-4,
     delay: 0.01, blanking: 0.004, gate: 5.0, timeout: 0.5, stamp: receive}
"""
_EDGES = (0, 1, 2, 5, 999, 2**31, 2**32 - 1)
_LONG = (0, 1, 7, 1007, 2**32, 2**63, 2**64 - 1)


_LIVE = """\
name: live
bodies: [{name: x, mass: 1}]
grounds: [{name: table, motion: {live: true}}]
springs: [{between: [table, x], stiffness: 40, damping: 1}]
forces: [{body: x, input: motor}, {body: x, amplitude: 1, frequency: 6, order: 1}]
stops: [{name: stop, between: [table, x], gap: 0.2, restitution: 0.5}]
"""


class Target(NamedTuple):
    """Something that reads foreign input.

    Attributes:
        name: on the command line.
        share: of all inputs, relative to the others: less where an input takes longer.
        make: prepares the attack, in a folder of its own.
    """

    name: str
    share: float
    make: Callable[[Path], Attack]


def _model(_: Path) -> Attack:
    """A model file; what it says is integrated over a millisecond if it is valid."""
    texts = [shared(f"config/{name}.yaml").read_bytes() for name in _MODELS]
    texts.append(
        b"name: a\nbodies: [{name: x, mass: 1}]\nsprings: [{between: [ground, x], stiffness: 1}]\n"
    )

    def attack(draw: random.Random) -> object:
        return parse_model(_text(mutated(draw, draw.choice(texts), texts)), "model")

    return attack


def _table(folder: Path) -> Attack:
    """A table of forces beside a model."""
    file = folder / "table.csv"
    model = shared("config/two_mass.yaml").read_text("utf-8")
    head, _, rest = model.partition("forcing:")
    tail = rest[rest.index("contacts:") :] if "contacts:" in rest else ""
    text = f"{head}forcing: {{sampled: table.csv, hold: linear}}\n{tail}"

    def attack(draw: random.Random) -> object:
        file.write_bytes(mutated(draw, _TABLE, [_TABLE]))
        return parse_model(text, "model", folder)

    return attack


def _sensors(_: Path) -> Attack:
    """A file of sensors."""
    texts = [each.read_bytes() for each in sorted(shared("config/detector").glob("*.yaml"))]

    def attack(draw: random.Random) -> object:
        return parse_sources(_text(mutated(draw, draw.choice(texts), texts)), "sensors")

    return attack


def _measurements(_: Path) -> Attack:
    """A file of what is measured beside the impacts."""
    texts = [each.read_bytes() for each in sorted(shared("config/measurements").glob("*.yaml"))]
    texts.append(_MEASURED)

    def attack(draw: random.Random) -> object:
        return parse_measurements(_text(mutated(draw, draw.choice(texts), texts)), "measured")

    return attack


def _csv(folder: Path) -> Attack:
    """A CSV file of impact times."""
    number = iter(range(2**62))

    def attack(draw: random.Random) -> object:
        file, bag = folder / "impacts.csv", folder / f"imported{next(number)}"
        file.write_bytes(mutated(draw, _IMPACTS, [_IMPACTS, _TABLE]))
        try:
            return import_table(file, bag)
        finally:
            _remove(bag)

    return attack


def _bag(folder: Path) -> Attack:
    """A bag: read, checked, observed."""
    source = folder / "seed"
    soak_files.write_two_mass(source)
    seeds = {file.name: file.read_bytes() for file in source.iterdir()}
    bag, number = folder / "bag", iter(range(2**62))
    bag.mkdir()

    def attack(draw: random.Random) -> object:
        chosen = draw.choice([*seeds])
        for name, data in seeds.items():
            content = mutated(draw, data, [data]) if name == chosen else data
            (bag / name).write_bytes(content)
        output = folder / f"out{next(number)}"
        how = draw.randrange(2)
        try:
            if how == 0:
                return check_bag(bag)
            with BagReader(bag) as reader:
                return observe_bag(reader, _observer(), output, rate=10.0, most=10_000)
        finally:
            _remove(output)

    return attack


def _parameters(_: Path) -> Attack:
    """Values of options on the command line, in Python, and of the nodes' parameters."""
    rows: list[Option] = [*OBSERVER_OPTIONS, *SENSOR_FAULTS]
    rows += [row for table in parameters.TABLES.values() for row in table]
    values: tuple[object, ...] = (
        *(
            "",
            "nan",
            "-1",
            "1e999",
            "0x10",
            "\u0663",
            "a" * 9999,
            "\0",
            "1,2",
            "restitution=-1",
            True,
        ),
        *(0, -1, 2**63, 2**70, 1.5, -1e300, math.nan, math.inf, (), ("x",), None, [], b"x"),
    )

    def attack(draw: random.Random) -> object:
        row, value = draw.choice(rows), draw.choice(values)
        if draw.random() < 0.5:
            text = _text(mutated(draw, str(value).encode("utf-8", "replace"), [b"1.0", b"zero"]))
            return value_of(row)(text)
        if draw.random() < 0.3 and row in OBSERVER_OPTIONS:
            given: dict[str, Any] = {row.name: value}
            return make_observer(_two_mass(), Options(**given))
        given = {row.name: value}
        parameters.check((row,), given)
        return given

    return attack


def _event_bytes(draw: random.Random) -> bytes:
    """A serialized event, most of them of an observed plant."""
    return mutated(draw, draw.choice(_serialized()), _serialized())


def _rosbags_message(_: Path) -> Attack:
    """A serialized event, as the reader of a bag takes the event."""
    return lambda draw: read_event(_event_message(draw))


def _event_message(draw: random.Random) -> AnyMessage:
    """The message in the bytes of an event.

    Raises:
        MessageError: the bytes are no event.
    """
    data = _event_bytes(draw)
    try:
        return deserialize(typestore(), data, "impact_observer_msgs/msg/ImpactEvent")
    except Exception as error:  # noqa: BLE001 (rosbags raises errors of many types)
        raise MessageError(str(error)) from None  # as the reader does


def _message(_: Path) -> Attack:
    """The message of an event, as a node takes the message; a valid event is applied."""
    intakes: list[EventIntake] = []
    observers: list[Observer] = []

    def attack(draw: random.Random) -> object:
        if not intakes or draw.random() < 1e-3:
            observers[:] = [_observer()]
            now = EPOCH + 1000 * S
            intakes[:] = [EventIntake(observers[0], lambda: now, S, MessageLimits(), Counter())]
        if problem := intakes[0].take_message(_event_message(draw)):
            raise MessageError(problem)
        for _ in intakes[0].finish():
            pass
        while intakes[0].is_busy:
            for _ in intakes[0].apply_waiting():
                pass
        return _check_finite(observers[0])

    return attack


def _event(_: Path) -> Attack:
    """Events of any values, given to an observer; its estimates stay finite."""
    observers: dict[str, Observer] = {}

    def attack(draw: random.Random) -> object:
        law = "minimum-variance" if draw.random() < 0.01 else "geometric"
        if law not in observers or draw.random() < 0.01:
            observers[law] = _observer(law)
        observers[law].receive(_drawn_event(draw))
        return _check_finite(observers[law])

    return attack


def _samples(_: Path) -> Attack:
    """Samples of a live force and ground of any values, between events."""
    model = parse_model(_LIVE, "live").system
    observers: list[Observer] = []

    def attack(draw: random.Random) -> object:
        if not observers or draw.random() < 0.01:
            observers[:] = [make_observer(model, Options("geometric", ensemble=2))]
        live = observers[0].live
        assert live is not None, "the model has live signals"
        name = draw.choice(["motor", "table", "table", ""])
        odd = draw.random() < 0.1
        stamp = draw.choice([1, EPOCH, MAX_STAMP]) if odd else EPOCH + draw.randrange(30 * S)
        value, rate = (
            draw.choice([0.0, 1e15, -1e300, math.nan, math.inf])
            if draw.random() < 0.1
            else draw.gauss(0.0, 1.0)
            for _ in range(2)
        )
        live.add_force(name, stamp, value)
        live.add_motion(name, stamp, value, rate)
        if draw.random() < 0.2:
            live.add_pulse(stamp)
        observers[0].receive(_drawn_event(draw))
        return _check_finite(observers[0])

    return attack


def _measured(_: Path) -> Attack:
    """Messages of an encoder with anything in them, between events."""
    declared = Measurement("encoder", "/encoder", "x1", "position", deviation=1e-3)
    reader, observers = SensorReader(declared, 0, JOINT_STATE), list[Observer]()

    def attack(draw: random.Random) -> object:
        if not observers or draw.random() < 0.1:
            law = "minimum-variance" if draw.random() < 0.1 else "geometric"
            options = Options(law, ensemble=2, clock_error=1e-3, model_error=0.0)
            observers[:] = [make_observer(_two_mass(), options, measurements=[declared])]
        odd = draw.random() < 0.1
        stamp = draw.choice([1, EPOCH, EPOCH + 100 * S]) if odd else EPOCH + draw.randrange(30 * S)
        message = bag_messages().joint_state(JointState(stamp, (), np.empty(0), np.empty(0)))
        message.name = [draw.choice(["x1", "x2", ""]) for _ in range(draw.randrange(4))]
        values = [0.0, 1e15, -1e300, math.nan, math.inf] if odd else [draw.gauss(0.0, 1.0)]
        message.position = np.array([draw.choice(values) for _ in range(draw.randrange(4))])
        sample = reader.sample(message, stamp)
        observers[0].measure([] if sample is None else [sample])
        event = _drawn_event(draw)
        if event.stamp < EPOCH + 100 * S:  # odd events are the matter of another target
            observers[0].receive(event)
        return _check_finite(observers[0])

    return attack


TARGETS = (
    Target("model", 0.5, _model),
    Target("table", 1, _table),
    Target("sensors", 0.5, _sensors),
    Target("measurements", 0.5, _measurements),
    Target("csv", 0.5, _csv),
    Target("sound", 3, soak_files.sound),
    Target("matrix", 3, soak_files.matrix),
    Target("signal", 1, soak_files.signal),
    Target("robot", 0.2, soak_files.robot),
    Target("bag", 0.1, _bag),
    Target("database", 0.2, soak_files.database),
    Target("commands", 0.2, soak_commands.commands),
    Target("parameters", 25, _parameters),
    Target("bag-message", 25, _rosbags_message),
    Target("message", 40, _message),
    Target("event", 8, _event),
    Target("samples", 2, _samples),
    Target("measured", 1, _measured),
)
"""All of them."""


@cache
def _two_mass() -> Any:  # noqa: ANN401 (a System; its name would be imported for this line)
    return read_model("two_mass").system


def _observer(law: str = "geometric") -> Observer:
    return make_observer(_two_mass(), Options(law, "random:1", ensemble=2))


@cache
def _serialized() -> list[bytes]:
    """Events as messages in CDR."""
    make, store = bag_messages(), new_typestore()
    stop = (Switch("stop"),)
    events = [ImpactEvent(EPOCH + k * S // 4, stop, k, 0, EPOCH) for k in range(1, 40)]
    events += [
        ImpactEvent(EPOCH + 11 * S, (Switch("stop", Kind.CLOSE), Switch("bolt")), 41, 0, EPOCH),
        ImpactEvent(EPOCH + 12 * S, (), 0, 1, 0),
    ]
    kind = "impact_observer_msgs/msg/ImpactEvent"
    return [bytes(store.serialize_cdr(make.event(each), kind)) for each in events]


def _drawn_event(draw: random.Random) -> ImpactEvent:
    """An event that is like those of a plant in most of its values."""
    near = EPOCH + draw.randrange(30 * S)
    odd = draw.random() < 0.2
    contacts = draw.choices(["stop", "bolt", ""], [20, 1, 1], k=draw.choice([1, 1, 1, 2, 0, 50]))
    return ImpactEvent(
        draw.choice([1, EPOCH, MAX_STAMP, near]) if odd else near,
        tuple(Switch(each, draw.choice(list(Kind))) for each in contacts),
        draw.choice(_LONG) if draw.random() < 0.2 else draw.randrange(5000),
        draw.choice(_EDGES) if draw.random() < 0.2 else 0,
        draw.choice([0, 1, EPOCH, near, MAX_STAMP]) if draw.random() < 0.2 else EPOCH,
    )


def _check_finite(observer: Observer) -> object:
    """The estimate at the last event.

    Raises:
        AssertionError: it is not finite.
    """
    if observer.start is None:
        return None
    estimate = observer.estimate(max(observer.last_event, observer.start))
    assert np.isfinite([*estimate.q, *estimate.u]).all(), "the estimate is not finite"
    return estimate


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _remove(path: Path) -> None:
    """Remove a bag."""
    for file in path.iterdir() if path.is_dir() else ():
        file.unlink()
    if path.is_dir():
        path.rmdir()


def expected_errors() -> tuple[type[BaseException], ...]:
    """Errors by which what is attacked may refuse an input."""
    return (ImpactObserverError, argparse.ArgumentTypeError)


def named(names: Iterable[str]) -> list[Target]:
    """The targets of these names; all for none."""
    wanted = [*names]
    return [each for each in TARGETS if not wanted or each.name in wanted]


def folder() -> "tempfile.TemporaryDirectory[str]":
    """A folder for the files of an attack, in memory where there is such."""
    memory = Path("/dev/shm")
    return tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None)
