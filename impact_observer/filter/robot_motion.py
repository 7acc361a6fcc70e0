# SPDX-License-Identifier: Apache-2.0
"""The motion of a robot between impacts, as the filter asks for it: states and derivatives.

A motion goes by steps of Runge and Kutta. Its derivative by the start is the product of the
exponentials of the linearisation in the middle of each step, to third order.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from impact_observer.dynamics.flow import Motion
from impact_observer.dynamics.scales import Scales
from impact_observer.events import Contacts
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.process_noise import fastest_rate
from impact_observer.filter.saltation import StateRates
from impact_observer.filter.square_root import triangular
from impact_observer.model import System
from impact_observer.model.live_samples import LiveSamples
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_parameters import torques_by_parameters
from impact_observer.states import Matrix, Vector, frozen

_SAME_STEP = 1e-9
"""Part of a step that is rounding."""
_SAME_INSTANT = 1e-9
"""Time between two instants that count as one, s: that of a stamp."""
_LONGEST_STEP = 0.1
"""Longest step, in the inverse of the fastest rate at rest, which is at most 1 s."""


_KEPT_COURSES = 8
"""Motions whose steps are kept: those of an estimate and of its hypotheses."""


class _MotionStep:
    """A step of a motion; derivatives are made when they are asked for.

    Attributes:
        before: the state before it, shape (2n,).
        after: the state after it.
        seconds: how long it takes.
    """

    def __init__(
        self, moving: "RobotMotion", t: float, x: Vector, h: float, closed: Contacts
    ) -> None:
        """From ``x`` at ``t``, s since the epoch, ``h`` seconds on."""
        self._moving, self._closed, self.before, self.seconds = moving, closed, x, h
        self._t = t
        self._tau, slope = moving.torques(t, t + h)
        self.after = moving.system.advanced(x, self._tau, h, closed, slope)

    @cached_property
    def middle(self) -> Vector:
        """The state in the middle, nearly, shape (2n,)."""
        return (self.before + self.after) / 2

    @cached_property
    def _rates(self) -> tuple[Matrix, Matrix]:
        return self._moving.system.rate_derivatives(self.middle, self._tau, self._closed)

    @cached_property
    def map_(self) -> Matrix:
        """The derivative of the state after by the one before, shape (2n, 2n)."""
        first = self.seconds * self._rates[0]
        square = first @ first
        map_: Matrix = first + square / 2 + square @ first / 6
        map_.flat[:: len(map_) + 1] += 1.0
        return map_

    @property
    def kicks(self) -> Matrix:
        """Accelerations by torques in the middle, shape (n, n)."""
        return self._rates[1][len(self._rates[1]) // 2 :]

    @property
    def faded(self) -> Matrix:
        """What is left of a kick at the end, in the mean over the step, shape (n, n)."""
        n = self.before.size // 2
        faded = self.map_[n:, n:] / 2
        faded.flat[:: n + 1] += 0.5
        return faded

    @cached_property
    def noise(self) -> Matrix:
        """A root of the covariance of what white torques add, shape (2n, 2n)."""
        n, h = self.before.size // 2, self.seconds
        inverse = self.faded @ self.kicks * self._moving.system.white_torques(self._t)
        added = np.zeros((2 * n, 2 * n))
        added[:n, :n] = h**1.5 / 2 * inverse
        added[:n, n:] = h**1.5 / math.sqrt(12) * inverse
        added[n:, :n] = math.sqrt(h) * inverse
        return added

    def with_noise(self, root: Matrix) -> Matrix:
        """A ``root`` of a covariance before the step after it, with noise, shape (2n, 2n)."""
        return triangular(np.hstack([self.map_ @ root, self.noise]))

    def with_parameters(self, change: Matrix, names: Sequence[str]) -> Matrix:
        """Derivatives of the state by parameters of these ``names`` after it, shape (2n, p)."""
        n, h = self.before.size // 2, self.seconds
        acceleration = (self.after - self.before)[n:] / h
        drags = torques_by_parameters(self._moving.system, self.middle[n:], acceleration, names)
        kicks = h * self.kicks @ drags
        found: Matrix = self.map_ @ change
        found[:n] += h / 2 * kicks
        found[n:] += self.faded @ kicks
        return found


class _Course:
    """A motion from one state on, or back, by equal steps that are made when they are needed.

    So the cost of many instants is that of the longest, and steps do not depend on who asks.
    """

    def __init__(
        self, moving: "RobotMotion", t: float, x: Vector, step: float, closed: Contacts
    ) -> None:
        """From ``x`` at ``t``, s since the epoch, by steps of ``step`` seconds."""
        self._moving, self._t, self._x, self._step, self._closed = moving, t, x, step, closed
        self._steps: list[_MotionStep] = []
        self._last: tuple[tuple[int, float], _MotionStep] | None = None
        self._maps = [moving.unit]
        self._roots = [moving.nothing]
        self._changes: dict[tuple[str, ...], list[Matrix]] = {}

    def moved(self, s: float) -> tuple[Vector, Matrix]:
        """The state after ``s`` seconds, and its derivative by the first one."""
        whole, last = self._to(s)
        before = self._whole(self._maps, whole, lambda map_, step: step.map_ @ map_)
        return last.after, last.map_ @ before if whole else last.map_

    def state(self, s: float) -> Vector:
        """The state after ``s`` seconds, shape (2n,)."""
        return self._to(s)[1].after

    def diffusion(self, s: float) -> Matrix:
        """A root of what white torques add in ``s`` seconds, shape (2n, 2n)."""
        whole, last = self._to(s)
        if not whole:
            return last.noise
        return last.with_noise(
            self._whole(self._roots, whole, lambda root, step: step.with_noise(root))
        )

    def by_parameters(self, s: float, names: tuple[str, ...]) -> Matrix:
        """Derivatives of the state after ``s`` seconds by parameters, shape (2n, p)."""
        whole, last = self._to(s)
        known = self._changes.setdefault(names, [np.zeros((self._x.size, len(names)))])
        before = self._whole(known, whole, lambda each, step: step.with_parameters(each, names))
        return last.with_parameters(before, names)

    def _to(self, s: float) -> tuple[int, _MotionStep]:
        """How many whole steps come before the last step to ``s`` seconds, and this last one."""
        whole = max(math.ceil(s / self._step - _SAME_STEP) - 1, 0)
        left = s - whole * self._step
        while len(self._steps) < whole:
            self._steps.append(self._between(len(self._steps), self._step))
        if self._last is None or self._last[0] != (whole, left):
            self._last = (whole, left), self._between(whole, left)
        return whole, self._last[1]

    def _between(self, whole: int, seconds: float) -> _MotionStep:
        """The step after some whole ones."""
        x = self._steps[whole - 1].after if whole else self._x
        return _MotionStep(self._moving, self._t + whole * self._step, x, seconds, self._closed)

    def _whole(
        self, known: list[Matrix], count: int, after: Callable[[Matrix, _MotionStep], Matrix]
    ) -> Matrix:
        """What is ``known`` after whole steps, of which ``count`` are asked for."""
        while len(known) <= count:
            known.append(after(known[-1], self._steps[len(known) - 1]))
        return known[count]


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

    def along(self, x: Vector, forces: Matrix) -> tuple[Vector, Vector]:
        """``dx/dt`` at a state and its derivative by time, (2n,) each; ``forces`` are f, f'."""
        first = self._robot.rates(x, forces[0], self._closed)
        return first, np.asarray(self.A @ first + self.B @ forces[1])


class RobotPath(Motion):
    """A motion from one state on."""

    def __init__(self, moving: "RobotMotion", t: float, x: Vector, closed: Contacts) -> None:
        """From ``x`` at ``t``, s since the epoch, while contacts are ``closed``."""
        self._moving, self.t, self._x, self._closed = moving, t, x, closed

    def state(self, s: float) -> Vector:
        """The state ``s`` seconds after the start, shape (2n,)."""
        return self._moving.state_after(self.t, self._x, s, self._closed)

    def states(self, s: Vector) -> Matrix:
        """``state`` at each of ``s`` seconds in rising order, shape (samples, 2n)."""
        return np.array([self.state(each) for each in s.tolist()])


class RobotMotion(MovingSystem):
    """A robot between its impacts; torques are those of its ``forcing``.

    Attributes:
        system: the robot.
        depends_on_state: derivatives of a motion depend on its start.
        is_plain: the kernel does not know it.
        rate: the fastest rate at rest, 1/s.
        scales: of its motions.
        longest_step: of Runge and Kutta, s.
        first_window: that step, as encoders come often and a motion is integrated.
        unit: the derivative of a state by itself, shape (2n, 2n).
        nothing: no covariance, shape (2n, 2n).
    """

    def __init__(self, robot: Robot) -> None:
        """Of a ``robot``; its rates are those at rest with all coordinates zero."""
        self.system: Robot = robot  # type: ignore[assignment]
        self.is_plain = False
        self.depends_on_state = True
        zero = np.zeros(robot.n)
        A, _ = robot.rate_derivatives(np.zeros(2 * robot.n), robot.rest_torque(zero))
        self.rate = fastest_rate(A)
        unit, squares = np.eye(robot.n), np.full(robot.n, self.rate**2)
        self.scales = Scales(squares, unit, unit, unit, self.rate, 1.0 / max(self.rate, 1.0))
        self.longest_step = self.first_window = _LONGEST_STEP * self.scales.timescale
        self.unit = frozen(np.eye(2 * robot.n))
        self.nothing = frozen(np.zeros((2 * robot.n, 2 * robot.n)))
        self._noisy = robot.has_white_torques
        self._courses: dict[object, _Course] = {}
        self._known: Vector | None = None

    def forces(self, t: float) -> Matrix:
        """Torques and their first two derivatives at ``t``, s since the epoch, (3, n)."""
        return self.system.forcing.derivatives(np.array([t]), 2)[:, 0]

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
        return self._course(t, x, s, closed).state(s) if s else x

    def moved(self, t: float, x: Vector, s: float, closed: Contacts) -> tuple[Vector, Matrix]:
        """The state ``s`` seconds after, or before, ``x`` at ``t``; its derivative by ``x``."""
        return self._course(t, x, s, closed).moved(s) if s else (x, self.unit)

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

    def inverse(self, x: Vector) -> Matrix:
        """``M^-1`` at a state, shape (n, n)."""
        return self.system.mobility_matrix(x[: self.system.n], ())

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

        The level of this noise is that of the robot's ``white_torques``.
        """
        if not (self._noisy and s > 0):
            return self.nothing
        return self._course(t, x, s, closed).diffusion(s)

    def by_parameters(
        self, t: float, x: Vector, s: float, closed: Contacts, names: Sequence[str]
    ) -> Matrix:
        """Derivatives of ``moved`` by the parameters of these ``names``, shape (2n, p)."""
        if not (names and s):
            return np.zeros((x.size, len(names)))
        return self._course(t, x, s, closed).by_parameters(s, tuple(names))

    def carried(self, t: float, x: Vector, columns: Matrix, s: float, closed: Contacts) -> Matrix:
        """Differences of states about ``x`` at ``t``, one a column, ``s`` seconds later."""
        return np.asarray(self.moved(t, x, s, closed)[1] @ columns)

    def _course(self, t: float, x: Vector, s: float, closed: Contacts) -> _Course:
        """The motion forward, or back if ``s`` is negative; the latest few are kept."""
        sampled = self.system.forcing.sampled
        known = None if sampled is None else sampled.time  # replaced where samples come
        if known is not self._known:
            self._courses.clear()
            self._known = known
        t, step = float(t), math.copysign(self.longest_step, s)
        asked = t, step, closed, x.tobytes()
        course = self._courses.pop(asked, None)
        if course is None:
            if len(self._courses) == _KEPT_COURSES:
                del self._courses[next(iter(self._courses))]
            course = _Course(self, t, x, step, closed)
        self._courses[asked] = course  # the last to be forgotten
        return course

    def torques(self, since: float, until: float) -> tuple[Vector, Vector | None]:
        """Torques in the middle of a step, shape (n,), and their slope; None for zero.

        Where samples change within the step, the line with the same integral and first moment:
        the velocities and coordinates that it gives differ by the change of masses in the step.
        """
        forcing, middle = self.system.forcing, (since + until) / 2
        samples = forcing.sampled
        if not isinstance(samples, LiveSamples) or forcing.frequency.size:
            tau, slope, _ = self.forces(middle)
            return tau, slope
        ends = min(since, until), max(since, until)
        low = int(samples.time.searchsorted(ends[0] + _SAME_INSTANT))
        high = int(samples.time.searchsorted(ends[1] - _SAME_INSTANT, side="right"))
        held = samples.force[max(low - 1, 0) : max(low, high, 1)]
        if len(held) == 1:
            return forcing.constant + held[0], None
        knots = np.concatenate([ends[:1], samples.time[low:high], ends[1:]])
        share = np.diff(knots) / (ends[1] - ends[0])
        arm = (knots[1:] + knots[:-1]) / 2 - middle
        slope = 12 / (ends[1] - ends[0]) ** 2 * ((share * arm) @ held)
        return forcing.constant + share @ held, slope


def motion_of(system: System | Robot) -> MovingSystem:
    """The motion of a linear system or a robot between impacts."""
    return RobotMotion(system) if isinstance(system, Robot) else MovingSystem(system)


def scales_of(system: System | Robot) -> Scales:
    """The scales of the motions of a linear system or a robot while nothing is held."""
    return RobotMotion(system).scales if isinstance(system, Robot) else Scales.of_equations(system)
