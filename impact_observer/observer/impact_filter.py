"""The Kalman filter of impact times: what an instant says of the whole state, and how surely."""

import math
from typing import NamedTuple

import numpy as np
from scipy import linalg, special

from impact_observer.dynamics import (
    ROUNDING,
    Correction,
    Map,
    Measured,
    Sensitivity,
    led,
    lengths,
    product,
    triangular,
)
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.family import Family
from impact_observer.observer.belief import Known, Touch
from impact_observer.observer.joint import Expected, Joint
from impact_observer.observer.learning import Unknowns
from impact_observer.observer.linear import Astray, Linear
from impact_observer.observer.members import Member, Members
from impact_observer.observer.resting import rested
from impact_observer.states import Matrix, Vector

_SHORT = 1e-8
"""Flights that a plant may leave out before it is at rest, relative to the model's time scale."""
_BRIEF = 1e-2
"""Flights that need not be told from rest where they are lower than is known, likewise."""
_BACK = 8.0
"""How far the fastest fading motion is followed back, in its own time constants."""
_ROUNDS = 6
"""How often a measurement is linearised about what it says itself, at most."""
_STILL = 1e-150
"""Speed that is none."""
_CLOSING = 1e-3
"""Standard deviation of a closing speed below which its sign is sure, relative to it."""
_FAR = 30.0
"""Innovation, in standard deviations, beyond which an event cannot be what it is said to be."""
_NORMAL = math.log(2 * math.pi) / 2


class Evidence(NamedTuple):
    """How an event fits what was known.

    Attributes:
        density: logarithm of the probability density of its instant, 1/s for each contact.
        innovations: by contact, how far the innovation was from zero, in standard deviations.
        linear: what was expected about what was known, and what the event tells of that; None
            where that was not needed.
    """

    density: float
    innovations: dict[int, float]
    linear: tuple[Expected, Correction] | None = None


class ImpactFilter:
    """Knowledge of a state before and after events that are what they are said to be.

    Given the model, an impact is a linear map of the state and says one thing exactly: the gap was
    zero. A release says that the load was, a closed contact that its gap and its speed are. The
    error of a stamp belongs to what is estimated: it enters the jump as well as the gap, so the
    estimate jumps at its own root of the gap, as nearly as the stamp allows. What that leaves of
    products, of the stamp's error and the state's, is noise of known variance.

    A filter with saltation matrices, but with measured instants for its guards: Kong, Payne,
    Council and Johnson, The salted Kalman filter, 2021.

    Parameters of the model that are not known either stay between events; gaps, loads and what an
    impact does change with them.

    Attributes:
        system: what moves, as the model says.
        members: the family of what may move.
        phases: linear phases of ``system``.
        short: flights that a plant may leave out before it is at rest, s.
        brief: flights that are left out where they are not known from rest, s.
    """

    def __init__(
        self,
        system: System,
        model_error: float = 0.0,
        unknowns: Unknowns | None = None,
    ) -> None:
        """Prepare impact law and phases.

        Args:
            system: what moves.
            model_error: of the accelerations, as white noise, m/s^1.5.
            unknowns: parameters of ``system`` that are learnt; None for none.
        """
        self.system = system
        unknowns = unknowns or Unknowns(Family(system, ()), np.empty(0))
        self._unknowns = unknowns
        self.members = Members(unknowns.family)
        self.phases = self.members.given.moving.phases
        self.short = _SHORT * self.phases.scales.timescale
        self.brief = _BRIEF * self.phases.scales.timescale
        self._astray = Astray(model_error, unknowns.drift * unknowns.deviations)

    def begin(self, known: Known) -> Known:
        """``known``, and that its closed contacts rest."""
        return rested(self.members, known, known.closed, np.zeros(len(known.closed)))

    def course(self, t: float, known: Known) -> Linear:
        """How ``known`` goes on from ``t`` (s since the epoch) while nothing switches."""
        return Linear(t, known, self.members, self._astray)

    def member(self, known: Known | Joint) -> Member:
        """The system whose parameters are those of an estimate."""
        return self.members.at(known.theta)

    def prior(self, touch: Touch, known: Known, clock: float) -> Joint:
        """Instant and state as they are believed before an event is heard.

        Args:
            touch: what is heard, from the contacts that ``known`` has closed.
            known: when it is stamped.
            clock: standard deviation of the stamp, s.
        """
        d, p = known.root.shape[0], known.parameters
        root = np.zeros((1 + d, 1 + known.root.shape[1]))
        root[0, 0], root[1:, 1:] = clock, known.root
        if d > known.x.size + p:
            root[0, 1:] = known.root[-1]
            root = triangular(root)
        joint = Joint.of(touch.t, known.offset, known, root, Joint.apart_of(known))
        return self._at_its_instant(touch, joint) if known.offset else joint

    def evidence(self, touch: Touch, prior: Joint) -> Evidence:
        """How an event fits what is known, if it is what it is said to be.

        The density of a gap at an instant, times the speed at which it goes through zero, is the
        density of the instant; and it can only go through it from above.
        """
        contacts = self._telling(touch)
        if not contacts:
            return Evidence(0.0, {})
        if (apart := self._far(touch, contacts, prior)) is not None:
            return apart
        expected = self._expected(self.member(prior), touch, contacts, prior, prior)
        learnt, (_, H, D, _) = expected.learnt(prior), expected.expansion
        white = linalg.lapack.dtrtrs(learnt.innovation, expected.innovation, lower=1)[0]
        density = -0.5 * float(white @ white) - len(contacts) * _NORMAL
        density -= float(np.sum(np.log(np.abs(np.diag(learnt.innovation)))))
        slope = H[:, 0]
        spread = lengths(D @ prior.own[1:])
        density += float(np.sum(np.log(np.hypot(slope, spread) + _STILL)))
        if len(contacts) == 1:
            surely = max(float(spread[0]), _CLOSING * abs(float(slope[0])), _STILL)
            density += float(special.log_ndtr(slope[0] / surely))
        sizes = np.abs(expected.innovation) / learnt.deviations
        innovations = dict(zip(contacts, sizes.tolist(), strict=True))
        return Evidence(density, innovations, (expected, learnt))

    def _far(self, touch: Touch, contacts: Contacts, prior: Joint) -> Evidence | None:
        """The evidence of an event that is so far off that no more need be known; else None."""
        if not touch.hit:
            return None
        member = self.member(prior)
        gaps, rates = member.gaps(contacts), member.moving.rates(touch.before)
        rate = rates.along(prior.x, member.moving.forces(prior.t))[0]
        slope = -gaps.c @ rate
        bent = np.abs(gaps.c @ rates.A @ rate)
        clock = prior.root[0, 0]
        seen = (
            gaps.c @ prior.own[1:] + self.members.gap_rows(contacts) @ prior.root[prior.of_theta]
        )
        most = np.hypot(lengths(seen), (np.abs(slope) + bent * clock) * clock)
        most += self._rounding(touch, gaps, prior.x)
        value = np.abs(gaps.value(prior.x) + slope * prior.e)
        sizes = value / most
        if np.max(sizes) < _FAR:
            return None
        innovations = dict(zip(contacts, sizes.tolist(), strict=True))
        return Evidence(-float(sizes @ sizes) / 2, innovations)

    def heard(self, touch: Touch, prior: Joint, evidence: Evidence | None = None) -> Joint:
        """Instant and state, both just before the event, once it is heard.

        They are looked at where the event is believed to have been.

        Args:
            touch: the event.
            prior: what is known before it.
            evidence: of the same event and ``prior``, to begin with; None to begin without.
        """
        contacts = self._telling(touch)
        found, member = prior, self.member(prior)
        linear = evidence and evidence.linear
        for _ in range(_ROUNDS if contacts else 0):
            view = self._moved(member, touch.before, prior, found.t - prior.t)
            if linear is None:
                expected = self._expected(member, touch, contacts, view, found)
                linear = expected, expected.learnt(view)
            (expected, learnt), linear = linear, None
            found = view.corrected(learnt, expected.rows(view), expected.innovation)
            settled = expected.settled(found)
            found = self._bounded(found) if found.parameters else found
            found = self._at_its_instant(touch, found, member)
            if settled:
                break
        return found

    def after(self, touch: Touch, joint: Joint, left: float = 0.0) -> Known:
        """What is known after the event, at the instant at which it is stamped.

        Args:
            touch: the event.
            joint: what is known just before it.
            left: speed that a contact which closes may have left out before it rested, m/s.
        """
        after, member = self._jumped(touch, joint), self.member(joint)
        if touch.closed:
            new = tuple(i for i in touch.closed if i not in touch.before)
            rates, forces = member.moving.rates(touch.before), member.moving.forces(joint.t)
            pressing = rates.along(after.x, forces)[0]
            short = self.short * self.system.contact_speed(pressing[self.system.n :])
            after = rested(self.members, after, new, np.hypot(short[list(new)], left))
        phase, s, turn = member.moving.phase(touch.closed), touch.t - joint.t, None
        if joint.parameters:
            turn = s * self.members.turning(member, touch.closed, after.x, joint.t)
        return after.carried(phase.moved(joint.t, after.x, s), phase.transition(s), turn)

    def unheard(self, touch: Touch, known: Known, left: float = 0.0) -> Known:
        """What is known after an event that nobody heard, at the instant of ``touch``.

        It was where the state says, so the instant is as uncertain as that, and says nothing.

        Args:
            touch: what was not heard.
            known: then.
            left: speed that a contact which closes may have left out before it rested, m/s.
        """
        x, root, member, contacts = known.x, known.root, self.member(known), touch.contacts[:1]
        measured = self._watched(member, touch, contacts, touch.t)
        forces = member.moving.forces(touch.t)
        value, H, D, E = measured.expanded(member.moving.rates(touch.before), x, forces)
        seen = np.hstack([H[:, 1:], self._turn(member, touch, contacts, x, touch.t)])
        late = -float(value[0])
        deviation = float(np.linalg.norm(seen @ root[: seen.size]))
        # Where it is slow, an acceleration decides when: s = sqrt(2 g / a), not g / gamma.
        falling = math.sqrt(abs(float(E[0])) * (deviation + abs(late)))
        slope = max(float(H[0, 0]), falling, _STILL)
        row, e, deviation = -seen / slope, late / slope, deviation / slope
        bent = deviation * float(np.linalg.norm(D @ root[: x.size])) / slope
        bent += float(E[0]) / slope * deviation**2 / 2
        apart = Joint.apart_of(known)
        apart[:, :1] = apart[:, 1 : 1 + row.size] @ row.T
        whole = np.zeros((1 + len(root), 1 + root.shape[1]))
        whole[0, 0], whole[0, 1:], whole[1:, 1:] = bent, row @ root[: row.size], root
        return self.after(touch, Joint.of(touch.t, e, known, triangular(whole), apart), left)

    def wider(self, known: Known, factor: float) -> Known:
        """``known`` with a state that is less sure by ``factor``.

        So are the parameters, but never less than they were at first.
        """
        factors = np.full(len(known.root), factor)
        size, p = known.x.size, known.parameters
        if p:
            now = np.linalg.norm(known.root[size : size + p], axis=1)
            most = self._unknowns.deviations / np.maximum(now, _STILL)
            factors[size : size + p] = np.maximum(np.minimum(factor, most), 1.0)
        return known._replace(root=known.root * factors[:, None])

    def mirrored(self, contact: int, known: Known) -> Matrix:
        """What an impact of ``contact`` makes of errors, were it told when: shape (2n, 2n)."""
        return self.member(known).mirror(tuple(sorted({*known.closed, contact}))).J

    def speed(self, contact: int, known: Known) -> float:
        """Speed of a contact, m/s."""
        return float(self.system.W[:, contact] @ known.x[self.system.n :])

    def rests(self, t: float, contact: int, known: Known) -> bool:
        """Whether ``contact`` leaves its stop by less than is known of its gap, or not at all.

        Args:
            t: s since the epoch, just after an impact of the contact.
            contact: index.
            known: at ``t``.
        """
        n, w, speed = self.system.n, self.system.W[:, contact], self.speed(contact, known)
        moving = self.member(known).moving
        rate = moving.rates(known.closed).along(known.x, moving.forces(t))[0]
        fall = -float(w @ rate[n:])
        if fall <= 0:
            return False
        unsure = float(np.linalg.norm(w @ known.root[:n]))
        flight = 2 * speed / fall
        return flight <= self.short or (speed * flight / 4 <= unsure and flight <= self.brief)

    def _telling(self, touch: Touch) -> Contacts:
        """The contacts that say something that is not known already."""
        held = self.members.given.moving.phase(touch.before).held
        return touch.telling(held, self.system.forcing)

    @staticmethod
    def _watched(member: Member, touch: Touch, contacts: Contacts, t: float) -> Measured:
        """What is zero at an event: the gaps of those that hit, or the load of one that opens."""
        if touch.hit:
            return member.gaps(contacts)
        moving = member.moving
        return Measured.loads(moving.phase(touch.before), contacts, moving.forces(t))

    def _turn(
        self, member: Member, touch: Touch, contacts: Contacts, x: Vector, t: float
    ) -> Matrix:
        """How that changes with the parameters, shape (k, p)."""
        if touch.hit:
            return self.members.gap_rows(contacts)
        return self.members.load_rows(member, touch.before, contacts, x, t)

    def _rounding(self, touch: Touch, measured: Measured, x: Vector) -> Vector:
        """Standard deviation of what is rounded in what an event measures, shape (k,)."""
        if not touch.hit:
            return measured.rounding(x)
        return measured.rounding(self.phases.scales.sizes(x))

    def _expected(
        self, member: Member, touch: Touch, contacts: Contacts, view: Joint, about: Joint
    ) -> Expected:
        """What ``contacts`` should say of ``view``, linearised about another at its instant.

        ``member`` is the one of ``view``.
        """
        measured = self._watched(member, touch, contacts, view.t)
        forces = member.moving.forces(view.t)
        expansion = measured.expanded(member.moving.rates(touch.before), about.x, forces)
        mean, bent = product(about.own, expansion.D, expansion.E)
        value = measured.value(view.x)
        return Expected(
            about.x,
            expansion,
            self._turn(member, touch, contacts, about.x, view.t),
            -(value + expansion.H[:, 0] * view.e + mean),
            bent,
            self._rounding(touch, measured, view.x),
        )

    def _at_its_instant(self, touch: Touch, joint: Joint, member: Member | None = None) -> Joint:
        """``joint`` looked at where it believes the event to have been.

        Not where no forcing is known, nor so far back that what has faded would be rounding. But
        it may be before an earlier event: where clocks change the order of two impacts, the
        phase between them is wrong by what the first did to the second, within their distance.
        """
        sampled, moving = self.system.forcing.sampled, self.members.given.moving
        fading = max(moving.rates(touch.before).decay, moving.rates(touch.closed).decay)
        back = on = _BACK / fading if fading else math.inf
        if sampled is not None:
            back = min(back, touch.t - float(sampled.time[0]))
            on = min(on, sampled.end - touch.t)
        early = touch.t - joint.t + joint.e
        s = touch.t - max(-on, min(early, back)) - joint.t
        return self._moved(member or self.member(joint), touch.before, joint, s)

    def _moved(self, member: Member, closed: Contacts, joint: Joint, s: float) -> Joint:
        """``joint`` looked at ``s`` seconds later, as ``member`` moves; first order in ``s``."""
        if not s:
            return joint
        phase = member.moving.phase(closed)
        map_ = Map(phase.moved(joint.t, joint.x, s), phase.transition(s))
        if not joint.parameters:
            return joint.moved(s, map_)
        turn = s * self.members.turning(member, closed, joint.x, joint.t)
        other = turn @ (joint.theta - member.values)
        return joint.moved(s, map_._replace(value=map_.value + other), turn)

    def _bounded(self, joint: Joint) -> Joint:
        """``joint`` with parameters that may be."""
        return joint.shifted(self.members.inward(joint.theta, joint.root, joint.of_theta))

    def _jumped(self, touch: Touch, joint: Joint) -> Known:
        """What is known after the jump, at the same instant."""
        pressed: Contacts = ()
        member = self.member(joint)
        moving = member.moving
        if touch.hit:
            gamma = self.system.contact_speed(joint.x[self.system.n :])[list(touch.hit)]
            pressed = touch.pressed(member.newton, gamma)
        before, after = moving.rates(touch.before), moving.rates(touch.closed)
        mirror, forces = member.mirror(pressed), moving.forces(joint.t)
        x, H, D, E = mirror.expanded(before, after, joint.x, forces)
        mean, bent = product(joint.own, D, E)
        x = x + joint.e * (H[:, 0] + E * (joint.e / 2)) + mean
        # Nothing is known better than the motion's own size allows.
        rounded = np.diag(ROUNDING * self.phases.scales.sizes(x))
        replicas = x + joint.apart[:, : 1 + x.size] @ H.T
        whole, moved = joint.root, H @ joint.own
        if joint.parameters and pressed:
            whole = led(joint.root, joint.of_theta)
            seen, own = self._seen(joint, pressed), whole[joint.of_theta, : joint.parameters]
            columns, noise = seen.added(whole[1 : 1 + x.size], own)
            moved, bent = H @ whole[: 1 + x.size], np.hstack([bent, noise])
            moved[:, : joint.parameters] += columns
            replicas = replicas + joint.apart[:, joint.of_theta] @ seen.first
            replicas[0] = x
        root, slow = np.concatenate([moved, bent, rounded], axis=1), whole[1 + x.size :]
        if len(slow):
            left = np.zeros((len(slow), root.shape[1] - slow.shape[1]))
            root = np.concatenate([root, np.concatenate([slow, left], axis=1)])
        root = triangular(root)
        others = joint.slow + joint.apart[:, 1 + x.size :]
        return Known(replicas, others, root, touch.closed, joint.parameters)

    def _seen(self, joint: Joint, pressed: Contacts) -> Sensitivity:
        """How the state after an impact changes with the parameters."""
        steps = self.members.steps(joint.theta, joint.root[joint.of_theta])
        return Sensitivity.of(
            lambda theta: self.members.jumped(theta, joint.x, pressed), joint.theta, steps
        )
