# SPDX-License-Identifier: Apache-2.0
"""The belief that an observer carries from one event to the next, and its prediction."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.bank import Bank
from impact_observer.bank.notes import Note
from impact_observer.events import Contacts
from impact_observer.states import Matrix, Vector

NOTHING: Mapping[int, float] = MappingProxyType({})
Parameters: TypeAlias = tuple[tuple[str, float, float], ...]
"""Parameters estimated beside the state: name, value, standard deviation, SI units."""


class Onset(NamedTuple):
    """The state before an impact, (q, u) at the stamp, shape (2n,), and the contacts that hit."""

    x: Vector
    hit: Contacts


class Belief(NamedTuple):
    """Estimate and uncertainty of a law at one instant: a prior or a posterior.

    Attributes:
        x: the estimate (q, u), shape (2n,).
        others: by how much replicas with other initial states differ from it, one a column, shape
            (2n, N - 1).
        root: a square root ``S`` of the estimate's covariance ``S S^T``, shape (2n, any); None for
            a law without covariance, or where ``Prediction.root`` has it.
        bound: certified upper bound of V, J; None where nothing is certified.
        inconsistent: whether the bound fell below zero: events contradict what is declared.
        innovations: the estimate's gaps at the last event in standard deviations, by contact.
        clock_offset: estimated delay of the sensor's stamps, s.
        learned: makes the parameters that are estimated beside the state.
        misfit: the warning that the model does not explain the impacts; empty without misfit.
        onset: the state before an impact with an uncertain instant.
        unmeasured: how long ago each coordinate was measured, shape (n,), s, infinite before the
            first time; None for a law that does not use it.
        bank: the hypotheses of a law that has them as arrays.
        flown: how many seconds later than the stamp of its ``bank`` the belief holds.
        noted: decisions on the latest events, of a law with a ``bank``.
        clock_deviation: of a stamp, s, of a law with a ``bank``.
    """

    x: Vector
    others: Matrix
    root: Matrix | None = None
    bound: float | None = None
    inconsistent: bool = False
    innovations: Mapping[int, float] = NOTHING
    clock_offset: float = 0.0
    learned: Callable[[], Parameters] = tuple
    misfit: str = ""
    onset: Onset | None = None
    unmeasured: Vector | None = None
    bank: Bank | None = None
    flown: float = 0.0
    noted: tuple[Note, ...] = ()
    clock_deviation: float = 0.0

    @classmethod
    def of(cls, replicas: Matrix, **others: Any) -> "Belief":  # noqa: ANN401 (as the fields are)
        """``replicas`` (q, u), shape (N, 2n), the estimate first, and other fields by name."""
        x = replicas[0]
        return cls(x, np.subtract(replicas[1:].T, x[:, None], order="C"), **others)

    def moved(self, replicas: Matrix) -> "Belief":
        """The same with other ``replicas``, as of ``of``."""
        now = Belief.of(replicas)
        return self._replace(x=now.x, others=now.others)

    @property
    def replicas(self) -> Matrix:
        """States (q, u), shape (N, 2n), the estimate first."""
        return np.concatenate([self.x[None], self.others.T + self.x])


class Prediction(ABC):
    """A belief as a function of time, ``s`` seconds after it, until the next event.

    Attributes:
        is_plain: whether only the state changes: ``root`` and ``closed`` return None.
        follows_samples: whether each call uses the samples of forces known at the call.
    """

    is_plain: ClassVar[bool] = False
    follows_samples: ClassVar[bool] = False

    @abstractmethod
    def state(self, s: float) -> Vector:
        """The estimate (q, u), shape (2n,)."""

    def states(self, s: Vector) -> Matrix:
        """``state`` at each of ``s``, equal in every bit, shape (samples, 2n)."""
        return np.array([self.state(at) for at in s.tolist()])

    def replicas(self, s: Vector) -> NDArray[np.float64]:
        """States of the replicas that move by themselves, shape (N, samples, 2n).

        The estimate is first, and by default the only one.
        """
        return self.states(s)[None]

    @abstractmethod
    def belief(self, s: float) -> Belief:
        """The whole belief: the prior of an event then."""

    def root(self, s: float) -> Matrix | None:
        """``Belief.root``, without propagating the other replicas; None without covariance."""
        del s
        return None

    def of_grounds(self, ns: int, s: float) -> tuple[Vector, Matrix] | None:
        """What uncertain grounds add to the state in the frame, ``ns`` ns after the epoch.

        Returns:
            The sum, shape (2n,), and its error, which is added to the first columns of ``root``,
            shape (2n, any); None where the model says the motion of all grounds.
        """
        del ns, s
        return None

    def silence(self, s: float) -> str:
        """The warning that predicted impacts have not come; empty without."""
        del s
        return ""

    def closed(self, s: float) -> Contacts | None:
        """Contacts that the estimate holds closed; None for those reported."""
        del s
        return None
