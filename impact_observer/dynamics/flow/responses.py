"""Responses of a system at rest to steps and ramps of force, one class per kind of flow."""

import numpy as np
from scipy import linalg

from impact_observer.dynamics.flow.flow import Complex, Equations, balanced_state_matrix
from impact_observer.dynamics.flow.modes import Modes
from impact_observer.dynamics.flow.sampled import Propagators, Response, ResponseValues
from impact_observer.kernel import divided
from impact_observer.states import Matrix, Vector


def response_of(system: Equations, modes: Modes | None, longest: float) -> Response:
    """The response that goes with the flow of ``system``.

    Args:
        system: whose response.
        modes: from ``split``.
        longest: time of the longest response, s.
    """
    if modes is None:
        return DenseResponse(system, longest)
    if modes.proportional:
        return ProportionalResponse(modes, longest)
    return EigenResponse(system, modes, longest)


class ProportionalResponse(Response):
    """Modes ``y'' + c y' + k y = load``, each with its own coordinate and velocity.

    With eigenvalues ``l1, l2`` all follows from ``S_j = exp[l1, l2, 0, .., 0]`` with ``j`` zeros:
    the velocity after a unit step is ``S_0`` and the coordinate ``S_1``.
    """

    def __init__(self, modes: Modes, longest: float) -> None:
        """Take proportional ``modes``."""
        n = len(modes.J)
        self._shapes = modes.T[:n, 0::2]
        self._stiffness, self._damping = -modes.J[:, 1, 0], -modes.J[:, 1, 1]
        self._points = modes.eigenvalues
        rate = np.max(np.abs(np.stack(self._points)))
        super().__init__(modes.J, np.tile([[0.0], [1.0]], (n, 1, 1)), bool(rate * longest <= 1))

    def loads(self, force: Matrix) -> ResponseValues:
        """Modal accelerations, shape (samples, n, 1, 1)."""
        return np.asarray((force @ self._shapes)[..., None, None])

    def closed_form(self, h: Vector) -> Propagators:
        """Of (n, 2, 2) and twice (n, 2, 1) a time."""
        one, two = self._points
        zero = np.zeros_like(one)
        S0, S1, S2 = (_divided((one, two, zero, zero)[:k], h).real for k in (2, 3, 4))
        position = np.stack([-self._stiffness * S1, S0], axis=-1)
        velocity = np.stack(
            [-self._stiffness * S0, -self._damping * S0 - self._stiffness * S1], axis=-1
        )
        step, ramp = np.stack([S1, S0], axis=-1), np.stack([S2, S1], axis=-1)
        change = np.stack([position, velocity], axis=-2)
        return Propagators(change, step[..., None], ramp[..., None])

    def states(self, y: ResponseValues) -> Matrix:
        """States (q, u), shape (samples, 2n)."""
        return np.hstack([y[:, :, i, 0].real @ self._shapes.T for i in range(2)])


class EigenResponse(Response):
    """Eigenvectors of the state matrix, one of each conjugate pair, with a complex number each."""

    def __init__(self, system: Equations, modes: Modes, longest: float) -> None:
        """Take ``modes`` of ``system`` as complex numbers: the state is ``Re(vectors y)``."""
        n, pair = system.n, modes.rates.oscillates
        left, right = modes.T[:, 0::2], modes.T[:, 1::2]
        up, down = modes.T_inverse[0::2, n:], modes.T_inverse[1::2, n:]
        real = [modes.J[~pair, i, i] for i in range(2)]
        values = np.concatenate([modes.eigenvalues[0][pair], *real]).astype(np.complex128)
        conjugate = left[:, pair] + 1j * right[:, pair]
        self._vectors = np.hstack([conjugate, left[:, ~pair], right[:, ~pair]])
        loads = np.vstack([up[pair] - 1j * down[pair], up[~pair], down[~pair]])
        self._load = linalg.solve(system.M, loads.T, assume_a="pos")
        self._values = values
        one = np.ones((values.size, 1, 1), dtype=np.complex128)
        short = bool(np.max(np.abs(values)) * longest <= 1)
        super().__init__(values[:, None, None], one, short)

    def loads(self, force: Matrix) -> ResponseValues:
        """Shape (samples, r, 1, 1)."""
        return np.asarray((force @ self._load)[..., None, None])

    def closed_form(self, h: Vector) -> Propagators:
        """Of (r, 1, 1) a time."""
        zero = np.zeros_like(self._values)
        change = np.expm1(self._values * h[:, None])
        step, ramp = (_divided((self._values, zero, zero)[:k], h) for k in (2, 3))
        return Propagators(*(part[..., None, None] for part in (change, step, ramp)))

    def states(self, y: ResponseValues) -> Matrix:
        """States (q, u), shape (samples, 2n)."""
        return np.asarray((y[..., 0, 0] @ self._vectors.T).real)


class DenseResponse(Response):
    """The state itself, by the exponential of ``[[A, B, 0], [0, 0, 1], [0, 0, 0]]``."""

    def __init__(self, system: Equations, longest: float) -> None:
        """Assemble the matrix, with positions in units of velocity."""
        n = system.n
        A, unit = balanced_state_matrix(system)
        self._rate, self._unit = unit[0], unit
        self._inverse = linalg.inv(system.M)
        augmented = np.zeros((4 * n, 4 * n))
        augmented[: 2 * n, : 2 * n] = A
        augmented[n : 2 * n, 2 * n : 3 * n] = self._rate * np.eye(n)
        augmented[2 * n : 3 * n, 3 * n :] = self._rate * np.eye(n)
        self._augmented = augmented
        super().__init__(A, np.eye(2 * n)[:, n:], bool(linalg.norm(A, 2) * longest <= 1))

    def loads(self, force: Matrix) -> ResponseValues:
        """Accelerations, shape (samples, n, 1)."""
        return np.asarray((force @ self._inverse)[..., None])

    def closed_form(self, h: Vector) -> Propagators:
        """Of (2n, 2n) and twice (2n, n) a time."""
        n = self._inverse.shape[0]
        distinct, which = np.unique(h, return_inverse=True)
        found = linalg.expm(distinct[:, None, None] * self._augmented)[:, : 2 * n]
        step = found[..., 2 * n : 3 * n] / self._rate
        ramp = found[..., 3 * n :] / self._rate**2
        # The response to a unit displacement is that to the acceleration that it causes.
        change = np.concatenate([step @ self.A[n:, :n], self.A @ step], axis=-1)
        return Propagators(change, step, ramp).of(which)

    def states(self, y: ResponseValues) -> Matrix:
        """States (q, u), shape (samples, 2n)."""
        return np.asarray(y[..., 0].real / self._unit)


def _divided(points: tuple[Complex, ...], h: Vector) -> Complex:
    """Divided differences of the exponential, shape (times, modes)."""
    return divided(np.stack(points), h)
