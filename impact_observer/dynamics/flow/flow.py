"""Exact flow of a linear phase ``M du/dt = -C u - K q + f(t)``, ``dq/dt = u``.

Two ways lead to it. ``SpectralFlow`` splits the motion into ``n`` pairs of modes, each in closed
form; it costs a few microseconds. Where that splitting is ill-conditioned (eigenvectors of
a non-proportionally damped system that almost coincide), ``DenseFlow`` takes a matrix
exponential, a hundred times slower, for any spectrum. The response to a sampled forcing is added
to either: ``sampled.py``.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.kernel import Guards, Trace
from impact_observer.model import Forcing
from impact_observer.states import Matrix, Vector

Complex = NDArray[np.complex128]


class Equations(Protocol):
    """What a flow is made from: a ``System``, or one reduced to fewer coordinates.

    ``M`` symmetric positive definite, ``K`` symmetric positive semidefinite, the symmetric part
    of ``C`` positive semidefinite, shape (n, n) each; SI units.
    """

    @property
    def n(self) -> int:
        """Number of coordinates, at least one."""

    @property
    def M(self) -> Matrix:  # noqa: N802
        """Mass matrix."""

    @property
    def C(self) -> Matrix:  # noqa: N802
        """Damping matrix."""

    @property
    def K(self) -> Matrix:  # noqa: N802
        """Stiffness matrix."""

    @property
    def forcing(self) -> Forcing:
        """``f(t)`` on ``n`` coordinates."""


def state_matrix(system: Equations) -> Matrix:
    """``A`` of ``dx/dt = A x + b(t)``, ``x = (q, u)``, shape (2n, 2n)."""
    n = system.n
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -linalg.solve(system.M, system.K, assume_a="pos")
    A[n:, n:] = -linalg.solve(system.M, system.C, assume_a="pos")
    return A


def balanced_state_matrix(system: Equations) -> tuple[Matrix, Vector]:
    """The state matrix of ``x unit``, positions counted in units of velocity, and ``unit``.

    Then its entries are rates, and its norm is about the fastest: a matrix exponential needs no
    more squarings than the motion has oscillations. Shapes (2n, 2n) and (2n,).
    """
    n, A = system.n, state_matrix(system)
    rate = max(np.sqrt(linalg.norm(A[n:, :n], 1)), linalg.norm(A[n:, n:], 1)) or 1.0
    unit = np.concatenate([np.full(n, rate), np.ones(n)])
    return np.asarray(unit[:, None] * A / unit), unit


class Motion(Protocol):
    """One solution of a linear phase, from its initial state.

    Attributes:
        t: when the phase starts, s since the epoch.
    """

    t: float

    @abstractmethod
    def states(self, s: NDArray[np.float64], /) -> NDArray[np.float64]:
        """States at ``s`` seconds after the phase's start.

        Args:
            s: shape (samples,), s.

        Returns:
            States (q, u), shape (samples, 2n).
        """

    def state(self, s: float, /) -> Vector:
        """The state (q, u), shape (2n,), at ``s`` seconds after the phase's start."""
        return np.asarray(self.states(np.array([s]))[0])

    def each(self, s: NDArray[np.float64], /) -> NDArray[np.float64]:
        """``state`` at many instants, equal to the bit, where ``states`` may round differently.

        Args:
            s: shape (samples,), at least one, s.

        Returns:
            States (q, u), shape (samples, 2n).
        """
        return np.array([self.state(at) for at in s.tolist()])


class Functions(NamedTuple):
    """Functions ``rows x + Re(harmonics e^{i omega t}) + constant`` of states and of time.

    Attributes:
        rows: shape (w, 2n).
        harmonics: shape (w, h), a column a harmonic of the forcing.
        constant: shape (w,).
    """

    rows: Matrix
    harmonics: NDArray[np.complex128]
    constant: Vector


class View(ABC):
    """Functions of the motions of one flow, in closed form."""

    guards: Guards
    """What the kernel needs of them."""

    @abstractmethod
    def of(self, motion: Motion, shift: Vector | None = None) -> Trace | None:
        """The functions along ``motion``; None where it has no closed form.

        ``shift``, shape (w,), is added to their constants.
        """


class Flow(ABC):
    """The flow of one linear phase."""

    @abstractmethod
    def start(self, t: float, x: Vector) -> Motion:
        """The motion through state ``x`` = (q, u), shape (2n,), at ``t`` s since the epoch."""

    def view(self, functions: Functions) -> View | None:  # noqa: ARG002
        """``functions`` of this flow's motions in closed form; None where there is none."""
        return None

    @abstractmethod
    def transition(self, s: float) -> Matrix:
        """Propagate the difference of two motions by ``s`` seconds, which may be negative.

        Returns:
            ``e^{As}``, shape (2n, 2n).
        """

    def transitions(self, s: Vector) -> NDArray[np.float64]:
        """``transition`` by each of ``s`` seconds, shape (2n, samples, 2n)."""
        return np.stack([self.transition(at) for at in s.tolist()], axis=1)

    def moved(self, motion: Motion, s: float) -> tuple[Vector, Matrix]:
        """``state`` of a motion of this flow, equal to the bit, and ``transition`` after ``s``."""
        return motion.state(s), self.transition(s)
