# SPDX-License-Identifier: Apache-2.0
"""A bank between two events, at any instant: what is published of it.

The likeliest hypotheses are followed from checkpoint to checkpoint. At first these are a window of
the mechanism apart; the distance doubles every 16 checkpoints. So an estimate is a
function of its instant, whatever was asked for before. From a checkpoint to the first dip of a gap
their mixture is one Gaussian.
"""

from bisect import bisect_right
from functools import cached_property, lru_cache

import numpy as np

from impact_observer.bank.bank import Bank, Hypotheses, contacts_of
from impact_observer.bank.impact_bank import ImpactBank
from impact_observer.bank.merge import merged
from impact_observer.bank.predict import Leg
from impact_observer.events import Contacts
from impact_observer.states import Matrix, Vector

_EQUAL = 16
"""Checkpoints until their distance doubles."""


class Checkpoint:
    """What is published from one checkpoint on; each part is found when it is asked for.

    Attributes:
        rows: the hypotheses.
        start: s since the event.
        length: s until the next one.
        t: when it is, s since the epoch.
        held: contacts that the likeliest hypothesis holds closed.
    """

    def __init__(self, course: "Course", rows: Hypotheses, start: float, length: float) -> None:
        """Hypotheses of a ``course``."""
        self._course, self.rows, self.start, self.length = course, rows, start, length
        self.t, self.held = course.bank.t + start, contacts_of(int(rows.held[0]))

    @cached_property
    def gaussian(self) -> tuple[Vector, Matrix]:
        """Their mean, shape (N,), and a root of their covariance, (N, N)."""
        return self._course.filter.gaussian(self.rows)

    @cached_property
    def error(self) -> float:
        """Root mean square of their relative errors of the model."""
        ladders = self._course.filter.ladders
        each = ladders.errors * ladders.persistence
        return float(np.sqrt(self.rows.weights @ each[self.rows.r] ** 2))

    def is_plain(self, s: float) -> bool:
        """Whether the hypotheses are one Gaussian ``s`` seconds later."""
        return s <= 0 or s > self.length or s <= self._quiet

    @cached_property
    def _quiet(self) -> float:
        """How long no gap or load falls below zero, s."""
        rows, course = self.rows, self._course
        if np.any(rows.held != rows.held[0]) or rows.paid.any():
            return 0.0
        return course.flights.quiet(
            rows, Leg(self.t, self.length, self.held, course.bank.intensity)
        )


class Course:
    """The published estimate from one event on.

    Attributes:
        filter: of the bank.
        bank: the hypotheses at the event.
        flights: near their parameters.
    """

    def __init__(self, filter_: ImpactBank, bank: Bank) -> None:
        """Follow the likeliest hypotheses of ``bank``."""
        self.filter, self.bank = filter_, bank
        self.flights = filter_.flights(bank.constants)
        shown = bank.rows.shown(filter_.numbers.unpublished)
        self._checkpoints = [Checkpoint(self, shown, 0.0, self.flights.mechanism.window)]
        self._starts = [0.0]
        self.estimate = lru_cache(2)(self._estimate)
        self._rows = lru_cache(2)(self._rows_at)

    def _at(self, s: float) -> Checkpoint:
        """The checkpoint before ``s``."""
        last, filter_ = self._checkpoints[-1], self.filter
        while s >= last.start + last.length and not self._is_lost:
            rows = self._moved(last, last.length)
            rows = merged(rows, filter_.ladders, filter_.numbers, filter_.scan)
            count = len(self._checkpoints)
            length = last.length * (1 if count % _EQUAL else 2)
            last = Checkpoint(self, rows, last.start + last.length, length)
            self._checkpoints.append(last)
            self._starts.append(last.start)
        return self._checkpoints[max(bisect_right(self._starts, s) - 1, 0)]

    @property
    def _is_lost(self) -> bool:
        """Whether so many impacts were missed that none is looked for any more."""
        rows = self._checkpoints[-1].rows
        return len(rows.missed[rows.best]) >= self.filter.numbers.most_silent

    def _rows_at(self, s: float) -> Hypotheses:
        """What is decided after ``s`` seconds; states may be those of the checkpoint before."""
        point = self._at(s)
        ago = s - point.start
        return point.rows if point.is_plain(ago) else self._moved(point, ago)

    def _moved(self, point: Checkpoint, s: float) -> Hypotheses:
        """Hypotheses ``s`` seconds after a checkpoint."""
        bank = self.bank
        most, deaf = self.filter.numbers.most_silent, self.filter.deaf(bank, point.t)
        leg = Leg(point.t, s, (), bank.intensity, deaf=deaf, most=most)
        return self.flights.moved(point.rows, leg)

    def _estimate(self, s: float) -> tuple[Vector, Matrix]:
        """Mean, shape (N,), and root of the covariance, (N, any), after ``s`` seconds."""
        point = self._at(s)
        ago = s - point.start
        flights, d = self.flights, self.filter.d
        if not point.is_plain(ago):
            return self.filter.gaussian(self._rows(s))
        if ago == 0:
            return point.gaussian
        length, (start, root) = np.array([ago]), point.gaussian
        moved = flights.images([point.t], start[None], length, point.held)
        x, root = start.copy(), root.copy()
        x[:d] = moved.x[0]
        root[:d] = moved.Phi[0] @ root[:d] + moved.Gamma[0] @ root[d:]
        if point.error:
            noise = np.zeros((len(x), d))
            flown = length.clip(0.0), point.held, self.bank.intensity
            noise[:d] = flights.mechanism.noise([point.t], start[None, :d], *flown)[0]
            root = np.hstack([root, point.error * noise])
        return x, root

    def states(self, s: Vector) -> Matrix:
        """Means after many times of ascending ``s`` seconds, shape (samples, N)."""
        found, d = np.empty((s.size, self.bank.rows.x.shape[1])), self.filter.d
        if s.size:
            self._at(float(s[-1]))
        number = np.maximum(np.searchsorted(self._starts, s, side="right") - 1, 0)
        for each in np.unique(number).tolist():
            own = np.flatnonzero(number == each)
            point = self._at(float(s[own[0]]))
            ago = s[own] - point.start
            plain = np.array([point.is_plain(each) for each in ago.tolist()])
            found[own] = point.gaussian[0]
            moved = self.flights.images([point.t], found[own], ago, point.held)
            found[own, :d] = moved.x
            for k in own[~plain].tolist():
                found[k] = self.estimate(float(s[k]))[0]
        return found

    def silent(self, s: float) -> tuple[int, bool]:
        """Impacts that the likeliest hypothesis predicts since the last event, unreported.

        Returns:
            How many it has inserted; and whether it is far inside a stop.
        """
        rows = self._rows(s)
        best, has_sensor = rows.best, self.flights.log_missed < 0
        missed = sum(bool(has_sensor[m.contact]) and not m.is_dead for m in rows.missed[best])
        return missed, bool(rows.sunk[best] < self.filter.numbers.log_inside)

    def closed(self, s: float) -> Contacts:
        """Contacts that the likeliest hypothesis holds closed."""
        rows = self._rows(s)
        return contacts_of(int(rows.held[rows.best]))
