# SPDX-License-Identifier: Apache-2.0
"""Whether a frequency of a model was written in Hz, by the impacts that its drive makes.

Impacts of a driven rig come at phases of the drive that are not evenly spread, so the mean of
``exp(i omega t_k)`` over their times ``t_k`` is large at the drive's ``omega`` (Rayleigh's test:
Mardia and Jupp, Directional Statistics, 2000, section 6.3.1).
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.states import Vector

_FEWEST = 20
"""Fewest impacts that are tested."""
_LOG_CHANCE = math.log(1e-6)
"""Logarithm of the probability that impacts at random are as coherent."""
_MULTIPLES = np.arange(1, 17)
"""Multiples of a declared frequency with which no impact may be coherent. A motion that repeats
after several periods of its drive with impacts at even phases is coherent with multiples only."""
_CLEARLY = 2.0
"""Least ratio of the coherence with 2 pi times a frequency to that with all multiples."""
_NEAR, _OFFSETS = 0.9, np.linspace(-0.5, 0.5, 21)
"""Least ratio of that coherence to the largest within half a turn over the recording. Another
periodic motion seldom has the very frequency."""


def coherence(times: Vector, rates: ArrayLike) -> Vector:
    """``|mean of exp(i omega t)|`` over ``times``, s, for angular frequencies ``rates``, rad/s.

    From 0 to 1, of the shape of ``rates``.
    """
    turns = np.exp(1j * np.multiply.outer(np.asarray(rates, dtype=float), times))
    return np.asarray(np.abs(turns.mean(axis=-1)))


def frequencies_in_hertz(times: Vector, frequencies: Vector) -> list[float]:
    """Those of a model's ``frequencies``, rad/s, that are probably in Hz.

    The impacts are coherent with 2 pi times such a frequency. They are with no multiple of any
    frequency of the model: else the model's drives, as they are declared, explain the coherence.

    Args:
        times: of the impacts of one contact, s, shape (k,).
        frequencies: shape (h,).
    """
    if times.size < _FEWEST or not frequencies.size:
        return []
    by_model = float(coherence(times, np.multiply.outer(_MULTIPLES, frequencies)).max())
    found = list[float]()
    for each in frequencies.tolist():
        here = float(coherence(times, math.tau * each))
        if times.size * here**2 < -_LOG_CHANCE or here < _CLEARLY * by_model:
            continue
        near = math.tau * (each + _OFFSETS / max(float(np.ptp(times)), 1e-9))
        if here >= _NEAR * float(coherence(times, near).max()):
            found.append(each)
    return found
