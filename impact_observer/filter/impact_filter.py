# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of impact times: prediction, likelihood and correction by one event."""

import math
from collections.abc import Iterable, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.events import Contacts
from impact_observer.filter.conditioning import Conditioning
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.likelihood import Likelihood
from impact_observer.filter.linear import LinearPrediction
from impact_observer.filter.members import Member
from impact_observer.filter.process_noise import with_noise
from impact_observer.filter.resting import rested
from impact_observer.filter.robot_members import members_of
from impact_observer.filter.square_root import (
    correction,
    lengths,
    narrow,
)
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.kernel._kernel import (
    TINY,
    Gaps,
)
from impact_observer.model import System
from impact_observer.model.system import refuse_squares
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_family import family_of
from impact_observer.states import Matrix, Vector

_LEAST_EXTENT = 1e-9
"""Magnitude of a component of the motion that has been still, relative to the largest."""


def gap_deviation_near(near: System, contact: int, root: Matrix) -> float:
    """The standard deviation of a gap of the system ``near`` a state, m.

    The ``root`` is that of the covariance of the state, shape (2n or more, any).
    """
    seen = near.W[:, contact].dot(root[: near.n])
    return math.sqrt(seen.dot(seen))


class EventQuery(NamedTuple):
    """An event under one hypothesis.

    Attributes:
        change: what the event was.
        state: before it.
        clock: standard deviation of its stamp, s.
        likelihood: of the event, if it is known.
    """

    change: ContactChange
    state: GaussianState
    clock: float
    likelihood: Likelihood | None = None


class ImpactFilter:
    """Prediction and correction of a state by events that are what they are reported to be.

    Unknown parameters of the model are constants between events; gaps, loads and the jump depend
    on them. Those that are considered keep their values and variances, and the states keep the
    errors that follow.

    Attributes:
        system: the system with the parameters of the model.
        members: the family of systems with other parameters.
        scales: of the motions of ``system``.
        noise: white noise of the accelerations, m/s^1.5; 0 for none.
        conditioning: conditions states on events that are not for the kernel.
    """

    def __init__(
        self,
        system: System | Robot,
        model_error: float = 0.0,
        unknowns: UnknownParameters | None = None,
    ) -> None:
        """Prepare law and phases; ``model_error`` is white noise of accelerations, m/s^1.5.

        A robot has the white torques of its model instead.
        """
        self.system: System = system  # type: ignore[assignment]
        refuse_squares(self.system, "minimum-variance")
        if isinstance(system, Robot):
            model_error = float(system.has_white_torques)
        unknowns = unknowns or UnknownParameters(family_of(system), np.empty((0, 0)))
        self._unknowns = unknowns
        self.members = members_of(unknowns.family, unknowns.considered)
        self.scales = self.members.given.moving.scales
        self.conditioning = Conditioning(self.members)
        self.noise = model_error
        self._is_free = self.members.given.moving.is_plain and self.members.is_linear

    def begin(self, state: GaussianState) -> GaussianState:
        """``state`` with its closed contacts at rest."""
        return rested(self.members, state, state.closed, np.zeros(len(state.closed)))

    def predict(
        self, t: float, state: GaussianState, model_error: float = 0.0
    ) -> LinearPrediction:
        """The prediction of ``state`` from ``t`` (s since the epoch) while nothing switches.

        The accelerations have white noise of ``model_error``, m/s^1.5, besides the declared one.
        """
        return LinearPrediction(t, state, self.members, self.noise_of(model_error))

    def noise_of(self, model_error: float) -> float:
        """The declared noise of the accelerations, and that of ``model_error``, m/s^1.5."""
        return math.hypot(self.noise, model_error)

    def member(self, state: GaussianState) -> Member:
        """The system with the parameters of an estimate."""
        return self.members.of_estimate(state)

    def rate_of(self, t: float, state: GaussianState) -> Vector:
        """``dx/dt`` of a state at ``t``, s since the epoch, shape (2n,)."""
        if self._is_free and not state.closed:
            return self.members.free.rates(t, state.x, state.theta)
        return self.member(state).moving.rate_of(t, state.x, state.closed)

    def near(self, x: Vector) -> System:
        """The system at a state ``x``, shape (2n,): a linear one is the same at all states."""
        return self.members.given.near(x)

    def speed(self, contact: int, state: GaussianState) -> float:
        """The contact speed of a state, m/s; positive where the contact opens."""
        return float(self.near(state.x).W[:, contact].dot(state.x[self.system.n :]))

    def gap(self, contact: int, state: GaussianState) -> float:
        """The gap of a contact by an estimate and its parameters, m."""
        near = self.near(state.x)
        found = float(near.W[:, contact] @ state.x[: near.n])
        by_theta = self.members.gap_sensitivity((contact,))[0]
        return found + float(near.q_r[contact] + by_theta @ self.members.change(state))

    def is_open(self, state: GaussianState, s: float) -> bool:
        """Whether no contact has been closed in the last ``s`` seconds, which are few.

        Speeds may have been ``Tuning.open_speed`` times as large as they are.
        """
        near, n = self.near(state.x), self.system.n
        way = TUNING.open_speed * s * np.abs(near.contact_speed(state.x[n:]))
        return bool(np.all(near.gap(state.x[:n]) > way))

    def since_root(self, contact: int, state: GaussianState) -> float:
        """How long ago a negative gap was zero, to first order, s; 0 for an opening contact."""
        gap, speed = self.gap(contact, state), self.speed(contact, state)
        return min(gap / speed, self.conditioning.longest) if gap < 0 and speed < 0 else 0.0

    @property
    def is_of_robot(self) -> bool:
        """Whether the states are those of a robot, which encoders tell."""
        return isinstance(self.system, Robot)

    def gap_deviation(self, contact: int, x: Vector, root: Matrix) -> float:
        """The standard deviation of a gap at a state ``x``, shape (2n,), m.

        The ``root`` is that of the covariance, shape (2n or more, any).
        """
        return gap_deviation_near(self.near(x), contact, root)

    def speed_deviation(self, contact: int, state: GaussianState) -> float:
        """The standard deviation of ``speed``, m/s."""
        near, n = self.near(state.x), self.system.n
        return float(np.linalg.norm(near.W[:, contact].dot(state.root[n : 2 * n])))

    def considered_deviation(self, contact: int, state: GaussianState) -> float:
        """The standard deviation of a gap by the errors of considered parameters alone, m."""
        rows = self.members.considered_rows(state.x.size)
        if not rows:
            return 0.0
        own = state.root[rows]
        near = self.near(state.x)
        seen = near.W[:, contact] @ state.root[: near.n]
        seen = seen + self.members.gap_sensitivity((contact,))[0] @ state.root[state.of_theta]
        own = own / np.linalg.norm(own, axis=1)[:, None]  # of full rank without correlations of 1
        along, *_ = np.linalg.lstsq(own.T, seen, rcond=None)
        return float(np.linalg.norm(own.T @ along))

    def largest_energy(self, largest: Vector) -> float:
        """The root of twice the energy of a motion of the magnitude ``largest``, (2n,), sqrt(J).

        Infinite for a robot, whose samples bound its motion.
        """
        q, u = largest.reshape(2, -1)
        fastest = np.append(q, u + q / self.scales.timescale)
        own = 0.0 if self.is_of_robot else self.members.given.moving.root_energy(fastest)
        return own or math.inf

    def is_possible(self, state: GaussianState, contacts: Contacts, root_energy: float) -> bool:
        """Whether the speeds of ``contacts`` in a ``state`` are those of a possible motion.

        ``root_energy`` is the largest root of twice the energy of the motion so far, sqrt(J).
        """
        moving = self.members.given.moving
        return state.is_finite and all(
            math.hypot(self.speed(i, state), self.speed_deviation(i, state))
            <= TUNING.impossible_speed * moving.contact_length(i, state.x) * root_energy
            for i in contacts
        )

    def fall(self, t: float, contact: int, state: GaussianState) -> float:
        """The acceleration of an open contact back to its stop at ``t`` (s), m/s2."""
        rate = self.rate_of(t, state)[self.system.n :]
        return -float(self.near(state.x).W[:, contact].dot(rate))

    def likelihoods(self, queries: Sequence[EventQuery]) -> list[Likelihood]:
        """The likelihoods of events, each if it is what it is reported to be."""
        found: dict[int, Likelihood] = {}
        for contact, which in self._grouped(queries):
            if contact is None:
                found.update((i, self.conditioning.likelihood(*queries[i][:3])) for i in which)
                continue
            some = [queries[i] for i in which]
            clocks = np.array([each.clock for each in some])
            fits = self.members.free_impact(contact).fits(
                some[0].change.t, [each.state for each in some], clocks
            )
            for i, fit in zip(which, fits.tolist(), strict=True):
                found[i] = Likelihood.of_single(contact, *fit)
        return [found[i] for i in range(len(queries))]

    def posteriors(self, queries: Sequence[EventQuery]) -> list[GaussianState]:
        """The states after events."""
        found: dict[int, GaussianState] = {}
        for contact, which in self._grouped(queries):
            if contact is None:
                found.update((i, self.conditioning.posterior(*queries[i])) for i in which)
                continue
            some = [queries[i] for i in which]
            change, clocks = some[0].change, np.array([each.clock for each in some])
            after = self.members.free_impact(contact).posteriors(
                change.t, change.flown, [each.state for each in some], clocks
            )
            found.update(zip(which, map(self._free_state, after), strict=True))
        return [found[i] for i in range(len(queries))]

    def _free_state(self, made: tuple[Vector, Vector, Matrix, Matrix]) -> GaussianState:
        """A state without contact that the kernel has made."""
        return GaussianState(*made, (), self.members.family.size)

    def is_alone(self, change: ContactChange) -> bool:
        """Whether an event is an impact of one contact while none is closed: for the kernel.

        One by another law than a constant restitution is not.
        """
        return self._is_free and change.is_plain(self.system)

    def _grouped(self, queries: Sequence[EventQuery]) -> Iterable[tuple[int | None, list[int]]]:
        """Contacts that impact alone, and None for all else, and where they are asked for."""
        found: dict[int | None, list[int]] = {}
        known: dict[int, list[int]] = {}  # branches share changes
        for i, (change, *_) in enumerate(queries):
            if id(change) not in known:
                contact = change.hit[0] if self.is_alone(change) else None
                known[id(change)] = found.setdefault(contact, [])
            known[id(change)].append(i)
        return found.items()

    def posterior_of_missed(
        self, change: ContactChange, state: GaussianState, leftover: float = 0.0
    ) -> GaussianState:
        """The state after a missed event, at the instant of ``change``.

        The instant is the root of the estimate's own guard. The event measures nothing, and its
        error follows from that of the state. A contact that closes may neglect the speed
        ``leftover``, m/s.
        """
        if not self.is_alone(change) or leftover:
            return self.conditioning.unmeasured(change, state, leftover)
        impact = self.members.free_impact(change.hit[0])
        return self._free_state(impact.missed(np.array([change.t]), [state])[0])

    def priors(
        self, t: float, s: float, states: Sequence[GaussianState], levels: Sequence[float]
    ) -> list[GaussianState]:
        """``states`` at ``t`` (s since the epoch), ``s`` seconds later, while nothing switches.

        Each has white accelerations of its own level, m/s^1.5, besides the declared ones.
        """
        flown = self._flown(np.full(len(states), t), np.full(len(states), s), states, levels)
        if flown is not None:
            return flown
        found, moving = list[GaussianState](), self.members.given.moving
        if self.members.moving or moving.depends_on_state:
            return [
                self.predict(t, state, level).prior(s)
                for state, level in zip(states, levels, strict=True)
            ]
        shared: dict[Contacts, tuple[Vector, Vector, Matrix]] = {}
        for state, level in zip(states, levels, strict=True):
            closed, x = state.closed, state.x
            if closed not in shared:
                shared[closed] = x, *moving.phase(closed).moved(t, x, s)
            about, after, map_ = shared[closed]
            if x is not about:
                after = after + map_.dot(x - about)
            prior = state.propagated(after, map_)
            if noise := self.noise_of(level):
                over = partial(moving.diffusion, t, x, closed)
                root = with_noise(prior.root, state.x.size, noise, over, s)
                prior = prior._replace(root=narrow(root))
            found.append(prior)
        return found

    def flights(
        self, t: Vector, s: Vector, states: Sequence[GaussianState], levels: Sequence[float]
    ) -> list[GaussianState]:
        """``priors`` of states with instants and durations of their own."""
        flown = self._flown(t, s, states, levels)
        if flown is not None:
            return flown
        if len({*zip(t.tolist(), s.tolist(), strict=True)}) == 1:
            return self.priors(float(t[0]), float(s[0]), states, levels)
        each = zip(t.tolist(), s.tolist(), states, levels, strict=True)
        return [self.priors(at, over, [one], [level])[0] for at, over, one, level in each]

    def _flown(
        self, t: Vector, s: Vector, states: Sequence[GaussianState], levels: Sequence[float]
    ) -> list[GaussianState] | None:
        """The same by the kernel; None where not by it."""
        if not self._is_free:
            return None
        longest = float(max(s, default=0.0))
        gaps = None if any(state.closed for state in states) else self.gaps((), longest)
        if gaps is None or not self.members.given.moving.is_short(longest):
            return None
        made = gaps.flown(t, s, states, np.array(levels), self.noise)
        return [self._free_state(each) for each in made]

    def gaps(self, closed: Contacts, s: float) -> Gaps | None:
        """The kernel's gaps for ``s`` seconds while contacts are ``closed``; None if not by it."""
        if closed or not self._is_free or s > self.conditioning.longest:
            return None
        return self.members.free_gaps

    def part_of(self, contacts: Contacts, x: Vector) -> NDArray[np.bool_]:
        """The coordinates that ``contacts`` touch at a state, and all coupled with them, (n,)."""
        touched = np.any(self.near(x).W[:, list(contacts)] != 0, axis=1)
        return np.isin(self._parts, self._parts[touched])

    @cached_property
    def _parts(self) -> NDArray[np.intp]:
        return self.system.parts()

    def widened(
        self,
        state: GaussianState,
        factor: float,
        largest: Vector,
        part: NDArray[np.bool_] | None = None,
    ) -> GaussianState:
        """``state`` with standard deviations that are larger by ``factor``.

        They stay below ``Tuning.widest_deviation`` times the motion so far, ``largest``, shape
        (2n,). Those of the parameters stay below what was declared. ``part``
        are the coordinates whose state is widened, shape (n,); all of them by default.
        """
        factors = np.full(len(state.root), factor)
        size = state.x.size
        if part is not None:
            factors[:size] = np.where(np.tile(part, 2), factor, 1.0)
        if state.parameters:
            now = lengths(state.root[state.of_theta])
            most = self._unknowns.deviations / np.maximum(now, TINY)
            factors[state.of_theta] = np.maximum(np.minimum(factor, most), 1.0)
        wider = state.root * factors[:, None]
        extent = np.maximum(largest, _LEAST_EXTENT * float(largest.max(initial=TINY)))
        most = TUNING.widest_deviation * extent
        if np.all(np.linalg.norm(wider[:size], axis=1) <= TUNING.unlimited_deviation * most):
            return state._replace(root=wider)
        bounds = np.zeros((size, len(state.root)))
        bounds.flat[:: len(state.root) + 1] = 1.0 / most
        nothing, considered = np.zeros((size, 0)), self.members.considered_rows(size)
        limited = correction(wider, bounds, nothing, [1.0] * size, considered)
        return state._replace(root=limited.root)
