# SPDX-License-Identifier: Apache-2.0
"""Sampled forcing of a model file: a CSV file beside the model file, or a table inside."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import (
    LARGEST,
    Section,
    Value,
    file_beside,
    number,
    numbers,
)
from impact_observer.model.force_samples import HOLDS, Samples
from impact_observer.resources import read_text
from impact_observer.states import Matrix

KEYS = ("sampled", "hold")
_TIME = "time"


def read_samples(
    section: Section, coordinates: Sequence[str], folder: Path | None
) -> Samples | None:
    """The samples of a ``section`` with ``sampled`` and ``hold``; None without these keys.

    Forces are in the order of ``coordinates``. A coordinate without a column has zero force. CSV
    files lie in ``folder``.

    Raises:
        ModelError: a value is wrong; the error names the key, or file, line and column.
    """
    if "sampled" not in section:
        if "hold" in section:
            raise ModelError(section.key("hold"), "stands without sampled")
        return None
    hold = section.text("hold")
    if hold not in HOLDS:
        raise ModelError(section.key("hold"), f"{hold!r} found; expected {' or '.join(HOLDS)}")
    key, value = section.key("sampled"), section.value("sampled")
    if isinstance(value, str):
        table = read_table(section, "sampled", coordinates, folder)
        try:
            return Samples(table[:, 0], table[:, 1:], hold)
        except ModelError as error:
            source = "its table" if "\n" in value else value
            raise ModelError(key, f"{source}: {error.problem}") from None
    inline = Section(key, value, ("time", "force"))
    time = _column(inline.key("time"), inline.value("time"))
    rows = [numbers(at, row, len(coordinates)) for at, row in inline.items("force")]
    if len(rows) != len(time):
        raise ModelError(inline.key("force"), f"{len(rows)} rows found for {len(time)} times")
    return Samples(time, np.reshape(rows, (-1, len(coordinates))), hold)


def read_table(section: Section, name: str, columns: Sequence[str], folder: Path | None) -> Matrix:
    """Instants and ``columns`` of a CSV file or of CSV text, shape (k, 1 + columns).

    A missing column is zero. At least one of the columns must be present.

    Raises:
        ModelError: a value is wrong; the error names key, file, line and column.
    """
    key, value = section.key(name), section.value(name)
    if not isinstance(value, str):
        raise ModelError(key, f"{value!r} found; expected the name of a CSV file")
    source = "its table" if "\n" in value else value
    lines = io.StringIO(value) if "\n" in value else _lines(key, value, folder)
    try:
        return _read_csv(lines, columns)
    except (ValueError, csv.Error) as error:
        raise ModelError(key, f"{source}: {error}") from None


def _column(key: str, value: Value) -> Matrix:
    if not isinstance(value, list):
        raise ModelError(key, "is not a list; expected instants, s since the epoch")
    return np.array([number(f"{key}[{i}]", item) for i, item in enumerate(value)])


def _lines(key: str, relative: str, folder: Path | None) -> list[str]:
    path = file_beside(key, relative, folder)
    try:
        return read_text(path).splitlines(keepends=True)
    except UsageError as error:
        raise ModelError(key, str(error)) from None


def _read_csv(text: Iterable[str], coordinates: Sequence[str]) -> Matrix:
    """Time and forces in the order of ``coordinates``, shape (k, 1 + n)."""
    reader = csv.reader(text)
    header = [name.strip() for name in next(reader, [])]
    order = _order(header, coordinates)
    rows = [_numbers(reader.line_num, row, header) for row in reader if row]
    table = np.zeros((len(rows), 1 + len(coordinates)))
    table[:, order] = np.reshape(rows, (-1, len(header)))
    return table


def _order(header: list[str], coordinates: Sequence[str]) -> list[int]:
    """The place of each column of ``header`` in a table of time and ``coordinates``."""
    if _TIME in coordinates:
        raise ValueError(f"a coordinate is named {_TIME!r} as the column of instants; rename it")
    wanted = [_TIME, *coordinates]
    if _TIME not in header:
        raise ValueError(f"column {_TIME!r} is missing; expected {', '.join(wanted)}")
    for i, name in enumerate(header):
        if name not in wanted:
            raise ValueError(f"column {name!r} is not known; expected {', '.join(wanted)}")
        if name in header[:i]:
            raise ValueError(f"column {name!r} stands there twice")
    if len(header) < 2:
        raise ValueError(f"only the column {_TIME!r} found; expected some of {', '.join(wanted)}")
    return [wanted.index(name) for name in header]


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
    """The values of ``KEYS`` for ``samples``: CSV text, or lists for unusual names."""
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
