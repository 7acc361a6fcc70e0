# SPDX-License-Identifier: Apache-2.0
"""The mechanism of a robot: every answer by pinocchio, and derivatives along Runge-Kutta steps."""

import math
from collections import OrderedDict
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.dynamics.guard_values import GuardValues
from impact_observer.dynamics.mechanism import (
    Array,
    Flown,
    Gaps,
    Grip,
    Mechanism,
    Pressing,
    mechanism_near,
    mechanism_of,
)
from impact_observer.errors import DynamicsError
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.robot_description import RESTITUTION
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_course import RobotCourse, Way
from impact_observer.robots.robot_family import RobotFamily
from impact_observer.robots.robot_flight import RobotFlight, held_state
from impact_observer.robots.robot_parameters import jump_by_parameters, rates_by_parameters
from impact_observer.robots.tangent_robot import tangent
from impact_observer.states import Matrix, Vector

_GRAVITY = 9.81
_ZERO = 1e-11
"""Acceleration of a gap that counts as none, relative to the largest term of its sum."""
_LONGEST_STEP = 0.1
"""Longest step of flights with derivatives, in the inverse of the fastest rate at rest."""
_CLOSE = 0.01
"""Difference of coordinates of two states whose flights differ by their derivatives, rad or m."""
_SHORT = 0.2
"""Steps up to which one linearisation does, over the longest step."""
_KEPT = 256
"""Motions and places that are kept: those of an estimate and of its hypotheses."""


class RobotMechanism:
    """One robot.

    Attributes:
        system: the robot.
        timescale: of a fall through the reach of the robot, s.
        rate: the fastest rate at rest with all coordinates zero, at least 1, 1/s.
        window: the longest step of a flight, s.
        stride: the same.
        names: parameters by which derivatives are taken, as in ``robot_parameters``.
        theta: their values, shape (p,).
        gap_slopes: no parameter moves a plane, shape (m, p).
    """

    def __init__(self, robot: Robot, names: Sequence[str] = ()) -> None:
        """Take the parameters ``names`` for derivatives."""
        self.system: Robot = robot
        self.names = tuple(names)
        known = robot.description.parameters
        self.theta = np.array([known[name] for name in self.names])
        self.gap_slopes = np.zeros((robot.m, self.theta.size))
        size = float(np.max(robot.reach, initial=1.0))
        self.timescale: float = math.sqrt(size / _GRAVITY)
        n = robot.n
        A, _ = robot.rate_derivatives(np.zeros(2 * n), robot.rest_torque(np.zeros(n)))
        self.rate = max(float(np.max(np.abs(np.linalg.eigvals(A)))), 1.0)
        self.window = self.stride = _LONGEST_STEP / self.rate
        self._courses: OrderedDict[tuple[object, ...], RobotCourse] = OrderedDict()
        self._known: object = None
        self._placed = lru_cache(_KEPT)(self._placed_at)

    @property
    def is_noisy(self) -> bool:
        """Whether torques are white noise: those of the model, or the error of held efforts."""
        return self.system.has_white_torques

    def motion(self, t: float, x: Vector, grip: Grip, /) -> RobotFlight:
        """A flow of high order, in whose steps guards are polynomials."""
        return RobotFlight(self.system, t, x, grip)

    def struck(self, x: Vector, contacts: Contacts, /, *, plastic: bool = False) -> Vector:
        """Newton's law, and the nearest position on the planes in the metric of ``M``."""
        robot, (q, u) = self.system, np.split(x, 2)
        velocity = robot.velocity_after(q, u, contacts, plastic=plastic)
        return np.concatenate([robot.projected(q, contacts), velocity])

    def stopped(self, x: Vector, contacts: Contacts, /) -> Vector:
        """The nearest state in the metric of ``M``."""
        return held_state(self.system, x, contacts)

    def pressing(self, t: float, x: Vector, /) -> Pressing:
        """How contacts are pressed; planes do not move."""
        robot, (q, u) = self.system, np.split(x, 2)
        root = np.linalg.cholesky(robot.mass(q))
        B = linalg.solve_triangular(root, robot.directions(q), lower=True)
        free = root.T @ robot.acceleration(q, u, robot.torques(t))
        length = np.sqrt(np.einsum("ik,ik->k", B, B))
        return Pressing(B, length, free, robot.bias(q, u), robot.reach)

    def grip(
        self,
        t: float,
        x: Vector,
        contacts: Contacts,
        /,
        ending: tuple[Grip, frozenset[int]] | None = None,
    ) -> Grip:
        """Accelerations decide."""
        if not contacts:
            return Grip((), ())
        robot = self.system
        here, which = self.pressing(t, x), list(contacts)
        B, rising = here.B[:, which], here.rising(contacts)
        loads = complementary(B, rising)
        if loads is None:
            names = ", ".join(repr(robot.contact_names[i]) for i in contacts)
            raise DynamicsError(
                f"{robot.name}: contacts {names}: the loads that hold them cannot be found"
            )
        none = _ZERO * (np.abs(here.free) @ np.abs(B) + np.abs(here.bias[which]))
        stays = (loads > 0) | (rising + B.T @ (B @ loads) <= none)
        closed = tuple(i for i, each in zip(contacts, stays, strict=True) if each)
        if ending is not None and closed == ending[0].closed:
            closed = tuple(i for i in closed if i not in ending[1])
        return Grip(closed, closed)

    def course(self, t: float, x: Vector, held: Contacts) -> RobotCourse:
        """The motion through ``x``, shape (2n,), at ``t`` by steps of Runge and Kutta."""
        return RobotCourse(self._way(held), t, x, backward=False)

    def _way(self, held: Contacts) -> Way:
        is_moved = any(not name.startswith(RESTITUTION) for name in self.names)
        return Way(self.system, self.names, is_moved, held, self.window, _SHORT * self.window)

    def flown(self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /) -> Flown:
        """Steps of Runge and Kutta, one state after the other; close states share derivatives."""
        after = np.empty_like(x)
        Phi, Gamma = np.empty((*x.shape, x.shape[1])), np.empty((*x.shape, self.theta.size))
        near = self._near_first(t, x, s)
        for k, course, seconds in self._flights(t, x, s, held, near):
            after[k] = course.state(seconds)
            Phi[k], Gamma[k] = course.maps(seconds)
        if near.any():
            after[near] = after[0] + (x[near] - x[0]) @ Phi[0].T
            Phi[near], Gamma[near] = Phi[0], Gamma[0]
        return Flown(after, Phi, Gamma)

    def noise(
        self,
        t: Sequence[float],
        x: Array,
        s: Vector,
        held: Contacts,
        intensity: tuple[float, ...],
        /,
    ) -> Array:
        """White torques and accelerations along the motion of each state, step by step."""
        given, found = np.array(intensity), np.empty((*x.shape, x.shape[1]))
        near = self._near_first(t, x, s)
        for k, course, seconds in self._flights(t, x, s, held, near):
            found[k] = course.noise(seconds, given)
        found[near] = found[0]
        return found

    def _near_first(self, t: Sequence[float], x: Array, s: Vector) -> NDArray[np.bool_]:
        """Which states fly as the first one does, but for terms of second order, shape (K,)."""
        near = np.zeros(len(x), dtype=np.bool_)
        if len(x) > 1 and len(s) == len(t) == 1 and abs(s[0]) <= self.stride:
            q, u = np.split(np.abs(x - x[0]), 2, axis=1)
            near = np.all(q + u / self.rate <= _CLOSE, axis=1)
            near[0] = False
        return near

    def rates(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """``(u, u')`` of each state."""
        robot, times = self.system, np.broadcast_to(t, len(x)).tolist()
        each = zip(x, times, strict=True)
        return np.array([robot.rates(at, robot.torques(when), held) for at, when in each])

    def rate_slopes(self, t: Sequence[float], x: Array, held: Contacts, /) -> tuple[Array, Array]:
        """One state after the other."""
        robot, times = self.system, np.broadcast_to(t, len(x)).tolist()
        A, Gamma = np.empty((*x.shape, x.shape[1])), np.empty((*x.shape, self.theta.size))
        for k, (at, when) in enumerate(zip(x, times, strict=True)):
            tau = robot.torques(when)
            A[k], _ = robot.rate_derivatives(at, tau, held)
            Gamma[k] = rates_by_parameters(robot, at, tau, self.names, held)
        return A, Gamma

    def gaps(self, x: Array, /) -> Gaps:
        """One state after the other; the latest are kept."""
        robot, n = self.system, self.system.n
        placed = [self._placed(q.tobytes()) for q in x.reshape(-1, 2 * n)[:, :n]]
        W = np.array([each.T for _, each in placed]).reshape(*x.shape[:-1], robot.m, n)
        g = np.array([each for each, _ in placed]).reshape(*x.shape[:-1], robot.m)
        return Gaps(g, np.einsum("...ij,...j->...i", W, x[..., n:]), W)

    def _placed_at(self, q: bytes) -> tuple[Vector, Matrix]:
        return self.system.gaps_and_directions(np.frombuffer(q))

    def gaps_along(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /
    ) -> GuardValues:
        """At the ends of the steps of each flight."""
        states, ends = self._along(t, x, s, held)
        gaps = self.gaps(states)
        return GuardValues(gaps.g.transpose(0, 2, 1), gaps.gamma.transpose(0, 2, 1), ends)

    def loads_along(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts, /
    ) -> tuple[Array, Array]:
        """At the ends of the steps of each flight."""
        (states, ends), robot = self._along(t, x, s, held), self.system
        times = ends + np.array([float(each) for each in t])
        found = np.empty((len(ends), len(held), len(x)))
        for (k, h), when in np.ndenumerate(times):
            q, u = np.split(states[k, h], 2)
            found[k, :, h] = robot.loads(q, u, robot.torques(when), held)
        return found, ends

    def _along(
        self, t: Sequence[float], x: Array, s: Vector, held: Contacts
    ) -> tuple[Array, Array]:
        """States at the ends of steps, (steps + 1, K, 2n), and when, s, (steps + 1, K)."""
        steps = max(math.ceil(float(s.max()) / self.window), 1)
        ends = np.minimum(np.arange(steps + 1)[:, None] * self.window, s)
        states = np.empty((steps + 1, *x.shape))
        for h, course, _ in self._flights(t, x, s, held):
            states[:, h] = [course.state(each) for each in ends[:, h].tolist()]
        return states, ends

    def falling(self, t: Sequence[float], x: Array, held: Contacts, /) -> Array:
        """By the accelerations of the joints, and by the turn of the directions."""
        robot, n = self.system, self.system.n
        turned = np.array([robot.bias(each[:n], each[n:]) for each in x])
        rates = self.rates(t, x, held)[:, n:]
        return np.asarray(-np.einsum("kmi,ki->km", self.gaps(x).W, rates) - turned)

    def pressed(self, x: Vector, active: Contacts, hit: Contacts, /) -> Contacts:
        """Newton's law decides; where all of them separate, those that ``hit``."""
        q, u = np.split(x, 2)
        return self.system.pushed(q, u, active) or hit

    def forced(self) -> tuple[Vector, Vector]:
        """Zero: the motion of a robot is known by its encoders."""
        return np.zeros(2 * self.system.n), np.zeros(self.system.n)

    def near(self, x: Vector, theta: Vector, /) -> System:
        """The robot at ``x``."""
        robot = self.system
        if theta.size:
            values = dict(zip(self.names, theta.tolist(), strict=True))
            robot = robot.with_parameters(values)
        return tangent(robot, x)

    def rest(self, x: Array, held: Contacts, /) -> Flown:
        """The nearest state in the metric of ``M``, positions too, as planes bend coordinates."""
        robot, n, d = self.system, self.system.n, 2 * self.system.n
        rows, Phi = x.reshape(-1, d), np.zeros((x.size // d, d, d))
        after = np.array([held_state(robot, each, held) for each in rows])
        X = self.stops(after, held)
        still = np.eye(n) - X @ self.gaps(after).W[:, list(held)]
        Phi[:, :n, :n] = Phi[:, n:, n:] = still
        shape = x.shape[:-1]
        Gamma = np.zeros((*shape, d, self.theta.size))
        return Flown(after.reshape(x.shape), Phi.reshape(*shape, d, d), Gamma)

    def stops(self, x: Array, pressed: Contacts, /) -> Array:
        """One state after the other."""
        n, found = self.system.n, list[Matrix]()
        for each in x.reshape(-1, 2 * n):
            W, kicks = self.system.kicks(each[:n], pressed)
            found.append(kicks @ np.linalg.pinv(W.T @ kicks, hermitian=True))
        return np.array(found).reshape(*x.shape[:-1], n, len(pressed))

    def impact(self, x: Array, pressed: Contacts, /) -> Flown:
        """One state after the other."""
        robot, d = self.system, 2 * self.system.n
        rows = x.reshape(-1, d)
        after = np.array([robot.jumped(each, pressed) for each in rows])
        Phi = np.array([robot.jump_derivatives(each, pressed) for each in rows])
        Gamma = np.array([jump_by_parameters(robot, each, pressed, self.names) for each in rows])
        shape = x.shape[:-1]
        return Flown(
            after.reshape(x.shape), Phi.reshape(*shape, d, d), Gamma.reshape(*shape, d, -1)
        )

    def sizes(self, x: Vector, s: float = 0.0, /) -> Vector:
        """Each joint by itself, at the fastest rate."""
        q, u = np.split(np.abs(x), 2)
        return np.concatenate([q + (1 / self.rate + s / 2) * u, u + s / 2 * self.rate**2 * q])

    def kinetic(self, x: Array, /) -> Array:
        """``u' M(q) u / 2``."""
        n = self.system.n
        rows = x.reshape(-1, 2 * n)
        found = [self.system.kinetic_energy(each[:n], each[n:]) for each in rows]
        return np.array(found).reshape(x.shape[:-1])

    def distance(self, x: Array, error: Array, /) -> Array:
        """``du' M(q) du / 2 + dq' M(q) dq / 2 s^2``: inertia weighs positions, too, over 1 s."""
        n = self.system.n
        M = np.array([self.system.mass(each[:n]) for each in x.reshape(-1, 2 * n)])
        M, halves = M.reshape(-1, n, n), error.reshape(-1, 2, n)
        found = np.einsum("kai,kij,kaj->k", halves, M, halves) / 2
        return np.asarray(found.reshape(x.shape[:-1]))

    def _flights(
        self,
        t: Sequence[float],
        x: Array,
        s: Vector,
        held: Contacts,
        left_out: NDArray[np.bool_] | None = None,
    ) -> list[tuple[int, RobotCourse, float]]:
        """Numbers of states, the course of each and the duration of its flight; none ``left_out``.

        The latest courses are kept.
        """
        robot, courses = self.system, self._courses
        if robot.forcing.sampled_at is not self._known:
            courses.clear()
            self._known = robot.forcing.sampled_at
        times, lengths = list(t), s.tolist()
        found = list[tuple[int, RobotCourse, float]]()
        for k in range(len(x)) if left_out is None else np.flatnonzero(~left_out).tolist():
            at, seconds = times[min(k, len(times) - 1)], lengths[min(k, len(lengths) - 1)]
            asked = at, seconds < 0, held, x[k].tobytes()
            course = courses.pop(asked, None)
            if course is None:
                course = RobotCourse(self._way(held), at, x[k], backward=seconds < 0)
                if len(courses) == _KEPT:
                    courses.popitem(last=False)
            courses[asked] = course  # the last to be forgotten
            found.append((k, course, seconds))
        return found


@mechanism_of.register
def _(robot: Robot) -> Mechanism:
    return RobotMechanism(robot)


@mechanism_near.register
def _(family: RobotFamily, theta: Vector) -> Mechanism:
    names = tuple(family.names)
    return RobotMechanism(family.system_at(theta) if names else family.system, names)
