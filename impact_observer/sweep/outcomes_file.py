"""The outcomes of a sweep in one Parquet file, by ``pyarrow``; it is whole at any time.

A row a case, in order of their numbers: what tells it from other cases, then its figures. The
metadata say what sweep it is. The file is written anew beside itself and then put in its place,
so that readers and crashes never see half of one, and equal outcomes make equal files.
"""

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from impact_observer.errors import SweepError, UsageError
from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.plan import Case, Sweep

_KEY = b"impact_observer.sweep"
_TYPES = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
_LONGEST = 60
"""Most letters of a value that is told in an error."""
_COUNTS = ("events", "impacts_used", "switches_rejected", "impacts_inserted")


def read_outcomes(path: Path, sweep: Sweep) -> dict[int, Outcome]:
    """The outcomes in a file, by the numbers of their cases; none where there is no file.

    Raises:
        UsageError: the file is none of ``sweep``, and must not be replaced.
    """
    if not path.exists():
        return {}
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        line = " ".join(str(error).split())
        raise UsageError(f"{path}: exists and is no sweep ({line}); name another file") from None
    found = (table.schema.metadata or {}).get(_KEY)
    if found is None:
        raise UsageError(f"{path}: exists and is no sweep; name another file")
    _check_same(path, json.loads(found), sweep.description())
    names = [field.name for field in fields(Outcome)]
    return {row["case"]: Outcome(**row) for row in table.select(names).to_pylist()}


def write_outcomes(path: Path, sweep: Sweep, outcomes: Mapping[int, Outcome]) -> None:
    """Write the file anew, all at once.

    Raises:
        SweepError: it cannot be written.
    """
    columns: dict[str, list[object]] = {name: [] for name in _schema(sweep).names}
    for case in sweep.cases():
        if case.number in outcomes:
            for name, value in _row(case, outcomes[case.number]).items():
                columns[name].append(value)
    beside = path.with_name(f".{path.name}.part")
    try:
        table = pa.Table.from_pydict(columns, schema=_schema(sweep))
        pq.write_table(table, beside, compression="zstd")
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise SweepError(f"{path}: cannot be written: {error.strerror or error}") from None


def _schema(sweep: Sweep) -> pa.Schema:
    """The columns, the same for any outcomes of a sweep."""
    labels = next(sweep.cases()).labels
    columns = {name: _TYPES[type(value)] for name, value in labels.items()}
    for field in fields(Outcome):
        kind = pa.int64() if field.name in _COUNTS else pa.float64()
        columns.setdefault(field.name, pa.string() if field.name == "error" else kind)
    metadata = {_KEY: json.dumps(sweep.description(), sort_keys=True).encode()}
    return pa.schema([*columns.items()], metadata=metadata)


def _row(case: Case, outcome: Outcome) -> dict[str, object]:
    """What stands in the row of a case."""
    return {**case.labels, **{f.name: getattr(outcome, f.name) for f in fields(Outcome)}}


def _check_same(path: Path, there: Mapping[str, object], wanted: Mapping[str, object]) -> None:
    """Raise unless a file is of the same sweep."""
    for key in {**wanted, **there}:
        if (one := there.get(key)) != (other := wanted.get(key)):
            told = f"{key} is {one} there and {other} here"
            if max(len(str(one)), len(str(other))) > _LONGEST:
                told = f"its {key} is another"
            raise UsageError(f"{path}: holds another sweep: {told}; name another file")
