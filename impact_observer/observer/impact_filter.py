"""The Kalman filter of impact times: what an instant says of the whole state, and how surely."""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from impact_observer.dynamics import (
    KEPT,
    ROUNDING,
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
from impact_observer.observer.compiled import Single, compiled_single
from impact_observer.observer.evidence import (
    STILL,
    Evidence,
    far_off,
    likelihood,
    likelihood_of_one,
)
from impact_observer.observer.joint import Expected, Joint
from impact_observer.observer.learning import Unknowns
from impact_observer.observer.linear import Astray, Linear
from impact_observer.observer.members import Member, Members
from impact_observer.observer.resting import rested
from impact_observer.observer.single import ROUNDS, Contact, Fit, State, single
from impact_observer.states import Matrix, Vector

_SHORT = 1e-8
"""Flights that a plant may leave out before it is at rest, relative to the model's time scale."""
_BRIEF = 1e-2
"""Flights that need not be told from rest where they are lower than is known, likewise."""
_BACK = 8.0
"""How far the fastest fading motion is followed back, in its own time constants."""
_NEAR = 1e-7
"""How near an event must be for a jump's expansion to leave out but rounding, likewise."""


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
        astray: what makes knowledge less sure in time; None for nothing.
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
        drift = unknowns.drift * unknowns.deviations
        self.astray = Astray(model_error, drift) if model_error or np.any(drift) else None
        self._near = 0.0
        if system.forcing.sampled is None and not unknowns.family.size:  # nothing jumps or turns
            decay = self.members.given.moving.rates(()).decay
            self._near = _NEAR / max(decay, 1.0 / self.phases.scales.timescale)
        self._contact = lru_cache(KEPT)(self._contact_of)
        self._single: Single = single

    def compile(self) -> None:
        """Have machine code for what nearly every event takes, if any is; see ``compiled.py``.

        Raises:
            UsageError: ``numba`` is not installed.
        """
        if self._near:
            self._single = compiled_single()

    def begin(self, known: Known) -> Known:
        """``known``, and that its closed contacts rest."""
        return rested(self.members, known, known.closed, np.zeros(len(known.closed)))

    def course(self, t: float, known: Known) -> Linear:
        """How ``known`` goes on from ``t`` (s since the epoch) while nothing switches."""
        return Linear(t, known, self.members, self.astray)

    def member(self, known: Known | Joint) -> Member:
        """The system whose parameters are those of an estimate."""
        return self.members.at(known.theta)

    def told(
        self, touch: Touch, known: Known, clock: float
    ) -> tuple[Evidence, Callable[[], Known]]:
        """How an event fits what is known, and what is known after it, for whoever asks.

        Args:
            touch: what is heard, from the contacts that ``known`` has closed.
            known: when it is stamped.
            clock: standard deviation of the stamp, s.
        """
        state, usual = (known.x, known.root, known.apart), None
        if len(known.root) == known.x.size:  # nothing is slow
            usual = self.usually(touch, state, clock)
        if usual is not None:
            (x, root, apart), fit = usual
            after = Known(x, known.slow, root, apart)
            return likelihood_of_one(touch.hit[0], *fit), lambda: after
        return self.generally(touch, known, clock)

    def generally(
        self, touch: Touch, known: Known, clock: float
    ) -> tuple[Evidence, Callable[[], Known]]:
        """``told`` of any event.

        Args:
            touch: this and the others as of ``told``.
            known: likewise.
            clock: likewise.
        """
        prior = self.prior(touch, known, clock)
        evidence = self.evidence(touch, prior)
        return evidence, lambda: self.after(touch, self.heard(touch, prior, evidence))

    def usually(self, touch: Touch, known: State, clock: float) -> tuple[State, Fit] | None:
        """``told`` of an event that is as nearly all are; None of others.

        Args:
            touch: what is heard.
            known: when it is stamped; nothing is slow.
            clock: standard deviation of the stamp, s.
        """
        if not self._near or len(touch.hit) != 1 or touch.before or touch.closed:
            return None
        x, root, apart = known
        state = np.array(x), np.array(root, order="C"), np.array(apart, order="C")
        contact = self._contact(touch.hit[0])
        usual, after, fit = self._single(touch.t, state, clock, contact)
        return (after, fit) if usual else None

    def _contact_of(self, contact: int) -> Contact:
        """What an impact of one contact depends on while none is closed."""
        member = self.members.given
        rows, gap = member.watched((), (contact,), True)
        jump = member.jump((contact,), (), ())
        H, D, _ = np.ascontiguousarray(gap.maps)
        scale = self.phases.scales.of_sizes
        forcing, rest = self.system.forcing, float(rows.rest[0])
        forces = np.array(forcing.frequency), forcing.jet_rows(2)
        return forces, (gap.now, H, D, rest), (jump.now, jump.maps), scale, self._near

    def prior(self, touch: Touch, known: Known, clock: float) -> Joint:
        """Instant and state as they are believed before an event is heard.

        Args:
            touch: what is heard, from the contacts that ``known`` has closed.
            known: when it is stamped.
            clock: standard deviation of the stamp, s.
        """
        d, columns = known.root.shape
        root = np.zeros((1 + d, 1 + columns))
        root[0, 0], root[1:, 1:] = clock, known.root
        if d > known.x.size + known.parameters:
            root[0, 1:] = known.root[-1]
            root = triangular(root)
        joint = Joint.of(touch.t, known.offset, known, root, Joint.apart_of(known))
        return self._at_its_instant(touch, joint) if known.offset else joint

    def evidence(self, touch: Touch, prior: Joint) -> Evidence:
        """How an event fits what is known, if it is what it is said to be."""
        contacts = self._telling(touch)
        if not contacts:
            return Evidence(0.0, {})
        member = self.member(prior)
        expected = self._expected(member, touch, contacts, prior, prior)

        def rate() -> Vector:
            rates, forces = member.moving.rates(touch.before), member.moving.forces(prior.t)
            return rates.along(prior.x, forces)[0]

        apart = far_off(contacts, expected, prior, rate) if touch.hit else None
        return apart or likelihood(contacts, expected, prior)

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
        for _ in range(ROUNDS if contacts else 0):
            view = self._moved(member, touch.before, prior, found.t - prior.t)
            if linear is None:
                expected = self._expected(member, touch, contacts, view, found)
                learnt = expected.learnt(view)
                linear = expected, learnt, learnt.whitened(expected.innovation.tolist())
            (expected, learnt, white), linear = linear, None
            found = view.corrected(learnt, expected.rows(view), white)
            settled = expected.settled(found)
            found = self._bounded(found) if found.parameters else found
            if not (settled and self._is_near(touch, found)):
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
        s, turn = touch.t - joint.t, None
        if not (s or touch.closed):
            return after
        if joint.parameters:
            turn = s * self.members.turning(member, touch.closed, after.x, joint.t)
        x, map_ = member.moving.moved(joint.t, after.x, s, touch.closed)
        return after.carried(x, map_, turn)

    def unheard(self, touch: Touch, known: Known, left: float = 0.0) -> Known:
        """What is known after an event that nobody heard, at the instant of ``touch``.

        It was where the state says, so the instant is as uncertain as that, and says nothing.

        Args:
            touch: what was not heard.
            known: then.
            left: speed that a contact which closes may have left out before it rested, m/s.
        """
        x, root, member, contacts = known.x, known.root, self.member(known), touch.contacts[:1]
        jet = member.watched(touch.before, contacts, bool(touch.hit)).jet
        value, H, D, E = jet.expanded(x, member.moving.forces(touch.t))
        seen = np.hstack([H[:, 1:], self._turn(member, touch, contacts, x, touch.t)])
        late, bend = -float(value[0]), float(E[0])
        deviation = lengths(seen.dot(root[: seen.size]))[0]
        # Where it is slow, an acceleration decides when: s = sqrt(2 g / a), not g / gamma.
        falling = math.sqrt(abs(bend) * (deviation + abs(late)))
        slope = max(float(H[0, 0]), falling, STILL)
        row, e, deviation = -seen / slope, late / slope, deviation / slope
        bent = deviation * lengths(D.dot(root[: x.size]))[0] / slope
        bent += bend / slope * deviation**2 / 2
        apart = Joint.apart_of(known)
        apart[:1] = row.dot(apart[1 : 1 + row.size])
        whole = np.zeros((1 + len(root), 1 + root.shape[1]))
        whole[0, 0], whole[0, 1:], whole[1:, 1:] = bent, row.dot(root[: row.size]), root
        return self.after(touch, Joint.of(touch.t, e, known, triangular(whole), apart), left)

    def wider(self, known: Known, factor: float) -> Known:
        """``known`` with a state that is less sure by ``factor``.

        So are the parameters, but never less than they were at first.
        """
        factors = np.full(len(known.root), factor)
        size, p = known.x.size, known.parameters
        if p:
            now = lengths(known.root[size : size + p])
            most = self._unknowns.deviations / np.maximum(now, STILL)
            factors[size : size + p] = np.maximum(np.minimum(factor, most), 1.0)
        return known._replace(root=known.root * factors[:, None])

    def mirrored(self, contact: int, known: Known) -> Matrix:
        """What an impact of ``contact`` makes of errors, were it told when: shape (2n, 2n)."""
        return self.member(known).mirror(tuple(sorted({*known.closed, contact}))).J

    def speed(self, contact: int, known: Known) -> float:
        """Speed of a contact, m/s."""
        return float(self.system.W[:, contact].dot(known.x[self.system.n :]))

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
        fall = -float(w.dot(rate[n:]))
        if fall <= 0:
            return False
        seen = w.dot(known.root[:n])
        unsure = math.sqrt(seen.dot(seen))
        flight = 2 * speed / fall
        return flight <= self.short or (speed * flight / 4 <= unsure and flight <= self.brief)

    def _telling(self, touch: Touch) -> Contacts:
        """The contacts that say something that is not known already."""
        if touch.hit:
            return touch.hit
        held = self.members.given.moving.phase(touch.before).held
        return touch.telling(held, self.system.forcing)

    def _turn(
        self, member: Member, touch: Touch, contacts: Contacts, x: Vector, t: float
    ) -> Matrix:
        """How what an event measures changes with the parameters, shape (k, p)."""
        if touch.hit:
            return self.members.gap_rows(contacts)
        return self.members.load_rows(member, touch.before, contacts, x, t)

    def _expected(
        self, member: Member, touch: Touch, contacts: Contacts, view: Joint, about: Joint
    ) -> Expected:
        """What ``contacts`` should say of ``view``, linearised about another at its instant.

        ``member`` is the one of ``view``.
        """
        rows, jet = member.watched(touch.before, contacts, bool(touch.hit))
        forces = member.moving.forces(view.t)
        expansion = jet.expanded(about.x, forces)
        mean, bent = product(about.own, expansion.D, expansion.E)
        x, e = view.x, view.e
        value = expansion.value if about is view else rows.value(x, forces[0])
        if e:
            value = value + expansion.H[:, 0] * e
        return Expected(
            about.x,
            expansion,
            self._turn(member, touch, contacts, about.x, view.t),
            -(value + mean),
            bent,
            rows.rounding(self.phases.scales.sizes(x) if touch.hit else x, forces[0]),
        )

    def _is_near(self, touch: Touch, joint: Joint) -> bool:
        """Whether ``joint`` is looked at so near to its event that it need not be moved there."""
        far = max(abs(joint.e), abs(float(joint.root[0, 0])))
        return far <= self._near and not (touch.before or touch.closed)

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
        map_ = member.moving.moved(joint.t, joint.x, s, closed)
        if not joint.parameters:
            return joint.moved(s, map_)
        turn = s * self.members.turning(member, closed, joint.x, joint.t)
        other = turn @ (joint.theta - member.values)
        return joint.moved(s, map_._replace(value=map_.value + other), turn)

    def _bounded(self, joint: Joint) -> Joint:
        """``joint`` with parameters that may be."""
        inward = self.members.inward(joint.theta, joint.root, joint.of_theta)
        return joint._replace(z=joint.z + inward)

    def _jumped(self, touch: Touch, joint: Joint) -> Known:
        """What is known after the jump, at the same instant."""
        pressed: Contacts = ()
        member, size = self.member(joint), joint.size
        if touch.hit:
            n = self.system.n
            gamma = member.gaps(touch.hit).c[:, :n].dot(joint.x[n:])
            pressed = touch.pressed(member.newton, gamma)
        jet = member.jump(pressed, touch.before, touch.closed)
        about = joint.e if self._is_near(touch, joint) else 0.0
        x, H, D, E = jet.expanded(joint.x, member.moving.forces(joint.t), about)
        mean, bent = product(joint.own, D, E)
        x = x + mean
        if e := joint.e - about:
            x += e * (H[:, 0] + E * (e / 2))
        whole, moved, apart = joint.root, H.dot(joint.own), joint.apart[1:].copy()
        if apart.size:
            apart[:size] = H.dot(joint.apart[: 1 + size])
        if joint.parameters and pressed:
            whole = led(joint.root, joint.of_theta)
            seen, own = self._seen(joint, pressed), whole[joint.of_theta, : joint.parameters]
            columns, noise = seen.added(whole[1 : 1 + size], own)
            moved, bent = H.dot(whole[: 1 + size]), np.hstack([bent, noise])
            moved[:, : joint.parameters] += columns
            apart[:size] += seen.first.T.dot(joint.apart[joint.of_theta])
        slow, first = whole[1 + size :], moved.shape[1]
        last = first + bent.shape[1]
        root = np.zeros((size + len(slow), last + size))
        root[:size, :first], root[:size, first:last] = moved, bent
        root[size:, : slow.shape[1]] = slow
        # Nothing is known better than the motion's own size allows.
        root[:size].flat[last :: last + size + 1] = ROUNDING * self.phases.scales.sizes(x)
        root, learnt = triangular(root), joint.z[1 + size :]
        return Known(x, learnt, root, apart, touch.closed, joint.parameters)

    def _seen(self, joint: Joint, pressed: Contacts) -> Sensitivity:
        """How the state after an impact changes with the parameters."""
        steps = self.members.steps(joint.theta, joint.root[joint.of_theta])
        return Sensitivity.of(
            lambda theta: self.members.jumped(theta, joint.x, pressed), joint.theta, steps
        )
