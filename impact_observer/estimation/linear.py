"""What is known between two events, while one linear phase lasts."""

import math
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics import Motion, Phase
from impact_observer.estimation.gaussian_state import GaussianState, carried
from impact_observer.estimation.members import Members
from impact_observer.estimation.parametric import Map, Sensitivity, led
from impact_observer.estimation.process_noise import diffusion
from impact_observer.estimation.square_root import triangular
from impact_observer.states import Matrix, Vector

_MINUTE = 60.0
"""s"""


class Astray(NamedTuple):
    """What is not known of a motion that nothing disturbs.

    Attributes:
        model_error: of the accelerations, as white noise, m/s^1.5.
        drift: what parameters go astray by in a minute, shape (p,).
    """

    model_error: float
    drift: Vector

    def gone(self, phase: Phase, root: Matrix, s: float) -> Matrix:
        """A covariance's root with what ``s`` seconds of ``phase`` add to it.

        Args:
            phase: what moves.
            root: of (q, u) and, maybe, what is slow, shape (2n or more, any).
            s: seconds.
        """
        size, columns = 2 * phase.equations.n, [root]
        if self.model_error and s > 0:
            added = diffusion(phase, s, self.model_error)
            columns.append(np.pad(added, ((0, len(root) - size), (0, 0))))
        if np.any(self.drift) and s > 0 and len(root) > size:
            added = np.diag(self.drift * math.sqrt(s / _MINUTE))
            columns.append(np.pad(added, ((size, len(root) - size - len(added)), (0, 0))))
        return triangular(np.hstack(columns)) if len(columns) > 1 else root


class Linear:
    """What is known while one linear phase lasts.

    Attributes:
        motion: of the estimate.
    """

    def __init__(
        self, t: float, known: GaussianState, members: Members, astray: Astray | None
    ) -> None:
        """Begin at ``t``, s since the epoch.

        Args:
            t: s since the epoch.
            known: then.
            members: the family of what moves.
            astray: what makes it less sure in time; None for nothing.
        """
        self._t = t
        self._known = known
        self._members = members
        moving = members.motion(known.theta) if known.parameters else members.given.moving
        self._phase = moving.phase(known.closed)
        self._noise = astray
        self.motion: Motion = self._phase.start(t, known.x)
        self._root = known.root
        if members.moving:
            size, p = known.x.size, known.parameters
            self._root = led(known.root, slice(size, size + p))
            self._own = self._root[size : size + members.moving]
            self._steps = members.steps(known.theta, self._own)

    def state(self, s: float) -> Vector:
        """The estimate (q, u) after ``s`` seconds, shape (2n,)."""
        return self.motion.state(s)

    def root(self, s: float) -> Matrix:
        """The rows of the covariance's root for (q, u) after ``s`` seconds, shape (2n, any)."""
        if self._members.moving:
            return self.whole(s)[: self._known.x.size]
        size = self._known.x.size
        return self._gone(self._phase.transition(s) @ self._root[:size], s)

    def whole(self, s: float) -> Matrix:
        """The covariance's root after ``s`` seconds, all its rows."""
        if self._members.moving:
            return self._gone(self._carried(self._phase.transition(s), self._seen(s)), s)
        return self._gone(carried(self._root, 0, self._phase.transition(s)), s)

    def known(self, s: float) -> GaussianState:
        """All that is known after ``s`` seconds."""
        x, transition = self._phase.flow.moved(self.motion, s)
        if not self._members.moving:
            known = self._known.carried(x, transition)
            return known if self._noise is None else known._replace(root=self._gone(known.root, s))
        seen = self._seen(s)
        turn = np.zeros((x.size, self._known.parameters))
        turn[:, : self._members.moving] = seen.first.T
        root = self._gone(triangular(self._carried(transition, seen)), s)
        return self._known.carried(x, transition, turn)._replace(root=root)

    def _gone(self, root: Matrix, s: float) -> Matrix:
        """``root`` with what ``s`` seconds add to what is not known."""
        return root if self._noise is None else self._noise.gone(self._phase, root, s)

    def _carried(self, transition: Matrix, seen: Sensitivity) -> Matrix:
        """The root after some time, all rows, where parameters of the motion are learnt."""
        size, q = self._known.x.size, self._members.moving
        moved = transition @ self._root[:size]
        columns, noise = seen.added(self._root[:size], self._own[:, :q])
        moved[:, :q] += columns
        blank = np.zeros((len(self._root) - size, noise.shape[1]))
        return np.block([[moved, noise], [self._root[size:], blank]])

    def _seen(self, s: float) -> Sensitivity:
        """How the state after ``s`` seconds changes with the parameters of the motion."""
        q, t, x, closed = self._members.moving, self._t, self._known.x, self._known.closed

        def moved(theta: Vector) -> Map:
            return self._members.motion(theta).moved(t, x, s, closed)

        return Sensitivity.of(moved, self._known.theta[:q], self._steps)
