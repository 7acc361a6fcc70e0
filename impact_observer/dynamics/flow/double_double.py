# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Products of matrices in twice the digits.

Few numbers in a row, as in those of chains and of finite elements, are multiplied one by one, each
product exact by Dekker's splitting (Numer. Math. 18, 1971). Otherwise matrices are cut into parts
with so few bits that products of parts are exact (Ozaki et al., Numer. Algorithms 59, 2012).
"""

from collections.abc import Iterator
from math import ceil, log2
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Matrix, Vector

_FEW = 16
"""Numbers in a row that are multiplied one by one."""
_SLICES = 4
"""Parts that a matrix is cut into."""
_ENTRIES = 1 << 16
"""Products of numbers that are held at once: as many as stay in a processor's cache."""
_LARGEST = 1 << 22
"""The same of products of parts."""
_SPLITTER = 2.0**27 + 1

Array = NDArray[np.float64]


class Double(NamedTuple):
    """Numbers as sums of two, of any shape.

    Attributes:
        high: the numbers.
        low: what they were rounded by.
    """

    high: Array
    low: Array

    @property
    def total(self) -> Array:
        """The numbers, rounded."""
        return np.asarray(self.high + self.low)

    def columns(self, which: slice) -> "Double":
        """Some columns of a matrix."""
        return Double(self.high[:, which], self.low[:, which])

    def plus(self, other: "Double") -> "Double":
        """The sum with numbers of the same shape."""
        high, low = _sum(self.high, other.high)
        return Double(high, low + (self.low + other.low))

    def times(self, factors: Array) -> "Double":
        """The product with plain numbers."""
        high, low = _times(self.high, factors)
        return Double(high, low + self.low * factors)


def dots(X: Matrix, Y: Double) -> Double:
    """Products of each column of ``X`` with that of ``Y``, shape (columns,)."""
    high, low = np.empty((2, X.shape[1]))
    for block in _blocks(X.shape[1], len(X)):
        high[block], low[block] = _total(Y.columns(block).times(X[:, block]))
    return Double(high, low)


def difference(Y: Double, Z: Double, factors: Vector) -> Matrix:
    """``Y - Z diag(factors)``, rounded, of what may be nearly the same."""
    found = np.empty(Y.high.shape)
    for block in _blocks(len(factors), len(found)):
        other = Z.columns(block).times(-factors[block])
        found[:, block] = Y.columns(block).plus(other).total
    return found


def _blocks(columns: int, rows: int, most: int = _ENTRIES) -> Iterator[slice]:
    """Groups of columns, each with at most ``most`` entries."""
    at_once = max(1, most // rows)
    for start in range(0, columns, at_once):
        yield slice(start, start + at_once)


def product(A: Matrix, B: Matrix) -> Double:
    """``A B``."""
    width = int(np.count_nonzero(A, axis=1).max())
    if width > _FEW:
        return _product_of_parts(A, B)
    # Whatever is not zero stands first; where rows have less, zeros are multiplied too.
    columns = np.argsort(A == 0, axis=1, kind="stable")[:, : max(width, 1)]
    factors = np.take_along_axis(A, columns, axis=1).T[..., None]
    high, low = np.empty((2, len(A), B.shape[1]))
    for block in _blocks(B.shape[1], columns.size):
        terms = B[:, block][columns.T]
        high[:, block], low[:, block] = _total(Double(*_times(factors, terms)))
    return Double(high, low)


def _product_of_parts(A: Matrix, B: Matrix) -> Double:
    bits = (53 - ceil(log2(A.shape[1] + 1))) // 2
    left, right = _parts(A, bits), _parts(B.T, bits).transpose(0, 2, 1)
    high, low = np.empty((2, len(A), B.shape[1]))
    for block in _blocks(B.shape[1], _SLICES**2 * len(A), _LARGEST):
        each = left[:, None] @ right[None, ..., block]
        terms = each.reshape(_SLICES**2, len(A), -1)
        high[:, block], low[:, block] = _total(Double(terms, np.zeros(terms.shape)))
    return Double(high, low)


def _parts(A: Matrix, bits: int) -> Array:
    """``A`` as a sum, each part with ``bits`` bits below the largest number of its row."""
    parts = np.empty((_SLICES, *A.shape))
    for part in parts:
        _, exponent = np.frexp(np.abs(A).max(axis=1, keepdims=True))
        shift = np.ldexp(1.0, exponent + 53 - bits)
        np.subtract(A + shift, shift, out=part)
        A = A - part
    return parts


def _total(terms: Double) -> Double:
    """Sums along the first axis, two by two."""
    high, low = terms.high, terms.low.sum(axis=0)
    while len(high) > 1:
        half = len(high) // 2
        paired, rest = _sum(high[:half], high[half : 2 * half])
        low += rest.sum(axis=0)
        high = np.concatenate([paired, high[2 * half :]]) if len(high) % 2 else paired
    return Double(*_sum(high[0], low))


def _sum(a: Array, b: Array) -> tuple[Array, Array]:
    """``a + b`` and what it was rounded by (Knuth)."""
    total = a + b
    virtual = total - a
    return total, (a - (total - virtual)) + (b - virtual)


def _times(a: Array, b: Array) -> tuple[Array, Array]:
    """``a b`` and what it was rounded by (Dekker)."""
    total = a * b
    (a, a_low), (b, b_low) = _halves(a), _halves(b)
    return total, ((a * b - total) + a * b_low + a_low * b) + a_low * b_low


def _halves(a: Array) -> tuple[Array, Array]:
    """``a`` as a sum of two numbers of half of its bits."""
    scaled = _SPLITTER * a
    high = scaled - (scaled - a)
    return high, a - high
