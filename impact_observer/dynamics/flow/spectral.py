"""Flow by modes: ``n`` real 2 x 2 blocks, each in closed form.

With ``x = T y`` the homogeneous phase falls into blocks ``dy/dt = J y``. A block with eigenvalues
``lambda = a +- d`` has ::

    e^{Js} = c(s) I + S(s) (J - a I),   c = e^{as} cosh(ds),   S = e^{as} sinh(ds) / d

which holds for oscillation (``d`` imaginary), overdamping, critical damping and rigid bodies
(``d = 0``) alike. A harmonic ``b e^{mu t}`` adds its steady response ``(mu - J)^{-1} b``, except
near resonance, where that would lose all digits: there the response since the phase's start is
``(exp[l1, mu] + exp[l1, l2, mu] (J - l1)) b`` in divided differences of the exponential.
So it is for a while where the steady response is huge against the state, as that of a load on
a soft spring: then both are rounded to the motion's own size. No constant here is a time.
"""

import math
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.flow.angles import Angles
from impact_observer.dynamics.flow.dense import DenseFlow
from impact_observer.dynamics.flow.divided_differences import Complex
from impact_observer.dynamics.flow.driven import Driven
from impact_observer.dynamics.flow.few import product_with
from impact_observer.dynamics.flow.flow import Equations, Flow, Functions, Motion
from impact_observer.dynamics.flow.modes import Modes, split
from impact_observer.dynamics.flow.responses import response_of
from impact_observer.dynamics.flow.sampled import SampledFlow
from impact_observer.dynamics.flow.turning import Steady, Turning
from impact_observer.dynamics.flow.waves import Aging, Rows, View, Waves
from impact_observer.states import Matrix, Vector

_RESONANCE = 1e-2
"""Distance of a forcing frequency from an eigenvalue that is near, over the rates of both."""
_HUGE = 30.0
"""Steady response, over the state, that would cost digits while the motion is young."""
_NOW = np.zeros(1)


def flow_of(system: Equations, shapes: Matrix | None = None) -> Flow:
    """The fastest flow of ``system`` without contact that keeps full accuracy.

    Args:
        system: what moves.
        shapes: of its undamped modes by LAPACK, shape (n, n), if available.
    """
    modes = split(system, shapes)
    flow = DenseFlow(system) if modes is None else SpectralFlow(system, modes)
    samples = system.forcing.sampled
    if samples is None:
        return flow
    longest = float(np.max(samples.steps))
    return SampledFlow(flow, response_of(system, modes, longest), samples)


class SpectralFlow(Flow):
    """Flow of a system in its modes."""

    def __init__(self, system: Equations, modes: Modes) -> None:
        """Prepare eigenvalues, steady responses and the pairs that resonate."""
        self._n = system.n
        self._inertia, self._sprung = product_with(system.M), product_with(system.K)
        self.modes = modes
        self._prepare_forcing(system, modes)

    def _prepare_forcing(self, system: Equations, modes: Modes) -> None:
        forcing = system.forcing
        mu = 1j * np.concatenate([[0.0], forcing.frequency])
        forces = np.vstack([forcing.constant, forcing.cosine, forcing.sine])
        acceleration = linalg.solve(system.M, forces.T, assume_a="pos")
        pushed = np.concatenate([np.zeros(acceleration.shape), acceleration]).T
        loads = np.stack([modes.pairs(each) for each in pushed], axis=1)
        constant, cosine, sine = np.split(loads, [1, mu.size], axis=1)
        beta = np.concatenate([constant, cosine - 1j * sine], axis=1)
        one, two = modes.eigenvalues
        distance = np.minimum(abs(mu - one[:, None]), abs(mu - two[:, None]))
        fastest = float(np.max(np.abs(np.concatenate([one, two, mu]))))
        forced = np.any(beta != 0, axis=2)
        # Eigenvalues that are found all together are rounded to the fastest of them.
        rates = np.abs(one)[:, None] + np.abs(mu) if modes.proportional else fastest
        near = forced & (distance <= _RESONANCE * rates)
        far = forced & ~near
        # Steady response of the pairs away from resonance, (mu - J)^{-1} beta by Cramer's rule.
        e, f = mu - modes.J[:, 0, 0][:, None], mu - modes.J[:, 1, 1][:, None]
        g, h = modes.J[:, 0, 1][:, None], modes.J[:, 1, 0][:, None]
        determinant = np.where(far, e * f - g * h, 1.0)
        response = np.stack(
            [f * beta[..., 0] + g * beta[..., 1], h * beta[..., 0] + e * beta[..., 1]], axis=1
        )
        response = np.where(far[:, None, :], response / determinant[:, None, :], 0.0)
        steady = modes.states(response.real) + 1j * modes.states(response.imag)
        self._steady_constant = steady[:, 0].real
        self._steady_cosine, self._steady_sine = steady[:, 1:].real, -steady[:, 1:].imag
        self._angles = Angles(forcing.frequency)
        self._small = self.energy(np.abs(steady).sum(axis=1)) / _HUGE
        # Motions that are not so small are recognised by their speed, with one product.
        least = float(linalg.eigvalsh(system.M)[0]) if modes.shapes is None else 0.0
        self._slow = self._small**2 / least if least > 0 else math.inf
        self._young = 1.0 / np.min(distance[far], initial=np.inf)
        self.near = Driven(modes, beta, self._angles, near)
        self.all = Driven(modes, beta, self._angles, forced)

    @cached_property
    def turning(self) -> Turning | None:
        """One state alone, in a cheaper way; None where not all modes turn, or some resonate.

        Nor is it of many modes, where calls cost less than what is multiplied.
        """
        few = self.modes.shapes is None
        if not (few and self.near.nothing and Turning.suits(self.modes)):
            return None
        parts = (self._steady_constant, self._steady_cosine, self._steady_sine)
        return Turning(self.modes, Steady(self._angles, *parts))

    def view(self, functions: Functions) -> View:
        """Of motions young and old."""
        return _SpectralView(self, functions)

    def rows(self, functions: Functions, *, young: bool) -> Rows:
        """What ``functions`` see of the pairs, and of harmonics with a steady response or none."""
        rows, harmonics, constant = functions
        seen = rows @ self.modes.T
        if young:
            return Rows(self.modes, seen, (self._angles, harmonics, constant), self.all)
        steady = rows @ (self._steady_cosine - 1j * self._steady_sine)
        constant = constant + rows @ self._steady_constant
        return Rows(self.modes, seen, (self._angles, harmonics + steady, constant), self.near)

    def energy(self, x: Vector) -> float:
        """Size of a state (q, u), shape (2n,), square root of twice its energy."""
        q, u = x[: self._n], x[self._n :]
        return math.sqrt(max(float(u.dot(self._inertia(u)) + q.dot(self._sprung(q))), 0.0))

    def start(self, t: float, x: Vector) -> Motion:
        """The motion through ``x`` at ``t``."""
        old = _SpectralMotion(self, t, x)
        u = x[self._n :]
        if float(u.dot(u)) < self._slow and self.energy(x) < self._small:
            return _YoungMotion(self, self.modes.pairs(x), old, self._young)
        return old

    def transition(self, s: float) -> Matrix:
        """``T e^{Js} T^{-1}``, shape (2n, 2n)."""
        if self.turning is not None:
            return self.turning.transition(s)
        c, S = self.modes.rates.propagated(np.array([s]))[..., None]
        blocks = c * np.eye(2) + S * self.modes.deviator
        T = self.modes.T
        moved = np.einsum("xpi,pij->xpj", T.reshape(-1, self._n, 2), blocks)
        return np.asarray(moved.reshape(T.shape) @ self.modes.T_inverse)

    def moved(self, motion: Motion, s: float) -> tuple[Vector, Matrix]:
        """Both of what turns by the same."""
        if self.turning is None or not isinstance(motion, _SpectralMotion):
            return super().moved(motion, s)
        return self.turning.moved(motion.turned(self.turning), s)

    def steady(self, t: float, s: Vector) -> NDArray[np.float64]:
        """Steady response of all pairs away from resonance ``s`` after ``t``, (2n, samples)."""
        if not self._angles.frequency.size:
            return np.broadcast_to(self._steady_constant[:, None], (2 * self._n, s.size))
        angle = self._angles.after(t, s)
        found: NDArray[np.float64] = self._steady_cosine @ np.cos(angle)
        found += self._steady_sine @ np.sin(angle)
        found += self._steady_constant[:, None]
        return found

    def homogeneous(self, z: Matrix, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Free response of pairs ``z``, shape (n, 2), shape (n, 2, samples)."""
        c, S = self.modes.rates.propagated(s)[:, :, None]
        found: NDArray[np.float64] = c * z[..., None]
        found += S * (self.modes.deviator @ z[..., None])
        return found

    def assemble(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """States from pairs: ``x = T y``, shape (2n, samples)."""
        return self.modes.states(y)

    def each(self, y: NDArray[np.float64], t: float, s: Vector) -> NDArray[np.float64]:
        """``assemble(y) + steady(t, s)`` as for each sample alone, shape (samples, 2n).

        The products are those of a matrix with one column, over and over: one product with many
        columns may add up in another order.
        """
        found = self.modes.T @ _columns(y)
        if not self._angles.frequency.size:
            return np.asarray((found + self._steady_constant[:, None])[..., 0])
        angle = self._angles.after(t, s)
        steady = self._steady_cosine @ _columns(np.cos(angle))
        steady += self._steady_sine @ _columns(np.sin(angle))
        steady += self._steady_constant[:, None]
        return np.asarray((found + steady)[..., 0])


def _columns(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """What comes with samples last as one column a sample, shape (samples, rows, 1)."""
    rows = samples.reshape(-1, samples.shape[-1])
    return np.ascontiguousarray(rows.T)[..., None]


class _SpectralMotion(Motion):
    """Steady response, free motion of pairs from ``z`` on, and the answer of those resonant."""

    def __init__(self, flow: SpectralFlow, t: float, x: Vector) -> None:
        self._flow = flow
        self.t = t
        self._x = x
        self._zeta: Complex | None = None

    @cached_property
    def z(self) -> Matrix:
        return self._flow.modes.pairs(self._x - self._flow.steady(self.t, _NOW)[:, 0])

    def state(self, s: float) -> Vector:
        turning = self._flow.turning
        return super().state(s) if turning is None else turning.state(self.turned(turning), s)

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        flow = self._flow
        y = flow.near.response(self.t, flow.homogeneous(self.z, s), s)
        return np.ascontiguousarray((flow.assemble(y) + flow.steady(self.t, s)).T)

    def each(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        flow = self._flow
        if flow.turning is not None:
            return flow.turning.each(self.turned(flow.turning), s)
        if not flow.near.nothing or flow.modes.shapes is not None:
            return super().each(s)  # what is near resonance, or left out, depends on the others
        return flow.each(flow.homogeneous(self.z, s), self.t, s)

    def turned(self, turning: Turning) -> Complex:
        """``zeta`` at the start, computed when first needed."""
        if self._zeta is None:
            self._zeta = turning.start(self.t, self._x)
        return self._zeta


class _SpectralView(View):
    """Functions of motions young and old; what they need is prepared when first asked for."""

    def __init__(self, flow: SpectralFlow, functions: Functions) -> None:
        self._rows = cache(lambda young: flow.rows(functions, young=young))

    def of(self, motion: Motion) -> Waves | Aging | None:
        if not isinstance(motion, _SpectralMotion | _YoungMotion):
            return None
        if isinstance(motion, _SpectralMotion):
            return self._rows(False).waves(motion.t, motion.z)
        early = self._rows(True).waves(motion.t, motion.z)
        return Aging(early, self._rows(False).waves(motion.t, motion.old.z), motion.young)


class _YoungMotion(Motion):
    """A motion that is small against the steady response, which it has not had time to reach."""

    def __init__(self, flow: SpectralFlow, z: Matrix, old: _SpectralMotion, young: float) -> None:
        self._flow = flow
        self.t = old.t
        self.z = z
        self.old = old
        self.young = young

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        young = s < self.young
        if not young.any():
            return self.old.states(s)
        flow, early = self._flow, s[young]
        y = flow.all.response(self.t, flow.homogeneous(self.z, early), early)
        found = np.empty((s.size, 2 * self.z.shape[0]))
        found[young] = flow.assemble(y).T
        if not young.all():
            found[~young] = self.old.states(s[~young])
        return found
