"""The Kalman filter of impact times: what an instant says of the whole state, and how surely."""

import math
from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from scipy import linalg, special

from impact_observer.dynamics import (
    KEPT,
    ROUNDING,
    ImpactLaw,
    Measured,
    Mirror,
    Motion,
    Phase,
    Phases,
    Rates,
    correction,
    diffusion,
    product,
    triangular,
)
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Known, Touch
from impact_observer.observer.joint import Expected, Joint
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
    """

    density: float
    innovations: dict[int, float]


class ImpactFilter:
    """Knowledge of a state before and after events that are what they are said to be.

    Given the model, an impact is a linear map of the state and says one thing exactly: the gap was
    zero. A release says that the load was, a closed contact that its gap and its speed are. The
    error of a stamp belongs to what is estimated: it enters the jump as well as the gap, so the
    estimate jumps at its own root of the gap, as nearly as the stamp allows. What that leaves of
    products, of the stamp's error and the state's, is noise of known variance.

    A filter with saltation matrices, but with measured instants for its guards: Kong, Payne,
    Council and Johnson, The salted Kalman filter, 2021.

    Attributes:
        system: what moves.
        phases: its linear phases.
        short: flights that a plant may leave out before it is at rest, s.
        brief: flights that are left out where they are not known from rest, s.
    """

    def __init__(self, system: System, model_error: float = 0.0) -> None:
        """Prepare impact law and phases.

        Args:
            system: what moves.
            model_error: of the accelerations, as white noise, m/s^1.5.
        """
        self.system = system
        self.phases = Phases(system)
        self.short = _SHORT * self.phases.scales.timescale
        self.brief = _BRIEF * self.phases.scales.timescale
        self._model_error = model_error
        self._newton = ImpactLaw(system)
        self.phase = lru_cache(KEPT)(self._phase_of)
        self._rates = lru_cache(KEPT)(self._rates_of)
        self._gaps = lru_cache(KEPT)(partial(Measured.gaps, system))
        self._mirror = lru_cache(KEPT)(self._mirror_of)
        self._forces = lru_cache(KEPT)(self._forces_at)

    def begin(self, known: Known) -> Known:
        """``known``, and that its closed contacts rest."""
        return self._rested(known, known.closed, np.zeros(len(known.closed)))

    def course(self, t: float, known: Known) -> "Linear":
        """How ``known`` goes on from ``t`` (s since the epoch) while nothing switches."""
        return Linear(t, known, self.phase(known.closed), self._model_error)

    def prior(self, touch: Touch, known: Known, clock: float) -> Joint:
        """Instant and state as they are believed before an event is heard.

        Args:
            touch: what is heard, from the contacts that ``known`` has closed.
            known: when it is stamped.
            clock: standard deviation of the stamp, s.
        """
        d, size = known.root.shape[0], known.x.size
        root = np.zeros((1 + d, 1 + known.root.shape[1]))
        root[0, 0], root[1:, 1:] = clock, known.root
        if d > size:
            root[0, 1:] = known.root[size]
            root = triangular(root)
        joint = Joint(touch.t, known.offset, known.x, known.offset, root, self._apart(known))
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
        expected = self._expected(touch, contacts, prior, prior)
        learnt, (_, H, D, _) = expected.learnt(prior), expected.expansion
        white = linalg.solve_triangular(learnt.innovation, expected.innovation, lower=True)
        density = -0.5 * float(white @ white) - len(contacts) * _NORMAL
        density -= float(np.sum(np.log(np.abs(np.diag(learnt.innovation)))))
        slope = H[:, 0]
        spread = np.linalg.norm(D @ prior.own[1:], axis=1)
        density += float(np.sum(np.log(np.hypot(slope, spread) + _STILL)))
        if len(contacts) == 1:
            surely = max(float(spread[0]), _CLOSING * abs(float(slope[0])), _STILL)
            density += float(special.log_ndtr(slope[0] / surely))
        sizes = np.abs(expected.innovation) / learnt.deviations
        return Evidence(density, dict(zip(contacts, sizes.tolist(), strict=True)))

    def _far(self, touch: Touch, contacts: Contacts, prior: Joint) -> Evidence | None:
        """The evidence of an event that is so far off that no more need be known; else None."""
        if not touch.hit:
            return None
        gaps = self._gaps(contacts)
        rate = self._rates(touch.before).along(prior.x, self._forces(prior.t))[0]
        slope = -gaps.c @ rate
        bend = np.abs(gaps.c @ self._rates(touch.before).A @ rate)
        clock = prior.root[0, 0]
        spread = np.linalg.norm(gaps.c @ prior.own[1:], axis=1)
        most = np.hypot(spread, (np.abs(slope) + bend * clock) * clock)
        most += self._rounding(touch, gaps, prior.x)
        value = np.abs(gaps.value(prior.x) + slope * prior.e)
        sizes = value / most
        if np.max(sizes) < _FAR:
            return None
        innovations = dict(zip(contacts, sizes.tolist(), strict=True))
        return Evidence(-float(sizes @ sizes) / 2, innovations)

    def heard(self, touch: Touch, prior: Joint) -> Joint:
        """Instant and state, both just before the event, once it is heard.

        They are looked at where the event is believed to have been.
        """
        contacts = self._telling(touch)
        found = prior
        for _ in range(_ROUNDS if contacts else 0):
            view = prior.moved(self.phase(touch.before), found.t - prior.t)
            expected = self._expected(touch, contacts, view, found)
            found = view.corrected(
                expected.learnt(view), expected.expansion.H, expected.innovation
            )
            settled = expected.settled(found)
            found = self._at_its_instant(touch, found)
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
        after = self._jumped(touch, joint)
        if touch.closed:
            new = tuple(i for i in touch.closed if i not in touch.before)
            pressing = self._rates(touch.before).along(after.x, self._forces(joint.t))[0]
            short = self.short * self.system.contact_speed(pressing[self.system.n :])
            after = self._rested(after, new, np.hypot(short[list(new)], left))
        phase, s = self.phase(touch.closed), touch.t - joint.t
        return after.carried(phase.moved(joint.t, after.x, s), phase.transition(s))

    def unheard(self, touch: Touch, known: Known, left: float = 0.0) -> Known:
        """What is known after an event that nobody heard, at the instant of ``touch``.

        It was where the state says, so the instant is as uncertain as that, and says nothing.

        Args:
            touch: what was not heard.
            known: then.
            left: speed that a contact which closes may have left out before it rested, m/s.
        """
        x, root = known.x, known.root
        measured = self._watched(touch, touch.contacts[:1], touch.t)
        value, H, D, E = measured.expanded(self._rates(touch.before), x, self._forces(touch.t))
        late, deviation = -float(value[0]), float(np.linalg.norm(H[:, 1:] @ root[: x.size]))
        # Where it is slow, an acceleration decides when: s = sqrt(2 g / a), not g / gamma.
        falling = math.sqrt(abs(float(E[0])) * (deviation + abs(late)))
        slope = max(float(H[0, 0]), falling, _STILL)
        row, e, deviation = -H[:1, 1:] / slope, late / slope, deviation / slope
        bent = deviation * float(np.linalg.norm(D @ root[: x.size])) / slope
        bent += float(E[0]) / slope * deviation**2 / 2
        apart = self._apart(known)
        apart[:, :1] = apart[:, 1 : 1 + x.size] @ row.T
        whole = np.zeros((1 + len(root), 1 + root.shape[1]))
        whole[0, 0], whole[0, 1:], whole[1:, 1:] = bent, row @ root[: x.size], root
        joint = Joint(touch.t, e, x, known.offset, triangular(whole), apart)
        return self.after(touch, joint, left)

    def mirrored(self, contact: int, known: Known) -> Matrix:
        """What an impact of ``contact`` makes of errors, were it told when: shape (2n, 2n)."""
        return self._mirror(tuple(sorted({*known.closed, contact}))).J

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
        rate = self._rates(known.closed).along(known.x, self._forces(t))[0]
        fall = -float(w @ rate[n:])
        if fall <= 0:
            return False
        unsure = float(np.linalg.norm(w @ known.root[:n]))
        flight = 2 * speed / fall
        return flight <= self.short or (speed * flight / 4 <= unsure and flight <= self.brief)

    def _telling(self, touch: Touch) -> Contacts:
        """The contacts that say something that is not known already."""
        return touch.telling(self.phase(touch.before).held, self.system.forcing)

    def _watched(self, touch: Touch, contacts: Contacts, t: float) -> Measured:
        """What is zero at an event: the gaps of those that hit, or the load of one that opens."""
        if touch.hit:
            return self._gaps(contacts)
        return Measured.loads(self.phase(touch.before), contacts, self._forces(t))

    def _rounding(self, touch: Touch, measured: Measured, x: Vector) -> Vector:
        """Standard deviation of what is rounded in what an event measures, shape (k,)."""
        if not touch.hit:
            return measured.rounding(x)
        return measured.rounding(self.phases.scales.sizes(*np.split(x, 2)))

    def _expected(self, touch: Touch, contacts: Contacts, view: Joint, about: Joint) -> Expected:
        """What ``contacts`` should say of ``view``, linearised about another at its instant."""
        measured = self._watched(touch, contacts, view.t)
        forces = self._forces(view.t)
        expansion = measured.expanded(self._rates(touch.before), about.x, forces)
        mean, bent = product(about.own, expansion.D, expansion.E)
        value = measured.value(view.x)
        return Expected(
            about.x,
            expansion,
            -(value + expansion.H[:, 0] * view.e + mean),
            np.column_stack([bent, np.diag(self._rounding(touch, measured, view.x))]),
        )

    def _at_its_instant(self, touch: Touch, joint: Joint) -> Joint:
        """``joint`` looked at where it believes the event to have been.

        Not where no forcing is known, nor so far back that what has faded would be rounding. But
        it may be before an earlier event: where clocks change the order of two impacts, the
        phase between them is wrong by what the first did to the second, within their distance.
        """
        sampled = self.system.forcing.sampled
        fading = max(self._rates(touch.before).decay, self._rates(touch.closed).decay)
        back = on = _BACK / fading if fading else math.inf
        if sampled is not None:
            back = min(back, touch.t - float(sampled.time[0]))
            on = min(on, sampled.end - touch.t)
        early = touch.t - joint.t + joint.e
        s = touch.t - max(-on, min(early, back)) - joint.t
        return joint.moved(self.phase(touch.before), s)

    def _jumped(self, touch: Touch, joint: Joint) -> Known:
        """What is known after the jump, at the same instant."""
        pressed: Contacts = ()
        if touch.hit:
            gamma = self.system.contact_speed(joint.x[self.system.n :])[list(touch.hit)]
            pressed = touch.pressed(self._newton, gamma)
        before, after = self._rates(touch.before), self._rates(touch.closed)
        x, H, D, E = self._mirror(pressed).expanded(before, after, joint.x, self._forces(joint.t))
        mean, bent = product(joint.own, D, E)
        x = x + joint.e * (H[:, 0] + E * (joint.e / 2)) + mean
        # Nothing is known better than the motion's own size allows.
        rounded = np.diag(ROUNDING * self.phases.scales.sizes(*np.split(x, 2)))
        root = np.column_stack([H @ joint.own, bent, rounded])
        offsets = joint.root[1 + x.size :]
        left = np.zeros((len(offsets), root.shape[1] - offsets.shape[1]))
        root = triangular(np.vstack([root, np.hstack([offsets, left])]))
        replicas = x + joint.apart[:, : 1 + x.size] @ H.T
        return Known(replicas, root, joint.offset + joint.apart[:, -1], touch.closed)

    def _rested(self, known: Known, new: Contacts, left: Vector) -> Known:
        """``g = 0`` and ``gamma = 0`` on closed contacts; those that are ``new`` tell it.

        Args:
            known: when they close.
            new: contacts that were not closed before.
            left: speeds that a plant may leave out before these rest, shape (len(new),), m/s.
        """
        closed = known.closed
        if not closed:
            return known
        gaps, speeds, size = self._gaps(new), Measured.speeds(self.system, new), known.x.size
        c = np.vstack([gaps.c, speeds.c])
        value = np.concatenate([gaps.value(known.x), speeds.value(known.x)])
        sizes = self.phases.scales.sizes(*np.split(known.x, 2))
        floor = [gaps.rounding(sizes), np.hypot(speeds.rounding(sizes), left)]
        H = np.hstack([c, np.zeros((len(c), known.root.shape[0] - size))])
        learnt = correction(known.root, H, np.diag(np.concatenate(floor)))
        gain = learnt.gain[:size]
        values = value + (known.replicas - known.x) @ c.T
        offsets = known.offsets - np.sum(values @ learnt.gain[size:].T, axis=1)
        told = Known(known.replicas - values @ gain.T, learnt.root, offsets, closed)
        # That was as good as exact. What is left goes by the way the plant itself comes to rest.
        n, x = self.system.n, self.phases.stopped(told.x, closed)
        slip = self.phases.projection.jump(closed) @ self.system.W[:, list(closed)].T
        still = self.phase(closed).inverse @ self.system.M
        return told.carried(x, linalg.block_diag(np.eye(n) - slip, still))

    @staticmethod
    def _apart(known: Known) -> Matrix:
        """(e, x, b) of all replicas less those of the estimate, shape (N, 2 + 2n)."""
        late = (known.offsets - known.offset)[:, None]
        return np.hstack([late, known.replicas - known.x, late])

    def _forces_at(self, t: float) -> Matrix:
        """f, df/dt and the next derivative at ``t``, shape (3, n)."""
        return np.asarray(self.system.forcing.derivatives(np.array([t]), 2)[:, 0])

    def _phase_of(self, closed: Contacts) -> Phase:
        return self.phases.phase(self.phases.independent(closed))

    def _rates_of(self, closed: Contacts) -> Rates:
        return Rates(self.phase(closed))

    def _mirror_of(self, pressed: Contacts) -> Mirror:
        return Mirror.of(self.system, self._newton.jump(pressed), pressed)


class Linear:
    """What is known while one linear phase lasts.

    Attributes:
        motion: of the estimate.
    """

    def __init__(self, t: float, known: Known, phase: Phase, model_error: float) -> None:
        """Begin at ``t``, s since the epoch."""
        self._known = known
        self._phase = phase
        self._model_error = model_error
        self.motion: Motion = phase.start(t, known.x)

    def state(self, s: float) -> Vector:
        """The estimate (q, u) after ``s`` seconds, shape (2n,)."""
        return self.motion.state(s)

    def root(self, s: float) -> Matrix:
        """The rows of the covariance's root for (q, u) after ``s`` seconds, shape (2n, any)."""
        size = self._known.x.size
        return self._astray(self._phase.transition(s) @ self._known.root[:size], s)

    def known(self, s: float) -> Known:
        """All that is known after ``s`` seconds."""
        found = self._known.carried(self.state(s), self._phase.transition(s))
        return replace(found, root=self._astray(found.root, s))

    def _astray(self, root: Matrix, s: float) -> Matrix:
        """``root`` with what the model's own error adds in ``s`` seconds."""
        if not (self._model_error and s > 0):
            return root
        added = diffusion(self._phase, s, self._model_error)
        wide = np.zeros((len(root), added.shape[1]))
        wide[: len(added)] = added
        return triangular(np.hstack([root, wide]))
