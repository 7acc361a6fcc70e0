# SPDX-License-Identifier: Apache-2.0
"""Hypotheses between events: one flight for all of them, and the impacts that were missed.

All hypotheses with the same closed contacts fly at once; those of a linear system share their
transition matrix. Gaps are followed on a grid of times (``dips``). A dip of a gap below zero says
that an impact was missed, or that the estimate is wrong by as much: the hypothesis branches into
both. A contact that is closed opens where its load falls to zero.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from impact_observer.bank.balance import ImpactState, impact_states
from impact_observer.bank.bank import Array, Hypotheses, Missed, bits, spread_of
from impact_observer.bank.dips import Dips, dips_of
from impact_observer.bank.ladders import Ladders, Numbers
from impact_observer.bank.notes import with_missed
from impact_observer.dynamics.mechanism import Flown, Mechanism
from impact_observer.events import Contacts
from impact_observer.square_roots import triangular
from impact_observer.stamps import Elapsed
from impact_observer.states import Vector

_ROUNDING = 1e-13
"""Depth of a dip that is rounding, over the size of the gap."""
_SETTLED = 1e-7
"""Step of Newton that is the last one, over the fastest time scale; the next is its square."""
_NEWTON = 8
"""Steps by which the instant of a predicted impact is found."""
_LEAST = -40.0
"""Least log probability that a dip costs: no hypothesis becomes impossible by it."""


class Leg(NamedTuple):
    """What flights have in common.

    Attributes:
        t: from when on times are counted, s since the epoch.
        s: when they end, s after ``t``.
        held: contacts that stay closed.
        intensity: of white accelerations for a relative error of one, m/s^1.5, length n.
        named: contacts of the event at the end: it explains gaps of theirs below zero.
        most: impacts that may be missed; None for the tuned number.
        deaf: until when the sensor reports no impact of each contact, s after ``t``, shape (m,).
    """

    t: Elapsed
    s: float
    held: Contacts
    intensity: tuple[float, ...]
    named: Contacts = ()
    deaf: Vector | None = None
    most: int | None = None

    def times(self, s: Vector) -> list[Elapsed]:
        """Instants ``s`` seconds after ``t``, shape (H,); one for all where these are equal."""
        return [self.t + each for each in _once(s).tolist()]


class Reports(NamedTuple):
    """How the sensors of m contacts report impacts.

    Attributes:
        log_missed: log probability that an impact is not reported, shape (m,).
        clocks: deviations of stamps, s; NaN where the ladder holds, shape (m,).
    """

    log_missed: Vector
    clocks: Vector


class Guard(NamedTuple):
    """A gap and its speed in states of hypotheses, linearised.

    Attributes:
        g: gaps, shape (H,), m.
        by: their derivatives by the states, shape (H, N).
        gamma: contact speeds, shape (H,), m/s.
        along: their derivatives by (q, u) at fixed directions, shape (H, d).
    """

    g: Vector
    by: Array
    gamma: Vector
    along: Array


class Flights:
    """The motion of hypotheses between events, near some parameters.

    Attributes:
        mechanism: flights and jumps of the system with these parameters.
        constants: the parameters, and the delay of the stamps where it is estimated, (N - d,).
        ladders: what rungs stand for.
        numbers: the tuned numbers.
        log_missed: log probability that an impact is not reported, of each contact, shape (m,).
        own_clocks: deviations of the stamps of contacts, s; NaN where the ladder holds, (m,).
        d: numbers of (q, u).
        is_noisy: whether any rung has an error of the model.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        constants: Vector,
        ladders: Ladders,
        numbers: Numbers,
        reports: Reports,
    ) -> None:
        """Prepare flights near ``constants``."""
        self.mechanism, self.ladders, self.numbers = mechanism, ladders, numbers
        self.constants, (self.log_missed, self.own_clocks) = constants, reports
        system = mechanism.system
        self.m, self.p, self.d = system.m, mechanism.theta.size, 2 * system.n
        self.rate, self.is_noisy = mechanism.rate, bool(ladders.errors.any())

    def clock(self, contact: NDArray[np.intp] | int, c: NDArray[np.intp]) -> Vector:
        """Deviations of stamps of a contact, by hypotheses on rungs ``c``, shape (H,), s."""
        own = self.own_clocks[contact]
        return np.where(np.isnan(own), self.ladders.clocks[c], own)

    def guard(self, contact: NDArray[np.intp] | int, x: Array) -> Guard:
        """The gap of a contact, or of one each, in states of hypotheses, shape (H, N)."""
        H, n, (g, gamma, W) = np.arange(len(x)), self.d // 2, self.mechanism.gaps(x[:, : self.d])
        by, along = np.zeros(x.shape), np.zeros((len(x), self.d))
        by[:, :n] = along[:, n:] = W[H, contact]
        slopes = self.mechanism.gap_slopes[contact]
        by[:, self.d : self.d + self.p] = slopes
        g = g[H, contact] + np.sum(slopes * self.beside(x), axis=1)
        return Guard(g, by, gamma[H, contact], along)

    def images(self, at: Sequence[float], x: Array, s: Vector, held: Contacts) -> Flown:
        """(q, u) of states (H, N) after flights of ``s`` seconds, (H, d), with derivatives.

        Those by the constants have shape (H, d, N - d). All are of first order in the difference
        of the constants from those of the flights.
        """
        found = self.mechanism.flown(at, x[:, : self.d], s, held)
        by = np.zeros((len(x), self.d, x.shape[1] - self.d))
        if not self.p:
            return found._replace(Gamma=by)
        by[..., : self.p] = found.Gamma
        return Flown(found.x + self.change(found.Gamma, x), found.Phi, by)

    def change(self, by: Array, x: Array) -> Array:
        """What parameters of states (..., N) change of a function, beside those of the flights.

        ``by`` are its derivatives by the parameters, shape (..., k, p); the change is (..., k).
        """
        return np.asarray((by @ self.beside(x)[..., None])[..., 0])

    def beside(self, x: Array) -> Array:
        """Parameters of states (..., N) less those of the flights, shape (..., p)."""
        return x[..., self.d : self.d + self.p] - self.constants[: self.p]

    def moved(self, rows: Hypotheses, leg: Leg) -> Hypotheses:
        """The hypotheses at the end of a ``leg``, with those that impacts were missed.

        Each keeps its own closed contacts, whatever those of the leg are.
        """
        if leg.s <= 0:
            return rows
        if (later := self._undisturbed(rows, leg)) is not None:
            return later
        most = self.numbers.most_missed if leg.most is None else leg.most
        done, todo = list[Hypotheses](), [(rows, np.zeros(rows.size), most)]
        best = -np.inf
        while todo:
            rows, start, left = todo.pop()
            for own, held in rows.by_held():
                group = rows.take(own), start[own], leg._replace(held=held)
                stays, more = self._together(*group, left)
                if stays is not None:
                    done.append(stays)
                    best = max(best, float(stays.logw.max()))
                todo += more
            todo = [self._likely(*each, best) for each in todo]
            todo = [each for each in todo if each[0].size]
        return Hypotheses.joined(done)

    def _undisturbed(self, rows: Hypotheses, leg: Leg) -> Hypotheses | None:
        """The hypotheses at the end of a short leg on which no gap can close; None if one may.

        In one stride a gap is the cubic through values and slopes of both ends, and a cubic is
        above zero where its control points are (Farin, Curves and surfaces for CAGD, 2002).
        """
        if leg.s > self.mechanism.stride or rows.held.any() or rows.paid.any():
            return None
        if not self._is_clear(rows.x, leg.s / 3):
            return None
        leg = leg._replace(held=())
        later = self.flown(rows, leg, np.zeros(rows.size), np.full(rows.size, leg.s))
        return later if self._is_clear(later.x, -leg.s / 3) else None

    def _is_clear(self, x: Array, s: float) -> bool:
        """Whether gaps of states (H, N) are above zero, and ``s`` seconds on at their speeds."""
        g, gamma, _ = self.mechanism.gaps(x[:, : self.d])
        if self.p:
            g = g + self.beside(x) @ self.mechanism.gap_slopes.T
        return bool(((g > 0) & (g + s * gamma > 0)).all())

    def _likely(
        self, rows: Hypotheses, start: Vector, left: int, best: float
    ) -> tuple[Hypotheses, Vector, int]:
        kept = np.flatnonzero(rows.logw > best + self.numbers.log_kept)
        kept = kept[np.argsort(-rows.logw[kept])][: self.numbers.most]
        return rows.take(kept), start[kept], left

    def _together(
        self, rows: Hypotheses, start: Vector, leg: Leg, left: int
    ) -> tuple[Hypotheses | None, list[tuple[Hypotheses, Vector, int]]]:
        """Hypotheses at the end of the leg, of which the same contacts are closed at ``start``.

        Returns:
            Those at the end, None if there are none; and others on their way, since when, and how
            many impacts they may miss still.
        """
        more = []
        if leg.held and np.any(self.log_missed[list(leg.held)] > -np.inf):
            released = self._released(rows, start, leg)
            early = np.isfinite(released)
            if early.any():
                own = np.flatnonzero(early)
                freed = self.flown(rows.take(own), leg, start[own], released[own] - start[own])
                open_ = freed.held & ~bits(leg.held)
                more.append((freed._replace(held=open_, just=freed.held), released[own], left))
                rows, start = rows.take(~early), start[~early]
                if not rows.size:
                    return None, more
        rows, spawned, since = self._branched(rows, leg, start, left > 0)
        if spawned is not None:
            more.append((spawned, since, left - 1))
        return self.flown(rows, leg, start, leg.s - start), more

    def flown(self, rows: Hypotheses, leg: Leg, start: Vector, s: Vector) -> Hypotheses:
        """Hypotheses after flights of ``s`` seconds from ``start`` on, without impacts, (H,)."""
        d = self.d
        times = leg.times(start)
        length = _once(s) if len(times) == 1 else s
        images = self.images(times, rows.x, length, leg.held)
        x, S, B = rows.x.copy(), rows.S.copy(), rows.B
        x[:, :d] = images.x
        S[:, :d] = images.Phi @ rows.S[:, :d]
        if self.p:
            S[:, :d] += images.Gamma @ rows.S[:, d:]
        if self.is_noisy:
            flight = np.maximum(length, 0.0), leg.held, leg.intensity
            noise = self.mechanism.noise(times, rows.x[:, :d], *flight)
            noise = np.broadcast_to(noise, B.shape)
            B = triangular(np.concatenate([images.Phi @ B, noise], axis=2)) if B.any() else noise
        return rows._replace(x=x, S=S, B=B)

    def quiet(self, rows: Hypotheses, leg: Leg) -> float:
        """How long hypotheses fly on before a gap or a load of one falls below zero, s."""
        start, found = np.zeros(rows.size), leg.s
        if (dips := self.dips(rows, leg, start)) is not None:
            found = float(dips.began[:, 0].min())
        if leg.held and np.any(self.log_missed[list(leg.held)] > -np.inf):
            found = min(found, float(self._released(rows, start, leg).min()))
        return found

    def _released(self, rows: Hypotheses, start: Vector, leg: Leg) -> Vector:
        """When the load of a closed contact falls to zero, s after ``t``, (H,); inf for never."""
        times = leg.times(start)
        flight = rows.x[:, : self.d], leg.s - start, leg.held
        load, ends = self.mechanism.loads_along(times, *flight)
        below = load < 0
        first = np.argmax(below.any(axis=1), axis=0)
        found = np.full(rows.size, np.inf)
        for h in np.flatnonzero(below.any(axis=(0, 1))).tolist():
            k = first[h]
            i = int(np.argmin(load[k, :, h]))
            before = max(k - 1, 0)
            a, b = load[before, i, h], load[k, i, h]
            part = a / (a - b) if a > 0 else 0.0
            found[h] = start[h] + ends[before, h] + part * (ends[k, h] - ends[before, h])
        return np.where(found < leg.s, found, np.inf)

    def _branched(
        self, rows: Hypotheses, leg: Leg, start: Vector, may_miss: bool
    ) -> tuple[Hypotheses, Hypotheses | None, Vector]:
        """The hypotheses without missed impacts, and those after a first missed one.

        Returns:
            All hypotheses at their starts, having paid for dips; others just after a missed
            impact; when that was, s after ``t``.
        """
        dips = self.dips(rows, leg, start)
        nothing = None, np.zeros(0)
        if dips is None:
            if rows.paid.any():
                none = np.zeros_like(rows.tried)
                rows = rows._replace(paid=np.zeros_like(rows.paid), tried=none)
            return rows, *nothing
        depth = self._depths(rows, leg, start, dips)
        stays, before = self._paid(rows, leg, dips, depth)
        enough = np.where(dips.is_over, self.numbers.shallow, self.numbers.confident)
        again = dips.was_before & ((rows.tried[dips.h] >> dips.contact & 1) == 1)
        deaf = np.full(self.m, -np.inf) if leg.deaf is None else leg.deaf
        is_dead = dips.began[:, 1] < deaf[dips.contact]
        log_missed = np.where(is_dead, 0.0, self.log_missed[dips.contact])
        tried = (depth > enough) & ~again & (log_missed > -np.inf) & may_miss
        tried &= before > stays.logw.max() + self.numbers.log_kept
        marked = np.zeros_like(rows.tried)
        lasts = (tried | again) & ~dips.is_over
        np.bitwise_or.at(marked, dips.h[lasts], 1 << dips.contact[lasts])
        stays = stays._replace(tried=marked)
        if not tried.any():
            return stays, *nothing
        logw = before + special.log_ndtr(depth) + log_missed
        spawned, since = [], []
        for i in np.unique(dips.contact[tried]).tolist():
            own = np.flatnonzero(tried & (dips.contact == i))
            h = dips.h[own]
            parents = rows.take(h)._replace(
                logw=logw[own], paid=np.zeros((h.size, self.m)), tried=np.zeros_like(h)
            )
            about = (*dips.began[own].T, dips.zero[own])
            after, when, states = self._after_missed(i, leg, parents, start[h], about)
            each = zip(
                when.tolist(), depth[own].tolist(), is_dead[own].tolist(), states, strict=True
            )
            spawned.append(with_missed(after, [Missed(i, leg.t + s, *rest) for s, *rest in each]))
            since.append(when)
        return stays, Hypotheses.joined(spawned), np.concatenate(since)

    def _depths(self, rows: Hypotheses, leg: Leg, start: Vector, dips: Dips) -> Vector:
        """How deep dips are in standard deviations of state, noise and clock, shape (D,)."""
        at = start[dips.h]
        lowest = self.flown(rows.take(dips.h), leg, at, dips.lowest - at)
        guard = self.guard(dips.contact, lowest.x)
        seen = spread_of(lowest, self.ladders, guard.by)
        seen = np.hypot(seen, guard.gamma * self.clock(dips.contact, lowest.c)) + 1e-300
        return -dips.gap / seen

    def _paid(
        self, rows: Hypotheses, leg: Leg, dips: Dips, depth: Vector
    ) -> tuple[Hypotheses, Vector]:
        """The hypotheses after they have paid for ``dips``, whose ``depth`` has shape (D,).

        Returns:
            The hypotheses; and the log probability of each dip's own before that dip, shape (D,).
        """
        cost = np.maximum(special.log_ndtr(-depth), _LEAST)
        is_named = np.isin(dips.contact, leg.named) & ~dips.is_over
        logw, paid, sunk = rows.logw.copy(), np.zeros_like(rows.paid), rows.sunk.copy()
        before = np.empty_like(depth)
        for k, (own, i) in enumerate(zip(dips.h.tolist(), dips.contact.tolist(), strict=True)):
            known = rows.paid[own, i] if dips.was_before[k] else 0.0
            before[k] = logw[own]
            if is_named[k]:  # what it has paid so far is given back
                logw[own] -= known
                continue
            logw[own] += min(cost[k] - known, 0.0)
            if dips.is_over[k] or leg.s - dips.began[k, 1] > self.numbers.patience / self.rate:
                sunk[own] = min(sunk[own], cost[k])
            if not dips.is_over[k]:
                paid[own, i] = min(cost[k], 0.0)
        return rows._replace(logw=logw, paid=paid, sunk=sunk), before

    def dips(self, rows: Hypotheses, leg: Leg, start: Vector) -> Dips | None:
        """Where gaps are below zero from ``start`` to the end of the leg; None if nowhere."""
        n, x = self.d // 2, rows.x[:, : self.d]
        times = leg.times(start)
        values = self.mechanism.gaps_along(times, x, leg.s - start, leg.held)
        g = values.g
        if self.p:
            g = g + self.mechanism.gap_slopes @ self.beside(rows.x).T

        def rounding() -> Vector:
            first = self.mechanism.gaps(x)
            size = np.abs(first.g).max(axis=0)
            size += np.einsum("hmi,hi->hm", np.abs(first.W), np.abs(x[:, :n])).max(axis=0)
            return np.asarray(_ROUNDING * size)

        leaves = (rows.just[None] >> np.arange(self.m)[:, None] & 1) & (values.v[0] >= 0)
        g[0] = np.where(leaves, np.maximum(g[0], 0.0), g[0])
        ignored = np.array(leg.held, dtype=np.intp)
        return dips_of(values._replace(g=g), start, rounding, ignored)

    def _after_missed(
        self, contact: int, leg: Leg, rows: Hypotheses, start: Vector, about: tuple[Vector, ...]
    ) -> tuple[Hypotheses, Vector, list[ImpactState]]:
        """Hypotheses after an impact of a ``contact`` that was missed, each at its own instant.

        The instants are ``about``: lower bounds, upper bounds, and a guess, s, shape (H,) each.
        """
        d, (low, high, at) = self.d, about
        times = leg.times(start)
        for _ in range(_NEWTON):
            x = rows.x.copy()
            x[:, :d] = self.images(times, x, at - start, leg.held).x
            guard = self.guard(contact, x)
            gap, speed = guard.g, guard.gamma
            low, high = np.where(gap > 0, at, low), np.where(gap > 0, high, at)
            newton = at - gap / np.where(speed, speed, -1.0)
            before, inside = at, (newton >= low) & (newton <= high)
            at = np.where(inside, newton, (low + high) / 2)
            if np.all(np.abs(at - before) < _SETTLED / self.rate):
                break
        rows = self.flown(rows, leg, start, at - start)
        guard, mechanism = self.guard(contact, rows.x), self.mechanism
        x, speed = rows.x[:, :d], guard.gamma
        jumps = mechanism.impact(x, (*leg.held, contact))
        t = leg.times(at)
        before, after = (mechanism.rates(t, each, leg.held) for each in (x, jumps.x))
        by_speed = np.pad(guard.along, ((0, 0), (0, rows.x.shape[1] - d)))
        wide = spread_of(rows, self.ladders, by_speed)
        slow = -np.hypot(speed, np.minimum(wide, 1e3))
        early = (guard.by / slow[:, None])[:, None, :]
        roots = rows.published(self.ladders)
        roots[:, :d] -= before[:, :, None] * (early @ roots)
        held, scatter = [leg.held] * len(x), self.ladders.kicks[rows.r]
        states = impact_states(mechanism, (contact,), rows.x, roots, held=held, scatter=scatter)
        change = after - (jumps.Phi @ before[..., None])[..., 0]
        late = change[:, :, None] * early
        Xi = late + np.pad(jumps.Phi, ((0, 0), (0, 0), (0, late.shape[2] - d)))
        S, B, whole = rows.S.copy(), rows.B, rows.x.copy()
        Xi[:, :, d : d + self.p] += jumps.Gamma
        whole[:, :d] = jumps.x + self.change(jumps.Gamma, rows.x)
        S[:, :d] = Xi @ S
        if self.is_noisy:
            kick = np.zeros((len(x), d, 1))
            kick[:, d // 2 :] = speed[:, None, None] * mechanism.stops(x, (contact,))
            kick *= self.ladders.is_learned
            B = triangular(np.concatenate([Xi[:, :, :d] @ B, kick], axis=2))
        lost = (speed >= 0) | (np.abs(guard.g) > _ROUNDING**0.5 * np.abs(speed))
        logw = np.where(lost, -np.inf, rows.logw)
        just = np.full_like(rows.just, bits((contact,)))
        rows = rows._replace(x=whole, S=S, B=B, just=just, logw=logw)
        rows = self.settled(rows, contact, t, leg.held, self.numbers.brief / self.rate)
        return rows, at, states

    def settled(
        self, rows: Hypotheses, contact: int, t: list[Elapsed], held: Contacts, brief: float
    ) -> Hypotheses:
        """Hypotheses just after an impact; a contact whose next flight is brief stays closed.

        Bounces and rest take the same impulse, so flights shorter than ``brief``, s, and those
        that the clock does not resolve, are left out.
        """
        if self.log_missed[contact] == -np.inf:
            return rows
        d, mechanism = self.d, self.mechanism
        x = rows.x[:, :d]
        speed, fall = (
            each[:, contact] for each in (mechanism.gaps(x).gamma, mechanism.falling(t, x, held))
        )
        flight = brief + 2 * self.ladders.clocks[rows.c]
        rests = (fall > 0) & (2 * speed < flight * fall)
        if not rests.any():
            return rows
        own = np.flatnonzero(rests)
        whole, S, B, bit = rows.x.copy(), rows.S.copy(), rows.B.copy(), rows.held.copy()
        still = mechanism.rest(x[own], tuple(sorted({*held, contact})))
        whole[own, :d] = still.x
        S[own, :d] = still.Phi @ S[own, :d]
        B[own] = still.Phi @ B[own]
        bit[own] |= 1 << contact
        return rows._replace(x=whole, S=S, B=B, held=bit)


def _once(s: Vector) -> Vector:
    """The first of equal values, shape (1,); else all of them."""
    return s[:1] if s.size and s.min() == s.max() else s
