# SPDX-License-Identifier: Apache-2.0
"""Flow by modes: ``n`` real 2 x 2 blocks, each in closed form.

With ``x = T y`` the homogeneous phase falls into blocks ``dy/dt = J y``. A block with eigenvalues
``lambda = a +- d`` has ::

    e^{Js} = c(s) I + S(s) (J - a I),   c = e^{as} cosh(ds),   S = e^{as} sinh(ds) / d

which holds for oscillation (``d`` imaginary), overdamping, critical damping and rigid bodies
(``d = 0``) alike. A harmonic ``b e^{mu t}`` adds its steady response ``(mu - J)^{-1} b``, except
near resonance, where the steady response would lose all digits.
There the response since the phase's start is
``(exp[l1, mu] + exp[l1, l2, mu] (J - l1)) b`` in divided differences of the exponential.
The same form is used at first if the steady response is huge against the state, as under a load on
a soft spring. Then the rounding errors are relative to the motion.

This module prepares the constants of all motions; the kernel computes motions (``motion.hpp``).
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.modes import Complex, Modes
from impact_observer.kernel import ModalFlow
from impact_observer.states import Matrix, Vector

Coordinates: TypeAlias = tuple[Matrix, Matrix, Matrix, Matrix, Vector, bool]
Harmonics: TypeAlias = tuple[Vector, NDArray[np.uint64]]

_RESONANCE = 1e-2
"""Largest distance of a forcing frequency from an eigenvalue near resonance, over both rates."""
_HUGE = 30.0
"""Steady response, over the state, that would cost digits while the motion is young."""


def closed_form(
    modes: Modes, coordinates: Coordinates, harmonics: Harmonics, load: Matrix, fastest: float
) -> ModalFlow:
    """The flow of a system in its modes.

    Args:
        modes: the pairs of modes.
        coordinates: the result of ``Modes.coordinates``.
        harmonics: angular frequencies, shape (h,), rad/s, and ``Angles.turns``.
        load: constant load of the modes, then loads by cosines and sines, shape (2n, 1 + 2h).
        fastest: the fastest rate, 1/s.
    """
    mu = 1j * np.concatenate([[0.0], harmonics[0]])
    pairs = load.reshape(len(modes.J), 2, load.shape[1])
    beta = pairs[:, :, : mu.size].astype(np.complex128)
    beta[..., 1:] -= 1j * pairs[:, :, mu.size :]
    one, two = modes.eigenvalues
    distance = np.minimum(abs(mu - one[:, None]), abs(mu - two[:, None]))
    driven = np.any(beta != 0, axis=1)
    # The eigenvalues of one matrix have rounding errors relative to the fastest.
    rates = np.abs(one)[:, None] + np.abs(mu) if modes.proportional else fastest
    near = driven & (distance <= _RESONANCE * rates)
    far = driven & ~near
    response = _steady(modes, mu, beta, far)
    small = float(np.sqrt(np.sum(modes.energy * np.sum(np.abs(response), axis=2) ** 2))) / _HUGE
    young = 1.0 / float(np.min(distance[far], initial=np.inf))
    real = np.concatenate([response.real, -response.imag[..., 1:]], axis=2).reshape(load.shape)
    return ModalFlow(
        coordinates,
        (modes.J.reshape(-1, 4), *modes.rates),
        harmonics,
        real,
        load,
        near,
        driven,
        modes.energy,
        small,
        young,
    )


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
