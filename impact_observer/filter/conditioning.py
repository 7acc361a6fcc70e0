# SPDX-License-Identifier: Apache-2.0
"""A state conditioned on any event, as (instant, state, constants): step "correct" of the filter.

The equations are those of the kernel's ``Impact``, which takes impacts of one contact while none
is closed, with harmonic forces and constant restitutions. There an impact changes a root by a few
products of a column and a row, and a hypothesis costs 5 us instead of 0.8 ms. ``Conditioning``
takes all other events: several contacts, rests and releases, sampled forces, and parameters of
masses and forces. Tests compare both wherever both apply.
"""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.joint import Expected, Joint
from impact_observer.filter.likelihood import Likelihood, likelihood_of
from impact_observer.filter.members import Member, Members
from impact_observer.filter.resting import rested
from impact_observer.filter.saltation import STATE_ROUNDING
from impact_observer.filter.square_root import lengths, product, triangular
from impact_observer.kernel._kernel import (
    BACK,
    MOST_STEPS,
    ROUNDS,
    SLOWEST,
    TIME_SHARE,
    TINY,
    Sensitivity,
    leading,
)
from impact_observer.states import Matrix, Vector
from impact_observer.turns import give_turn

_NO_TIME = 1e-15
"""Time in which nothing moves, s."""
_NEGLECTED_FLIGHT = 1e-8
"""Flights that a plant may neglect before it is at rest, relative to the model's time scale."""


class _Jump(NamedTuple):
    """The state after a jump at the instant ``e`` before that of a joint.

    Attributes:
        x: for ``e = 0``, shape (2n,).
        H: derivatives by ``e`` and the state before, shape (2n, 1 + 2n).
        E: second derivative by ``e``, shape (2n,).
        mean: of what is not linear, shape (2n,).
        noise: a root of its covariance, shape (2n, any).
        whole: the root of the joint, the columns of parameters first.
        by_theta: derivatives by the parameters, shape (p, 2n); None without parameters.
    """

    x: Vector
    H: Matrix
    E: Vector
    mean: Vector
    noise: Matrix
    whole: Matrix
    by_theta: Matrix | None = None


class Conditioning:
    """Conditions states on events that are what they are reported to be.

    Given the model, an impact is a linear map of the state and measures one function exactly: the
    gap is zero. A release measures that the load is zero, a closed contact that its gap and its
    speed are. The error e of the stamp is estimated with the state: it enters the jump as well as
    the gap, so the estimate jumps at its own root of the gap. Products of the errors of stamp and
    state are noise of known variance.

    A filter with saltation matrices, but with measured instants for its guards: Kong, Payne,
    Council and Johnson, The salted Kalman filter, 2021.

    Attributes:
        system: the system with the parameters of the model.
        members: the family of systems with other parameters.
        short: flights that a plant may neglect before it is at rest, s.
        longest: the longest flight that is followed step by step, s.
    """

    def __init__(self, members: Members) -> None:
        """Prepare for the states of a family's systems."""
        moving = members.given.moving
        self.system = members.family.system
        self.members = members
        self.short = _NEGLECTED_FLIGHT * moving.scales.timescale
        self.longest = MOST_STEPS / max(moving.rate, SLOWEST)
        self._scales = moving.scales

    def posterior(
        self,
        change: ContactChange,
        state: GaussianState,
        clock: float,
        likelihood: Likelihood | None = None,
        leftover: float = 0.0,
    ) -> GaussianState:
        """The state after an event, whose ``likelihood`` may be known; see ``after_jump``."""
        give_turn()
        prior = self.joint_prior(change, state, clock)
        return self.after_jump(change, self.joint_posterior(change, prior, likelihood), leftover)

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

    def likelihood(self, change: ContactChange, state: GaussianState, clock: float) -> Likelihood:
        """The likelihood of an event at a stamp with the standard deviation ``clock``, s."""
        give_turn()
        contacts = self.measured_contacts(change)
        if not contacts:
            # The instant of each switch is as likely as any in the model's time scale.
            return Likelihood(-len(change.contacts) * math.log(self._scales.timescale), {})
        prior = self.joint_prior(change, state, clock)
        member = self.members.of_estimate(prior)
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
        found, member = prior, self.members.of_estimate(prior)
        first = likelihood and likelihood.expected
        considered = self.members.considered_rows(prior.of_theta.start)
        for _ in range(ROUNDS if contacts else 0):
            view = self._propagated(member, change.before, prior, found.t - prior.t)
            expected = first or self._expected(member, change, contacts, view, found)
            first, update = None, expected.correction(view, considered)
            found = view.corrected(update, expected.rows(view), expected.innovation)
            settled = expected.settled(found)
            if found.parameters:
                bounded, rows = self.members.parameters.bounded, found.of_theta
                found = found._replace(z=bounded(found.z, found.root, rows.start))
            found = self._at_estimated_instant(change, found, member)
            if settled:
                break
        return found

    def after_jump(
        self, change: ContactChange, joint: Joint, leftover: float = 0.0
    ) -> GaussianState:
        """The state after the event, at its stamp; ``joint`` is just before it.

        A contact that closes may neglect the speed ``leftover`` before it rested, m/s; where that
        is infinite, the state is at rest afterwards, and nothing is measured by that.
        """
        member = self.members.of_estimate(joint)
        after = self._jumped(change, joint)
        if change.closed:
            new = tuple(i for i in change.closed if i not in change.before)
            new = () if math.isinf(leftover) else new
            short = self.neglected(member, change.before, after.x, joint.t)
            after = rested(self.members, after, new, np.hypot(short[list(new)], leftover))
            member = self.members.of_estimate(after)
        s, sensitivity = change.t - joint.t, None
        if not (s or change.closed):
            return after
        if joint.parameters:
            rate = self.members.rate_sensitivity(member, change.closed, after.x, joint.t)
            sensitivity = s * rate
        x, map_ = member.moving.moved(joint.t, after.x, s, change.closed)
        return after.propagated(x, map_, sensitivity)

    def unmeasured(
        self, change: ContactChange, state: GaussianState, leftover: float = 0.0
    ) -> GaussianState:
        """The state after a missed event; see ``ImpactFilter.posterior_of_missed``."""
        return self.after_jump(change, self.joint_of_missed(change, state), leftover)

    def joint_of_missed(self, change: ContactChange, state: GaussianState) -> Joint:
        """The instant of a missed event, which is the root of its guard, and the state then."""
        x, root, member = state.x, state.root, self.members.of_estimate(state)
        contacts = change.contacts[:1]
        hit = bool(change.hit)
        rates = member.moving.rates_at(change.t, x, change.before)
        rows = member.guard(change.before, contacts, change.t, x, hit=hit)
        value, H, D, E = rows.expanded(rates, x, member.moving.forces(change.t))
        sensitivity = self.measured_sensitivity(member, change, contacts, x, change.t)
        seen = np.hstack([H[:, 1:], sensitivity])
        late, bend = -float(value[0]), float(E[0])
        deviation = lengths(seen.dot(root[: seen.size]))[0]
        # Near grazing the acceleration decides the instant: s = sqrt(2 g / a), not g / gamma.
        falling = math.sqrt(abs(bend) * (deviation + abs(late)))
        # A gap that stands still tells no instant: its error stays one that can be followed.
        farthest = self.farthest(change)
        slope = max(float(H[0, 0]), falling, (deviation + abs(late)) / farthest, TINY)
        row, e, deviation = -seen / slope, late / slope, deviation / slope
        nonlinear = deviation * lengths(D.dot(root[: x.size]))[0] / slope
        nonlinear += bend / slope * deviation**2 / 2
        nonlinear = min(max(nonlinear, -farthest), farthest)
        differences = Joint.differences_of(state)
        differences[:1] = row.dot(differences[1 : 1 + row.size])
        whole = np.zeros((1 + len(root), 1 + root.shape[1]))
        whole[0, 0], whole[0, 1:], whole[1:, 1:] = nonlinear, row.dot(root[: row.size]), root
        return Joint.of(change.t, e, state, triangular(whole), differences)

    def jump_remainder(self, change: ContactChange, joint: Joint) -> Matrix:
        """What is not linear in the jump of ``joint``: a root of its second moment, (2n, any)."""
        jump = self._expanded_jump(change, joint)
        return np.column_stack([jump.mean, jump.noise])

    def neglected(self, member: Member, before: Contacts, x: Vector, t: float) -> Vector:
        """Speeds of all contacts that a plant may neglect to come to rest at ``x``, (m,), m/s.

        ``before`` are closed until then, at ``t`` s since the epoch.
        """
        rates, forces = member.moving.rates_at(t, x, before), member.moving.forces(t)
        pressing = rates.along(x, forces)[0]
        return self.short * member.near(x).contact_speed(pressing[self.system.n :])

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
        held = self.members.given.moving.held(change.before)
        return change.informative(held, self.system)

    def _expected(
        self, member: Member, change: ContactChange, contacts: Contacts, view: Joint, about: Joint
    ) -> Expected:
        """The predicted measurement of ``view``, linearised about another joint at its instant.

        ``member`` is the one of ``view``.
        """
        hit = bool(change.hit)
        rows = member.guard(change.before, contacts, view.t, about.x, hit=hit)
        forces = member.moving.forces(view.t)
        rates = member.moving.rates_at(view.t, about.x, change.before)
        expansion = rows.expanded(rates, about.x, forces)
        mean, nonlinear = product(about.own, expansion.D, expansion.E)
        x, e = view.x, view.e
        value = expansion.value if about is view else rows.value(x, forces[0])
        if e:
            value = value + expansion.H[:, 0] * e
        sensitivity = self.measured_sensitivity(member, change, contacts, about.x, view.t)
        return Expected(
            about.x,
            expansion,
            sensitivity,
            -(value + mean),
            nonlinear,
            rows.rounding(self._scales.sizes(x) if hit else x, forces[0]),
        )

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
        return self._propagated(member or self.members.of_estimate(joint), change.before, joint, s)

    def farthest(self, change: ContactChange) -> float:
        """Longest time between an event and its stamp over which a state is followed, s.

        A motion that fades grows going back: after some time constants it is rounding.
        """
        moving = self.members.given.moving
        fading = max(moving.decay(change.before), moving.decay(change.closed))
        return min(BACK / fading, self.longest) if fading else self.longest

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

    def _jumped(self, change: ContactChange, joint: Joint) -> GaussianState:
        """The state after the jump, at the instant of ``joint``: saltation."""
        size = joint.size
        x, H, E, mean, noise, whole, by_theta = self._expanded_jump(change, joint)
        x = x + mean
        if e := joint.e:
            x += e * (H[:, 0] + E * (e / 2))
        moved, differences = H.dot(joint.own), joint.differences[1:].copy()
        if differences.size:
            differences[:size] = H.dot(joint.differences[: 1 + size])
        if by_theta is not None:
            moved = H.dot(whole[: 1 + size]) + by_theta.T.dot(whole[joint.of_theta])
            differences[:size] += by_theta.T.dot(joint.differences[joint.of_theta])
        rounding = self._rounding(joint.t, x, change.flown)
        root = _with_rounding(moved, noise, whole[1 + size :], rounding)
        constants = joint.z[1 + size :]
        return GaussianState(x, constants, root, differences, change.closed, joint.parameters)

    def _expanded_jump(self, change: ContactChange, joint: Joint) -> _Jump:
        """The jump of ``joint``, about its state."""
        member, size = self.members.of_estimate(joint), joint.size
        pressed, moving = member.pressed(change, joint.x), member.moving
        mirror = member.mirror_about(joint.x, pressed)
        before = moving.rates_at(joint.t, joint.x, change.before)
        after = moving.rates_at(joint.t, mirror.landed(joint.x), change.closed)
        x, H, D, E = mirror.expanded(before, after, joint.x, moving.forces(joint.t))
        mean, noise = product(joint.own, D, E)
        if not self.system.is_plain(pressed):
            bends = member.bends(joint.x, joint.root[1 : 1 + size], pressed)
            noise = np.hstack([noise, bends])
        if not (joint.parameters and pressed):
            return _Jump(x, H, E, mean, noise, joint.root)
        whole = leading(joint.root, joint.of_theta.start, joint.parameters)
        own = joint.of_theta
        sensitivity = Sensitivity(
            lambda theta: self.members.impact(theta, joint.x, pressed),
            joint.theta,
            self.members.parameters.steps(joint.theta, joint.root[own], joint.differences[own]),
        )
        by_theta = sensitivity.noise(whole[1 : 1 + size], whole[own])
        return _Jump(x, H, E, mean, np.hstack([noise, by_theta]), whole, sensitivity.first)

    def _rounding(self, t: float, x: Vector, flown: float) -> Vector:
        """Standard deviation of the rounding of a state ``x`` at ``t`` (s), shape (2n,).

        The state was ``flown`` seconds in flight. The time since the epoch is rounded, too, so
        that harmonic forces are as wrong as they change in that rounding.
        """
        scales = self._scales
        late = (
            TIME_SHARE * abs(t) / scales.timescale if self.system.forcing.frequency.size else 0.0
        )
        return STATE_ROUNDING * (1.0 + late) * scales.sizes(x, flown)


def _with_rounding(moved: Matrix, noise: Matrix, rest: Matrix, rounding: Vector) -> Matrix:
    """The root of (q, u, constants) after a jump, with ``rounding`` of (q, u), (2n,)."""
    size, first = moved.shape
    last = first + noise.shape[1]
    root = np.zeros((size + len(rest), last + size))
    root[:size, :first], root[:size, first:last] = moved, noise
    root[size:, : rest.shape[1]] = rest
    root[:size].flat[last :: last + size + 1] = rounding
    return triangular(root)
