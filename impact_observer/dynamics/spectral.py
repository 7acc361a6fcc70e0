"""Flow by modes: ``n`` real 2 x 2 blocks, each in closed form.

With ``x = T y`` the homogeneous phase falls into blocks ``dy/dt = J y``. A block with eigenvalues
``lambda = a +- d`` has ::

    e^{Js} = c(s) I + S(s) (J - a I),   c = e^{as} cosh(ds),   S = e^{as} sinh(ds) / d

which holds for oscillation (``d`` imaginary), overdamping, critical damping and rigid bodies
(``d = 0``) alike. A harmonic ``b e^{mu t}`` adds its steady response ``(mu - J)^{-1} b``, except
near resonance, where that would lose all digits: there the response since the phase's start is
``(exp[l1, mu] + exp[l1, l2, mu] (J - l1)) b`` in divided differences of the exponential.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.dense import DenseFlow, state_matrix
from impact_observer.dynamics.divided_differences import Complex, first, second
from impact_observer.dynamics.flow import Flow, Motion
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_PROPORTIONAL = 1e-12
"""Coupling of modes by damping that counts as rounding, relative to the damping."""
_RIGID = 1e-13
"""``omega^2`` that counts as zero, relative to the stiffest mode's, times n."""
_WORST_CONDITION = 1e4
"""Condition of the modes, in units of energy, beyond which digits would be lost."""
_RESONANCE = 1e-2
"""Distance of a forcing frequency from an eigenvalue that is near, over the fastest rate."""
_SLOW = 0.1
"""The same, 1/s: phases are short against a slower beat, and its steady response is huge."""


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """A splitting of the state into ``n`` pairs.

    Attributes:
        T: columns of pair ``k`` at ``2k`` and ``2k + 1``, shape (2n, 2n).
        T_inverse: shape (2n, 2n).
        J: blocks, shape (n, 2, 2), 1/s.
    """

    T: Matrix
    T_inverse: Matrix
    J: NDArray[np.float64]


def flow_of(system: System) -> Flow:
    """The fastest flow of ``system`` without contact that keeps full accuracy."""
    modes = split(system)
    return DenseFlow(system) if modes is None else SpectralFlow(system, modes)


def split(system: System) -> Modes | None:
    """Split ``system`` into pairs of modes; None where no splitting is well-conditioned."""
    stiffness, shapes = linalg.eigh(system.K, system.M)
    damping = shapes.T @ system.C @ shapes
    coupling = damping - np.diag(np.diag(damping))
    if np.max(np.abs(coupling)) <= _PROPORTIONAL * np.max(np.abs(damping)):
        return _proportional(system, stiffness, np.diag(damping), shapes)
    return _general(system, max(stiffness[-1], 0.0))


def _proportional(system: System, stiffness: Vector, damping: Vector, shapes: Matrix) -> Modes:
    """``M``-orthonormal shapes carry their own coordinate and velocity."""
    n = system.n
    rigid = stiffness <= _RIGID * n * np.max(np.abs(stiffness))
    J = np.zeros((n, 2, 2))
    J[:, 0, 1] = 1.0
    J[:, 1, 0] = -np.where(rigid, 0.0, stiffness)
    J[:, 1, 1] = -np.maximum(damping, 0.0)
    T, T_inverse = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    T[:n, 0::2] = T[n:, 1::2] = shapes
    T_inverse[0::2, :n] = T_inverse[1::2, n:] = shapes.T @ system.M
    return Modes(T, T_inverse, J)


def _general(system: System, stiffest: float) -> Modes | None:
    """Eigenvectors, complex ones as real and imaginary part, real ones two by two."""
    n, A = system.n, state_matrix(system)
    values, vectors = linalg.eig(A)
    upper = np.flatnonzero(values.imag > 0)
    real = np.flatnonzero(values.imag == 0)
    real = real[np.argsort(values[real].real)]
    J = np.zeros((n, 2, 2))
    T = np.zeros((2 * n, 2 * n))
    for k, i in enumerate(upper):
        a, b = values[i].real, values[i].imag
        J[k] = [[a, b], [-b, a]]
        T[:, 2 * k], T[:, 2 * k + 1] = vectors[:, i].real, vectors[:, i].imag
    for k, (i, j) in enumerate(zip(real[0::2], real[1::2], strict=True), start=upper.size):
        J[k] = np.diag([values[i].real, values[j].real])
        T[:, 2 * k], T[:, 2 * k + 1] = vectors[:, i].real, vectors[:, j].real
    energy = np.concatenate([np.full(n, np.sqrt(stiffest) or 1.0), np.ones(n)])
    scaled = energy[:, None] * T
    scaled /= np.linalg.norm(scaled, axis=0)
    if not np.linalg.cond(scaled) < _WORST_CONDITION:
        return None
    return Modes(T, linalg.inv(T), J)


class SpectralFlow(Flow):
    """Flow of a system whose modes are known."""

    def __init__(self, system: System, modes: Modes) -> None:
        """Prepare eigenvalues, steady responses and the pairs that resonate."""
        n, J = system.n, modes.J
        self._n = n
        self._T, self._T_inverse = modes.T, modes.T_inverse
        self._a = (J[:, 0, 0] + J[:, 1, 1]) / 2
        deviator = J - self._a[:, None, None] * np.eye(2)
        self._deviator = deviator
        d2 = deviator[:, 0, 0] ** 2 + deviator[:, 0, 1] * deviator[:, 1, 0]
        self._oscillates = d2 < 0
        self._d = np.sqrt(np.abs(d2))
        determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        fast = self._a - np.where(self._oscillates, 0.0, self._d)
        # The slow eigenvalue a + d would cancel; the product of both is the determinant.
        self._slow = np.where(
            self._oscillates | (fast == 0), self._a, determinant / np.where(fast == 0, 1.0, fast)
        )
        self._prepare_forcing(system)

    def _prepare_forcing(self, system: System) -> None:
        forcing, n = system.forcing, self._n
        omega = np.concatenate([[0.0], forcing.frequency])
        force = np.vstack([forcing.constant, forcing.cosine - 1j * forcing.sine])
        acceleration = linalg.solve(system.M, force.T, assume_a="pos")
        beta = (self._T_inverse[:, n:] @ acceleration).reshape(n, 2, -1).transpose(0, 2, 1)
        imaginary = np.where(self._oscillates, 1j * self._d, 0.0)
        one = np.where(self._oscillates, self._a + imaginary, self._slow)
        two = np.where(self._oscillates, self._a - imaginary, 2 * self._a - self._slow)
        mu = 1j * omega
        distance = np.minimum(abs(mu - one[:, None]), abs(mu - two[:, None]))
        fastest = float(np.max(np.abs(np.concatenate([one, two, omega]))))
        forced = np.any(beta != 0, axis=2)
        near = forced & (distance <= max(_RESONANCE * fastest, _SLOW))
        far = forced & ~near
        # Steady response of the pairs away from resonance, (mu - J)^{-1} beta by Cramer's rule.
        J = self._deviator + self._a[:, None, None] * np.eye(2)
        e, f = mu - J[:, 0, 0][:, None], mu - J[:, 1, 1][:, None]
        g, h = J[:, 0, 1][:, None], J[:, 1, 0][:, None]
        determinant = np.where(far, e * f - g * h, 1.0)
        response = np.stack(
            [f * beta[..., 0] + g * beta[..., 1], h * beta[..., 0] + e * beta[..., 1]], axis=1
        )
        response = np.where(far[:, None, :], response / determinant[:, None, :], 0.0)
        steady = self._T @ response.reshape(2 * n, -1)
        self._steady_constant = steady[:, 0].real
        self._steady_cosine, self._steady_sine = steady[:, 1:].real, -steady[:, 1:].imag
        self._frequency = forcing.frequency
        block, harmonic = np.nonzero(near)
        self._resonant_block = block
        self._resonant_beta = beta[block, harmonic]
        self._resonant_lambda = one[block], two[block], mu[harmonic]

    def start(self, t: float, x: Vector) -> Motion:
        """The motion through ``x`` at ``t``."""
        z = self._T_inverse @ (x - self.steady(np.array([t]))[0])
        return _SpectralMotion(self, t, z.reshape(self._n, 2))

    def steady(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Steady response of all pairs away from resonance, shape (samples, 2n)."""
        if not self._frequency.size:
            return np.broadcast_to(self._steady_constant, (t.size, 2 * self._n))
        angle = np.outer(t, self._frequency)
        return np.asarray(
            self._steady_constant
            + np.cos(angle) @ self._steady_cosine.T
            + np.sin(angle) @ self._steady_sine.T
        )

    def homogeneous(self, z: Matrix, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Free response of pairs ``z``, shape (n, 2), in pairs, shape (samples, n, 2)."""
        s = s[:, None]
        if self._oscillates.all():
            decay, angle = np.exp(self._a * s), self._d * s
            c, S = decay * np.cos(angle), decay * np.sin(angle) / self._d
        else:
            c, S = self._mixed(s)
        return c[..., None] * z + S[..., None] * (self._deviator @ z[..., None])[..., 0]

    def _mixed(self, s: NDArray[np.float64]) -> tuple[Matrix, Matrix]:
        """``c`` and ``S`` where some pairs do not oscillate."""
        decay, angle = np.exp(self._a * s), self._d * s
        slow = np.exp(self._slow * s)
        width = 2 * np.where(self._oscillates, 0.0, angle)
        ratio = np.where(width == 0, 1.0, -np.expm1(-width) / np.where(width == 0, 1.0, width))
        c = np.where(self._oscillates, decay * np.cos(angle), slow * (1 + np.exp(-width)) / 2)
        S = np.where(self._oscillates, decay * s * np.sinc(angle / np.pi), slow * s * ratio)
        return c, S

    def resonant(self, t: float, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Response, since ``t``, of the pairs near resonance, shape (samples, n, 2)."""
        y = np.zeros((s.size, self._n, 2))
        one, two, mu = self._resonant_lambda
        s = s[:, None]
        phi_1, phi_2 = first(one, mu, s), second(one, two, mu, s)
        beta = self._resonant_beta * np.exp(mu * t)[:, None]
        block = self._resonant_block
        shifted = self._deviator[block] + (self._a[block] - one)[:, None, None] * np.eye(2)
        turned = (shifted @ beta[..., None])[..., 0]
        response: Complex = phi_1[..., None] * beta + phi_2[..., None] * turned
        for k, pair in enumerate(block):
            y[:, pair] += response[:, k].real
        return y

    @property
    def resonates(self) -> bool:
        """Whether some pair is forced near its own frequency (gravity on a free body is)."""
        return self._resonant_block.size > 0

    def assemble(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """States from pairs: ``x = T y``, shape (samples, 2n)."""
        return np.asarray(y.reshape(-1, 2 * self._n) @ self._T.T)


class _SpectralMotion(Motion):
    def __init__(self, flow: SpectralFlow, t: float, z: Matrix) -> None:
        self._flow = flow
        self.t = t
        self._z = z

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        flow = self._flow
        y = flow.homogeneous(self._z, s)
        if flow.resonates:
            y = y + flow.resonant(self.t, s)
        return flow.assemble(y) + flow.steady(self.t + s)
