# SPDX-License-Identifier: Apache-2.0
"""Simulate a model, observe with several laws, and draw V over time.

With the default laws the picture is made after Figure 2 of Baumann and Leine (ENOC 2014):
kinematic grey, geometric black. With --laws all the picture has a curve for each installed law.
"""

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_force, installed_laws, positive
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from impact_observer.cli.progress import Progress
    from impact_observer.compare.comparison import Comparison
    from impact_observer.model import Model
    from impact_observer.observer import Observer
    from impact_observer.plant import Run

LAWS = "kinematic,geometric"
INITIAL = "random:1"
EPOCH = 1_000_000_000
"""Stamp of ``t = 0``, ns."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("model", metavar="MODEL", help="a model file, or a sample: two_mass, ...")
    output = "the picture: a PNG, SVG or PDF"
    add("-o", "--output", metavar="FILE", type=Path, required=True, help=output)
    add_force(parser, "output")
    laws = f"laws of the observers, one curve each, or all (default {LAWS})"
    add("--laws", metavar="LAW,...", default=LAWS, help=laws)
    initial = (
        f"of the observers: q1,..,qn,u1,..,un, random:SEED, drawn:SEED or zero (default {INITIAL})"
    )
    add("--initial", metavar="STATE", default=INITIAL, help=initial)
    duration = "length of the simulation, s (default 30)"
    add("--duration", metavar="S", type=positive, default=30.0, help=duration)
    rate = "rate of the samples, Hz (default 100)"
    add("--rate", metavar="HZ", type=positive, default=100.0, help=rate)
    paper = "make a picture for a printed column: 88 mm wide, without a title"
    add("--paper", action="store_true", help=paper)
    add("--json", action="store_true", help="print the metrics as JSON")


def run(args: argparse.Namespace) -> int:
    """Simulate, observe, compare and draw."""
    from impact_observer.cli.progress import Progress
    from impact_observer.compare.comparison import impacts_in
    from impact_observer.compare.distance_picture import lyapunov_picture
    from impact_observer.compare.error_tables import distance_remarks, table_of_laws
    from impact_observer.compare.metrics import DISTANCE, metrics_of
    from impact_observer.draw.pictures import save
    from impact_observer.draw.reports import print_facts, print_table
    from impact_observer.io.bag_part import TimeZero
    from impact_observer.model import read_model
    from impact_observer.observer import Options, make_observer
    from impact_observer.output_files import check_output

    check_output(args.output)
    read = read_model(args.model)
    # The ensemble is left out: no estimate depends on the ensemble.
    observers = [
        make_observer(
            read.system, Options(law, args.initial, clock_error=0.0, ensemble=1, epoch=EPOCH)
        )
        for law in installed_laws(args.laws)
    ]
    with Progress() as progress:
        done = _simulated(read, args.duration, args.rate, progress)
        comparisons = _observed(observers, done, progress)
        progress.show(f"drawing {args.output}")
        about = (
            f"{read.system.name}: distance of the estimates from the truth, observers started at"
            f" {args.initial}\nour model and numbers, by impact_observer; after Figure 2 of"
            " Baumann and Leine, ENOC 2014"
        )
        impacts = impacts_in(done.events)
        zero = TimeZero(EPOCH)
        drawn = lyapunov_picture(comparisons, impacts, title=about, zero=zero, paper=args.paper)
        save(drawn, args.output, about=about.replace("\n", "; "))
    if args.json:
        metrics = {law: metrics_of(each) for law, each in comparisons.items()}
        say(json.dumps(metrics, indent=2))
        return 0
    print_table(table_of_laws(DISTANCE, comparisons))
    print_facts(distance_remarks(comparisons))
    say(f"picture: {args.output}")
    return 0


def _simulated(model: "Model", duration: float, rate: float, progress: "Progress") -> "Run":
    """The plant's run, with a progress bar."""
    from impact_observer.plant import Plant, simulate
    from impact_observer.stamps import from_seconds, grid, seconds_between

    def show(impact: int) -> None:
        progress.step("simulating", seconds_between(EPOCH, impact), duration)

    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    return simulate(plant, grid(EPOCH, EPOCH + from_seconds(duration), rate), progress=show)


def _observed(
    observers: "Sequence[Observer]", run: "Run", progress: "Progress"
) -> "dict[str, Comparison]":
    """Run each observer on ``run``, and compare its estimates with the truth, by law."""
    from impact_observer.compare.comparison import compare_observer
    from impact_observer.io.pairing import samples_of

    truth = samples_of(run.stamps, run.states)
    return {
        observer.law.name: compare_observer(
            observer,
            run.events,
            truth,
            progress=partial(progress.step, observer.law.name),
        )
        for observer in observers
    }
