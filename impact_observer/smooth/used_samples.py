# SPDX-License-Identifier: Apache-2.0
"""Samples of sensors beside the impacts, as rows of the chain.

The samples of a flight without process noise are functions of the state at its start. An
orthogonal matrix turns their rows into a row for each number of the state, and a residual.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.filter.readings import Reading
from impact_observer.filter.square_root import triangular
from impact_observer.smooth.chain import Step
from impact_observer.states import Matrix, Vector

_LOG_2PI = math.log(2 * math.pi)


class UsedSamples(NamedTuple):
    """The samples of a recording.

    Attributes:
        readings: in order of their instants.
        rejected: indices of readings that their gates reject.
    """

    readings: tuple[Reading, ...] = ()
    rejected: frozenset[int] = frozenset()

    def flights(
        self, instants: Vector, hits: Sequence[bool], margins: Vector
    ) -> dict[int, list[int]]:
        """The samples that are used in each flight, by the moment before it; -1 for the start.

        Args:
            instants: of the moments, s since the epoch, shape (k,).
            hits: whether contacts hit at each moment, which begins the blanking of sensors.
            margins: distance from each moment within which samples are left out, s, shape (k,).
        """
        flights: dict[int, list[int]] = {}
        order = np.maximum.accumulate(instants) if instants.size else instants
        since = np.where(hits, instants, -np.inf)
        since = np.maximum.accumulate(since) if instants.size else since
        times = np.array([float(each.t) for each in self.readings])
        before = np.searchsorted(order, times, side="right") - 1
        for i, (each, k) in enumerate(zip(self.readings, before.tolist(), strict=True)):
            if i in self.rejected:
                continue
            if k >= 0:
                ago = times[i] - since[k]
                near = times[i] - order[k] <= margins[k]
                if near or ago < each.sensor.measurement.blanking:
                    continue
            if k + 1 < order.size and order[k + 1] - times[i] <= margins[k + 1]:
                continue
            flights.setdefault(k, []).append(i)
        return flights

    def left_out(self, used: int) -> float:
        """Logarithm of the density of the samples that are left out; ``used`` counts the others.

        A rejected sample counts like one at its gate, any other like an expected one. So accounts
        that use different samples compare.
        """
        total = 0.0
        for i in self.rejected:
            gate = self.readings[i].sensor.measurement.gate
            total -= (gate * gate + _log_variance(self.readings[i])) / 2
        others = len(self.readings) - len(self.rejected) - used
        usual = float(np.mean([_log_variance(each) for each in self.readings] or [0.0]))
        return total - others * (1.0 + usual) / 2


NO_SAMPLES = UsedSamples()


def _log_variance(reading: Reading) -> float:
    return math.log(max(reading.sensor.variance, 1e-300)) + _LOG_2PI


def measured(H: Matrix, y: Vector, deviations: Vector) -> Step:
    """The measurement ``H z = y`` with independent errors, in at most ``d`` rows.

    Args:
        H: shape (k, d).
        y: shape (k,).
        deviations: of the errors, positive, shape (k,).
    """
    k, d = H.shape
    blank, unmoved = np.zeros((d, 0)), np.eye(d)
    if k <= d:
        return Step(unmoved, np.zeros(d), blank, H, y, np.diag(deviations))
    order = np.argsort(deviations)  # exact rows first, against rounding
    rows = np.column_stack([H, y])[order] / deviations[order, None]
    R = triangular(rows.T).T
    residual = float(R[d, d])
    density = -residual * residual / 2 - float(np.sum(np.log(deviations))) - (k - d) * _LOG_2PI / 2
    return Step(unmoved, np.zeros(d), blank, R[:d, :d], R[:d, d], np.eye(d), density)
