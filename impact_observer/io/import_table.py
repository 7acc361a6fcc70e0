# SPDX-License-Identifier: Apache-2.0
"""Impact times from a table, true states and samples of sensors from others: a bag."""

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import isnan
from operator import itemgetter
from pathlib import Path

import numpy as np

from impact_observer import __version__
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import interfaces
from impact_observer.io.messages import AnyMessage, JointState, bag_messages
from impact_observer.io.recordings import all_or_nothing
from impact_observer.io.signals import Signal, check_stamps, read_signal, topic_of, zero_of
from impact_observer.io.tables import Table, TableForm, is_number, read_table, shown
from impact_observer.model import Model
from impact_observer.stamps import text
from impact_observer.states import Vector, frozen

_EXPECTED = "time[, contact[, kind]]"
_COLUMNS = ("contact", "kind")
_KINDS = {name: kind for kind in Kind for name in (kind.name.lower(), str(kind.value))}
_KINDS[""] = Kind.IMPACT
_SAMPLES = 101
"""First rows that look like samples of a signal if they are equally spaced."""
_Stream = Iterator[tuple[int, str, AnyMessage]]
"""Stamps (ns), topics and messages."""


@dataclass(frozen=True, slots=True)
class Imported:
    """The result of an import: events and numbers of true states and of samples by topic.

    Attributes:
        rows: rows of impacts read.
        start: stamp of the file's time zero, ns.
        times: words for the form of the file's times, such as ``times in ms``.
        ignored: names of the columns of impacts that were not read.
        remarks: what was left out or is doubtful, a line each.
    """

    events: list[ImpactEvent]
    rows: int
    states: int
    start: int
    times: str
    ignored: list[str]
    remarks: list[str]
    samples: Mapping[str, int]


def import_table(
    path: Path,
    output: Path,
    *,
    model: Model | None = None,
    truth: Path | None = None,
    samples: Sequence[Path] = (),
    form: TableForm | None = None,
    start: int | None = None,
    epoch: int | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Imported:
    """Write the impact times of a table to a bag, and true states and samples of other tables.

    Rows of equal time are one event.

    Args:
        path: the table of impact times.
        output: the bag to make.
        model: to put into the bag; only its contacts are allowed. None for none.
        truth: a table of positions ``q_NAME`` (or ``NAME``) and velocities ``u_NAME`` of the
            model's coordinates; None for none.
        samples: tables of sensors. Each is a topic named as the file, of
            ``sensor_msgs/JointState``, whose positions are the columns of numbers.
        form: of the files; column of time, separator and lines to skip are those of ``path``.
        start: stamp of the files' time zero, ns; None as for :func:`zero_of` of the first impact.
        epoch: stamp of ``t = 0`` of the forcing, ns; None for the files' time zero.
        progress: called with the number of messages written.

    Raises:
        UsageError: a file has a mistake, something is at ``output`` already, or there is truth
            without a model.
        BagError: the bag cannot be written.
    """
    form = form or TableForm()
    table = read_table(path, form, _EXPECTED, strict=True)
    _check_is_no_signal(table)
    start = zero_of(int(table.times[0]), start)
    zero = start if epoch is None else epoch
    events = _events(table, None if model is None else model.subject.contact_names, start, zero)
    others = replace(form, skip_rows=0, separator=None)
    signals = _signals(samples, replace(others, time_column=None), start, table)
    counted = [table.is_counted, *(signal.is_counted for signal in signals.values())]
    if form.frame_rate and not any(counted):
        raise UsageError(f"{path}: has a column of time; leave out --frame-rate, or the column")
    make = bag_messages()
    impacts = ((e.stamp, interfaces.IMPACTS.topic, make.event(e)) for e in events)
    streams: list[_Stream] = [impacts]
    if truth is not None:
        streams.append(_states(truth, others, model, start))
    streams += [_samples(topic, signal) for topic, signal in signals.items()]
    counts = Counter[str]()
    with all_or_nothing(output) as writer:
        if model is not None:
            text_of_model = model.text({"package": "impact_observer", "version": __version__})
            writer.write(interfaces.PLANT_MODEL.topic, events[0].stamp, make.model(text_of_model))
        writer.declare(interfaces.IMPACTS.topic)
        for topic in signals:
            writer.declare(topic, type_name=interfaces.JOINT_STATE)
        # At equal stamps the event is first: the state there is the one after it.
        merged = heapq.merge(*streams, key=itemgetter(0))
        for done, (stamp, topic, message) in enumerate(merged, start=1):
            writer.write(topic, stamp, message)
            counts[topic] += 1
            progress(done)
    own = [(*each.remarks, *each.omissions.values()) for each in signals.values()]
    return Imported(
        events=events,
        rows=len(table.times),
        states=counts[interfaces.PLANT_JOINT_STATES.topic],
        start=start,
        times=table.words,
        ignored=[name for name in table.cells if name.lower() not in _COLUMNS],
        remarks=[*table.remarks, *chain.from_iterable(own)],
        samples={topic: counts[topic] for topic in signals},
    )


def _check_is_no_signal(table: Table) -> None:
    """Refuse rows like samples: equally spaced, with a column of numbers and none of contacts."""
    times, numbers = table.times[:_SAMPLES], table.columns_of_numbers()
    if len(times) < _SAMPLES or not numbers or table.find("contact") is not None:
        return
    steps, rounded = np.diff(times), np.gcd.reduce(times)
    if np.ptp(steps) <= rounded and np.ptp(steps) < steps.max():
        raise UsageError(
            f"{table.path}: looks like a signal, not like impact times: its rows are equally"
            f" spaced, and column {numbers[0]} is left out; `detect {table.path} --contact NAME"
            " --threshold X` finds the impacts of a signal (docs/detector.md). If these are"
            f" impacts, remove the column {numbers[0]}"
        )


def _events(
    table: Table, contacts: Sequence[str] | None, start: int, epoch: int
) -> list[ImpactEvent]:
    """The events; ``contacts`` are those of the model, None without a model."""
    rows, lines = len(table.times), table.lines.tolist()
    check_stamps(table.path, start + table.times, start, epoch)
    names, kinds = (_texts(table, name) for name in _COLUMNS)
    events: list[ImpactEvent] = []
    places = np.split(np.arange(rows), np.flatnonzero(np.diff(table.times)) + 1)
    for sequence, together in enumerate(places, start=1):
        switches: dict[Switch, int] = {}
        for k in together.tolist():
            contact = _contact(table, lines[k], names[k], contacts)
            switch = Switch(contact, _kind(table, lines[k], kinds[k]))
            if (other := switches.setdefault(switch, lines[k])) != lines[k]:
                table.wrong(
                    lines[k],
                    f"{switch.kind.name.lower()} of {contact!r} stands in line {other} already, at"
                    " the same time; remove one, or write times with more digits",
                )
        stamp = start + int(table.times[together[0]])
        events.append(ImpactEvent(stamp, tuple(switches), sequence, 0, epoch))
    return events


def _texts(table: Table, name: str) -> list[str]:
    """The texts in a column; empty without the column."""
    found = table.find(name)
    return [""] * len(table.times) if found is None else [*table.cells[found]]


def _contact(table: Table, line: int, cell: str, contacts: Sequence[str] | None) -> str:
    """The contact with a name; without a name the model's only one."""
    if not cell and contacts is not None and len(contacts) == 1:
        return contacts[0]
    if not cell:
        which = f"one of {', '.join(contacts)}" if contacts else "a column contact"
        remedy = "" if contacts else ", or a --model with one contact"
        table.wrong(line, f"names no contact; expected {which}{remedy}")
    if contacts is not None and cell not in contacts:
        expected = ", ".join(contacts) or "none"
        table.wrong(line, f"contact {shown(cell)} is none of the model's: {expected}")
    if contacts is None and is_number(cell, True):
        table.wrong(line, f"contact {shown(cell)}: a number found; expected a name")
    return cell


def _kind(table: Table, line: int, cell: str) -> Kind:
    """The kind of a switch; an impact if the cell is empty."""
    if cell.lower() not in _KINDS:
        names = ", ".join(kind.name.lower() for kind in Kind)
        table.wrong(line, f"kind {shown(cell)} found; expected one of {names}")
    return _KINDS[cell.lower()]


def _states(path: Path, form: TableForm, model: Model | None, start: int) -> _Stream:
    """The true states in a table."""
    if model is None:
        raise UsageError(f"{path}: true states without a model; name it with --model")
    names = model.subject.coordinates
    columns = [[f"q_{each}", each] for each in names] + [[f"u_{each}"] for each in names]
    expected = ", ".join(["time", *(each[0] for each in columns)])
    table = read_table(path, form, expected, strict=True)
    check_stamps(path, start + table.times, start)
    found = [[name for each in either if (name := table.find(each))] for either in columns]
    for present in found:
        if len(present) > 1:
            table.wrong(table.header, f"columns {' and '.join(present)} found; expected one")
    if missing := [each[0] for each, present in zip(columns, found, strict=True) if not present]:
        seen = ", ".join(table.cells)
        table.wrong(table.header or 1, f"columns {seen} found; {', '.join(missing)} missing")
    values = [_finite(table, present[0]) for present in found]
    make, n = bag_messages(), len(names)
    states = (
        JointState(stamp, names, frozen(x[:n]), frozen(x[n:]))
        for stamp, *x in zip((start + table.times).tolist(), *values, strict=True)
    )
    return ((s.stamp, interfaces.PLANT_JOINT_STATES.topic, make.joint_state(s)) for s in states)


def _finite(table: Table, name: str) -> Vector:
    """The numbers in a column; UsageError if a cell has no finite number."""
    values = table.numbers(name)
    for k in np.flatnonzero(np.isnan(values))[:1]:
        found = f"{name} is {shown(table.cells[name][k])}"
        table.wrong(int(table.lines[k]), f"{found}; expected a finite number")
    return values


def _signals(
    paths: Sequence[Path], form: TableForm, start: int, impacts: Table
) -> dict[str, Signal]:
    """Tables of samples by their topics.

    Raises:
        UsageError: two files have one topic, or a file has that of the package, or another clock
            than the impacts.
    """
    signals: dict[str, Signal] = {}
    first = int(impacts.times[0])
    for path in paths:
        topic = topic_of(path.stem)
        if interfaces.interface(topic) or topic in signals:
            raise UsageError(f"{path}: topic {topic} is taken already; rename the file")
        signals[topic] = signal = read_signal(path, form, start)
        time = int(signal.stamps[0]) - start
        if zero_of(time, None) != zero_of(first, None):
            raise UsageError(
                f"{path}: time {text(time)} s is of another clock than the first impact,"
                f" {text(first)} s: only one of them counts from 1970"
            )
    return signals


def _samples(topic: str, signal: Signal) -> _Stream:
    """The rows with a number; a joint without a number is not in the message of the row."""
    make, names = bag_messages(), [*signal.columns]
    rows = zip(*(values.tolist() for values in signal.columns.values()), strict=True)
    for stamp, row in zip(signal.stamps.tolist(), rows, strict=True):
        some = {name: value for name, value in zip(names, row, strict=True) if not isnan(value)}
        if some:
            yield stamp, topic, make.joints(stamp, [*some], position=[*some.values()])
