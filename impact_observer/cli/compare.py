"""Compare the estimates in bags with the truth: V(t), errors, settling times, a picture.

With --laws, other observers are run on the bags' own impacts and compared as well.
"""

import argparse
import json as json_module
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_observer_arguments, observer_options, positive
from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from impact_observer.analysis.comparison import Comparison
    from impact_observer.bag.comparisons import BagComparison
    from impact_observer.observer import Options

SETTLED = 1e-2
"""V over V at the start below which an estimate counts as settled, unless told otherwise."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bags", metavar="BAG", nargs="+", type=Path, help="bags with truth")
    parser.add_argument(
        "--laws",
        metavar="LAW,...",
        help="run observers with these laws on each bag, or with all that are installed",
    )
    add_observer_arguments(parser)
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
    laws = () if args.laws is None else laws_in(args.laws)
    options = [observer_options(args, law) for law in laws]
    if not options and observer_options(args, "") != observer_options(argparse.Namespace(), ""):
        raise UsageError("laws: none named, but how to run observers; name some with --laws")
    return compare(
        args.bags,
        model=args.model,
        observers=options,
        plot=args.plot,
        threshold=args.threshold,
        json=args.json,
    )


def laws_in(text: str) -> tuple[str, ...]:
    """Read ``LAW,LAW,...`` or ``all``: names of installed laws, each once.

    Raises:
        UsageError: no law is named, or one that is not installed.
    """
    from impact_observer.observer import law_named, law_names

    if not text:
        raise UsageError("laws: none named; expected LAW,LAW,... or all")
    names = law_names() if text == "all" else [name.strip() for name in text.split(",")]
    for name in names:
        law_named(name)
    return tuple(dict.fromkeys(names))


def compare(
    bags: Sequence[Path],
    *,
    model: str | None = None,
    observers: "Sequence[Options]" = (),
    plot: Path | None = None,
    threshold: float = SETTLED,
    json: bool = False,
) -> int:
    """Compare bags and print what comes out.

    Args:
        bags: with truth, and with estimates or impacts.
        model: a model file or a sample's name; None for the model that each bag carries.
        observers: to run on each bag, one a law, beside those whose estimates it has. Their
            ensemble is left out: no estimate depends on it.
        plot: a picture to write; None for none.
        threshold: V over V at the start at which an estimate has settled.
        json: print JSON instead of tables.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        BagError: a bag cannot be read, or holds nothing to compare.
        ImpactLawError, DynamicsError: an observer cannot follow the events of a bag.
    """
    if plot is not None:
        from impact_observer.analysis.figures import check_picture

        check_picture(plot)
    results = [(bag, _compare_one(bag, model, observers)) for bag in bags]
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


def _compare_one(bag: Path, model: str | None, observers: "Sequence[Options]") -> "BagComparison":
    """Compare one bag, and show on a terminal how far that is."""
    from impact_observer.bag.comparisons import compare_bag
    from impact_observer.bag.reader import BagReader
    from impact_observer.bag.recordings import system_of
    from impact_observer.cli.progress import Progress

    with BagReader(bag) as reader, Progress(sys.stderr) as progress:
        progress.show(f"{bag}: reading")
        system = system_of(reader, model)

        def show(law: str, done: int, total: int) -> None:
            if done % 100 == 0:
                progress.show(f"{bag}: {law}, {done} of {total} estimates")

        made = [replace(each, ensemble=1).observer(system) for each in observers]
        return compare_bag(reader, system, made, progress=show)


def draw(labelled: "dict[str, Comparison]", first: "BagComparison", plot: Path) -> None:
    """Draw V over time; impacts and epoch are those of the first bag."""
    from impact_observer.analysis.figures import lyapunov_figure, save

    title = f"{first.system.name}: distance of the estimates from the truth"
    save(lyapunov_figure(labelled, first.impacts, title=title, epoch=first.epoch), plot)


def labelled_by_law(results: "Sequence[tuple[Path, BagComparison]]") -> "dict[str, Comparison]":
    """Name each estimate by its law, and by observer and bag where that is not enough.

    One that was made here, and not recorded, has no observer's prefix.
    """
    each = [
        (bag, "" if prefix == comparison.law else f" {prefix}", comparison)
        for bag, result in results
        for prefix, comparison in result.comparisons.items()
    ]
    namings = [
        [comparison.law for _, _, comparison in each],
        [f"{comparison.law}{prefix}" for _, prefix, comparison in each],
        [f"{comparison.law} {bag.name}" for bag, _, comparison in each],
        [f"{comparison.law}{prefix} {bag}" for bag, prefix, comparison in each],
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

    console = Console()
    errors = Table(
        box=box.SIMPLE_HEAD, title="Errors, estimate minus truth, SI units", title_justify="left"
    )
    errors.add_column("law", overflow="fold")
    errors.add_column("state")
    for heading in ("rms", "largest", "final"):
        errors.add_column(heading, justify="right")
    for label, each in labelled.items():
        for row in _error_rows(label, each):
            errors.add_row(*row)
        errors.add_section()
    console.print(table_of(labelled, threshold))
    console.print(errors)
    print_blindness(labelled)


def table_of(labelled: "dict[str, Comparison]", threshold: float = SETTLED) -> "Table":
    """V of each estimate, and when it settled."""
    from rich import box
    from rich.table import Table

    names = ", ".join(dict.fromkeys(each.system.name for each in labelled.values()))
    table = Table(
        box=box.SIMPLE_HEAD,
        title=f"Estimates of {names}",
        title_justify="left",
        collapse_padding=True,
        pad_edge=False,
    )
    table.add_column("law", overflow="fold")
    for heading in ("V0 [J]", "V end [J]", "V/V0", f"s to {threshold:g} V0", "events", "late"):
        table.add_column(heading, justify="right", no_wrap=True)
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
    return table


def print_blindness(labelled: "dict[str, Comparison]") -> None:
    """Say of which systems V does not see everything."""
    from impact_observer.analysis.lyapunov import is_seminorm

    systems = {each.system.name: each.system for each in labelled.values()}
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
