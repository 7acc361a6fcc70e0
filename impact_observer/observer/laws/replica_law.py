# SPDX-License-Identifier: Apache-2.0
"""Laws that correct each replica by itself: those of the papers, and similar ones."""

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import special

from impact_observer.dynamics import Clutches, Motion, Phase
from impact_observer.errors import ImpactLawError
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.law import Law
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.states import Matrix, Vector

_BEYOND = 1e-6
"""Probability of an initial error that exceeds the initial certified bound."""


class ReplicaLaw(Law):
    """A law that moves each replica by itself, at an impact and between impacts.

    A law must define ``impact`` and may define ``motion``. The other methods make it faster for
    many replicas, or certify a bound where the energy that each event removes is known.
    """

    def __init_subclass__(cls) -> None:
        """Check that ``cls`` inherits no method that must agree with one that it overrides.

        Raises:
            TypeError: a method of another law would be used beside a method of ``cls``.
        """
        super().__init_subclass__()
        own = vars(cls)
        for method, other in (("impact", "energy_removed"), ("motion", "phase")):
            inherited = other not in own and getattr(cls, other) is not getattr(ReplicaLaw, other)
            if method in own and inherited:
                raise TypeError(
                    f"{cls.__name__} overrides {method} and inherits {other} of another law:"
                    f" override it too, or write {other} = ReplicaLaw.{other}"
                )

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare sprag clutches and all linear phases."""
        super().__init__(system, uncertainty)
        self._clutches = Clutches(system)

    @cached_property
    def _free(self) -> Phase:
        return self._clutches.phases.phase()

    @abstractmethod
    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """States after an impact of the plant, of one replica or of many at once.

        Args:
            x: the replicas' states (q-, u-), shape (..., 2n); not changed.
            active: indices of the contacts with ``chi = 1`` at this instant, ascending.
            closed: indices of those with ``chi = 1`` from now on, a part of ``active``.

        Returns:
            (q+, u+), of the shape of ``x``.

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
        """

    def motion(self, t: float, x: Vector, closed: Contacts) -> Motion:
        """One replica's motion until the next event; by default contacts close as sprag clutches.

        It begins with ``x``, shape (2n,), at ``t``, s since the epoch; ``closed`` have ``chi =
        1``. Not used where all replicas move in one ``phase``.
        """
        return self._clutches.motion(t, x, closed, fix=False)

    def phase(self, closed: Contacts) -> Phase | None:
        """The linear phase in which all replicas move; None where they move differently."""
        del closed
        return None

    def admissible(self, x: Vector) -> Vector:
        """Initial states, shape (..., 2n), of replicas that are given ``x``; by default ``x``."""
        return x

    def energy_removed(self, before: Vector, after: Vector, active: Contacts) -> float | None:
        """Energy that an impact certainly removes from V, whatever the plant's state is, J.

        None for laws, or contacts, for which nothing is certain. The replica jumps from ``before``
        to ``after``, shape (2n,) each, while ``active`` contacts have ``chi = 1``.
        """
        del before, after, active
        return None

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """Admissible replicas; the bound fails for one initial error in a million."""
        replicas = self.admissible(replicas)
        if closed:
            replicas = self.impact(replicas, closed, closed)
        n = self.system.n
        weighted = np.vstack([self.system.K @ root[:n], self.system.M @ root[n:]])
        largest = float(np.linalg.eigvalsh(root.T @ weighted)[-1])
        reach = float(special.chdtri(2 * n, _BEYOND))
        certified = self.energy_removed(replicas[0], replicas[0], ()) is not None
        bound = reach * max(largest, 0.0) / 2 if certified else None
        return Belief.of(replicas, bound=bound)

    def correct(self, change: ContactChange, prior: Belief) -> Belief:
        """Every replica after its own impact."""
        if not change.hit:
            return prior
        active, bound = change.active, prior.bound
        x = self.impact(prior.x, active, change.closed)
        replicas = x[None]
        if prior.others.size:
            others = self._impacts_if_solvable(prior.replicas[1:], active, change.closed)
            replicas = np.concatenate([replicas, others])
        if bound is not None:
            removed = self.energy_removed(prior.x, x, active)
            bound = None if removed is None else bound - removed
        return self._checked(Belief.of(replicas, bound=bound, inconsistent=prior.inconsistent))

    def _impacts_if_solvable(self, replicas: Matrix, active: Contacts, closed: Contacts) -> Matrix:
        """``impact``; a replica whose impact has no solution keeps its state."""
        try:
            return self.impact(replicas, active, closed)
        except ImpactLawError:
            if len(replicas) == 1:
                return replicas
            each = [self._impacts_if_solvable(x[None], active, closed) for x in replicas]
            return np.concatenate(each)

    @staticmethod
    def _checked(belief: Belief) -> Belief:
        """``belief``; inconsistent and without bound if the bound has fallen below zero.

        The model is wrong then, or the initial error larger than declared.
        """
        if belief.bound is None or belief.bound >= 0:
            return belief
        return belief._replace(bound=None, inconsistent=True)

    def predict(self, t: float, posterior: Belief, closed: Contacts) -> Prediction:
        """Each replica by its own motion, or all in one phase."""
        if (phase := self.phase(closed)) is not None:
            return _CommonPhase(phase.start(t, posterior.x), posterior, phase)
        first = self.motion(t, posterior.x, closed)
        others = posterior.replicas[1:] if posterior.others.size else ()
        return OwnMotions([first, *(self.motion(t, x, closed) for x in others)], posterior)


class OwnMotions(Prediction):
    """Every replica by its own motion."""

    is_plain: ClassVar[bool] = True

    def __init__(self, motions: Sequence[Motion], belief: Belief) -> None:
        """The ``motions`` of all replicas of a ``belief``, the estimate's first."""
        self._motions = motions
        self._belief = belief

    def state(self, s: float) -> Vector:
        """That of the first motion."""
        return self._motions[0].state(s)

    def states(self, s: Vector) -> Matrix:
        """Those of the first motion."""
        return self._motions[0].states(s)

    def replicas(self, s: Vector) -> NDArray[np.float64]:
        """Those of all motions."""
        return np.array([each.states(s) for each in self._motions])

    def belief(self, s: float) -> Belief:
        """All replicas, and the bound of before."""
        return self._belief.moved(np.array([motion.state(s) for motion in self._motions]))


class _CommonPhase(Prediction):
    """All replicas in one linear phase: their differences share one transition matrix."""

    is_plain: ClassVar[bool] = True
    follows_samples: ClassVar[bool] = True

    def __init__(self, first: Motion, belief: Belief, phase: Phase) -> None:
        self._first = first
        self._belief = belief
        self._phase = phase

    def state(self, s: float) -> Vector:
        return self._first.state(s)

    def states(self, s: Vector) -> Matrix:
        return self._first.states(s)

    def replicas(self, s: Vector) -> NDArray[np.float64]:
        first, others = self.states(s), self._belief.others.T
        Phi = self._phase.transitions(s).transpose(2, 0, 1).reshape(others.shape[1], -1)
        moved = first + (others @ Phi).reshape(len(others), *first.shape)
        return np.concatenate([first[None], moved])

    def belief(self, s: float) -> Belief:
        others = self._belief.others
        if others.size:
            others = self._phase.transition(s).dot(others)
        return self._belief._replace(x=self._first.state(s), others=others)
