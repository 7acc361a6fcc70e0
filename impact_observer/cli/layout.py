"""Write a layout for Foxglove (.json) or PlotJuggler (.xml) that shows a model's observers.

From a bag its own observers are taken, and only what is in it.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_model

if TYPE_CHECKING:
    from impact_observer.draw.curves import Curve

_BAGS = {".mcap", ".db3"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument(
        "source", metavar="MODEL|BAG", help="a model file, a sample's name, or a bag"
    )
    parser.add_argument(
        "--observers",
        metavar="NAME,...",
        type=lambda text: text.split(","),
        help="names of observer nodes, such as observer_geometric,observer_kinematic"
        " (default: those in the bag; with a model: observer)",
    )
    add_model(parser, "of a bag (default: the one that it carries)")
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        type=Path,
        required=True,
        help="the layout to write: .json for Foxglove, .xml for PlotJuggler",
    )


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
        output: the file to write; its suffix says for which tool.
        observers: names of observer nodes; None for those in the bag, or ``observer``.
        model: of a bag; None for the one that it carries.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used, or the file cannot be written.
        BagError: the bag cannot be read, or has no observers.
    """
    from impact_observer.draw.layouts import foxglove, plotjuggler
    from impact_observer.errors import UsageError

    if (kind := output.suffix.lower()) not in {".json", ".xml"}:
        raise UsageError(f"{output}: expected .json for Foxglove, or .xml for PlotJuggler")
    path = Path(source)
    if path.suffix.lower() in _BAGS or path.is_dir():
        curves, topics = _of_bag(path, observers, model)
    elif model is not None:
        raise UsageError(f"--model {model}: is for a bag; {source} is a model itself")
    else:
        curves, topics = _of_model(source, observers or ["observer"]), None
    text = foxglove(curves, topics) if kind == ".json" else plotjuggler(curves)
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{output}: cannot be written: {error.strerror}") from None
    print(f"{output}: {len(curves)} curves on {len({each.topic for each in curves})} topics")
    return 0


def _of_model(model: str, observers: Sequence[str]) -> "tuple[Curve, ...]":
    """The curves of a model and observers that go by these names."""
    from impact_observer.draw.curves import Observed, curves
    from impact_observer.model import read_model

    named = dict.fromkeys(Observed.named(name) for name in observers)
    return curves(read_model(model).system, list(named))


def _of_bag(
    bag: Path, observers: Sequence[str] | None, model: str | None
) -> "tuple[tuple[Curve, ...], tuple[str, ...]]":
    """The curves that a bag has something for, and its topics."""
    from impact_observer.draw.curves import Observed, curves, observed_in
    from impact_observer.errors import BagError, UsageError
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import system_of

    with BagReader(bag) as reader:
        system, found = system_of(reader, model), observed_in(reader)
        if not found:
            raise BagError(f"{bag}: has no estimates; make them with observe, or name a model")
        by_prefix = {each.prefix: each for each in found}
        wanted = dict.fromkeys(Observed.named(name).prefix for name in observers or by_prefix)
        if missing := [prefix for prefix in wanted if prefix not in by_prefix]:
            there = ", ".join(by_prefix)
            raise UsageError(f"{bag}: no observer {missing[0]}; in the bag: {there}")
        topics = tuple(name for name, topic in reader.topics.items() if topic.count)
    return curves(system, [by_prefix[prefix] for prefix in wanted], topics), topics
