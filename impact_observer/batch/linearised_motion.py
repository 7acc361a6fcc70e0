# SPDX-License-Identifier: Apache-2.0
"""A motion through all moments of a recording, linearised about states at the moments.

Node 0 is the start; node ``k`` is the state just before the ``k``-th moment, at the stamp of the
moment. A state jumps at its own instant, where its gap is zero, and flies to the next stamp. So a
jump at a stamp is: flow by ``late`` seconds, jump, flow back. Its derivative is the saltation
matrix. The measured number of a moment is ``late``, the own instant minus the stamp, plus the
latency of the sensor.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.batch.moments import Indices, Moments, MomentSwitching, grouped
from impact_observer.dynamics.tangent import GuardRows, Maps, Tangent
from impact_observer.events import Contacts
from impact_observer.model.contact_sensors import ContactErrors
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

Array = NDArray[np.float64]
_REACH = 0.3
"""Part of the neighbouring flights by which an own instant may differ from its stamp."""
_GRAZING = 1e-3
"""Speed of approach below which the stamp is taken for the own instant, over the usual speed."""
_NEWTON = 2
"""Steps of Newton's method towards an own instant."""


class LinearisedMotion(NamedTuple):
    """Maps from node to node; K moments, R measured gaps, p parameters.

    Attributes:
        x: states before the moments, shape (K + 1, 2n); the first is the start.
        after: states after the moments, shape (K + 1, 2n); the first is the start.
        jump: derivatives of ``after`` by ``x``, shape (K + 1, 2n, 2n).
        jump_by_theta: derivatives of ``after`` by the parameters, shape (K + 1, 2n, p).
        Phi: derivatives of the next state by ``after``, shape (K, 2n, 2n).
        Gamma: derivatives of the next state by the parameters, shape (K, 2n, p).
        defect: where flights end minus ``x`` there, shape (K, 2n).
        kick: what a rebound that is faster by the speed of approach adds, shape (K + 1, 2n).
        late: own instants minus stamps, plus latencies, shape (R,), s.
        late_by_x: derivatives of ``late`` by ``x``, shape (R, 2n).
        late_by_theta: derivatives of ``late`` by the parameters, shape (R, p).
        speed: contact speeds before the impacts, shape (R,), m/s.
        is_regular: whether own instants exist near the stamps of the moments, shape (K,).
        own_late: own instants of all moments minus stamps, shape (K,), s.
        own_late_by_x: derivatives of ``own_late`` by ``x``, shape (K, 2n).
    """

    x: Matrix
    after: Matrix
    jump: Array
    jump_by_theta: Array
    Phi: Array
    Gamma: Array
    defect: Matrix
    kick: Matrix
    late: Vector
    late_by_x: Matrix
    late_by_theta: Matrix
    speed: Vector
    is_regular: NDArray[np.bool_]
    own_late: Vector
    own_late_by_x: Matrix

    @property
    def late_by_y(self) -> Matrix:
        """Derivatives of ``late`` by states and parameters, shape (R, 2n + p)."""
        return np.hstack([self.late_by_x, self.late_by_theta])


def linearised(
    tangent: Tangent, moments: Moments, x: Matrix, errors: ContactErrors
) -> LinearisedMotion:
    """Linearise the motion about states at the nodes, shape (K + 1, 2n).

    Raises:
        DynamicsError: the forcing has no sample at a moment.
    """
    K, R, d, p = moments.count, moments.row_moment.size, 2 * tangent.n, tangent.p
    motion = LinearisedMotion(
        x=x,
        after=x.copy(),
        jump=np.broadcast_to(np.eye(d), (K + 1, d, d)).copy(),
        jump_by_theta=np.zeros((K + 1, d, p)),
        Phi=np.empty((K, d, d)),
        Gamma=np.empty((K, d, p)),
        defect=np.empty((K, d)),
        kick=np.zeros((K + 1, d)),
        late=np.zeros(R),
        late_by_x=np.zeros((R, d)),
        late_by_theta=np.zeros((R, p)),
        speed=np.zeros(R),
        is_regular=np.zeros(K, dtype=bool),
        own_late=np.zeros(K),
        own_late_by_x=np.zeros((K, d)),
    )
    usual = usual_speed(tangent, moments, x)
    for switching, own in grouped([one.switching for one in moments.each]).items():
        if switching.hit:
            _jump(motion, tangent, moments, own, switching, usual)
    held_in_flight = [(), *(one.switching.held for one in moments.each[:-1])]
    for held, own in grouped(held_in_flight).items():
        starts = [moments.starts[k] for k in own.tolist()]
        maps, begin = tangent.flights(starts, moments.flights[own], held), motion.after[own]
        motion.Phi[own], motion.Gamma[own] = maps.Phi, maps.Gamma(begin)
        motion.defect[own] = maps.of(begin) - x[own + 1]
    latency, slopes = errors.late(tangent.family, tangent.theta)
    motion.late[:] += latency[moments.row_contact]
    motion.late_by_theta[:] += slopes[moments.row_contact]
    return motion


def usual_speed(tangent: Tangent, moments: Moments, x: Matrix) -> float:
    """Median speed of the measured contacts before their moments, m/s; at least tiny."""
    W = tangent.system.W[:, moments.row_contact].T
    speeds = np.abs(np.einsum("ri,ri->r", W, x[1 + moments.row_moment, tangent.n :]))
    flight = float(np.mean(moments.flights)) or 1.0
    least = float(np.max(np.abs(tangent.system.q_r), initial=0.0)) / flight or 1.0
    return max(float(np.median(speeds)) if speeds.size else 0.0, 1e-6 * least)


def _jump(  # noqa: PLR0917
    motion: LinearisedMotion,
    tangent: Tangent,
    moments: Moments,
    own: Indices,
    switching: MomentSwitching,
    usual: float,
) -> None:
    """Fill in the jumps of the moments ``own``, at which the same contacts switch."""
    hit, pressed, before, held = switching
    t, n, nodes = [moments.each[k].t for k in own.tolist()], tangent.n, own + 1
    x, gaps = motion.x[nodes], tangent.gaps(hit)
    guard = gaps.by_x.mean(axis=0)
    late, is_regular = _first_late(tangent, moments, own, x, gaps, before, usual)
    motion.is_regular[own] = is_regular

    def at_own_instant(late: Vector) -> tuple[Maps, list[Elapsed], Matrix, Matrix, Matrix, Matrix]:
        """Return flights to the instants, these, states and rates there, speeds and gaps."""
        to = tangent.flights(t, late, before)
        at = [each + by for each, by in zip(t, late.tolist(), strict=True)]
        there = to.of(x)
        rate = tangent.rates(at, there, before)[0]
        speeds = rate @ gaps.by_x.T
        speeds = np.where(is_regular[:, None], speeds, -np.maximum(np.abs(speeds), usual))
        return to, at, there, rate, speeds, gaps.of(there)

    for _ in range(_NEWTON):
        *_, speeds, value = at_own_instant(late)
        late = np.where(is_regular, late - value.mean(axis=1) / speeds.mean(axis=1), 0.0)
    to, at, there, rate, speeds, value = at_own_instant(late)
    speed = speeds.mean(axis=1)
    moved, by_theta = to.Gamma(x), gaps.Theta(there)
    does = is_regular[:, None]
    late_x = np.where(does, -(guard @ to.Phi) / speed[:, None], 0.0)
    guard_theta = np.einsum("i,kip->kp", guard, moved) + by_theta.mean(axis=1)
    late_theta = np.where(does, -guard_theta / speed[:, None], 0.0)
    motion.own_late[own], motion.own_late_by_x[own] = late, late_x
    jump = tangent.impact(there, pressed)
    after, Phi, Gamma = jump
    if held:
        after, still, still_theta = tangent.rest(after, held)
        Phi, Gamma = still @ Phi, still @ Gamma + still_theta
    lost = rate[:, :, None]
    Phi, Gamma = (
        Phi @ (to.Phi + lost * late_x[:, None]),
        Gamma + Phi @ (moved + lost * late_theta[:, None]),
    )
    gained, back = tangent.rates(at, after, held)[0][:, :, None], tangent.flights(at, -late, held)
    motion.after[nodes] = back.of(after)
    motion.jump[nodes] = back.Phi @ (Phi - gained * late_x[:, None])
    motion.jump_by_theta[nodes] = back.Phi @ (Gamma - gained * late_theta[:, None])
    motion.jump_by_theta[nodes] += back.Gamma(after)
    approach = np.abs(there[:, n:] @ tangent.system.W[:, list(pressed)])
    motion.kick[nodes, n:] = approach @ tangent.stops(pressed).T
    is_measured = np.array([moments.each[k].is_measured for k in own.tolist()])
    rows, nodes = moments.first_row[own][is_measured], np.flatnonzero(is_measured)
    for h in range(len(hit)):
        of_one = speeds[nodes, h]
        motion.speed[rows + h] = of_one
        motion.late[rows + h] = late[nodes] - value[nodes, h] / of_one
        motion.late_by_x[rows + h] = -(gaps.by_x[h] @ to.Phi[nodes]) / of_one[:, None]
        by = np.einsum("i,kip->kp", gaps.by_x[h], moved[nodes]) + by_theta[nodes, h]
        motion.late_by_theta[rows + h] = -by / of_one[:, None]


def _first_late(  # noqa: PLR0917
    tangent: Tangent,
    moments: Moments,
    own: Indices,
    x: Matrix,
    gaps: GuardRows,
    before: Contacts,
    usual: float,
) -> tuple[Vector, NDArray[np.bool_]]:
    """Return own instants minus stamps, by parabolas of the gaps, and which of them exist."""
    t = [moments.each[k].t for k in own.tolist()]
    first, second = tangent.rates(t, x, before)
    guard = gaps.by_x.mean(axis=0)
    value, speed, bend = gaps.of(x).mean(axis=1), first @ guard, second @ guard
    square = speed**2 - 2 * bend * value
    root = np.sqrt(np.maximum(square, 0.0))
    does = (speed < -_GRAZING * usual) & (square > 0)
    late = np.where(does, -2 * value / np.where(does, speed - root, -1.0), 0.0)
    flights = np.append(moments.flights, np.inf)
    room = _REACH * np.minimum(flights[own], np.maximum(flights[own + 1], 0.0))
    does &= np.abs(late) <= room
    return np.where(does, late, 0.0), does
