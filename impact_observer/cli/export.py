# SPDX-License-Identifier: Apache-2.0
"""Write the states, errors, events or impacts of a bag to a CSV or Parquet file.

Each row has its stamp in ns and seconds since the epoch, or without one since the first impact.
Coordinates are q_NAME and u_NAME, their
standard deviations, where an observer has them, deviation_q_NAME and deviation_u_NAME, errors
dq_NAME and du_NAME with V. An impact has its contact and verdict, the contact speed before and
after, the impulse and the energy that is lost, each followed by its deviation. All is in SI units.
Parquet needs pyarrow: impact_observer[parquet].
"""

import argparse
from functools import partial

from impact_observer.cli.arguments import PART, add_shared
from impact_observer.cli.progress import Progress
from impact_observer.errors import UsageError

STATES, ERRORS, EVENTS = WHAT = ("states", "errors", "events")
IMPACTS = "impacts"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.usage = (
        "%(prog)s BAG -o FILE [--what {states,errors,events} | --impacts] [--topics TOPIC ...] "
        "[--model MODEL] [--start S] [--duration S]"
    )
    file = "a .csv or .parquet file"
    add_shared(parser, "bag", "topics", "model", *PART, "file", file=file)
    parser.set_defaults(outputs={"output": ()})
    rows = parser.add_mutually_exclusive_group()
    rows.add_argument(
        "--what",
        choices=WHAT,
        default=STATES,
        help="states of truth and estimates (default), errors of estimates with V, or events",
    )
    rows.add_argument(
        "--impacts",
        action="store_const",
        const=IMPACTS,
        dest="what",
        help="speeds, impulse and energy of each impact, as observe and smooth estimate them",
    )


def run(args: argparse.Namespace) -> int:
    """Export a bag and print how many rows were written."""
    from impact_observer.compare.bag_export import (
        error_rows,
        event_rows,
        impact_rows,
        named_impacts,
        state_rows,
        state_topics,
    )
    from impact_observer.compare.table_files import write_table
    from impact_observer.io.bag_part import read_part, topic_of_impacts
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.model.multibody import multibody_of

    if args.topics is not None and args.what == EVENTS:
        raise UsageError(f"topics: {', '.join(args.topics)} given; {EVENTS} have their own topic")
    with BagReader(args.bag) as reader, Progress() as progress:
        if args.what == EVENTS:
            topics = topic_of_impacts(reader)
        else:
            chosen = named_impacts if args.what == IMPACTS else state_topics
            topics = chosen(reader, args.topics)
        read_part(reader, args.start, args.duration, topics, tell=progress.line)
        show = partial(progress.step, f"exporting {args.bag.name}")
        if args.what == EVENTS:
            blocks = event_rows(reader, show)
        elif args.what == IMPACTS:
            blocks = impact_rows(reader, args.topics, show)
        elif args.what == ERRORS:
            system = multibody_of(model_of(reader, args.model))
            blocks = error_rows(reader, system, args.topics, show)
        else:
            blocks = state_rows(reader, args.topics, show)
        written = write_table(args.output, blocks)
        each = ", ".join(f"{count} of {topic}" for topic, count in written.items())
        progress.line(f"{args.output}: {written.total()} rows of {args.what}: {each}")
    return 0
