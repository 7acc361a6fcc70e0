# SPDX-License-Identifier: Apache-2.0
"""Flights and jumps of a system with their derivatives by state, parameters and instants.

``docs/theory/filter.md`` has the equations. A flight that no parameter changes is that of
``MovingSystem``. Other flights and their derivatives by a parameter are blocks of an exponential
in which harmonics and constants are states as well (Van Loan, Computing integrals involving the
matrix exponential, 1978). Samples of a force are no states: there the derivative is a difference
of two motions.
"""

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.saltation import Measured
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

STEP = 1e-6
"""Step of a difference by a parameter, relative to its size."""
_ONE = np.ones(1)


class FlightEnd(NamedTuple):
    """The impacts, closings and openings at one instant.

    Attributes:
        t: as recorded, s since the epoch.
        hit: contacts that impact or close; empty where contacts only open.
        pressed: closed contacts that take an impulse.
        held: contacts that stay closed from now on, independent of each other.
        measured: whether the moment has a stamp; else the moment was inserted as missed.
    """

    t: float
    hit: Contacts
    pressed: Contacts
    held: Contacts = ()
    measured: bool = True

    @classmethod
    def of_change(
        cls, change: ContactChange, newton: ImpactLaw, phases: Phases, *, measured: bool = True
    ) -> "FlightEnd":
        """The end of a flight at a ``change``; what hits counts as equally fast.

        Raises:
            ImpactLawError: the impact law has no solution there.
        """
        pressed = change.pressed(newton, -np.ones(len(change.hit))) if change.hit else ()
        return cls(change.t, change.hit, pressed, phases.independent(change.closed), measured)


class TangentMap(NamedTuple):
    """A state as a function of an earlier state and of the parameters, near a motion.

    Attributes:
        x: the state (q, u), shape (2n,).
        Phi: its derivative by the earlier state, shape (2n, 2n).
        Gamma: its derivative by the parameters, shape (2n, p).
    """

    x: Vector
    Phi: Matrix
    Gamma: Matrix

    def preceded_by(self, first: "TangentMap") -> "TangentMap":
        """One map for ``first`` and then this map."""
        return TangentMap(self.x, self.Phi @ first.Phi, self.Phi @ first.Gamma + self.Gamma)


class TangentState(NamedTuple):
    """A state of a motion and its derivatives by what is unknown, at a fixed instant.

    Attributes:
        t: s since the epoch.
        x: the state (q, u), shape (2n,).
        X: its derivatives, first by the start, then by the p parameters, then by anything else,
            shape (2n, any). There are 2n columns of the start if p is not 0.
        closed: contacts that are closed from now on.
    """

    t: float
    x: Vector
    X: Matrix
    closed: Contacts = ()

    def mapped(self, map_: TangentMap, t: float, closed: Contacts) -> "TangentState":
        """The state and its derivatives after a flight or jump to ``t``."""
        X, d = map_.Phi.dot(self.X), self.x.size
        X[:, d : d + map_.Gamma.shape[1]] += map_.Gamma
        return TangentState(t, map_.x, X, closed)


class Guard(NamedTuple):
    """Functions that are zero where contacts switch: gaps, m, or loads, N.

    Attributes:
        measured: the functions.
        value: of them, shape (k,).
        rows: their derivatives by what is unknown, at a fixed instant, shape (k, any).
        rate: their derivatives by time, shape (k,).
        bend: their second derivatives by time, shape (k,).
    """

    measured: Measured
    value: Vector
    rows: Matrix
    rate: Vector
    bend: Vector


class LinearisedSystem:
    """One system of a family, whose flights and jumps have exact derivatives.

    Attributes:
        family: the systems.
        theta: the parameters of the system, shape (p,), within their bounds.
        numbers: its coefficients.
        moving: its motion between impacts.
        gap_change: derivatives of the gaps by the parameters, shape (p, m).
    """

    def __init__(
        self, family: ParametricFamily, theta: Vector, moving: MovingSystem | None = None
    ) -> None:
        """Prepare the system of ``family`` with the parameters ``theta``, shape (p,).

        ``moving`` is its motion between impacts, if that is prepared already.
        """
        self.family, self.theta = family, np.array(theta)
        self.numbers = family.coefficients_at(theta)
        self.gap_change = family.gap_changes
        effects = [each.effect for each in family.parameters]
        self._laws = self.numbers.laws(family.system)
        self._moves = [j for j, each in enumerate(family.parameters) if each.moves]
        tuned = [each.frequency for each in effects]
        self._tuned = np.reshape(tuned, (family.size, self.numbers.frequency.size))
        own = family.near(theta) if family.size else family.system
        inverse = linalg.inv(self.numbers.M) if self._moves else None
        self.moving = moving or MovingSystem(own, inverse)
        self._is_driven = bool(self._moves) and self.moving.is_plain
        self._flight_maps = dict[tuple[Contacts, float], np.ndarray]()
        self._generators = cache(self._generators_of)
        self._stops = cache(self._stops_of)
        self.contact_rows = cache(self._contact_rows)
        self.beside = cache(self._beside)

    def begin(self, t: float, x: Vector, others: int = 0) -> TangentState:
        """The start ``x``, shape (2n,), at ``t``, with ``others`` more unknowns; all is open."""
        return TangentState(t, np.array(x), np.eye(x.size, x.size + self.family.size + others))

    def pressed(self, change: ContactChange, x: Vector) -> Contacts:
        """The contacts that take an impulse at a ``change``, before which the state is ``x``."""
        if not change.hit or len(change.active) == 1:
            return change.hit
        gamma = self.family.system.W[:, list(change.hit)].T @ x[x.size // 2 :]
        return change.pressed(self.moving.newton, gamma)

    def prepare(self, flights: Iterable[tuple[Contacts, float]]) -> None:
        """Make the exponentials of ``flights``, those of a phase at once.

        A flight has closed contacts and a duration, s. ``flow`` makes others when it needs them.
        """
        durations = dict[Contacts, list[float]]()
        for closed, duration in flights if self._is_driven else ():
            durations.setdefault(closed, []).append(duration)
        d, p = 2 * self.family.system.n, self.family.size
        size = d + 2 * self.numbers.frequency.size + 1
        for closed, each in durations.items():
            s, generators = np.array(each)[:, None, None], self._generators(closed)
            maps = np.zeros((len(each), 1 + p, d, size))
            for j, (generator, scale) in zip(self._moves, generators, strict=True):
                blocks = linalg.expm(generator * s)[..., :size] * (scale[:, None] / scale[:size])
                maps[:, 0], maps[:, 1 + j] = blocks[:, :d], blocks[:, -d:]
            self._flight_maps.update(zip([(closed, one) for one in each], maps, strict=True))

    def flight(self, at: TangentState, t: float) -> TangentState:
        """The motion from ``at`` to ``t``, s since the epoch; nothing switches."""
        return at.mapped(self.flow(at.t, at.x, t - at.t, at.closed), t, at.closed)

    def switch(self, at: TangentState, end: FlightEnd) -> tuple[TangentState, Vector]:
        """The motion just after ``end``, and what it gains a second that the jump comes earlier.

        The second value, shape (2n,), is ``F+ - D_x R F-``.
        """
        map_, xi = self.jump(at, end)
        return at.mapped(map_, at.t, end.held), xi

    def gaps(self, at: TangentState, contacts: Contacts) -> tuple[Vector, Matrix]:
        """The gaps of ``contacts``, m, and their derivatives, shapes (k,) and (k, any)."""
        n, (W, gap, change) = self.family.system.n, self.contact_rows(contacts)
        rows = W.dot(at.X[:n])
        rows[:, 2 * n : 2 * n + self.family.size] += change
        return W.dot(at.x[:n]) + gap, rows

    def speeds(self, at: TangentState, contacts: Contacts) -> Matrix:
        """The derivatives of the speeds of ``contacts``, shape (k, any)."""
        return self.contact_rows(contacts)[0] @ at.X[self.family.system.n :]

    def guard(self, at: TangentState, contacts: Contacts, *, hit: bool) -> Guard:
        """The gaps of ``contacts`` that ``hit``, or the loads of closed ones that open."""
        n, d, moving = self.family.system.n, at.x.size, self.moving
        first, second = moving.rates_at(at.t, at.x, at.closed).along(at.x, moving.forces(at.t))
        force, slope, bend = moving.forces(at.t)
        if hit:
            value, rows = self.gaps(at, contacts)
            measured = Measured.gaps(moving.system, contacts)
            return Guard(measured, value, rows, measured.c @ first, measured.c @ second)
        measured = Measured.loads(moving.phase(at.closed), contacts)
        assert measured.load is not None, "a load depends on the force"
        rows, forces = measured.c @ at.X, self.family.force_changes(self.theta, at.t)
        for j, effect in enumerate(each.effect for each in self.family.parameters):
            changed = effect.K @ at.x[:n] + effect.C @ at.x[n:] + effect.M @ first[n:]
            rows[:, d + j] -= measured.load @ (forces[j] - changed)
        rate, bend = (
            measured.c @ along - measured.load @ by
            for along, by in ((first, slope), (second, bend))
        )
        return Guard(measured, measured.value(at.x, force), rows, rate, bend)

    def flow(self, t: float, x: Vector, s: float, closed: Contacts) -> TangentMap:
        """The state ``s`` seconds after, or before, the state ``x`` at ``t``."""
        if self._is_driven:
            if (closed, s) not in self._flight_maps:
                self.prepare([(closed, s)])
            maps, angle = self._flight_maps[closed, s], self.numbers.frequency * t
            cos, sin = np.cos(angle), np.sin(angle)
            after = maps.dot(np.concatenate([x, cos, sin, _ONE]))
            Gamma = after[1:].T
            if self._tuned.any():  # at t the harmonics have turned for t seconds already
                turned = t * np.hstack([-sin * self._tuned, cos * self._tuned])
                Gamma = Gamma + maps[0, :, x.size : -1] @ turned.T
            return TangentMap(after[0], maps[0, :, : x.size], Gamma)
        moved, Phi = self.moving.moved(t, x, s, closed)
        Gamma = np.zeros((x.size, self.family.size))
        if s:
            for j in self._moves:
                more, less = (each.moving.moved(t, x, s, closed)[0] for each in self.beside(j))
                Gamma[:, j] = (more - less) / self.distance(j)
        return TangentMap(moved, Phi, Gamma)

    def impact(self, x: Vector, pressed: Contacts, *, reflects: bool = False) -> TangentMap:
        """Newton's law on exactly the contacts ``pressed``, from the state ``x``.

        If the impact ``reflects``, gaps that are left are reversed like speeds: an impact that is
        as early or late as its gap says leaves the positions as they are.
        """
        n, p, x = self.family.system.n, self.family.size, x.copy()
        W, gap, change = self.contact_rows(pressed)
        stopped, stops, by_mass, by_law = self._stops(pressed)
        Phi, Gamma, gamma = np.eye(2 * n), np.zeros((2 * n, p)), W.dot(x[n:])
        speeds = [(self._laws[i], v) for i, v in zip(pressed, gamma.tolist(), strict=True)]
        rebounds = np.array([float(law.rebound(np.array(v))) for law, v in speeds])
        Phi[n:, n:] = stopped - (stops * [law.slope(v) for law, v in speeds]).dot(W)
        x[n:] = stopped.dot(x[n:]) - stops.dot(rebounds)
        if p:
            by = np.zeros((len(pressed), self.numbers.rebound.shape[1]))
            for row, (law, v) in zip(by, speeds, strict=True):
                sensitivity = law.sensitivity(v)
                row[: len(sensitivity)] = sensitivity
            Gamma[n:] = by_mass.dot(gamma + rebounds) - by_law.dot(by.ravel())
        if reflects:
            eps = [float(law.restitution_at(np.array(abs(v)))) for law, v in speeds]
            Phi[:n, :n] = stopped - (stops * eps).dot(W)
            left = (Phi[:n, :n] - np.eye(n)) @ linalg.pinv(W)
            x[:n] = Phi[:n, :n] @ x[:n] + left @ gap
            Gamma[:n] = left @ change
        return TangentMap(x, Phi, Gamma)

    def at_rest(self, x: Vector, closed: Contacts) -> TangentMap:
        """The state ``x`` with the speeds of ``closed`` contacts zero, as masses would have it."""
        n, p = self.family.system.n, self.family.size
        inverse, M = self.moving.phase(closed).inverse, self.numbers.M
        Phi, Gamma, still = np.eye(2 * n), np.zeros((2 * n, p)), x.copy()
        Phi[n:, n:] = inverse @ M
        still[n:] = Phi[n:, n:] @ x[n:]
        for j, each in enumerate(self.family.parameters):
            Gamma[n:, j] = inverse @ (each.effect.M @ (x[n:] - still[n:]))
        return TangentMap(still, Phi, Gamma)

    def on_stops(self, x: Vector, closed: Contacts) -> TangentMap:
        """The state ``x`` with the gaps of ``closed`` contacts zero, as springs would have it.

        What parameters change of the projection itself is left out: near such states it is small.
        """
        n, (W, gap, change) = self.family.system.n, self.contact_rows(closed)
        Z = self.moving.phases.projection.jump(closed)
        Phi, Gamma, moved = np.eye(2 * n), np.zeros((2 * n, self.family.size)), x.copy()
        moved[:n] -= Z @ (W @ x[:n] + gap)
        Phi[:n, :n] -= Z @ W
        Gamma[:n] = -Z @ change
        return TangentMap(moved, Phi, Gamma)

    def jump(
        self, at: TangentState, end: FlightEnd, *, is_measured: bool = False
    ) -> tuple[TangentMap, Vector]:
        """The jump at ``end``; see ``switch``.

        Contacts that stay closed have no speed afterwards. Where a gap, and the gap and speed of a
        contact that stays closed, ``is_measured`` by the user, such an impact leaves the speed as
        it is, and ``reflects`` what is left of the gap.
        """
        t, x, _, before = at
        map_ = self.impact(x, end.pressed, reflects=is_measured)
        if end.held and not is_measured:
            map_ = self.at_rest(map_.x, end.held).preceded_by(map_)
        ahead = self.moving.rate_of(t, map_.x, end.held)
        return map_, ahead - map_.Phi.dot(self.moving.rate_of(t, x, before))

    def distance(self, j: int) -> float:
        """The difference of the ``j``-th parameter of the two systems that are ``beside``."""
        more, less = self.beside(j)
        return float(more.theta[j] - less.theta[j])

    def _beside(self, j: int) -> tuple["LinearisedSystem", "LinearisedSystem"]:
        """Systems with a little more and a little less of the ``j``-th parameter."""
        more, less, each = self.theta.copy(), self.theta.copy(), self.family.parameters[j]
        more[j] = min(self.theta[j] + STEP * each.size, each.high)
        less[j] = max(self.theta[j] - STEP * each.size, each.low)
        return LinearisedSystem(self.family, more), LinearisedSystem(self.family, less)

    def _generators_of(self, closed: Contacts) -> list[tuple[Matrix, Vector]]:
        """For each parameter that moves ``z``: generator of ``z`` and its derivative, and scales.

        ``z = (q, u, cos w t, sin w t, 1)``; the derivative is that of (q, u), after those of the
        harmonics by a frequency. A derivative is zero at the start.
        """
        n, numbers, rates = self.family.system.n, self.numbers, self.moving.rates(closed)
        h, amplitudes = numbers.frequency.size, self.family.harmonics(numbers)
        forces, size, found = _by_wave(amplitudes[0]), 2 * n + 2 * h + 1, []
        forces[:, -1] = numbers.constant
        own = np.zeros((size, size))
        own[: 2 * n, : 2 * n], own[: 2 * n, 2 * n :] = rates.A, rates.B @ forces
        turning = np.zeros((2, h, 2, h))
        turning[0, :, 1], turning[1, :, 0] = (
            -np.diag(numbers.frequency),
            np.diag(numbers.frequency),
        )
        waves = slice(2 * n, 2 * n + 2 * h)
        own[waves, waves] = turning.reshape(2 * h, 2 * h)
        for j in self._moves:
            effect = self.family.parameters[j].effect
            pulled = -effect.M @ own[n : 2 * n]
            pulled[:, : 2 * n] -= np.hstack([effect.K, effect.C])
            pulled[:, 2 * n :] += _by_wave(amplitudes[1][j])
            pulled[:, -1] += effect.constant
            tuned = 2 * h if np.any(effect.frequency) else 0
            whole = np.zeros((size + tuned + 2 * n,) * 2)
            whole[:size, :size] = own
            if tuned:
                late, share = slice(size, size + tuned), effect.frequency / numbers.frequency
                whole[late, waves] = np.tile(share, 2)[:, None] * own[waves, waves]
                whole[late, late] = own[waves, waves]
                whole[-2 * n :, late] = own[: 2 * n, waves]
            whole[-2 * n :, :size] = rates.B @ pulled
            whole[-2 * n :, -2 * n :] = rates.A
            balanced, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
            found.append((balanced, scale))
        return found

    def _contact_rows(self, contacts: Contacts) -> tuple[Matrix, Vector, Matrix]:
        """Directions of k contacts, gaps of zero coordinates, and their changes by parameters.

        Shapes (k, n), (k,) and (k, p).
        """
        own = list(contacts)
        return self.family.system.W[:, own].T, self.numbers.gap[own], self.gap_change[:, own].T

    def _stops_of(self, pressed: Contacts) -> tuple[Matrix, Matrix, np.ndarray, np.ndarray]:
        """``X`` of contacts, and what each parameter changes.

        Returns:
            ``I - X W^T``, shape (n, n); ``X``, shape (n, c) for c contacts; ``-dX = R dM X``,
            (n, p, c); ``X`` times the changes of the parameters of the rebound laws, (n, p, any).
        """
        stops, most = self.moving.newton.stops(pressed), self.numbers.rebound.shape[1]
        by_mass = np.zeros((len(stops), self.family.size, len(pressed)))
        by_law = np.zeros((*by_mass.shape, most))
        for j, each in enumerate(self.family.parameters):
            by_law[:, j] = stops[:, :, None] * each.effect.rebound[list(pressed)]
            if np.any(each.effect.M):
                by_mass[:, j] = self.moving.phase(pressed).inverse @ each.effect.M @ stops
        stopped = self.moving.newton.jump(pressed, np.zeros(self.family.system.m))
        return stopped, stops, by_mass, by_law.reshape(*by_mass.shape[:2], len(pressed) * most)


def _by_wave(amplitudes: np.ndarray) -> Matrix:
    """Harmonic forces of complex ``amplitudes``, (h, n), by (cos w t, sin w t, 1), (n, 2h + 1)."""
    zero = np.zeros((1, amplitudes.shape[1]))
    return np.asarray(np.vstack([amplitudes.real, -amplitudes.imag, zero]).T)
