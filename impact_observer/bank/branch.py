# SPDX-License-Identifier: Apache-2.0
"""What an event may have been, and how likely: the table of interpretations.

Of each hypothesis and each move of its rungs an impact has a likelihood: the density of the gap at
zero, times the mean speed at which contacts close there (Rice, Mathematical analysis of random
noise, 1945), which is a density of the instant. A false alarm has a density of the instant, too.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from impact_observer.bank.bank import Hypotheses
from impact_observer.bank.ladders import Numbers
from impact_observer.bank.predict import Flights
from impact_observer.states import Vector

_LEAST_GAP = 1e-16
"""Deviation of a gap that is rounding, m, for a motion of 1 m."""


class Priors(NamedTuple):
    """Log probabilities of what an event is.

    Attributes:
        true: as reported.
        other: an impact of another contact, of each of them.
        spurious: nothing.
        false_rate: log of the rate of false alarms, were all events such, 1/s.
    """

    true: float
    other: float
    spurious: float
    false_rate: float

    @classmethod
    def of(
        cls, spurious: float, mislabelled: float, contacts: int, rate: float, numbers: Numbers
    ) -> "Priors":
        """The priors of declared probabilities; ``rate`` is the fastest of the model, rad/s."""
        others = max(contacts - 1, 1)
        mislabelled = mislabelled if contacts > 1 else 0.0
        return cls(
            math.log1p(-spurious - mislabelled),
            _log(mislabelled / others),
            _log(spurious),
            math.log(numbers.false_rate * rate),
        )


class Branches(NamedTuple):
    """Impacts that an event may have been, one row each.

    Attributes:
        h: the hypothesis.
        contact: the contact that has hit.
        r: rung of the error afterwards.
        c: rung of the clock afterwards.
        logw: log probability.
    """

    h: NDArray[np.intp]
    contact: NDArray[np.intp]
    r: NDArray[np.intp]
    c: NDArray[np.intp]
    logw: Vector

    def take(self, which: NDArray[np.intp]) -> "Branches":
        """The chosen ones."""
        h, contact, r, c, logw = self
        return Branches(h[which], contact[which], r[which], c[which], logw[which])


def impacts(rows: Hypotheses, contact: int, flights: Flights) -> Branches:
    """That a ``contact`` has hit, by each hypothesis on each of its new rungs."""
    ladders, leading = flights.ladders, flights.numbers.log_leading
    w, u = flights.gap_rows[contact], flights.speed_rows[contact]
    h, r, c, k = ladders.moved(rows.r, rows.c, rows.logw > rows.logw.max() + leading)
    x, S, B = rows.x[:, : w.size], rows.S[:, : w.size], rows.B[:, : w.size]
    g, v, gS, vS, gB, vB = x @ w + flights.rest[contact], x @ u, w @ S, u @ S, w @ B, u @ B
    square = ladders.errors[r] ** 2
    gg = np.sum(gS * gS, axis=1)[h] + square * np.sum(gB * gB, axis=1)[h]
    gv = np.sum(gS * vS, axis=1)[h] + square * np.sum(gB * vB, axis=1)[h]
    vv = np.sum(vS * vS, axis=1)[h] + square * np.sum(vB * vB, axis=1)[h]
    least = _LEAST_GAP * np.sum(np.abs(x), axis=1)[h]
    gg += ladders.clocks[c] ** 2 * (v[h] ** 2 + vv) + least**2
    mean = v[h] - gv / gg * g[h]
    deviation = np.sqrt(np.maximum(vv - gv**2 / gg, 1e-30))
    log = -(g[h] ** 2) / gg / 2 - np.log(2 * np.pi * gg) / 2 + _log_closing(mean, deviation)
    logw = rows.logw[h] + ladders.log_moves[k] + log
    return Branches(h, np.full(h.size, contact), r, c, logw)


def _log_closing(mean: Vector, deviation: Vector) -> Vector:
    """Logarithm of the mean of ``max(-gamma, 0)`` of a normal ``gamma``."""
    a = -mean / deviation
    near = np.maximum(a, -30.0)
    density = np.exp(-(near**2) / 2) / math.sqrt(2 * math.pi)
    found = np.log(np.maximum(density + near * special.ndtr(near), 1e-300))
    return np.asarray(np.log(deviation) + np.where(a > -30, found, -700.0))


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0 else -math.inf
