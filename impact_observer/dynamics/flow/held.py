"""The flow of a system in which contacts are held: that of the coordinates left free."""

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.flow import Flow, Functions, Motion, View
from impact_observer.dynamics.flow.reduced_coordinates import ReducedCoordinates
from impact_observer.kernel import Trace
from impact_observer.states import Matrix, Vector


class HeldFlow(Flow):
    """A flow in fewer coordinates, seen in all of them."""

    def __init__(
        self,
        inner: Flow | None,
        free: ReducedCoordinates,
        inverse: Matrix,
        static: tuple[Matrix, Matrix],
    ) -> None:
        """Take the flow in the free coordinates; None where nothing is free.

        Args:
            inner: flow of the free coordinates.
            free: which are free.
            inverse: free coordinates of the nearest motion, shape (r, n).
            static: the part of a position that does not move, as a product of shapes
                (n, held) and (held, n).
        """
        self._inner = inner
        self._free = free
        self._shapes = free.shapes
        self._inverse = inverse
        self._static = static

    def start(self, t: float, x: Vector) -> Motion:
        """The motion through ``x`` at ``t``, without its velocity along held contacts."""
        n = len(self._shapes)
        static, seen = self._static
        rest = static @ (seen @ x[:n])
        if self._inner is None:
            return _HeldMotion(t, None, self._free, rest)
        free = np.concatenate([self._inverse @ (x[:n] - rest), self._inverse @ x[n:]])
        return _HeldMotion(t, self._inner.start(t, free), self._free, rest)

    def view(self, functions: Functions) -> View | None:
        """Of the free coordinates, and of constants that each motion has of its own."""
        if self._inner is None:
            return None
        n = len(self._shapes)
        position, velocity = functions.rows[:, :n], functions.rows[:, n:]
        free = np.hstack([position @ self._shapes, velocity @ self._shapes])
        inner = self._inner.view(functions._replace(rows=free))
        return None if inner is None else _HeldView(inner, position)

    def transition(self, s: float) -> Matrix:
        """That of the free coordinates; velocities along held contacts vanish at once."""
        n, r = self._shapes.shape
        found = np.zeros((2 * n, 2 * n))
        static = self._static[0] @ self._static[1]
        found[:n, :n] = static
        if self._inner is None:
            return found
        free = np.zeros((2 * r, 2 * n))
        free[:r, :n] = self._inverse @ (np.eye(n) - static)
        free[r:, n:] = self._inverse
        moved = self._inner.transition(s) @ free
        found[:n] += self._shapes @ moved[:r]
        found[n:] = self._shapes @ moved[r:]
        return found


class _HeldMotion(Motion):
    def __init__(
        self, t: float, inner: Motion | None, free: ReducedCoordinates, rest: Vector
    ) -> None:
        self.t = t
        self.inner = inner
        self.rest = rest
        self._free = free

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        n = self.rest.size
        found = np.zeros((s.size, 2 * n))
        found[:, :n] = self.rest
        if self.inner is not None:
            y = self.inner.states(s).reshape(2 * s.size, self._free.free.size)
            found += self._free.all(y).reshape(s.size, 2 * n)
        return found


class _HeldView(View):
    """Functions of a motion in fewer coordinates, with the part of the position at rest."""

    def __init__(self, inner: View, position: Matrix) -> None:
        self.guards = inner.guards
        self._inner = inner
        self._position = position

    def of(self, motion: Motion, shift: Vector | None = None) -> Trace | None:
        if not isinstance(motion, _HeldMotion) or motion.inner is None:
            return None
        rest = self._position @ motion.rest
        return self._inner.of(motion.inner, rest if shift is None else rest + shift)
