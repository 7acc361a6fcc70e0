# SPDX-License-Identifier: Apache-2.0
"""Files beside a model file: matrices, and tables of what depends on time."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_observer.errors import ModelError, UsageError
from impact_observer.input_files import check_input
from impact_observer.model.document import LARGEST
from impact_observer.resources import read_text
from impact_observer.states import Matrix

TIME = "time"
"""The column of instants in a table."""


def file_beside(key: str, relative: str, folder: Path | None) -> Path:
    """The file that a model file in ``folder`` names.

    Raises:
        ModelError: the file does not exist, or the model was not read from a file.
    """
    if folder is None:
        raise ModelError(key, f"names the file {relative}; only a model file on disk may do so")
    path = folder / relative
    if not path.is_file():
        state = "is not a file" if path.exists() else "does not exist"
        raise ModelError(key, f"names the file {path}, which {state}")
    return path


def load_matrix(
    key: str, relative: str, folder: Path | None, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """The dense matrix of a ``shape`` in a ``.npy`` or Matrix Market file beside the model file.

    Raises:
        ModelError: the file is missing, not readable, or has something else.
    """
    path = file_beside(key, relative, folder)
    if path.suffix not in (".npy", ".mtx"):
        raise ModelError(key, f"names {relative}; expected a .npy or Matrix Market (.mtx) file")
    try:
        check_input(path)
        if path.suffix == ".npy":
            with np.errstate(over="raise"):  # the product of the sizes in its header
                matrix: NDArray[np.generic] = np.lib.format.open_memmap(path, mode="r")
        else:
            _check_shape(scipy.io.mminfo(str(path))[:2], shape)
            stored = scipy.io.mmread(str(path))
            matrix = stored.toarray() if scipy.sparse.issparse(stored) else stored
        _check_shape(matrix.shape, shape)
        if matrix.dtype.kind not in "fiu":  # numpy would drop an imaginary part with a warning
            raise ValueError(f"holds {matrix.dtype} values, expected real numbers")
        return np.array(matrix, dtype=np.float64)
    except Exception as error:  # noqa: BLE001 (numpy and scipy raise anything)
        raise ModelError(key, f"{path} cannot be read: {error}") from None


def _check_shape(found: tuple[int, ...], wanted: tuple[int, int]) -> None:
    if found != wanted:
        shown = (" x ".join(map(str, sizes)) for sizes in (found, wanted))
        raise ValueError("{} numbers found; expected {}".format(*shown))


def table_in(value: str) -> str:
    """What a table of a model file is called in errors: its file, or CSV text in the model."""
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
        raise ModelError(key, f"{table_in(value)}: {error}") from None


def _read_csv(text: Iterable[str], columns: Sequence[str]) -> Matrix:
    """Instants and ``columns``, in their order, shape (k, 1 + columns)."""
    reader, wanted = csv.reader(text), [TIME, *columns]
    header = [name.strip() for name in next(reader, [])]
    if TIME in columns:
        raise ValueError(f"a coordinate is named {TIME!r} as the column of instants; rename it")
    if TIME not in header:
        raise ValueError(f"column {TIME!r} is missing; expected {', '.join(wanted)}")
    if len(header) < 2:
        raise ValueError(f"only the column {TIME!r} found; expected some of {', '.join(wanted)}")
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


def table_text(table: Matrix, columns: Sequence[str]) -> str:
    """The CSV of instants and ``columns``, shape (k, 1 + columns)."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([TIME, *columns])
    writer.writerows(table.tolist())
    return text.getvalue()
