# SPDX-License-Identifier: Apache-2.0
"""What an event may have been, and how likely: the table of interpretations.

Of each hypothesis and each move of its rungs an impact has a likelihood: the density of the gap at
zero, times the mean speed at which contacts close there (Rice, Mathematical analysis of random
noise, 1945), which is a density of the instant. So is that of a false positive.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from impact_observer.bank.bank import Hypotheses
from impact_observer.bank.ladders import Numbers
from impact_observer.bank.predict import Flights
from impact_observer.events import Contacts
from impact_observer.states import Vector

_LEAST_TRUE = 1e-3
"""Least probability that an event is what it is reported to be."""
_LEAST_GAP = 1e-16
"""Deviation of a gap that is rounding, m, for a motion of 1 m."""


class Priors(NamedTuple):
    """Log probabilities of what an event is.

    Attributes:
        true: as reported.
        other: an impact of another contact, of each of them.
        spurious: nothing.
        false_rate: log of the rate of false positives, were all events such, 1/s.
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
            _log(max(1 - spurious - mislabelled, _LEAST_TRUE)),
            _log(mislabelled / others),
            _log(spurious),
            math.log(numbers.false_rate * rate),
        )


class Branches(NamedTuple):
    """Impacts that an event may have been, one row each.

    Attributes:
        h: the hypothesis.
        contact: the contact that has hit; of several the first.
        r: rung of the error afterwards.
        c: rung of the clock afterwards.
        logw: log probability.
        z: the gap in standard deviations.
    """

    h: NDArray[np.intp]
    contact: NDArray[np.intp]
    r: NDArray[np.intp]
    c: NDArray[np.intp]
    logw: Vector
    z: Vector

    def take(self, which: NDArray[np.intp]) -> "Branches":
        """The chosen ones."""
        h, contact, r, c, logw, z = self
        return Branches(h[which], contact[which], r[which], c[which], logw[which], z[which])

    @classmethod
    def joined(cls, parts: Sequence["Branches"]) -> "Branches":
        """All of ``parts``."""
        return cls(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def impacts(rows: Hypotheses, contacts: Contacts, flights: Flights) -> Branches:
    """That ``contacts`` have hit, by each hypothesis on each of its new rungs."""
    ladders, leading = flights.ladders, flights.numbers.log_leading
    h, r, c, k = ladders.moved(rows.r, rows.c, rows.logw > rows.logw.max() + leading)
    logw = rows.logw[h] + ladders.log_moves[k]
    g, gg, v, vv, gv = _moments(rows, contacts[0], flights, (h, r, c))
    mean, deviation = v - gv / gg * g, np.sqrt(np.maximum(vv - gv**2 / gg, 1e-30))
    z = np.abs(g) / np.sqrt(gg)
    logw += -(z**2) / 2 - np.log(2 * np.pi * gg) / 2 + _log_closing(mean, deviation)
    for contact in contacts[1:]:  # at the same instant: their gaps are zero, too
        g, gg, *_ = _moments(rows, contact, flights, (h, r, c))
        z = np.maximum(z, np.abs(g) / np.sqrt(gg))
        logw -= g**2 / gg / 2
    return Branches(h, np.full(h.size, contacts[0]), r, c, logw, z)


def _moments(
    rows: Hypotheses, contact: int, flights: Flights, rungs: tuple[NDArray[np.intp], ...]
) -> tuple[Vector, ...]:
    """Mean and variance of a gap and of its speed, and their covariance, one of each rung."""
    ladders, d, (h, r, c) = flights.ladders, flights.d, rungs
    g, by_state, v, along = flights.guard(contact, rows.x)
    if rows.x.shape[1] > d + flights.p:  # the gap before the stamp by the delay
        by_state[:, -1] -= v
        g = g - v * (rows.x[:, -1] - flights.constants[-1])
    gS = np.einsum("hi,hik->hk", by_state, rows.S)
    vS = np.einsum("hi,hik->hk", along, rows.S[:, :d])
    gB, vB = (np.einsum("hi,hik->hk", each, rows.B) for each in (by_state[:, :d], along))
    square = ladders.errors[r] ** 2
    gg = np.sum(gS * gS, axis=1)[h] + square * np.sum(gB * gB, axis=1)[h]
    gv = np.sum(gS * vS, axis=1)[h] + square * np.sum(gB * vB, axis=1)[h]
    vv = np.sum(vS * vS, axis=1)[h] + square * np.sum(vB * vB, axis=1)[h]
    least = _LEAST_GAP * np.sum(np.abs(rows.x[:, :d]), axis=1)[h]
    gg += flights.clock(contact, c) ** 2 * (v[h] ** 2 + vv) + least**2
    return g[h], gg, v[h], vv, gv


def _log_closing(mean: Vector, deviation: Vector) -> Vector:
    """Logarithm of the mean of ``max(-gamma, 0)`` of a normal ``gamma``."""
    a = -mean / deviation
    near = np.maximum(a, -30.0)
    density = np.exp(-(near**2) / 2) / math.sqrt(2 * math.pi)
    found = np.log(np.maximum(density + near * special.ndtr(near), 1e-300))
    return np.asarray(np.log(deviation) + np.where(a > -30, found, -700.0))


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0 else -math.inf
