# SPDX-License-Identifier: Apache-2.0
"""The outcomes of a sweep in one Parquet file, and the runs that the file lacks.

Each case has a row, in order of the numbers of the cases: labels, then metrics. The metadata
describe the sweep. A new file is written beside the old one and then replaces the old one, so the
file is always complete. Equal outcomes make equal files.
"""

import json
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import get_args, get_type_hints

from impact_observer.errors import UsageError
from impact_observer.output_files import replacing
from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.engines import run_batches
from impact_observer.sweep.plan import Sweep

try:
    import pyarrow as pa
    import pyarrow.parquet as pq
except ImportError as error:
    raise UsageError(f"sweep needs pyarrow ({error}); pip install pyarrow") from None

_KEY = b"impact_observer.sweep"
_TYPES = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
PERIOD = 5.0
"""Least time between two writings of the file, s."""
LOAD = 20.0
"""Least time between two writings, over the duration of the last one."""
_LONGEST = 60
"""Most letters of a value in an error line."""


def read_outcomes(path: Path, sweep: Sweep) -> dict[int, Outcome]:
    """The outcomes in a file, by the numbers of their cases; empty without a file.

    Raises:
        UsageError: the file belongs to another sweep, or is no sweep; the file stays.
    """
    if not path.exists():
        return {}
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        line = " ".join(str(error).split())
        raise UsageError(f"{path}: exists and is no sweep ({line}); name another file") from None
    description = (table.schema.metadata or {}).get(_KEY)
    if description is None:
        raise UsageError(f"{path}: exists and is no sweep; name another file")
    _check_same(path, json.loads(description), sweep.description())
    names = [field.name for field in fields(Outcome)]
    return {row["case"]: Outcome(**row) for row in table.select(names).to_pylist()}


def write_outcomes(path: Path, sweep: Sweep, outcomes: Mapping[int, Outcome]) -> None:
    """Replace the file by one with all of ``outcomes``.

    Raises:
        UsageError: the file may not be written.
        OutputError: the disk is full or gone.
    """
    cases = [case for case in sweep.cases() if case.number in outcomes]
    labels = [case.labels for case in cases]
    present = [outcomes[case.number] for case in cases]
    columns = {name: [each[name] for each in labels] for name in labels[0]}
    columns |= {each.name: [getattr(o, each.name) for o in present] for each in fields(Outcome)}
    with replacing(path) as temporary:
        pq.write_table(pa.table(columns, _schema(sweep)), temporary, compression="zstd")


def _schema(sweep: Sweep) -> pa.Schema:
    """The columns: labels of the cases, then the fields of ``Outcome``."""
    columns = {name: type(value) for name, value in next(sweep.cases()).labels.items()}
    for name, hint in get_type_hints(Outcome).items():
        columns.setdefault(name, get_args(hint)[0] if get_args(hint) else hint)
    metadata = {_KEY: json.dumps(sweep.description(), sort_keys=True).encode()}
    return pa.schema([(name, _TYPES[kind]) for name, kind in columns.items()], metadata=metadata)


def _check_same(path: Path, recorded: Mapping[str, object], wanted: Mapping[str, object]) -> None:
    """Raise unless both descriptions are of the same sweep."""
    for key in {**wanted, **recorded}:
        if (one := recorded.get(key)) != (other := wanted.get(key)):
            difference = f"{key} is {one} there and {other} here"
            if max(len(str(one)), len(str(other))) > _LONGEST:
                difference = f"its {key} is another"
            raise UsageError(f"{path}: holds another sweep: {difference}; name another file")


def run_missing(
    sweep: Sweep,
    path: Path,
    outcomes: dict[int, Outcome],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> None:
    """Run the cases that are not in ``outcomes`` yet, and write all outcomes to the file.

    Args:
        sweep: what is swept.
        path: the file of outcomes, also written after errors and interrupts.
        outcomes: by the numbers of their cases; new ones are added.
        jobs: processes on this machine; None for as many as it has cores.
        scheduler: address of a Dask scheduler, whose workers run the cases instead.
        progress: called with the number of outcomes.

    Raises:
        UsageError: a package is missing, or the scheduler cannot be used.
        SweepError: processes have died.
        OutputError: the disk of the file is full or gone.
        KeyboardInterrupt: with a line on what is done.
    """
    missing = [*sweep.batches(outcomes)]
    if not missing:
        return
    before = len(outcomes)
    progress(before)
    due = time.monotonic() + PERIOD
    try:
        with closing(run_batches(missing, jobs=jobs, scheduler=scheduler)) as finished:
            for outcome in finished:
                outcomes[outcome.case] = outcome
                progress(len(outcomes))
                if (start := time.monotonic()) >= due:
                    write_outcomes(path, sweep, outcomes)
                    end = time.monotonic()
                    due = end + max(PERIOD, LOAD * (end - start))
    except KeyboardInterrupt:
        done = f"{len(outcomes)} of {sweep.size} cases are done; the same command goes on"
        raise KeyboardInterrupt(done) from None
    finally:
        if len(outcomes) > before:
            write_outcomes(path, sweep, outcomes)
