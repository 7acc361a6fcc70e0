# SPDX-License-Identifier: Apache-2.0
"""What a fit to impacts leaves: whether the model fits, and a motion that may be early or late."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from impact_observer.model.document import Keys, NotNegative, Positive, Value, converted
from impact_observer.states import Vector


class TimeShift(NamedTuple):
    """A time by which a motion may be early or late, always alike.

    Shifts of stamps that are no white errors of a clock do not average out.

    Attributes:
        largest: the largest shift that a motion leaves, s.
        interval: the mean time between two impacts, s.
    """

    largest: float
    interval: float

    def errors(self, x: Vector) -> Vector:
        """Errors of a state (q, u), shape (2n,), in SI units.

        Where the motion goes during the shift; and of each component, the phase by which an
        oscillation with one turn an interval is off.
        """
        error = 2.0 * np.pi * self.largest / self.interval * np.abs(x)
        n = x.size // 2
        error[:n] += self.largest * np.abs(x[n:])
        return np.asarray(error)


NO_SHIFT = TimeShift(0.0, 1.0)


class WrittenVerdict(Keys, frozen=True):
    """The verdict of ``identify`` in the ``provenance`` of a model.

    Attributes:
        fits: whether the model fits the impacts.
        residual: rms of the shifts that are left, s; 0 where no motion explains the impacts.
        shift: ``largest`` of a ``TimeShift``, s.
        interval: that of the ``TimeShift``, s.
    """

    fits: bool = True
    residual: NotNegative = 0.0
    shift: NotNegative = NO_SHIFT.largest
    interval: Positive = NO_SHIFT.interval

    @classmethod
    def of(cls, provenance: Mapping[str, Value]) -> "WrittenVerdict":
        """The verdict in a ``provenance``; without ``fits`` no key is one of a verdict.

        Raises:
            ModelError: a value is wrong.
        """
        return converted(verdict_keys(provenance), cls, "provenance")

    @property
    def time_shift(self) -> TimeShift:
        """By how much the motion may be early or late, as the fit has shown."""
        return TimeShift(self.shift, self.interval)


FITS, *_ = VERDICT = WrittenVerdict.__struct_fields__
"""Keys of the provenance by which ``identify`` says whether a model fits."""


def verdict_keys(provenance: Mapping[str, Value]) -> dict[str, Value]:
    """The part of a ``provenance`` that is a verdict; empty where ``fits`` is missing."""
    return {key: provenance[key] for key in VERDICT if FITS in provenance and key in provenance}
