# SPDX-License-Identifier: Apache-2.0
"""Compares what commands give with the golden corpus, within the tolerances of each figure."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

EXACT = 1e-12
"""Of states of laws without covariance, over the largest state."""
OF_DEVIATION = 1e-3
"""Of states of ``minimum-variance`` and the smoother, in their published deviations."""
SMALL = 1e-8
"""The same over the largest state; the larger of both is allowed."""
TRUTH = 1e-9
"""Of a simulated motion, over the largest state."""
FIGURE = 1e-6
"""Relative, of a figure in JSON."""
STAMP = 2
"""Of a stamp, ns: a time between two nanoseconds is rounded to either."""
INNOVATION = 1e-3
"""Of an innovation, in standard deviations, absolute and relative: as states are known."""
ROUNDING = {
    r"/state parameter(_deviation)?\[": 1e-9,  # s: stamps are whole nanoseconds
    r"(shift\[\d+\]|residual|\.mean)$": 1e-14,  # s, of stamps that fit to 0.3 ns
    r"probability": 1e-4,  # of these residuals
    r"initial_state\[\d+\]$": 1e-11,  # a hundredth of its standard error
    r"singular_values": 1e-14,  # of a matrix whose largest one is about 1
}
"""Absolute tolerances of figures that are at rounding level, by a pattern of their name.

OpenBLAS with the kernels Prescott, Haswell and Zen differs by a tenth of these at most.
"""
PENETRATING = 0.5
"""Of an innovation where a contact is closed already: rounding over rounding."""


def leaves(name: str, value: object) -> Iterator[tuple[str, object]]:
    """The scalars in nested dictionaries and lists, by their names."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from leaves(f"{name}.{key}", each)
    elif isinstance(value, list | tuple):
        yield f"{name}.length", len(value)
        for index, each in enumerate(value):
            yield from leaves(f"{name}[{index}]", each)
    else:
        yield name, value


def differences(
    command: str, wanted: Mapping[str, Any], given: Mapping[str, Any]
) -> Iterator[tuple[str, str]]:
    """What differs between the results of a command: the name of each figure, and how."""
    for field in sorted({*wanted, *given}):
        if field not in wanted or field not in given:
            yield field, f"only in {'the corpus' if field in wanted else 'the new result'}"
        elif isinstance(wanted[field], np.ndarray):
            if line := array_difference(command, field, wanted, given[field]):
                yield field, line
        else:
            yield from tree_differences(field, wanted[field], given[field])


def array_difference(
    command: str, field: str, wanted: Mapping[str, Any], new: NDArray[np.float64]
) -> str:
    """How an array differs from that in the corpus; empty where it does not."""
    old = wanted[field]
    if old.shape != np.shape(new):
        return f"shape {np.shape(new)}, in the corpus {old.shape}"
    if not old.size:
        return ""
    topic, _, kind = field.rpartition(" ")
    largest = float(np.abs(old).max())
    allowed: NDArray[np.float64] | float
    if kind == "x" and f"{topic} deviation" in wanted:
        allowed = np.maximum(OF_DEVIATION * wanted[f"{topic} deviation"], SMALL * largest)
    elif kind == "stamp":
        allowed = STAMP
    elif kind == "x":
        allowed = (EXACT if command.startswith("observe") else TRUTH) * largest
    elif kind == "deviation":
        allowed = OF_DEVIATION * np.abs(old) + SMALL * largest
    elif kind == "innovation":
        closed = PENETRATING if "impacts_only" in command else 0.0
        allowed = INNOVATION * (1 + np.abs(old)) + closed
    else:
        allowed = FIGURE * np.abs(old) + SMALL * largest
    excess = np.abs(new - old) / allowed
    if not np.isfinite(new).all() or excess.max() > 1:
        at = np.unravel_index(int(np.argmax(excess)), old.shape)
        return (
            f"{excess.max():.3g} times the tolerance at {[int(i) for i in at]}:"
            f" {float(new[at])!r}, in the corpus {float(old[at])!r}"
        )
    return ""


def tree_differences(name: str, wanted: object, given: object) -> Iterator[tuple[str, str]]:
    """What differs between two trees of JSON: the name of each leaf, and how."""
    old, new = dict(leaves(name, wanted)), dict(leaves(name, given))
    for leaf in [*old, *(leaf for leaf in new if leaf not in old)]:
        if leaf not in old or leaf not in new:
            yield leaf, f"only in {'the corpus' if leaf in old else 'the new result'}"
        elif not alike(leaf, old[leaf], new[leaf]):
            yield leaf, f"{new[leaf]!r}, in the corpus {old[leaf]!r}"


def alike(name: str, old: object, new: object) -> bool:
    """Whether two scalars agree; words, counts and truth values must be equal."""
    if (
        isinstance(old, int)
        and isinstance(new, int)
        and re.search(r"stamp(_ns)?(\[\d+\])?$", name)
    ):
        return abs(new - old) <= STAMP
    if not (isinstance(old, float) and isinstance(new, float | int)):
        return old == new
    absolute = max((at for key, at in ROUNDING.items() if re.search(key, name)), default=0.0)
    return abs(new - old) <= FIGURE * abs(old) + absolute
