"""The Kalman filter of impact times: what an instant says of the whole state, and how surely."""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from impact_observer.dynamics import KEPT
from impact_observer.estimation.compiled import Single, compiled_single
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.joint import Expected, Joint
from impact_observer.estimation.likelihood import (
    STILL,
    Likelihood,
    far_off,
    likelihood,
    likelihood_of_one,
)
from impact_observer.estimation.linear import Astray, Linear
from impact_observer.estimation.members import Member, Members
from impact_observer.estimation.parametric import Sensitivity, led
from impact_observer.estimation.resting import rested
from impact_observer.estimation.saltation import ROUNDING
from impact_observer.estimation.single import ROUNDS, Contact, Fit, State, single
from impact_observer.estimation.square_root import lengths, product, triangular
from impact_observer.estimation.unknown_parameters import Unknowns
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
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
        unknowns = unknowns or Unknowns(ParametricFamily(system, ()), np.empty(0))
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

    def begin(self, known: GaussianState) -> GaussianState:
        """``known``, and that its closed contacts rest."""
        return rested(self.members, known, known.closed, np.zeros(len(known.closed)))

    def course(self, t: float, known: GaussianState) -> Linear:
        """How ``known`` goes on from ``t`` (s since the epoch) while nothing switches."""
        return Linear(t, known, self.members, self.astray)

    def member(self, known: GaussianState | Joint) -> Member:
        """The system whose parameters are those of an estimate."""
        return self.members.at(known.theta)

    def told(
        self, change: ContactChange, known: GaussianState, clock: float
    ) -> tuple[Likelihood, Callable[[], GaussianState]]:
        """How an event fits what is known, and what is known after it, for whoever asks.

        Args:
            change: what is heard, from the contacts that ``known`` has closed.
            known: when it is stamped.
            clock: standard deviation of the stamp, s.
        """
        state, usual = (known.x, known.root, known.differences), None
        if len(known.root) == known.x.size:  # nothing is slow
            usual = self.usually(change, state, clock)
        if usual is not None:
            (x, root, differences), fit = usual
            after = GaussianState(x, known.slow, root, differences)
            return likelihood_of_one(change.hit[0], *fit), lambda: after
        return self.generally(change, known, clock)

    def generally(
        self, change: ContactChange, known: GaussianState, clock: float
    ) -> tuple[Likelihood, Callable[[], GaussianState]]:
        """``told`` of any event.

        Args:
            change: this and the others as of ``told``.
            known: likewise.
            clock: likewise.
        """
        prior = self.prior(change, known, clock)
        evidence = self.evidence(change, prior)
        return evidence, lambda: self.after(change, self.heard(change, prior, evidence))

    def usually(
        self, change: ContactChange, known: State, clock: float
    ) -> tuple[State, Fit] | None:
        """``told`` of an event that is as nearly all are; None of others.

        Args:
            change: what is heard.
            known: when it is stamped; nothing is slow.
            clock: standard deviation of the stamp, s.
        """
        if not self._near or len(change.hit) != 1 or change.before or change.closed:
            return None
        x, root, differences = known
        state = np.array(x), np.array(root, order="C"), np.array(differences, order="C")
        contact = self._contact(change.hit[0])
        usual, after, fit = self._single(change.t, state, clock, contact)
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

    def prior(self, change: ContactChange, known: GaussianState, clock: float) -> Joint:
        """Instant and state as they are believed before an event is heard.

        Args:
            change: what is heard, from the contacts that ``known`` has closed.
            known: when it is stamped.
            clock: standard deviation of the stamp, s.
        """
        d, columns = known.root.shape
        root = np.zeros((1 + d, 1 + columns))
        root[0, 0], root[1:, 1:] = clock, known.root
        if d > known.x.size + known.parameters:
            root[0, 1:] = known.root[-1]
            root = triangular(root)
        joint = Joint.of(change.t, known.offset, known, root, Joint.differences_of(known))
        return self._at_its_instant(change, joint) if known.offset else joint

    def evidence(self, change: ContactChange, prior: Joint) -> Likelihood:
        """How an event fits what is known, if it is what it is said to be."""
        contacts = self._telling(change)
        if not contacts:
            return Likelihood(0.0, {})
        member = self.member(prior)
        expected = self._expected(member, change, contacts, prior, prior)

        def rate() -> Vector:
            rates, forces = member.moving.rates(change.before), member.moving.forces(prior.t)
            return rates.along(prior.x, forces)[0]

        differences = far_off(contacts, expected, prior, rate) if change.hit else None
        return differences or likelihood(contacts, expected, prior)

    def heard(
        self, change: ContactChange, prior: Joint, evidence: Likelihood | None = None
    ) -> Joint:
        """Instant and state, both just before the event, once it is heard.

        They are looked at where the event is believed to have been.

        Args:
            change: the event.
            prior: what is known before it.
            evidence: of the same event and ``prior``, to begin with; None to begin without.
        """
        contacts = self._telling(change)
        found, member = prior, self.member(prior)
        linear = evidence and evidence.linear
        for _ in range(ROUNDS if contacts else 0):
            view = self._moved(member, change.before, prior, found.t - prior.t)
            if linear is None:
                expected = self._expected(member, change, contacts, view, found)
                learnt = expected.learnt(view)
                linear = expected, learnt, learnt.whitened(expected.innovation.tolist())
            (expected, learnt, white), linear = linear, None
            found = view.corrected(learnt, expected.rows(view), white)
            settled = expected.settled(found)
            found = self._bounded(found) if found.parameters else found
            if not (settled and self._is_near(change, found)):
                found = self._at_its_instant(change, found, member)
            if settled:
                break
        return found

    def after(self, change: ContactChange, joint: Joint, left: float = 0.0) -> GaussianState:
        """What is known after the event, at the instant at which it is stamped.

        Args:
            change: the event.
            joint: what is known just before it.
            left: speed that a contact which closes may have left out before it rested, m/s.
        """
        after, member = self._jumped(change, joint), self.member(joint)
        if change.closed:
            new = tuple(i for i in change.closed if i not in change.before)
            rates, forces = member.moving.rates(change.before), member.moving.forces(joint.t)
            pressing = rates.along(after.x, forces)[0]
            short = self.short * self.system.contact_speed(pressing[self.system.n :])
            after = rested(self.members, after, new, np.hypot(short[list(new)], left))
        s, turn = change.t - joint.t, None
        if not (s or change.closed):
            return after
        if joint.parameters:
            turn = s * self.members.turning(member, change.closed, after.x, joint.t)
        x, map_ = member.moving.moved(joint.t, after.x, s, change.closed)
        return after.carried(x, map_, turn)

    def missed(
        self, change: ContactChange, known: GaussianState, left: float = 0.0
    ) -> GaussianState:
        """What is known after an event that nobody heard, at the instant of ``change``.

        It was where the state says, so the instant is as uncertain as that, and says nothing.

        Args:
            change: what was not heard.
            known: then.
            left: speed that a contact which closes may have left out before it rested, m/s.
        """
        x, root, member, contacts = known.x, known.root, self.member(known), change.contacts[:1]
        jet = member.watched(change.before, contacts, bool(change.hit)).jet
        value, H, D, E = jet.expanded(x, member.moving.forces(change.t))
        seen = np.hstack([H[:, 1:], self._turn(member, change, contacts, x, change.t)])
        late, bend = -float(value[0]), float(E[0])
        deviation = lengths(seen.dot(root[: seen.size]))[0]
        # Where it is slow, an acceleration decides when: s = sqrt(2 g / a), not g / gamma.
        falling = math.sqrt(abs(bend) * (deviation + abs(late)))
        slope = max(float(H[0, 0]), falling, STILL)
        row, e, deviation = -seen / slope, late / slope, deviation / slope
        bent = deviation * lengths(D.dot(root[: x.size]))[0] / slope
        bent += bend / slope * deviation**2 / 2
        differences = Joint.differences_of(known)
        differences[:1] = row.dot(differences[1 : 1 + row.size])
        whole = np.zeros((1 + len(root), 1 + root.shape[1]))
        whole[0, 0], whole[0, 1:], whole[1:, 1:] = bent, row.dot(root[: row.size]), root
        return self.after(
            change, Joint.of(change.t, e, known, triangular(whole), differences), left
        )

    def wider(self, known: GaussianState, factor: float) -> GaussianState:
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

    def mirrored(self, contact: int, known: GaussianState) -> Matrix:
        """What an impact of ``contact`` makes of errors, were it told when: shape (2n, 2n)."""
        return self.member(known).mirror(tuple(sorted({*known.closed, contact}))).J

    def speed(self, contact: int, known: GaussianState) -> float:
        """Speed of a contact, m/s."""
        return float(self.system.W[:, contact].dot(known.x[self.system.n :]))

    def rests(self, t: float, contact: int, known: GaussianState) -> bool:
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

    def _telling(self, change: ContactChange) -> Contacts:
        """The contacts that say something that is not known already."""
        if change.hit:
            return change.hit
        held = self.members.given.moving.phase(change.before).held
        return change.telling(held, self.system.forcing)

    def _turn(
        self, member: Member, change: ContactChange, contacts: Contacts, x: Vector, t: float
    ) -> Matrix:
        """How what an event measures changes with the parameters, shape (k, p)."""
        if change.hit:
            return self.members.gap_rows(contacts)
        return self.members.load_rows(member, change.before, contacts, x, t)

    def _expected(
        self, member: Member, change: ContactChange, contacts: Contacts, view: Joint, about: Joint
    ) -> Expected:
        """What ``contacts`` should say of ``view``, linearised about another at its instant.

        ``member`` is the one of ``view``.
        """
        rows, jet = member.watched(change.before, contacts, bool(change.hit))
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
            self._turn(member, change, contacts, about.x, view.t),
            -(value + mean),
            bent,
            rows.rounding(self.phases.scales.sizes(x) if change.hit else x, forces[0]),
        )

    def _is_near(self, change: ContactChange, joint: Joint) -> bool:
        """Whether ``joint`` is looked at so near to its event that it need not be moved there."""
        far = max(abs(joint.e), abs(float(joint.root[0, 0])))
        return far <= self._near and not (change.before or change.closed)

    def _at_its_instant(
        self, change: ContactChange, joint: Joint, member: Member | None = None
    ) -> Joint:
        """``joint`` looked at where it believes the event to have been.

        Not where no forcing is known, nor so far back that what has faded would be rounding. But
        it may be before an earlier event: where clocks change the order of two impacts, the
        phase between them is wrong by what the first did to the second, within their distance.
        """
        sampled, moving = self.system.forcing.sampled, self.members.given.moving
        fading = max(moving.rates(change.before).decay, moving.rates(change.closed).decay)
        back = on = _BACK / fading if fading else math.inf
        if sampled is not None:
            back = min(back, change.t - float(sampled.time[0]))
            on = min(on, sampled.end - change.t)
        early = change.t - joint.t + joint.e
        s = change.t - max(-on, min(early, back)) - joint.t
        return self._moved(member or self.member(joint), change.before, joint, s)

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

    def _jumped(self, change: ContactChange, joint: Joint) -> GaussianState:
        """What is known after the jump, at the same instant."""
        pressed: Contacts = ()
        member, size = self.member(joint), joint.size
        if change.hit:
            n = self.system.n
            gamma = member.gaps(change.hit).c[:, :n].dot(joint.x[n:])
            pressed = change.pressed(member.newton, gamma)
        jet = member.jump(pressed, change.before, change.closed)
        about = joint.e if self._is_near(change, joint) else 0.0
        x, H, D, E = jet.expanded(joint.x, member.moving.forces(joint.t), about)
        mean, bent = product(joint.own, D, E)
        x = x + mean
        if e := joint.e - about:
            x += e * (H[:, 0] + E * (e / 2))
        whole, moved, differences = joint.root, H.dot(joint.own), joint.differences[1:].copy()
        if differences.size:
            differences[:size] = H.dot(joint.differences[: 1 + size])
        if joint.parameters and pressed:
            whole = led(joint.root, joint.of_theta)
            seen, own = self._seen(joint, pressed), whole[joint.of_theta, : joint.parameters]
            columns, noise = seen.added(whole[1 : 1 + size], own)
            moved, bent = H.dot(whole[: 1 + size]), np.hstack([bent, noise])
            moved[:, : joint.parameters] += columns
            differences[:size] += seen.first.T.dot(joint.differences[joint.of_theta])
        slow, first = whole[1 + size :], moved.shape[1]
        last = first + bent.shape[1]
        root = np.zeros((size + len(slow), last + size))
        root[:size, :first], root[:size, first:last] = moved, bent
        root[size:, : slow.shape[1]] = slow
        # Nothing is known better than the motion's own size allows.
        root[:size].flat[last :: last + size + 1] = ROUNDING * self.phases.scales.sizes(x)
        root, learnt = triangular(root), joint.z[1 + size :]
        return GaussianState(x, learnt, root, differences, change.closed, joint.parameters)

    def _seen(self, joint: Joint, pressed: Contacts) -> Sensitivity:
        """How the state after an impact changes with the parameters."""
        steps = self.members.steps(joint.theta, joint.root[joint.of_theta])
        return Sensitivity.of(
            lambda theta: self.members.jumped(theta, joint.x, pressed), joint.theta, steps
        )
