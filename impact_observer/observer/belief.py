"""What an observer carries from one event to the next, and what a law is told of an event."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import numpy as np

from impact_observer.estimation.ensemble import Ensemble
from impact_observer.estimation.hypotheses import Hypothesis
from impact_observer.events import Contacts
from impact_observer.states import Matrix, Vector

_NOTHING: Mapping[int, float] = MappingProxyType({})


class Fallback(NamedTuple):
    """Where to begin anew if nothing is believed any more.

    Attributes:
        x: (q, u) of a replica that never goes far astray, shape (2n,).
        reach: the largest that each of its numbers was, or may have been at first, shape (2n,).
    """

    x: Vector
    reach: Vector


class Belief(NamedTuple):
    """What a law takes for possible at one instant.

    Attributes:
        ensemble: the estimate, and replicas that began elsewhere.
        root: a square root ``S`` of the estimate's covariance ``S S^T``, shape (2n, 2n); None for
            a law that has none.
        bound: certified upper bound of V, J; None where nothing is certified.
        refuted: whether events have contradicted what was declared: the bound came below zero.
        innovations: of the event before it, by contact: how far the estimate's gap was from
            zero, in standard deviations.
        applied: whether the law took the event for what it is said to be.
        offset: what the sensor's stamps are believed to be late by, s.
        learnt: what was learnt besides the state: name, value, standard deviation, SI units.
        hypotheses: for a law that carries several, the likeliest first; none for others. The
            estimate is that of the first, the covariance that of all together.
        fallback: where such a law begins anew; None for others.
    """

    ensemble: Ensemble
    root: Matrix | None = None
    bound: float | None = None
    refuted: bool = False
    innovations: Mapping[int, float] = _NOTHING
    applied: bool = True
    offset: float = 0.0
    learnt: tuple[tuple[str, float, float], ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    fallback: Fallback | None = None

    @property
    def x(self) -> Vector:
        """The estimate (q, u), shape (2n,)."""
        return self.ensemble.x

    @property
    def replicas(self) -> Matrix:
        """States (q, u), shape (N, 2n), the estimate first."""
        return self.ensemble.replicas


class Prediction(ABC):
    """How a belief goes on until the next event; a function of time alone.

    Attributes:
        is_plain: whether it has neither ``root`` nor ``closed``: nothing but the state changes.
    """

    is_plain: ClassVar[bool] = False

    @abstractmethod
    def state(self, s: float) -> Vector:
        """The estimate (q, u), shape (2n,), ``s`` seconds after the start."""

    def states(self, s: Vector) -> Matrix:
        """``state`` after each of ``s`` seconds, in every bit, shape (samples, 2n)."""
        return np.array([self.state(at) for at in s.tolist()])

    @abstractmethod
    def belief(self, s: float) -> Belief:
        """The whole belief ``s`` seconds after the start."""

    def root(self, s: float) -> Matrix | None:
        """``Belief.root`` after ``s`` seconds, without the other replicas."""
        del s
        return None

    def closed(self, s: float) -> Contacts | None:
        """Contacts that the estimate holds closed after ``s`` seconds; None for those told."""
        del s
        return None
