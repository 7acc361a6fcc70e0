# SPDX-License-Identifier: Apache-2.0
"""States between samples, so that the curve of a smooth motion is smooth.

Between two neighbours the positions are a cubic with the neighbours' positions and velocities
(Hermite's). The cubic is off by ``(omega dt)^4 / 384`` of an amplitude: 1 % with four samples a
period. To an impact between two neighbours the model's motion leads from both sides. Where the
velocity of the cubic would leave the range of its neighbours', as at an impact that no sensor
reported, the line stays straight.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from impact_observer.dynamics import Phases
from impact_observer.model import System
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Stamps, Vector

PARTS = 8
"""Into how many parts the time between two samples is divided."""
MOST = 1000
"""Most samples between which states are put; more samples make a smooth line by themselves."""
_MEET = 0.05
"""Largest distance between the two motions at an impact, over the range of all motion. If the
motions are farther apart, the stamp of the impact is wrong, and the line stays straight."""
_COARSE = 0.3
"""Disagreement of positions and velocities, over the change of velocities, above which the samples
are too few: some 3 a period."""
_JUMP = 2.0
"""Change of a velocity in an interval, over the usual one, from which it may be a jump."""
_ELSEWHERE = 4.0
"""Change of velocities in an interval, over that in the one beside with the stamp of a jump, from
which the jump is in the former."""


class FreeMotion:
    """The motion of a model without contacts, from any sample, also back in time."""

    def __init__(self, system: System, epoch: int) -> None:
        """Take a model whose forcing begins at the stamp ``epoch``, ns."""
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
    """Samples of one motion, and states between neighbours with no jump or one jump between them.

    Args:
        stamps: ascending, shape (N,), ns.
        x: states (q, u), shape (N, 2n).
        jumps: instants at which velocities jump, ascending, ns.
        free: the motion up to a jump and from the jump on; None for straight lines.

    Returns:
        Stamps and states in order of time; ``stamps`` and ``x`` themselves if the samples are too
        many, or too few for the motion.
    """
    if not 2 < stamps.size <= MOST or np.any(np.diff(stamps) <= 0):
        return stamps, x
    n = x.shape[1] // 2
    q, u = x[:, :n], x[:, n:]
    dt = (np.diff(stamps) / NS_PER_S)[:, None]
    count = np.diff(np.searchsorted(jumps, stamps, "right"))
    smooth = (count == 0) & ~_beside_stamps(count, np.linalg.norm(np.diff(u, axis=0), axis=1))
    off = np.abs(np.diff(q, axis=0) - dt * (u[1:] + u[:-1]) / 2)
    change = np.abs(np.diff(u, axis=0))
    if not smooth.any() or np.sum(off[smooth]) > _COARSE * np.sum((dt * change)[smooth]):
        return stamps, x
    largest = np.maximum(change, _JUMP * np.median(change[smooth], axis=0))
    smooth &= ~np.any(6 * off > dt * largest, axis=1)
    parts = np.arange(1, PARTS)[:, None] / PARTS
    between = (stamps[:-1] + np.round(parts * np.diff(stamps)).astype(np.int64))[:, smooth].ravel()
    cubic = CubicHermiteSpline((stamps - stamps[0]) / NS_PER_S, q, u)
    seconds = (between - stamps[0]) / NS_PER_S
    every = [stamps, between]
    states = [x, np.hstack([cubic(seconds), cubic(seconds, nu=1)])]
    size = np.ptp(x, axis=0)
    for k in np.flatnonzero(count == 1).tolist():
        if free is None:
            break
        jump = int(jumps[np.searchsorted(jumps, stamps[k], "right")])
        around, motion = _up_to_a_jump(free, stamps[k : k + 2], x[k : k + 2], jump)
        before, behind = motion[PARTS // 2 - 1 : PARTS // 2 + 1, :n]
        if np.all(np.abs(behind - before) <= _MEET * size[:n]):
            every.append(around)
            states.append(motion)
    merged = np.concatenate(every)
    order = np.argsort(merged, kind="stable")
    return merged[order], np.concatenate(states)[order]


def _beside_stamps(count: Stamps, changes: Vector) -> NDArray[np.bool_]:
    """Mask of the intervals in which velocities jump although the stamp is in the one beside.

    A stamp has an error, and an impact that lasts begins before its jump.

    Args:
        count: stamps of jumps in each interval, shape (N - 1,).
        changes: of the velocities in each interval, shape (N - 1,).
    """
    jumps = np.zeros(count.size, dtype=np.bool_)
    for k in np.flatnonzero(count).tolist():
        for beside in {max(k - 1, 0), min(k + 1, count.size - 1)} - {k}:
            jumps[beside] |= changes[beside] > _ELSEWHERE * changes[k]
    return jumps


def _up_to_a_jump(free: FreeMotion, stamps: Stamps, x: Matrix, jump: int) -> tuple[Stamps, Matrix]:
    """States between two samples: ``PARTS`` / 2 before a jump, as many from the jump on."""
    parts = np.arange(1, PARTS // 2 + 1) / (PARTS // 2)
    before = stamps[0] + np.round(parts * (jump - 1 - stamps[0])).astype(np.int64)
    behind = stamps[1] - np.round(parts[::-1] * (stamps[1] - jump)).astype(np.int64)
    states = [free.states(int(stamps[0]), x[0], before), free.states(int(stamps[1]), x[1], behind)]
    return np.concatenate([before, behind]), np.concatenate(states)
