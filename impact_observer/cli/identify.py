# SPDX-License-Identifier: Apache-2.0
"""Identify parameters of a model from impact times and samples, or check a model against them."""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from impact_observer.cli.arguments import PART, add_shared, number
from impact_observer.errors import BagError, UsageError
from impact_observer.options import OBSERVER_OPTIONS, Options
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from impact_observer.batch.identification import Identification
    from impact_observer.events import ImpactEvent
    from impact_observer.io.bag_part import TimeZero
    from impact_observer.model import Model, System
    from impact_observer.model.measurement import Measurement
    from impact_observer.model.model_file import ModelText
    from impact_observer.model.parameter_uncertainty import ParameterUncertainty
    from impact_observer.observer.samples import SensorSample


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    epoch = "stamp of t = 0 of the forcing (default: as in the bag)"
    plot = "the errors of the stamps: PNG, SVG, PDF"
    add_shared(parser, "bag", "model", "measurements", *PART, "clock-error")
    add_shared(parser, "epoch", "plot", "json", epoch=epoch, plot=plot)
    add = parser.add_argument
    free = "what to identify, with commas, such as gap.stop, or gap for all of a kind"
    add("--free", metavar="LIST", default="", help=f"{free}; docs/fitting.md has all names")
    for name, metavar in (("dead_time", "S"), ("mislabelled", "P")):
        option = next(each for each in OBSERVER_OPTIONS if each.name == name)
        shown = f"{option.meaning} (default {option.default})"
        flag, default = option.long_flag, option.default
        add(flag, metavar=metavar, type=number, default=default, help=shown)
    add("--check", action="store_true", help="only check whether the model fits the times")
    model = "write the model with the identified values, as YAML"
    add("-o", "--output", metavar="FILE", type=Path, help=model)
    start = "write the identified initial state into the model too"
    add("--initial-state", action="store_true", help=start)
    parser.set_defaults(outputs=("output", "plot"))


def run(args: argparse.Namespace) -> int:
    """Fit a model to the impacts in a bag, and to samples if any, and print the result.

    Returns:
        0; 1 if a parameter is not determined or ends at its bound, no motion explains the impacts,
        or the model does not fit.
    """
    from impact_observer.batch.fit_report import fit_picture, refuse_scales_of_parts, why_useless
    from impact_observer.batch.identification import identify
    from impact_observer.cli.progress import Progress
    from impact_observer.draw.pictures import save
    from impact_observer.draw.reports import listed
    from impact_observer.model.free_parameters import parametric_family

    free = tuple(name.strip() for name in args.free.split(",") if name.strip())
    clock = None if args.clock_error < 0 else args.clock_error
    sensor = Options(dead_time=args.dead_time, mislabelled=args.mislabelled)
    _check_usage(args, free, clock)
    lines = sys.stderr if args.json else sys.stdout
    given = _read(args, partial(say, file=lines))
    # Live signals are known now, as samples.
    family = parametric_family(replace(given.system, live=None), free, given.model.elements)
    refuse_scales_of_parts(family.names, given.model.uncertainty)
    with Progress() as progress:
        try:
            fit = identify(
                family,
                given.events,
                clock=clock,
                progress=lambda what: progress.show(f"{family.system.name}: {what}"),
                measurements=given.measurements,
                samples=given.samples,
                dead_time=sensor.dead_time,
                mislabelled=sensor.mislabelled,
                prior=given.prior,
                sensors=given.model.sensors,
            )
        except BagError as error:
            raise type(error)(f"{args.bag}: {error}") from None
    _print(args, fit)
    if given.unused and not fit.fit.is_settled:
        joints = f"{args.bag} has joints on {listed(given.unused)}"
        say(f"note: {joints}: --measurements FILE uses encoders (docs/nodes.md)", file=lines)
    good = not why_useless(fit) and fit.verdict.fits
    if args.output is not None:
        good = _write(args, fit, given.text) and good
    if args.plot is not None:
        title = f"{fit.family.system.name}: instants of the model minus stamps"
        save(fit_picture(fit, title=title, zero=given.zero), args.plot)
        say(f"picture: {args.plot}", file=lines)
    return 0 if good else 1


class _Given(NamedTuple):
    """What the bag and the files say.

    Attributes:
        text: of the model.
        model: the model.
        system: its system, with the live signals that the bag has.
        events: of the bag, with their epoch, if any.
        measurements: what sensors measure beside the impacts.
        samples: of these sensors.
        zero: time zero of the fit.
        unused: topics of joint states, no estimates, that no measurement takes.
        prior: the deviations of the model, unless they were fitted to these impacts.
    """

    text: "ModelText"
    model: "Model"
    system: "System"
    events: "list[ImpactEvent]"
    measurements: "Sequence[Measurement]"
    samples: "Sequence[SensorSample]"
    zero: "TimeZero"
    unused: "Sequence[str]"
    prior: "ParameterUncertainty | None"


def _read(args: argparse.Namespace, tell: Callable[[str], object]) -> _Given:
    """Read bag and files; what is left out or doubtful is a line for ``tell``."""
    from impact_observer.io.bag_part import TimeZero, assumed_epoch, read_impacts_part
    from impact_observer.io.live_inputs import with_recorded
    from impact_observer.io.measured_samples import joint_topics, samples_in
    from impact_observer.io.observed_bag import events_from
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import epoch_of, text_of_model
    from impact_observer.model import parse_model
    from impact_observer.model.measurement import read_measurements

    with BagReader(args.bag) as reader:
        given = text_of_model(reader, args.model)
        model = parse_model(*given)
        declared = read_measurements(args.measurements)
        part = (args.start, args.duration, args.epoch)
        read_impacts_part(reader, *part, declared, tell=tell)
        events = events_from(reader, args.epoch)
        recorded = samples_in(reader, declared)
        assumed = assumed_epoch(model.system, events, recorded.samples, args.epoch)
        epoch = args.epoch or assumed.stamp
        events = [replace(each, epoch=each.epoch or epoch) for each in events]
        lost: list[str] = []
        system = with_recorded(reader, model.system, epoch_of(events), lost.append)
        if assumed.note:
            tell(f"note: {assumed.note}")
        for line in (*lost, *recorded.problems):
            tell(f"warning: {line}")
        unused = joint_topics(reader, declared)
        if model.misfit:
            tell(f"warning: {model.misfit}")
    zero, prior = TimeZero(epoch, assumed.instant), model.uncertainty
    if prior is not None and prior.is_fitted_to(each.stamp for each in events):
        prior = None
        tell("note: the model was fitted to these impacts: its deviations are no prior here")
    return _Given(given, model, system, events, declared, recorded.samples, zero, unused, prior)


def _print(args: argparse.Namespace, fit: "Identification") -> None:
    """Print a fit as JSON, as a check, or with a table of parameters."""
    from impact_observer.batch.fit_report import for_json, print_report

    if args.json:
        say(json.dumps(for_json(fit), indent=2, allow_nan=False))
    else:
        print_report(fit, is_check=args.check)


def _write(args: argparse.Namespace, fit: "Identification", given: "ModelText") -> bool:
    """Write the model, or say why not; returns whether all of it is written."""
    from impact_observer.batch.fit_report import why_useless, write_model

    if reason := why_useless(fit):
        words, is_whole = f"{args.output} is not written: {reason}", False
    else:
        left_out = write_model(fit, given, args.bag, args.output, initial=args.initial_state)
        doubt = "" if fit.verdict.fits else "though it does not fit"
        words = ", ".join(filter(None, [str(args.output), left_out, doubt]))
        is_whole = not left_out
    say(f"model: {words}", file=sys.stderr if args.json else sys.stdout)
    return is_whole


def _check_usage(args: argparse.Namespace, free: tuple[str, ...], clock: float | None) -> None:
    """Raise UsageError before the work is done."""
    if args.initial_state and args.output is None:
        raise UsageError("--initial-state: written into the model, so -o is needed")
    if args.check and (free or args.output):
        raise UsageError("--check identifies nothing; expected no --free and no -o beside it")
    if args.check and clock is None:
        raise UsageError("--check: no --clock-error; expected the deviation of a stamp, s")
    if not args.check and not free:
        raise UsageError("--free: names no parameter; expected some, such as restitution,gap")
    if args.plot is not None:
        from impact_observer.output_files import check_output

        check_output(args.plot)
