# SPDX-License-Identifier: Apache-2.0
"""Hypotheses between events: one flight for all of them, and the impacts that were missed.

All hypotheses with the same closed contacts share the maps of a flight. Their gaps are followed on
a grid of times (``dips``). A dip of a gap below zero says that an impact was missed, or that the
estimate is wrong by as much: the hypothesis branches into both. A contact that is closed opens
where its load falls to zero.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from impact_observer.bank.bank import Array, Hypotheses, Missed, bits, spread_of
from impact_observer.bank.dips import Dips, GridValues, dips_of
from impact_observer.bank.ladders import Ladders, Numbers, triangular
from impact_observer.bank.notes import with_missed
from impact_observer.dynamics.tangent import Maps, Tangent
from impact_observer.events import Contacts
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_GAPS, _LOADS = range(2)
"""Functions that are followed along flights."""
_ROUNDING = 1e-13
"""Depth of a dip that is rounding, over the size of the gap."""
_TABLE = 4096
"""Most steps of the table of a flight; of longer flights the steps are longer."""
_SETTLED = 1e-12
"""Change of an instant that ends its search, over the fastest time scale."""
_NEWTON = 8
"""Steps by which the instant of a predicted impact is found."""
_NO_STAMP = 0.1
"""Deviation of the instant of an impact that was not reported, over the fastest time scale."""
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


class Reports(NamedTuple):
    """How the sensors of m contacts report impacts.

    Attributes:
        log_missed: log probability that an impact is not reported, shape (m,).
        clocks: deviations of stamps, s; NaN where the ladder holds, shape (m,).
    """

    log_missed: Vector
    clocks: Vector


class Flights:
    """The motion of hypotheses between events, near some parameters.

    Attributes:
        tangent: flights and jumps of the system with these parameters.
        constants: the parameters, and the delay of the stamps where it is estimated, (N - d,).
        ladders: what rungs stand for.
        numbers: the tuned numbers.
        log_missed: log probability that an impact is not reported, of each contact, shape (m,).
        own_clocks: deviations of the stamps of contacts, s; NaN where the ladder holds, (m,).
        d: numbers of (q, u).
        gap_rows: derivatives of the gaps by the state, shape (m, N).
        speed_rows: derivatives of their speeds by (q, u), shape (m, d).
        rest: the gaps where the state is zero, shape (m,).
    """

    def __init__(
        self,
        tangent: Tangent,
        constants: Vector,
        ladders: Ladders,
        numbers: Numbers,
        reports: Reports,
    ) -> None:
        """Prepare the rows of gaps and speeds."""
        self.tangent, self.ladders, self.numbers = tangent, ladders, numbers
        self.constants, (self.log_missed, self.own_clocks) = constants, reports
        system = tangent.system
        self.m, self.p, self.d = system.m, tangent.p, 2 * system.n
        self.rate = max(tangent.phase(()).flow.exponential.rate, 1.0)
        gaps = tangent.gaps(tuple(range(self.m)))
        slopes = np.pad(gaps.rest_slopes, ((0, 0), (0, constants.size - self.p)))
        self.gap_rows = np.hstack([gaps.by_x, slopes])
        W = system.W.T
        self.speed_rows = np.hstack([np.zeros_like(W), W])
        self.rest = gaps.rest - slopes @ constants
        self._table = lru_cache(16)(self._table_of)

    def without_stamps(self) -> "Flights":
        """The same for an impact that no stamp tells, only the state."""
        clocks = np.full_like(self.ladders.clocks, _NO_STAMP / self.rate)
        return Flights(
            self.tangent,
            self.constants,
            self.ladders._replace(clocks=clocks),
            self.numbers,
            Reports(self.log_missed, np.full_like(self.own_clocks, np.nan)),
        )

    def clock(self, contact: NDArray[np.intp] | int, c: NDArray[np.intp]) -> Vector:
        """Deviations of stamps of a contact, by hypotheses on rungs ``c``, shape (H,), s."""
        own = self.own_clocks[contact]
        return np.where(np.isnan(own), self.ladders.clocks[c], own)

    def gap(self, contact: int, x: Array, constants: Array) -> Array:
        """The gap of a contact at (q, u), shape (..., d), with constants, shape (..., N - d)."""
        row = self.gap_rows[contact]
        return np.asarray(x @ row[: self.d] + constants @ row[self.d :] + self.rest[contact])

    def images(self, maps: Maps, x: Array) -> tuple[Array, Array]:
        """(q, u) of states (..., N) after flights, (..., d), and by the constants (..., d, N - d).

        To first order in the difference of the constants from those of the flights.
        """
        found, beside = maps.of(x[..., : self.d]), x.shape[-1] - self.d
        by = np.zeros((*found.shape, beside))
        if self.p:
            by[..., : self.p] = maps.Gamma(x[..., : self.d])
            found += self.change(by[..., : self.p], x)
        return found, by

    def change(self, by: Array, x: Array) -> Array:
        """What parameters of states (..., N) change of a function, beside those of the flights.

        ``by`` are its derivatives by the parameters, shape (..., k, p); the change is (..., k).
        """
        theta = x[..., self.d : self.d + self.p] - self.constants[: self.p]
        return np.asarray((by @ theta[..., None])[..., 0])

    def moved(self, rows: Hypotheses, leg: Leg) -> Hypotheses:
        """The hypotheses at the end of a ``leg``, with those that impacts were missed.

        Each keeps its own closed contacts, whatever those of the leg are.
        """
        if leg.s <= 0:
            return rows
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
        same = start.min() == start.max() and s.min() == s.max()
        at, length = (start[:1], s[:1]) if same else (start, s)
        maps = self.tangent.flights([leg.t + each for each in at.tolist()], length, leg.held)
        x, S, B = rows.x.copy(), rows.S.copy(), rows.B
        x[:, :d], by = self.images(maps, rows.x)
        S[:, :d] = maps.Phi @ rows.S[:, :d]
        if self.p:
            S[:, :d] += by @ rows.S[:, d:]
        if self.ladders.errors.any():
            noise = self.tangent.noise(np.maximum(length, 0.0), leg.held, leg.intensity)
            noise = np.broadcast_to(noise, B.shape)
            B = triangular(np.concatenate([maps.Phi @ B, noise], axis=2)) if B.any() else noise
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
        values = self._values(rows, start, leg, _LOADS)
        load, ends = values.g, values.ends
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
        at, d = start[dips.h], self.d
        lowest = self.flown(rows.take(dips.h), leg, at, dips.lowest - at)
        seen = spread_of(lowest, self.ladders, self.gap_rows[dips.contact])
        speed = np.einsum("di,di->d", self.speed_rows[dips.contact], lowest.x[:, :d])
        seen = np.hypot(seen, speed * self.clock(dips.contact, lowest.c)) + 1e-300
        depth = -dips.gap / seen
        is_named = np.isin(dips.contact, leg.named) & ~dips.is_over
        cost = np.maximum(special.log_ndtr(-depth), _LEAST)
        logw, paid, sunk = rows.logw.copy(), np.zeros_like(rows.paid), rows.sunk.copy()
        before = logw[dips.h].copy()
        each = zip(dips.h.tolist(), dips.contact.tolist(), strict=True)
        for k, (own, contact) in enumerate(each):
            owed = float(cost[k]) - (rows.paid[own, contact] if dips.was_before[k] else 0.0)
            before[k] = logw[own]
            if is_named[k]:  # what it has paid so far is given back
                logw[own] -= rows.paid[own, contact] if dips.was_before[k] else 0.0
                continue
            logw[own] += min(owed, 0.0)
            sunk[own] = min(sunk[own], cost[k])
            if not dips.is_over[k]:
                paid[own, contact] = min(cost[k], 0.0)
        enough = np.where(dips.is_over, self.numbers.shallow, self.numbers.confident)
        again = dips.was_before & ((rows.tried[dips.h] >> dips.contact & 1) == 1)
        log_missed = self.log_missed[dips.contact]
        if leg.deaf is not None:
            log_missed = np.where(dips.began[:, 1] < leg.deaf[dips.contact], 0.0, log_missed)
        tried = (depth > enough) & ~again & (log_missed > -np.inf) & may_miss
        tried &= before > logw.max() + self.numbers.log_kept
        marked = np.zeros_like(rows.tried)
        lasts = (tried | again) & ~dips.is_over
        np.bitwise_or.at(marked, dips.h[lasts], 1 << dips.contact[lasts])
        stays = rows._replace(logw=logw, paid=paid, sunk=sunk, tried=marked)
        if not tried.any():
            return stays, *nothing
        which = np.flatnonzero(tried)
        parents = rows.take(dips.h[which])
        log = before[which] + special.log_ndtr(depth[which]) + log_missed[which]
        none = np.zeros_like(parents.tried)
        parents = parents._replace(logw=log, paid=np.zeros_like(parents.paid), tried=none)
        spawned, since = [], []
        for i in np.unique(dips.contact[which]).tolist():
            own = np.flatnonzero(dips.contact[which] == i)
            parts = parents.take(own), start[dips.h[which]][own], dips.began[which][own]
            after, when = self._after_missed(i, leg, *parts)
            deaf = -np.inf if leg.deaf is None else leg.deaf[i]
            dead = (dips.began[which][own][:, 1] < deaf).tolist()
            about = zip(when.tolist(), depth[which][own].tolist(), dead, strict=True)
            missed = [Missed(i, leg.t + s, size, late) for s, size, late in about]
            spawned.append(with_missed(after, missed))
            since.append(when)
        return stays, Hypotheses.joined(spawned), np.concatenate(since)

    def dips(self, rows: Hypotheses, leg: Leg, start: Vector) -> Dips | None:
        """Where gaps are below zero from ``start`` to the end of the leg; None if nowhere."""
        values = self._values(rows, start, leg, _GAPS)
        beside = rows.x[:, self.d :] @ self.gap_rows[:, self.d :].T
        g = values.g + (beside + self.rest).T
        size = np.abs(self.gap_rows[:, : self.d]) @ np.abs(rows.x[:, : self.d]).max(axis=0)
        size += np.abs(self.rest)
        just = rows.just[None] >> np.arange(self.m)[:, None] & 1
        g[0] = np.where(just, np.maximum(g[0], 0.0), g[0])
        ignored = np.array(leg.held, dtype=np.intp)
        return dips_of(values._replace(g=g), start, _ROUNDING * size, ignored)

    def _values(self, rows: Hypotheses, start: Vector, leg: Leg, kind: int) -> GridValues:
        """Gaps, without their rests, or loads of closed contacts, on a grid of times."""
        length = float(leg.s - start.min())
        flow = self.tangent.phase(leg.held).flow
        step = flow.exponential.step / 2
        step *= 2 ** max(0, int(np.ceil(np.log2(max(length / step / _TABLE, 1e-9)))))
        steps = max(int(np.ceil(length / step)), 1)
        starts, which = np.unique(start, return_inverse=True)
        y = np.array([flow.drive.at(leg.t + each) for each in starts.tolist()])
        z = np.hstack([rows.x[:, : self.d], y[which.ravel()]])
        if flow.drive.is_smooth:
            table = self._table(leg.held, kind, step, 1 << (steps - 1).bit_length())[: steps + 1]
            values = (table @ z.T).reshape(steps + 1, 2, -1, rows.size)
        else:
            values = self._sampled_values(z, start, leg, kind, np.arange(steps + 1) * step)
        return GridValues.to_the_end(values[:, 0], values[:, 1], step, leg.s - start)

    def _sampled_values(
        self, z: Matrix, start: Vector, leg: Leg, kind: int, times: Vector
    ) -> Array:
        """Values and slopes where forces have samples or switches."""
        both, drive = self._rows(leg.held, kind), self.tangent.phase(leg.held).flow.drive
        found = np.empty((times.size, *both.shape[:2], len(z)))
        for at in np.unique(start).tolist():
            own = np.flatnonzero(start == at)
            maps = self.tangent.flights([leg.t + at] * times.size, times, leg.held)
            x = maps.Phi @ z[own, : self.d].T + maps.drift[:, :, None]
            y = np.array([drive.at(leg.t + (at + each)) for each in times.tolist()])
            later = np.concatenate([x, np.repeat(y[:, :, None], own.size, axis=2)], axis=1)
            found[..., own] = np.einsum("abi,tik->tabk", both, later)
        return found

    def _rows(self, held: Contacts, kind: int) -> Array:
        """Gaps of all contacts or loads of closed ones, and rates, as rows of z, (2, k, N)."""
        phase, d = self.tangent.phase(held), self.d
        A = phase.flow.exponential.A
        if kind == _GAPS:
            first = np.pad(self.gap_rows[:, :d], ((0, 0), (0, len(A) - d)))
            return np.stack([first, np.pad(self.speed_rows, ((0, 0), (0, len(A) - d)))])
        H, own = phase.loads, phase.equations
        first = np.hstack([H @ own.K, H @ own.C, -H @ phase.flow.drive.F])
        return np.stack([first, first @ A])

    def _table_of(self, held: Contacts, kind: int, step: float, steps: int) -> Array:
        """``_rows`` after 0, 1, 2, .. steps, shape (steps + 1, 2k, N)."""
        rows = self._rows(held, kind)
        table = rows.reshape(1, -1, rows.shape[-1])
        power = self.tangent.phase(held).flow.exponential.matrix(step)
        while len(table) <= steps:
            table = np.concatenate([table, table @ power])
            power = power @ power
        return table[: steps + 1]

    def _after_missed(
        self, contact: int, leg: Leg, rows: Hypotheses, start: Vector, began: Array
    ) -> tuple[Hypotheses, Vector]:
        """Hypotheses after an impact of a ``contact`` that was missed, each at its own instant."""
        d, row = self.d, self.speed_rows[contact]
        at = began.mean(axis=1)
        low, high = began.T.copy()
        for _ in range(_NEWTON):
            maps = self.tangent.flights(
                [leg.t + each for each in start.tolist()], at - start, leg.held
            )
            x, _ = self.images(maps, rows.x)
            gap, speed = self.gap(contact, x, rows.x[:, d:]), x @ row
            low, high = np.where(gap > 0, at, low), np.where(gap > 0, high, at)
            newton = at - gap / np.where(speed, speed, -1.0)
            before, inside = at, (newton >= low) & (newton <= high)
            at = np.where(inside, newton, (low + high) / 2)
            if np.all(np.abs(at - before) < _SETTLED / self.rate):
                break
        rows = self.flown(rows, leg, start, at - start)
        x, gap = rows.x[:, :d], self.gap(contact, rows.x[:, :d], rows.x[:, d:])
        speed = x @ row
        jumps = self.tangent.impact(x, (*leg.held, contact))
        t = [leg.t + each for each in at.tolist()]
        before = self.tangent.rates(t, x, leg.held)[0]
        after = self.tangent.rates(t, jumps.x, leg.held)[0]
        by_state = np.pad(np.tile(row, (rows.size, 1)), ((0, 0), (0, rows.x.shape[1] - d)))
        wide = spread_of(rows, self.ladders, by_state)
        slow = -np.hypot(speed, np.minimum(wide, 1e3))
        change = after - (jumps.Phi @ before[..., None])[..., 0]
        late = change[:, :, None] * (self.gap_rows[contact] / slow[:, None])[:, None, :]
        Xi = late + np.pad(jumps.Phi, ((0, 0), (0, 0), (0, late.shape[2] - d)))
        S, B, whole = rows.S.copy(), rows.B, rows.x.copy()
        Xi[:, :, d : d + self.p] += jumps.Gamma
        whole[:, :d] = jumps.x + self.change(jumps.Gamma, rows.x)
        S[:, :d] = Xi @ S
        if self.ladders.errors.any():
            kick = speed[:, None, None] * self.tangent.impulse(contact)[:, None]
            B = triangular(np.concatenate([Xi[:, :, :d] @ B, kick], axis=2))
        lost = (speed >= 0) | (np.abs(gap) > _ROUNDING**0.5 * np.abs(speed))
        logw = np.where(lost, -np.inf, rows.logw)
        just = np.full_like(rows.just, bits((contact,)))
        rows = rows._replace(x=whole, S=S, B=B, just=just, logw=logw)
        return self.settled(rows, contact, t, leg.held, self.numbers.brief / self.rate), at

    def settled(
        self, rows: Hypotheses, contact: int, t: list[Elapsed], held: Contacts, brief: float
    ) -> Hypotheses:
        """Hypotheses just after an impact; a contact whose next flight is brief stays closed.

        Bounces and rest take the same impulse, so flights shorter than ``brief``, s, and those
        that the clock does not resolve, are left out.
        """
        if self.log_missed[contact] == -np.inf:
            return rows
        d, row = self.d, self.speed_rows[contact]
        x = rows.x[:, :d]
        speed, fall = x @ row, -self.tangent.rates(t, x, held)[0] @ row
        flight = brief + 2 * self.ladders.clocks[rows.c]
        rests = (fall > 0) & (2 * speed < flight * fall)
        if not rests.any():
            return rows
        own = np.flatnonzero(rests)
        whole, S, B, bit = rows.x.copy(), rows.S.copy(), rows.B.copy(), rows.held.copy()
        still = self.tangent.rest(x[own], tuple(sorted({*held, contact})))
        whole[own, :d] = still.x
        S[own, :d] = still.Phi @ S[own, :d]
        B[own] = still.Phi @ B[own]
        bit[own] |= 1 << contact
        return rows._replace(x=whole, S=S, B=B, held=bit)
