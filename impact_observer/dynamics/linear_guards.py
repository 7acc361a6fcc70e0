# SPDX-License-Identifier: Apache-2.0
"""Gaps and loads of flights of a linear system, by powers of its exponential."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from impact_observer.dynamics.guard_values import Array, GuardValues
from impact_observer.dynamics.tangent import Tangent
from impact_observer.events import Contacts
from impact_observer.stamps import elapsed
from impact_observer.states import Matrix, Vector

_GAPS, _LOADS = range(2)
"""Functions that are followed along flights."""
_TABLE = 4096
"""Most steps of the table of a flight; of longer flights the steps are longer."""


class LinearGuards:
    """Gaps and loads of one linear system."""

    def __init__(self, tangent: Tangent) -> None:
        """Take the gaps of the system of ``tangent``."""
        self._tangent, self._d = tangent, 2 * tangent.n
        gaps = tangent.gaps(tuple(range(tangent.system.m)))
        self._gaps, self._rest = gaps.by_x, gaps.rest
        self._table = lru_cache(16)(self._table_of)

    def gaps(self, t: Sequence[float], x: Array, s: Vector, held: Contacts) -> GuardValues:
        """Gaps of all contacts in flights from ``x``, shape (K, 2n), at ``t`` on."""
        values = self._values(t, x, s, held, _GAPS)
        return values._replace(g=values.g + self._rest[:, None])

    def loads(self, t: Sequence[float], x: Array, s: Vector, held: Contacts) -> GuardValues:
        """Loads of the contacts that are ``held``."""
        return self._values(t, x, s, held, _LOADS)

    def _values(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, kind: int
    ) -> GuardValues:
        flow = self._tangent.phase(held).flow
        step, length = flow.exponential.step / 2, float(s.max())
        step *= 2 ** max(0, int(np.ceil(np.log2(max(length / step / _TABLE, 1e-9)))))
        steps = max(int(np.ceil(length / step)), 1)
        starts = list(dict.fromkeys(t))
        which = np.zeros(len(x), dtype=np.intp)
        if len(starts) > 1:
            which[:] = [starts.index(each) for each in t]
        z = np.hstack([x, flow.drive.at_each([elapsed(each) for each in starts])[which]])
        if flow.drive.is_smooth:
            table = self._table(held, kind, step, 1 << (steps - 1).bit_length())[: steps + 1]
            values = (table @ z.T).reshape(steps + 1, 2, -1, len(x))
        else:
            times = np.arange(steps + 1) * step
            both = self._rows(held, kind)
            values = np.empty((times.size, *both.shape[:2], len(x)))
            for k, start in enumerate(starts):
                own = np.flatnonzero(which == k)
                values[..., own] = self._sampled(z[own], start, held, both, times)
        return GuardValues.to_the_end(values[:, 0], values[:, 1], step, s)

    def _sampled(
        self, z: Matrix, start: float, held: Contacts, both: Array, times: Vector
    ) -> Array:
        """Values and slopes at ``times`` where forces have samples or switches."""
        d, drive = self._d, self._tangent.phase(held).flow.drive
        maps = self._tangent.flights([start], times, held)
        x = maps.Phi @ z[:, :d].T + maps.drift[:, :, None]
        y = drive.at_each([elapsed(start) + each for each in times.tolist()])
        later = np.concatenate([x, np.repeat(y[:, :, None], len(z), axis=2)], axis=1)
        return np.asarray(np.einsum("abi,tik->tabk", both, later))

    def _rows(self, held: Contacts, kind: int) -> Array:
        """Gaps of all contacts or loads of closed ones, and rates, as rows of z, (2, k, N)."""
        phase, d = self._tangent.phase(held), self._d
        A, n = phase.flow.exponential.A, d // 2
        if kind == _GAPS:
            wide = np.zeros((2, len(self._gaps), len(A)))
            wide[0, :, :d], wide[1, :, n:d] = self._gaps, self._gaps[:, :n]
            return wide
        H, own = phase.loads, phase.equations
        first = np.hstack([H @ own.K, H @ own.C, -H @ phase.flow.drive.F])
        return np.stack([first, first @ A])

    def _table_of(self, held: Contacts, kind: int, step: float, steps: int) -> Array:
        """``_rows`` after 0, 1, 2, .. steps, shape (steps + 1, 2k, N)."""
        rows = self._rows(held, kind)
        table = rows.reshape(1, -1, rows.shape[-1])
        power = self._tangent.phase(held).flow.exponential.matrix(step)
        while len(table) <= steps:
            table = np.concatenate([table, table @ power])
            power = power @ power
        return table[: steps + 1]
