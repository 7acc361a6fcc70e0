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

from typing import NamedTuple

from impact_observer.kernel._kernel import Sensitivity, leading
from impact_observer.states import Matrix, Vector

__all__ = ["Map", "Sensitivity", "leading"]


class Map(NamedTuple):
    """An affine map of states, evaluated at one state.

    Attributes:
        value: of that state, shape (k,).
        linear: its derivative, shape (k, d).
    """

    value: Vector
    linear: Matrix
