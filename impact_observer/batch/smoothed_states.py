# SPDX-License-Identifier: Apache-2.0
"""States of a smoothed motion at any instant, with roots of their covariances."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.batch.linearised_motion import Array
from impact_observer.batch.motion_fit import MotionFit
from impact_observer.dynamics.tangent import Maps
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector


class SmoothedStates(NamedTuple):
    """States in the frame at S instants.

    Attributes:
        x: shape (S, 2n).
        root: roots of the covariances, shape (S, 2n, any).
        flight: number of the flight: 0 before the first moment, shape (S,).
    """

    x: Matrix
    root: Array
    flight: NDArray[np.intp]


def own_instants(fit: MotionFit) -> Vector:
    """Instants of the moments minus their stamps by the smoothed motion, shape (K,), s."""
    moments, late = fit.problem.moments, np.zeros(fit.problem.moments.count)
    d = fit.x.shape[1]
    for k, each in enumerate(moments.each):
        if not each.switching.hit or not fit.motion.is_regular[k]:
            continue
        late[k] = fit.motion.own_late[k] + fit.motion.own_late_by_x[k] @ fit.change[k + 1, :d]
    return late


def smoothed_states(fit: MotionFit, t: Sequence[Elapsed]) -> SmoothedStates:
    """The states at instants, s since the epoch, ascending; after an impact at this instant.

    A flight with process noise is known from both ends: the nearer one counts more, and between
    the ends is the noise that both leave open.
    """
    moments, N = fit.problem.moments, fit.back.nodes.mean.shape[1]
    d, S = fit.x.shape[1], len(t)
    before, after = fit.states
    ends = np.array([float(each.t) for each in moments.each]) + own_instants(fit)
    ends = np.maximum.accumulate(ends) if ends.size else ends
    flight = np.searchsorted(ends, np.array([float(each) for each in t]), side="right")
    size, model = fit.back.joint.shape[2], fit.sizes.model
    x, root = np.empty((S, d)), np.zeros((S, d, size + d))
    for k in np.unique(flight).tolist():
        own = np.flatnonzero(flight == k)
        held = moments.each[k - 1].switching.held if k else ()
        begin = moments.each[k - 1].t if k else moments.start
        s = np.array([t[i] - begin for i in own.tolist()])
        is_last = k == moments.count
        joint = np.zeros((2 * N, size))
        if is_last:
            joint[N:, :N] = fit.back.nodes.root[-1]
        else:
            joint = fit.back.joint[2 * k + 1]
        maps = fit.tangent.flights([begin], s, held)
        x[own], root[own, :, :size] = _carried(maps, after[k], joint[N:])
        open_for = np.maximum(s, 0.0)
        if not is_last and model:
            T = float(moments.flights[k])
            share = np.clip(s / T, 0.0, 1.0) if T else np.ones(s.size)
            back = fit.tangent.flights([moments.each[k].t], s - T, held)
            x_back, root_back = _carried(back, before[k + 1], joint[:N])
            x[own] += share[:, None] * (x_back - x[own])
            root[own, :, :size] += share[:, None, None] * (root_back - root[own, :, :size])
            open_for *= 1 - share
        if model:
            intensity = fit.intensity
            root[own, :, size:] = model * fit.tangent.noise(open_for, held, intensity)
    return SmoothedStates(x, root, flight)


def _carried(maps: Maps, x: Vector, joint: Matrix) -> tuple[Matrix, Array]:
    """Return states, and roots of their covariances, some time from a state with a root."""
    d, Gamma = x.size, maps.Gamma(np.broadcast_to(x, maps.drift.shape))
    return maps.of(x), maps.Phi @ joint[:d] + Gamma @ joint[d:]
