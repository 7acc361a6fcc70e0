# SPDX-License-Identifier: Apache-2.0
"""Hypotheses between events: one flight for all of them, and the impacts that were missed.

All hypotheses with the same closed contacts share the maps of a flight. Their gaps are followed on
a grid of times. A dip of a gap below zero says that an impact was missed, or that the estimate is
wrong by as much: the hypothesis branches into both.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from impact_observer.bank.bank import (
    MISSED,
    Array,
    Hypotheses,
    bits,
    contacts_of,
    spread_of,
)
from impact_observer.bank.ladders import Ladders, Numbers, triangular
from impact_observer.dynamics.tangent import Tangent
from impact_observer.events import Contacts
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_ROUNDING = 1e-13
"""Depth of a dip that is rounding, over the size of the gap."""
_TABLE = 4096
"""Most steps of the table of a flight; of longer flights the steps are longer."""
_NEWTON = 4
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
    """

    t: Elapsed
    s: float
    held: Contacts
    intensity: tuple[float, ...]
    named: Contacts = ()


class Dips(NamedTuple):
    """Intervals in which gaps are below zero, one row each.

    Attributes:
        h: the hypothesis.
        contact: the contact.
        began: bounds of the instant at which the gap falls below zero, s, shape (D, 2).
        lowest: when it is lowest, s.
        gap: how low, m.
        is_over: whether the gap has come back above zero.
        was_before: whether it was below zero at the start already.
    """

    h: NDArray[np.intp]
    contact: NDArray[np.intp]
    began: Array
    lowest: Vector
    gap: Vector
    is_over: NDArray[np.bool_]
    was_before: NDArray[np.bool_]


class Flights:
    """The motion of hypotheses between events.

    Attributes:
        tangent: flights and jumps of the system.
        ladders: what rungs stand for.
        numbers: the tuned numbers.
        log_missed: log probability that an impact is not reported, of each contact, shape (m,).
    """

    def __init__(
        self,
        tangent: Tangent,
        ladders: Ladders,
        numbers: Numbers,
        log_missed: Vector,
    ) -> None:
        """Prepare the rows of gaps and speeds."""
        self.tangent, self.ladders, self.numbers = tangent, ladders, numbers
        self.log_missed = log_missed
        system = tangent.system
        self.n, self.m = system.n, system.m
        W = system.W.T
        self.gap_rows = np.hstack([W, np.zeros_like(W)])
        self.speed_rows = np.hstack([np.zeros_like(W), W])
        self.rest = tangent.gaps(tuple(range(self.m))).rest
        self._table = lru_cache(16)(self._table_of)

    def moved(self, rows: Hypotheses, leg: Leg) -> Hypotheses:
        """The hypotheses at the end of a ``leg``, with those that impacts were missed.

        Each keeps its own closed contacts, whatever those of the leg are.
        """
        if leg.s <= 0:
            return rows
        parts = []
        for number in np.unique(rows.held).tolist():
            group = rows.take(np.flatnonzero(rows.held == number))
            parts += self._moved_together(group, leg._replace(held=contacts_of(number)))
        return Hypotheses.joined(parts)

    def _moved_together(self, rows: Hypotheses, leg: Leg) -> list[Hypotheses]:
        """``moved`` hypotheses that have the contacts of the leg closed."""
        done, start = [], np.zeros(rows.size)
        for _ in range(self.numbers.most_missed + 1):
            rows, spawned, since = self._branched(rows, leg, start)
            done.append(self.flown(rows, leg, start, leg.s - start))
            if spawned is None:
                break
            best = max(each.logw.max() for each in done)
            kept = np.flatnonzero(spawned.logw > best + self.numbers.log_kept)
            kept = kept[np.argsort(-spawned.logw[kept])][: self.numbers.most]
            if not kept.size:
                break
            rows, start = spawned.take(kept), since[kept]
        return done

    def flown(self, rows: Hypotheses, leg: Leg, start: Vector, s: Vector) -> Hypotheses:
        """Hypotheses after flights of ``s`` seconds from ``start`` on, without impacts, (H,)."""
        d = 2 * self.n
        same = start.min() == start.max() and s.min() == s.max()
        at, length = (start[:1], s[:1]) if same else (start, s)
        maps = self.tangent.flights([leg.t + each for each in at.tolist()], length, leg.held)
        x, S = rows.x.copy(), rows.S.copy()
        x[:, :d], S[:, :d] = maps.of(rows.x[:, :d]), maps.Phi @ rows.S[:, :d]
        B = rows.B
        if self.ladders.errors.any():
            noise = self.tangent.noise(np.maximum(length, 0.0), leg.held, leg.intensity)
            if B.any():
                wide = np.concatenate(
                    [maps.Phi @ B[:, :d], np.broadcast_to(noise, (rows.size, d, d))], axis=2
                )
                B = B.copy()
                B[:, :d] = triangular(wide)[..., : B.shape[2]]
            else:
                B = np.zeros_like(B)
                B[:, :d, :d] = noise
        return rows._replace(x=x, S=S, B=B)

    def _branched(
        self, rows: Hypotheses, leg: Leg, start: Vector
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
        at = start[dips.h]
        lowest = self.flown(rows.take(dips.h), leg, at, dips.lowest - at)
        row = np.zeros((len(at), lowest.x.shape[1]))
        row[:, : 2 * self.n] = self.gap_rows[dips.contact]
        seen = spread_of(lowest, self.ladders, row)
        speed = np.einsum("di,di->d", self.speed_rows[dips.contact], lowest.x[:, : 2 * self.n])
        seen = np.hypot(seen, speed * self.ladders.clocks[lowest.c]) + 1e-300
        depth = -dips.gap / seen
        is_named = np.isin(dips.contact, leg.named) & ~dips.is_over
        cost = np.maximum(special.log_ndtr(-depth), _LEAST)
        logw, paid = rows.logw.copy(), np.zeros_like(rows.paid)
        before = logw[dips.h].copy()
        each = zip(dips.h.tolist(), dips.contact.tolist(), strict=True)
        for k, (own, contact) in enumerate(each):
            owed = float(cost[k]) - (rows.paid[own, contact] if dips.was_before[k] else 0.0)
            before[k] = logw[own]
            if is_named[k]:  # what it has paid so far is given back
                logw[own] -= rows.paid[own, contact] if dips.was_before[k] else 0.0
                continue
            logw[own] += min(owed, 0.0)
            if not dips.is_over[k]:
                paid[own, contact] = min(cost[k], 0.0)
        enough = np.where(dips.is_over, self.numbers.shallow, self.numbers.confident)
        again = dips.was_before & ((rows.tried[dips.h] >> dips.contact & 1) == 1)
        tried = (depth > enough) & ~again & (self.log_missed[dips.contact] > -np.inf)
        tried &= before > logw.max() + self.numbers.log_kept
        marked = np.zeros_like(rows.tried)
        lasts = (tried | again) & ~dips.is_over
        np.bitwise_or.at(marked, dips.h[lasts], 1 << dips.contact[lasts])
        stays = rows._replace(logw=logw, paid=paid, tried=marked)
        if not tried.any():
            return stays, *nothing
        which = np.flatnonzero(tried)
        parents = rows.take(dips.h[which])
        log = before[which] + special.log_ndtr(depth[which])
        log += self.log_missed[dips.contact[which]]
        none = np.zeros_like(parents.tried)
        parents = parents._replace(logw=log, paid=np.zeros_like(parents.paid), tried=none)
        spawned, since = [], []
        for i in np.unique(dips.contact[which]).tolist():
            own = np.flatnonzero(dips.contact[which] == i)
            parts = parents.take(own), start[dips.h[which]][own], dips.began[which][own]
            after, when = self._after_missed(i, leg, *parts)
            spawned.append(after)
            since.append(when)
        return stays, Hypotheses.joined(spawned), np.concatenate(since)

    def dips(self, rows: Hypotheses, leg: Leg, start: Vector) -> Dips | None:
        """Where gaps are below zero from ``start`` to the end of the leg; None if nowhere."""
        H, m = rows.size, self.m
        length = float(leg.s - start.min())
        step = self.tangent.phase(leg.held).flow.exponential.step / 2
        step *= 2 ** max(0, int(np.ceil(np.log2(max(length / step / _TABLE, 1e-9)))))
        steps = max(int(np.ceil(length / step)), 1)
        table = self._table(leg.held, step, 1 << (steps - 1).bit_length())[: steps + 1]
        drive = self.tangent.phase(leg.held).flow.drive
        if drive.is_smooth:
            y = [drive.at(leg.t + each) for each in np.unique(start).tolist()]
            which = np.unique(start, return_inverse=True)[1].ravel()
            z = np.hstack([rows.x[:, : 2 * self.n], np.array(y)[which]])
            values = (table @ z.T).reshape(steps + 1, 2, m, H)
        else:
            values = self._sampled_values(rows, leg, start, np.arange(steps + 1) * step)
        g, v = values[:, 0] + self.rest[:, None], values[:, 1]
        free = leg.s - start
        ends = np.minimum(np.arange(steps + 1)[:, None] * step, free)
        last = np.minimum((free / step).astype(int), steps - 1)
        # the last step of each hypothesis ends at s: by the cubic through its ends
        part = (free - last * step) / step
        each = np.arange(H)
        both = np.stack([last, last + 1])
        g_end, v_end = _cubic(g[both, :, each], v[both, :, each], step, part[:, None])
        beyond = np.arange(steps + 1)[:, None, None] > last
        g = np.where(beyond, g_end.T, g)
        v = np.where(beyond, v_end.T, v)
        size = np.abs(self.gap_rows) @ np.abs(rows.x[:, : 2 * self.n]).max(axis=0) + np.abs(
            self.rest
        )
        g[0] = np.where(rows.just[None] >> np.arange(m)[:, None] & 1, np.maximum(g[0], 0.0), g[0])
        T = np.diff(ends, axis=0)[:, None]
        low, at = _lowest(g, v, T)
        for i in leg.held:
            low[:, i] = 0.0
        negative = low < -_ROUNDING * size[:, None]
        if not negative.any():
            return None
        return _runs(negative, _Grid(g, low, at + ends[:-1, None], ends), start)

    def _sampled_values(self, rows: Hypotheses, leg: Leg, start: Vector, times: Vector) -> Array:
        """Gaps without their rests, and speeds, where forces have samples or switches."""
        found = np.empty((times.size, 2, self.m, rows.size))
        both = np.vstack([self.gap_rows, self.speed_rows])
        for at in np.unique(start).tolist():
            own = np.flatnonzero(start == at)
            maps = self.tangent.flights([leg.t + at] * times.size, times, leg.held)
            x = maps.Phi @ rows.x[own, : 2 * self.n].T + maps.drift[:, :, None]
            found[..., own] = (both @ x).reshape(times.size, 2, self.m, own.size)
        return found

    def _table_of(self, held: Contacts, step: float, steps: int) -> Array:
        """Gaps and speeds after 0, 1, 2, .. steps, as rows of the state, (steps + 1, 2m, N)."""
        exponential = self.tangent.phase(held).flow.exponential
        size, d = len(exponential.A), 2 * self.n
        table = np.zeros((1, 2 * self.m, size))
        table[0, : self.m, :d], table[0, self.m :, :d] = self.gap_rows, self.speed_rows
        power = exponential.matrix(step)
        while len(table) <= steps:
            table = np.concatenate([table, table @ power])
            power = power @ power
        return table[: steps + 1]

    def _after_missed(
        self, contact: int, leg: Leg, rows: Hypotheses, start: Vector, began: Array
    ) -> tuple[Hypotheses, Vector]:
        """Hypotheses after an impact of a ``contact`` that was missed, each at its own instant."""
        d, w = 2 * self.n, self.gap_rows[contact]
        at = began.mean(axis=1)
        low, high = began.T.copy()
        for _ in range(_NEWTON):
            maps = self.tangent.flights(
                [leg.t + each for each in start.tolist()], at - start, leg.held
            )
            x = maps.of(rows.x[:, :d])
            gap, speed = x @ w + self.rest[contact], x @ self.speed_rows[contact]
            low, high = np.where(gap > 0, at, low), np.where(gap > 0, high, at)
            newton = at - gap / np.where(speed, speed, -1.0)
            at = np.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
        rows = self.flown(rows, leg, start, at - start)
        x = rows.x[:, :d]
        speed = x @ self.speed_rows[contact]
        jumps = self.tangent.impact(x, (*leg.held, contact))
        before = self._rates(leg, at, x)
        after = self._rates(leg, at, jumps.x)
        row = np.zeros((rows.size, rows.x.shape[1]))
        row[:, :d] = self.speed_rows[contact]
        wide = spread_of(rows, self.ladders, row)
        slow = -np.hypot(speed, np.minimum(wide, 1e3))
        Xi = jumps.Phi.copy()
        change = after - (jumps.Phi @ before[..., None])[..., 0]
        Xi += change[:, :, None] * (w / slow[:, None])[:, None, :]
        S, B, whole = rows.S.copy(), rows.B.copy(), rows.x.copy()
        whole[:, :d], S[:, :d] = jumps.x, Xi @ S[:, :d]
        if self.ladders.errors.any():
            kick = speed[:, None, None] * self.tangent.impulse(contact)[:, None]
            B[:, :d] = triangular(np.concatenate([Xi @ B[:, :d], kick], axis=2))[..., : B.shape[2]]
        lost = (speed >= 0) | (np.abs(x @ w + self.rest[contact]) > _ROUNDING**0.5 * np.abs(speed))
        logw = np.where(lost, -np.inf, rows.logw)
        past = rows.decided(8 * contact + MISSED)
        just = np.full_like(rows.just, bits((contact,)))
        return rows._replace(x=whole, S=S, B=B, past=past, just=just, logw=logw), at

    def _rates(self, leg: Leg, at: Vector, x: Matrix) -> Matrix:
        """``dx/dt`` of states, each at its own time, shape (H, 2n)."""
        each = zip(at.tolist(), x, strict=True)
        return np.array(
            [self.tangent.rates([leg.t + s], row[None], leg.held)[0][0] for s, row in each]
        )


def _cubic(ends: Array, slopes: Array, step: float, part: Array) -> tuple[Array, Array]:
    """Value and slope at a ``part`` of a step, of cubics through both ends, shape (2, ...)."""
    (g0, g1), (a, b) = ends, slopes * step
    second, third = 3 * (g1 - g0) - 2 * a - b, 2 * (g0 - g1) + a + b
    value = g0 + part * (a + part * (second + part * third))
    return value, (a + part * (2 * second + 3 * part * third)) / step


def _lowest(g: Array, v: Array, T: Array) -> tuple[Array, Array]:
    """Lowest values of cubics in steps of length ``T``, and when, s after the start of a step.

    Values ``g`` and slopes ``v`` at the ends of steps have shape (steps + 1, m, H).
    """
    g0, g1, v0, v1 = g[:-1], g[1:], v[:-1], v[1:]
    low, at = np.minimum(g0, g1), np.where(g0 < g1, 0.0, T)
    turns = np.nonzero((v0 < 0) & (v1 > 0))
    if turns[0].size:
        T = np.broadcast_to(T, g0.shape)[turns]
        p, q, a, b = g0[turns], g1[turns], v0[turns] * T, v1[turns] * T
        second, third = 3 * (q - p) - 2 * a - b, 2 * (p - q) + a + b
        # a + 2 second x + 3 third x^2 = 0, the root at which the slope grows
        root = np.sqrt(np.maximum(second**2 - 3 * third * a, 0.0))
        x = np.clip(-a / (second + root + 1e-300), 0.0, 1.0)
        value = p + x * (a + x * (second + x * third))
        better = value < low[turns]
        low[turns] = np.where(better, value, low[turns])
        at = np.array(at)
        at[turns] = np.where(better, x * T, at[turns])
    return low, at


class _Grid(NamedTuple):
    """Gaps at the ends of steps, (steps + 1, m, H); lowest ones and when, (steps, m, H)."""

    g: Array
    low: Array
    at: Array
    ends: Array


def _runs(negative: NDArray[np.bool_], grid: _Grid, start: Vector) -> Dips:
    """The dips of which some steps are ``negative``, shape (steps, m, H); see ``Flights.dips``."""
    g, low, at, ends = grid
    found = list[tuple[int, int, tuple[float, float], float, float, bool, bool]]()
    for i, h in zip(*np.nonzero(negative.any(axis=0)), strict=True):
        steps = np.flatnonzero(negative[:, i, h])
        breaks = np.flatnonzero((np.diff(steps) > 1) | (g[steps[1:], i, h] >= 0)) + 1
        for run in np.split(steps, breaks):
            first, last = run[0], run[-1]
            lowest = run[np.argmin(low[run, i, h])]
            was_before = bool(first == 0 and g[0, i, h] < 0)
            is_below = g[first + 1, i, h] < 0
            began = ends[first, h], ends[first + 1, h] if is_below else at[first, i, h]
            if was_before:
                began = ends[0, h] - (ends[1, h] - ends[0, h]), ends[0, h]
            is_over = bool(g[last + 1, i, h] >= 0)
            gap = float(low[lowest, i, h])
            found.append((h, i, began, at[lowest, i, h], gap, is_over, was_before))
    found.sort(key=lambda each: each[3])
    h, contact, bounds, when, gaps, over, before = (
        np.array(each) for each in zip(*found, strict=True)
    )
    own = start[h]
    return Dips(h, contact, bounds + own[:, None], when + own, gaps, over, before)
