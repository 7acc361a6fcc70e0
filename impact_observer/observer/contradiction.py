# SPDX-License-Identifier: Apache-2.0
"""Learned values that contradict the declared ones."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from impact_observer.observer.uncertainty import Uncertainty

_MOST = 4.0
"""Declared deviations beyond which a learned value contradicts the declared one."""
_OUTSIDE = 2.0
"""Deviations of a learned value by which it is outside the bounds of its parameter."""


class Contradiction(NamedTuple):
    """A learned value that contradicts the declared one, SI units.

    Attributes:
        name: such as ``restitution.stop``, or ``clock_offset``.
        declared: the declared value, and its standard deviation.
        learned: the learned value, and its standard deviation.
    """

    name: str
    declared: tuple[float, float]
    learned: tuple[float, float]


def contradictions(
    learned: Iterable[tuple[str, float, float]], uncertainty: Uncertainty
) -> list[Contradiction]:
    """The ``learned`` values (name, value, standard deviation) that contradict the declared."""
    declared, unknowns = dict[str, tuple[float, float, float, float]](), uncertainty.unknowns
    if unknowns is not None:
        family = unknowns.family
        columns = (family.nominal, unknowns.deviations, *family.bounds)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        declared |= zip(family.names, rows, strict=True)
    offset = uncertainty.clock_offset_error
    declared["clock_offset"] = (0.0, offset, -math.inf, math.inf)
    found = []
    for name, value, deviation in learned:
        nominal, error, low, high = declared.get(name, (0.0, 0.0, 0.0, 0.0))
        if not error:
            continue
        margin = _OUTSIDE * deviation
        is_inside = low - margin <= value <= high + margin
        if abs(value - nominal) > _MOST * error or not is_inside:
            found.append(Contradiction(name, (nominal, error), (value, deviation)))
    return found
