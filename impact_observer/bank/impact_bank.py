# SPDX-License-Identifier: Apache-2.0
"""The filter: a bank of hypotheses that is predicted to each event and corrected by it."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from impact_observer.bank.balance import ImpactState, impact_states
from impact_observer.bank.bank import (
    OTHER,
    RESTART,
    SPURIOUS,
    TRUE,
    Bank,
    Hypotheses,
    bits,
    contacts_of,
    mixture,
    objects,
)
from impact_observer.bank.branch import Branches, Priors, impacts
from impact_observer.bank.correct import Hit, corrected
from impact_observer.bank.ladders import NUMBERS, ROUNDING, Ladders, Numbers
from impact_observer.bank.merge import merged, most_of
from impact_observer.bank.notes import Event, decided
from impact_observer.bank.predict import Flights, Leg, Reports
from impact_observer.bank.sample_correction import LinearSample, Sampled, sampled
from impact_observer.dynamics.mechanism import mechanism_near
from impact_observer.events import Contacts
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.square_roots import lengths_of, triangular
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_SHORTEST = 1e-9
"""Shortest flight between two bounces, s."""
_SMALL = 1e-12
"""Size of a motion that has none, m or m/s."""


class DeclaredErrors(NamedTuple):
    """What is declared of the sensor and the model.

    Attributes:
        clock: deviation of a stamp besides its rounding, s; None to weigh several.
        error: white accelerations, m/s^1.5; None to weigh relative errors of the model.
        missed: probability that an impact of each contact is not reported, shape (m,).
        clocks: deviations of the stamps of contacts, s; NaN where ``clock`` holds, shape (m,).
        spurious: probability that an event is a false positive.
        mislabelled: probability that an event is an impact of another contact.
        dead_time: after an event, in which the sensor reports no other hit of the contact, s.
        constants: root of the covariance of the parameters and, where it is estimated, of the
            delay of the stamps, shape (N - 2n, N - 2n).
        considered: which of them are not estimated, shape (N - 2n,).
    """

    clock: float | None = None
    error: float | None = None
    missed: ArrayLike = 0.0
    clocks: ArrayLike = math.nan
    spurious: float = 0.0
    mislabelled: float = 0.0
    dead_time: float = 0.0
    constants: Matrix = np.zeros((0, 0))
    considered: Sequence[bool] = ()


class ImpactBank:
    """A Kalman filter of impact times with hypotheses on what the events were."""

    def __init__(
        self,
        family: ParametricFamily,
        declared: DeclaredErrors | None = None,
        numbers: Numbers = NUMBERS,
    ) -> None:
        """Prepare the filter of the systems of a ``family``, with tuned ``numbers``."""
        declared = declared or DeclaredErrors()
        self.family, self.numbers, self.declared = family, numbers, declared
        system = family.system
        self.n, self.m, self.d = system.n, system.m, 2 * system.n
        self.names = system.contact_names
        self._mechanism = lru_cache(4)(lambda theta: mechanism_near(family, np.array(theta)))
        mechanism = self._mechanism(tuple(family.nominal.tolist()))
        error = declared.error
        level = None if error is None else float(error > 0 or mechanism.is_noisy)
        self.ladders = Ladders.of(declared.clock, level, numbers, has_encoders=system.has_encoders)
        self.rate = mechanism.rate
        missed = np.broadcast_to(np.asarray(declared.missed, dtype=float), self.m)
        with np.errstate(divide="ignore"):
            self.log_missed = np.log(missed)
        clocks = np.broadcast_to(np.asarray(declared.clocks, dtype=float), self.m)
        self._own_clocks = np.hypot(clocks, ROUNDING)
        self.nominal = np.zeros(len(declared.constants))
        self.nominal[: family.size] = family.nominal
        self._considered = self.d + np.flatnonzero(declared.considered)
        self._bounds = np.full((2, self.nominal.size), np.array([[-np.inf], [np.inf]]))
        self._bounds[:, : family.size] = family.bounds
        self._flights = lru_cache(4)(self._flights_of)
        self.priors = Priors.of(
            declared.spurious, declared.mislabelled, self.m, self.rate, numbers
        )
        self._A = mechanism.rate_slopes([0.0], np.zeros((1, self.d)), ())[0][0, self.n :]
        self._size, self._pushed = mechanism.forced()
        self.scan = numbers.scan * self.n
        missed_none = bool(np.all(self.log_missed == -math.inf))
        self._is_trusted = missed_none and self.priors.spurious == -math.inf

    def flights(self, constants: Vector) -> Flights:
        """Flights near these parameters and this delay, shape (N - 2n,)."""
        return self._flights(tuple(constants.tolist()))

    def _flights_of(self, constants: tuple[float, ...]) -> Flights:
        mechanism = self._mechanism(constants[: self.family.size])
        reports = Reports(self.log_missed, self._own_clocks)
        return Flights(mechanism, np.array(constants), self.ladders, self.numbers, reports)

    def begin(self, t: Elapsed, x: Vector, root: Matrix, held: Contacts = ()) -> Bank:
        """The bank at a start: (q, u), shape (2n,), with a root of its covariance, (2n, 2n)."""
        deviations = lengths_of(root) + _SMALL
        flights = self.flights(self.nominal)
        for i in held:
            for is_gap in (True, False):  # gaps and speeds are zero
                guard = flights.guard(i, np.concatenate([x, self.nominal])[None])
                row, value = (guard.by, guard.g) if is_gap else (guard.along, guard.gamma)
                seen = row[0, : self.d] @ root
                x = x - root @ seen * (float(value[0]) / max(float(seen @ seen), 1e-300))
                root = _known(row[0, : self.d], root)
        rows = self._begun(x, root, held)
        never = np.full(self.m, -np.inf)
        size = np.where(self._size > _SMALL, self._size, deviations)
        known = size**2 / 2, self._intensity(size), self.nominal, never
        return Bank(t, rows, x.copy(), *known, closed=held)

    def _intensity(self, sizes: Vector) -> tuple[float, ...]:
        """Of the accelerations of a motion of some size, to a factor of two, or as declared."""
        if self.declared.error is not None:
            return (self.declared.error,) * self.n
        accelerations = np.maximum(np.abs(self._A * sizes).max(axis=1), self._pushed) + _SMALL
        rounded = 2.0 ** np.round(np.log2(accelerations))
        return tuple((rounded / math.sqrt(self.rate)).tolist())

    def _begun(self, x: Vector, root: Matrix, held: Contacts) -> Hypotheses:
        r, c, logw = self.ladders.first(self.numbers)
        H = r.size
        whole = np.concatenate([x, self.nominal])
        return Hypotheses(
            np.tile(whole, (H, 1)),
            np.tile(linalg.block_diag(root, self.declared.constants), (H, 1, 1)),
            np.zeros((H, self.d, self.d)),
            logw,
            r,
            c,
            np.zeros((H, self.scan), dtype=np.intp),
            np.zeros((H, self.m)),
            np.zeros(H),
            np.full(H, bits(held)),
            np.zeros(H, dtype=np.intp),
            np.zeros(H, dtype=np.intp),
            objects([()] * H),
            objects([()] * H),
        )

    def _begun_anew(
        self, before: Hypotheses, x: Vector, root: Matrix, held: Contacts, logw: float
    ) -> Hypotheses:
        """Hypotheses of a new start, ``logw`` together; notes are those of the best ``before``."""
        rows = self._begun(x, root, held)
        notes = objects([before.notes[before.best]] * rows.size)
        return rows._replace(logw=rows.logw + logw, notes=notes)

    def predicted(self, bank: Bank, s: float, named: Contacts = ()) -> Bank:
        """The bank ``s`` seconds later, just before an event of the contacts ``named`` if any."""
        if s > 0:
            leg = Leg(bank.t, s, (), bank.intensity, named, self.deaf(bank, bank.t))
            rows = self.flights(bank.constants).moved(bank.rows, leg)
            bank = bank._replace(t=bank.t + s, rows=rows, ago=bank.ago + s)
            if rows.size > 1 and not named and self._ticks(bank.t, s):
                bank = bank._replace(rows=merged(rows, self.ladders, self.numbers, self.scan))
            if self.family.system.has_encoders:
                x = rows.x[rows.best, : self.d]
                return self._sized(bank._replace(replica=x, ago=0.0), x**2, s)
        return self._followed(bank) if named and bank.ago > 0 else bank

    def _ticks(self, t: Elapsed, s: float) -> bool:
        """Whether a time scale since the epoch ends in the ``s`` seconds before ``t``."""
        return math.floor(t * self.rate) != math.floor((t + -s) * self.rate)

    def _followed(self, bank: Bank) -> Bank:
        """The bank with its replica at its own instant, whose motion since then has a size."""
        s, flights = bank.ago, self.flights(bank.constants)
        start, replicas = bank.t + -s, np.tile(bank.replica, (2, 1))
        lengths = np.array([s / 2, s])
        middle, replica = flights.mechanism.flown([start], replicas, lengths, bank.closed).x
        bank = bank._replace(replica=replica, ago=0.0)
        return self._sized(bank, (middle**2 + replica**2) / 2, s)

    def _sized(self, bank: Bank, squares: Vector, s: float) -> Bank:
        """The bank with the mean squares of its motion in the last ``s`` seconds, shape (2n,)."""
        # flights shorter than the fastest period, as between samples, count less
        kept = self.numbers.forgetting ** min(s * self.rate / (2 * math.pi), 1.0)
        squares = kept * bank.squares + (1 - kept) * squares
        squares = np.minimum(squares, 4 * bank.squares)
        return bank._replace(squares=squares, intensity=self._intensity(np.sqrt(2 * squares)))

    def flown_on(self, bank: Bank, s: float) -> tuple[Vector, Matrix]:
        """The likeliest hypothesis ``s`` seconds later as if no impact came, and a root of it.

        Shapes (N,) and (N, N): the state before an event, on its own side of it.
        """
        best = bank.rows.take([bank.rows.best])
        leg = Leg(bank.t, s, contacts_of(int(best.held[0])), bank.intensity)
        later = self.flights(bank.constants).flown(best, leg, np.zeros(1), np.array([s]))
        return later.x[0], triangular(later.published(self.ladders)[0])

    def gaussian(self, rows: Hypotheses) -> tuple[Vector, Matrix]:
        """``mixture`` as published: mean and root of the covariance, shapes (N,) and (N, N)."""
        return mixture(rows, self.ladders, self.numbers.unpublished)

    def deaf(self, bank: Bank, t: float) -> Vector | None:
        """Until when the sensor reports no impact of each contact, s after ``t``, shape (m,)."""
        time = self.declared.dead_time
        return bank.reported + (time - float(t)) if time else None

    def after(self, bank: Bank, event: Event) -> Bank:
        """The bank after an event now.

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
        """
        bank = self._opened(bank, event)
        if not event.hit:
            return bank
        rows, priors, numbers = bank.rows, self.priors, self.numbers
        flights = self.flights(bank.constants)
        found = []
        resting = (rows.held & bits(event.hit)) != 0
        true, free = self._true(rows, event, flights, resting)
        false = rows.logw + priors.spurious + priors.false_rate
        ago = max(float(bank.t) - float(np.max(bank.reported[list(event.hit)])), _SHORTEST)
        density = -math.log(ago) - ago * self.rate  # of the next bounce in a row that ends
        bounce = np.where(resting, rows.logw + priors.true + density, -np.inf)
        evidence = float(np.logaddexp.reduce(np.concatenate([true.logw, false, bounce])))
        before = float(np.logaddexp.reduce(rows.logw))
        kept = max(float(each.max(initial=-np.inf)) for each in (true.logw, false, bounce))
        kept += numbers.log_kept
        most = most_of(numbers, rows.x.shape[1])
        order = np.argsort(-true.logw)[:most]
        order = order[true.logw[order] > kept]
        if order.size:
            found.append(self._corrected(free, true.take(order), bank.t, event, flights))
        least = np.full(free.size, np.inf)
        np.minimum.at(least, true.h, true.z)
        z = np.full(rows.size, -1.0)
        z[~resting] = least
        for logw, kind, sizes in ((false, SPURIOUS, z), (bounce, TRUE, -np.ones(z.size))):
            order = np.argsort(-logw)[:most]
            order = order[logw[order] > kept]
            if order.size:
                stays = rows.take(order)._replace(logw=logw[order])
                is_hit = kind != SPURIOUS
                states = self._resting(stays, event, flights) if is_hit else [None] * order.size
                z_of = sizes[order].tolist()
                found.append(decided(stays, (event, bank.t), (kind, ""), z_of, states))
        replica = flights.mechanism.struck(bank.replica, event.hit)
        if bank.closed:
            replica = flights.mechanism.stopped(replica, bank.closed)
        farthest = float(z[rows.best])
        is_expected = evidence - before >= math.log(self.rate) or self._trusts(farthest)
        if not (found and is_expected):
            weight = numbers.log_restart
            if bank.is_expected:
                weight = max(priors.spurious, numbers.log_least_spurious) + numbers.log_sudden
            weight += before + priors.false_rate
            found.append(self._restarted(replica, bank, event, weight, flights))
        rows = merged(Hypotheses.joined(found), self.ladders, numbers, self.scan)
        rows = rows._replace(held=rows.held & ~bits(event.opened))
        reported = bank.reported.copy()
        reported[list(event.hit)] = bank.t
        doubted = bank.doubted + 1 if self._is_in_error(bank.rows) else 0
        bank = bank._replace(
            rows=rows,
            replica=replica,
            reported=reported,
            doubted=doubted,
            is_expected=bool(found) and is_expected,
        )
        if self._is_trusted and not self._trusts(farthest):
            bank = bank._replace(contradicted=numbers.remembered, farthest=farthest)
        elif bank.contradicted:
            bank = bank._replace(contradicted=bank.contradicted - 1)
        return self._recentred(bank)

    def _opened(self, bank: Bank, event: Event) -> Bank:
        """The bank where contacts have opened that did not hit, with those that are closed now."""
        bank = self._followed(bank) if bank.ago > 0 else bank
        closed = tuple(sorted({*bank.closed, *event.closed} - {*event.opened}))
        alone = bits(tuple(i for i in event.opened if i not in event.hit))
        rows = bank.rows._replace(held=bank.rows.held & ~alone)
        return bank._replace(rows=rows, closed=closed)

    def _trusts(self, z: float) -> bool:
        """Whether the sensor has no faults, and an innovation of ``z`` deviations is possible."""
        return self._is_trusted and z <= self.numbers.contradiction

    def measured(
        self, bank: Bank, sample: LinearSample, *, lost: bool = False
    ) -> tuple[Bank, Sampled]:
        """The bank after a sample now; ``lost`` where the last samples were rejected.

        Returns:
            The bank, and what became of the sample, the likeliest hypothesis first.
        """
        flights, rows = self.flights(bank.constants), bank.rows
        if lost:
            x, held = rows.x[rows.best, : self.d], contacts_of(int(rows.held[rows.best]))
            root = np.diag(self.numbers.restart_deviation * bank.sizes)
            weight = float(rows.logw.max()) + self.numbers.log_restart
            rows = Hypotheses.joined([rows, self._begun_anew(rows, x, root, held, weight)])
        found = sampled(rows, sample, bank.t, flights, self._considered)
        if found.rows.size > 1:
            order = np.argsort(-found.rows.logw)
            logw = found.rows.logw[order]
            order = order[logw > logw[0] + self.numbers.log_kept]
            found = Sampled(found.rows.take(order), found.innovation[order], found.z[order])
        rows = found.rows
        if rows.size > most_of(self.numbers, rows.x.shape[1]):
            rows = merged(rows, self.ladders, self.numbers, self.scan)
        rows = rows._replace(logw=rows.logw - np.logaddexp.reduce(rows.logw))
        return self._recentred(bank._replace(rows=rows)), found

    def _is_in_error(self, rows: Hypotheses) -> bool:
        """Whether the model is almost surely in error, which nothing declares."""
        exact = rows.weights @ (self.ladders.kicks[rows.r] < self.numbers.least_error)
        return bool(exact < self.numbers.exact)

    def _true(
        self, rows: Hypotheses, event: Event, flights: Flights, resting: NDArray[np.bool_]
    ) -> tuple[Branches, Hypotheses]:
        """That contacts have hit, those named or others, of hypotheses where they are open."""
        free, priors = rows.take(~resting), self.priors
        if not free.size:
            none, nothing = np.zeros(0, dtype=np.intp), np.zeros(0)
            return Branches(none, none, none, none, nothing, nothing), free
        parts = [_weighted(impacts(free, event.hit, flights), priors.true)]
        if priors.other > -math.inf and len(event.hit) == 1 and not event.closed:
            for i in range(self.m):
                if i != event.hit[0]:
                    found = _weighted(impacts(free, (i,), flights), priors.other)
                    is_held = (free.held[found.h] >> i & 1) != 0
                    parts.append(found._replace(logw=np.where(is_held, -np.inf, found.logw)))
        return Branches.joined(parts), free

    def _corrected(
        self, rows: Hypotheses, branches: Branches, t: Elapsed, event: Event, flights: Flights
    ) -> Hypotheses:
        """The hypotheses of ``branches``, after their impacts."""
        chosen = rows.take(branches.h)._replace(r=branches.r, c=branches.c, logw=branches.logw)
        parts, named = [], event.hit[0]
        for i in np.unique(branches.contact).tolist():
            hit = event.hit if i == named else (i,)
            of_contact = np.flatnonzero(branches.contact == i)
            for which, held in chosen.take(of_contact).by_held():
                own, closed = of_contact[which], tuple(sorted({*held, *event.closed}))
                group = chosen.take(own)
                struck = Hit(t, hit, held, closed)
                rows, states = corrected(group, struck, flights, self._considered)
                just = np.full_like(group.just, bits(hit))
                rows = rows._replace(just=just, held=np.full_like(group.held, bits(closed)))
                kind = (TRUE, "") if i == named else (OTHER, self.names[i])
                rows = decided(rows, (event, t), kind, branches.z[own].tolist(), states)
                if not event.closed and len(hit) == 1:
                    brief = self.numbers.bounce / self.rate
                    rows = flights.settled(rows, i, [t], held, brief)
                parts.append(rows)
        return Hypotheses.joined(parts)

    def _recentred(self, bank: Bank) -> Bank:
        """The bank with parameters and delay within their bounds, and flights near the best."""
        size, rows = self.nominal.size, bank.rows
        if size == self._considered.size:
            return bank
        x = rows.x.copy()
        x[:, self.d :] = np.clip(x[:, self.d :], *self._bounds)
        best = rows.best
        found = x[best, self.d :]
        deviations = lengths_of(rows.S[best, self.d :])
        far = np.abs(found - bank.constants) > self.numbers.recentre * deviations
        far[[i - self.d for i in self._considered]] = False
        bank = bank._replace(rows=rows._replace(x=x))
        if not far.any():
            return bank
        constants = np.where(far, found, bank.constants)
        if size == self.family.size or not far[-1]:
            return bank._replace(constants=constants)
        return self._shifted(bank, constants)

    def _shifted(self, bank: Bank, constants: Vector) -> Bank:
        """The bank with another delay, at the same stamp: it holds earlier or later."""
        flights, s = self.flights(bank.constants), float(bank.constants[-1] - constants[-1])
        rows, parts, order = bank.rows, [], []
        for own, held in rows.by_held():
            leg = Leg(bank.t, s, held, bank.intensity)
            part = flights.flown(rows.take(own), leg, np.zeros(own.size), np.full(own.size, s))
            parts.append(part)
            order.append(own)
        rows = Hypotheses.joined(parts).take(np.argsort(np.concatenate(order)))
        late = bank.late - s
        return bank._replace(t=bank.t + s, rows=rows, constants=constants, late=late)

    def _restarted(
        self, replica: Vector, bank: Bank, event: Event, logw: float, flights: Flights
    ) -> Hypotheses:
        """Hypotheses about the replica, ``logw`` together, as uncertain as the motion is large."""
        root = np.diag(self.numbers.restart_deviation * bank.sizes)
        whole = np.concatenate([replica, self.nominal])[None]
        for contact in event.hit:
            root = _known(flights.guard(contact, whole).by[0, : self.d], root)
        rows = self._begun_anew(bank.rows, replica, root, event.closed, logw)
        rows = rows._replace(just=np.full_like(rows.just, bits(event.hit)))
        x, known = np.concatenate([bank.replica, self.nominal])[None], rows.S[:1]
        held, scatter = [bank.closed], np.zeros(1)
        (state,) = impact_states(
            flights.mechanism, event.hit, x, known, held=held, scatter=scatter
        )
        states = [state] * rows.size
        return decided(rows, (event, bank.t), (RESTART, ""), [-1.0] * rows.size, states)

    def _resting(self, rows: Hypotheses, event: Event, flights: Flights) -> list[ImpactState]:
        """The states at an impact of contacts that rest: one of a row of bounces."""
        held = [
            tuple(i for i in contacts_of(each) if i not in event.hit)
            for each in rows.held.tolist()
        ]
        roots, scatter = rows.published(self.ladders), self.ladders.kicks[rows.r]
        return impact_states(
            flights.mechanism, event.hit, rows.x, roots, held=held, scatter=scatter
        )


def _known(row: Vector, root: Matrix) -> Matrix:
    """A ``root`` of a covariance where the function of a ``row`` is known exactly."""
    seen = row @ root
    return np.asarray(root - np.outer(root @ seen, seen) / max(float(seen @ seen), 1e-300))


def _weighted(branches: Branches, log: float) -> Branches:
    return branches._replace(logw=branches.logw + log)
