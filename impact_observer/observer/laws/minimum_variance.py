"""The Kalman filter of impact times: what an instant says of the whole state, and how surely."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.dynamics import (
    KEPT,
    ROUNDING,
    Correction,
    Expansion,
    ImpactLaw,
    Measured,
    Mirror,
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
from impact_observer.observer.belief import Belief, Course, Touch
from impact_observer.observer.laws.law import Law
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.states import Matrix, Vector

_STAMP = 1e-9 / math.sqrt(12)
"""Standard deviation of what rounding to 1 ns does to a stamp, s."""
_SHORT = 1e-8
"""Flights that a plant may leave out before it is at rest, relative to the model's time scale."""
_BACK = 8.0
"""How far the fastest fading motion is followed back, in its own time constants."""
_ROUNDS = 6
"""How often a measurement is linearised about what it says itself, at most."""
_SETTLED = 0.05
"""What another linearisation may change, relative to the deviation of what was measured."""


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """The instant of an event and the state then, as one normal vector.

    Attributes:
        t: where the state is looked at, s since the epoch.
        e: how much earlier than ``t`` the event is believed to have been, s.
        x: state (q, u) at ``t``, before the event, shape (2n,).
        root: a square root of the covariance of (e, x); its first row zero but for the first
            entry, shape (1 + 2n, 1 + 2n).
        apart: (e, x) of all replicas less those of the estimate, shape (N, 1 + 2n).
    """

    t: float
    e: float
    x: Vector
    root: Matrix
    apart: Matrix

    def moved(self, phase: Phase, s: float) -> "_Joint":
        """The same, looked at ``s`` seconds later."""
        if not s:
            return self
        Phi = phase.transition(s)
        root, apart = self.root.copy(), self.apart.copy()
        root[1:] = Phi @ root[1:]
        apart[:, 1:] = apart[:, 1:] @ Phi.T
        return _Joint(self.t + s, self.e + s, phase.moved(self.t, self.x, s), root, apart)

    def corrected(self, learnt: Correction, H: Matrix, innovation: Vector) -> "_Joint":
        """The same after a measurement of ``H (e, x)``."""
        change = learnt.gain @ innovation
        return _Joint(
            self.t,
            self.e + float(change[0]),
            self.x + change[1:],
            learnt.root,
            self.apart - (self.apart @ H.T) @ learnt.gain.T,
        )


class _Expected(NamedTuple):
    """What an event is expected to say of a ``_Joint``, linearised.

    Attributes:
        about: the state that it is linearised about, shape (2n,).
        expansion: of what is measured, about it.
        innovation: by what it says something else than ``expansion`` does, shape (k,).
        noise: a square root of the covariance of what is not linear, shape (k, any).
    """

    about: Vector
    expansion: Expansion
    innovation: Vector
    noise: Matrix

    def judged(self, contacts: Contacts, learnt: Correction) -> dict[int, float]:
        """By contact, how far its innovation is from zero, in standard deviations."""
        sizes = np.abs(self.innovation) / learnt.deviations
        return dict(zip(contacts, sizes.tolist(), strict=True))

    def settled(self, found: _Joint) -> bool:
        """Whether linearising about ``found`` instead would change nothing."""
        _, H, D, E = self.expansion
        bent = found.e * (D @ (found.x - self.about) + E * (found.e / 2))
        noise = np.linalg.norm(self.noise, axis=1)
        left = np.linalg.norm(product(found.root, D, E)[1], axis=1)
        scale = np.hypot(H[:, 0] * found.root[0, 0], noise)
        return bool(np.all(np.abs(bent) + np.abs(noise - left) <= _SETTLED * scale))


class MinimumVariance(Law):
    """The estimate of least variance, and that variance, from the instants alone.

    Given the model, an impact is a linear map of the state and says one thing exactly: the gap was
    zero. A release says that the load was, a closed contact that its gap and its speed are. The
    error of a stamp belongs to what is estimated: it enters the jump as well as the gap, so the
    estimate jumps at its own root of the gap, as nearly as the stamp allows. What that leaves of
    products, of the stamp's error and the state's, is noise of known variance.

    A filter with saltation matrices, but with measured instants for its guards: Kong, Payne,
    Council and Johnson, The salted Kalman filter, 2021.

    Attributes:
        clock: standard deviation of a stamp, s.
    """

    name: ClassVar[str] = "minimum-variance"

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare impact law and phases."""
        super().__init__(system, uncertainty)
        self.clock = math.hypot(self.uncertainty.clock_error, _STAMP)
        self._newton = ImpactLaw(system)
        self._phases = Phases(system)
        self._short = _SHORT * self._phases.scales.timescale
        self._phase = lru_cache(KEPT)(self._phase_of)
        self._rates = lru_cache(KEPT)(self._rates_of)
        self._gaps = lru_cache(KEPT)(partial(Measured.gaps, system))
        self._mirror = lru_cache(KEPT)(self._mirror_of)

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """What is declared, and that closed contacts rest."""
        belief = Belief(replicas, root)
        return self._rested(belief, closed, closed, np.zeros(len(closed))) if closed else belief

    def event(self, touch: Touch, belief: Belief) -> Belief:
        """What the event says of the state before it; then the jump, at its own instant."""
        if not touch.hit and touch.before == touch.closed:
            return belief
        joint, innovations = self._heard(touch, self._prior(touch, belief))
        after = self._jumped(touch, joint)
        if touch.closed:
            new = tuple(i for i in touch.closed if i not in touch.before)
            pressing = self._rates(touch.before).along(after.x, self._forces(joint.t))[0]
            left = self._short * self.system.contact_speed(pressing[self.system.n :])
            after = self._rested(after, touch.closed, new, left[list(new)])
        phase, s = self._phase(touch.closed), touch.t - joint.t
        x = phase.moved(joint.t, after.x, s)
        return replace(_carried(after, x, phase.transition(s)), innovations=innovations)

    def course(self, t: float, belief: Belief, closed: Contacts) -> Course:
        """One linear phase for the estimate, the others and the covariance."""
        return _Linear(t, belief, self._phase(closed), self.uncertainty.model_error)

    def _prior(self, touch: Touch, belief: Belief) -> _Joint:
        """Instant and state as they are believed before the event is heard."""
        size = belief.x.size
        root, apart = np.zeros((1 + size, 1 + size)), np.zeros((len(belief.replicas), 1 + size))
        root[0, 0], root[1:, 1:] = self.clock, _root(belief)
        apart[:, 1:] = belief.replicas - belief.x
        return _Joint(touch.t, 0.0, belief.x, root, apart)

    def _heard(self, touch: Touch, prior: _Joint) -> tuple[_Joint, dict[int, float]]:
        """Instant and state, both just before the event, once it is heard.

        Returns:
            What is believed, looked at where the event is believed to have been; and, by contact,
            how far the innovation was from zero, in standard deviations.
        """
        contacts = touch.telling(self._phase(touch.before).held, self.system.forcing)
        found = prior
        judged: dict[int, float] = {}
        for _ in range(_ROUNDS if contacts else 0):
            view = prior.moved(self._phase(touch.before), found.t - prior.t)
            expected = self._expected(touch, contacts, view, found)
            H = expected.expansion.H
            learnt = correction(view.root, H, expected.noise)
            judged = judged or expected.judged(contacts, learnt)
            found = view.corrected(learnt, H, expected.innovation)
            settled = expected.settled(found)
            found = self._at_its_instant(touch, found)
            if settled:
                break
        return found, judged

    def _expected(
        self, touch: Touch, contacts: Contacts, view: _Joint, about: _Joint
    ) -> _Expected:
        """What ``contacts`` should say of ``view``, linearised about another at its instant."""
        forces, phase = self._forces(view.t), self._phase(touch.before)
        measured = self._gaps(contacts) if touch.hit else Measured.loads(phase, contacts, forces)
        expansion = measured.expanded(self._rates(touch.before), about.x, forces)
        mean, bent = product(about.root, expansion.D, expansion.E)
        value = measured.value(view.x)
        return _Expected(
            about.x,
            expansion,
            -(value + expansion.H[:, 0] * view.e + mean),
            np.column_stack([bent, np.diag(measured.rounding(view.x))]),
        )

    def _at_its_instant(self, touch: Touch, joint: _Joint) -> _Joint:
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
        return joint.moved(self._phase(touch.before), s)

    def _jumped(self, touch: Touch, joint: _Joint) -> Belief:
        """What is believed after the jump, at the same instant."""
        pressed: Contacts = ()
        if touch.hit:
            gamma = self.system.contact_speed(joint.x[self.system.n :])[list(touch.hit)]
            pressed = touch.pressed(self._newton, gamma)
        before, after = self._rates(touch.before), self._rates(touch.closed)
        x, H, D, E = self._mirror(pressed).expanded(before, after, joint.x, self._forces(joint.t))
        mean, bent = product(joint.root, D, E)
        x = x + joint.e * (H[:, 0] + E * (joint.e / 2)) + mean
        rounded = np.diag(ROUNDING * np.abs(x))  # nothing is known better than that
        root = triangular(np.column_stack([H @ joint.root, bent, rounded]))
        return Belief(x + joint.apart @ H.T, root)

    def _rested(self, belief: Belief, closed: Contacts, new: Contacts, left: Vector) -> Belief:
        """``g = 0`` and ``gamma = 0`` on ``closed``; those that are ``new`` tell it.

        Args:
            belief: when they close.
            closed: all contacts that are closed from now on.
            new: those that were not.
            left: speeds that a plant may leave out before these rest, shape (len(new),), m/s.
        """
        gaps, speeds = self._gaps(new), Measured.speeds(self.system, new)
        c = np.vstack([gaps.c, speeds.c])
        value = np.concatenate([gaps.value(belief.x), speeds.value(belief.x)])
        floor = [gaps.rounding(belief.x), np.hypot(speeds.rounding(belief.x), left)]
        learnt = correction(_root(belief), c, np.diag(np.concatenate(floor)))
        replicas = belief.replicas - (belief.replicas - belief.x) @ c.T @ learnt.gain.T
        told = Belief(replicas - learnt.gain @ value, learnt.root)
        # That was as good as exact. What is left goes by the way the plant itself comes to rest.
        n, x = self.system.n, self._phases.stopped(told.x, closed)
        slip = self._phases.projection.jump(closed) @ self.system.W[:, list(closed)].T
        still = self._phase(closed).inverse @ self.system.M
        return _carried(told, x, linalg.block_diag(np.eye(n) - slip, still))

    def _forces(self, t: float) -> Matrix:
        """f, df/dt and the next derivative at ``t``, shape (3, n)."""
        return np.asarray(self.system.forcing.derivatives(np.array([t]), 2)[:, 0])

    def _phase_of(self, closed: Contacts) -> Phase:
        return self._phases.phase(self._phases.independent(closed))

    def _rates_of(self, closed: Contacts) -> Rates:
        return Rates(self._phase(closed))

    def _mirror_of(self, pressed: Contacts) -> Mirror:
        return Mirror.of(self.system, self._newton.jump(pressed), pressed)


class _Linear(Course):
    """A belief in one linear phase."""

    def __init__(self, t: float, belief: Belief, phase: Phase, model_error: float) -> None:
        self._belief = belief
        self._phase = phase
        self._model_error = model_error
        self._motion = phase.start(t, belief.x)

    def state(self, s: float) -> Vector:
        return self._motion.state(s)

    def root(self, s: float) -> Matrix:
        return self._astray(self._phase.transition(s) @ _root(self._belief), s)

    def belief(self, s: float) -> Belief:
        found = _carried(self._belief, self.state(s), self._phase.transition(s))
        return replace(found, root=self._astray(_root(found), s))

    def _astray(self, root: Matrix, s: float) -> Matrix:
        """``root`` with what the model's own error adds in ``s`` seconds."""
        if not self._model_error:
            return root
        return triangular(np.hstack([root, diffusion(self._phase, s, self._model_error)]))


def _carried(belief: Belief, x: Vector, map_: Matrix) -> Belief:
    """What ``map_`` makes of deviations from the estimate, and ``x`` of the estimate itself."""
    replicas = (belief.replicas - belief.x) @ map_.T + x
    replicas[0] = x  # in every bit, however many others there are
    return Belief(replicas, map_ @ _root(belief))


def _root(belief: Belief) -> Matrix:
    """The covariance's root, which every belief of this law has."""
    assert belief.root is not None, "a belief of another law"
    return belief.root
