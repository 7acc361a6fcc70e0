"""Compare the estimates in bags with the truth: V(t), errors, settling times, a picture, a report.

With --laws, other observers are run on the bags' own impacts and compared as well. The two sides
of an impact are never mixed: samples at which the truth has jumped and the estimate has not, or
the other way round, are reported apart.
"""

import argparse
import csv as csv_module
import json as json_module
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_observer_arguments, observer_options, positive
from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from impact_observer.analysis.comparison import Comparison
    from impact_observer.bag.comparisons import BagComparison, Choice
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
        "--estimates",
        metavar="NAME",
        nargs="+",
        help="compare these only: observers, or topics of JointState or ObserverState",
    )
    parser.add_argument(
        "--truth", metavar="TOPIC", help="of the true states (default: the plant's joint states)"
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="write V over time to a PNG, SVG or PDF"
    )
    parser.add_argument(
        "--report",
        metavar="FILE.html",
        type=Path,
        help="write figures and pictures to one page that needs no network",
    )
    parser.add_argument(
        "--csv", metavar="FILE", type=Path, help="write the figures, a line an estimate"
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
        truth=args.truth,
        estimates=args.estimates,
        threshold=args.threshold,
        output=Output(args.plot, args.report, args.csv, args.json),
    )


@dataclass(frozen=True, slots=True)
class Output:
    """Where a comparison goes; what is there already is replaced.

    Attributes:
        plot: a picture of V; None for none.
        report: a page of HTML; None for none.
        csv: the figures as CSV; None for none.
        json: whether to print JSON instead of tables.
    """

    plot: Path | None = None
    report: Path | None = None
    csv: Path | None = None
    json: bool = False

    def check(self) -> None:
        """Raise before the work is done if something cannot be written.

        Raises:
            UsageError: a name does not end as it must, or a folder does not exist.
        """
        from impact_observer.analysis.figures import check_picture

        for path, endings in (
            (self.plot, (".png", ".svg", ".pdf")),
            (self.report, (".html", ".htm")),
            (self.csv, (".csv",)),
        ):
            if path is not None:
                check_picture(path, endings)


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
    truth: str | None = None,
    estimates: Sequence[str] | None = None,
    threshold: float = SETTLED,
    output: Output | None = None,
) -> int:
    """Compare bags and print what comes out.

    Args:
        bags: with truth, and with estimates or impacts.
        model: a model file or a sample's name; None for the model that each bag carries.
        observers: to run on each bag, one a law, beside those whose estimates it has. Their
            ensemble is left out: no estimate depends on it.
        truth: the topic of the true states; None for the plant's.
        estimates: names of observers or topics; None for every observer.
        threshold: V over V at the start at which an estimate has settled.
        output: where it goes; None for tables on the terminal.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        BagError: a bag cannot be read, or holds nothing to compare.
        ImpactLawError, DynamicsError: an observer cannot follow the events of a bag.
    """
    from impact_observer.bag.comparisons import Choice

    given = output or Output()
    given.check()
    choice = Choice(truth, None if estimates is None else tuple(estimates), threshold)
    results = [(bag, _compare_one(bag, model, observers, choice)) for bag in bags]
    labelled = labelled_by_law(results)
    if given.json:
        print(json_module.dumps({k: figures(v) for k, v in labelled.items()}, indent=2))
    else:
        print_tables(labelled)
    _write(given, labelled, results)
    return 0


def _write(
    output: Output,
    labelled: "dict[str, Comparison]",
    results: "Sequence[tuple[Path, BagComparison]]",
) -> None:
    """Write the files that are wanted, and say so."""
    if output.csv is not None:
        write_csv(labelled, output.csv)
    if output.plot is not None:
        draw(labelled, results[0][1], output.plot)
    if output.report is not None:
        from impact_observer.cli.report import write_report

        write_report(output.report, labelled, results)
    written = {"figures": output.csv, "picture": output.plot, "report": output.report}
    for what, path in written.items():
        if path is not None and not output.json:
            print(f"{what}: {path}")


def _compare_one(
    bag: Path, model: str | None, observers: "Sequence[Options]", choice: "Choice"
) -> "BagComparison":
    """Compare one bag, and show on a terminal how far that is."""
    from impact_observer.bag.comparisons import compare_bag
    from impact_observer.bag.reader import BagReader
    from impact_observer.bag.recordings import system_of
    from impact_observer.cli.progress import Progress

    with BagReader(bag) as reader, Progress(sys.stderr) as progress:
        progress.show(f"{bag}: reading")
        system = system_of(reader, model)

        def show(what: str, done: int, total: int) -> None:
            progress.step(f"{bag}: {what}", done, total)

        made = [replace(each, ensemble=1).observer(system) for each in observers]
        return compare_bag(reader, system, made, choice=choice, progress=show)


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


def figures(comparison: "Comparison") -> dict[str, object]:
    """What ``--json`` prints of one estimate; SI units, None where a figure has no meaning."""
    from impact_observer.events import Ruling

    mismatch, rulings = comparison.mismatch, comparison.heard.rulings
    counts = {r: None if rulings is None else rulings[r] for r in Ruling}
    return {
        "law": comparison.law,
        "samples": comparison.samples,
        "late_samples": comparison.late,
        "stale_samples": comparison.stale,
        "events_used": comparison.events,
        "impacts_used": comparison.heard.until(int(comparison.stamps[-1])),
        "switches_rejected": counts[Ruling.REJECTED],
        "impacts_inserted": counts[Ruling.INSERTED],
        "start_stamp_ns": int(comparison.stamps[0]),
        "end_stamp_ns": int(comparison.stamps[-1]),
        "V_start": float(comparison.V[0]),
        "V_end": float(comparison.V[-1]),
        "V_ratio": comparison.ratio,
        "V_largest_rise": comparison.largest_rise,
        "settling_time": comparison.settling_time,
        "rate_per_second": comparison.rate_per_second,
        "rate_per_impact": comparison.rate_per_impact,
        "mismatch_windows": mismatch.windows,
        "mismatch_samples": mismatch.samples,
        "mismatch_longest": mismatch.longest,
        "mismatch_V_largest": mismatch.V,
        "rms": comparison.rms.tolist(),
        "max": comparison.largest.tolist(),
        "final": comparison.final.tolist(),
    }


def write_csv(labelled: "dict[str, Comparison]", path: Path) -> None:
    """Write the figures of each estimate as a line; errors have a column a state.

    Raises:
        UsageError: the file cannot be written.
    """
    rows = []
    for label, each in labelled.items():
        row: dict[str, object] = {"estimate": label, "system": each.system.name}
        for key, value in figures(each).items():
            if isinstance(value, list):
                row |= {f"{key}_{s}": v for s, v in zip(states_of(each), value, strict=True)}
            else:
                row[key] = value
        rows.append(row)
    columns = dict.fromkeys(key for row in rows for key in row)
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv_module.DictWriter(file, [*columns])
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def print_tables(labelled: "dict[str, Comparison]") -> None:
    """Tables of V, of the impacts, and of the errors coordinate by coordinate."""
    from rich.console import Console

    console = Console()
    for table in (table_of(labelled), impacts_table(labelled), errors_table(labelled)):
        console.print(table)
    print_blindness(labelled)


def table_of(labelled: "dict[str, Comparison]") -> "Table":
    """V of each estimate, when it settled and how fast it fell."""
    names = ", ".join(dict.fromkeys(each.system.name for each in labelled.values()))
    threshold = next(iter(labelled.values())).threshold
    headings = ("V0 [J]", "V end [J]", "V/V0", f"s to {threshold:g} V0", "1/s", "1/impact")
    table = _table(f"Estimates of {names}", *headings)
    for label, each in labelled.items():
        table.add_row(
            label,
            f"{each.V[0]:.4g}",
            f"{each.V[-1]:.3g}",
            "undefined" if each.ratio is None else f"{each.ratio:.2e}",
            _number(each.settling_time, "never"),
            _number(each.rate_per_second),
            _number(each.rate_per_impact),
        )
    return table


def impacts_table(labelled: "dict[str, Comparison]") -> "Table":
    """What became of the impacts, and the samples that do not count."""
    from impact_observer.events import Ruling

    title = "Impacts; samples late, and between the jumps of truth and estimate"
    table = _table(title, "used", "rejected", "inserted", "late", "between", "longest", "V")
    for label, each in labelled.items():
        rulings, mismatch = each.heard.rulings, each.mismatch
        table.add_row(
            label,
            str(each.heard.until(int(each.stamps[-1]))),
            "" if rulings is None else str(rulings[Ruling.REJECTED]),
            "" if rulings is None else str(rulings[Ruling.INSERTED]),
            str(each.late),
            str(mismatch.samples),
            f"{1e3 * mismatch.longest:.4g} ms" if mismatch.windows else "",
            f"{mismatch.V:.2e} J" if mismatch.windows else "",
        )
    return table


def errors_table(labelled: "dict[str, Comparison]") -> "Table":
    """Errors of each state."""
    from rich import box
    from rich.table import Table

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
    return errors


def _table(title: str, *headings: str) -> "Table":
    """An empty table with a row a law."""
    from rich import box
    from rich.table import Table

    table = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        collapse_padding=True,
        pad_edge=False,
    )
    table.add_column("law", overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _number(value: float | None, without: str = "") -> str:
    return without if value is None else f"{value:.3g}" if value < 1 else f"{value:.2f}"


def print_blindness(labelled: "dict[str, Comparison]") -> None:
    """Say of which systems V does not see everything."""
    from impact_observer.analysis.lyapunov import is_seminorm

    systems = {each.system.name: each.system for each in labelled.values()}
    for name, system in systems.items():
        if is_seminorm(system):
            print(f"{name} has a rigid-body mode: V does not see an error of its position")


def states_of(comparison: "Comparison") -> list[str]:
    """Names of the states: coordinates, then their velocities."""
    coordinates = comparison.system.coordinates
    return [*coordinates, *(f"d{name}/dt" for name in coordinates)]


def _error_rows(label: str, comparison: "Comparison") -> "list[tuple[str, ...]]":
    states, final = states_of(comparison), comparison.final
    figures_of = zip(states, comparison.rms, comparison.largest, final, strict=True)
    return [
        ("" if i else label, state, f"{rms:.3e}", f"{largest:.3e}", f"{final:+.3e}")
        for i, (state, rms, largest, final) in enumerate(figures_of)
    ]
