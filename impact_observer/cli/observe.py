# SPDX-License-Identifier: Apache-2.0
"""Run an observer on the impacts in a bag: the same observer that the node runs."""

import argparse
import gc
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    PART,
    add_observer_arguments,
    add_shared,
    observer_options,
)
from impact_observer.cli.progress import Progress
from impact_observer.draw.reports import TextTable, counted, figure, print_table

if TYPE_CHECKING:
    from impact_observer.events import Ruling
    from impact_observer.model import Model
    from impact_observer.observer import Observer

_COMPONENTS = 12
"""Most positions and velocities in the table of deviations."""
_DOUBTED, _FEW, _CONTRADICTED = 0.25, 5, 4.0
"""Share of the events, and least number of them, whose rejection makes the model doubtful."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add_shared(parser, "bag", "model")
    parser.add_argument(
        "--law", metavar="LAW", default="geometric", help="of the observer (default geometric)"
    )
    add_observer_arguments(parser)
    add_observer_arguments(parser, ("ensemble",))
    add_shared(parser, "measurements", *PART, "rate", "output")


def run(args: argparse.Namespace) -> int:
    """Run an observer on a bag, and write a bag with its estimates."""
    from impact_observer.io.bag_part import assumed_epoch, read_impacts_part
    from impact_observer.io.measured_samples import samples_in
    from impact_observer.io.observed_bag import events_from, observe_bag
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.measurement import read_measurements
    from impact_observer.observer import law_named, make_observer

    chosen = observer_options(args, args.law)
    with BagReader(args.bag) as reader, Progress() as progress:
        read = model_of(reader, args.model)
        sensors = read_measurements(args.measurements)
        part = (args.start, args.duration, chosen.epoch)
        read_impacts_part(reader, *part, sensors, tell=progress.line)
        measured = samples_in(reader, sensors)
        used = measured.samples if law_named(chosen.law).uses_measurements else ()
        events = events_from(reader, chosen.epoch)
        assumed = assumed_epoch(read.subject, events, used, chosen.epoch)
        chosen = replace(chosen, epoch=chosen.epoch or assumed.stamp)
        observer = make_observer(read, chosen, measurements=sensors)
        warnings = [*measured.problems]
        gc.freeze()  # what is loaded stays: no collection of garbage looks through it again
        count, rulings = observe_bag(
            reader,
            observer,
            args.output,
            rate=args.rate,
            epoch=chosen.epoch,
            measured=measured,
            progress=lambda done, total: progress.step(chosen.law, done, total),
            warn=warnings.append,
        )
        if assumed.note:
            progress.line(f"note: {assumed.note}")
        progress.line(
            f"{args.output}: {chosen.law}, {count} estimates, verdicts: {in_words(rulings)}"
        )
        tables = components(observer), parameters(read, observer), samples(observer)
        for table in (each for each in tables if each.rows):
            print_table(table)
        progress.warn([*warnings, *remarks(read, observer, rulings)])
    return 0


def in_words(rulings: "Mapping[Ruling, int]") -> str:
    """How many events have each verdict."""
    words = (f"{n} {ruling.name.lower().replace('_', ' ')}" for ruling, n in rulings.items())
    return ", ".join(words) or "none"


def components(observer: "Observer") -> TextTable:
    """The deviation of each component in the last flights."""
    rows = []
    if (found := observer.last_deviations()) is not None:
        system = observer.system
        each = zip(system.state_names, system.state_units, found.tolist(), strict=True)
        rows = [[name, figure(size, unit)] for name, unit, size in islice(each, _COMPONENTS)]
    return TextTable(("component", "deviation in the last flights"), rows, words=("component",))


def parameters(model: "Model", observer: "Observer") -> TextTable:
    """The parameters with a deviation, as declared and as learned with the state."""
    from impact_observer.model.free_parameters import with_unit

    unknowns, rows = observer.law.uncertainty.unknowns, dict[str, list[str]]()
    if unknowns is not None:
        family, sizes = unknowns.family, unknowns.deviations.tolist()
        units = {each.name: f" [{each.unit}]" for each in family.parameters if each.unit}
        for name, value, size in zip(family.names, family.nominal.tolist(), sizes, strict=True):
            declared = figure(value, deviation=size)
            rows[name] = [name + units.get(name, ""), declared, ""]
    latest = observer.estimate(observer.newest).parameters if observer.last_event else ()
    for name, value, size in latest:
        unit = model.system.unit if model.robot is None else ""
        row = rows.setdefault(name, [with_unit(name, unit), "", ""])
        row[2] = figure(value, deviation=size)
    return TextTable(("parameter", "declared", "learned"), [*rows.values()])


def samples(observer: "Observer") -> TextTable:
    """What became of the samples of each sensor."""
    kinds = ("samples", "accepted", "rejected", "unused", "invalid", "dropped")
    sensors = zip(observer.samples.sensors, observer.samples.counts, strict=True)
    rows = [[sensor.name, *(str(counts[kind]) for kind in kinds)] for sensor, counts in sensors]
    return TextTable(("sensor", *kinds), rows)


def remarks(
    model: "Model", observer: "Observer", rulings: "Mapping[Ruling, int]"
) -> Iterator[str]:
    """What makes the estimates doubtful, the worst first."""
    from impact_observer.events import Remark, Ruling
    from impact_observer.observer.misfit import MISFIT

    law, samples_of = observer.law, observer.samples
    if unexplained := observer.remarks[Remark.MISFIT]:
        latest = observer.estimate(observer.newest).misfit
        yield f"at {counted(unexplained, 'event')} {latest or MISFIT}"
    rejected = rulings.get(Ruling.REJECTED, 0)
    judged = rejected + rulings.get(Ruling.APPLIED, 0)
    if rejected >= _FEW and rejected > _DOUBTED * judged:
        yield f"{rejected} of {judged} impacts rejected: the model does not explain them"
    if observer.last_event:
        yield from contradictions_of(observer)
    yield from model.doubts
    yield from fitted_to(model, (observer.last_event,))
    if samples_of.sensors and not law.uses_measurements:
        names = ", ".join(each.name for each in samples_of.sensors)
        yield f"{law.name} uses no measurements: {names} left out; --law minimum-variance does"
    for sensor, counts in zip(samples_of.sensors, samples_of.counts, strict=True):
        doubt = sensor.measurement.doubt(counts["samples"], counts["rejected"])
        if doubt and observer.robot is None:
            yield doubt
    if model.robot is not None and law.has_covariance:
        yield from (text for _, text in model.robot.torque_remarks)
    if model.robot is None and observer.last_event and observer.epoch:
        seconds = (observer.last_event - observer.epoch) / 1e9
        yield from filter(None, [model.system.held_force(seconds)])


def fitted_to(model: "Model", stamps: Iterable[int]) -> Iterator[str]:
    """A remark if a model was fitted to the impacts at ``stamps``, ns."""
    if model.uncertainty is not None and model.uncertainty.is_fitted_to(stamps):
        yield "the model was fitted to these impacts: its errors and those of estimates are one"


def contradictions_of(observer: "Observer") -> Iterator[str]:
    """What was learned, and is far from what was declared."""
    own = observer.law.uncertainty
    declared = {"clock_offset": (0.0, own.clock_offset_error)}
    if (unknowns := own.unknowns) is not None:
        values = zip(unknowns.family.nominal.tolist(), unknowns.deviations.tolist(), strict=True)
        declared |= zip(unknowns.family.names, values, strict=True)
    for name, value, deviation in observer.estimate(observer.newest).parameters:
        nominal, error = declared.get(name, (value, 0.0))
        if abs(value - nominal) > _CONTRADICTED * error > 0:
            found, given = figure(value, deviation=deviation), figure(nominal, deviation=error)
            yield (
                f"learned {name} {found} contradicts the declared {given}: widen its deviation,"
                " or give --model-error (docs/troubles.md)"
            )
