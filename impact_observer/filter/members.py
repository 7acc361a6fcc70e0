# SPDX-License-Identifier: Apache-2.0
"""The system with other values of the parameters that are estimated, prepared for the filter.

Members that differ only by gaps and restitutions share the motion between impacts.
"""

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache, partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics import (
    KEPT,
    ImpactLaw,
    PositionProjection,
)
from impact_observer.dynamics.equations import balanced
from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.saltation import Measured, Mirror, RestProjection
from impact_observer.kernel._kernel import (
    Family,
    Gaps,
    Impact,
    MotionChange,
    Parameters,
    Sensitivity,
)
from impact_observer.model import System
from impact_observer.model.parametric_family import Coefficients, ParametricFamily
from impact_observer.states import Matrix, Vector

LARGEST = 1e300
"""Instead of bounds that are infinite."""
_LINEAR = {"C", "K", "gap", "rebound", "contact_time", "aside"}
_LINEAR |= {"amplitude", "constant", "cosine", "sine"}
"""Coefficients by which parameters change accelerations, gaps and jumps linearly."""
_LINEARISED = _LINEAR | {"M", "phase", "frequency"}
"""Coefficients by which considered parameters do, linearised about their values."""


class HasTheta(Protocol):
    """An estimate with parameters."""

    @property
    def theta(self) -> Vector: ...  # noqa: D102


class MotionSensitivity(Protocol):
    """How a state after a motion depends on parameters."""

    @property
    def first(self) -> Matrix:
        """Derivatives by the parameters, shape (p, 2n)."""

    def noise(self, root: Matrix, own: Matrix) -> Matrix:
        """What the second order adds to the covariance: a root, shape (2n, any)."""


class Member:
    """One system of a family.

    Attributes:
        system: the system.
        values: its parameters, shape (p,).
        moving: its motion between impacts.
        masses: the impact law of a system with the same masses.
    """

    def __init__(
        self,
        system: System,
        values: Vector,
        moving: MovingSystem,
        masses: ImpactLaw,
        numbers: Coefficients,
    ) -> None:
        """A system whose motion between impacts is ``moving``; ``numbers`` are of ``values``.

        ``masses`` is the impact law of one that has the same masses.
        """
        self.system = system
        self._numbers = numbers
        self.values = values
        self.moving = moving
        self.masses = masses
        self._gaps = lru_cache(KEPT)(partial(Measured.gaps, system))
        self._guard = lru_cache(KEPT)(self._guard_of)
        self.mirror = lru_cache(KEPT)(self._mirror_of)

    def near(self, x: Vector) -> System:
        """The system at a state ``x``, shape (2n,): a linear one is the same at all states."""
        del x
        return self.system

    def gaps(self, contacts: Contacts, x: Vector) -> Measured:
        """The gaps of ``contacts`` near a state ``x``, shape (2n,)."""
        del x
        return self._gaps(contacts)

    def speeds(self, contacts: Contacts, x: Vector) -> Measured:
        """The contact speeds of ``contacts`` near a state ``x``, shape (2n,)."""
        del x
        return Measured.speeds(self.system, contacts)

    def guard(
        self, before: Contacts, contacts: Contacts, t: float, x: Vector, *, hit: bool
    ) -> Measured:
        """Gaps of contacts that hit, or loads of those that open, in the phase ``before``.

        Near a state ``x``, shape (2n,), at ``t``, s since the epoch.
        """
        del t, x
        return self._guard(before, contacts, hit)

    def pressed(self, change: ContactChange, x: Vector) -> Contacts:
        """The contacts that take an impulse at an event, before which the state is ``x``."""
        if not change.hit or len(change.active) == 1:
            return change.hit
        n = self.system.n
        gamma = self.gaps(change.hit, x).c[:, :n].dot(x[n:])
        return change.pressed(self.newton, gamma)

    def stopped(self, x: Vector, closed: Contacts, gap_sensitivity: Matrix) -> RestProjection:
        """A state ``x``, nearly at rest on ``closed`` contacts, projected onto rest on them.

        The projection is that by which the plant itself comes to rest.
        """
        n, W, projection = self.system.n, self.system.W[:, list(closed)].T, self.projection
        x, Z = self.moving.phases.stopped(x, closed, projection), projection.jump(closed)
        still = self.moving.phase(closed).inverse @ self.system.M
        sensitivity = np.zeros((2 * n, gap_sensitivity.shape[1]))
        sensitivity[:n] = -Z @ gap_sensitivity
        return RestProjection(x, linalg.block_diag(np.eye(n) - Z @ W, still), sensitivity)

    @cached_property
    def newton(self) -> ImpactLaw:
        """Its impact law."""
        own = self.moving.system is self.system
        return self.moving.newton if own else ImpactLaw(self.system)

    @cached_property
    def projection(self) -> PositionProjection:
        """Its position projection."""
        own = self.moving.system is self.system
        return self.moving.phases.projection if own else PositionProjection(self.system)

    def mirror_about(self, x: Vector, pressed: Contacts) -> Mirror:
        """The jump of states near ``x``, (q-, u-), in which ``pressed`` take part."""
        if self.system.is_plain(pressed):
            return self.mirror(pressed)
        return _mirror_about(self.masses, self._numbers, x, pressed)

    def jump_root(self, before: Vector, after: Vector) -> Matrix | None:
        """A root of the covariance of an error as large as a jump, shape (2n, n).

        None: no sample tells the errors of the jumps of a linear system. The states ``before`` and
        ``after`` the hit have shape (2n,).
        """
        del before, after
        return None

    def bends(self, x: Vector, root: Matrix, pressed: Contacts) -> Matrix:
        """What the curvature of rebound laws adds to the error of a jump, (2n, k).

        Its root mean square where speeds have the deviations of ``root``, shape (2n, any), about
        those of ``x``.
        """
        n, bent = self.system.n, [i for i in pressed if not self.system.rebounds[i].is_affine]
        found = np.zeros((2 * n, len(bent)))
        stops = self.masses.stops(pressed) if bent else found
        for k, i in enumerate(bent):
            row = self.system.W[:, i]
            speed, seen = float(row.dot(x[n:])), row.dot(root[n:])
            bend = self._numbers.law(self.system, i).bend(speed, math.sqrt(seen.dot(seen)))
            found[n:, k] = bend * stops[:, pressed.index(i)]
        return found

    def _guard_of(self, before: Contacts, contacts: Contacts, hit: bool) -> Measured:
        """Gaps of contacts that hit, or loads of those that open, in the phase ``before``."""
        return self._gaps(contacts) if hit else Measured.loads(self.moving.phase(before), contacts)

    def _mirror_of(self, pressed: Contacts) -> Mirror:
        J = self.masses.jump(pressed, self._numbers.eps)
        return Mirror.of(self.system, J, pressed, self._numbers)


def _mirror_about(
    newton: ImpactLaw, numbers: Coefficients, x: Vector, pressed: Contacts
) -> Mirror:
    """The jump of states near ``x`` where some restitution is not a constant.

    The speeds jump by ``r(gamma)`` and its slope, the gap that is left by ``eps``. Where ``r`` is
    ``eps gamma``, a jump a little early or late then leaves the positions as they are.
    """
    system, P = newton.system, list(pressed)
    eps, slopes, rebounds = np.zeros((3, system.m))
    gamma = system.W[:, P].T @ x[system.n :]
    for i, speed in zip(P, gamma, strict=True):
        law = numbers.law(system, i)
        eps[i] = law.restitution_at(np.abs(speed))
        slopes[i], rebounds[i] = law.slope(speed), law.rebound(speed)
    mirror = Mirror.of(system, newton.jump(pressed, eps), pressed, numbers)
    J, offset = mirror.J.copy(), mirror.offset.copy()
    n = system.n
    J[n:, n:] += newton.jump(pressed, slopes) - newton.jump(pressed, eps)
    offset[n:] -= newton.stops(pressed) @ (rebounds[P] - slopes[P] * gamma)
    return Mirror(J, offset)


class Members:
    """The members of a family; each is prepared when it is first needed.

    Attributes:
        family: the system and the parameters that are estimated; first those that change the
            motion between impacts.
        given: the member with the parameters of the model.
        moving: how many of the parameters change the motion between impacts.
        considered: which of the parameters have an error, but are not estimated.
        parameters: their bounds, and steps of finite differences by them, for the kernel.
    """

    def __init__(self, family: ParametricFamily, considered: Sequence[bool] = ()) -> None:
        """Prepare the given member; without ``considered`` all parameters are estimated."""
        self.family = family
        self.considered = tuple(considered) or (False,) * family.size
        self.moving = sum(each.moves for each in family.parameters)
        assert all(each.moves for each in family.parameters[: self.moving]), (
            "parameters of the motion come first"
        )
        self._gap = family.gap_changes
        effects = [each.effect for each in family.parameters]
        self._still = [bool(np.any(each.rebound)) for each in effects]
        self._weighs = [bool(np.any(each.effect.M)) for each in family.parameters]
        low, high = (np.clip(each, -LARGEST, LARGEST) for each in family.bounds)
        self.parameters = Parameters(low, high, family.sizes, self.moving, self.considered)
        self.free_impact = lru_cache(KEPT)(self._free_impact)
        self.gap_sensitivity = lru_cache(KEPT)(self._gap_sensitivity)
        self._at = lru_cache(KEPT)(self._member)
        self._moving = lru_cache(KEPT)(self._motion)
        self._mirror = lru_cache(KEPT)(self._mirror_at)
        self._nominal = family.nominal
        self.given = self.at(self._nominal)

    def at(self, values: Vector) -> Member:
        """The member whose parameters are ``values``, shape (p,), all within their bounds."""
        return self._at(tuple(values.tolist()))

    def of_estimate(self, estimate: HasTheta) -> Member:
        """The member with the parameters of an estimate."""
        return self.at(estimate.theta)

    def change(self, estimate: HasTheta) -> Vector:
        """How the parameters of an estimate differ from those of the model, shape (p,)."""
        return np.asarray(estimate.theta - self._nominal)

    def with_given_restitution(self, member: Member) -> Member:
        """``member`` with the restitutions of the model."""
        values = np.where(self._still, self._nominal, member.values)
        return self.at(values) if self.family.size else member

    def motion(self, values: Vector) -> MovingSystem:
        """The motion between impacts of the member with ``values``; only these need bounds."""
        return self._moving(tuple(values[: self.moving].tolist()))

    def motion_sensitivity(
        self, theta: Vector, steps: Vector, *, t: float, x: Vector, s: float, closed: Contacts
    ) -> MotionSensitivity:
        """Of the state ``s`` seconds after ``x`` at ``t`` to the parameters of the motion.

        By differences over ``steps`` about ``theta``, of the parameters that move.
        """

        def at(values: Vector) -> tuple[Vector, Matrix]:
            return self.motion(values).moved(t, x, s, closed)

        return Sensitivity(at, theta[: self.moving], steps)

    def considered_rows(self, first: int) -> list[int]:
        """The rows of the considered parameters in a root whose row ``first`` is the first's."""
        return [first + j for j, each in enumerate(self.considered) if each]

    def estimates_restitution(self, contacts: Contacts) -> NDArray[np.bool_]:
        """Whether each of ``contacts`` has a restitution that is estimated, shape (k,)."""
        changes = [
            np.any(each.effect.rebound, axis=1)
            for each, considered in zip(self.family.parameters, self.considered, strict=True)
            if not considered
        ]
        estimated = np.any(changes, axis=0) if changes else np.zeros(self.family.system.m, bool)
        return np.asarray(estimated[list(contacts)], dtype=np.bool_)

    @cached_property
    def is_linear(self) -> bool:
        """Whether the kernel knows the parameters: accelerations are linear in them.

        Those of considered parameters are linearised.
        """
        rests = self.family.system.frame is None or not self.moving
        return rests and all(
            each.effect.parts.keys() <= (_LINEARISED if considered else _LINEAR)
            for each, considered in zip(self.family.parameters, self.considered, strict=True)
        )

    @cached_property
    def free(self) -> Family:
        """The motions of all members while no contact is closed."""
        moving, system = self.given.moving, self.family.system
        rates, parameters = moving.rates(()), self.family.parameters[: self.moving]
        unit = np.append(balanced(rates.A)[1][: system.n], np.ones(system.n))
        harmonics = self.family.harmonics(self.family.coefficients)[1]
        changes = [
            self._motion_change(each.effect, harmonic, rates.B[system.n :], unit)
            for each, harmonic in zip(parameters, harmonics, strict=False)
        ]
        return Family(moving.free, moving.sizes, self.parameters, self._nominal, changes)

    def _motion_change(
        self, effect: Coefficients, harmonic: NDArray[np.complex128], inverse: Matrix, unit: Vector
    ) -> MotionChange:
        """What a unit of a parameter adds to the accelerations, to first order.

        Args:
            effect: of the parameter on the coefficients.
            harmonic: on the amplitudes of the harmonic forces, shape (h, n), N.
            inverse: of the mass matrix.
            unit: of the components of a state, in which the bound of the rates is taken, (2n,).
        """
        system, forcing = self.family.system, self.family.system.forcing
        by_mass = -inverse @ effect.M @ inverse
        lower = by_mass @ np.hstack([-system.K, -system.C])
        lower -= inverse @ np.hstack([effect.K, effect.C])
        return MotionChange(
            lower,
            by_mass @ forcing.constant + inverse @ effect.constant,
            effect.frequency,
            forcing.cosine @ by_mass.T + harmonic.real @ inverse.T,
            forcing.sine @ by_mass.T - harmonic.imag @ inverse.T,
            max(float(np.linalg.norm(lower / unit, 1)), *np.abs(effect.frequency), 0.0),
        )

    def _free_impact(self, contact: int) -> Impact:
        """An impact of one contact while none is closed."""
        effects = [each.effect for each in self.family.parameters]
        eps = np.array([each.eps[contact] for each in effects])
        lags = np.array([each.contact_time[contact] / 2 for each in effects])
        newton, system = self.given.newton, self.family.system
        w, kick, stop = system.W[:, contact], newton.kick(contact), newton.stops((contact,))[:, 0]
        inverse = self.given.moving.rates(()).B[system.n :]
        pushed = np.array([inverse @ each.M @ stop for each in effects]).reshape(-1, system.n)
        by_mass = (np.outer(pushed @ w, stop) - pushed) * float(w @ kick)
        aside = np.array([each.aside[contact] for each in effects]).reshape(-1, system.n)
        aside = aside @ inverse / float(w @ inverse @ w)
        return Impact(
            self.free,
            w,
            -kick,
            float(system.q_r[contact]),
            -np.outer(eps, stop) - by_mass - aside,
            self._gap[:, contact],
            lags,
        )

    @cached_property
    def free_gaps(self) -> Gaps:
        """All gaps while no contact is closed."""
        system = self.family.system
        return Gaps(self.free, system.W.T, system.q_r, self._gap)

    def _gap_sensitivity(self, contacts: Contacts) -> Matrix:
        return np.asarray(self._gap[:, list(contacts)].T)

    def rate_sensitivity(self, member: Member, closed: Contacts, x: Vector, t: float) -> Matrix:
        """Of ``dx/dt`` to the parameters, shape (2n, p)."""
        forces = self._force_sensitivity(member, closed, x, t)
        return np.asarray(member.moving.rates_at(t, x, closed).B @ forces)

    def load_sensitivity(
        self, member: Member, closed: Contacts, contacts: Contacts, x: Vector, t: float
    ) -> Matrix:
        """Of the loads of held ``contacts`` to the parameters, shape (k, p)."""
        phase = member.moving.phase(closed)
        loads = phase.loads[[phase.held.index(i) for i in contacts]]
        return np.asarray(-loads @ self._force_sensitivity(member, closed, x, t))

    def impact(self, values: Vector, x: Vector, pressed: Contacts) -> tuple[Vector, Matrix]:
        """The state after an impact of ``pressed``, and its derivative by the state."""
        key = tuple(values.tolist())
        if self.family.system.is_plain(pressed):
            mirror = self._mirror(key, pressed)
        else:
            moving, numbers = self._heavy(key)
            mirror = _mirror_about(moving.newton, numbers, x, pressed)
        return mirror.landed(x), mirror.J

    def _heavy(self, values: tuple[float, ...]) -> tuple[MovingSystem, Coefficients]:
        """The model's motion with the masses of a member, and its coefficients."""
        theta, weighed = np.array(values), self._nominal
        if any(self._weighs):
            weighed = np.where(self._weighs, theta, weighed)
        return self.motion(weighed), self.family.coefficients_at(theta)

    def _mirror_at(self, values: tuple[float, ...], pressed: Contacts) -> Mirror:
        heavy, numbers = self._heavy(values)
        J = heavy.newton.jump(pressed, numbers.eps)
        return Mirror.of(heavy.system, J, pressed, numbers)

    def _force_sensitivity(self, member: Member, closed: Contacts, x: Vector, t: float) -> Matrix:
        """Of the forces that accelerate the masses to the parameters, shape (n, p)."""
        n, moving = self.family.system.n, member.moving
        rates = moving.rates_at(t, x, closed)
        acceleration = rates.along(x, member.moving.forces(t))[0][n:]
        forces = self.family.force_changes(member.values, t).T
        for j, each in enumerate(self.family.parameters[: self.moving]):
            effect = each.effect
            forces[:, j] -= effect.K @ x[:n] + effect.C @ x[n:] + effect.M @ acceleration
        return np.asarray(forces)

    def _member(self, values: tuple[float, ...]) -> Member:
        theta, moving = np.array(values), self._moving(values[: self.moving])
        same = np.array_equal(theta[self.moving :], self._nominal[self.moving :])
        system = moving.system if same else self.family.near(theta)
        heavy, numbers = self._heavy(values)
        return Member(system, theta, moving, heavy.newton, numbers)

    def _motion(self, values: tuple[float, ...]) -> MovingSystem:
        """The motion with the first parameters at ``values``, the others as given."""
        theta = np.array(self._nominal)
        theta[: self.moving] = values
        if np.array_equal(theta, self._nominal):
            return MovingSystem(self.family.system)
        given = None if any(self._weighs) else self.motion(self._nominal).phase(()).inverse
        return MovingSystem(self.family.near(theta), given)
