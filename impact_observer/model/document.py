# SPDX-License-Identifier: Apache-2.0
"""Checked values of a model file; every error names the key of the value."""

import gzip
import math
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from impact_observer.errors import ModelError
from impact_observer.input_files import open_input
from impact_observer.model.gone_keys import problem_with
from impact_observer.states import Matrix, Vector, frozen

LARGEST = 1e15
"""Largest magnitude of any number of a model, SI units; products of larger numbers overflow."""
_MOST_TEXT, _MOST_NUMBERS = 200_000_000, 100_000_000
"""Bytes of the text of a matrix, unpacked, and numbers in a matrix: more take minutes to read."""
Value: TypeAlias = object
"""Any value in a YAML file."""


class Section:
    """A mapping in a model file, with the key of the mapping and the allowed member keys."""

    def __init__(self, key: str, value: Value, allowed: Sequence[str]) -> None:
        """Take the ``value`` of ``key``.

        Raises:
            ModelError: ``value`` is not a mapping, or has a key that is not ``allowed``.
        """
        if not isinstance(value, Mapping):
            raise ModelError(key, f"{_shown(value)} found; expected keys: {', '.join(allowed)}")
        self._key = key
        self._values = value
        for name in value:
            if name not in allowed:
                raise ModelError(
                    self.key(str(name)), problem_with(self.key(str(name)), ", ".join(allowed))
                )

    def __contains__(self, name: str) -> bool:
        """Whether the key is present."""
        return name in self._values

    @property
    def place(self) -> str:
        """The key of the mapping, such as ``contacts[0]``."""
        return self._key

    def key(self, name: str) -> str:
        """The whole key of ``name``, such as ``contacts[0].gap``."""
        return f"{self._key}.{name}" if self._key else name

    def value(self, name: str) -> Value:
        """The value of the key ``name``.

        Raises:
            ModelError: the mapping has no such key.
        """
        if name not in self._values:
            raise ModelError(self.key(name), "is missing")
        return self._values[name]

    def text(self, name: str) -> str:
        """The non-empty string at the key ``name``."""
        value = self.value(name)
        if not isinstance(value, str) or not value:
            raise ModelError(self.key(name), f"{_shown(value)} found; expected a name")
        if not value.isprintable():
            raise ModelError(self.key(name), f"{value!r} has characters that cannot be printed")
        return value

    def number(self, name: str, default: float | None = None) -> float:
        """The number at the key ``name``; ``default``, if given, where the key is absent."""
        if default is not None and name not in self:
            return default
        return number(self.key(name), self.value(name))

    def positive(self, name: str, *, or_zero: bool = False) -> float:
        """The positive number at the key ``name``; zero is allowed with ``or_zero``."""
        value = self.number(name)
        if not (value > 0 or (or_zero and value == 0)):
            wanted = "a number not below zero" if or_zero else "a positive number"
            raise ModelError(self.key(name), f"is {value:g}; expected {wanted}")
        return value

    def items(self, name: str) -> list[tuple[str, Value]]:
        """The members of a list with their keys; an empty list where the key is absent."""
        if name not in self:
            return []
        value = self.value(name)
        if not isinstance(value, list):
            raise ModelError(self.key(name), f"{_shown(value)} found; expected a list")
        return [(f"{self.key(name)}[{i}]", item) for i, item in enumerate(value)]

    def vector(self, name: str, n: int, *, optional: bool = False, meaning: str = "") -> Vector:
        """``n`` numbers, shape (n,); zeros where the key is absent and ``optional``.

        ``meaning`` follows the expected number of numbers in errors.
        """
        if optional and name not in self:
            return np.zeros(n)
        return numbers(self.key(name), self.value(name), n, meaning)

    def matrix(self, name: str, n: int, folder: Path | None) -> Matrix:
        """An ``n`` x ``n`` matrix: rows, or the path of a ``.npy`` or Matrix Market file."""
        value = self.value(name)
        if isinstance(value, str):
            return load_matrix(self.key(name), value, folder)
        if not isinstance(value, list) or len(value) != n:
            given = f"{len(value)} rows" if isinstance(value, list) else _shown(value)
            raise ModelError(self.key(name), f"{given} found; expected {n} rows of {n} numbers")
        return np.array([numbers(f"{self.key(name)}[{i}]", row, n) for i, row in enumerate(value)])


def number(key: str, value: Value) -> float:
    """``value`` as a finite float.

    Raises:
        ModelError: ``value`` is not a number (a boolean is not), not finite or too large.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ModelError(key, f"{_shown(value)} found; expected a number")
    if isinstance(value, float) and not math.isfinite(value):
        raise ModelError(key, "is not finite; expected a number")
    if abs(value) > LARGEST:
        raise ModelError(key, f"is too large; expected at most {LARGEST:g}")
    return float(value)


def numbers(key: str, value: Value, n: int, meaning: str = "") -> Vector:
    """``value`` as a vector of ``n`` numbers; ``meaning`` follows these words in errors.

    Raises:
        ModelError: ``value`` is no list, has another length or a member that is not a number.
    """
    if not isinstance(value, list) or len(value) != n:
        given = f"{len(value)} values" if isinstance(value, list) else _shown(value)
        raise ModelError(key, f"{given} found; expected a list of {n} numbers{meaning}")
    return np.array([number(f"{key}[{i}]", item) for i, item in enumerate(value)])


def finite(key: str, values: ArrayLike, shape: tuple[int, ...], what: str) -> Vector:
    """``values`` as a frozen array of ``shape``; ``what`` names the expected value in errors.

    Raises:
        ModelError: ``values`` have another shape, or a value that is no finite number or too
            large.
    """
    try:
        array = frozen(values)
    except (TypeError, ValueError):
        raise ModelError(key, f"is not made of numbers only; expected {what}") from None
    if array.shape != shape:
        given = " x ".join(map(str, array.shape)) or "a single number"
        raise ModelError(key, f"has shape {given}; expected {what}")
    sizes = np.abs(array)
    if (sizes <= LARGEST).all():
        return array
    unfit = sizes > LARGEST
    why = f"is too large; expected at most {LARGEST:g}"
    if not np.all(np.isfinite(array)):
        unfit, why = ~np.isfinite(array), "is not finite; expected a number"
    index = "".join(f"[{i}]" for i in np.argwhere(unfit)[0])
    raise ModelError(f"{key}{index}", why)


def check_names(key: str, names: Sequence[object], least: str = "") -> None:
    """Check names that must differ; ``least`` says of what at least one is needed.

    Raises:
        ModelError: at ``key`` with the index of the wrong name.
    """
    for i, name in enumerate(names):
        if not isinstance(name, str) or not name:
            raise ModelError(f"{key}[{i}]", f"{name!r:.40} is not a name; give a non-empty string")
        if not name.isprintable():
            raise ModelError(f"{key}[{i}]", f"{name!r} has characters that cannot be printed")
        if name in names[:i]:
            raise ModelError(f"{key}[{i}]", f"{name!r} is taken already; names must differ")
    if least and not names:
        raise ModelError(key, f"is empty; expected {least}")


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


def load_matrix(key: str, relative: str, folder: Path | None) -> Matrix:
    """The dense matrix in a ``.npy`` or Matrix Market file, relative to the model file.

    Raises:
        ModelError: the file is missing, has another format or is not readable.
    """
    path = file_beside(key, relative, folder)
    readers = {".npy": _read_npy, ".mtx": _read_matrix_market, ".gz": _read_matrix_market}
    if (read := readers.get(path.suffix)) is None:
        raise ModelError(key, f"names {relative}; expected a .npy or Matrix Market (.mtx) file")
    try:
        with open_input(path) as file:
            return _real(read(file))
    except Exception as error:  # noqa: BLE001 (numpy and scipy raise anything)
        raise ModelError(key, f"{path} cannot be read: {error}") from None


def _read_npy(file: BinaryIO) -> NDArray[np.generic]:
    """The array in a file of numpy.

    Raises:
        ValueError: the file is none, or is not as large as its header says.
    """
    version = np.lib.format.read_magic(file)
    read_header = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, kind = read_header(file)
    begin = file.tell()
    there, wanted = file.seek(0, 2) - begin, math.prod(shape) * kind.itemsize
    if there < wanted:
        raise ValueError(f"its header promises {wanted:.6g} bytes, {there} are there")
    _check_size(math.prod(shape))
    file.seek(0)
    return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _read_matrix_market(file: BinaryIO) -> NDArray[np.generic]:
    """The matrix in a Matrix Market file, which may be compressed by gzip.

    Raises:
        ValueError: the matrix or its text is too large.
    """
    packed = file.read(2) == b"\x1f\x8b"
    file.seek(0)
    with gzip.open(file) if packed else file as source:
        text = source.read(_MOST_TEXT + 1)
    if len(text) > _MOST_TEXT:
        raise ValueError(f"more than {_MOST_TEXT / 1e6:g} MB of text; write a .npy file")
    rows, columns, *_ = scipy.io.mminfo(BytesIO(text))
    _check_size(rows * columns)
    matrix = scipy.io.mmread(BytesIO(text))
    return np.asarray(matrix.toarray() if scipy.sparse.issparse(matrix) else matrix)


def _check_size(count: int) -> None:
    """Raise ValueError for a matrix of more numbers than that of any model."""
    if count > _MOST_NUMBERS:
        raise ValueError(f"{count:.6g} numbers; expected at most {_MOST_NUMBERS:g}")


def _real(matrix: NDArray[np.generic]) -> Matrix:
    """``matrix`` as floats.

    Raises:
        ValueError: ``matrix`` is not real; numpy would drop the imaginary part with a warning.
    """
    if matrix.dtype.kind not in "fiu":
        raise ValueError(f"holds {matrix.dtype} values, expected real numbers")
    return np.asarray(matrix, dtype=np.float64)


def _shown(value: Value) -> str:
    if value is None:
        return "nothing"
    shown = repr(value)
    return shown if len(shown) <= 40 else shown[:37] + "..."
