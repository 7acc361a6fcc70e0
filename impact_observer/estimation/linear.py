# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The prediction of state and covariance between two events, while one linear phase lasts."""

from functools import cached_property, partial

import numpy as np

from impact_observer.dynamics import Motion
from impact_observer.estimation.gaussian_state import GaussianState, propagate_errors
from impact_observer.estimation.members import Members
from impact_observer.estimation.moving_system import transition_of
from impact_observer.estimation.parametric import Map, Sensitivity, leading
from impact_observer.estimation.process_noise import ProcessNoise
from impact_observer.estimation.square_root import narrow, triangular
from impact_observer.states import Matrix, Vector


class LinearPrediction:
    """State and covariance while one linear phase lasts.

    Attributes:
        moving: the system between impacts with the estimated parameters.
    """

    def __init__(
        self, t: float, state: GaussianState, members: Members, noise: ProcessNoise | None
    ) -> None:
        """Start at ``t``.

        Args:
            t: s since the epoch.
            state: then.
            members: the family of the system.
            noise: process noise; None for none.
        """
        self._t = t
        self._start = state
        self._members = members
        given = members.given.moving
        self.moving = members.motion(state.theta) if state.parameters else given
        self._noise = noise
        self._diffusion = partial(given.diffusion, state.closed)
        self._root = state.root
        if members.moving:
            size, p = state.x.size, state.parameters
            self._root = leading(state.root, size, p)
            self._own = self._root[size : size + members.moving]
            self._steps = members.steps(state.theta, self._own)

    @cached_property
    def motion(self) -> Motion:
        """Of the estimate."""
        return self.moving.motion(self._t, self._start.x, self._start.closed)

    def state(self, s: float) -> Vector:
        """The estimate (q, u) after ``s`` seconds, shape (2n,)."""
        if self.moving.is_cheap(self._start.closed, s):
            return self._moved(s)[0]
        return self.motion.state(s)

    def root(self, s: float) -> Matrix:
        """The rows of the covariance's root for (q, u) after ``s`` seconds, shape (2n, any)."""
        if self._members.moving:
            return self.full_root(s)[: self._start.x.size]
        size = self._start.x.size
        return self._with_noise(self._transition(s) @ self._root[:size], s)

    def full_root(self, s: float) -> Matrix:
        """The covariance's root after ``s`` seconds, all its rows."""
        transition = self._transition(s)
        if self._members.moving:
            return self._with_noise(self._propagated(transition, self._sensitivity(s)), s)
        return self._with_noise(propagate_errors(self._root, 0, transition), s)

    def _transition(self, s: float) -> Matrix:
        if self.moving.guided:
            return transition_of(self.motion, s)
        if self.moving.is_cheap(self._start.closed, s):
            return self._moved(s)[1]
        return self.moving.phase(self._start.closed).transition(s)

    def _moved(self, s: float) -> tuple[Vector, Matrix]:
        return self.moving.moved(self._t, self._start.x, s, self._start.closed)

    def prior(self, s: float) -> GaussianState:
        """State and covariance after ``s`` seconds."""
        x, transition = self._moved(s)
        if not self._members.moving:
            prior = self._start.propagated(x, transition)
            return (
                prior
                if self._noise is None
                else prior._replace(root=narrow(self._with_noise(prior.root, s)))
            )
        sensitivity = self._sensitivity(s)
        first = np.zeros((x.size, self._start.parameters))
        first[:, : self._members.moving] = sensitivity.first.T
        root = self._with_noise(self._propagated(transition, sensitivity), s)
        return self._start.propagated(x, transition, first)._replace(root=triangular(root))

    def _with_noise(self, root: Matrix, s: float) -> Matrix:
        """``root`` with the process noise of ``s`` seconds."""
        if self._noise is None:
            return root
        return self._noise.added_to(root, self._start.x.size, self._diffusion, s)

    def _propagated(self, transition: Matrix, sensitivity: Sensitivity) -> Matrix:
        """The root after some time, all rows, where parameters of the motion are estimated."""
        size, root = self._start.x.size, self._root
        moved = transition @ root[:size] + sensitivity.first.T @ self._own
        noise = sensitivity.noise(root[:size], self._own)
        blank = np.zeros((len(root) - size, noise.shape[1]))
        return np.block([[moved, noise], [root[size:], blank]])

    def _sensitivity(self, s: float) -> Sensitivity:
        """Of the state after ``s`` seconds to the parameters of the motion."""
        q, t, x, closed = self._members.moving, self._t, self._start.x, self._start.closed

        def at(theta: Vector) -> Map:
            return self._members.motion(theta).flow_map(t, x, s, closed)

        return Sensitivity(at, self._start.theta[:q], self._steps)
