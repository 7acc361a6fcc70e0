# SPDX-License-Identifier: Apache-2.0
"""Errors of the model, learned: process noise whose level each hypothesis fits to its innovations.

Two kinds: white noise of the accelerations, and an uncertain restitution at each impact. A level
follows the innovations by recursive maximum likelihood (Sage and Husa, Adaptive filtering with
unknown prior statistics, 1969), each event counting by what it says about the level.
"""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from impact_observer.filter.tuning import TUNING
from impact_observer.model import System
from impact_observer.states import Matrix, Vector


class ErrorKind(Enum):
    """What is in error; the values name the levels in ``ObserverState.parameter_name``."""

    NONE = ""
    ACCELERATION = "model error"
    RESTITUTION = "bounce error"


class LearnedError(NamedTuple):
    """The error of the model under one hypothesis.

    Attributes:
        kind: what is in error.
        level: of ``ACCELERATION``: as white noise, m/s^1.5; of ``RESTITUTION``: standard deviation
            of the coefficient.
        information: about the logarithm of the level's square, by the events since its birth.
        events: since its birth.
    """

    kind: ErrorKind = ErrorKind.NONE
    level: float = 0.0
    information: float = 0.0
    events: int = 0

    def matched(
        self, innovation: float, deviation: float, unit: float, most: float
    ) -> "LearnedError":
        """The error after an event.

        Args:
            innovation: of the event, in standard deviations.
            deviation: standard deviation of that innovation, m.
            unit: what level 1 contributes to it since the last event, m.
            most: that the level may be.
        """
        share = min((self.level * unit / deviation) ** 2, 1.0)
        information = TUNING.forgetting * self.information + share * share / 2
        slope = share * (min(innovation * innovation, TUNING.clipping**2) - 1.0) / 2
        step = slope / max(information, TUNING.least_information)
        level = min(self.level * math.exp(step / 2), most)
        return LearnedError(self.kind, level, information, self.events + 1)


NO_ERROR = LearnedError()


def unit_kicks(system: System) -> Matrix:
    """``M^-1 W_i / (W_i^T M^-1 W_i)`` of each contact, a column each, shape (n, m)."""
    pushed = np.linalg.solve(system.M, system.W)
    return np.asarray(pushed / np.sum(system.W * pushed, axis=0))


def largest(kind: ErrorKind, accelerations: Vector, timescale: float) -> float:
    """The most that a level may be; ``accelerations`` of the motion have shape (n,), m/s2."""
    if kind is ErrorKind.RESTITUTION:
        return TUNING.largest_restitution_error
    size = math.sqrt(accelerations.dot(accelerations))
    return TUNING.largest_acceleration_error * size * math.sqrt(timescale)
