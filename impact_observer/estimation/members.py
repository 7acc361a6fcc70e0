"""Systems that differ by the parameters that are learnt, as a filter needs each of them.

What only moves stops or throws back otherwise shares the motion between impacts.
"""

from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics import KEPT, ImpactLaw, Phase, Phases, PositionProjection
from impact_observer.estimation.parametric import Map
from impact_observer.estimation.saltation import Jet, Measured, Mirror, StateRates
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

_FAR = 0.5
"""How far towards a bound a step of the motion's parameters may go."""
_STEP = 1e-6
"""Least step by which a parameter is moved to see what it does, relative to its size."""
_ROOM = 1e-3
"""What a parameter of the motion keeps from its bound, relative to its size."""


class MovingSystem:
    """One system between its impacts.

    Attributes:
        system: what moves; where its stops are does not matter here.
        phases: its linear phases.
    """

    def __init__(self, system: System) -> None:
        """Prepare the phases, each when it is needed."""
        self.system = system
        self.phases = Phases(system)
        self.phase = lru_cache(KEPT)(self._phase_of)
        self.rates = lru_cache(KEPT)(self._rates_of)
        self.forces = lru_cache(KEPT)(system.forcing.jet(2))
        """f, df/dt and the next derivative at an instant, shape (3, n)."""

    @cached_property
    def newton(self) -> ImpactLaw:
        """The impact law with its masses."""
        return ImpactLaw(self.system)

    def moved(self, t: float, x: Vector, s: float, closed: Contacts) -> Map:
        """How states go on from ``t`` (s since the epoch), or back for ``s < 0``, seen at ``x``.

        How far back the forcing is known is for the caller to see to.
        """
        return Map(*self.phase(closed).moved(t, x, s))

    def _phase_of(self, closed: Contacts) -> Phase:
        return self.phases.phase(self.phases.independent(closed))

    def _rates_of(self, closed: Contacts) -> StateRates:
        return StateRates(self.phase(closed))


class WatchedRows(NamedTuple):
    """What is zero at an event.

    Attributes:
        rows: it.
        jet: it, while the phase before the event lasts.
    """

    rows: Measured
    jet: Jet


class Member:
    """One system of a family.

    Attributes:
        system: it.
        values: its parameters, shape (p,).
        moving: how it moves between impacts.
        newton: its impact law.
    """

    def __init__(self, system: System, values: Vector, moving: MovingSystem) -> None:
        """Share how ``moving`` moves."""
        self.system = system
        self.values = values
        self.moving = moving
        self.newton = moving.newton if moving.system is system else ImpactLaw(system)
        self.gaps = lru_cache(KEPT)(partial(Measured.gaps, system))
        self.watched = lru_cache(KEPT)(self._watched_of)
        self.mirror = lru_cache(KEPT)(self._mirror_of)
        self.jump = lru_cache(KEPT)(self._jump_of)

    @cached_property
    def projection(self) -> PositionProjection:
        """Its position jumps."""
        own = self.moving.system is self.system
        return self.moving.phases.projection if own else PositionProjection(self.system)

    def _watched_of(self, before: Contacts, contacts: Contacts, hit: bool) -> WatchedRows:
        """What is zero at an event: the gaps of those that hit, or the load of one that opens."""
        moving = self.moving
        rows = self.gaps(contacts) if hit else Measured.loads(moving.phase(before), contacts)
        return WatchedRows(rows, rows.along(moving.rates(before)))

    def _mirror_of(self, pressed: Contacts) -> Mirror:
        return Mirror.of(self.system, self.newton.jump(pressed), pressed)

    def _jump_of(self, pressed: Contacts, before: Contacts, closed: Contacts) -> Jet:
        """The jump at an impact between phases in which ``before`` and ``closed`` are closed."""
        return self.mirror(pressed).between(self.moving.rates(before), self.moving.rates(closed))


class Members:
    """The family of a system, member by member.

    Attributes:
        family: what is learnt; none of its parameters changes the motion between impacts after
            one that does not.
        given: the member that the model says.
        moving: how many of the parameters change the motion between impacts.
        low: least that each parameter may be, shape (p,).
        high: most, shape (p,).
    """

    def __init__(self, family: ParametricFamily) -> None:
        """Prepare nothing but the given member."""
        self.family = family
        self.moving = sum(each.moves for each in family.parameters)
        assert all(each.moves for each in family.parameters[: self.moving]), "an order"
        self._gap = np.array([each.effect.gap for each in family.parameters])
        self._gap = self._gap.reshape(family.size, family.system.m)
        self._still = [bool(np.any(each.effect.eps)) for each in family.parameters]
        self._weighs = [bool(np.any(each.effect.M)) for each in family.parameters]
        keeps = np.where([each.moves for each in family.parameters], _ROOM * family.sizes, 0.0)
        low, high = family.bounds
        self.low, self.high = low + keeps, high - keeps
        self.gap_rows = lru_cache(KEPT)(self._gap_rows)
        self._at = lru_cache(KEPT)(self._member)
        self._moving = lru_cache(KEPT)(self._motion)
        self.given = self.at(family.nominal)

    def at(self, values: Vector) -> Member:
        """The member whose parameters are ``values``, shape (p,), all within their bounds."""
        return self._at(tuple(values.tolist()))

    def unmoved(self, member: Member) -> Member:
        """One that differs from ``member`` by restitutions only: the given ones."""
        values = np.where(self._still, self.family.nominal, member.values)
        return self.at(values) if self.family.size else member

    def motion(self, values: Vector) -> MovingSystem:
        """How the member with ``values`` moves between impacts; the others need no bounds."""
        return self._moving(tuple(values[: self.moving].tolist()))

    def _massive(self, values: Vector) -> MovingSystem:
        """A motion with the masses of the member with ``values``."""
        heavy = np.where(self._weighs, values, self.family.nominal)
        return self.motion(heavy)

    def bounces(self, contacts: Contacts) -> NDArray[np.bool_]:
        """Whether the restitutions of ``contacts`` are learnt, shape (k,)."""
        changes = [each.effect.eps != 0 for each in self.family.parameters]
        learnt = np.any(changes, axis=0) if changes else np.zeros(self.family.system.m, bool)
        return np.asarray(learnt[list(contacts)], dtype=np.bool_)

    def _gap_rows(self, contacts: Contacts) -> Matrix:
        """How the gaps of ``contacts`` change with the parameters, shape (k, p)."""
        return np.asarray(self._gap[:, list(contacts)].T)

    def turning(self, member: Member, closed: Contacts, x: Vector, t: float) -> Matrix:
        """How ``dx/dt`` changes with the parameters, shape (2n, p)."""
        pull = self._pull(member, closed, x, t)
        return np.vstack([np.zeros_like(pull), member.moving.phase(closed).inverse @ pull])

    def load_rows(
        self, member: Member, closed: Contacts, contacts: Contacts, x: Vector, t: float
    ) -> Matrix:
        """How the loads of held ``contacts`` change with the parameters, shape (k, p)."""
        phase = member.moving.phase(closed)
        loads = phase.loads[[phase.held.index(i) for i in contacts]]
        return np.asarray(-loads @ self._pull(member, closed, x, t))

    def jumped(self, values: Vector, x: Vector, pressed: Contacts) -> Map:
        """The mirror of an impact in which ``pressed`` take part; see ``dynamics.Mirror``."""
        numbers, heavy = self.family.at(values), self._massive(values)
        J = heavy.newton.jump(pressed, numbers.eps)
        mirror = Mirror.of(heavy.system, J, pressed, numbers.gap)
        return Map(mirror.J @ x + mirror.offset, mirror.J)

    def steps(self, theta: Vector, root: Matrix) -> Vector:
        """By how much parameters are moved to see what they do: about what they may be wrong by.

        They are powers of two, so that hypotheses that know about as much look at the same
        systems.

        Args:
            theta: parameters, shape (p,).
            root: a square root of the covariance of the first of them, shape (q, any).

        Returns:
            Shape (q,).
        """
        q = len(root)
        low, high = self.family.bounds
        least = _STEP * self.family.sizes[:q]
        wanted = np.maximum(np.linalg.norm(root, axis=1), least)
        room = _FAR * np.minimum(theta - low, high - theta)[:q]
        room[self.moving :] = np.inf  # those that only impacts know are never out of bounds there
        return np.asarray(np.exp2(np.floor(np.log2(np.minimum(wanted, room)))))

    def inward(self, theta: Vector, root: Matrix, rows: slice) -> Vector:
        """The change by which parameters that cannot be come to their bounds, others with them.

        What is then to be expected of all the rest, given those bounds (Simon and Chia, Kalman
        filtering with state equality constraints, 2002).

        Args:
            theta: parameters, shape (p,).
            root: a square root of the covariance of all that is estimated, shape (d, any).
            rows: of ``root`` that are those of ``theta``.

        Returns:
            Shape (d,).
        """
        change = np.zeros(len(root))
        for j, row in enumerate(root[rows]):
            value = float(theta[j] + change[rows][j])
            beyond = float(np.clip(value, self.low[j], self.high[j])) - value
            if beyond and np.any(row):
                change += root @ row * (beyond / float(row @ row))
        change[rows] = np.clip(theta + change[rows], self.low, self.high) - theta
        return change

    def _pull(self, member: Member, closed: Contacts, x: Vector, t: float) -> Matrix:
        """How the forces that accelerate masses change with the parameters, shape (n, p)."""
        n, rates = self.family.system.n, member.moving.rates(closed)
        acceleration = rates.along(x, member.moving.forces(t))[0][n:]
        pull = self.family.force_changes(member.values, t).T
        for j, each in enumerate(self.family.parameters[: self.moving]):
            effect = each.effect
            pull[:, j] -= effect.K @ x[:n] + effect.C @ x[n:] + effect.M @ acceleration
        return np.asarray(pull)

    def _member(self, values: tuple[float, ...]) -> Member:
        theta, moving = np.array(values), self._moving(values[: self.moving])
        same = np.array_equal(theta[self.moving :], self.family.nominal[self.moving :])
        return Member(moving.system if same else self.family.system_at(theta), theta, moving)

    def _motion(self, values: tuple[float, ...]) -> MovingSystem:
        """How the system moves with the first parameters as they are, the others as given."""
        theta = np.array(self.family.nominal)
        theta[: self.moving] = values
        same = np.array_equal(theta, self.family.nominal)
        return MovingSystem(self.family.system if same else self.family.system_at(theta))
