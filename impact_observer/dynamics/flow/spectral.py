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

"""Flow by modes: ``n`` real 2 x 2 blocks, each in closed form.

With ``x = T y`` the homogeneous phase falls into blocks ``dy/dt = J y``. A block with eigenvalues
``lambda = a +- d`` has ::

    e^{Js} = c(s) I + S(s) (J - a I),   c = e^{as} cosh(ds),   S = e^{as} sinh(ds) / d

which holds for oscillation (``d`` imaginary), overdamping, critical damping and rigid bodies
(``d = 0``) alike. A harmonic ``b e^{mu t}`` adds its steady response ``(mu - J)^{-1} b``, except
near resonance, where that would lose all digits: there the response since the phase's start is
``(exp[l1, mu] + exp[l1, l2, mu] (J - l1)) b`` in divided differences of the exponential.
So it is for a while where the steady response is huge against the state, as that of a load on
a soft spring: then both are rounded to the motion's own size. No constant here is a time.

What is the same for all motions is prepared here; the kernel computes motions (``motion.hpp``).
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.flow import (
    Complex,
    Equations,
    Flow,
    Functions,
    PhaseFrame,
)
from impact_observer.dynamics.flow.modes import Modes
from impact_observer.kernel import Guards, ModalFlow, PhaseMotion
from impact_observer.model.angles import Angles
from impact_observer.states import Matrix, Vector

_RESONANCE = 1e-2
"""Distance of a forcing frequency from an eigenvalue that is near, over the rates of both."""
_HUGE = 30.0
"""Steady response, over the state, that would cost digits while the motion is young."""


class SpectralFlow(Flow):
    """Flow of a system in its modes."""

    def __init__(self, system: Equations, modes: Modes, frame: PhaseFrame | None = None) -> None:
        """Prepare steady responses and the pairs that resonate."""
        super().__init__(system, frame)
        self.modes = modes
        forcing = system.forcing
        mu = 1j * np.concatenate([[0.0], forcing.frequency])
        forces = np.vstack([forcing.constant, forcing.cosine, forcing.sine])
        load = modes.pushed(self._pushed(forces.T))
        beta = load[:, :, : mu.size].astype(np.complex128)
        beta[..., 1:] -= 1j * load[:, :, mu.size :]
        one, two = modes.eigenvalues
        distance = np.minimum(abs(mu - one[:, None]), abs(mu - two[:, None]))
        fastest = float(np.max(np.abs(np.concatenate([one, two, mu]))))
        self._time = 1.0 / fastest if fastest > 0 else 0.0
        forced = np.any(beta != 0, axis=1)
        # Eigenvalues that are found all together are rounded to the fastest of them.
        rates = np.abs(one)[:, None] + np.abs(mu) if modes.proportional else fastest
        near = forced & (distance <= _RESONANCE * rates)
        far = forced & ~near
        response = _steady(modes, mu, beta, far)
        weights = modes.energy
        small = float(np.sqrt(np.sum(weights * np.sum(np.abs(response), axis=2) ** 2))) / _HUGE
        young = 1.0 / float(np.min(distance[far], initial=np.inf))
        real = np.concatenate([response.real, -response.imag[..., 1:]], axis=2)
        self._kernel = ModalFlow(
            modes.coordinates(frame),
            modes.splitting,
            (forcing.frequency, Angles(forcing.frequency).turns),
            real.reshape(2 * system.n, -1),
            load.reshape(2 * system.n, -1),
            near,
            forced,
            weights,
            small,
            young,
        )

    def start(self, t: float, x: Vector) -> PhaseMotion:
        """The motion through ``x`` at ``t``."""
        return self._kernel.start(t, x)

    def guards(self, functions: Functions) -> Guards:
        """``functions`` of all motions."""
        position, *rows = self._seen(functions, self._time)
        none = functions.force[:, :0]
        return self._kernel.guards(position, *self.modes.seen(*rows), functions.waves, none)

    def moving(self, s: float) -> Matrix:
        """``T e^{Js} T^{-1}``."""
        return np.asarray(self._kernel.propagated(s).T.dot(self._inverse))

    @cached_property
    def _inverse(self) -> Matrix:
        """``T^{-1}`` of states in their frame, shape (2r, 2n)."""
        inverse = self.modes.coordinates(self._frame)[1]
        if not self.modes.proportional:
            return inverse
        r, n = inverse.shape
        found = np.zeros((2 * r, 2 * n))
        found[0::2, :n] = found[1::2, n:] = inverse
        return found


def _steady(modes: Modes, mu: Complex, beta: Complex, far: NDArray[np.bool_]) -> Complex:
    """``(mu - J)^{-1} beta`` of the pairs ``far`` from resonance, shape (n, 2, 1 + h).

    By Cramer's rule; ``mu`` has shape (1 + h,), ``beta`` (n, 2, 1 + h), ``far`` (n, 1 + h).
    """
    e, f = mu - modes.J[:, 0, 0][:, None], mu - modes.J[:, 1, 1][:, None]
    g, h = modes.J[:, 0, 1][:, None], modes.J[:, 1, 0][:, None]
    determinant = np.where(far, e * f - g * h, 1.0)
    one, two = beta[:, 0], beta[:, 1]
    response = np.stack([f * one + g * two, h * one + e * two], axis=1)
    return np.asarray(np.where(far[:, None], response / determinant[:, None], 0.0))
