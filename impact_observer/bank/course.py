# SPDX-License-Identifier: Apache-2.0
"""A bank between two events, at any instant: what is published of it.

The likeliest hypotheses are followed from checkpoint to checkpoint, half a period of the fastest
rate apart. So an estimate is a function of its instant, whatever was asked for before. From a
checkpoint to the first dip of a gap their mixture is one Gaussian.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from impact_observer.bank.bank import Bank, Hypotheses, contacts_of, mixture
from impact_observer.bank.impact_bank import ImpactBank
from impact_observer.bank.ladders import triangular
from impact_observer.bank.merge import merged
from impact_observer.bank.predict import Leg
from impact_observer.events import Contacts
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_STEPS = 16
"""Steps of a flight's grid between two checkpoints."""


class Checkpoint(NamedTuple):
    """What is published from one checkpoint on.

    Attributes:
        rows: the hypotheses.
        x: their mean, shape (N,).
        root: of their covariance, shape (N, N).
        error: root mean square of their relative errors of the model.
        plain: how long they are one Gaussian, s.
        held: contacts that all hold closed meanwhile.
    """

    rows: Hypotheses
    x: Vector
    root: Matrix
    error: float
    plain: float
    held: Contacts


class Course:
    """The published estimate from one event on."""

    def __init__(self, filter_: ImpactBank, bank: Bank) -> None:
        """Follow the likeliest hypotheses of ``bank``."""
        self._filter, self._bank = filter_, bank
        order = np.argsort(-bank.rows.logw)
        shares = np.cumsum(bank.rows.weights[order])
        kept = 1 + int(np.searchsorted(shares, 1 - filter_.numbers.unpublished))
        self._length = _STEPS * filter_.tangent.phase(()).flow.exponential.step / 2
        self._checkpoints = [self._checkpoint(bank.rows.take(order[:kept]), 0)]
        self.estimate = lru_cache(2)(self._estimate)

    def _checkpoint(self, rows: Hypotheses, number: int) -> Checkpoint:
        filter_ = self._filter
        x, root = mixture(rows, filter_.ladders, filter_.numbers.unpublished)
        error = float(np.sqrt(rows.weights @ filter_.ladders.errors[rows.r] ** 2))
        held, plain = contacts_of(int(rows.held[0])), 0.0
        if np.all(rows.held == rows.held[0]) and not rows.paid.any():
            leg = Leg(
                self._bank.t + number * self._length, self._length, held, self._bank.intensity
            )
            dips = filter_.flights.dips(rows, leg, np.zeros(rows.size))
            plain = self._length if dips is None else float(dips.began[:, 0].min())
        return Checkpoint(rows, x, root, error, plain, held)

    def _at(self, s: float) -> tuple[Checkpoint, Elapsed, float]:
        """The checkpoint before ``s``, its instant, s since the epoch, and how long ago it was."""
        number = int(s / self._length)
        filter_ = self._filter
        while len(self._checkpoints) <= number:
            rows = self._moved(
                self._checkpoints[-1].rows, len(self._checkpoints) - 1, self._length
            )
            rows = merged(rows, filter_.ladders, filter_.numbers, filter_.scan)
            self._checkpoints.append(self._checkpoint(rows, len(self._checkpoints)))
        start = number * self._length
        return self._checkpoints[number], self._bank.t + start, s - start

    def _moved(self, rows: Hypotheses, number: int, s: float) -> Hypotheses:
        """Hypotheses ``s`` seconds after a checkpoint."""
        bank, t = self._bank, self._bank.t + number * self._length
        return self._filter.flights.moved(rows, Leg(t, s, (), bank.intensity))

    def _estimate(self, s: float) -> tuple[Vector, Matrix]:
        """Mean, shape (N,), and root of the covariance, (N, N), after ``s`` seconds."""
        point, t, ago = self._at(s)
        filter_, d = self._filter, 2 * self._filter.n
        if ago > point.plain:
            rows = self._moved(point.rows, int(s / self._length), ago)
            return mixture(rows, filter_.ladders, filter_.numbers.unpublished)
        if ago == 0:
            return point.x, point.root
        length = np.array([ago])
        map_ = filter_.tangent.flights([t], length, point.held)
        x, root = point.x.copy(), point.root.copy()
        x[:d], root[:d] = map_.of(x[:d])[0], map_.Phi[0] @ root[:d]
        if point.error:
            noise = np.zeros((len(x), d))
            noise[:d] = filter_.tangent.noise(length, point.held, self._bank.intensity)[0]
            root = triangular(np.hstack([root, point.error * noise]))
        return x, root

    def states(self, s: Vector) -> Matrix:
        """Means after many times of ascending ``s`` seconds, shape (samples, N)."""
        found, d = np.empty((s.size, self._checkpoints[0].x.size)), 2 * self._filter.n
        number = (s / self._length).astype(int)
        for each in np.unique(number).tolist():
            own = np.flatnonzero(number == each)
            point, t, _ = self._at(float(s[own[0]]))
            ago = s[own] - each * self._length
            plain = ago <= point.plain
            maps = self._filter.tangent.flights([t] * own.size, ago, point.held)
            found[own] = point.x
            found[own, :d] = maps.of(point.x[:d])
            for k in own[~plain].tolist():
                found[k] = self.estimate(float(s[k]))[0]
        return found

    def closed(self, s: float) -> Contacts:
        """Contacts that the likeliest hypothesis holds closed."""
        rows = self._at(s)[0].rows
        return contacts_of(int(rows.held[np.argmax(rows.logw)]))
