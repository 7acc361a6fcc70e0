# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of impact times: prediction, likelihood and correction by one event."""

import math
from collections.abc import Iterable, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.joint import Expected, Joint
from impact_observer.filter.likelihood import Likelihood, likelihood_of
from impact_observer.filter.linear import LinearPrediction
from impact_observer.filter.members import Member, Members
from impact_observer.filter.process_noise import ProcessNoise
from impact_observer.filter.resting import rested
from impact_observer.filter.saltation import STATE_ROUNDING, Measured
from impact_observer.filter.square_root import (
    correction,
    lengths,
    narrow,
    product,
    triangular,
)
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.kernel._kernel import (
    BACK,
    MOST_STEPS,
    ROUNDS,
    SLOWEST,
    TIME_SHARE,
    TINY,
    Gaps,
    Sensitivity,
    leading,
)
from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector

_NO_TIME = 1e-15
"""Time in which nothing moves, s."""
_NEGLECTED_FLIGHT = 1e-8
"""Flights that a plant may neglect before it is at rest, relative to the model's time scale."""
_LEAST_EXTENT = 1e-9
"""Magnitude of a component of the motion that has been still, relative to the largest."""


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

    Given the model, an impact is a linear map of the state and measures one function exactly: the
    gap is zero. A release measures that the load is zero, a closed contact that its gap and its
    speed are. The error e of the stamp is estimated with the state: it enters the jump as well as
    the gap, so the estimate jumps at its own root of the gap. Products of the errors of stamp and
    state are noise of known variance.

    A filter with saltation matrices, but with measured instants for its guards: Kong, Payne,
    Council and Johnson, The salted Kalman filter, 2021.

    Unknown parameters of the model are constants between events; gaps, loads and the jump depend
    on them.

    Attributes:
        system: the system with the parameters of the model.
        members: the family of systems with other parameters.
        phases: linear phases of ``system``.
        noise: process noise; None for none.
        short: flights that a plant may neglect before it is at rest, s.
    """

    def __init__(
        self,
        system: System,
        model_error: float = 0.0,
        unknowns: UnknownParameters | None = None,
    ) -> None:
        """Prepare law and phases; ``model_error`` is white noise of accelerations, m/s^1.5."""
        self.system = system
        unknowns = unknowns or UnknownParameters(ParametricFamily(system, ()), np.empty(0))
        self._unknowns = unknowns
        self.members = Members(unknowns.family)
        self.phases = self.members.given.moving.phases
        self.short = _NEGLECTED_FLIGHT * self.phases.scales.timescale
        declared = ProcessNoise(model_error, unknowns.drift * unknowns.deviations)
        self._declared = declared
        self.noise = declared if model_error or np.any(declared.drift) else None
        self._is_uncertain = self.noise is not None or self.members.family.size > 0
        self._is_free = self.members.given.moving.is_plain and self.members.is_linear
        self._drifts = bool(np.any(declared.drift))
        self._longest = MOST_STEPS / max(self.members.given.moving.rate, SLOWEST)

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

    def noise_of(self, model_error: float) -> ProcessNoise | None:
        """The declared process noise, and white accelerations of ``model_error``, m/s^1.5."""
        if not model_error:
            return self.noise
        declared, drift = self._declared
        return ProcessNoise(math.hypot(declared, model_error), drift)

    def member(self, state: GaussianState | Joint) -> Member:
        """The system with the parameters of an estimate."""
        return self.members.at(state.theta)

    def rate_of(self, t: float, state: GaussianState) -> Vector:
        """``dx/dt`` of a state at ``t``, s since the epoch, shape (2n,)."""
        if self._is_free and not state.closed:
            return self.members.free.rates(t, state.x, state.theta)
        return self.member(state).moving.rate_of(t, state.x, state.closed)

    def speed(self, contact: int, state: GaussianState) -> float:
        """The contact speed of a state, m/s; positive where the contact opens."""
        return float(self.system.W[:, contact].dot(state.x[self.system.n :]))

    def speed_deviation(self, contact: int, state: GaussianState) -> float:
        """The standard deviation of ``speed``, m/s."""
        n = self.system.n
        return float(np.linalg.norm(self.system.W[:, contact].dot(state.root[n : 2 * n])))

    def fall(self, t: float, contact: int, state: GaussianState) -> float:
        """The acceleration of an open contact back to its stop at ``t`` (s), m/s2."""
        return -float(self.system.W[:, contact].dot(self.rate_of(t, state)[self.system.n :]))

    def likelihoods(self, queries: Sequence[EventQuery]) -> list[Likelihood]:
        """The likelihoods of events, each if it is what it is reported to be."""
        found: dict[int, Likelihood] = {}
        for contact, which in self._grouped(queries):
            if contact is None:
                found.update((i, self._likelihood_of(queries[i])) for i in which)
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
                found.update((i, self._posterior_of(queries[i])) for i in which)
                continue
            some = [queries[i] for i in which]
            change, clocks = some[0].change, np.array([each.clock for each in some])
            after = self.members.free_impact(contact).posteriors(
                change.t, change.flown, [each.state for each in some], clocks
            )
            found.update(zip(which, map(self.free_state, after), strict=True))
        return [found[i] for i in range(len(queries))]

    def _rounding(self, t: float, x: Vector, flown: float) -> Vector:
        """Standard deviation of the rounding of a state ``x`` at ``t`` (s), shape (2n,).

        The state was ``flown`` seconds in flight. The time since the epoch is rounded, too, so
        that harmonic forces are as wrong as they change in that rounding.
        """
        scales = self.phases.scales
        late = (
            TIME_SHARE * abs(t) / scales.timescale if self.system.forcing.frequency.size else 0.0
        )
        return STATE_ROUNDING * (1.0 + late) * scales.sizes(x, flown)

    def free_state(self, made: tuple[Vector, Vector, Matrix, Matrix]) -> GaussianState:
        """A state without contact that the kernel has made."""
        return GaussianState(*made, (), self.members.family.size)

    def is_alone(self, change: ContactChange) -> bool:
        """Whether an event is an impact of one contact while none is closed: for the kernel.

        One that lasts is not, nor is one by another law than a constant restitution.
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

    def _likelihood_of(self, query: EventQuery) -> Likelihood:
        """By the general methods, as ``_posterior_of``."""
        return self.likelihood(query.change, self.joint_prior(*query[:3]))

    def _posterior_of(self, query: EventQuery) -> GaussianState:
        prior, change = self.joint_prior(*query[:3]), query.change
        return self.posterior(change, self.joint_posterior(change, prior, query.likelihood))

    def posterior_at_rest(self, query: EventQuery) -> GaussianState:
        """The state after an event that closes a contact, whatever its speed was."""
        prior, change = self.joint_prior(*query[:3]), query.change
        return self.posterior(change, self.joint_posterior(change, prior), math.inf)

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
        if self.members.moving or moving.guided:
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
                over = partial(moving.diffusion, closed)
                root = noise.added_to(prior.root, state.x.size, over, s)
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
        longest = float(max(s, default=0.0))
        gaps = None if any(state.closed for state in states) else self.gaps((), longest)
        if gaps is None or self._drifts or not self.members.given.moving.is_short(longest):
            return None
        made = gaps.flown(t, s, states, np.array(levels), self._declared.model_error)
        return [self.free_state(each) for each in made]

    def gaps(self, closed: Contacts, s: float) -> Gaps | None:
        """The kernel's gaps for ``s`` seconds while contacts are ``closed``; None if not by it."""
        if closed or not self._is_free or s > self._longest:
            return None
        return self.members.free_gaps

    def joint_prior(self, change: ContactChange, state: GaussianState, clock: float) -> Joint:
        """The prior of the event's instant and the state then.

        ``clock`` is the standard deviation of the stamp, s.
        """
        d, columns = state.root.shape
        root = np.zeros((1 + d, 1 + columns))
        root[0, 0], root[1:, 1:] = clock, state.root
        if d > state.x.size + state.parameters:
            root[0, 1:] = state.root[-1]
            root = triangular(root)
        joint = Joint.of(change.t, state.offset, state, root, Joint.differences_of(state))
        return self._at_estimated_instant(change, joint) if state.offset else joint

    def likelihood(self, change: ContactChange, prior: Joint) -> Likelihood:
        """The likelihood of an event, if it is what it is reported to be."""
        contacts = self.measured_contacts(change)
        if not contacts:
            # the instant is as likely as any in the model's time scale
            return Likelihood(-math.log(self.phases.scales.timescale), {})
        member = self.member(prior)
        expected = self._expected(member, change, contacts, prior, prior)
        return likelihood_of(contacts, expected, prior)

    def joint_posterior(
        self, change: ContactChange, prior: Joint, likelihood: Likelihood | None = None
    ) -> Joint:
        """Instant and state just before the event, corrected by it.

        An iterated filter: the measurement is linearised about its own posterior, at the estimated
        instant, until that changes next to nothing. The linearisation of ``likelihood`` is used
        first.
        """
        contacts = self.measured_contacts(change)
        found, member = prior, self.member(prior)
        first = likelihood and likelihood.expected
        for _ in range(ROUNDS if contacts else 0):
            view = self._propagated(member, change.before, prior, found.t - prior.t)
            expected = first or self._expected(member, change, contacts, view, found)
            first, update = None, expected.correction(view)
            found = view.corrected(update, expected.rows(view), expected.innovation)
            settled = expected.settled(found)
            if found.parameters:
                bounded, rows = self.members.parameters.bounded, found.of_theta
                found = found._replace(z=bounded(found.z, found.root, rows.start))
            found = self._at_estimated_instant(change, found, member)
            if settled:
                break
        return found

    def before(
        self, change: ContactChange, state: GaussianState, clock: float
    ) -> tuple[Vector, Matrix]:
        """The state at the stamp of an event, corrected by it, if it had not happened yet.

        (q, u), shape (2n,), and a root of its covariance, shape (2n, any).
        """
        found = self.joint_posterior(change, self.joint_prior(change, state, clock))
        s = change.t - found.t
        found = self._propagated(self.member(found), change.before, found, s)
        return found.x, found.own[1:]

    def posterior(
        self, change: ContactChange, joint: Joint, leftover: float = 0.0
    ) -> GaussianState:
        """The state after the event, at its stamp; ``joint`` is just before it.

        A contact that closes may neglect the speed ``leftover`` before it rested, m/s; where that
        is infinite, the state is at rest afterwards, and nothing is measured by that.
        """
        joint = self._at_jump(change, joint)
        member = self.member(joint)
        turned = self._is_turned(member, change, joint)
        after = self._jumped(change, joint, soft=turned or bool(change.delay(self.system)))
        if change.closed:
            new = tuple(i for i in change.closed if i not in change.before)
            new = () if turned or math.isinf(leftover) else new
            short = self.neglected(member, change.before, after.x, joint.t)
            after = rested(self.members, after, new, np.hypot(short[list(new)], leftover))
        s, sensitivity = change.t - joint.t, None
        if not (s or change.closed):
            return after
        if joint.parameters:
            rate = self.members.rate_sensitivity(member, change.closed, after.x, joint.t)
            sensitivity = s * rate
        x, map_ = member.moving.moved(joint.t, after.x, s, change.closed)
        return after.propagated(x, map_, sensitivity)

    def _at_jump(self, change: ContactChange, joint: Joint) -> Joint:
        """``joint`` when the velocities jump, which in an impact that lasts is later."""
        if not (late := change.delay(self.system)):
            return joint
        found = self._propagated(self.member(joint), change.before, joint, late)
        z = found.z.copy()
        z[0] -= late  # the jump is as early as the onset
        return found._replace(z=z)

    def neglected(self, member: Member, before: Contacts, x: Vector, t: float) -> Vector:
        """Speeds of all contacts that a plant may neglect to come to rest at ``x``, (m,), m/s.

        ``before`` are closed until then, at ``t`` s since the epoch.
        """
        rates, forces = member.moving.rates_at(t, x, before), member.moving.forces(t)
        pressing = rates.along(x, forces)[0]
        return self.short * self.system.contact_speed(pressing[self.system.n :])

    def part_of(self, contacts: Contacts) -> NDArray[np.bool_]:
        """The coordinates that ``contacts`` touch, and all that these are coupled with, (n,)."""
        touched = np.any(self.system.W[:, list(contacts)] != 0, axis=1)
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
        size, p = state.x.size, state.parameters
        if part is not None:
            factors[:size] = np.where(np.tile(part, 2), factor, 1.0)
        if p:
            now = lengths(state.root[size : size + p])
            most = self._unknowns.deviations / np.maximum(now, TINY)
            factors[size : size + p] = np.maximum(np.minimum(factor, most), 1.0)
        wider = state.root * factors[:, None]
        extent = np.maximum(largest, _LEAST_EXTENT * float(largest.max(initial=TINY)))
        most = TUNING.widest_deviation * extent
        if np.all(np.linalg.norm(wider[:size], axis=1) <= TUNING.unlimited_deviation * most):
            return state._replace(root=wider)
        bounds = np.zeros((size, len(state.root)))
        bounds.flat[:: len(state.root) + 1] = 1.0 / most
        limited = correction(wider, bounds, np.zeros((size, 0)), [1.0] * size)
        return state._replace(root=limited.root)

    def measured_sensitivity(
        self, member: Member, change: ContactChange, contacts: Contacts, x: Vector, t: float
    ) -> Matrix:
        """Of the functions that an event measures to the parameters, shape (k, p)."""
        if change.hit:
            return self.members.gap_sensitivity(contacts)
        return self.members.load_sensitivity(member, change.before, contacts, x, t)

    def measured_contacts(self, change: ContactChange) -> Contacts:
        """The contacts of which an event measures the guard; see ``ContactChange.informative``."""
        if change.hit:
            return change.hit
        held = self.members.given.moving.phase(change.before).held
        return change.informative(held, self.system)

    def _expected(
        self, member: Member, change: ContactChange, contacts: Contacts, view: Joint, about: Joint
    ) -> Expected:
        """The predicted measurement of ``view``, linearised about another joint at its instant.

        ``member`` is the one of ``view``.
        """
        if turned := self._is_turned(member, change, about):
            rows = Measured.speeds(self.system, contacts)
            jet = rows.along(member.moving.rates_at(view.t, about.x, change.before))
        else:
            hit = bool(change.hit)
            rows, jet = member.guard_at(view.t, about.x, change.before, contacts, hit=hit)
        forces = member.moving.forces(view.t)
        expansion = jet.expanded(about.x, forces)
        mean, nonlinear = product(about.own, expansion.D, expansion.E)
        x, e = view.x, view.e
        value = expansion.value if about is view else rows.value(x, forces[0])
        if e:
            value = value + expansion.H[:, 0] * e
        sensitivity = self.measured_sensitivity(member, change, contacts, about.x, view.t)
        return Expected(
            about.x,
            expansion,
            np.zeros_like(sensitivity) if turned else sensitivity,
            -(value + mean),
            nonlinear,
            rows.rounding(self.phases.scales.sizes(x) if change.hit else x, forces[0]),
        )

    def _is_turned(self, member: Member, change: ContactChange, joint: Joint) -> bool:
        """Whether a contact closes that has not reopened since a hit that lasted.

        The plant puts it on its stop where its speed comes down to zero, so that its gap says
        nothing of the instant. It is inside by more than the deviation explains.
        """
        if len(change.hit) != 1 or change.hit[0] not in change.closed:
            return False
        if not self.system.contact_time[change.hit[0]]:
            return False
        gap = member.gaps(change.hit)
        (deviation,) = lengths(gap.c @ joint.root[1 : 1 + joint.size])
        return float(gap.value(joint.x)[0]) < -TUNING.inside * deviation

    def _at_estimated_instant(
        self, change: ContactChange, joint: Joint, member: Member | None = None
    ) -> Joint:
        """``joint`` at its own estimate of the event's instant.

        It goes back neither before the samples of a sampled forcing, nor so far that a
        fading motion grows to rounding. It may go back beyond an earlier event: where errors of
        the clock reverse the order of two impacts, the phase between them lacks the first jump.
        """
        sampled = self.system.forcing.sampled
        back = on = self.farthest(change)
        if sampled is not None:
            back = min(back, change.t - float(sampled.time[0]))
        early = change.t - joint.t + joint.e
        s = change.t - max(-on, min(early, back)) - joint.t
        return self._propagated(member or self.member(joint), change.before, joint, s)

    def farthest(self, change: ContactChange) -> float:
        """Longest time between an event and its stamp over which a state is followed, s.

        A motion that fades grows going back: after some time constants it is rounding.
        """
        moving = self.members.given.moving
        fading = max(moving.rates(change.before).decay, moving.rates(change.closed).decay)
        return min(BACK / fading, self._longest) if fading else self._longest

    def _propagated(self, member: Member, closed: Contacts, joint: Joint, s: float) -> Joint:
        """``joint`` with its state ``s`` seconds later; of first order in ``s`` for parameters."""
        if abs(s) <= _NO_TIME:
            return joint
        x, map_ = member.moving.moved(joint.t, joint.x, s, closed)
        if not joint.parameters:
            return joint.propagated(s, x, map_)
        sensitivity = s * self.members.rate_sensitivity(member, closed, joint.x, joint.t)
        other = sensitivity @ (joint.theta - member.values)
        return joint.propagated(s, x + other, map_, sensitivity)

    def pressed(self, member: Member, change: ContactChange, x: Vector) -> Contacts:
        """The contacts that take an impulse at an event, before which the state is ``x``."""
        if not change.hit or len(change.active) == 1:
            return change.hit
        n = self.system.n
        gamma = member.gaps(change.hit).c[:, :n].dot(x[n:])
        return change.pressed(member.newton, gamma)

    def _jumped(self, change: ContactChange, joint: Joint, *, soft: bool) -> GaussianState:
        """The state after the jump, at the instant of ``joint``: saltation.

        A ``soft`` one leaves positions as they are.
        """
        member, size = self.member(joint), joint.size
        pressed = self.pressed(member, change, joint.x)
        jet = member.jump_about(joint.t, joint.x, pressed, change.before, change.closed, soft=soft)
        x, H, D, E = jet.expanded(joint.x, member.moving.forces(joint.t))
        mean, noise = product(joint.own, D, E)
        if not self.system.is_plain(pressed):
            bends = member.bends(joint.x, joint.root[1 : 1 + size], pressed)
            noise = np.hstack([noise, bends])
        x = x + mean
        if e := joint.e:
            x += e * (H[:, 0] + E * (e / 2))
        whole, moved, differences = joint.root, H.dot(joint.own), joint.differences[1:].copy()
        if differences.size:
            differences[:size] = H.dot(joint.differences[: 1 + size])
        if joint.parameters and pressed:
            whole = leading(joint.root, joint.of_theta.start, joint.parameters)
            sensitivity = Sensitivity(
                lambda theta: self.members.impact(theta, joint.x, pressed, soft=soft),
                joint.theta,
                self.members.parameters.steps(joint.theta, joint.root[joint.of_theta]),
            )
            own = whole[joint.of_theta]
            moved = H.dot(whole[: 1 + size]) + sensitivity.first.T.dot(own)
            noise = np.hstack([noise, sensitivity.noise(whole[1 : 1 + size], own)])
            differences[:size] += sensitivity.first.T.dot(joint.differences[joint.of_theta])
        rounding = self._rounding(joint.t, x, change.flown)
        root = _with_rounding(moved, noise, whole[1 + size :], rounding)
        constants = joint.z[1 + size :]
        return GaussianState(x, constants, root, differences, change.closed, joint.parameters)


def _with_rounding(moved: Matrix, noise: Matrix, rest: Matrix, rounding: Vector) -> Matrix:
    """The root of (q, u, constants) after a jump, with ``rounding`` of (q, u), (2n,)."""
    size, first = moved.shape
    last = first + noise.shape[1]
    root = np.zeros((size + len(rest), last + size))
    root[:size, :first], root[:size, first:last] = moved, noise
    root[size:, : rest.shape[1]] = rest
    root[:size].flat[last :: last + size + 1] = rounding
    return triangular(root)
