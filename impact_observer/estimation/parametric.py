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

"""How unknown parameters add to the error of a state, to second order.

A map ``F(x, theta)`` is affine in the state ``x`` for every ``theta``. Its derivatives with
``theta`` are differences over steps about as large as ``theta`` may be wrong: where the map is
curved they average over that distance, and as the deviations fall they become derivatives
(Norgaard, Poulsen and Ravn, New developments in state estimation for nonlinear systems, 2000).
Terms of second order are noise whose variance follows from that of state and parameters. So
a filter never claims more than its linearisation allows, and the noise vanishes with the
deviations of the parameters.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.states import Matrix, Vector

_MEAN_TOO = math.sqrt(3) / 2
"""Root mean square of half the square of a normal variable: its mean stays in the error."""

_TAILS = 1.5
"""Products of normal variables have heavier tails than noise of as large a variance."""


class Map(NamedTuple):
    """An affine map of states, evaluated at one state.

    Attributes:
        value: of that state, shape (k,).
        linear: its derivative, shape (k, d).
    """

    value: Vector
    linear: Matrix


class Sensitivity(NamedTuple):
    """How a map changes with parameters.

    Attributes:
        first: derivatives of its value, shape (p, k).
        mixed: derivatives of its linear part, shape (p, k, d).
        second: second derivatives of its value, shape (p, p, k).
    """

    first: Matrix
    mixed: NDArray[np.float64]
    second: NDArray[np.float64]

    @classmethod
    def of(cls, at: Callable[[Vector], Map], theta: Vector, steps: Vector) -> "Sensitivity":
        """Central differences of a map ``at`` given parameters about ``theta``, shape (p,).

        They are taken on a grid of parameters, ``steps`` wide, so that calls with parameters
        nearby share the members that were prepared.
        """
        p, near = theta.size, steps * np.round(theta / steps)
        centre, aside = at(near), np.diag(steps)
        count, d = centre.linear.shape
        plus = [at(near + step) for step in aside]
        mixed, second = np.zeros((p, count, d)), np.zeros((p, p, count))
        first = np.zeros((p, count))
        for j, step in enumerate(steps.tolist()):
            minus = at(near - aside[j])
            first[j] = (plus[j].value - minus.value) / (2 * step)
            mixed[j] = (plus[j].linear - minus.linear) / (2 * step)
            second[j, j] = (plus[j].value - centre.value) + (minus.value - centre.value)
            for k in range(j):
                both = at(near + aside[j] + aside[k]).value
                crossed = (both - plus[j].value) - (plus[k].value - centre.value)
                second[j, k] = second[k, j] = crossed
        second /= np.multiply.outer(steps, steps)[:, :, None]
        first += (theta - near).dot(second.reshape(p, -1)).reshape(p, count)
        return cls(first, mixed, second)

    def added(self, root: Matrix, steps: Matrix) -> tuple[Matrix, Matrix]:
        """The error that the parameters add to ``linear @ root``.

        Args:
            root: square root of the covariance of ``x``, shape (d, c); it shares its first p
                columns with the parameters.
            steps: square root of the parameters' covariance, lower triangular, shape (p, p).

        Returns:
            Added to the first columns, shape (k, p); and further columns, of noise.
        """
        p = len(steps)
        mixed = steps.T.dot(self.mixed.reshape(p, -1)).reshape(self.mixed.shape)
        curved = np.einsum("ic,ijk,jd->cdk", steps, self.second, steps)
        across = mixed @ root[:, :p]
        noise = [each @ root[:, p:] for each in mixed]
        for c in range(p):
            own = curved[c, c] + 2 * across[c, :, c]
            noise.append(_MEAN_TOO * own[:, None])
            both = curved[c, :c].T + across[c][:, :c] + across[:c, :, c].T
            noise.append(both)
        return self.first.T @ steps, _TAILS * np.hstack(noise)


def leading_triangular(root: Matrix, rows: slice) -> Matrix:
    """The same covariance's square root in which ``rows`` are lower triangular in front."""
    # LAPACK's routines themselves: of small matrices checks cost more than they do.
    reflectors, scales, *_ = linalg.lapack.dgeqrf(root[rows].T)
    found: Matrix = linalg.lapack.dormqr(
        "R", "N", reflectors[:, : scales.size], scales, root, 64 * len(root)
    )[0]
    return found
