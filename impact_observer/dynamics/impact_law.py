"""Newton's impact law on any set of contacts at once.

``0 <= gamma+ + eps gamma-  _|_  Lambda >= 0`` with ``u+ = u- + M^-1 W Lambda``: a linear
complementarity problem ``0 <= G Lambda + b _|_ Lambda >= 0`` in ``G = W^T M^-1 W``. With
``G = B^T B``, ``B = L^-1 W``, ``M = L L^T``, it says that ``B Lambda`` is the least velocity jump
that separates, ``min |v|`` subject to ``B^T v >= -b``: it has a solution unless no jump separates.
Lawson and Hanson (Solving Least Squares Problems, chapter 23) turn that into nonnegative least
squares, which scipy solves.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import linalg, optimize

from impact_observer.errors import ImpactLawError
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_RESIDUAL = 1e-9
"""Violation of the law that is rounding, relative to the largest contact speed."""


class ImpactLaw:
    """Newton's impact law of one system."""

    def __init__(self, system: System) -> None:
        """Factorise the mass matrix and prepare ``M^-1 W``, ``G`` and ``B``."""
        factor = linalg.cholesky(system.M, lower=True)
        self._system = system
        self._B = linalg.solve_triangular(factor, system.W, lower=True)
        self._Minv_W = linalg.solve_triangular(factor.T, self._B, lower=False)
        # Plain floats: the law of a single contact is on the path of every event.
        self._single = ((1.0 + system.eps) / np.sum(self._B**2, axis=0)).tolist()

    def velocity_after(self, u: Vector, active: Sequence[int]) -> Vector:
        """Velocities ``u+`` after an impact on the ``active`` contacts.

        Args:
            u: velocities ``u-``, shape (n,), m/s.
            active: indices of all contacts that are closed at this instant.

        Returns:
            Shape (n,), m/s; equal to ``u`` when all active contacts separate anyway.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        if len(active) == 1:
            i = active[0]
            gamma = float(self._system.W[:, i] @ u)
            return u - self._Minv_W[:, i] * (self._single[i] * gamma) if gamma < 0 else u
        return np.asarray(u + self._Minv_W[:, list(active)] @ self.impulses(u, active))

    def impulses(self, u: Vector, active: Sequence[int]) -> Vector:
        """Impulses ``Lambda >= 0`` on the ``active`` contacts, shape (len(active),), Ns.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        active = list(active)
        B, gamma = self._B[:, active], self._system.W[:, active].T @ u
        b = (1.0 + self._system.eps[active]) * gamma
        length = np.linalg.norm(B, axis=0)
        scale = float(np.max(-b / length, initial=0.0))
        if scale == 0:
            return np.zeros(len(active))
        B, b = B / length, b / (length * scale)
        for impulses in _candidates(B, b):
            separation = B.T @ (B @ impulses) + b
            # Both are nonnegative, and one of the two is zero.
            if np.all(np.abs(np.minimum(impulses, separation)) <= _RESIDUAL):
                return np.asarray(np.maximum(impulses, 0.0) * (scale / length))
        raise self._no_solution(active, gamma)

    def _no_solution(self, active: Sequence[int], gamma: Vector) -> ImpactLawError:
        names = [self._system.contact_names[i] for i in active]
        return ImpactLawError(
            f"contacts {', '.join(map(repr, names))}: Newton's impact law has no solution for"
            f" contact speeds {', '.join(f'{g:g}' for g in gamma)} m/s with restitution"
            f" {', '.join(f'{e:g}' for e in self._system.eps[list(active)])};"
            " give contacts that depend on each other a common restitution"
        )


def _candidates(B: Matrix, b: Vector) -> Iterator[Vector]:
    """Impulses that solve the law if anything does, the most accurate first.

    Where ``b = -B^T v`` for some ``v`` (contacts independent, or with a common restitution) the
    law is the optimality condition of ``min |B Lambda - v|``. Otherwise, with ``y >= 0`` the least
    squares solution of ``[B; -b^T] y = (0, ..., 0, 1)``, it is solved by ``y / (1 + b^T y)``.
    """
    towards = np.asarray(linalg.lstsq(B.T, -b)[0])
    for y in _nonnegative(B, towards):
        yield _refined(B, b, y)
        yield y
    for y in _nonnegative(np.vstack([B, -b]), np.append(np.zeros(B.shape[0]), 1.0)):
        yield _refined(B, b, y)
        if (residual := 1.0 + b @ y) > 0:
            yield y / residual


def _nonnegative(A: Matrix, target: Vector) -> list[Vector]:
    """The least squares solution ``y >= 0`` of ``A y = target``; none where the method cycles."""
    try:
        return [np.asarray(optimize.nnls(A, target)[0])]
    except RuntimeError:
        return []


def _refined(B: Matrix, b: Vector, y: Vector) -> Vector:
    """Impulses from the equations of those contacts that take one in ``y``."""
    pressed = y > 0
    impulses = np.zeros(b.size)
    impulses[pressed] = linalg.lstsq(B[:, pressed].T @ B[:, pressed], -b[pressed])[0]
    return impulses
