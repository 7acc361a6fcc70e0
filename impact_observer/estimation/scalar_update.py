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

"""The Kalman update by one number, on a square root: Potter's method.

Bierman, Factorization methods for discrete sequential estimation, 1977, chapter II.
"""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.readings import Row
from impact_observer.states import Vector


class Seen(NamedTuple):
    """A measured function of an uncertain state.

    Attributes:
        value: its expectation.
        columns: the function of the columns of the covariance's root, shape (columns,).
        spread: its variance, by the state alone.
    """

    value: float
    columns: Vector
    spread: float

    @classmethod
    def of(cls, row: Row, state: GaussianState) -> "Seen":
        """The function ``row`` of a state."""
        size, root = state.x.size, state.root
        columns = row.h.dot(root[:size])
        if row.of_theta.size:
            columns = columns + row.of_theta.dot(root[size : size + row.of_theta.size])
        return cls(row.value(state.x), columns, float(columns.dot(columns)))


def updated(
    state: GaussianState, row: Row, seen: Seen, innovation: float, noise: float
) -> GaussianState:
    """``state`` after a measurement of ``row`` with this ``innovation``.

    ``noise`` is the variance of the measurement, positive. The root keeps its columns.
    """
    size, p = state.x.size, row.of_theta.size
    variance = seen.spread + noise
    towards = state.root.dot(seen.columns)
    gain = towards / variance
    shrunk = towards / (variance + math.sqrt(variance * noise))
    root = state.root - np.multiply.outer(shrunk, seen.columns)
    differences = state.differences
    if differences.size:
        of_others = row.h.dot(differences[:size])
        if p:
            of_others = of_others + row.of_theta.dot(differences[size : size + p])
        differences = differences - np.multiply.outer(gain, of_others)
    change = gain * innovation
    constants = state.constants
    if constants.size:
        constants = constants + change[size:]
    return GaussianState(
        state.x + change[:size], constants, root, differences, state.closed, state.parameters
    )
