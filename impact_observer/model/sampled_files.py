# SPDX-License-Identifier: Apache-2.0
"""Sampled signals of a model file: a CSV file beside the model file, or a table inside."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from msgspec import UnsetType

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import LARGEST, Value, matrix
from impact_observer.model.force_samples import Samples
from impact_observer.model.matrix_files import file_beside
from impact_observer.model.schema import SampledForces, TableKeys
from impact_observer.resources import read_text
from impact_observer.states import Matrix

_TIME = "time"


def read_samples(
    forcing: SampledForces, coordinates: Sequence[str], folder: Path | None
) -> Samples | None:
    """The samples of the key ``forcing``; None without any.

    Forces are in the order of ``coordinates``. A coordinate without a column has zero force. CSV
    files lie in ``folder``.

    Raises:
        ModelError: a value is wrong; the error names the key, or file, line and column.
    """
    given, hold, key = forcing.sampled, forcing.hold, "forcing.sampled"
    if isinstance(given, UnsetType):
        if not isinstance(hold, UnsetType):
            raise ModelError("forcing.hold", "stands without sampled")
        return None
    if isinstance(hold, UnsetType):
        raise ModelError("forcing.hold", "is missing; expected previous or linear")
    if isinstance(given, TableKeys):
        shape = len(given.time), len(coordinates)
        return Samples(np.array(given.time), matrix(f"{key}.force", given.force, shape), hold)
    table = read_table(key, given, coordinates, folder)
    try:
        return Samples(table[:, 0], table[:, 1:], hold)
    except ModelError as error:
        raise ModelError(key, f"{_source(given)}: {error.problem}") from None


def _source(value: str) -> str:
    return "its table" if "\n" in value else value


def read_table(key: str, value: str, columns: Sequence[str], folder: Path | None) -> Matrix:
    """Instants and ``columns`` of a CSV file or of CSV text, shape (k, 1 + columns).

    A missing column is zero. At least one of the columns must be present.

    Raises:
        ModelError: a value is wrong; the error names key, file, line and column.
    """
    try:
        text = value if "\n" in value else read_text(file_beside(key, value, folder))
        return _read_csv(io.StringIO(text, newline=""), columns)
    except ModelError:
        raise
    except (UsageError, ValueError, csv.Error) as error:
        raise ModelError(key, f"{_source(value)}: {error}") from None


def _read_csv(text: Iterable[str], coordinates: Sequence[str]) -> Matrix:
    """Time and forces in the order of ``coordinates``, shape (k, 1 + n)."""
    reader, wanted = csv.reader(text), [_TIME, *coordinates]
    header = [name.strip() for name in next(reader, [])]
    if _TIME in coordinates:
        raise ValueError(f"a coordinate is named {_TIME!r} as the column of instants; rename it")
    if _TIME not in header:
        raise ValueError(f"column {_TIME!r} is missing; expected {', '.join(wanted)}")
    if len(header) < 2:
        raise ValueError(f"only the column {_TIME!r} found; expected some of {', '.join(wanted)}")
    for i, name in enumerate(header):
        if name not in wanted:
            raise ValueError(f"column {name!r} is not known; expected {', '.join(wanted)}")
        if name in header[:i]:
            raise ValueError(f"column {name!r} stands there twice")
    rows = [_numbers(reader.line_num, row, header) for row in reader if row]
    table = np.zeros((len(rows), len(wanted)))
    table[:, [wanted.index(name) for name in header]] = np.reshape(rows, (-1, len(header)))
    return table


def _numbers(line: int, row: list[str], header: list[str]) -> list[float]:
    """The numbers in a ``row``, which ends at ``line``."""
    if len(row) != len(header):
        raise ValueError(f"line {line} has {len(row)} values; expected {len(header)}")
    numbers = []
    for name, value in zip(header, row, strict=True):
        try:
            numbers.append(float(value))
        except ValueError:
            numbers.append(math.nan)
        if not abs(numbers[-1]) <= LARGEST:  # false for NaN, too
            raise ValueError(
                f"line {line}, column {name}: {value.strip()!r} found; expected a number of at"
                f" most {LARGEST:g}"
            )
    return numbers


def written_samples(samples: Samples | None, coordinates: Sequence[str]) -> dict[str, Value]:
    """The keys from which ``read_samples`` makes ``samples``: CSV text, or lists for odd names."""
    if samples is None:
        return {}
    plain = all(name.isprintable() and name == name.strip() for name in coordinates)
    table: Value = {"time": samples.time.tolist(), "force": samples.force.tolist()}
    if plain and _TIME not in coordinates:
        table = csv_text(np.column_stack([samples.time, samples.force]), coordinates)
    return {"sampled": table, "hold": samples.hold}


def csv_text(table: Matrix, columns: Sequence[str]) -> str:
    """The CSV of instants and ``columns``, shape (k, 1 + columns)."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_TIME, *columns])
    writer.writerows(table.tolist())
    return text.getvalue()
