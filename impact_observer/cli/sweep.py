"""Monte Carlo over laws, starts, sensors and wrong models, on all cores or on a cluster.

Every law is run with every combination of the values that are given, --runs times each. Run k has
the seed SEED + k: its observer begins at random:SEED+k, and its sensor draws from that seed,
whatever else is swept. The plant is the same in all runs. The results go into one Parquet file;
the same command goes on where it was interrupted. Needs impact_observer[sweep].
"""

import argparse
import json as json_module
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    add_observer_arguments,
    count,
    metavar,
    observer_options,
    parsed,
    positive,
    seed,
)
from impact_observer.compare.comparison import SETTLED
from impact_observer.errors import SweepError, UsageError
from impact_observer.options import Option, Value
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.sweep.engines import one_thread, run_cases
from impact_observer.sweep.summary_tables import figures, print_groups

if TYPE_CHECKING:
    from impact_observer.cli.progress import Progress
    from impact_observer.sweep.case_runs import Outcome
    from impact_observer.sweep.plan import Sweep
    from impact_observer.sweep.summary import CaseGroup

EPOCH = 1_000_000_000
"""Stamp of ``t = 0`` unless told otherwise, ns."""
PERIOD = 5.0
"""Time after which what is finished is written, s, or more where writing takes long."""
_BURDEN = 20.0
"""Least time between two writings, over what the last one took."""
SWEPT = tuple(each for each in SENSOR_FAULTS if each.name != "transport")
"""Estimates are made afterwards, from all events: what is on its way for long does not matter."""
SENSOR = "sensor_"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.usage = "%(prog)s MODEL -o FILE [--laws LAW,...] [--runs N] [--jitter S,...] [options]"
    parser.add_argument("model", metavar="MODEL", help="a model file, or a sample: two_mass, ...")
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        type=Path,
        required=True,
        help="a .parquet file, to make or to go on with",
    )
    parser.add_argument(
        "--laws",
        metavar="LAW,...",
        default="geometric",
        help="of the observers, or all that are installed (default geometric)",
    )
    parser.add_argument(
        "--runs", metavar="N", type=count, default=20, help="seeds of each kind (default 20)"
    )
    parser.add_argument(
        "--seed", metavar="N", type=seed, default=0, help="of the first run (default 0)"
    )
    parser.add_argument(
        "--duration", metavar="S", type=positive, default=30.0, help="how long, s (default 30)"
    )
    parser.add_argument(
        "--rate", metavar="HZ", type=positive, default=100.0, help="samples, Hz (default 100)"
    )
    parser.add_argument(
        "--settled",
        metavar="RATIO",
        type=positive,
        default=SETTLED,
        help=f"V/V0 at which an estimate has settled (default {SETTLED:g})",
    )
    _add_output_arguments(parser)
    _add_swept_arguments(parser)
    group = parser.add_argument_group("observers", "the same for all of them")
    add_observer_arguments(group, simulated=True)


def _add_output_arguments(parser: argparse.ArgumentParser) -> None:
    """Who does the work, and what is shown of it."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", metavar="N", type=count, help="processes (default: all cores)")
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster, such as tcp://10.0.0.1:8786"
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="settling times as PNG, SVG or PDF"
    )
    parser.add_argument(
        "--against", metavar="NAME", help="what the picture has on its axis (default: the first)"
    )
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def _add_swept_arguments(parser: argparse.ArgumentParser) -> None:
    """Add an option for every fault of the sensor, and one for the observer's model."""
    group = parser.add_argument_group("swept", "values with commas; no fault by default")
    for each in SWEPT:
        group.add_argument(
            each.long_flag,
            dest=SENSOR + each.name,
            metavar="BOOL,..." if each.type == "bool" else f"{metavar(each)},...",
            type=_values_of(each),
            help=each.summary,
        )
    group.add_argument(
        "--off",
        metavar="NAME=V,...",
        type=_off,
        action="append",
        default=[],
        help="a parameter of the observer's model, named as in identify: stiffness-scale=0.98,1",
    )


def _values_of(fault: Option) -> "Callable[[str], tuple[Value, ...]]":
    """The type of an argument that lists values of ``fault`` with commas."""

    def value(text: str) -> Value:
        found = parsed(fault, text.strip())
        fault.check(found)
        return found

    def values(text: str) -> tuple[Value, ...]:
        try:
            return tuple(dict.fromkeys(map(value, text.split(","))))
        except ValueError:
            expected = f"{fault.limits} {fault.unit}".rstrip()
            raise argparse.ArgumentTypeError(
                f"{text} found; expected values with commas, each {expected}"
            ) from None

    return values


def _off(text: str) -> tuple[str, tuple[float, ...]]:
    """The type of ``NAME=V,V,...``."""
    name, _, values = text.partition("=")
    try:
        return name.strip(), tuple(dict.fromkeys(float(part) for part in values.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text} found; expected NAME=V,V,... such as stiffness-scale=0.98,1,1.02"
        ) from None


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    one_thread()
    return sweep(
        sweep_in(args),
        args.output,
        jobs=args.jobs,
        scheduler=args.scheduler,
        show=Show(args.plot, args.against, args.json),
    )


def sweep_in(args: argparse.Namespace) -> "Sweep":
    """What the arguments ask for.

    Raises:
        UsageError, ModelError: they cannot be used.
    """
    from dataclasses import replace

    from impact_observer.cli.compare import laws_in
    from impact_observer.cli.progress import Progress
    from impact_observer.model import read_model
    from impact_observer.observer import COMPILING, needs_compiling, options_of_laws
    from impact_observer.sweep.model_variants import replicas_of
    from impact_observer.sweep.plan import RANDOM, Rig, Sweep, sensors_of

    model = read_model(args.model)
    model.initial_state()
    troubles = {each.name: getattr(args, SENSOR + each.name) for each in SWEPT}
    epoch = EPOCH if args.epoch is None else args.epoch
    options, laws = observer_options(args, ""), laws_in(args.laws)
    with Progress(sys.stderr if args.json else None) as progress:
        if any(map(needs_compiling, options_of_laws(options, laws))):
            progress.show(COMPILING)
        return Sweep(
            rig=Rig(replace(model, provenance={}).text(), args.duration, args.rate, epoch),
            laws=laws,
            sensors=sensors_of({name: found for name, found in troubles.items() if found}),
            replicas=replicas_of(model, named_once(args.off)),
            runs=args.runs,
            seed=args.seed,
            options=replace(options, initial_state=args.initial_state or RANDOM, law="geometric"),
            threshold=args.settled,
        )


def named_once(
    off: Sequence[tuple[str, tuple[float, ...]]],
) -> Mapping[str, tuple[float, ...]]:
    """What is off, by name.

    Raises:
        UsageError: a name comes twice.
    """
    found: dict[str, tuple[float, ...]] = {}
    for name, values in off:
        if name in found:
            raise UsageError(f"off: {name} found twice; give all its values at once, with commas")
        found[name] = values
    return found


@dataclass(frozen=True, slots=True)
class Show:
    """What is shown of a sweep.

    Attributes:
        plot: a picture; None for none.
        against: what it has on its axis; None for the first that is swept.
        json: whether to print JSON instead of a table.
    """

    plot: Path | None = None
    against: str | None = None
    json: bool = False

    def check(self, sweep: "Sweep") -> None:
        """Raise before the work is done if there can be no such picture.

        Raises:
            UsageError: its name, its folder or its axis cannot be used.
        """
        if self.plot is None:
            if self.against is not None:
                raise UsageError(f"--against {self.against}: there is no picture; add --plot FILE")
            return
        from impact_observer.draw.pictures import check_output
        from impact_observer.sweep.summary_picture import against_of

        check_output(self.plot)
        against_of(sweep, self.against)


def sweep(
    wanted: "Sweep",
    output: Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    show: Show | None = None,
) -> int:
    """Run the cases that are not in the file yet, and print what all of them come to.

    Args:
        wanted: what is swept.
        output: a Parquet file, to make or to go on with.
        jobs: processes on this machine; None for as many as it has cores.
        scheduler: address of a Dask scheduler, whose workers do the work instead.
        show: what is shown; None for a table.

    Returns:
        0.

    Raises:
        UsageError: something cannot be used, or a package is not here.
        ImpactLawError, DynamicsError: the plant has no solution.
        SweepError: the work could not go on, or some cases have failed; the file has the others.
        KeyboardInterrupt: as it came; the file has what was finished.
    """
    from impact_observer.cli.progress import Progress
    from impact_observer.draw.pictures import check_output
    from impact_observer.sweep.case_runs import plant_run
    from impact_observer.sweep.summary import groups_of

    shown = show or Show()
    check_output(output, (".parquet",))
    shown.check(wanted)
    outcomes = _files().read_outcomes(output, wanted)
    with Progress(sys.stderr if shown.json else None) as progress:
        progress.show(f"{output}: simulating")
        impacts = len(plant_run(wanted.rig).impacts)
        if outcomes:
            progress.line(f"{output}: has {len(outcomes)} of {wanted.size} cases already")
        missing = [case for case in wanted.cases() if case.number not in outcomes]
        if missing:
            work = run_cases(missing, jobs=jobs, scheduler=scheduler)
            _finish(work, wanted, output, outcomes, progress)
    groups = groups_of(wanted, outcomes.values())
    if shown.plot is not None:
        draw(wanted, groups, shown)
    if shown.json:
        print(json_module.dumps(document(wanted, groups, impacts), indent=2, allow_nan=False))
    else:
        print_groups(wanted, groups)
        print(f"{output}: {wanted.size} cases, {impacts} impacts of the plant in each")
        if shown.plot is not None:
            print(f"picture: {shown.plot}")
    _raise_failed(wanted, outcomes)
    return 0


def _files() -> "ModuleType":
    """The module that reads and writes the files.

    Raises:
        UsageError: ``pyarrow`` is not here.
    """
    try:
        from impact_observer.sweep import outcomes_file
    except ImportError as error:
        raise UsageError(
            f"sweep needs pyarrow ({error}); pip install impact_observer[sweep]"
        ) from None
    return outcomes_file


def _finish(
    work: "Generator[Outcome, None, None]",
    wanted: "Sweep",
    output: Path,
    outcomes: "dict[int, Outcome]",
    progress: "Progress",
) -> None:
    """Add the outcomes that are missing, and write the file now and then, and at any end."""
    write, what = _files().write_outcomes, f"{output}: cases"
    progress.step(what, len(outcomes), wanted.size)
    due, before = time.monotonic() + PERIOD, len(outcomes)
    try:
        with closing(work):
            for outcome in work:
                outcomes[outcome.case] = outcome
                progress.step(what, len(outcomes), wanted.size)
                if (now := time.monotonic()) >= due:
                    write(output, wanted, outcomes)
                    done = time.monotonic()
                    due = done + max(PERIOD, _BURDEN * (done - now))
    except KeyboardInterrupt:
        told = f"{len(outcomes)} of {wanted.size} cases are done; the same command goes on"
        raise KeyboardInterrupt(told) from None
    finally:
        if len(outcomes) > before:
            write(output, wanted, outcomes)


def draw(wanted: "Sweep", groups: "Sequence[CaseGroup]", show: Show) -> None:
    """Draw the settling times."""
    from impact_observer.draw.pictures import save
    from impact_observer.model import parse_model
    from impact_observer.sweep.summary_picture import sweep_figure

    assert show.plot is not None, "there is a picture to draw"
    name = parse_model(wanted.rig.text, "model").system.name
    title = f"{name}: when estimates settle, medians and quartiles of {wanted.runs} runs"
    save(sweep_figure(wanted, groups, against=show.against, title=title), show.plot, about=title)


def document(wanted: "Sweep", groups: "Sequence[CaseGroup]", impacts: int) -> dict[str, object]:
    """What ``--json`` prints."""
    return {
        "cases": wanted.size,
        "failed": sum(group.failed for group in groups),
        "impacts": impacts,
        "threshold": wanted.threshold,
        "groups": figures(groups),
    }


def _raise_failed(wanted: "Sweep", outcomes: "Mapping[int, Outcome]") -> None:
    """Raise SweepError where cases have failed."""
    failed = [outcomes[number] for number in sorted(outcomes) if outcomes[number].error]
    if failed:
        raise SweepError(
            f"{len(failed)} of {wanted.size} cases failed, such as case {failed[0].case}:"
            f" {failed[0].error}"
        )
