# SPDX-License-Identifier: Apache-2.0
"""Impact times from a table, true states and samples of sensors from others: a bag."""

import heapq
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count, groupby, islice, pairwise
from math import gcd
from operator import itemgetter
from pathlib import Path

from impact_observer import __version__
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import interfaces
from impact_observer.io.csv_tables import (
    FORM,
    ImpactRow,
    ImpactTable,
    StateRow,
    StateTable,
)
from impact_observer.io.messages import AnyMessage, JointState, bag_messages
from impact_observer.io.recordings import all_or_nothing
from impact_observer.io.sample_tables import sample_tables
from impact_observer.io.table_file import later_zero, start_of
from impact_observer.io.table_layout import TableForm
from impact_observer.io.writer import FLUSH
from impact_observer.model import Model
from impact_observer.stamps import MAX_STAMP, text

_SAMPLES = 101
"""First rows that look like samples of a signal if they are equally spaced."""


@dataclass(frozen=True, slots=True)
class Imported:
    """The result of an import.

    Attributes:
        events: written.
        rows: rows of impacts read.
        states: true states written.
        start: stamp of the file's time zero, ns.
        epoch: stamp of ``t = 0`` that the events carry, ns; 0 for unknown.
        first: stamp of the first event, ns.
        last: stamp of the last event, ns.
        times: words for the form of the file's times, such as ``times in ms``.
        ignored: names of the columns of impacts that were not read.
        remarks: what was left out or is doubtful, a line each.
        samples: how many rows of samples are on each topic.
    """

    events: int
    rows: int
    states: int
    start: int
    epoch: int
    first: int
    last: int
    times: str
    ignored: tuple[str, ...]
    remarks: list[str]
    samples: Mapping[str, int]


def import_csv(
    path: Path,
    output: Path,
    *,
    model: Model | None = None,
    truth: Path | None = None,
    samples: Sequence[Path] = (),
    form: TableForm | None = None,
    start: int | None = None,
    epoch: int | None = None,
    flush: float = FLUSH,
    progress: Callable[[int], None] = lambda _: None,
    each: Callable[[ImpactEvent], None] = lambda _: None,
) -> Imported:
    """Write the impact times of a file to a bag, and true states of another one.

    Rows of equal time are one event. Memory is constant, unless the rows are to be sorted.

    Args:
        path: the CSV file of impact times.
        output: the bag to make.
        model: to put into the bag; only its contacts are allowed. None for none.
        truth: a CSV file of positions and velocities of the model's coordinates; None for none.
        samples: tables of sensors, each a topic named as the file (:class:`SampleTable`).
        form: of the files; column of time, separator and lines to skip are those of ``path``.
        start: stamp of the files' time zero, ns. None for 0 where the first impact lies after
            1973, as times since 1970 do, and for 1 s elsewhere.
        epoch: stamp of ``t = 0`` of the forcing, ns; None for the files' time zero.
        flush: longest time until a message is on the disk, s.
        progress: called with the number of rows read.
        each: called with each event.

    Raises:
        UsageError: a file has a mistake, something is at ``output`` already, or there is truth
            without a model.
        BagError: the bag cannot be written.
    """
    form = form or TableForm()
    table = ImpactTable(path, form, None if model is None else model.subject.contact_names)
    numbers = count(1)

    def read() -> None:
        progress(next(numbers))

    rows = table.rows(read)
    first = next(rows, None)
    if first is None:
        raise UsageError(f"{path}: holds no impact; expected rows {FORM} below the header")
    start = start_of(first.time, start)
    zero, last, make = start if epoch is None else epoch, 0, bag_messages()
    rows = _impacts(path, table, chain([first], rows))
    streams = [_events(path, rows, start, zero, each)]
    others = replace(form, skip_rows=0, separator=None)
    if truth is not None:
        streams.append(_states(truth, others, model, start, read))
    sensors = sample_tables(samples, replace(others, time_column=None))
    streams += [sensor.messages(start, first.time, read) for sensor in sensors]
    if form.frame_rate and not (table.is_grid or any(sensor.is_grid for sensor in sensors)):
        raise UsageError(f"{path}: has a column of time; leave out --frame-rate, or the column")
    counts = Counter[str]()
    with all_or_nothing(output, flush) as writer:
        if model is not None:
            text_of_model = model.text({"package": "impact_observer", "version": __version__})
            log_time = max(start + first.time, 1)
            writer.write(interfaces.PLANT_MODEL.topic, log_time, make.model(text_of_model))
        writer.declare(interfaces.IMPACTS.topic)
        for sensor in sensors:
            writer.declare(sensor.topic, type_name=interfaces.JOINT_STATE)
        # At equal stamps the event is first: the state there is the one after it.
        for stamp, topic, message in heapq.merge(*streams, key=itemgetter(0)):
            writer.write(topic, stamp, message)
            counts[topic] += 1
            if topic == interfaces.IMPACTS.topic:
                counts["rows"] += len(message.switches)
                last = stamp
        remarks = table.remarks()
        for sensor in sensors:
            remarks += sensor.remarks()
    return Imported(
        events=counts[interfaces.IMPACTS.topic],
        rows=counts["rows"],
        states=counts[interfaces.PLANT_JOINT_STATES.topic],
        start=start,
        epoch=zero,
        first=start + first.time,
        last=last,
        times=table.times,
        ignored=table.ignored,
        remarks=remarks,
        samples={sensor.topic: counts[sensor.topic] for sensor in sensors},
    )


def _impacts(path: Path, table: ImpactTable, rows: Iterable[ImpactRow]) -> Iterator[ImpactRow]:
    """The rows, unless the first ones look like samples of a signal.

    Raises:
        UsageError: equal spacing up to rounding, a column of numbers and none of contacts.
    """
    rows = iter(rows)
    first = [*islice(rows, _SAMPLES)]
    if len(first) == _SAMPLES and (signal := table.signal):
        steps = [b.time - a.time for a, b in pairwise(first)]
        unequal, rounded = max(steps) - min(steps), gcd(*(row.time for row in first))
        if unequal <= rounded and unequal < max(steps):
            raise UsageError(
                f"{path}: looks like a signal, not like impact times: its rows are equally spaced,"
                f" and column {signal} is left out; `detect {path} --contact NAME --threshold X`"
                " finds the impacts of a signal (docs/detector.md). If these are impacts, remove"
                f" the column {signal}"
            )
    yield from first
    yield from rows


def _events(
    path: Path,
    rows: Iterable[ImpactRow],
    start: int,
    epoch: int,
    each: Callable[[ImpactEvent], None],
) -> Iterator[tuple[int, str, AnyMessage]]:
    """Stamps (ns), topic and messages of the events, which ``each`` is called with."""
    make = bag_messages()
    groups = groupby(rows, lambda row: row.time)
    for sequence, (_, group) in enumerate(groups, start=1):
        together = list(group)
        stamp = _stamp(path, together[0], start, epoch)
        event = ImpactEvent(stamp, _switches(path, together), sequence, 0, epoch)
        each(event)
        yield stamp, interfaces.IMPACTS.topic, make.event(event)


def _states(
    path: Path, form: TableForm, model: Model | None, start: int, read: Callable[[], object]
) -> Iterator[tuple[int, str, AnyMessage]]:
    """Stamps (ns), topic and messages of the true states."""
    if model is None:
        raise UsageError(f"{path}: true states without a model; name it with --model")
    make, names = bag_messages(), model.subject.coordinates
    for row in StateTable(path, form, names).rows(read):
        state = JointState(_stamp(path, row, start, 0), names, row.q, row.u)
        yield state.stamp, interfaces.PLANT_JOINT_STATES.topic, make.joint_state(state)


def _stamp(path: Path, row: ImpactRow | StateRow, start: int, epoch: int) -> int:
    """The stamp of a row, ns."""
    stamp = start + row.time
    if not max(epoch, 1) <= stamp <= MAX_STAMP:
        least = f"{text(epoch)} s, the epoch, or more" if epoch > 0 else "more than 0"
        raise UsageError(
            f"{path}, line {row.line}: the stamp would be {text(stamp)} s; expected {least}, at"
            f" most {text(MAX_STAMP)} s: choose {later_zero(row.time)}, the stamp of time 0, or"
            " --epoch"
        )
    return stamp


def _switches(path: Path, rows: Sequence[ImpactRow]) -> tuple[Switch, ...]:
    """The switches of one event, checked to be different."""
    rows_by_switch: dict[Switch, ImpactRow] = {}
    for row in rows:
        if (other := rows_by_switch.setdefault(row.switch, row)) is not row:
            kind = row.switch.kind.name.lower()
            raise UsageError(
                f"{path}, line {row.line}: {kind} of {row.switch.contact!r} stands in line"
                f" {other.line} already, at the same time; remove one, or write times with more"
                " digits"
            )
    return tuple(rows_by_switch)
