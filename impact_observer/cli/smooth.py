# SPDX-License-Identifier: Apache-2.0
"""Estimate the states in a bag from all of its impacts, before and after each instant.

The observer of least variance decides what each event was; then the motion that explains all of
them best is found. The bag that is made carries everything of the first along, and topics of the
owner /smoother: state, joint_states, verdicts, impacts.
"""

import argparse
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
    from collections.abc import Iterator

    from impact_observer.model import Model
    from impact_observer.observer.laws.law import Law
    from impact_observer.smooth.smoothed_motion import SmoothedMotion

LAW = "minimum-variance"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="a bag with impacts")
    add_model(parser)
    add_observer_arguments(parser)
    add_measurements(parser)
    add_part(parser)
    add_estimates(parser)
    add_bag_output(parser)


def run(args: argparse.Namespace) -> int:
    """Smooth a bag, and write a bag with the estimates."""
    from impact_observer.cli.observe import considered_lines, torque_lines
    from impact_observer.cli.progress import Progress
    from impact_observer.io.bag_part import read_impacts_part
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.measurements_file import read_measurements
    from impact_observer.observer import make_observer
    from impact_observer.smooth.bag_smoothing import smooth_bag

    chosen = observer_options(args, LAW)
    with BagReader(args.bag) as reader, Progress() as progress:
        read = model_of(reader, args.model)
        sensors = read_measurements(args.measurements)
        part = (args.start, args.duration, chosen.epoch)
        read_impacts_part(reader, *part, sensors, tell=progress.line)
        law = make_observer(read, chosen, measurements=sensors).law
        for line in (*considered_lines(read, law.uncertainty.unknowns), *torque_lines(read)):
            progress.line(line)
        smoothed = smooth_bag(
            reader,
            read,
            chosen,
            args.output,
            measurements=sensors,
            rate=args.rate,
            progress=progress.step,
            tell=lambda line: progress.line(f"note: {line}"),
        )
        verdicts = ", ".join(
            f"{n} {ruling.name.lower().replace('_', ' ')}"
            for ruling, n in smoothed.rulings.items()
        )
        progress.line(f"{args.output}: {smoothed.estimates} estimates, verdicts: {verdicts}")
        for line in smoothed.problems:
            progress.line(f"warning: {line}")
        for each in smoothed.runs:
            for line in _about_run(read, law, each):
                progress.line(line)
    return 0


def _about_run(model: "Model", law: "Law", run: "SmoothedMotion") -> "Iterator[str]":
    """What was learned in a run of the sender, what became of samples, and what is in doubt."""
    from impact_observer.cli.observe import contradiction_lines, fitted_lines
    from impact_observer.draw.reports import figure
    from impact_observer.model.free_parameters import with_unit

    unit = law.system.unit
    yield from fitted_lines(model, (each.change.stamp for each in run.account.moments))
    for name, value, deviation in () if run.fallback else run.parameters:
        yield f"learned: {with_unit(name, unit)} {figure(value, deviation=deviation)}"
    if not run.smoothed.is_settled:
        yield (
            "warning: the last linearisation still changed the motion by"
            f" {run.smoothed.change:.2g} standard deviations{_remedy(law)}"
        )
    for name, value, deviation in run.filtered_parameters:
        learned = f"{with_unit(name, unit)} {figure(value, deviation=deviation)}"
        yield f"learned by the filter: {learned}"
    for sensor in run.sensors:
        yield sensor.text
    yield from contradiction_lines(run.contradictions, unit)
    doubts = (sensor.doubt for sensor in run.sensors)
    far = run.misfit if run.is_unexplained else ""
    for line in filter(None, (*doubts, run.fallback, far, run.model_doubt, run.early_doubt[0])):
        yield f"warning: {line}"


def _remedy(law: "Law") -> str:
    """What to do about parameters that are so uncertain that the motion does not settle."""
    unknowns = law.uncertainty.unknowns
    if unknowns is None:
        is_forced = law.system.own_forcing.frequency.size > 0
        return "; if a phase is unknown, identify --free forcing-phase" if is_forced else ""
    names = ",".join(unknowns.family.names)
    learned = f"--estimate-parameters {names} or " if any(unknowns.considered) else ""
    return f"; find the uncertain parameters by {learned}identify --free {names}"
