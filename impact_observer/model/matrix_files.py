# SPDX-License-Identifier: Apache-2.0
"""Files beside a model file, and matrices in them."""

import gzip
import math
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_observer.errors import ModelError
from impact_observer.input_files import open_input
from impact_observer.states import Matrix

_MOST_TEXT, _MOST_NUMBERS = 200_000_000, 100_000_000
"""Bytes of the text of a matrix, unpacked, and numbers in a matrix: more take minutes to read."""


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
            matrix = read(file)
        if matrix.dtype.kind not in "fiu":  # numpy would drop an imaginary part with a warning
            raise ValueError(f"holds {matrix.dtype} values, expected real numbers")
        return np.asarray(matrix, dtype=np.float64)
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
