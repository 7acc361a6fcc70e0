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
        kick_by_after: derivatives of ``kick`` by ``after``, shape (K + 1, 2n, 2n).
        kick_by_theta: derivatives of ``kick`` by the parameters, shape (K + 1, 2n, p).
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
    kick_by_after: Array
    kick_by_theta: Array
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
    tangent: Tangent,
    moments: Moments,
    x: Matrix,
    errors: ContactErrors,
    *,
    is_scattered: bool = False,
) -> LinearisedMotion:
    """Linearise the motion about states at the nodes, shape (K + 1, 2n).

    Rebounds of a motion that ``is_scattered`` have chances of their own.

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
        kick_by_after=np.zeros((K + 1, d, d)),
        kick_by_theta=np.zeros((K + 1, d, p)),
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
    if is_scattered:
        _scatter(motion, tangent, moments, usual)
    latency, slopes = errors.late(tangent.family, tangent.theta)
    motion.late[:] += latency[moments.row_contact]
    motion.late_by_theta[:] += slopes[moments.row_contact]
    return motion


def _scatter(motion: LinearisedMotion, tangent: Tangent, moments: Moments, usual: float) -> None:
    """Let each rebound have a speed of its own, which the next instant tells.

    An instant depends on what was known before, so its row is linearised where the flight ends
    without the chance of the rebound; about the state that the instant has told, the row would
    depend on the chance, and innovations times such rows are not zero in the mean. What follows
    the instant depends on the rebound as it was.
    """
    predicted, flown = motion.x[1:] + motion.defect, motion.Phi @ motion.kick[:-1, :, None]
    for switching, own in grouped([one.switching for one in moments.each]).items():
        if not switching.hit:
            continue
        gaps = tangent.gaps(switching.hit)
        instants = _own_instants(tangent, moments, own, predicted[own], switching, usual)
        measured = np.array([moments.each[k].is_measured for k in own.tolist()])
        good = np.flatnonzero(measured & instants.is_regular & motion.is_regular[own])
        rows = moments.first_row[own][good]
        for h in range(len(switching.hit)):
            by_x, by_theta = instants.row_slopes(gaps, h)
            motion.late_by_x[rows + h], motion.late_by_theta[rows + h] = by_x[good], by_theta[good]
    size = np.sum(np.square(flown), axis=(1, 2))
    chance = -np.einsum("kio,ki->k", flown, motion.defect) / np.where(size > 0, size, 1.0)
    scaled = chance[:, None, None] * motion.Phi
    by_x = scaled @ motion.kick_by_after[:-1] @ np.linalg.pinv(motion.Phi)
    by_theta = scaled @ motion.kick_by_theta[:-1] - by_x @ motion.Gamma
    motion.jump_by_theta[1:] += motion.jump[1:] @ by_theta
    motion.jump[1:] += motion.jump[1:] @ by_x


def usual_speed(tangent: Tangent, moments: Moments, x: Matrix) -> float:
    """Median speed of the measured contacts before their moments, m/s; at least tiny."""
    W = tangent.system.W[:, moments.row_contact].T
    speeds = np.abs(np.einsum("ri,ri->r", W, x[1 + moments.row_moment, tangent.n :]))
    flight = float(np.mean(moments.flights)) or 1.0
    least = float(np.max(np.abs(tangent.system.q_r), initial=0.0)) / flight or 1.0
    return max(float(np.median(speeds)) if speeds.size else 0.0, 1e-6 * least)


class _OwnInstants(NamedTuple):
    """Instants at which the gaps of moments are zero, from states at the stamps.

    Attributes:
        late: after the stamps, shape (k,), s.
        is_regular: whether the instants exist, shape (k,).
        to: flights from the stamps to the instants.
        moved: derivatives of the states there by the parameters at fixed duration.
        at: the instants.
        there: states at the instants, shape (k, 2n).
        rate: of the states there, shape (k, 2n).
        speeds: of the gaps, shape (k, gaps), m/s.
        value: of the gaps, shape (k, gaps), m.
        by_theta: derivatives of the gaps by the parameters, shape (k, gaps, p).
    """

    late: Vector
    is_regular: NDArray[np.bool_]
    to: Maps
    moved: Array
    at: list[Elapsed]
    there: Matrix
    rate: Matrix
    speeds: Matrix
    value: Matrix
    by_theta: Array

    def row_slopes(self, gaps: GuardRows, h: int) -> tuple[Array, Array]:
        """Derivatives of the instant of gap ``h`` by states and parameters."""
        speed = self.speeds[:, h, None]
        by = np.einsum("i,kip->kp", gaps.by_x[h], self.moved) + self.by_theta[:, h]
        return -(gaps.by_x[h] @ self.to.Phi) / speed, -by / speed


def _own_instants(  # noqa: PLR0917
    tangent: Tangent,
    moments: Moments,
    own: Indices,
    x: Matrix,
    switching: MomentSwitching,
    usual: float,
) -> _OwnInstants:
    """Return the own instants of the moments ``own``, from states ``x`` at the stamps."""
    t, before = [moments.each[k].t for k in own.tolist()], switching.before
    gaps = tangent.gaps(switching.hit)
    late, is_regular, room = _first_late(tangent, moments, own, x, gaps, before, usual)

    def at_own_instant(
        late: Vector,
    ) -> tuple[Maps, list[Elapsed], Matrix, Matrix, Matrix, Matrix]:
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
        step = value.mean(axis=1) / speeds.mean(axis=1)
        late = np.where(is_regular, np.clip(late - step, -room, room), 0.0)
    to, at, there, rate, speeds, value = at_own_instant(late)
    moved, by_theta = to.Gamma(x), gaps.Theta(there)
    return _OwnInstants(late, is_regular, to, moved, at, there, rate, speeds, value, by_theta)


def _jump(  # noqa: PLR0917
    motion: LinearisedMotion,
    tangent: Tangent,
    moments: Moments,
    own: Indices,
    switching: MomentSwitching,
    usual: float,
) -> None:
    """Fill in the jumps of the moments ``own``, at which the same contacts switch."""
    hit, pressed, _, held = switching
    n, nodes, gaps = tangent.n, own + 1, tangent.gaps(hit)
    guard = gaps.by_x.mean(axis=0)
    instants = _own_instants(tangent, moments, own, motion.x[nodes], switching, usual)
    late, is_regular, to, moved, at, there, rate, speeds, value, by_theta = instants
    motion.is_regular[own] = is_regular
    speed, does = speeds.mean(axis=1), is_regular[:, None]
    late_x = np.where(does, -(guard @ to.Phi) / speed[:, None], 0.0)
    guard_theta = np.einsum("i,kip->kp", guard, moved) + by_theta.mean(axis=1)
    late_theta = np.where(does, -guard_theta / speed[:, None], 0.0)
    motion.own_late[own], motion.own_late_by_x[own] = late, late_x
    after, Phi, Gamma = tangent.impact(there, pressed)
    W, stops = tangent.system.W[:, list(pressed)], tangent.stops(pressed)
    approach, departure = np.abs(there[:, n:] @ W), np.abs(after[:, n:] @ W)
    motion.kick[nodes, n:] = approach @ stops.T
    gain = np.divide(approach, departure, out=np.zeros_like(approach), where=departure > 0)
    motion.kick_by_after[nodes, n:, n:] = np.einsum("ik,mk,jk->mij", stops, gain, W)
    motion.kick_by_theta[nodes] = -motion.kick_by_after[nodes] @ Gamma
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
    is_measured = np.array([moments.each[k].is_measured for k in own.tolist()])
    rows, nodes = moments.first_row[own][is_measured], np.flatnonzero(is_measured)
    for h in range(len(hit)):
        of_one = speeds[nodes, h]
        motion.speed[rows + h] = of_one
        motion.late[rows + h] = late[nodes] - value[nodes, h] / of_one
        by_x, by = instants.row_slopes(gaps, h)
        motion.late_by_x[rows + h], motion.late_by_theta[rows + h] = by_x[nodes], by[nodes]


def _first_late(  # noqa: PLR0917
    tangent: Tangent,
    moments: Moments,
    own: Indices,
    x: Matrix,
    gaps: GuardRows,
    before: Contacts,
    usual: float,
) -> tuple[Vector, NDArray[np.bool_], Vector]:
    """Return own instants minus stamps, by parabolas of the gaps, which exist, and their bound."""
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
    return np.where(does, late, 0.0), does, room
