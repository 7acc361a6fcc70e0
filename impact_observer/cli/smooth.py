# SPDX-License-Identifier: Apache-2.0
"""Estimate the states in a bag from all of its impacts, before and after each instant.

The observer of least variance decides what each event was; then the motion that explains all of
them best is found. The bag that is made carries everything of the first along, and topics of the
owner /smoother: state, joint_states, verdicts, impacts.
"""

import argparse
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    PART,
    add_observer_arguments,
    add_shared,
    observer_options,
)
from impact_observer.cli.progress import Progress
from impact_observer.draw.reports import TextTable, figure, print_table

if TYPE_CHECKING:
    from impact_observer.batch.smoothed_run import SmoothedRun

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
    add_shared(parser, "bag", "model")
    add_observer_arguments(parser, _OPTIONS)
    add_shared(parser, "measurements", *PART, "rate", "output")


def run(args: argparse.Namespace) -> int:
    """Smooth a bag, and write a bag with the estimates."""
    from impact_observer.batch.smooth_bag import smooth_bag
    from impact_observer.cli.observe import fitted_to, in_words
    from impact_observer.io.bag_part import read_impacts_part
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.measurement import read_measurements

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
        verdicts = in_words(smoothed.rulings)
        progress.line(f"{args.output}: {smoothed.estimates} estimates, verdicts: {verdicts}")
        warnings = [*smoothed.problems]
        for each in smoothed.runs:
            for table in (each for each in (_parameters(each), _samples(each)) if each.rows):
                print_table(table)
            if each.misfit:
                warnings.append(f"the model does not explain the impacts: {each.misfit}")
            warnings += fitted_to(read, (key.stamp for key in each.run.keys))
        progress.warn(warnings)
    return 0


def _parameters(run: "SmoothedRun") -> TextTable:
    """What was learned in a run of the sender."""
    from impact_observer.model.free_parameters import with_unit

    unit = run.run.system.unit
    rows = [[with_unit(n, unit), figure(v, deviation=size)] for n, v, size in run.parameters]
    return TextTable(("parameter", "learned"), rows)


def _samples(run: "SmoothedRun") -> TextTable:
    """How many samples of each sensor were used."""
    rows = [
        [
            sensor.measurement.name,
            str(len(sensor.t)),
            str(int((run.fit.samples.sensor == k).sum())),
        ]
        for k, sensor in enumerate(run.fit.problem.samples)
    ]
    return TextTable(("sensor", "samples", "used"), rows)
