# SPDX-License-Identifier: Apache-2.0
"""The belief that an observer carries from one event to the next, and its prediction."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.bank import Bank
from impact_observer.bank.notes import Note
from impact_observer.events import Contacts
from impact_observer.observer.ensemble import Ensemble
from impact_observer.states import Matrix, Vector

_NOTHING: Mapping[int, float] = MappingProxyType({})
Parameters: TypeAlias = tuple[tuple[str, float, float], ...]
"""Parameters estimated beside the state: name, value, standard deviation, SI units."""


class Learned:
    """Parameters estimated beside the state, computed at the first request."""

    def __init__(self, make: Callable[[], Parameters] = tuple) -> None:
        """``make`` computes the parameters."""
        self._make = make

    @cached_property
    def parameters(self) -> Parameters:
        """Name, value, standard deviation of each."""
        return self._make()


_NO_PARAMETERS = Learned()


class Onset(NamedTuple):
    """A state before an impact.

    Attributes:
        x: (q, u) at the stamp, shape (2n,).
        hit: the contacts that hit.
    """

    x: Vector
    hit: Contacts


class Belief(NamedTuple):
    """Estimate and uncertainty of a law at one instant: a prior or a posterior.

    Attributes:
        ensemble: the estimate, and replicas with other initial states.
        root: a square root ``S`` of the estimate's covariance ``S S^T``, shape (2n, 2n); None for
            a law without covariance.
        bound: certified upper bound of V, J; None where nothing is certified.
        inconsistent: whether events have contradicted the declared model or uncertainty: the
            bound fell below zero.
        innovations: the estimate's gaps at the last event in standard deviations, by contact.
        clock_offset: estimated delay of the sensor's stamps, s.
        learned: estimated parameters, computed at the first request.
        misfit: the warning that the model does not explain the impacts; empty without misfit.
        onset: the state before an impact that has an uncertain instant; the other states are those
            after the jump.
        bank: the hypotheses of a law that has them as arrays.
        flown: how many seconds later than the stamp of its ``bank`` the belief holds.
        noted: decisions on the latest events, of a law with a ``bank``.
        clock_deviation: of a stamp, s, of a law with a ``bank``.
        unmeasured: how long ago each coordinate was measured, shape (n,), s, infinite before the
            first time; None for a law that does not use it.
    """

    ensemble: Ensemble
    root: Matrix | None = None
    bound: float | None = None
    inconsistent: bool = False
    innovations: Mapping[int, float] = _NOTHING
    clock_offset: float = 0.0
    learned: Learned = _NO_PARAMETERS
    misfit: str = ""
    onset: Onset | None = None
    unmeasured: Vector | None = None
    bank: Bank | None = None
    flown: float = 0.0
    noted: tuple[Note, ...] = ()
    clock_deviation: float = 0.0

    @property
    def x(self) -> Vector:
        """The estimate (q, u), shape (2n,)."""
        return self.ensemble.x

    @property
    def parameters(self) -> Parameters:
        """The parameters that are estimated beside the state."""
        return self.learned.parameters

    @property
    def replicas(self) -> Matrix:
        """States (q, u), shape (N, 2n), the estimate first."""
        return self.ensemble.replicas


class Prediction(ABC):
    """A belief as a function of time until the next event.

    Attributes:
        is_plain: whether only the state changes: ``root`` and ``closed`` return None.
        follows_samples: whether each call uses the samples of forces known at the call.
    """

    is_plain: ClassVar[bool] = False
    follows_samples: ClassVar[bool] = False

    @abstractmethod
    def state(self, s: float) -> Vector:
        """The estimate (q, u), shape (2n,), ``s`` seconds after the start."""

    def states(self, s: Vector) -> Matrix:
        """``state`` at each of ``s`` seconds, equal in every bit, shape (samples, 2n)."""
        return np.array([self.state(at) for at in s.tolist()])

    def replicas(self, s: Vector) -> NDArray[np.float64]:
        """States of the replicas that move by themselves, after ``s`` seconds each.

        Shape (N, samples, 2n), the estimate first, which is the only one by default.
        """
        return self.states(s)[None]

    @abstractmethod
    def belief(self, s: float) -> Belief:
        """The whole belief ``s`` seconds after the start: the prior of an event then."""

    def root(self, s: float) -> Matrix | None:
        """``Belief.root`` after ``s`` seconds, without propagating the other replicas."""
        del s
        return None

    def of_grounds(self, ns: int, s: float) -> tuple[Vector, Matrix] | None:
        """What uncertain grounds add to the state (q, u) in the frame of the stops.

        Args:
            ns: nanoseconds since the epoch.
            s: seconds after the start.

        Returns:
            The sum, shape (2n,), and its error, which is added to the first columns of ``root``,
            shape (2n, any); None where the model says the motion of all grounds.
        """
        del ns, s
        return None

    def silence(self, s: float) -> str:
        """The warning that predicted impacts have not come for ``s`` seconds; empty if none is."""
        del s
        return ""

    def closed(self, s: float) -> Contacts | None:
        """Contacts that the estimate holds closed after ``s`` seconds; None for those reported."""
        del s
        return None
