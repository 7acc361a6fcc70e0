# SPDX-License-Identifier: Apache-2.0
"""Run an observer on the impacts in a bag: the same observer that the node runs."""

import argparse
import gc
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    add_bag_output,
    add_estimates,
    add_measurements,
    add_model,
    add_observer_arguments,
    add_part,
    observer_options,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from impact_observer.filter.contradiction import Contradiction
    from impact_observer.filter.unknown_parameters import UnknownParameters
    from impact_observer.model import Model
    from impact_observer.observer import Observer

_COMPONENTS = 12
"""Most positions and velocities whose deviations are printed."""
_SOURCES, _SMALL_SHARE = 3, 0.05
"""Most sources of a deviation that are printed, and the least share of its variance."""
_DOUBTED, _FEW = 0.25, 5
"""Share of the events, and least number of them, whose rejection makes the model doubtful."""
_SURE = 10.0
"""Deviations beyond which an offset of the clock that nobody has declared is named."""
_UNDETERMINED = 0.9
"""Least ratio of posterior to prior standard deviation of a parameter that is not determined."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="a bag with impacts")
    add_model(parser)
    add("--law", metavar="LAW", default="geometric", help="of the observer (default geometric)")
    add_observer_arguments(parser)
    add_observer_arguments(parser, ("ensemble",))
    add_measurements(parser)
    add_part(parser)
    add_estimates(parser)
    add_bag_output(parser)


def run(args: argparse.Namespace) -> int:
    """Run an observer on a bag, and write a bag with its estimates."""
    from impact_observer.cli.progress import Progress
    from impact_observer.draw.reports import counted
    from impact_observer.events import Remark, Ruling
    from impact_observer.filter.misfit import MISFIT
    from impact_observer.io.bag_part import assumed_epoch, read_impacts_part
    from impact_observer.io.measured_samples import MeasuredTopics
    from impact_observer.io.observed_bag import events_from, observe_bag
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.measurements_file import read_measurements
    from impact_observer.observer import law_named, make_observer

    chosen = observer_options(args, args.law)
    with BagReader(args.bag) as reader, Progress() as progress:
        read = model_of(reader, args.model)
        sensors = read_measurements(args.measurements)
        part = (args.start, args.duration, chosen.epoch)
        read_impacts_part(reader, *part, sensors, tell=progress.line)
        measured = MeasuredTopics.read(reader, sensors)
        used = measured.samples if law_named(chosen.law).uses_measurements else ()
        events = events_from(reader, chosen.epoch)
        assumed = assumed_epoch(read.subject, events, used, chosen.epoch)
        chosen = replace(chosen, epoch=chosen.epoch or assumed.stamp)
        observer = make_observer(read, chosen, measurements=sensors)
        for line in (*measured.problems, *unused_lines(observer)):
            progress.line(f"warning: {line}")
        noted = [f"note: {assumed.note}"] * bool(assumed.note)
        torques = torque_lines(read) if observer.law.has_covariance else ()
        considered = considered_lines(read, observer.law.uncertainty.unknowns)
        for line in (*noted, *considered, *torques):
            progress.line(line)

        def show(done: int, total: int) -> None:
            progress.step(chosen.law, done, total)

        gc.freeze()  # what is loaded stays: no collection of garbage looks through it again
        count, rulings = observe_bag(
            reader,
            observer,
            args.output,
            rate=args.rate,
            epoch=chosen.epoch,
            measured=measured,
            progress=show,
            warn=lambda line: progress.line(f"warning: {line}"),
        )
        verdicts = [
            f"{n} {ruling.name.lower().replace('_', ' ')}" for ruling, n in rulings.items()
        ]
        decided = f"verdicts: {', '.join(verdicts) or 'none'}"
        if inserted := rulings.get(Ruling.INSERTED, 0):
            predicted = rulings.get(Ruling.APPLIED, 0) + inserted
            share = (predicted - inserted) / predicted
            decided += f"; {share:.0%} of {predicted} predicted impacts were reported"
        progress.line(f"{args.output}: {chosen.law}, {count} estimates, {decided}")
        rejected = rulings.get(Ruling.REJECTED, 0)
        judged = rejected + rulings.get(Ruling.APPLIED, 0)
        if rejected >= _FEW and rejected > _DOUBTED * judged:
            progress.line(
                f"warning: {rejected} of {judged} impacts rejected: the model does not explain"
                " them"
            )
        for line in closing_lines(read, observer):
            progress.line(line)
        if unexplained := observer.remarks[Remark.MISFIT]:
            latest = observer.estimate(observer.last_event).misfit
            many = counted(unexplained, "event")
            progress.line(f"warning: at {many} {latest or MISFIT}")
    return 0


def closing_lines(model: "Model", observer: "Observer") -> "Iterator[str]":
    """What is said of the estimate, of what was learned, and of data used twice."""
    from impact_observer.filter.contradiction import contradictions
    from impact_observer.stamps import seconds_between

    yield from source_lines(observer)
    yield from parameter_lines(observer)
    if observer.last_event:
        declared = observer.law.uncertainty.declared_constants
        learned = observer.estimate(observer.last_event).parameters
        yield from contradiction_lines(contradictions(learned, declared), observer.system.unit)
        yield from late_lines(observer)
    yield from sample_lines(observer)
    yield from fitted_lines(model, (observer.last_event,))
    if model.robot is None and observer.last_event and observer.epoch:
        seconds = seconds_between(observer.epoch, observer.last_event)
        if warning := model.system.held_force(seconds):
            yield f"warning: {warning}"


def source_lines(observer: "Observer") -> "Iterator[str]":
    """The deviation of each component in the last flights, and its largest sources."""
    from impact_observer.draw.reports import figure, listed

    if (found := observer.deviation_sources()) is None:
        return
    system = observer.system
    names = zip(system.state_names, system.state_units, strict=True)
    for i, (name, unit) in enumerate(islice(names, _COMPONENTS)):
        shares = sorted(((share[i], of) for of, share in found.shares.items()), reverse=True)
        largest = [f"{share:.0%} {of}" for share, of in shares[:_SOURCES] if share > _SMALL_SHARE]
        deviation = figure(float(found.deviations[i]), unit)
        yield f"deviation of {name}: {deviation} in the last flights, from {listed(largest)}"
    if (more := 2 * system.n - _COMPONENTS) > 0:
        yield f"and {more} more deviations"


def unused_lines(observer: "Observer") -> "Iterator[str]":
    """A line if measurements are given that the law does not use."""
    law = observer.law
    if observer.samples.sensors and not law.uses_measurements:
        names = ", ".join(each.name for each in observer.samples.sensors)
        yield f"{law.name} uses no measurements: {names} left out; --law minimum-variance does"


def _names_with_units(model: "Model", unknowns: "UnknownParameters") -> list[str]:
    """The names of parameters, each with its unit."""
    from impact_observer.model.free_parameters import with_unit

    if model.robot is None:
        return [with_unit(name, model.system.unit) for name in unknowns.family.names]
    parameters = unknowns.family.parameters
    return [f"{each.name} [{each.unit}]" if each.unit else each.name for each in parameters]


def considered_lines(model: "Model", unknowns: "UnknownParameters | None") -> "Iterator[str]":
    """The parameters of a model whose deviations count, and what these do not contain."""
    from impact_observer.draw.reports import figure

    if unknowns is not None and any(unknowns.considered):
        each = zip(
            _names_with_units(model, unknowns),
            unknowns.considered,
            unknowns.family.nominal.tolist(),
            unknowns.deviations.tolist(),
            strict=True,
        )
        texts = [
            f"{name} {figure(value, deviation=deviation)}"
            for name, considered, value, deviation in each
            if considered
        ]
        yield f"considered: {', '.join(texts)}"
    yield from (f"warning: {doubt}" for doubt in model.doubts)


def torque_lines(model: "Model") -> "Iterator[str]":
    """Lines on the torques of a robot that an observer does not know, or not from the model."""
    if (robot := model.robot) is not None:
        yield from (f"{kind}: {text}" for kind, text in robot.torque_remarks)


def fitted_lines(model: "Model", stamps: "Iterable[int]") -> "Iterator[str]":
    """A line if a model was fitted to the impacts at ``stamps``, ns."""
    if model.uncertainty is not None and model.uncertainty.is_fitted_to(stamps):
        yield (
            "note: the model was fitted to these impacts: its errors and those of the estimates"
            " come from the same stamps"
        )


def sample_lines(observer: "Observer") -> "Iterator[str]":
    """Counts of accepted and other samples of each sensor."""
    from impact_observer.observer.samples import MOST_KEPT
    from impact_observer.plain_text import part_left_out

    for sensor, counts in zip(observer.samples.sensors, observer.samples.counts, strict=True):
        kinds = ("accepted", "rejected", "unused", "invalid", "dropped")
        used = ", ".join(f"{counts[kind]} {kind}" for kind in kinds if counts[kind])
        if dropped := counts["dropped"]:
            why = f"more than {MOST_KEPT} waited to be used"
            part = part_left_out(dropped, counts["samples"], "samples", why)
            yield f"warning: {sensor.name}: {part}"
        yield f"{sensor.name}: {counts['samples']} samples: {used or 'none used yet'}"
        doubt = sensor.measurement.doubt(counts["samples"], counts["rejected"])
        if doubt and observer.robot is None:
            yield f"warning: {doubt}"


def parameter_lines(observer: "Observer") -> "Iterator[str]":
    """Parameters that an observer has estimated with the state, after the last event."""
    from impact_observer.draw.reports import figure
    from impact_observer.model.free_parameters import with_unit

    if not observer.last_event:
        return
    unknowns = observer.law.uncertainty.unknowns
    names, priors = ((), ()) if unknowns is None else (unknowns.family.names, unknowns.deviations)
    prior = dict(zip(names, priors, strict=True))
    for name, value, deviation in observer.estimate(observer.last_event).parameters:
        is_learned = deviation < _UNDETERMINED * prior.get(name, float("inf"))
        words = "learned" if is_learned else "not determined by these impacts"
        known = figure(value, deviation=deviation)
        yield f"{words}: {with_unit(name, observer.system.unit)} {known}"


def late_lines(observer: "Observer") -> "Iterator[str]":
    """A line if stamps are late, or early, by what nobody has declared."""
    if observer.law.uncertainty.clock_offset_error:
        return
    for name, value, deviation in observer.estimate(observer.last_event).parameters:
        if name == "clock_offset" and abs(value) > _SURE * deviation:
            side = "late" if value > 0 else "early"
            yield (
                f"warning: stamps are {abs(value):.3g} s {side}, and no --clock-offset-error is"
                " declared"
            )


def contradiction_lines(found: "Sequence[Contradiction]", unit: str) -> "Iterator[str]":
    """A line that names the learned values that contradict the declared ones."""
    from impact_observer.draw.reports import figure
    from impact_observer.model.free_parameters import with_unit

    if not found:
        return
    texts = []
    for each in found:
        own, learned = each.declared, figure(each.value, deviation=each.deviation)
        given = figure(own.value, deviation=own.deviation)
        bounds = ", outside its bounds" if each.is_outside else ""
        texts.append(
            f"{with_unit(own.name, unit)} {learned}, declared {given} ({each.far:.1f}"
            f" deviations{bounds})"
        )
    yield (
        f"warning: learned values contradict the declared ones: {'; '.join(texts)}: as"
        " declared the model does not explain the impacts: declare wider deviations, or"
        " --model-error where a restitution scatters from hit to hit; see docs/troubles.md"
    )
