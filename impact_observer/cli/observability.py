# SPDX-License-Identifier: Apache-2.0
"""Which part of the state the impacts in a bag determine, before anyone trusts an estimate."""

import argparse
import json as json_module
from pathlib import Path

from impact_observer.cli.arguments import (
    add_force,
    add_measurements,
    add_model,
    add_namespace,
    positive,
)
from impact_observer.errors import BagError
from impact_observer.plain_text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag with impacts")
    add_model(parser)
    add_namespace(parser)
    add_measurements(parser)
    parser.add_argument(
        "--deviation",
        metavar="D",
        default="1",
        help="standard deviations of the initial state, SI units: one number, or q1,..,qn,u1,..,un"
        " (default 1)",
    )
    parser.add_argument(
        "--tolerance",
        metavar="R",
        type=positive,
        help="singular value that counts as zero, over the largest (default 1e-9: stamps of 1 ns)",
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="write singular values over time: PNG, SVG, PDF"
    )
    add_force(parser, "plot")
    parser.add_argument("--json", action="store_true", help="print the results as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return observe(
        args.bag,
        model=args.model,
        namespace=args.namespace,
        measurements=args.measurements,
        deviation=args.deviation,
        tolerance=args.tolerance,
        plot=args.plot,
        json=args.json,
    )


def observe(
    bag: Path,
    *,
    model: str | None = None,
    namespace: str = "",
    measurements: str | None = None,
    deviation: str = "1",
    tolerance: float | None = None,
    plot: Path | None = None,
    json: bool = False,
) -> int:
    """Print which part of the state the impacts in a bag determine.

    The arguments are the options.

    Returns:
        0, also where the rank is not full.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        BagError: the bag cannot be read, or contains no impact of the model's contacts.
        ImpactLawError: the impact law has no solution at an event.
    """
    from impact_observer.draw.pictures import save
    from impact_observer.draw.reports import print_table
    from impact_observer.filter.readings import sensors_of
    from impact_observer.filter.uncertainty import deviation_of
    from impact_observer.io.live_inputs import give_recorded
    from impact_observer.io.measured_samples import samples_in
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import events_in, model_of
    from impact_observer.model.measurements_file import read_measurements
    from impact_observer.observability.parameter_limit import parameter_limit
    from impact_observer.observability.rank import TOLERANCE, observability
    from impact_observer.observability.rank_picture import rank_picture
    from impact_observer.observability.rank_report import for_json, print_observability
    from impact_observer.options import Options
    from impact_observer.output_files import check_output

    if plot is not None:
        check_output(plot)
    with BagReader(bag, namespace) as reader:
        read = model_of(reader, model)
        system, events = read.system, events_in(reader)
        declared = read_measurements(measurements)
        sensors = sensors_of(declared, system)
        recorded = samples_in(reader, declared)
        for problem in () if json else filter(None, (read.misfit, *recorded.problems)):
            say(f"warning: {problem}")
        try:
            result = observability(
                system,
                events,
                deviation=deviation_of(deviation, system),
                tolerance=TOLERANCE if tolerance is None else tolerance,
                sensors=sensors,
                samples=recorded.samples,
            )
        except BagError as error:
            raise type(error)(f"{bag}: {error}") from None
        limit = parameter_limit(
            read,
            events,
            Options(initial_deviation=deviation),
            measurements=declared,
            samples=recorded.samples,
            give=lambda observer: give_recorded(reader, observer.live),
        )
    if json:
        own = {} if limit is None else {"deviations": limit.for_json}
        say(json_module.dumps({**for_json(result), **own}, indent=2, allow_nan=False))
    else:
        print_observability(result)
        if limit is not None:
            say("")
            print_table(limit.table(read))
    if plot is not None:
        title = f"{system.name}: what the impacts determine of the initial state"
        save(rank_picture(result, title=title), plot)
        if not json:
            say(f"picture: {plot}")
    return 0
