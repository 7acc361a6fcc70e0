# SPDX-License-Identifier: Apache-2.0
"""The prediction of state and covariance between two events, while one linear phase lasts."""

from functools import cached_property, partial

import numpy as np

from impact_observer.dynamics import Motion
from impact_observer.filter.gaussian_state import GaussianState, propagate_errors
from impact_observer.filter.members import Members, MotionSensitivity
from impact_observer.filter.process_noise import with_noise
from impact_observer.filter.square_root import narrow, triangular
from impact_observer.kernel._kernel import leading
from impact_observer.states import Matrix, Vector
from impact_observer.turns import give_turn


class LinearPrediction:
    """State and covariance while one linear phase lasts.

    Attributes:
        moving: the system between impacts with the estimated parameters.
    """

    def __init__(self, t: float, state: GaussianState, members: Members, noise: float) -> None:
        """Start at ``t``.

        Args:
            t: s since the epoch.
            state: then.
            members: the family of the system.
            noise: white noise of the accelerations, m/s^1.5.
        """
        self._t = t
        self._start = state
        self._members = members
        given = members.given.moving
        self.moving = members.motion(state.theta) if state.parameters else given
        self._noise = noise
        self._diffusion = partial(given.diffusion, t, state.x, state.closed)
        self._root = state.root
        if members.moving:
            size, p = state.x.size, state.parameters
            self._root = leading(state.root, size, p)
            self._own = self._root[size : size + members.moving]
            others = state.differences[size : size + members.moving]
            self._steps = members.parameters.steps(state.theta, self._own, others)

    @cached_property
    def motion(self) -> Motion:
        """Of the estimate."""
        return self.moving.motion(self._t, self._start.x, self._start.closed)

    def state(self, s: float) -> Vector:
        """The estimate (q, u) after ``s`` seconds, shape (2n,)."""
        if self.moving.is_cheap(self._start.closed, s):
            return self.moved(s)[0]
        return self.motion.state(s)

    def root(self, s: float) -> Matrix:
        """The rows of the covariance's root for (q, u) after ``s`` seconds, shape (2n, any)."""
        return self.full_root(s)[: self._start.x.size]

    def full_root(self, s: float) -> Matrix:
        """The covariance's root after ``s`` seconds, all its rows."""
        return self.root_after(self._transition(s), self._sensitivity(s), s)

    def _transition(self, s: float) -> Matrix:
        closed = self._start.closed
        if self.moving.is_cheap(closed, s):
            return self.moved(s)[1]
        return self.moving.phase(closed).transition(s)

    def moved(self, s: float) -> tuple[Vector, Matrix]:
        """The estimate after ``s`` seconds, and its derivative by the one before."""
        return self.moving.moved(self._t, self._start.x, s, self._start.closed)

    def prior(self, s: float) -> GaussianState:
        """State and covariance after ``s`` seconds."""
        x, transition = self.moved(s)
        sensitivity, differences = self._sensitivity(s), self._start.differences
        root = self.root_after(transition, sensitivity, s)
        by_theta = None if sensitivity is None else sensitivity.first.T
        return self._start._replace(
            x=x,
            root=narrow(root) if sensitivity is None else triangular(root),
            differences=propagate_errors(differences, 0, transition, by_theta),
        )

    def root_after(
        self, transition: Matrix, sensitivity: MotionSensitivity | None, s: float
    ) -> Matrix:
        """``full_root``, where parameters of the motion have this ``sensitivity``, if any."""
        size, root = self._start.x.size, self._root
        if sensitivity is None:
            root = propagate_errors(root, 0, transition)
        else:
            moved = transition @ root[:size] + sensitivity.first.T @ self._own
            noise = sensitivity.noise(root[:size], self._own)
            blank = np.zeros((len(root) - size, noise.shape[1]))
            root = np.block([[moved, noise], [root[size:], blank]])
        return with_noise(root, size, self._noise, self._diffusion, s)

    def remainder(self, s: float) -> Matrix:
        """A root of the covariance of what is not linear in the parameters, shape (2n, any)."""
        size, sensitivity = self._start.x.size, self._sensitivity(s)
        if sensitivity is None:
            return np.zeros((size, 0))
        return sensitivity.noise(self._root[:size], self._own)

    def _sensitivity(self, s: float) -> MotionSensitivity | None:
        """Of the state after ``s`` seconds to the parameters of the motion, if there are any."""
        if not self._members.moving:
            return None
        give_turn()
        start = self._start
        return self._members.motion_sensitivity(
            start.theta, self._steps, t=self._t, x=start.x, s=s, closed=start.closed
        )
