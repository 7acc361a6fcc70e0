# SPDX-License-Identifier: Apache-2.0
"""The motion of a robot between impacts, as the filter asks for it: states and derivatives.

A motion goes by steps of Runge and Kutta. Its derivative by the start is the product of the
exponentials of the linearisation in the middle of each step, to third order.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from impact_observer.dynamics.flow.flow import Motion
from impact_observer.dynamics.flow.scales import Scales
from impact_observer.events import Contacts
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.process_noise import fastest_rate
from impact_observer.filter.saltation import StateRates
from impact_observer.filter.square_root import triangular
from impact_observer.model import System
from impact_observer.model.live_samples import LiveSamples
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_parameters import torques_by_parameters
from impact_observer.states import Matrix, Vector

_SAME_INSTANT = 1e-9
"""Time between two instants that count as one, s: that of a stamp."""
_LONGEST_STEP = 0.1
"""Longest step, in the inverse of the fastest rate at rest, which is at most 1 s."""


_Asked: TypeAlias = tuple[tuple[float, float, Contacts, bytes], Vector | None]
"""Start, duration, closed contacts and state of a motion, and the instants of torques."""


class _MappedStep(NamedTuple):
    """A step of a motion.

    Attributes:
        after: the state after it, shape (2n,).
        map_: its derivative by the state before, shape (2n, 2n).
        seconds: how long it takes.
    """

    after: Vector
    map_: Matrix
    seconds: float


class RobotRates(StateRates):
    """``dx/dt`` of a robot about one state while contacts are closed.

    Attributes:
        A: derivative by the state, shape (2n, 2n).
        B: derivative by the torques, shape (2n, n).
        b: zero, shape (2n,).
    """

    def __init__(self, robot: Robot, x: Vector, tau: Vector, closed: Contacts) -> None:
        """About a state ``x`` under torques ``tau``."""
        self._robot, self._closed = robot, closed
        self.A, self.B = robot.rate_derivatives(x, tau, closed)
        self.b = np.zeros(x.size)

    def along(self, x: Vector, forces: Matrix) -> tuple[Vector, Vector]:
        """``dx/dt`` at a state and its derivative by time, (2n,) each; ``forces`` are f, f'."""
        first = self._robot.rates(x, forces[0], self._closed)
        return first, np.asarray(self.A @ first + self.B @ forces[1])


class RobotPath(Motion):
    """A motion from one state on, in steps that are made when they are asked for."""

    def __init__(self, moving: "RobotMotion", t: float, x: Vector, closed: Contacts) -> None:
        """From ``x`` at ``t``, s since the epoch, while contacts are ``closed``."""
        self._moving, self.t, self._closed = moving, t, closed
        self._nodes = [(0.0, x)]

    def state(self, s: float) -> Vector:
        """The state ``s`` seconds after the start, shape (2n,)."""
        step, start = self._moving.longest_step, self._nodes[0][1]
        if abs(s) <= step:
            return self._moving.moved(self.t, start, s, self._closed)[0]  # whose map is asked next
        while self._nodes[-1][0] + step < s:
            since, x = self._nodes[-1]
            x = self._moving.state_after(self.t + since, x, step, self._closed)
            self._nodes.append((since + step, x))
        since, x = next(each for each in reversed(self._nodes) if each[0] <= s or each[0] == 0)
        return self._moving.state_after(self.t + since, x, s - since, self._closed)

    def states(self, s: Vector) -> Matrix:
        """``state`` at each of ``s`` seconds in rising order, shape (samples, 2n)."""
        if s[-1] <= self._moving.longest_step:
            return np.array([self.state(each) for each in s.tolist()])
        found = [self.state(float(s[0]))]
        for since, until in pairwise(s.tolist()):
            t, x = self.t + since, found[-1]
            found.append(self._moving.state_after(t, x, until - since, self._closed))
        return np.array(found)


class RobotMotion(MovingSystem):
    """A robot between its impacts; torques are those of its ``forcing``.

    Attributes:
        system: the robot.
        guided: no guides rub.
        depends_on_state: derivatives of a motion depend on its start.
        is_plain: the kernel does not know it.
        rate: the fastest rate at rest, 1/s.
        scales: of its motions.
        longest_step: of Runge and Kutta, s.
        first_window: that step, as encoders come often and a motion is integrated.
    """

    def __init__(self, robot: Robot) -> None:
        """Of a ``robot``; its rates are those at rest with all coordinates zero."""
        self.system: Robot = robot  # type: ignore[assignment]
        self.guided = self.is_plain = False
        self.depends_on_state = True
        zero = np.zeros(robot.n)
        A, _ = robot.rate_derivatives(np.zeros(2 * robot.n), robot.rest_torque(zero))
        self.rate = fastest_rate(A)
        unit, squares = np.eye(robot.n), np.full(robot.n, self.rate**2)
        self.scales = Scales(squares, unit, unit, unit, self.rate, 1.0 / max(self.rate, 1.0))
        self.longest_step = self.first_window = _LONGEST_STEP * self.scales.timescale
        self._unit = np.eye(2 * robot.n)
        self._noisy = bool(robot.torque_deviation.any())
        self._latest: tuple[_Asked, list[_MappedStep]] | None = None

    def forces(self, t: float) -> Matrix:
        """Torques and their first two derivatives at ``t``, s since the epoch, (3, n)."""
        return self.system.forcing.derivatives(np.array([t]), 2)[:, 0]

    def _torques(self, t: float) -> Vector:
        """``forces(t)[0]``, at less cost where torques are samples that hold."""
        forcing = self.system.forcing
        if not isinstance(forcing.sampled, LiveSamples) or forcing.frequency.size:
            return np.asarray(self.forces(t)[0])
        k = int(np.searchsorted(forcing.sampled.time, t, side="right")) - 1
        return np.asarray(forcing.constant + forcing.sampled.force[max(k, 0)])

    def rates_at(self, t: float, x: Vector, closed: Contacts) -> RobotRates:
        """``dx/dt`` about a state, shape (2n,), at ``t``, s since the epoch."""
        return RobotRates(self.system, x, self.forces(t)[0], closed)

    def rate_of(self, t: float, x: Vector, closed: Contacts) -> Vector:
        """``dx/dt`` of a state at ``t``, s since the epoch, shape (2n,)."""
        return self.system.rates(x, self.forces(t)[0], closed)

    def motion(self, t: float, x: Vector, closed: Contacts) -> RobotPath:
        """The motion through ``x``, shape (2n,), at ``t``, s since the epoch."""
        return RobotPath(self, t, x, closed)

    def state_after(self, t: float, x: Vector, s: float, closed: Contacts) -> Vector:
        """The state ``s`` seconds after, or before, ``x`` at ``t``, shape (2n,)."""
        for tau, h in self._steps(t, s):
            x = self.system.advanced(x, tau, h, closed)
        return x

    def moved(self, t: float, x: Vector, s: float, closed: Contacts) -> tuple[Vector, Matrix]:
        """The state ``s`` seconds after, or before, ``x`` at ``t``; its derivative by ``x``."""
        whole = self._unit
        for after, map_, _ in self._mapped(t, x, s, closed):
            x, whole = after, map_ @ whole
        return x, whole

    def is_short(self, s: float) -> bool:
        """Whether the kernel makes transition matrices of ``s`` seconds: it makes none."""
        del s
        return False

    def is_cheap(self, closed: Contacts, s: float) -> bool:
        """Whether ``s`` seconds while contacts are ``closed`` need no phase: none has phases."""
        del closed, s
        return True

    def decay(self, closed: Contacts) -> float:
        """Rate of the fastest fading motion, 1/s, whatever is ``closed``."""
        del closed
        return self.rate

    def held(self, closed: Contacts) -> Contacts:
        """Those of the ``closed`` contacts that a load holds: all of them."""
        return closed

    def inverse(self, x: Vector, closed: Contacts = ()) -> Matrix:
        """``M^-1`` at a state while contacts are ``closed``, shape (n, n)."""
        return self.system.mobility_matrix(x[: self.system.n], closed)

    def root_energy(self, x: Vector) -> float:
        """The root of twice the kinetic energy of a state ``x``, shape (2n,), sqrt(J)."""
        n = self.system.n
        return math.sqrt(2 * self.system.kinetic_energy(x[:n], x[n:]))

    def contact_length(self, contact: int, x: Vector) -> float:
        """The largest speed of a contact per ``root_energy`` at a state ``x``, 1/sqrt(kg)."""
        W, kicks = self.system.kicks(x[: self.system.n], (contact,))
        return math.sqrt(W[:, 0] @ kicks[:, 0])

    def stops(self, x: Vector, contacts: Contacts) -> Matrix:
        """Velocities by unit speeds that ``contacts`` lose at a state ``x``, shape (n, k)."""
        W, kicks = self.system.kicks(x[: self.system.n], contacts)
        return np.asarray(kicks @ np.linalg.pinv(W.T @ kicks, hermitian=True))

    def shifts(self, x: Vector, contacts: Contacts) -> Matrix:
        """Coordinates by unit gaps that ``contacts`` gain at a state ``x``, shape (n, k)."""
        return self.stops(x, contacts)

    def diffusion(self, t: float, x: Vector, closed: Contacts, s: float) -> Matrix:
        """A root of what the white torques add in ``s`` seconds from ``x`` at ``t`` on, (2n, 2n).

        The level of this noise is that of the model, ``torque_deviation``.
        """
        root = np.zeros((x.size, x.size))
        for after, map_, h in self._mapped(t, x, s, closed) if self._noisy else ():
            n, added = self.system.n, np.zeros_like(root)
            faded = (np.eye(n) + map_[n:, n:]) / 2  # what is left of a kick, on average
            inverse = faded @ self.inverse((x + after) / 2, closed) * self.system.torque_deviation
            added[:n, :n] = h**1.5 / 2 * inverse
            added[:n, n:] = h**1.5 / math.sqrt(12) * inverse
            added[n:, :n] = math.sqrt(h) * inverse
            root = triangular(np.hstack([map_ @ root, added])) if root.any() else added
            x = after
        return root

    def by_parameters(
        self, t: float, x: Vector, s: float, closed: Contacts, names: Sequence[str]
    ) -> Matrix:
        """Derivatives of ``moved`` by the parameters of these ``names``, shape (2n, p)."""
        n, found = self.system.n, np.zeros((x.size, len(names)))
        for after, map_, h in self._mapped(t, x, s, closed) if names else ():
            middle, acceleration = (x + after) / 2, (after - x)[n:] / h
            drags = torques_by_parameters(self.system, middle[n:], acceleration, names)
            kicks = h * self.inverse(middle, closed) @ drags
            found = map_ @ found
            found[:n] += h / 2 * kicks
            found[n:] += (np.eye(n) + map_[n:, n:]) / 2 @ kicks
            x = after
        return found

    def carried(self, t: float, x: Vector, columns: Matrix, s: float, closed: Contacts) -> Matrix:
        """Differences of states about ``x`` at ``t``, one a column, ``s`` seconds later."""
        return np.asarray(self.moved(t, x, s, closed)[1] @ columns)

    def _mapped(self, t: float, x: Vector, s: float, closed: Contacts) -> list[_MappedStep]:
        """The steps of a motion; those asked for last are kept."""
        sampled = self.system.forcing.sampled
        known = None if sampled is None else sampled.time  # replaced where samples come
        asked = float(t), float(s), closed, x.tobytes()
        if self._latest is None or self._latest[0][0] != asked or self._latest[0][1] is not known:
            self._latest = (asked, known), [*self._made(t, x, s, closed)]
        return self._latest[1]

    def _made(self, t: float, x: Vector, s: float, closed: Contacts) -> Iterator[_MappedStep]:
        for tau, h in self._steps(t, s):
            after = self.system.advanced(x, tau, h, closed)
            A, _ = self.system.rate_derivatives((x + after) / 2, tau, closed)
            step = h * A
            square = step @ step
            map_ = self._unit + step + square / 2 + square @ step / 6
            yield _MappedStep(after, map_, h)
            x = after

    def _steps(self, t: float, s: float) -> Iterator[tuple[Vector, float]]:
        """Torques and durations of steps: no torque changes within one of them."""
        for since, until in self._intervals(t, t + s):
            length = until - since
            count = max(math.ceil(abs(length) / self.longest_step), 1)
            tau = self._torques((since + until) / 2)
            for _ in range(count if length else 0):
                yield tau, length / count

    def _intervals(self, since: float, until: float) -> Iterator[tuple[float, float]]:
        """The parts between the samples of torques; in the order of the motion."""
        sampled = self.system.forcing.sampled
        if sampled is None:
            yield since, until
            return
        ends = min(since, until) + _SAME_INSTANT, max(since, until) - _SAME_INSTANT
        low, high = np.searchsorted(sampled.time, ends)
        knots = sampled.time[low:high].tolist()
        yield from pairwise([since, *(knots if until > since else knots[::-1]), until])


def motion_of(system: System | Robot) -> MovingSystem:
    """The motion of a linear system or a robot between impacts."""
    return RobotMotion(system) if isinstance(system, Robot) else MovingSystem(system)


def scales_of(system: System | Robot) -> Scales:
    """The scales of the motions of a linear system or a robot while nothing is held."""
    return RobotMotion(system).scales if isinstance(system, Robot) else Scales.of_equations(system)
