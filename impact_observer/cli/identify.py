# SPDX-License-Identifier: Apache-2.0
"""Identify parameters of a model from impact times and samples, or check a model against them."""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    PART,
    add_observer_arguments,
    add_shared,
    observer_options,
)
from impact_observer.cli.progress import Progress
from impact_observer.draw.reports import listed
from impact_observer.errors import BagError, UsageError
from impact_observer.output_files import PICTURES
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from impact_observer.batch.identification import Identification
    from impact_observer.io.bag_part import TimeZero
    from impact_observer.model.model_file import ModelText


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    epoch = "stamp of t = 0 of the forcing (default: as in the bag)"
    plot = "the errors of the stamps: PNG, SVG, PDF"
    add_shared(parser, "bag", "model", "measurements", *PART, "clock-error")
    add_shared(parser, "epoch", "plot", "json", epoch=epoch, plot=plot)
    add = parser.add_argument
    free = "what to identify, with commas, such as gap.stop, or gap for all of a kind"
    add("--free", metavar="LIST", default="", help=f"{free}; docs/fitting.md has all names")
    add_observer_arguments(parser, ("dead_time", "mislabelled"))
    add("--check", action="store_true", help="only check whether the model fits the times")
    model = "write the model with the identified values, as YAML"
    add("-o", "--output", metavar="FILE", type=Path, help=model)
    start = "write the identified initial state into the model too"
    add("--write-start", action="store_true", help=start)
    parser.set_defaults(outputs={"output": (), "plot": PICTURES})


def run(args: argparse.Namespace) -> int:
    """Fit a model to the impacts in a bag, and to samples if any, and print the result.

    Returns:
        0; 1 if a parameter is not determined or ends at its bound, no motion explains the impacts,
        or the model does not fit.
    """
    from impact_observer.batch.fit_report import fit_picture, for_json, print_report, why_useless
    from impact_observer.draw.pictures import save

    free = tuple(name.strip() for name in args.free.split(",") if name.strip())
    _check_usage(args, free)
    tell = partial(say, file=sys.stderr if args.json else sys.stdout)
    fit, text, zero = _identified(args, free, tell)
    if args.json:
        say(json.dumps(for_json(fit), indent=2, allow_nan=False))
    else:
        print_report(fit, is_check=args.check)
    good = not why_useless(fit) and fit.verdict.fits
    if args.output is not None:
        words, is_whole = _written(args, fit, text)
        tell(f"model: {words}")
        good = good and is_whole
    if args.plot is not None:
        title = f"{fit.family.system.name}: instants of the model minus stamps"
        save(fit_picture(fit, title=title, zero=zero), args.plot)
        tell(f"picture: {args.plot}")
    return 0 if good else 1


def _identified(
    args: argparse.Namespace, free: tuple[str, ...], tell: Callable[[str], object]
) -> "tuple[Identification, ModelText, TimeZero]":
    """The fit to a bag, its model's text and its time zero; doubts are lines for ``tell``."""
    from impact_observer.batch.fit_report import refuse_scales_of_parts
    from impact_observer.batch.identification import identify
    from impact_observer.io.bag_part import TimeZero, assumed_epoch, read_impacts_part
    from impact_observer.io.live_inputs import with_recorded
    from impact_observer.io.measured_samples import joint_topics, samples_in
    from impact_observer.io.observed_bag import events_from
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import epoch_of, model_of, text_of_model
    from impact_observer.model.free_parameters import parametric_family
    from impact_observer.model.measurement import read_measurements

    given = argparse.Namespace(dead_time=args.dead_time, mislabelled=args.mislabelled)
    sensor = observer_options(given, "")
    with BagReader(args.bag) as reader, Progress() as progress:
        text = text_of_model(reader, args.model)
        model, declared = model_of(reader, args.model), read_measurements(args.measurements)
        read_impacts_part(reader, args.start, args.duration, args.epoch, declared, tell=tell)
        events = events_from(reader, args.epoch)
        recorded = samples_in(reader, declared)
        assumed = assumed_epoch(model.system, events, recorded.samples, args.epoch)
        epoch = args.epoch or assumed.stamp
        events = [replace(each, epoch=each.epoch or epoch) for each in events]
        doubts: list[str] = []
        system = with_recorded(reader, model.system, epoch_of(events), doubts.append)
        if assumed.note:
            tell(f"note: {assumed.note}")
        for line in filter(None, (*doubts, *recorded.problems, model.misfit)):
            tell(f"warning: {line}")
        prior = model.uncertainty
        if prior is not None and prior.is_fitted_to(each.stamp for each in events):
            prior = None
            tell("note: the model was fitted to these impacts: its deviations are no prior here")
        # Live signals are known now, as samples.
        family = parametric_family(replace(system, live=None), free, model.elements)
        refuse_scales_of_parts(family.names, model.uncertainty)
        try:
            fit = identify(
                family,
                events,
                clock=None if args.clock_error < 0 else args.clock_error,
                progress=lambda what: progress.show(f"{family.system.name}: {what}"),
                measurements=declared,
                samples=recorded.samples,
                dead_time=sensor.dead_time,
                mislabelled=sensor.mislabelled,
                prior=prior,
                sensors=model.sensors,
            )
        except BagError as error:
            raise type(error)(f"{args.bag}: {error}") from None
        if not fit.fit.is_settled and (unused := joint_topics(reader, declared)):
            joints = f"{args.bag} has joints on {listed(unused)}"
            tell(f"note: {joints}: --measurements FILE uses encoders (docs/nodes.md)")
    return fit, text, TimeZero(epoch, assumed.instant)


def _written(
    args: argparse.Namespace, fit: "Identification", given: "ModelText"
) -> tuple[str, bool]:
    """Write the model; the file with what is wrong with it, and whether all of it is written."""
    from impact_observer.batch.fit_report import why_useless, write_model

    if reason := why_useless(fit):
        return f"{args.output} is not written: {reason}", False
    left_out = write_model(fit, given, args.bag, args.output, initial=args.write_start)
    doubt = "" if fit.verdict.fits else "though it does not fit"
    return ", ".join(filter(None, [str(args.output), left_out, doubt])), not left_out


def _check_usage(args: argparse.Namespace, free: tuple[str, ...]) -> None:
    """Raise UsageError before the work is done."""
    if args.write_start and args.output is None:
        raise UsageError("--write-start: written into the model, so -o is needed")
    if args.check and (free or args.output):
        raise UsageError("--check identifies nothing; expected no --free and no -o beside it")
    if args.check and args.clock_error < 0:
        raise UsageError("--check: no --clock-error; expected the deviation of a stamp, s")
    if not args.check and not free:
        raise UsageError("--free: names no parameter; expected some, such as restitution,gap")
