# SPDX-License-Identifier: Apache-2.0
"""A motion switched at given instants, with exact derivatives.

Harmonics and constants are states as well. The vector ``z = (q, u, c_1, s_1, .., 1)`` with
``c = a cos(omega t + phi)`` obeys ``dz/dt = F z`` with a constant matrix between two instants.
Its derivative with respect to a parameter in ``F`` is the block of an exponential (Van Loan,
Computing integrals involving the matrix exponential, 1978)::

    exp(s [[F, F'], [0, F]]) = [[E, L], [0, E]],    dz(s) = E dz(0) + L z(0)

The derivative by an instant is ``F z``. Contacts that stay closed are held: ``M^-1`` becomes
``R = S (S^T M S)^-1 S^T``, where ``S`` spans the free directions, with ``dR = -R dM R``. At an
impact ``u+ = J u-``, ``J = I - X (1 + E) W^T``, ``X = M^-1 W G^-1`` with ``dX = -R dM X``. Where
``E`` depends on the speed of approach, its derivative counts.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.events import Contacts
from impact_observer.model.parametric_family import Coefficients, ParametricFamily
from impact_observer.model.restitution import PowerLaw
from impact_observer.states import Matrix, Vector


class FlightEnd(NamedTuple):
    """The impacts, closings and openings at one instant.

    Attributes:
        t: as recorded, s since the epoch.
        hit: contacts that impact or close; empty where contacts only open.
        pressed: closed contacts that take an impulse.
        held: contacts that stay closed from now on, independent of each other.
        measured: whether the moment has a stamp; else the moment was inserted as missed.
    """

    t: float
    hit: Contacts
    pressed: Contacts
    held: Contacts = ()
    measured: bool = True

    @property
    def lasts(self) -> bool:
        """Whether the moment can be an impact that lasts: of one contact, which stays open."""
        return len(self.hit) == 1 and self.pressed == self.hit and not self.held


class EquationsOfMotion:
    """The equations of motion for certain values of the parameters."""

    def __init__(self, family: ParametricFamily, numbers: Coefficients) -> None:
        self.numbers = numbers
        self._changes = [each.effect for each in family.parameters]
        self._system = family.system
        self._inverse = linalg.inv(numbers.M)
        self.constrained_inverse = cache(self._constrained_inverse)
        self.generator = cache(self._generator)
        self._step = cache(self._step_of)
        self._impact = cache(self._impact_of)
        self._held: list[Contacts] = []
        h = family.system.forcing.frequency.size
        self._size = 2 * family.system.n + 2 * h + 1
        self.gap_change = np.reshape([each.gap for each in self._changes], (-1, family.system.m))

    def start(
        self, x: Vector, moments: Sequence[FlightEnd], t: Vector, t0: float
    ) -> tuple[Vector, Matrix]:
        """``z`` at ``t0``, and its derivatives by initial state, parameters and instants.

        ``x`` is the state (q, u) at ``t0``; ``moments`` switch the motion at ``t``.
        """
        n, forcing = self._system.n, self._system.forcing
        p = len(self._changes)
        self._held = [(), *(each.held for each in moments)]
        self._steps = self.steps(moments, np.diff(t, prepend=t0))
        angle = forcing.frequency * t0 + self.numbers.phase
        wave = np.exp(1j * angle)
        z = np.concatenate([x, np.zeros(self._size - 2 * n)])
        z[2 * n : -1] = _pairs(self.numbers.amplitude * wave)
        z[-1] = 1.0
        Z = np.zeros((self._size, 2 * n + p + len(moments)))
        Z[: 2 * n, : 2 * n] = np.eye(2 * n)
        for j, change in enumerate(self._changes):
            turn = change.amplitude + 1j * self.numbers.amplitude * change.phase
            Z[2 * n : -1, 2 * n + j] = _pairs(turn * wave)
        return z, Z

    def rate(self, k: int, z: Vector, after: float = 0.0) -> Vector:
        """``dz/dt`` before the jump at moment ``k``, or ``after`` s later without the jump."""
        del after
        return self.generator(self._held[k]) @ z

    def flown(self, k: int, z: Vector, Z: Matrix) -> tuple[Vector, Matrix, Vector]:
        """``z`` and its derivatives from moment ``k - 1`` to just before moment ``k``.

        The third value is the derivative of ``z`` by the instant of moment ``k - 1``.
        """
        z, Z = self._by(self._steps[k], z, Z)
        return z, Z, -self.rate(k, z)

    def moved(self, k: int, z: Vector, Z: Matrix, s: float, after: float) -> tuple[Vector, Matrix]:
        """``z`` and its derivatives ``s`` seconds later than ``after`` a moment.

        All contacts are open.
        """
        del k, after
        return self._by(self._step(s), z, Z)

    def _by(self, step: tuple[Matrix, Matrix], z: Vector, Z: Matrix) -> tuple[Vector, Matrix]:
        (E, L), d = step, 2 * self._system.n
        moved = E @ Z
        moved[:d, d : d + len(L)] += (L @ z).T
        return E @ z, moved

    def _constrained_inverse(self, held: Contacts) -> Matrix:
        """``R``: the inverse of ``M`` in the directions that ``held`` contacts leave free."""
        W = self._system.W[:, list(held)]
        free = linalg.null_space(W.T) if held else np.eye(self._system.n)
        inner = free.T @ self.numbers.M @ free
        # scipy before 1.14 refuses empty systems
        return np.asarray(free @ (linalg.solve(inner, free.T) if free.size else free.T))

    def _generator(self, held: Contacts) -> Matrix:
        """``F`` while ``held`` contacts are closed."""
        n, forcing = self._system.n, self._system.forcing
        F = np.zeros((self._size, self._size))
        F[:n, n : 2 * n] = np.eye(n)
        forces = self._internal_forces(self.numbers)
        forces[:, 2 * n : -1 : 2] = forcing.cosine.T
        forces[:, 2 * n + 1 : -1 : 2] = forcing.sine.T
        forces[:, -1] = forcing.constant
        F[n : 2 * n] = self.constrained_inverse(held) @ forces
        for k, rate in enumerate(forcing.frequency.tolist()):
            c = 2 * n + 2 * k
            F[c, c + 1], F[c + 1, c] = -rate, rate
        return F

    def _internal_forces(self, numbers: Coefficients) -> Matrix:
        """``-K q - C u`` as a matrix on ``z``."""
        zero = np.zeros((self._system.n, self._size - 2 * self._system.n))
        return np.hstack([-numbers.K, -numbers.C, zero])

    def _generator_change(self, change: Coefficients, held: Contacts) -> Matrix:
        """The derivative of ``F`` with respect to a parameter."""
        n, R = self._system.n, self.constrained_inverse(held)
        dF = np.zeros((self._size, self._size))
        pulled = self._internal_forces(change) - change.M @ self.generator(held)[n : 2 * n]
        dF[n : 2 * n] = R @ pulled
        return dF

    def steps(self, moments: Sequence[FlightEnd], s: Vector) -> list[tuple[Matrix, Matrix]]:
        """For each moment the transition matrix to it, and its derivatives by the parameters."""
        N, n, p = self._size, self._system.n, len(self._changes)
        E = np.zeros((len(moments), N, N))
        L = np.zeros((len(moments), p, 2 * n, N))
        before = [(), *(each.held for each in moments[:-1])]
        for held in set(before):
            which = np.array([k for k, each in enumerate(before) if each == held])
            F = self.generator(held)
            balanced, (scale, _) = linalg.matrix_balance(F, permute=False, separate=True)
            lengths = s[which][:, None, None]
            E[which] = linalg.expm(balanced * lengths) * scale[:, None] / scale
            for j, change in enumerate(self._changes):
                generator_change = self._generator_change(change, held)
                if np.any(generator_change):
                    both = np.zeros((2 * N, 2 * N))
                    both[:N, :N] = both[N:, N:] = balanced
                    both[:N, N:] = generator_change * scale / scale[:, None]
                    dE = linalg.expm(both * lengths)[:, : 2 * n, N:]
                    L[which, j] = dE * scale[: 2 * n, None] / scale
        return list(zip(E, L, strict=True))

    def lasted(self, k: int, z: Vector, Z: Matrix, moment: FlightEnd) -> tuple[Vector, Matrix]:
        """``jumped`` half a contact time later, and from there back without the jump.

        With ``h`` that half, ``z+ = e^{-Fh} J e^{Fh} z`` has the derivative ``e^{-Fh} (J F - F J)
        e^{Fh} z`` by it.
        """
        (i,) = moment.hit
        half, d = float(self.numbers.contact_time[i]) / 2, 2 * self._system.n
        shares = [(j, change.contact_time[i] / 2) for j, change in enumerate(self._changes)]
        shares = [(j, share) for j, share in shares if share]
        if not (half or shares):
            return self.jumped(z, Z, moment)
        z, Z = self.moved(k, z, Z, half, 0.0)
        for j, share in shares:
            Z[:, d + j] += share * self.rate(k, z, half)
        z, Z = self.jumped(z, Z, moment)
        for j, share in shares:
            Z[:, d + j] -= share * self.rate(k, z, half)
        return self.moved(k, z, Z, -half, half)

    def _step_of(self, s: float) -> tuple[Matrix, Matrix]:
        return self.steps([FlightEnd(0.0, (), ())], np.array([s]))[0]

    def _rebounds(self, pressed: Contacts, speeds: Vector) -> tuple[Vector, ...]:
        """``eps``, ``d(eps v)/dv``, and ``eps`` by value and by exponent, a number a contact."""
        rows = []
        for i, speed in zip(pressed, np.abs(speeds).tolist(), strict=True):
            curve, eps = self.numbers.curve(self._system, i), float(self.numbers.eps[i])
            if curve is None:
                rows.append((eps, eps, 1.0, 0.0))
                continue
            by = curve.sensitivity(speed) if isinstance(curve, PowerLaw) else (0.0, 0.0)
            rows.append((float(curve.restitution_at(np.array(speed))), curve.slope(speed), *by))
        return tuple(np.array(rows).T)

    def _impact_of(self, pressed: Contacts) -> tuple[Matrix, Matrix, np.ndarray, Matrix, Matrix]:
        """``W`` and ``X`` of contacts, and what each parameter changes.

        Returns:
            ``W``, shape (n, c) for c contacts; ``X``, the same; ``-dX``, shape (p, n, c); the
            changes of the restitution's value and exponent, shape (p, c) each.
        """
        P, changes = list(pressed), self._changes
        W, R = self._system.W[:, P], self.constrained_inverse(pressed)
        X = self._inverse @ W @ linalg.pinvh(W.T @ self._inverse @ W)
        by_mass = np.reshape([R @ each.M @ X for each in changes], (len(changes), *X.shape))
        by_value = np.reshape([each.eps[P] for each in changes], (-1, len(P)))
        by_exponent = np.reshape([each.exponent[P] for each in changes], (-1, len(P)))
        return W, X, by_mass, by_value, by_exponent

    def jumped(self, z: Vector, Z: Matrix, moment: FlightEnd) -> tuple[Vector, Matrix]:
        """``z`` and its derivatives just after a moment."""
        n, d = self._system.n, 2 * self._system.n
        u, U = z[n:d].copy(), Z[n:d].copy()
        if moment.pressed:
            W, X, by_mass, by_value, by_exponent = self._impact(moment.pressed)
            speeds = W.T @ u
            eps, slopes, *shares = self._rebounds(moment.pressed, speeds)
            U -= X @ ((1.0 + slopes)[:, None] * (W.T @ U))
            lost = (1.0 + eps) * speeds
            rebounds = (shares[0] * by_value + shares[1] * by_exponent) * speeds
            U[:, d : d + len(self._changes)] += (by_mass @ lost - rebounds @ X.T).T
            u -= X @ lost
        if moment.held:
            R, M = self.constrained_inverse(moment.held), self.numbers.M
            still = R @ (M @ u)
            U = R @ (M @ U)
            for j, change in enumerate(self._changes):
                U[:, d + j] += R @ (change.M @ (u - still))
            u = still
        z, Z = z.copy(), Z.copy()
        z[n:d], Z[n:d] = u, U
        return z, Z


def _pairs(wave: np.ndarray) -> Vector:
    """Real and imaginary parts in turn."""
    return np.asarray(np.stack([wave.real, wave.imag], axis=-1).reshape(-1))
