"""``single`` compiled by ``numba``: the same numbers in a quarter of the time.

Compiling takes half a minute, once: ``numba`` keeps the machine code beside this file, or in the
user's cache where that is read-only. Where it can be kept nowhere, every start takes as long.
"""

import hashlib
import math
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TypeAlias, cast

import numpy as np

from impact_observer.dynamics import sizes
from impact_observer.dynamics.flow import scales
from impact_observer.errors import UsageError
from impact_observer.estimation import joint, likelihood, saltation, single, square_root
from impact_observer.estimation.single import Contact, Fit, State
from impact_observer.estimation.square_root import product, triangular
from impact_observer.states import Matrix

Single: TypeAlias = Callable[[float, float, State, float, Contact], tuple[bool, State, Fit]]
_SOURCES = (single, likelihood, joint, square_root, scales, saltation, sys.modules[__name__])
"""The modules of all functions that are compiled, and of their constants."""


@cache
def compiled_single() -> Single:
    """``single.single``, compiled.

    Raises:
        UsageError: ``numba`` is not installed, or cannot be loaded.
    """
    try:
        import numba  # noqa: PLC0415 (half a second that only this takes)
        from numba import types  # noqa: PLC0415
        from numba.extending import overload, register_jitable  # noqa: PLC0415
    except (ImportError, OSError) as error:  # OSError: llvmlite without its library
        raise UsageError(
            f"compiled needs numba ({error}): pip install impact_observer[compiled], or leave"
            " compiled out"
        ) from None
    overload(triangular)(_triangular)
    for part in (product, sizes, single.length, single.corrected, single.jumped, single.single):
        register_jitable(part)
    number, truth = types.float64, types.boolean
    vector, matrix, maps = (types.Array(number, k, "C") for k in (1, 2, 3))
    state = types.Tuple((vector, matrix, matrix))
    gap, jump = types.Tuple((matrix, matrix, matrix, number)), types.Tuple((matrix, maps))
    forces, scale = types.Tuple((vector, matrix)), types.UniTuple(matrix, 4)
    contact = types.Tuple((forces, gap, jump, scale, number))
    result = types.Tuple((truth, state, types.UniTuple(number, 4)))
    # With its signature, so that nothing is compiled while an event waits.
    signature = result(number, number, state, number, contact)
    run = _from(_digest(_SOURCES))
    try:
        made = numba.njit(signature, cache=True)(run)
    except (RuntimeError, OSError):  # nothing can be kept: no folder to write to, a full disk
        made = numba.njit(signature)(run)
    return cast("Single", made)


def _from(sources: str) -> Single:
    """``single.single``, bound to the digest of its ``sources``.

    ``numba`` takes machine code from its cache while the file of a function and what is bound to
    it are the same. It does not notice changes of the functions that this one calls.
    """

    def run(
        t: float, flown: float, prior: State, clock: float, contact: Contact
    ) -> tuple[bool, State, Fit]:
        _ = sources  # no assertion: python -O would leave it out, and with it what is bound
        return single.single(t, flown, prior, clock, contact)

    return run


def _digest(modules: tuple[ModuleType, ...]) -> str:
    """A digest of the source of ``modules``."""
    found = hashlib.sha256()
    for module in modules:
        assert module.__file__ is not None, "it has one"
        found.update(Path(module.__file__).read_bytes())
    return found.hexdigest()


def _triangular(root: Matrix) -> Callable[[Matrix], Matrix]:
    """The implementation of ``triangular`` for ``numba``."""
    del root
    return _reflected


def _reflected(root: Matrix) -> Matrix:
    """``triangular`` by Householder's reflections, as LAPACK does it.

    The QR of ``numba`` computes Q too, and takes three times as long.
    """
    d, columns = root.shape
    left = np.zeros((d, max(d, columns)))
    left[:, :columns] = root
    for k in range(d):
        largest = np.abs(left[k, k + 1 :]).max() if k + 1 < left.shape[1] else 0.0
        if largest == 0.0:
            continue
        first, size = left[k, k], max(largest, abs(left[k, k]))
        length = 0.0
        for each in left[k, k:]:
            length += (each / size) ** 2
        end = -math.copysign(size * math.sqrt(length), first)
        along = (end - first) / end
        for j in range(k + 1, left.shape[1]):
            left[k, j] /= first - end
        for i in range(k + 1, d):
            seen = left[i, k]
            for j in range(k + 1, left.shape[1]):
                seen += left[i, j] * left[k, j]
            seen *= along
            left[i, k] -= seen
            for j in range(k + 1, left.shape[1]):
                left[i, j] -= seen * left[k, j]
        left[k, k], left[k, k + 1 :] = end, 0.0
    found: Matrix = left[:, :d].copy()
    return found
