"""Compare the estimates in bags with the truth: V(t), errors, settling times, a picture."""

import argparse
import json as json_module
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import positive

if TYPE_CHECKING:
    from impact_observer.analysis.comparison import Comparison
    from impact_observer.model import System

SETTLED = 1e-2
"""V over V at the start below which an estimate counts as settled, unless told otherwise."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument(
        "bags", metavar="BAG", nargs="+", type=Path, help="bags with truth and estimates"
    )
    parser.add_argument(
        "--model", metavar="MODEL", help="a model file or a sample (default: the one in each bag)"
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="write V over time to a PNG, SVG or PDF"
    )
    parser.add_argument(
        "--threshold",
        metavar="RATIO",
        type=positive,
        default=SETTLED,
        help=f"V/V0 at which an estimate has settled (default {SETTLED:g})",
    )
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return compare(
        args.bags, model=args.model, plot=args.plot, threshold=args.threshold, json=args.json
    )


def compare(
    bags: Sequence[Path],
    *,
    model: str | None = None,
    plot: Path | None = None,
    threshold: float = SETTLED,
    json: bool = False,
) -> int:
    """Compare bags and print what comes out.

    Args:
        bags: with truth and estimates.
        model: a model file or a sample's name; None for the model that each bag carries.
        plot: a picture to write; None for none.
        threshold: V over V at the start at which an estimate has settled.
        json: print JSON instead of tables.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        BagError: a bag cannot be read, or holds nothing to compare.
    """
    from impact_observer.bag.comparisons import compare_bag
    from impact_observer.bag.reader import BagReader
    from impact_observer.bag.recordings import carried_model
    from impact_observer.model import read_model

    if plot is not None:
        from impact_observer.analysis.figures import check_picture

        check_picture(plot)
    results: list[tuple[Path, str, Comparison]] = []
    for bag in bags:
        with BagReader(bag) as reader:
            read = carried_model(reader) if model is None else read_model(model)
            result = compare_bag(reader, read.system)
        results += [(bag, prefix, each) for prefix, each in result.comparisons.items()]
    labelled = label(results)
    if json:
        print(json_module.dumps({k: figures(v, threshold) for k, v in labelled.items()}, indent=2))
    else:
        print_tables(labelled, read.system, threshold)
    if plot is not None:
        from impact_observer.analysis.figures import lyapunov_figure, save

        save(
            lyapunov_figure(
                labelled, result.impacts, title=read.system.name, epoch=result.epoch
            ),
            plot,
        )
        if not json:
            print(f"picture: {plot}")
    return 0


def label(results: "Sequence[tuple[Path, str, Comparison]]") -> "dict[str, Comparison]":
    """Name each result by its law, and by observer and bag where that is not enough."""
    namings = [
        [each.law for _, _, each in results],
        [f"{each.law} {prefix}" for _, prefix, each in results],
        [f"{each.law} {bag.name}" for bag, _, each in results],
        [f"{each.law} {prefix} {bag}" for bag, prefix, each in results],
    ]
    names = next((n for n in namings if len(set(n)) == len(n)), None)
    if names is None:
        names = [f"{name} #{i}" for i, name in enumerate(namings[-1], start=1)]
    return dict(zip(names, (each for _, _, each in results), strict=True))


def figures(comparison: "Comparison", threshold: float) -> dict[str, object]:
    """What ``--json`` prints of one estimate; SI units, None where a figure has no meaning."""
    return {
        "law": comparison.law,
        "samples": int(comparison.stamps.size),
        "late_samples": comparison.late,
        "impacts_used": comparison.impacts,
        "start_stamp_ns": int(comparison.stamps[0]),
        "end_stamp_ns": int(comparison.stamps[-1]),
        "V_start": float(comparison.V[0]),
        "V_end": float(comparison.V[-1]),
        "V_ratio": comparison.ratio,
        "V_largest_rise": comparison.largest_rise(),
        "settling_time": comparison.settling_time(threshold),
        "rms": comparison.rms.tolist(),
        "max": comparison.largest.tolist(),
        "final": comparison.final.tolist(),
    }


def print_tables(
    labelled: "dict[str, Comparison]", system: "System", threshold: float = SETTLED
) -> None:
    """A table of V and one of the errors, coordinate by coordinate."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(box=box.SIMPLE_HEAD, title=f"Estimates of {system.name}", title_justify="left")
    table.add_column("law", overflow="fold")
    headings = ("V0 [J]", "V end [J]", "V/V0", f"s to {threshold:g} V0", "impacts", "late")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for label, comparison in labelled.items():
        settled = comparison.settling_time(threshold)
        table.add_row(
            label,
            f"{comparison.V[0]:.4g}",
            f"{comparison.V[-1]:.3g}",
            "undefined" if comparison.ratio is None else f"{comparison.ratio:.2e}",
            "never" if settled is None else f"{settled:.2f}",
            str(comparison.impacts),
            str(comparison.late),
        )
    console.print(table)
    errors = Table(box=box.SIMPLE_HEAD, title="Errors, estimate minus truth", title_justify="left")
    errors.add_column("law", overflow="fold")
    errors.add_column("state")
    for heading in ("rms", "largest", "final"):
        errors.add_column(heading, justify="right")
    states = [*(f"{c} [m]" for c in system.coordinates),
              *(f"d{c}/dt [m/s]" for c in system.coordinates)]
    for label, comparison in labelled.items():
        rows = zip(states, comparison.rms, comparison.largest, comparison.final, strict=True)
        for i, (state, rms, largest, final) in enumerate(rows):
            errors.add_row(
                label if i == 0 else "", state, f"{rms:.3e}", f"{largest:.3e}", f"{final:+.3e}",
                end_section=i == len(states) - 1,
            )
    console.print(errors)
