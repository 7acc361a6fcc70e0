# SPDX-License-Identifier: Apache-2.0
"""Learned values that contradict the declared ones."""

from collections.abc import Iterable
from typing import NamedTuple

_MOST = 4.0
"""Deviations from the declared value beyond which a learned value contradicts it."""
_OUTSIDE = 2.0
"""Deviations of a learned value by which it is outside the bounds of its parameter."""


class Declared(NamedTuple):
    """What is declared of a constant that is learned, SI units.

    Attributes:
        name: such as ``restitution.stop``, or ``clock_offset``.
        value: the declared value.
        deviation: its standard deviation.
        low: least value allowed.
        high: largest value allowed.
    """

    name: str
    value: float
    deviation: float
    low: float
    high: float


class Contradiction(NamedTuple):
    """A learned value that contradicts the declared one.

    Attributes:
        declared: what is declared.
        value: the learned value.
        deviation: its standard deviation.
    """

    declared: Declared
    value: float
    deviation: float

    @property
    def far(self) -> float:
        """Distance of the learned value from the declared one, in declared deviations."""
        return abs(self.value - self.declared.value) / self.declared.deviation

    @property
    def is_outside(self) -> bool:
        """Whether the learned value is outside the bounds of its parameter."""
        margin = _OUTSIDE * self.deviation
        return not self.declared.low - margin <= self.value <= self.declared.high + margin


def contradictions(
    learned: Iterable[tuple[str, float, float]], declared: Iterable[Declared]
) -> tuple[Contradiction, ...]:
    """The ``learned`` values (name, value, standard deviation) that contradict the declared."""
    known = {each.name: each for each in declared if each.deviation > 0}
    found = (Contradiction(known[n], *rest) for n, *rest in learned if n in known)
    return tuple(each for each in found if each.far > _MOST or each.is_outside)
