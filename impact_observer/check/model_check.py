# SPDX-License-Identifier: Apache-2.0
"""Properties of a model that matter to an observer: modes, amplitudes, unseen motions, impacts.

The modes are those of ``A`` in ``dx/dt = A x`` without contacts. Rigid-body positions are split
off; the other states are written in energy coordinates ``(a', Omega b, b')``, with
``q = R a + P b`` in ``M``-orthonormal shapes. Then ``A`` has no double eigenvalue 0, and an
undamped mode is orthogonal to all others, whatever shapes the damping couples.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize
from scipy.sparse import csgraph

from impact_observer.events import Contacts
from impact_observer.model import Model, System
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.states import Matrix, Vector, frozen

_RIGID = 1e-12
"""``omega^2`` that counts as zero, relative to the stiffest mode's; as for position jumps."""
_ROUNDING = 1e-14
"""Real or imaginary part that counts as zero, relative to the largest eigenvalue, times 2n."""
_EQUAL = 1e-8
"""Distance of eigenvalues that count as equal, relative to the largest."""
_SAME_SHAPE = 1e-6
"""Singular value of the shapes of equal eigenvalues below which one is a copy of another."""
_UNSEEN = 1e-9
"""Contact speed of a shape that counts as none, relative to the shape's speed."""
_CLEAN = 1e-12
"""Entry of a shape that counts as rounding."""
_EIGENVALUE = 1e-9
"""Negative eigenvalue of ``G - E G E`` that counts as rounding, ``G`` having a unit diagonal."""
_CLOSED = 1e-8
"""Gap that counts as closed, relative to the largest gap in the rest position."""
_MOST_PAIRS = 200
"""Most pairs of contacts that are tried."""
_BOUNDLESS = 1e9
"""Amplitude that counts as a resonance without damping, m."""

ComplexVector = NDArray[np.complex128]
Basis = NDArray[Any]
"""Real or complex columns."""


class UnseenMotion(NamedTuple):
    """A motion that moves no contact, so that no event depends on the motion.

    Attributes:
        eigenvalue: 1/s; 0 for a rigid-body mode, real for a mode that does not oscillate.
        shape: amplitudes of the coordinates at the phase of the largest one, which is 1; shape
            (n,).
    """

    eigenvalue: complex
    shape: Vector


class Growth(NamedTuple):
    """Two contacts that can close together, and the largest factor of ``V`` at their impact."""

    contacts: Contacts
    factor: float


@dataclass(frozen=True, slots=True, eq=False)
class ModelCheck:
    """The result of a model check.

    Attributes:
        system: the model.
        undamped: eigenfrequencies without the damping, shape (n,), rad/s, ascending.
        modes: of each oscillating mode with the damping the eigenvalue above the real axis,
            1/s, the slowest first; the real part is exactly 0 for an undamped mode.
        rates: real eigenvalues, ascending, 1/s; without the zeros of rigid-body positions.
        rigid: directions of rigid-body modes, shape (r, n), in coordinates.
        unseen: motions that move no contact.
        effective_mass: ``1 / (w^T M^-1 w)`` of each contact, shape (m,), kg.
        rest: gaps under the constant loads, shape (m,), m; NaN where nothing holds the body, or
            where loads arrive live, are sampled or square.
        swing: largest amplitudes of the gaps by the harmonics, without impacts, shape (m,), m;
            infinite at a resonance, NaN as above.
        nonexpansive: whether no impact ever raises ``V``; None where this is not decided.
        growths: pairs of contacts whose impact can raise ``V``.
        declared: parameters whose standard deviations the model declares, with these.
    """

    system: System
    undamped: Vector
    modes: ComplexVector
    rates: Vector
    rigid: Matrix
    unseen: tuple[UnseenMotion, ...]
    effective_mass: Vector
    rest: Vector
    swing: Vector
    nonexpansive: bool | None
    growths: tuple[Growth, ...]
    declared: tuple[tuple[ModelParameter, float], ...]

    @property
    def damped(self) -> bool:
        """Whether damping alone brings every motion to rest."""
        return bool(np.all(self.modes.real < 0) and np.all(self.rates < 0))


def check_model(model: Model | System) -> ModelCheck:
    """Check a model, in seconds for some hundred coordinates and contacts."""
    model = model if isinstance(model, Model) else Model(model)
    system = model.system
    spectrum = _Spectrum(system)
    values = spectrum.values
    modes = values[values.imag > 0]
    lengths = np.sqrt(np.sum(system.W * linalg.solve(system.M, system.W), axis=0))
    rest, swing = spectrum.amplitudes()
    nonexpansive, growths = _expansion(system, lengths)
    known = model.uncertainty
    declared = (
        ()
        if known is None
        else zip(
            parametric_family(system, known.names, model.elements).parameters,
            known.deviations.tolist(),
            strict=True,
        )
    )
    return ModelCheck(
        system=system,
        undamped=frozen(spectrum.undamped),
        modes=modes[np.argsort(np.abs(modes), kind="stable")],
        rates=frozen(np.sort(values[values.imag == 0].real)),
        rigid=_readable(spectrum.rigid).T,
        unseen=spectrum.unseen(lengths),
        effective_mass=frozen(lengths**-2.0),
        rest=frozen(rest),
        swing=frozen(swing),
        nonexpansive=nonexpansive,
        growths=growths,
        declared=tuple(declared),
    )


def _expansion(system: System, lengths: Vector) -> tuple[bool | None, tuple[Growth, ...]]:
    """Whether no impact raises V, and pairs of contacts whose impact can.

    An impact of the contacts A never raises ``V`` when ``H = G - E G E`` is positive semidefinite,
    with ``G = W_A^T M^-1 W_A`` and ``E = diag(eps)``. Pairs that cannot close together are in none
    of the sets to be tested: their entries of H do not count.
    """
    bent = [law for law in system.rebounds if not law.is_affine]
    if not all(law.is_nonexpansive for law in bent):
        return False, ()
    W, eps = system.W / lengths, system.eps
    G = W.T @ linalg.solve(system.M, W)
    H = (1.0 - np.outer(eps, eps)) * G
    diagonal = np.diag(H)
    apart = np.hypot((diagonal[:, None] - diagonal) / 2, H)
    fails = (diagonal[:, None] + diagonal) / 2 - apart < -_EIGENVALUE
    growths = list[Growth]()
    pairs = np.argwhere(np.triu(fails & (eps[:, None] != eps), k=1)).tolist()
    for i, j in pairs[:_MOST_PAIRS]:
        if abs(G[i, j]) > 1.0 - _EIGENVALUE or not _can_close(system, lengths, (i, j)):
            H[i, j] = H[j, i] = 0.0  # of parallel contacts an impact has one only
        else:
            at, E = np.ix_((i, j), (i, j)), np.diag(eps[[i, j]])
            factor = linalg.eigh(E @ G[at] @ E, G[at], eigvals_only=True)[-1]
            growths.append(Growth((i, j), float(factor)))
    if growths:
        return False, tuple(growths)
    is_decided = not system.m or linalg.eigvalsh(H)[0] >= -_EIGENVALUE * system.m
    is_decided = bool(is_decided or np.ptp(eps) == 0)
    return (True if is_decided and not (bent and system.m > 1) else None), ()


def _can_close(system: System, lengths: Vector, contacts: Contacts) -> bool:
    """Whether ``{q: g_A = 0, g >= 0}`` is not empty for the ``contacts`` A, by a linear programme.

    Coordinates are divided by the roots of their masses, and gaps by the largest.
    """
    rows = system.W.T / np.outer(lengths, np.sqrt(np.diag(system.M)))
    gap = system.q_r / lengths
    gap = gap / (float(np.max(np.abs(gap))) or 1.0)
    index = list(contacts)
    found = optimize.linprog(rows[index].sum(axis=0), -rows, gap, bounds=(None, None))
    return bool(found.status == 0 and found.fun + gap[index].sum() <= _CLOSED * len(index))


class _Spectrum:
    """Eigenvalues and eigenvectors of a system without contacts."""

    def __init__(self, system: System) -> None:
        self._system = system
        squares, shapes = linalg.eigh(system.K, system.M)
        self._r = int(np.sum(squares <= _RIGID * max(float(squares[-1]), 0.0)))
        self._shapes, self.rigid = shapes, shapes[:, : self._r]
        self.undamped: Vector = np.sqrt(np.append(np.zeros(self._r), squares[self._r :]))
        values, vectors = linalg.eig(self._matrix())
        zero = _ROUNDING * len(values) * float(np.max(np.abs(values)))
        real = np.where(np.abs(values.real) <= zero, 0.0, np.minimum(values.real, 0.0))
        imaginary = np.where(np.abs(values.imag) <= zero, 0.0, values.imag)
        self.values: ComplexVector = real + 1j * imaginary
        # Speeds of the M-orthonormal shapes in each eigenvector.
        self._speeds = np.concatenate([vectors[: self._r], vectors[system.n :]])

    def _matrix(self) -> Matrix:
        """``A`` in ``(a', Omega b, b')``, shape (2n - r, 2n - r)."""
        n, r = self._system.n, self._r
        speeds = np.r_[0:r, n : 2 * n - r]
        matrix = np.zeros((2 * n - r, 2 * n - r))
        matrix[np.ix_(speeds, speeds)] = -self._shapes.T @ self._system.C @ self._shapes
        elastic = np.diag(self.undamped[r:])
        matrix[r:n, n:] = elastic
        matrix[n:, r:n] = -elastic
        return matrix

    def amplitudes(self) -> tuple[Vector, Vector]:
        """Gaps under constant loads and largest amplitudes of the gaps, m, shape (m,) each.

        ``K q_0 = f_0``, and for each harmonic ``(K - omega^2 M + i omega C) q_k = f_k``. Grounds
        that move are part of the forcing.
        """
        system, forcing, W = self._system, self._system.forcing, self._system.W
        unknown = forcing.sampled is not None or forcing.squares is not None
        if unknown or system.live is not None:
            return np.full(system.m, np.nan), np.full(system.m, np.nan)
        elastic = self._shapes[:, self._r :] / self.undamped[self._r :]
        with np.errstate(over="ignore", invalid="ignore"):  # next to no stiffness
            rest = system.q_r + W.T @ elastic @ (elastic.T @ forcing.constant)
        rest[np.any(np.abs(W.T @ self.rigid) > _CLEAN, axis=1)] = np.nan
        swing = np.zeros(system.m)
        for omega, force in zip(
            forcing.frequency, forcing.cosine - 1j * forcing.sine, strict=True
        ):
            stiffness = system.K - omega**2 * system.M + 1j * omega * system.C
            try:
                swing += np.abs(W.T @ np.linalg.solve(stiffness, force))
            except np.linalg.LinAlgError:
                swing += np.inf
        return rest, np.where(swing > _BOUNDLESS, np.inf, swing)

    def unseen(self, lengths: Vector) -> tuple[UnseenMotion, ...]:
        """The Popov-Belevitch-Hautus test, with gaps and contact speeds as outputs."""
        seen = self._shapes.T @ self._system.W / lengths
        rigid = _readable(self.rigid @ _null(seen[: self._r].T))
        motions = [UnseenMotion(0.0, shape) for shape in rigid.T]
        scale = float(np.max(np.abs(self.values)))
        at = np.flatnonzero((self.values.imag >= 0) & (self.values != 0))
        values = self.values[at]
        near = np.abs(values[:, None] - values) <= _EQUAL * scale
        count, group = csgraph.connected_components(near, directed=False)
        for members in (at[group == k] for k in range(count)):
            speeds, size, _ = linalg.svd(self._speeds[:, members], full_matrices=False)
            speeds = speeds[:, size > _SAME_SHAPE * size[0]]
            value = complex(np.mean(self.values[members]))
            hidden = _readable(self._shapes @ speeds @ _null(seen.T @ speeds))
            motions.extend(UnseenMotion(value, shape) for shape in hidden.T)
        return tuple(sorted(motions, key=lambda each: abs(each.eigenvalue)))


def _null(seen: Basis) -> Basis:
    """An orthonormal basis of the null space."""
    _, singular, right = np.linalg.svd(seen)
    rank = int(np.sum(singular > _UNSEEN))
    return np.asarray(right[rank:].conj().T)


def _readable(directions: Basis) -> Matrix:
    """A basis of the columns' span in which each column has a 1 where the others have a 0.

    The real part of complex columns is returned, at the phase of that 1.
    """
    n, r = directions.shape
    if r == 0:
        return np.zeros((n, 0))
    _, _, pivots = linalg.qr(directions.T, mode="economic", pivoting=True)
    chosen = sorted(pivots[:r].tolist())
    basis = linalg.solve(directions[chosen].T, directions.T).T.real
    return frozen(np.where(np.abs(basis) <= _CLEAN, 0.0, basis))
