"""Compare the estimates in bags with the truth: V(t), errors, settling times, a picture."""

import argparse
import json as json_module
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import positive

if TYPE_CHECKING:
    from impact_observer.analysis.comparison import Comparison
    from impact_observer.bag.comparisons import BagComparison

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
    results: list[tuple[Path, BagComparison]] = []
    for bag in bags:
        with BagReader(bag) as reader:
            system = (carried_model(reader) if model is None else read_model(model)).system
            results.append((bag, compare_bag(reader, system)))
    labelled = labelled_by_law(results)
    if json:
        print(json_module.dumps({k: figures(v, threshold) for k, v in labelled.items()}, indent=2))
    else:
        print_tables(labelled, threshold)
    if plot is not None:
        draw(labelled, results[0][1], plot)
        if not json:
            print(f"picture: {plot}")
    return 0


def draw(labelled: "dict[str, Comparison]", first: "BagComparison", plot: Path) -> None:
    """Draw V over time; impacts and epoch are those of the first bag."""
    from impact_observer.analysis.figures import lyapunov_figure, save

    title = f"{first.system.name}: distance of the estimates from the truth"
    save(lyapunov_figure(labelled, first.impacts, title=title, epoch=first.epoch), plot)


def labelled_by_law(results: "Sequence[tuple[Path, BagComparison]]") -> "dict[str, Comparison]":
    """Name each estimate by its law, and by observer and bag where that is not enough."""
    each = [
        (bag, prefix, comparison)
        for bag, result in results
        for prefix, comparison in result.comparisons.items()
    ]
    namings = [
        [comparison.law for _, _, comparison in each],
        [f"{comparison.law} {prefix}" for _, prefix, comparison in each],
        [f"{comparison.law} {bag.name}" for bag, _, comparison in each],
        [f"{comparison.law} {prefix} {bag}" for bag, prefix, comparison in each],
    ]
    names = next((n for n in namings if len(set(n)) == len(n)), None)
    if names is None:
        names = [f"{name} #{i}" for i, name in enumerate(namings[-1], start=1)]
    return dict(zip(names, (comparison for _, _, comparison in each), strict=True))


def figures(comparison: "Comparison", threshold: float) -> dict[str, object]:
    """What ``--json`` prints of one estimate; SI units, None where a figure has no meaning."""
    return {
        "law": comparison.law,
        "samples": int(comparison.stamps.size),
        "late_samples": comparison.late,
        "events_used": comparison.events,
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


def print_tables(labelled: "dict[str, Comparison]", threshold: float = SETTLED) -> None:
    """A table of V and one of the errors, coordinate by coordinate."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from impact_observer.analysis.lyapunov import is_seminorm

    console = Console()
    systems = {each.system.name: each.system for each in labelled.values()}
    title = f"Estimates of {', '.join(systems)}"
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left")
    table.add_column("law", overflow="fold")
    for heading in ("V0 [J]", "V end [J]", "V/V0", f"s to {threshold:g} V0", "events", "late"):
        table.add_column(heading, justify="right", no_wrap=True)
    errors = Table(
        box=box.SIMPLE_HEAD, title="Errors, estimate minus truth, SI units", title_justify="left"
    )
    errors.add_column("law", overflow="fold")
    errors.add_column("state")
    for heading in ("rms", "largest", "final"):
        errors.add_column(heading, justify="right")
    for label, each in labelled.items():
        settled = each.settling_time(threshold)
        table.add_row(
            label,
            f"{each.V[0]:.4g}",
            f"{each.V[-1]:.3g}",
            "undefined" if each.ratio is None else f"{each.ratio:.2e}",
            "never" if settled is None else f"{settled:.2f}",
            str(each.events),
            str(each.late),
        )
        for row in _error_rows(label, each):
            errors.add_row(*row)
        errors.add_section()
    console.print(table)
    console.print(errors)
    for name, system in systems.items():
        if is_seminorm(system):
            print(f"{name} has a rigid-body mode: V does not see an error of its position")


def _error_rows(label: str, comparison: "Comparison") -> "list[tuple[str, ...]]":
    coordinates = comparison.system.coordinates
    states = [*coordinates, *(f"d{name}/dt" for name in coordinates)]
    figures_of = zip(states, comparison.rms, comparison.largest, comparison.final, strict=True)
    return [
        ("" if i else label, state, f"{rms:.3e}", f"{largest:.3e}", f"{final:+.3e}")
        for i, (state, rms, largest, final) in enumerate(figures_of)
    ]
