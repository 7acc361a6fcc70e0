# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo over laws, starts, sensors and wrong models, on all cores or on a cluster.

Every law is run with every combination of the given values, --runs times each. Run k has the seed
SEED + k: the observer begins at random:SEED+k, and the sensor draws from the seed, whatever else
is swept. The plant is the same in all runs. The results go into one Parquet file, written at the
end. Needs impact_observer[sweep], and --dask impact_observer[dask].
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    add_observer_arguments,
    add_shared,
    argument,
    count,
    installed_laws,
    metavar,
    observer_options,
    parsed,
    positive,
)
from impact_observer.cli.progress import Progress
from impact_observer.errors import SweepError, UsageError
from impact_observer.matrix_threads import one_matrix_thread
from impact_observer.options import SETTLED, Option, Value
from impact_observer.output_files import PICTURES
from impact_observer.plain_text import say
from impact_observer.sensor_faults import SENSOR_FAULTS

if TYPE_CHECKING:
    from impact_observer.sweep.cases import Sweep

SWEPT = tuple(each for each in SENSOR_FAULTS if each.name != "transport")
"""Faults that change estimates; the transport time changes none that is made of all events."""
_OF_OBSERVERS = (
    "initial_state",
    "initial_deviation",
    "clock_error",
    "model_error",
    "clock_offset_error",
)
"""Options of observers; the others have their defaults."""
_SENSOR = "sensor_"
"""Prefix of a fault among the arguments: observers have options of the same names."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    one_matrix_thread(always=True)  # before numpy is imported
    parser.usage = "%(prog)s MODEL -o FILE [--laws LAW,...] [--runs N] [--jitter S,...] [options]"
    add = parser.add_argument
    add_shared(parser, "rig", "seed", "plot", "json", "measurements", seed="of the first run (0)")
    add_shared(parser, "file", file="a .parquet file to make")
    laws = "of the observers, or all that are installed (default geometric)"
    add("--laws", metavar="LAW,...", default="geometric", help=laws)
    add(
        "--runs", metavar="N", type=count, default=20, help="runs of each combination (default 20)"
    )
    duration = "how long, s (default 30)"
    add("--duration", metavar="S", type=positive, default=30.0, help=duration)
    rate = "samples, Hz (default 100)"
    add("--rate", metavar="HZ", type=positive, default=100.0, help=rate)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", metavar="N", type=count, help="processes (default: all cores)")
    scheduler = "of a Dask cluster, such as tcp://10.0.0.1:8786"
    where.add_argument("--dask", metavar="ADDRESS", help=scheduler)
    parser.set_defaults(outputs={"output": (".parquet",), "plot": PICTURES})
    _add_swept_arguments(parser)
    group = parser.add_argument_group("observers", "the same for all of them")
    add_observer_arguments(group, _OF_OBSERVERS, initial_state="random, of each run")


def _add_swept_arguments(parser: argparse.ArgumentParser) -> None:
    """Add an option for every fault of the sensor, and one for the observer's model."""
    group = parser.add_argument_group("swept", "values with commas; no fault by default")
    for each in SWEPT:
        group.add_argument(
            each.long_flag,
            dest=_SENSOR + each.name,
            metavar="BOOL,..." if each.type == "bool" else f"{metavar(each)},...",
            type=_values_of(each),
            help=each.summary,
        )
    group.add_argument(
        "--off",
        metavar="NAME=V,...",
        type=argument(_off, all, "NAME=V,V,... such as stiffness-scale=0.98,1,1.02"),
        action="append",
        default=[],
        help="a parameter of the observer's model, named as in identify: stiffness-scale=0.98,1",
    )


def _values_of(fault: Option) -> "Callable[[str], tuple[Value, ...]]":
    """The type of an argument that lists values of ``fault`` with commas."""

    def read(text: str) -> tuple[Value, ...]:
        return tuple(dict.fromkeys(parsed(fault, each.strip()) for each in text.split(",")))

    def allows(values: tuple[Value, ...]) -> bool:
        for each in values:
            fault.check(each)
        return True

    expected = f"values with commas, each {fault.limits} {fault.unit}".rstrip()
    return argument(read, allows, expected)


def _off(text: str) -> tuple[str, tuple[float, ...]]:
    """The name and the values in ``NAME=V,V,...``."""
    name, _, values = text.partition("=")
    return name.strip(), tuple(dict.fromkeys(map(float, values.split(","))))


def run(args: argparse.Namespace) -> int:
    """Run all cases, write their rows, and print a summary.

    Raises:
        SweepError: the sweep could not go on, or some cases have failed; the file has the others.
    """
    from impact_observer.sweep.engine import run_cases
    from impact_observer.sweep.summary import (
        groups_of,
        print_groups,
        save_picture,
        table_of,
        write_table,
    )

    wanted = sweep_in(args)
    with Progress() as progress:
        progress.show(f"{args.output}: simulating")
        impacts, rows = len(wanted.plant_run.impacts), []
        for row in run_cases(wanted, jobs=args.jobs, dask=args.dask):
            rows.append(row)
            progress.step(f"{args.output}: cases", len(rows), wanted.size)
    table = table_of(rows)
    write_table(table, args.output)
    groups = groups_of(table, wanted.swept)
    if args.plot is not None:
        save_picture(wanted, groups, args.plot)
    if args.json:
        failures = sum(group["failed"] for group in groups)
        counts = {"cases": wanted.size, "failed": failures, "impacts": impacts}
        found = {**counts, "settled": SETTLED, "groups": groups}
        say(json.dumps(found, indent=2, allow_nan=False))
    else:
        print_groups(wanted, groups)
        say(f"\n{args.output}: {wanted.size} cases, {impacts} impacts of the plant in each")
        if args.plot is not None:
            say(f"picture: {args.plot}")
    failed = [row for row in table.itertuples() if row.error]
    if failed:
        raise SweepError(
            f"{len(failed)} of {wanted.size} cases failed, such as case {failed[0].case}:"
            f" {failed[0].error}"
        )
    return 0


def sweep_in(args: argparse.Namespace) -> "Sweep":
    """The sweep that the arguments define.

    Raises:
        UsageError, ModelError: an argument cannot be used.
    """
    from impact_observer.model import read_model
    from impact_observer.model.measurement import read_measurements
    from impact_observer.sweep.cases import RANDOM, Sweep, models_of, sensors_of

    model = read_model(args.model)
    model.initial_state()
    faults = {each.name: getattr(args, _SENSOR + each.name) for each in SWEPT}
    options, laws = observer_options(args, ""), installed_laws(args.laws)
    sweep = Sweep(
        model=replace(model, provenance={}).text(),
        laws=laws,
        sensors=sensors_of({name: values for name, values in faults.items() if values}),
        models=models_of(model, _by_name(args.off)),
        duration=args.duration,
        rate=args.rate,
        runs=args.runs,
        seed=args.seed,
        options=replace(options, initial_state=args.initial_state or RANDOM, law="geometric"),
        measurements=read_measurements(args.measurements),
    )
    sweep.check()
    return sweep


def _by_name(off: Sequence[tuple[str, tuple[float, ...]]]) -> dict[str, tuple[float, ...]]:
    """The values of ``--off`` by name.

    Raises:
        UsageError: a name is given twice.
    """
    by_name: dict[str, tuple[float, ...]] = {}
    for name, values in off:
        if name in by_name:
            raise UsageError(f"off: {name} found twice; give all its values at once, with commas")
        by_name[name] = values
    return by_name
