# SPDX-License-Identifier: Apache-2.0
"""A robot prepared for the filter: at each state its contacts, jumps and rests, linearised there.

A robot is what a linear system is to the filter, but at one state. Damping, rotor inertia and
restitutions may be considered.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics import KEPT
from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.members import LARGEST, Member, Members, MotionSensitivity
from impact_observer.filter.robot_motion import RobotMotion, RobotRates
from impact_observer.filter.saltation import Expansion, Measured, Mirror, RestProjection
from impact_observer.kernel._kernel import Parameters
from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.robot_description import DAMPING, RESTITUTION
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_family import RobotFamily
from impact_observer.robots.robot_parameters import loads_by_parameters, rates_by_parameters
from impact_observer.robots.tangent_robot import tangent
from impact_observer.states import Matrix, Vector

_KEPT_STATES = 4
"""States at which a robot is kept: those of an estimate and of its hypotheses."""


class RobotGaps(Measured):
    """Gaps of a robot near a state, whose expansion knows how they bend."""

    robot: Robot
    contacts: Contacts

    @classmethod
    def about(cls, robot: Robot, contacts: Contacts, x: Vector) -> "RobotGaps":
        """The gaps of ``contacts`` near ``x``, shape (2n,)."""
        q = x[: robot.n]
        gaps, columns = robot.gaps_and_directions(q, contacts)
        W = columns.T
        found = cls(np.hstack([W, np.zeros_like(W)]), gaps - W @ q)
        found.robot, found.contacts = robot, contacts
        return found

    def expanded(self, rates: RobotRates, x: Vector, forces: Matrix) -> Expansion:  # type: ignore[override]
        """Their expansions about ``(0, x)``; see ``Measured.expanded``."""
        n = self.robot.n
        q, u = x[:n], x[n:]
        W = self.c[:, :n]
        acceleration = rates.along(x, forces)[0][n:]
        bend = W @ acceleration + self.robot.bias(q, u, self.contacts)
        by_state = np.hstack([self.robot.speed_gradients(q, u, self.contacts).T, W])
        H = np.column_stack([-(W @ u), self.c])
        return Expansion(self.robot.gaps(q, self.contacts), H, -by_state, bend)


class RobotMember(Member):
    """A robot with values of its parameters.

    Attributes:
        system: the robot.
        values: its parameters, shape (p,).
        moving: its motion between impacts.
    """

    def __init__(self, robot: Robot, values: Vector, moving: RobotMotion) -> None:
        """A robot whose motion between impacts is ``moving``."""
        self.system: Robot = robot  # type: ignore[assignment]
        self.values, self.moving = values, moving
        self._near = lru_cache(_KEPT_STATES)(self._tangent)

    def near(self, x: Vector) -> System:
        """The robot at a state ``x``, shape (2n,)."""
        return self._near(x.tobytes())

    def _tangent(self, state: bytes) -> System:
        return tangent(self.system, np.frombuffer(state))

    def gaps(self, contacts: Contacts, x: Vector) -> Measured:
        """The gaps of ``contacts`` near a state ``x``, shape (2n,)."""
        return RobotGaps.about(self.system, contacts, x)

    def speeds(self, contacts: Contacts, x: Vector) -> Measured:
        """The contact speeds of ``contacts`` near a state ``x``, shape (2n,)."""
        n = self.system.n
        by_u = self.system.directions(x[:n], contacts).T
        c = np.hstack([self.system.speed_gradients(x[:n], x[n:], contacts).T, by_u])
        return Measured(c, by_u @ x[n:] - c @ x)

    def guard(
        self, before: Contacts, contacts: Contacts, t: float, x: Vector, *, hit: bool
    ) -> Measured:
        """Gaps of contacts that hit, or loads of those that open while ``before`` are closed.

        Near a state ``x``, shape (2n,), at ``t``, s since the epoch.
        """
        if hit:
            return self.gaps(contacts, x)
        robot, n, which = self.system, self.system.n, [before.index(i) for i in contacts]
        tau = self.moving.forces(t)[0]
        c = robot.load_gradients(x, tau, before)[which]
        return Measured(c, robot.loads(x[:n], x[n:], tau, before)[which] - c @ x)

    def pressed(self, change: ContactChange, x: Vector) -> Contacts:
        """The contacts that take an impulse at an event, before which the state is ``x``."""
        if not change.hit or len(change.active) == 1:
            return change.hit
        n = self.system.n
        taking = self.system.pushed(x[:n], x[n:], change.active) or change.hit
        return tuple(sorted({*taking, *(i for i in change.before if i in change.closed)}))

    def mirror_about(self, x: Vector, pressed: Contacts) -> Mirror:
        """The jump of states near ``x``, (q-, u-), in which ``pressed`` take part.

        Newton's law for the velocities; a gap that is left is reversed like its speed.
        """
        n = self.system.n
        if not pressed:
            return Mirror(np.eye(2 * n), np.zeros(2 * n))
        J, landed = self.system.jump_derivatives(x, pressed), self.system.jumped(x, pressed)
        gaps, W = self.system.gaps_and_directions(x[:n], pressed)
        kick = J[n:, n:] - np.eye(n)
        J[:n, :n] += kick
        landed[:n] += kick @ np.linalg.lstsq(W.T, gaps)[0]
        return Mirror(J, landed - J @ x)

    def jump_root(self, before: Vector, after: Vector) -> Matrix:
        """A root of the covariance of an error as large as a jump, shape (2n, n).

        The error has the kinetic energy of the jump, in all directions alike.
        """
        n = self.system.n
        root, change = np.linalg.cholesky(self.system.mass(before[:n])), (after - before)[n:]
        size = np.linalg.norm(root.T @ change) / math.sqrt(n)
        return np.vstack([np.zeros((n, n)), size * np.linalg.inv(root.T)])

    def bends(self, x: Vector, root: Matrix, pressed: Contacts) -> Matrix:
        """What the curvature of rebound laws adds to the error of a jump: it is neglected."""
        del root, pressed
        return np.zeros((x.size, 0))

    def stopped(self, x: Vector, closed: Contacts, gap_sensitivity: Matrix) -> RestProjection:
        """A state ``x``, nearly at rest on ``closed`` contacts, projected onto rest on them."""
        n, robot = self.system.n, self.system
        q = robot.projected(x[:n], closed)
        u = robot.stopped(q, x[n:], closed)
        x = np.concatenate([q, u])
        still = np.eye(n) - self.moving.stops(x, closed) @ robot.directions(q, closed).T
        zero = np.zeros((n, n))
        map_ = np.block([[still, zero], [zero, still]])
        return RestProjection(x, map_, np.zeros((2 * n, gap_sensitivity.shape[1])))


class FirstOrder(NamedTuple):
    """The sensitivity of a motion to parameters, of which the second order is neglected.

    Attributes:
        first: derivatives of the state by the parameters, shape (p, 2n).
    """

    first: Matrix

    def noise(self, root: Matrix, own: Matrix) -> Matrix:
        """What the second order adds to the covariance: nothing, shape (2n, 0)."""
        del own
        return np.zeros((len(root), 0))


class RobotMembers(Members):
    """The members of a robot's family; each is prepared when it is first needed.

    Attributes:
        family: the robot and the parameters that are considered.
        given: the member with the parameters of the model.
        moving: how many of the parameters change the motion between impacts.
        considered: which of the parameters have an error, but are not estimated.
        parameters: their bounds, and steps of finite differences by them, for the kernel.
        is_linear: the kernel does not know a robot.
    """

    def __init__(self, family: RobotFamily, considered: Sequence[bool] = ()) -> None:
        """Prepare the given member; without ``considered`` all parameters are estimated."""
        self.family: RobotFamily = family
        self.moving, self.is_linear = sum(each.moves for each in family.parameters), False
        self.considered = tuple(considered) or (False,) * family.size
        low, high = np.clip(family.bounds, 0.0, LARGEST)
        self.parameters = Parameters(low, high, family.sizes, self.moving, self.considered)
        self._nominal = family.nominal
        self._damps = np.array([each.kind == DAMPING for each in family.parameters], np.bool_)
        self._at = lru_cache(KEPT)(self._member)
        self._motion_at = lru_cache(KEPT)(self._robot_motion)
        self._jumped = lru_cache(KEPT)(self._jump)
        self.gap_sensitivity = lru_cache(KEPT)(self._no_sensitivity)
        self._given_motion = RobotMotion(family.system)
        self.given = RobotMember(family.system, self._nominal, self._given_motion)

    def at(self, values: Vector) -> Member:
        """The member whose parameters are ``values``, shape (p,), all within their bounds."""
        return self._at(tuple(values.tolist())) if self.family.size else self.given

    def _member(self, values: tuple[float, ...]) -> Member:
        theta = np.array(values)
        if np.array_equal(theta, self._nominal):
            return self.given
        return RobotMember(self.family.robot_at(theta), theta, self.motion(theta))

    def with_given_restitution(self, member: Member) -> Member:
        """The member whose motion is that of ``member``, with the restitutions of the model."""
        values = np.append(member.values[: self.moving], self._nominal[self.moving :])
        return self.at(values)

    def motion(self, values: Vector) -> RobotMotion:
        """The motion between impacts of the member with ``values``; only the first matter."""
        return self._motion_at(tuple(values[: self.moving].tolist()))

    def _robot_motion(self, values: tuple[float, ...]) -> RobotMotion:
        theta = np.append(values, self._nominal[self.moving :])
        if np.array_equal(theta, self._nominal):
            return self._given_motion
        return RobotMotion(self.family.robot_at(theta))

    def estimates_restitution(self, contacts: Contacts) -> NDArray[np.bool_]:
        """Whether each of ``contacts`` has a restitution that is estimated, shape (k,)."""
        each = zip(self.family.parameters, self.considered, strict=True)
        estimated = {parameter.name for parameter, considered in each if not considered}
        names = self.family.system.contact_names
        return np.array([f"{RESTITUTION}.{names[i]}" in estimated for i in contacts], np.bool_)

    def _no_sensitivity(self, contacts: Contacts) -> Matrix:
        """Of the gaps of ``contacts`` to the parameters: zero, shape (k, p)."""
        return np.zeros((len(contacts), self.family.size))

    def rate_sensitivity(self, member: Member, closed: Contacts, x: Vector, t: float) -> Matrix:
        """Of ``dx/dt`` to the parameters, shape (2n, p)."""
        robot, tau = cast(Robot, member.system), member.moving.forces(t)[0]
        return rates_by_parameters(robot, x, tau, self.family.names, closed)

    def load_sensitivity(
        self, member: Member, closed: Contacts, contacts: Contacts, x: Vector, t: float
    ) -> Matrix:
        """Of the loads of held ``contacts`` to the parameters, shape (k, p)."""
        robot, tau = cast(Robot, member.system), member.moving.forces(t)[0]
        found = loads_by_parameters(robot, x, tau, self.family.names, closed)
        return np.asarray(found[[closed.index(i) for i in contacts]])

    def motion_sensitivity(
        self, theta: Vector, steps: Vector, *, t: float, x: Vector, s: float, closed: Contacts
    ) -> MotionSensitivity:
        """Of the state ``s`` seconds after ``x`` to the parameters of the motion."""
        del steps
        names = self.family.names[: self.moving]
        return FirstOrder(self.motion(theta).by_parameters(t, x, s, closed, names).T)

    def impact(self, values: Vector, x: Vector, pressed: Contacts) -> tuple[Vector, Matrix]:
        """The state after an impact of ``pressed``, and its derivative by the state."""
        weighs = np.where(self._damps, self._nominal, values)  # an impact takes no time
        return self._jumped(tuple(weighs.tolist()), x.tobytes(), pressed)

    def _jump(
        self, values: tuple[float, ...], state: bytes, pressed: Contacts
    ) -> tuple[Vector, Matrix]:
        x, member = np.frombuffer(state), self.at(np.array(values))
        mirror = member.mirror_about(x, pressed)
        return mirror.landed(x), mirror.J


def members_of(family: ParametricFamily, considered: Sequence[bool]) -> Members:
    """The members of a family of linear systems or of robots."""
    if isinstance(family, RobotFamily):
        return RobotMembers(family, considered)
    return Members(family, considered)
