# SPDX-License-Identifier: Apache-2.0
"""Write a layout for Foxglove (.json) or PlotJuggler (.xml) that shows a model's observers.

The layout of a bag shows the observers and topics of the bag.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from impact_observer.cli.arguments import add_force, add_model, add_observers
from impact_observer.plain_text import say

_BAGS = {".mcap", ".db3"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("source", metavar="MODEL|BAG", help="a model file, a sample's name, or a bag")
    add_observers(
        parser,
        "draw only observers of these names, such as observer_geometric,observer_kinematic"
        " (default: all in the bag; with a model: observer)",
    )
    add_model(parser, "of a bag (default: the model in the bag)")
    output = "the layout: .json for Foxglove, .xml for PlotJuggler"
    add("-o", "--output", metavar="FILE", type=Path, required=True, help=output)
    add_force(parser, "output")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return layout(args.source, args.output, observers=args.observers, model=args.model)


def layout(
    source: str,
    output: Path,
    *,
    observers: Sequence[str] | None = None,
    model: str | None = None,
) -> int:
    """Write a layout.

    Args:
        source: a bag, a model file or a sample's name.
        output: the layout; its suffix chooses the tool.
        observers: names of observer nodes; None for those in the bag, or ``observer``.
        model: of a bag; None for the model in the bag.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used, or the file may not be written.
        OutputError: the disk is full or gone.
        BagError: the bag cannot be read, or has no observers.
    """
    from impact_observer.draw.curves import curves_of_bag, curves_of_model
    from impact_observer.draw.layouts import foxglove, plotjuggler
    from impact_observer.errors import UsageError
    from impact_observer.output_files import replacing

    if (suffix := output.suffix.lower()) not in {".json", ".xml"}:
        raise UsageError(f"{output}: expected .json for Foxglove, or .xml for PlotJuggler")
    path, topics = Path(source), None
    if path.suffix.lower() in _BAGS or path.is_dir():
        curves, topics = curves_of_bag(path, observers, model)
    elif model is not None:
        raise UsageError(f"--model {model}: is for a bag; {source} is a model itself")
    else:
        curves = curves_of_model(source, observers or ["observer"])
    text = foxglove(curves, topics) if suffix == ".json" else plotjuggler(curves)
    with replacing(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    say(f"{output}: {len(curves)} curves on {len({each.topic for each in curves})} topics")
    return 0
