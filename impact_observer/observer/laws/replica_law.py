"""Laws that correct every replica by itself: the paper's, and whatever is built like them."""

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import special

from impact_observer.dynamics import Clutches, Motion, Phase
from impact_observer.errors import ImpactLawError
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.ensemble import Ensemble
from impact_observer.estimation.uncertainty import Uncertainty
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.laws.law import Law
from impact_observer.states import Matrix, Vector

_BEYOND = 1e-6
"""Probability of an initial error beyond what a certified bound begins with."""


class ReplicaLaw(Law):
    """What one replica does at an impact of the plant, and in between.

    ``impact`` must be given, ``motion`` may be. The other methods serve many replicas at once,
    and certify a bound where a law knows what each event takes away.
    """

    def __init_subclass__(cls) -> None:
        """Who jumps or moves otherwise than what it derives from knows only what it says itself.

        ``phase`` is of ``motion``, and ``energy_removed`` of ``impact``.
        """
        super().__init_subclass__()
        if "impact" in vars(cls) and "energy_removed" not in vars(cls):
            cls.energy_removed = ReplicaLaw.energy_removed  # type: ignore[method-assign]
        if "motion" in vars(cls) and "phase" not in vars(cls):
            cls.phase = ReplicaLaw.phase  # type: ignore[method-assign]

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare sprag clutches and all linear phases."""
        super().__init__(system, uncertainty)
        self._clutches = Clutches(system)

    @cached_property
    def _free(self) -> Phase:
        """Free flight."""
        return self._clutches.phases.phase()

    @abstractmethod
    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """One replica's state after an impact of the plant.

        Args:
            x: the replica's state (q-, u-), shape (2n,); not changed.
            active: indices of the contacts with ``chi = 1`` at this instant, ascending.
            closed: indices of those with ``chi = 1`` from now on, a part of ``active``.

        Returns:
            (q+, u+), shape (2n,).

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
        """

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """One replica's motion until the next event: sprag clutches, unless a law says else.

        Not asked for where all replicas move in one ``phase``.

        Args:
            t: s since the epoch.
            x: the replica's state (q, u), shape (2n,).
            closed: indices of the contacts with ``chi = 1`` meanwhile, ascending.
        """
        return self._clutches.motion(t, x, closed, fix=False)

    def admissible(self, x: Vector) -> Vector:
        """Where a replica begins that is told to begin at ``x``: there, unless a law says else."""
        return x

    def impacts(self, replicas: Matrix, active: Contacts, closed: Contacts) -> Matrix:
        """``impact`` of many replicas, shape (N, 2n): one after the other, or all at once."""
        after = [self.impact(x, active, closed) for x in replicas]
        return np.reshape(after, replicas.shape)

    def phase(self, closed: Contacts) -> Phase | None:
        """The one linear phase, nothing fixed, in which all replicas move; None for several."""
        del closed
        return None

    def energy_removed(self, before: Vector, after: Vector, active: Contacts) -> float | None:
        """What an impact has surely taken away from V, whatever the plant's state is, J.

        None for a law, or for contacts, with which nothing is sure.
        """
        del before, after, active
        return None

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """The replicas in their places; the bound holds but for one start in a million."""
        replicas = np.array([self.admissible(x) for x in replicas])
        if closed:
            replicas = self.impacts(replicas, closed, closed)
        n = self.system.n
        weighted = np.vstack([self.system.K @ root[:n], self.system.M @ root[n:]])
        largest = float(np.linalg.eigvalsh(root.T @ weighted)[-1])
        reach = float(special.chdtri(2 * n, _BEYOND))
        certified = self.energy_removed(replicas[0], replicas[0], ()) is not None
        bound = reach * max(largest, 0.0) / 2 if certified else None
        return Belief(Ensemble.of(replicas), bound=bound)

    def correct(self, change: ContactChange, belief: Belief) -> Belief:
        """Every replica after its own impact."""
        if not change.hit:
            return belief
        before, active, closed = belief.ensemble, change.active, change.closed
        x = self.impact(before.x, active, closed)
        after = Ensemble(x, before.since)
        if before.others:
            after = self.impact_ensemble(before, x, active, closed)
        bound = belief.bound
        if bound is not None:
            taken = self.energy_removed(before.x, x, active)
            bound = None if taken is None else bound - taken
        return self._judged(Belief(after, None, bound, belief.inconsistent))

    def impact_ensemble(
        self, before: Ensemble, x: Vector, active: Contacts, closed: Contacts
    ) -> Ensemble:
        """All replicas after their own impacts.

        Args:
            before: it, at least one besides the estimate.
            x: the estimate after it, shape (2n,), however many others there are.
            active: contacts with ``chi = 1`` at this instant.
            closed: those with ``chi = 1`` from now on.
        """
        others = self._others(before.replicas[1:], active, closed)
        return Ensemble.of(np.concatenate([x[None], others]))

    @staticmethod
    def _judged(belief: Belief) -> Belief:
        """``belief`` without a bound that has come below zero.

        That refutes it: the model is wrong, or the start was not to be expected.
        """
        if belief.bound is None or belief.bound >= 0:
            return belief
        return belief._replace(bound=None, inconsistent=True)

    def _others(self, replicas: Matrix, active: Contacts, closed: Contacts) -> Matrix:
        """The impacts of the other replicas; one without a solution stays apart, as it was."""
        try:
            return self.impacts(replicas, active, closed)
        except ImpactLawError:
            if len(replicas) == 1:
                return replicas
            each = [self._others(x[None], active, closed) for x in replicas]
            return np.concatenate(each)

    def predict(self, t: float, belief: Belief, closed: Contacts) -> Prediction:
        """The estimate by its own motion, the others beside it where all move alike."""
        if (phase := self.phase(closed)) is not None:
            return _Together(phase.start(t, belief.x), belief, phase)
        first = self.motion(t, belief.x, closed)
        others = belief.replicas[1:] if belief.ensemble.others else ()
        return _Apart([first, *(self.motion(t, x, closed) for x in others)], belief)


class _Apart(Prediction):
    """Every replica by its own motion."""

    is_plain: ClassVar[bool] = True

    def __init__(self, motions: Sequence[Motion], belief: Belief) -> None:
        self._motions = motions
        self._belief = belief

    def state(self, s: float) -> Vector:
        return self._motions[0].state(s)

    def states(self, s: Vector) -> Matrix:
        return self._motions[0].each(s)

    def belief(self, s: float) -> Belief:
        replicas = np.array([motion.state(s) for motion in self._motions])
        belief = self._belief
        return Belief(Ensemble.of(replicas), None, belief.bound, belief.inconsistent)


class _Together(Prediction):
    """Differences of replicas in one linear phase: one matrix for all of them."""

    is_plain: ClassVar[bool] = True

    def __init__(self, first: Motion, belief: Belief, phase: Phase) -> None:
        self._first = first
        self._belief = belief
        self._phase = phase

    def state(self, s: float) -> Vector:
        return self._first.state(s)

    def states(self, s: Vector) -> Matrix:
        return self._first.each(s)

    def belief(self, s: float) -> Belief:
        before = self._belief.ensemble
        if before.others:
            after = before.carried(*self._phase.flow.moved(self._first, s))
        else:
            after = Ensemble(self._first.state(s), before.since)
        return Belief(after, None, self._belief.bound, self._belief.inconsistent)
