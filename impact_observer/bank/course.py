# SPDX-License-Identifier: Apache-2.0
"""A bank between two events, at any instant: what is published of it.

The likeliest hypotheses are followed from checkpoint to checkpoint. At first these are half a
period of the fastest rate apart; the distance doubles every 16 checkpoints. So an estimate is a
function of its instant, whatever was asked for before. From a checkpoint to the first dip of a gap
their mixture is one Gaussian.
"""

from bisect import bisect_right
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
"""Steps of a flight's grid between the first checkpoints."""
_EQUAL = 16
"""Checkpoints until their distance doubles."""


class Checkpoint(NamedTuple):
    """What is published from one checkpoint on.

    Attributes:
        start: s since the event.
        length: s until the next one.
        rows: the hypotheses.
        x: their mean, shape (N,).
        root: of their covariance, shape (N, N).
        error: root mean square of their relative errors of the model.
        plain: how long they are one Gaussian, s.
        held: contacts that all hold closed meanwhile.
    """

    start: float
    length: float
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
        self._flights = filter_.flights(bank.constants)
        shown = bank.rows.shown(filter_.numbers.unpublished)
        first = _STEPS * self._flights.tangent.phase(()).flow.exponential.step / 2
        self._checkpoints = [self._checkpoint(shown, 0.0, first)]
        self._starts = [0.0]
        self.estimate = lru_cache(2)(self._estimate)
        self._rows = lru_cache(2)(self._rows_at)

    def _checkpoint(self, rows: Hypotheses, start: float, length: float) -> Checkpoint:
        filter_ = self._filter
        x, root = mixture(rows, filter_.ladders, filter_.numbers.unpublished)
        each = filter_.ladders.errors * filter_.ladders.persistence
        error = float(np.sqrt(rows.weights @ each[rows.r] ** 2))
        held, plain = contacts_of(int(rows.held[0])), 0.0
        if np.all(rows.held == rows.held[0]) and not rows.paid.any():
            leg = Leg(self._bank.t + start, length, held, self._bank.intensity)
            plain = self._flights.quiet(rows, leg)
        return Checkpoint(start, length, rows, x, root, error, plain, held)

    def _at(self, s: float) -> tuple[Checkpoint, Elapsed]:
        """The checkpoint before ``s``, and its instant, s since the epoch."""
        last, filter_ = self._checkpoints[-1], self._filter
        while s >= last.start + last.length and not self._is_lost:
            rows = self._moved(last, last.length)
            rows = merged(rows, filter_.ladders, filter_.numbers, filter_.scan)
            count = len(self._checkpoints)
            length = last.length * (1 if count % _EQUAL else 2)
            last = self._checkpoint(rows, last.start + last.length, length)
            self._checkpoints.append(last)
            self._starts.append(last.start)
        point = self._checkpoints[max(bisect_right(self._starts, s) - 1, 0)]
        return point, self._bank.t + point.start

    @property
    def _is_lost(self) -> bool:
        """Whether so many impacts were missed that none is looked for any more."""
        rows = self._checkpoints[-1].rows
        return len(rows.missed[rows.best]) >= self._filter.numbers.most_silent

    def _rows_at(self, s: float) -> Hypotheses:
        """What is decided after ``s`` seconds; states may be those of the checkpoint before."""
        point, _ = self._at(s)
        ago = s - point.start
        return self._moved(point, ago) if point.plain < ago <= point.length else point.rows

    def _moved(self, point: Checkpoint, s: float) -> Hypotheses:
        """Hypotheses ``s`` seconds after a checkpoint."""
        bank, t = self._bank, self._bank.t + point.start
        most, deaf = self._filter.numbers.most_silent, self._filter.deaf(bank, t)
        leg = Leg(t, s, (), bank.intensity, deaf=deaf, most=most)
        return self._flights.moved(point.rows, leg)

    def _estimate(self, s: float) -> tuple[Vector, Matrix]:
        """Mean, shape (N,), and root of the covariance, (N, N), after ``s`` seconds."""
        point, t = self._at(s)
        ago = s - point.start
        filter_, flights, d = self._filter, self._flights, self._filter.d
        if point.plain < ago <= point.length:
            rows = self._rows(s)
            return mixture(rows, filter_.ladders, filter_.numbers.unpublished)
        if ago == 0:
            return point.x, point.root
        length = np.array([ago])
        maps = flights.tangent.flights([t], length, point.held)
        x, root = point.x.copy(), point.root.copy()
        moved, by = flights.images(maps, point.x[None])
        x[:d], root[:d] = moved[0], maps.Phi[0] @ root[:d] + by[0] @ root[d:]
        if point.error:
            noise = np.zeros((len(x), d))
            flown = length.clip(0.0), point.held, self._bank.intensity
            noise[:d] = flights.tangent.noise(*flown)[0]
            root = triangular(np.hstack([root, point.error * noise]))
        return x, root

    def states(self, s: Vector) -> Matrix:
        """Means after many times of ascending ``s`` seconds, shape (samples, N)."""
        found, d = np.empty((s.size, self._checkpoints[0].x.size)), self._filter.d
        if s.size:
            self._at(float(s[-1]))
        number = np.maximum(np.searchsorted(self._starts, s, side="right") - 1, 0)
        for each in np.unique(number).tolist():
            own = np.flatnonzero(number == each)
            point, t = self._at(float(s[own[0]]))
            ago = s[own] - point.start
            plain = ago <= point.plain
            maps = self._flights.tangent.flights([t] * own.size, ago, point.held)
            found[own] = point.x
            found[own, :d] = self._flights.images(maps, found[own])[0]
            for k in own[~plain].tolist():
                found[k] = self.estimate(float(s[k]))[0]
        return found

    def silent(self, s: float) -> tuple[int, bool]:
        """Impacts that the likeliest hypothesis predicts since the last event, unreported.

        Returns:
            How many it has inserted; and whether it is far inside a stop.
        """
        rows = self._rows(s)
        best, has_sensor = rows.best, self._flights.log_missed < 0
        missed = sum(bool(has_sensor[m.contact]) and not m.is_dead for m in rows.missed[best])
        return missed, bool(rows.sunk[best] < self._filter.numbers.log_inside)

    def closed(self, s: float) -> Contacts:
        """Contacts that the likeliest hypothesis holds closed."""
        rows = self._rows(s)
        return contacts_of(int(rows.held[rows.best]))
