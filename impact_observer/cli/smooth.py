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

    from impact_observer.batch.smoothed_run import SmoothedRun
    from impact_observer.model import Model

LAW = "minimum-variance"
_OPTIONS = (
    "epoch",
    "initial_state",
    "initial_deviation",
    "clock_error",
    "clock_offset_error",
    "missed",
    "spurious",
    "mislabelled",
    "dead_time",
    "estimate_parameters",
)
"""Options of an observer that the best estimate of a recording takes, too."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="a bag with impacts")
    add_model(parser)
    add_observer_arguments(parser, _OPTIONS)
    add_measurements(parser)
    add_part(parser)
    add_estimates(parser)
    add_bag_output(parser)


def run(args: argparse.Namespace) -> int:
    """Smooth a bag, and write a bag with the estimates."""
    from impact_observer.batch.smooth_bag import smooth_bag
    from impact_observer.cli.progress import Progress
    from impact_observer.io.bag_part import read_impacts_part
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.measurements_file import read_measurements

    chosen = observer_options(args, LAW)
    with BagReader(args.bag) as reader, Progress() as progress:
        read = model_of(reader, args.model)
        sensors = read_measurements(args.measurements)
        part = (args.start, args.duration, chosen.epoch)
        read_impacts_part(reader, *part, sensors, tell=progress.line)
        if read.misfit:
            progress.line(f"warning: {read.misfit}")
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
            for line in _about_run(read, each):
                progress.line(line)
    return 0


def _about_run(read: "Model", run: "SmoothedRun") -> "Iterator[str]":
    """What was learned in a run of the sender, and what is in doubt."""
    from impact_observer.cli.observe import fitted_lines
    from impact_observer.draw.reports import figure
    from impact_observer.model.free_parameters import with_unit

    unit = run.run.system.unit
    yield from fitted_lines(read, (each.stamp for each in run.run.keys))
    for name, value, deviation in run.parameters:
        yield f"learned: {with_unit(name, unit)} {figure(value, deviation=deviation)}"
    for index, sensor in enumerate(run.fit.problem.samples):
        used = int((run.fit.samples.sensor == index).sum())
        yield f"{sensor.measurement.name}: {used} of {len(sensor.t)} samples used"
    if run.misfit:
        yield f"warning: the model does not explain the impacts: {run.misfit}"
