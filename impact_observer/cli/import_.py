# SPDX-License-Identifier: Apache-2.0
"""Make a bag of impact times in a table, and of samples of sensors in others.

Columns are time, contact and kind (impact, close or open): with a header in any order, without one
in this order. The last ones may be left out. Lines that begin with # are comments.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import TABLE, UNUSUAL_TABLE, add_shared, table_form
from impact_observer.cli.progress import Progress
from impact_observer.draw.reports import counted

if TYPE_CHECKING:
    from impact_observer.io.import_table import Imported


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("csv", metavar="CSV", type=Path, help="the file of impact times")
    model = "a model file or a sample, to be put into the bag"
    add_shared(parser, "output", "model", "epoch", *TABLE, *UNUSUAL_TABLE, model=model)
    truth = "a file of true states: time, and q_NAME and u_NAME of each coordinate of --model"
    add("--truth", metavar="CSV", type=Path, help=truth)
    samples = "tables of an encoder, a camera, a tracker: each a topic named as the file, for"
    samples += " --measurements of the other commands; their columns are joints"
    add("--samples", metavar="FILE", type=Path, nargs="+", default=[], help=samples)


def run(args: argparse.Namespace) -> int:
    """Import a file and print what was imported."""
    from impact_observer.io.import_table import import_table
    from impact_observer.model import read_model

    model = None if args.model is None else read_model(args.model)
    with Progress() as progress:

        def show(messages: int) -> None:
            if messages % 1000 == 0:
                progress.show(f"{args.output}: {messages} messages")

        progress.show(f"reading {args.csv}")
        imported = import_table(
            args.csv,
            args.output,
            model=model,
            truth=args.truth,
            samples=args.samples,
            form=table_form(args),
            start=args.time_zero,
            epoch=args.epoch,
            progress=show,
        )
        progress.line(f"{args.output}: {_summary(imported)}")
        progress.warn(imported.remarks)
        if imported.ignored:
            progress.line(f"note: columns left out: {', '.join(imported.ignored)}")
    return 0


def _summary(imported: "Imported") -> str:
    """An import in one line."""
    from impact_observer.stamps import text

    first, last = imported.events[0], imported.events[-1]
    events = f"{counted(len(imported.events), 'event')} of {counted(imported.rows, 'row')}"
    words = [events, imported.times]
    if imported.states:
        words.append(f"{imported.states} true states")
    words += [f"{counted(n, 'sample')} on {topic}" for topic, n in imported.samples.items()]
    words.append(f"stamps {text(first.stamp)} to {text(last.stamp)} s")
    epoch = (
        f"epoch {text(first.epoch)} s" if first.epoch else "epoch unknown (--epoch, --time-zero)"
    )
    return f"{', '.join(words)}; time 0 is stamp {text(imported.start)} s, {epoch}"
