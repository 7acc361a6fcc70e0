"""Numbers of a model that check themselves, each mistake named by its key."""

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.errors import ModelError
from impact_observer.states import Vector, frozen

LARGEST = 1e15
"""Largest magnitude of any number of a model, SI units; beyond it products overflow."""


def finite(key: str, values: ArrayLike, shape: tuple[int, ...], what: str) -> Vector:
    """``values`` as a frozen array of ``shape``; ``what`` says it in words.

    Raises:
        ModelError: another shape, or a value that is no number, not finite or too large.
    """
    try:
        array = frozen(values)
    except (TypeError, ValueError):
        raise ModelError(key, f"is not made of numbers only; expected {what}") from None
    if array.shape != shape:
        found = " x ".join(map(str, array.shape)) or "a single number"
        raise ModelError(key, f"has shape {found}; expected {what}")
    if not np.all(np.isfinite(array)):
        at = "".join(f"[{i}]" for i in np.argwhere(~np.isfinite(array))[0])
        raise ModelError(f"{key}{at}", "is not finite; expected a number")
    if np.any(np.abs(array) > LARGEST):
        at = "".join(f"[{i}]" for i in np.argwhere(np.abs(array) > LARGEST)[0])
        raise ModelError(f"{key}{at}", f"is too large; expected at most {LARGEST:g}")
    return array
