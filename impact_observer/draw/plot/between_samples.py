# SPDX-License-Identifier: Apache-2.0
"""States between samples, for curves that are smooth where the motion is.

A cubic with the positions and velocities of two neighbours (Hermite's). It is off by
``(omega dt)^4 / 384`` of an amplitude: 1 % with four samples a period. Where one impact lies
between two neighbours, the model's motion leads to it from both sides.
"""

import numpy as np

from impact_observer.dynamics import Phases
from impact_observer.model import System
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Stamps, Vector

PARTS = 8
"""Into how many parts the time between two samples is divided."""
MOST = 1000
"""Most samples between which states are put in; more of them make a smooth line anyway."""
_MEET = 0.05
"""Distance at which the two ways to an impact miss each other, over the range of the motion, above
which it is not where its stamp says: then the line stays straight."""
_COARSE = 0.3
"""Part of a velocity's change that neighbours may disagree by: at some 3 samples a period."""


class FreeMotion:
    """The motion of a model without contacts, from any sample, also back in time."""

    def __init__(self, system: System, epoch: int) -> None:
        """Of ``system``, whose forcing begins at the stamp ``epoch``, ns."""
        self._system, self._epoch = system, epoch
        self._phase = Phases(system).phase()

    def states(self, stamp: int, x: Vector, stamps: Stamps) -> Matrix:
        """States at ``stamps`` (ns) of the motion through ``x`` at ``stamp``, shape (N, 2n)."""
        start = np.array([stamp - self._epoch])
        own = self._system.to_frame(start, x[None])[0]
        motion = self._phase.start((stamp - self._epoch) / NS_PER_S, own)
        states = motion.states((stamps - stamp) / NS_PER_S)
        return self._system.from_frame(stamps - self._epoch, states)


def with_states_between(
    stamps: Stamps, x: Matrix, jumps: Stamps, free: FreeMotion | None = None
) -> tuple[Stamps, Matrix]:
    """Samples of one motion, and states between them where it is smooth or has one jump.

    Args:
        stamps: ascending, shape (N,), ns.
        x: states (q, u), shape (N, 2n).
        jumps: instants at which velocities jump, ascending, ns.
        free: the motion up to a jump and from it on; None for straight lines.

    Returns:
        The same, where there are too many samples, or too few for the motion.
    """
    if not 2 < stamps.size <= MOST or np.any(np.diff(stamps) <= 0):
        return stamps, x
    n = x.shape[1] // 2
    q, u = x[:, :n], x[:, n:]
    dt = (np.diff(stamps) / NS_PER_S)[:, None]
    count = np.diff(np.searchsorted(jumps, stamps, "right"))
    smooth = count == 0
    off = np.abs(np.diff(q, axis=0) - dt * (u[1:] + u[:-1]) / 2)[smooth]
    if off.size == 0 or np.sum(off) > _COARSE * np.sum((dt * np.abs(np.diff(u, axis=0)))[smooth]):
        return stamps, x
    at, between = _cubics(stamps, q, u, dt)
    every, states = [stamps, at[:, smooth].ravel()], [x, between[:, smooth].reshape(-1, 2 * n)]
    size = np.ptp(x, axis=0)
    for k in np.flatnonzero(count == 1).tolist():
        if free is None:
            break
        jump = int(jumps[np.searchsorted(jumps, stamps[k], "right")])
        own, made = _to_a_jump(free, stamps[k : k + 2], x[k : k + 2], jump)
        before, after = made[PARTS // 2 - 1 : PARTS // 2 + 1, :n]
        if np.all(np.abs(after - before) <= _MEET * size[:n]):
            every.append(own)
            states.append(made)
    merged, found = np.concatenate(every), np.concatenate(states)
    order = np.argsort(merged, kind="stable")
    return merged[order], found[order]


def _cubics(stamps: Stamps, q: Matrix, u: Matrix, dt: Matrix) -> tuple[Stamps, Matrix]:
    """States between all neighbours, shapes (``PARTS`` - 1, N - 1) and (..., 2n)."""
    s = (np.arange(1, PARTS) / PARTS)[:, None, None]
    a, b = q[:-1], q[1:]
    va, vb = dt * u[:-1], dt * u[1:]
    position = (
        (2 * s**3 - 3 * s**2 + 1) * a
        + (s**3 - 2 * s**2 + s) * va
        + (3 * s**2 - 2 * s**3) * b
        + (s**3 - s**2) * vb
    )
    slope = 6 * (s**2 - s) * (a - b) + (3 * s**2 - 4 * s + 1) * va + (3 * s**2 - 2 * s) * vb
    at = stamps[:-1] + np.round(s[..., 0] * np.diff(stamps)).astype(np.int64)
    return at, np.concatenate([position, slope / dt], axis=2)


def _to_a_jump(free: FreeMotion, stamps: Stamps, x: Matrix, jump: int) -> tuple[Stamps, Matrix]:
    """States between two samples: ``PARTS`` / 2 of them before a jump, as many after it."""
    parts = np.arange(1, PARTS // 2 + 1) / (PARTS // 2)
    before = stamps[0] + np.round(parts * (jump - 1 - stamps[0])).astype(np.int64)
    after = stamps[1] - np.round(parts[::-1] * (stamps[1] - jump)).astype(np.int64)
    states = [free.states(int(stamps[0]), x[0], before), free.states(int(stamps[1]), x[1], after)]
    return np.concatenate([before, after]), np.concatenate(states)
