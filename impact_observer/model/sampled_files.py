"""Sampled forcing of a model file: a CSV file beside it, or a table inside it."""

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
from impact_observer.model.forcing import Forcing
from impact_observer.resources import read_text
from impact_observer.states import Matrix

KEYS = ("sampled", "hold")
_TIME = "time"


def sampled_forcing(
    section: Section, coordinates: Sequence[str], folder: Path | None
) -> Forcing | None:
    """The forcing of a ``section`` {sampled, hold}; None where it is not sampled.

    Forces are in the order of ``coordinates``; CSV files lie in ``folder``.

    Raises:
        ModelError: naming the key, or the file with its line and column.
    """
    if "sampled" not in section:
        if "hold" in section:
            raise ModelError(section.key("hold"), "stands without sampled")
        return None
    for name in ("constant", "harmonics"):
        if name in section:
            raise ModelError(
                section.key(name), "stands beside sampled; add it to the samples instead"
            )
    hold = section.text("hold")
    if hold not in HOLDS:
        raise ModelError(section.key("hold"), f"{hold!r} found; expected {' or '.join(HOLDS)}")
    key, value = section.key("sampled"), section.value("sampled")
    if isinstance(value, str):
        source = "its table" if "\n" in value else value
        lines = io.StringIO(value) if "\n" in value else _lines(key, value, folder)
        try:
            table = _read_csv(lines, coordinates)
            return Forcing.of_samples(Samples(table[:, 0], table[:, 1:], hold))
        except ModelError as error:
            raise ModelError(key, f"{source}: {error.problem}") from None
        except (ValueError, csv.Error) as error:
            raise ModelError(key, f"{source}: {error}") from None
    inline = Section(key, value, ("time", "force"))
    time = _column(inline.key("time"), inline.value("time"))
    rows = [numbers(at, row, len(coordinates)) for at, row in inline.items("force")]
    if len(rows) != len(time):
        raise ModelError(inline.key("force"), f"{len(rows)} rows found for {len(time)} times")
    return Forcing.of_samples(Samples(time, np.reshape(rows, (-1, len(coordinates))), hold))


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
    return np.reshape(rows, (-1, len(header)))[:, order]


def _order(header: list[str], coordinates: Sequence[str]) -> list[int]:
    """The columns of time and coordinates in ``header``, which must name each once, no other."""
    if _TIME in coordinates:
        raise ValueError(f"a coordinate is named {_TIME!r} as the column of instants; rename it")
    wanted = [_TIME, *coordinates]
    for name in wanted:
        if name not in header:
            raise ValueError(f"column {name!r} is missing; expected {', '.join(wanted)}")
    for i, name in enumerate(header):
        if name not in wanted:
            raise ValueError(f"column {name!r} is not known; expected {', '.join(wanted)}")
        if name in header[:i]:
            raise ValueError(f"column {name!r} stands there twice")
    return [header.index(name) for name in wanted]


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
        if not abs(numbers[-1]) <= LARGEST:  # NaN neither
            raise ValueError(
                f"line {line}, column {name}: {value.strip()!r} found; expected a number of at"
                f" most {LARGEST:g}"
            )
    return numbers


def table_of(samples: Samples, coordinates: Sequence[str]) -> Value:
    """The value of ``sampled`` that reads back equal: CSV, or lists for unusual names."""
    plain = all(name.isprintable() and name == name.strip() for name in coordinates)
    if _TIME in coordinates or not plain:
        return {"time": samples.time.tolist(), "force": samples.force.tolist()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_TIME, *coordinates])
    writer.writerows(np.column_stack([samples.time, samples.force]).tolist())
    return text.getvalue()
