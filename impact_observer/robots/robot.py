# SPDX-License-Identifier: Apache-2.0
"""A robot: its equations of motion, its contacts, and the derivatives that a filter needs.

``M(q) u' + C(q, u) u + h(q) + D u = tau + W(q) lambda``, ``q' = u``, with n joints and m contacts
``g_i(q) = n_i . p_i(q) - o_i >= 0``, ``W_i = J_i' n_i``. States are ``x = (q, u)``, shape (2n,).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from impact_observer.dynamics.contact.complementarity import complementary
from impact_observer.errors import ImpactLawError, ModelError, UsageError
from impact_observer.events import Contacts
from impact_observer.model import Model, System
from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import LiveNames
from impact_observer.model.live_signals import LiveSamples, LiveSignals
from impact_observer.model.model_file import ModelSource, model_of
from impact_observer.model.robot_description import RobotDescription
from impact_observer.model.system import checked_parts, per_second
from impact_observer.robots.held_torques import HeldTorques
from impact_observer.robots.pinocchio_model import imported_pinocchio, pinocchio_model
from impact_observer.states import Matrix, Vector, frozen

_STEP = 6e-6
"""Step of central differences, rad or m, rad/s or m/s: the cube root of the rounding error."""
_INSIDE = 1e-12
"""Largest gap that counts as rounding, relative to the terms of the gap."""
_NOISE = 1e-14
"""Contact speed of several contacts that is rounding, relative to that of all kinetic energy."""
_EIGENVALUE = 1e-12
"""Negative eigenvalue of ``G - E G E`` that is rounding, ``G`` having a unit diagonal."""
_NEWTON_STEPS = 8
"""Most Newton steps of a projection."""
_ON_PLANE = 1e-16
"""Gap that counts as zero after a projection, relative to the scale of the gap."""
_SINGULAR = 1e-12
"""Least eigenvalue of a mass matrix with a unit diagonal."""


class Robot:
    """A robot whose root is fixed, with n joints of one coordinate each and m contacts.

    Arguments ``q`` and ``u`` are coordinates and velocities, shape (n,), rad or m and rad/s or
    m/s; ``tau`` torques and forces of the joints, shape (n,), N m or N; ``contacts`` and
    ``closed`` indices of contacts. Joints are in the order of the model file. An object has
    memory of its own for pinocchio, so threads need a robot each.

    Attributes:
        description: the model file's contents.
        n: number of joints.
        m: number of contacts.
        name: name of the model.
        coordinates: names of the joints, as in ``JointState``.
        contact_names: names of the contacts.
        units: units of the coordinates, ``rad`` or ``m``.
        speed_units: units of the velocities.
        turns: whether each joint is continuous, so that its encoder may count modulo a turn,
            shape (n,).
        lower: least coordinates by the URDF, shape (n,); minus infinity without a limit.
        upper: largest coordinates by the URDF, shape (n,); infinity without a limit.
        fastest: largest speeds by the URDF, shape (n,); infinity without a limit.
        strongest: largest torques and forces by the URDF, shape (n,); infinity without a limit.
        damping: ``D``, shape (n,), N m s/rad or N s/m.
        eps: nominal restitution coefficients, shape (m,).
        forcing: torques and forces of the drives, N m or N: those of the plant, or as measured.
    """

    def __init__(self, description: RobotDescription | ModelSource) -> None:
        """Prepare the equations of motion.

        ``description`` may be a model, or the path of a model file.

        Raises:
            UsageError: pinocchio is not installed, the URDF has not come from its topic, or the
                model is no robot.
            ModelError: the model file is wrong, or the URDF makes no robot that can move.
        """
        if not isinstance(description, RobotDescription):
            model = model_of(description, "Robot")
            if model.robot is None:
                raise UsageError(
                    f"Robot: the linear model {model.system.name} found; expected a model file"
                    " with the key urdf"
                )
            description = model.robot
        self._pin = pin = imported_pinocchio()
        self.description = description
        joints = description.urdf_joints
        self.name = description.name
        self.coordinates = description.joints
        self.contact_names = description.contact_names
        self.n, self.m = len(self.coordinates), len(self.contact_names)
        self.units = description.units
        self.speed_units = tuple(map(per_second, self.units))
        self.turns = np.array([each.type == "continuous" for each in joints])
        self.lower = frozen([each.lower for each in joints])
        self.upper = frozen([each.upper for each in joints])
        self.fastest = frozen([each.velocity for each in joints])
        self.strongest = frozen([each.effort for each in joints])
        self.damping = description.damping
        self.rebounds = tuple(each.rebound for each in description.contacts)
        self._special = {i for i, law in enumerate(self.rebounds) if not law.is_plain}
        self.eps = frozen([law.nominal for law in self.rebounds])
        self._held: HeldTorques | None = None
        self.forcing = description.forcing
        self._world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        self._model = pinocchio_model(description)
        self._data = self._model.createData()
        ids = [self._model.getJointId(name) for name in self.coordinates]
        place = np.array([self._model.joints[i].idx_v for i in ids])
        self._in = np.argsort(place)  # pinocchio's order from ours
        self._out = place  # ours from pinocchio's
        self._square = np.ix_(place, place)
        pairs = np.meshgrid(place, place)
        self._upper = np.minimum(*pairs), np.maximum(*pairs)  # of a symmetric matrix
        self._frames = [self._model.getFrameId(each.frame) for each in description.contacts]
        self._normals = np.reshape([each.normal for each in description.contacts], (-1, 3))
        self._offsets = np.array([each.offset for each in description.contacts])
        self._all: Contacts = tuple(range(description.m))
        self._check_mass()

    def __reduce__(self) -> tuple[type["Robot"], tuple[RobotDescription]]:
        """Copies and pickles are made of the description."""
        return Robot, (self.description,)

    @property
    def frame(self) -> None:
        """Moving grounds: none."""
        return

    @property
    def unit(self) -> str:
        """Unit of the coordinates, or of the first joint where they differ."""
        return self.units[0]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the components of (q, u)."""
        return (*self.coordinates, *(f"{name}'" for name in self.coordinates))

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of the components of (q, u)."""
        return (*self.units, *self.speed_units)

    @property
    def live(self) -> LiveNames | None:
        """The efforts that arrive live, by joint; None if efforts count as zero."""
        if self.description.forces is None:
            return None
        return LiveNames(self.coordinates, np.eye(self.n))

    @property
    def gap_unit(self) -> str:
        """Unit of the gaps."""
        return "m"

    @property
    def has_encoders(self) -> bool:
        """Whether an observer of it needs its measured positions: yes."""
        return True

    @property
    def remark_on_distance(self) -> str:
        """What a user should know of its V: a robot has no stiffness that could weigh errors."""
        return "is a robot: V = 1/2 du' M du + 1/2 dq' M dq / s^2 at the true q"

    @property
    def plant_inputs(self) -> None:
        """Signals for which a plant waits: none, as it makes its torques."""
        return

    @property
    def depends_on_time(self) -> bool:
        """Whether an observer needs an epoch: where measured torques act."""
        return self.live is not None

    def is_plain(self, contacts: Collection[int]) -> bool:
        """Whether all ``contacts`` rebound by a constant coefficient."""
        return self._special.isdisjoint(contacts)

    def from_frame(self, ns: NDArray[np.int64], x: Matrix) -> Matrix:
        """States (q, u), as planes do not move."""
        del ns
        return x

    def to_frame(self, ns: NDArray[np.int64], x: Matrix) -> Matrix:
        """The inverse of ``from_frame``."""
        del ns
        return x

    def remarks(self, states: Matrix) -> list[str]:
        """Joints that are held, and those whose limits the ``states`` pass, a line each."""
        held = self.description.held_in_words
        passed = [
            f"{name} passes its limits in the URDF, which are no contacts"
            for name in self.passed_limits(states)
        ]
        return [*([held] if held else []), *passed]

    def parts(self) -> NDArray[np.intp]:
        """The part to which each coordinate belongs, (n,): all joints move together."""
        return np.zeros(self.n, dtype=np.intp)

    def with_forcing(self, forcing: Forcing) -> "Robot":
        """The robot under other torques; both share pinocchio's memory."""
        return self._twin(forcing=forcing)

    def under_efforts(self, samples: LiveSamples) -> "Robot":
        """The robot under measured efforts, each held until the next."""
        forcing = replace(self.forcing, sampled=samples)
        return self._twin(forcing=forcing, _held=HeldTorques(samples))

    def with_parameters(self, values: Mapping[str, float]) -> "Robot":
        """The robot with other parameters, by names such as ``restitution.wall``.

        Both share pinocchio's memory unless a rotor inertia differs.

        Raises:
            ModelError: a value is impossible, such as a restitution above 1.
        """
        given = self.description
        other = given.with_parameters(values)
        rebounds = tuple(each.rebound for each in other.contacts)
        changed = {
            "description": other,
            "damping": other.damping,
            "rebounds": rebounds,
            "eps": frozen([law.nominal for law in rebounds]),
        }
        if not np.array_equal(other.rotor_inertia, given.rotor_inertia):
            model = self._model.copy()
            model.armature = other.rotor_inertia[self._in]
            changed |= {"_model": model, "_data": model.createData()}
        return self._twin(**changed)

    def _twin(self, **changed: object) -> "Robot":
        """Another object with the same memory for pinocchio, of which some attributes differ."""
        found = object.__new__(Robot)
        found.__dict__.update(self.__dict__ | changed)
        return found

    @cached_property
    def reach(self) -> Vector:
        """Scale of the gaps: offset, joints one after the other and 1 m, shape (m,), m."""
        sizes = [np.linalg.norm(each.translation) for each in self._model.jointPlacements]
        return frozen(np.abs(self._offsets) + (float(np.sum(sizes)) + 1.0))

    # Motion

    def torques(self, t: float) -> Vector:
        """Torques and forces of the plant's drives at ``t``, s since the epoch, shape (n,)."""
        force: Vector = self.forcing(t)
        return force

    @property
    def has_white_torques(self) -> bool:
        """Whether an observer adds white torques: those of the model, or those of held efforts."""
        given = self.description.torque_deviation
        return self._held is not None if given is None else bool(given.any())

    def white_torques(self, t: float) -> Vector:
        """Deviations of white torques at ``t``, shape (n,), N m sqrt(s) or N sqrt(s)."""
        given = self.description.torque_deviation
        if given is None:
            return np.zeros(self.n) if self._held is None else self._held.deviation(t)
        return given

    def held_force(self, t: float) -> str:
        """A warning if ``t``, s since the epoch, is after the last sample of the torques."""
        return self.forcing.held(t)

    def mass(self, q: Vector) -> Matrix:
        """The mass matrix ``M(q)`` with the rotors, shape (n, n), kg m^2, kg m and kg."""
        M = self._pin.crba(self._model, self._data, q[self._in])
        return np.asarray(M[self._upper])

    def inverse_mass(self, q: Vector) -> Matrix:
        """``M(q)^-1``, shape (n, n)."""
        inverse = self._pin.computeMinverse(self._model, self._data, q[self._in])
        return np.asarray(inverse[self._upper])

    def mobility_matrix(self, q: Vector, closed: Sequence[int] = ()) -> Matrix:
        """Accelerations by torques, (n, n): ``M^-1`` without what ``closed`` contacts prevent."""
        inverse = self.inverse_mass(q)
        if not len(closed):
            return inverse
        W = self.directions(q, closed)
        held = inverse @ W
        return np.asarray(inverse - held @ _least(W.T @ held, held.T))

    def coriolis(self, q: Vector, u: Vector) -> Matrix:
        """``C(q, u)`` of Christoffel's symbols, linear in ``u``, shape (n, n)."""
        C = self._pin.computeCoriolisMatrix(self._model, self._data, q[self._in], u[self._in])
        return np.asarray(C[self._square])

    def rest_torque(self, q: Vector) -> Vector:
        """``h(q)``: the torques that hold the robot at rest against gravity, shape (n,)."""
        h = self._pin.computeGeneralizedGravity(self._model, self._data, q[self._in])
        return np.asarray(h[self._out])

    def kinetic_energy(self, q: Vector, u: Vector) -> float:
        """``u' M(q) u / 2`` with the rotors, J."""
        return float(u @ self.mass(q) @ u) / 2

    def potential_energy(self, q: Vector) -> float:
        """The energy of gravity, J."""
        return float(self._pin.computePotentialEnergy(self._model, self._data, q[self._in]))

    def acceleration(
        self, q: Vector, u: Vector, tau: Vector, closed: Sequence[int] = ()
    ) -> Vector:
        """``u'``, shape (n,); contacts ``closed`` keep their speeds: ``W'u' + W'' u = 0``."""
        tau = tau - self.damping * u
        free = self._pin.aba(self._model, self._data, q[self._in], u[self._in], tau[self._in])
        free = free[self._out]
        if not len(closed):
            return np.asarray(free)
        W, held = self.kicks(q, closed)
        short = W.T @ free + self.bias(q, u, closed)
        return np.asarray(free - held @ _least(W.T @ held, short))

    def loads(self, q: Vector, u: Vector, tau: Vector, closed: Sequence[int]) -> Vector:
        """Forces ``lambda`` of the ``closed`` contacts, shape (len(closed),), N.

        A negative force means that the contact is about to open.
        """
        W, held = self.kicks(q, closed)
        short = W.T @ self.acceleration(q, u, tau) + self.bias(q, u, closed)
        return np.asarray(_least(W.T @ held, -short))

    def acceleration_derivatives(
        self, q: Vector, u: Vector, tau: Vector, closed: Sequence[int] = ()
    ) -> tuple[Matrix, Matrix, Matrix]:
        """Derivatives of ``acceleration`` by ``q``, ``u`` and ``tau``, shape (n, n) each.

        Without ``closed`` contacts they are exact; with them, differences of second order.
        """
        if not len(closed):
            return self._linearised(q, u, tau)[1:]
        n = self.n
        found = _differences(
            lambda at: self.acceleration(at[:n], at[n : 2 * n], at[2 * n :], closed),
            np.concatenate([q, u, tau]),
        )
        by_q, by_u, by_tau = np.hsplit(found, 3)
        return by_q, by_u, by_tau

    def _linearised(
        self, q: Vector, u: Vector, tau: Vector
    ) -> tuple[Vector, Matrix, Matrix, Matrix]:
        """``acceleration`` without closed contacts, and its derivatives."""
        driven = (tau - self.damping * u)[self._in]
        self._pin.computeABADerivatives(self._model, self._data, q[self._in], u[self._in], driven)
        data, inverse = self._data, self._data.Minv[self._upper]
        by_speed = data.ddq_dv[self._square] - inverse * self.damping
        by_place = np.asarray(data.ddq_dq[self._square])
        return np.asarray(data.ddq[self._out]), by_place, by_speed, inverse

    def rates(self, x: Vector, tau: Vector, closed: Sequence[int] = ()) -> Vector:
        """The flow ``F = (u, u')`` in a state ``x``, shape (2n,)."""
        u = x[self.n :]
        return np.concatenate([u, self.acceleration(x[: self.n], u, tau, closed)])

    def rate_derivatives(
        self, x: Vector, tau: Vector, closed: Sequence[int] = ()
    ) -> tuple[Matrix, Matrix]:
        """Derivatives of ``rates`` by ``x``, shape (2n, 2n), and by ``tau``, shape (2n, n)."""
        n = self.n
        by_q, by_u, by_tau = self.acceleration_derivatives(x[:n], x[n:], tau, closed)
        A, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n))
        A[:n, n:] = np.eye(n)
        A[n:, :n], A[n:, n:], B[n:] = by_q, by_u, by_tau
        return A, B

    def advanced(
        self,
        x: Vector,
        tau: Vector,
        seconds: float,
        closed: Contacts = (),
        slope: Vector | None = None,
    ) -> Vector:
        """The state after one Runge-Kutta step of 4th order, shape (2n,).

        The torques are ``tau`` in the middle of the step, and have the constant ``slope``, shape
        (n,), N m/s or N/s; None for zero.
        """
        h = seconds
        rise = 0.0 if slope is None else h / 2 * slope
        one = self.rates(x, tau - rise, closed)
        two = self.rates(x + h / 2 * one, tau, closed)
        three = self.rates(x + h / 2 * two, tau, closed)
        four = self.rates(x + h * three, tau + rise, closed)
        return np.asarray(x + h / 6 * (one + 2 * two + 2 * three + four))

    def advanced_with_derivatives(
        self,
        x: Vector,
        tau: Vector,
        seconds: float,
        closed: Contacts = (),
        *,
        torques: Callable[[Vector, Vector], Matrix] | None = None,
        slope: Vector | None = None,
    ) -> tuple[Vector, Matrix, Matrix]:
        """``advanced``, and its derivatives by ``x``, (2n, 2n), and by parameters, (2n, p).

        The derivatives are those of the Runge-Kutta step itself. ``torques`` gives what a unit of
        each parameter adds to the torques, shape (n, p), by velocities and accelerations; None
        for derivatives by ``tau``. The ``slope`` of the torques is as of ``advanced``.
        """
        h, n, unit = seconds, self.n, np.eye(self.n)
        rise = np.zeros(n) if slope is None else h / 2 * slope
        p = torques(x[n:], x[n:]).shape[1] if torques is not None else n
        first = np.zeros((2 * n, 1 + 2 * n + p))  # the state, and its derivatives
        first[:, 0] = x
        first[:, 1 : 2 * n + 1] = np.eye(2 * n)
        at, total, rates = first, np.zeros_like(first), np.empty_like(first)
        stages = ((1, h / 2, -rise), (2, h / 2, 0.0), (2, h, 0.0), (1, 0.0, rise))
        for weight, ahead, rising in stages:
            q, u, given = at[:n, 0], at[n:, 0], tau + rising
            if closed:
                acceleration = self.acceleration(q, u, given, closed)
                by_q, by_u, by_tau = self.acceleration_derivatives(q, u, given, closed)
            else:
                acceleration, by_q, by_u, by_tau = self._linearised(q, u, given)
            rates[:n] = at[n:]
            rates[n:] = by_q @ at[:n] + by_u @ at[n:]
            added = unit if torques is None else torques(u, acceleration)
            rates[n:, 2 * n + 1 :] += by_tau @ added
            rates[n:, 0] = acceleration
            total += weight * rates
            at = first + ahead * rates
        total = first + h / 6 * total
        return total[:, 0], total[:, 1 : 2 * n + 1], total[:, 2 * n + 1 :]

    # Contacts

    def gaps(self, q: Vector, contacts: Sequence[int] | None = None) -> Vector:
        """Gaps ``g`` of ``contacts``, by default of all, shape (k,), m."""
        which = list(self._all if contacts is None else contacts)
        self._pin.forwardKinematics(self._model, self._data, q[self._in])
        return np.array([self._placed_gap(i) for i in which])

    def _placed_gap(self, contact: int) -> float:
        """The gap of a contact where the joints are placed already, m."""
        point = self._pin.updateFramePlacement(self._model, self._data, self._frames[contact])
        return float(self._normals[contact].dot(point.translation) - self._offsets[contact])

    def gaps_at(self, ns: NDArray[np.int64], states: Matrix) -> Matrix:
        """Gaps in ``states`` (q, u), (samples, 2n), at ``ns`` since the epoch, (samples, m)."""
        del ns  # planes do not move
        return np.array([self.gaps(x[: self.n]) for x in states]).reshape(len(states), self.m)

    def directions(self, q: Vector, contacts: Sequence[int] | None = None) -> Matrix:
        """``W(q)``: gradients of the gaps of ``contacts``, by default of all, shape (n, k)."""
        return self.gaps_and_directions(q, contacts)[1]

    def gaps_and_directions(
        self, q: Vector, contacts: Sequence[int] | None = None
    ) -> tuple[Vector, Matrix]:
        """``gaps``, shape (k,), m, and ``directions``, shape (n, k), in the time of these."""
        which = list(self._all if contacts is None else contacts)
        pin, model, data = self._pin, self._model, self._data
        pin.computeJointJacobians(model, data, q[self._in])
        g, W = np.empty(len(which)), np.empty((self.n, len(which)))
        for k, i in enumerate(which):
            g[k] = self._placed_gap(i)
            J = pin.getFrameJacobian(model, data, self._frames[i], self._world)
            W[:, k] = (self._normals[i] @ J.reshape(6, -1)[:3])[self._out]  # a vector for n = 1
        return g, W

    def kicks(self, q: Vector, contacts: Sequence[int] | None = None) -> tuple[Matrix, Matrix]:
        """``W`` and ``M^-1 W`` of ``contacts``, by default of all, shape (n, k) each.

        A column of the second has the velocities that a unit impulse of a contact adds.
        """
        W = self.directions(q, contacts)
        return W, self.inverse_mass(q) @ W

    def mobility(self, q: Vector) -> Vector:
        """``diag(W' M^-1 W)`` of all contacts, shape (m,), 1/kg."""
        W, held = self.kicks(q)
        return np.asarray(np.einsum("ik,ik->k", W, held))

    def contact_speeds(self, x: Vector) -> Vector:
        """``gamma = W(q)'u`` of all contacts in a state ``x``, shape (m,), m/s."""
        return np.asarray(self.directions(x[: self.n]).T @ x[self.n :])

    def bias(self, q: Vector, u: Vector, contacts: Sequence[int] | None = None) -> Vector:
        """``dW/dt'u``: accelerations of gaps where joints do not accelerate, (k,), m/s^2."""
        which = list(self._all if contacts is None else contacts)
        pin, model, data = self._pin, self._model, self._data
        pin.forwardKinematics(model, data, q[self._in], u[self._in], np.zeros(self.n))
        return np.array(
            [
                self._normals[i].dot(
                    pin.getFrameClassicalAcceleration(
                        model, data, self._frames[i], self._world
                    ).linear
                )
                for i in which
            ]
        )

    def speed_gradients(
        self, q: Vector, u: Vector, contacts: Sequence[int] | None = None
    ) -> Matrix:
        """Derivatives of ``gamma`` by ``q``, shape (n, k); those by ``u`` are ``directions``."""
        which = list(self._all if contacts is None else contacts)
        pin, model, data = self._pin, self._model, self._data
        pin.computeForwardKinematicsDerivatives(
            model, data, q[self._in], u[self._in], np.zeros(self.n)
        )
        found = np.empty((self.n, len(which)))
        for k, i in enumerate(which):
            frame = self._frames[i]
            local, J = pin.getFrameVelocityDerivatives(
                model, data, frame, pin.ReferenceFrame.LOCAL
            )
            R = pin.updateFramePlacement(model, data, frame).rotation
            normal = self._normals[i] @ R  # in the frame, which turns with the joints
            speed = pin.getFrameVelocity(model, data, frame, pin.ReferenceFrame.LOCAL).linear
            (a, b, c), (d, e, f) = speed.tolist(), normal.tolist()
            aside = np.array([b * f - c * e, c * d - a * f, a * e - b * d])  # speed x normal
            rows = normal @ local.reshape(6, -1)[:3] + aside @ J.reshape(6, -1)[3:]
            found[:, k] = rows[self._out]
        return found

    def closed_at(self, q: Vector) -> Contacts:
        """Indices of the contacts with ``g <= 0`` but for rounding."""
        return tuple(np.flatnonzero(self.gaps(q) <= _INSIDE * self.reach).tolist())

    def penetrated(self, q: Vector) -> Contacts:
        """Indices of the contacts with ``g < 0`` by more than rounding."""
        return tuple(np.flatnonzero(self.gaps(q) < -_INSIDE * self.reach).tolist())

    def projected(self, q: Vector, contacts: Sequence[int]) -> Vector:
        """The nearest ``q`` in the metric of ``M`` with ``g = 0`` on ``contacts``, shape (n,)."""
        for _ in range(_NEWTON_STEPS):
            g = self.gaps(q, contacts)
            if np.all(np.abs(g) <= _ON_PLANE * self.reach[list(contacts)]):
                break
            W, held = self.kicks(q, contacts)
            q = q - held @ _least(W.T @ held, g)
        return q

    def stopped(self, q: Vector, u: Vector, contacts: Sequence[int]) -> Vector:
        """The nearest ``u`` in the metric of ``M`` with ``gamma = 0`` on ``contacts``, (n,)."""
        if not len(contacts):
            return u
        W, held = self.kicks(q, contacts)
        return np.asarray(u - held @ _least(W.T @ held, W.T @ u))

    # Impacts

    def velocity_after(
        self, q: Vector, u: Vector, active: Sequence[int], *, plastic: bool = False
    ) -> Vector:
        """Velocities after Newton's law on the ``active`` contacts, shape (n,).

        ``plastic`` contacts have no restitution. The result is ``u`` if all contacts separate.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        impact = self._impact(q, u, active, plastic=plastic)
        if impact is None:
            return u
        held, impulses = impact
        return np.asarray(u + held @ impulses)

    def pushed(self, q: Vector, u: Vector, active: Sequence[int]) -> Contacts:
        """Those of the ``active`` contacts that take an impulse in an impact, as indices.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        impact = self._impact(q, u, active, plastic=False)
        if impact is None:
            return ()
        return tuple(i for i, push in zip(active, impact[1].tolist(), strict=True) if push > 0)

    def jumped(self, x: Vector, pushed: Sequence[int]) -> Vector:
        """``R(x)``: the state after an impact in which exactly ``pushed`` contacts take part.

        Impulses of either sign count, so the function is smooth in ``x``.
        """
        n = self.n
        q, u = x[:n], x[n:]
        W, held = self.kicks(q, pushed)
        lost = self._lost(W.T @ u, pushed)
        return np.concatenate([q, u - held @ _least(W.T @ held, lost)])

    def jump_derivatives(self, x: Vector, pushed: Sequence[int]) -> Matrix:
        """``D_x R`` of ``jumped``, shape (2n, 2n)."""
        pin, model, data, n = self._pin, self._model, self._data, self.n
        q, u = x[:n], x[n:]
        W, free = self.directions(q, pushed), self.inverse_mass(q)
        held = free @ W
        G, gamma = W.T @ held, W.T @ u
        slopes = [self.rebounds[i].slope(g) for i, g in zip(pushed, gamma, strict=True)]
        rise = 1.0 + np.array(slopes)
        impulses = _least(G, -self._lost(gamma, pushed))
        change = held @ impulses
        # by q: of M change = W impulses, and of W' change = -lost
        turned = np.array([self.speed_gradients(q, unit, pushed) @ impulses for unit in np.eye(n)])
        zero, moved = np.zeros(n), change[self._in]
        with_weight, _, _ = pin.computeRNEADerivatives(model, data, q[self._in], zero, moved)
        with_weight = np.array(with_weight)  # the next call uses the same memory
        weight = pin.computeGeneralizedGravityDerivatives(model, data, q[self._in])
        forces = turned - (with_weight - weight).reshape(n, n)[self._square]
        speeds = -self.speed_gradients(q, change, pushed).T
        speeds -= rise[:, None] * self.speed_gradients(q, u, pushed).T
        X = np.eye(2 * n)
        X[n:, :n] = free @ forces + held @ _least(G, speeds - held.T @ forces)
        X[n:, n:] -= held @ _least(G, rise[:, None] * W.T)
        return X

    def jump_by_restitution(self, x: Vector, pushed: Sequence[int]) -> Matrix:
        """Derivatives of ``jumped`` by the first parameter of each rebound law, (2n, k)."""
        n = self.n
        W, held = self.kicks(x[:n], pushed)
        gamma = W.T @ x[n:]
        lost = np.diag(
            [self.rebounds[i].sensitivity(g)[0] for i, g in zip(pushed, gamma, strict=True)]
        )
        return np.vstack([np.zeros((n, len(pushed))), -held @ _least(W.T @ held, lost)])

    def is_nonexpansive(self, q: Vector, contacts: Sequence[int]) -> bool:
        """Whether ``G - E G E >= 0`` on ``contacts`` at ``q``: then no impact raises V.

        Where the slope of a rebound law is not constant, this is known of one contact only.
        """
        if not all(self.rebounds[i].is_affine for i in contacts):
            return len(contacts) == 1 and self.rebounds[contacts[0]].is_nonexpansive
        W, held = self.kicks(q, contacts)
        G = W.T @ held
        size = np.sqrt(np.diag(G))
        G, eps = G / np.outer(size, size), self.eps[list(contacts)]
        if np.all(eps == eps[:1]):
            return True
        return bool(linalg.eigvalsh(G - np.outer(eps, eps) * G)[0] >= -_EIGENVALUE)

    # Checks

    def checked_state(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """``position`` and ``velocity`` as read-only arrays of shape (n,).

        Raises:
            UsageError: a wrong number of values, or one that is not finite.
        """
        return checked_parts(self.n, position, velocity)

    def checked_start(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """The initial state of a plant, outside all planes.

        Raises:
            UsageError: a wrong number of values, one that is not finite, or a plane penetrated.
        """
        q, u = self.checked_state(position, velocity)
        if problem := self.in_plane(q):
            raise UsageError(f"{self.name}: position: {problem}")
        return q, u

    def in_plane(self, q: Vector) -> str:
        """In which plane ``q`` is, and the remedy; empty for none."""
        for i in self.penetrated(q):
            return (
                f"is inside the plane of {self.contact_names[i]!r} (gap {self.gaps(q)[i]:g} m);"
                f" expected gap >= 0: start on its free side, or see normal and offset of"
                f" contacts[{i}]"
            )
        return ""

    def beyond_limits(self, q: Vector) -> tuple[int, ...]:
        """Indices of the joints whose limits in the URDF do not contain ``q``."""
        return tuple(np.flatnonzero((q < self.lower) | (q > self.upper)).tolist())

    def passed_limits(self, states: Matrix) -> list[str]:
        """Names of the joints whose limits some of the ``states``, shape (samples, 2n), pass."""
        q = states[:, : self.n]
        passed = np.any((q < self.lower) | (q > self.upper), axis=0)
        return [self.coordinates[i] for i in np.flatnonzero(passed)]

    def _check_mass(self) -> None:
        M = self.mass(np.zeros(self.n))
        diagonal = np.diag(M)
        for i in np.flatnonzero(~(diagonal > 0)):
            raise ModelError(
                "urdf",
                f"{self.description.origin}: joint {self.coordinates[i]!r} moves no mass; expected"
                " an inertial of its link, or rotor_inertia",
            )
        size = np.sqrt(diagonal)
        if np.linalg.eigvalsh(M / np.outer(size, size))[0] < _SINGULAR:
            raise ModelError(
                "urdf",
                f"{self.description.origin}: the mass matrix is singular; expected an inertia of"
                " each link, or rotor_inertia",
            )

    def _lost(self, gamma: Vector, contacts: Sequence[int]) -> Vector:
        """``gamma + r(gamma)`` of ``contacts``, shape (k,), m/s."""
        lost = (1.0 + self.eps[list(contacts)]) * gamma
        for k, i in enumerate(contacts if self._special else ()):
            if i in self._special:
                lost[k] = gamma[k] + float(self.rebounds[i].rebound(gamma[k]))
        return np.asarray(lost)

    def _impact(
        self, q: Vector, u: Vector, active: Sequence[int], *, plastic: bool
    ) -> tuple[Matrix, Vector] | None:
        """``M^-1 W`` and impulses of Newton's law; None where nothing is hit."""
        W, held = self.kicks(q, active)
        gamma = W.T @ u
        if len(active) > 1:
            energy = float(u @ self.mass(q) @ u)
            noise = _NOISE * np.sqrt(energy * np.einsum("ik,ik->k", W, held))
            gamma[np.abs(gamma) <= noise] = 0.0
        lost = gamma if plastic else self._lost(gamma, active)
        if not np.any(lost < 0):
            return None
        if len(active) == 1:
            return held, -lost / W[:, 0].dot(held[:, 0])
        root = np.linalg.cholesky(self.inverse_mass(q))
        impulses = complementary(root.T @ W, lost)
        if impulses is None:
            names = [self.contact_names[i] for i in active]
            raise ImpactLawError.for_contacts(
                names, "Newton's impact law has no solution", gamma, self.eps[list(active)]
            )
        return held, impulses


def _differences(function: Callable[[Vector], Vector], at: Vector) -> Matrix:
    """Derivatives of a ``function`` by central differences, shape (values, arguments)."""
    steps = _STEP * np.eye(at.size)
    return np.column_stack([(function(at + h) - function(at - h)) / (2 * _STEP) for h in steps])


def _least(G: Matrix, b: Matrix) -> Matrix:
    """The least solution of ``G y = b``; ``G`` is singular where contacts depend on each other."""
    return np.asarray(b / G[0, 0] if len(G) == 1 else linalg.lstsq(G, b)[0])


def robot_of(model: Model) -> Robot:
    """The robot of a ``model``.

    Raises:
        UsageError: pinocchio is not installed, or the URDF has not come from its topic.
        ModelError: the URDF makes no robot that can move, or the initial state is inside a plane;
            the error names the model file.
    """
    assert model.robot is not None, "a robot"
    try:
        robot = Robot(model.robot)
        if model.position is not None and (problem := robot.in_plane(model.position)):
            raise ModelError("initial_state.position", problem)
    except ModelError as error:
        raise error.in_file(model.source) from None
    return robot


def observed(model: Model) -> Robot:
    """The robot of a ``model`` for an observer: no torques act but those that are measured.

    Raises:
        UsageError, ModelError: as ``robot_of``.
    """
    robot = robot_of(model)
    return robot.with_forcing(Forcing.none(robot.n))


def connected_robot(robot: Robot) -> tuple[Robot, LiveSignals | None]:
    """The ``robot`` under the efforts of new live signals; None where none are measured."""
    if robot.live is None:
        return robot, None
    signals = LiveSignals(cast(System, robot), causal=False)
    return robot.under_efforts(signals.samples), signals
