"""What a model means for an observer, before a run: modes, contacts, the impact law.

Modes are those of ``A`` in ``dx/dt = A x`` without contacts. Rigid-body positions are split off;
the rest is written in energy coordinates ``(a', Omega b, b')``, with ``q = R a + P b`` in
``M``-orthonormal shapes. There ``A`` has no double eigenvalue 0, and an undamped mode is
orthogonal to all others, whatever shapes the damping couples.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.check.closing_sets import ClosingSets, SearchResult, redundant
from impact_observer.check.impact_expansion import (
    Growth,
    expansive,
    expansive_sets,
    growth,
    is_nonexpansive,
)
from impact_observer.model import System
from impact_observer.states import Matrix, Vector, frozen

__all__ = ["ModelCheck", "check_model", "expansive_sets", "is_nonexpansive"]

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
_RESONANCE = 1e-6
"""Relative distance of a forcing frequency from a mode's that counts as resonance."""

ComplexVector = NDArray[np.complex128]
Basis = NDArray[Any]
"""Real or complex columns."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode that oscillates: the eigenvalues ``decay +- i frequency``.

    Attributes:
        decay: real part, at most 0, exactly 0 for an undamped mode, 1/s.
        frequency: imaginary part, the damped angular eigenfrequency, rad/s.
    """

    decay: float
    frequency: float

    @property
    def natural(self) -> float:
        """Magnitude of the eigenvalue, rad/s; without damping the eigenfrequency."""
        return float(np.hypot(self.decay, self.frequency))

    @property
    def damping_ratio(self) -> float:
        """``-decay`` over the magnitude, in [0, 1)."""
        return abs(self.decay) / self.natural


@dataclass(frozen=True, slots=True)
class Resonance:
    """A harmonic of the forcing that drives an undamped mode at its own frequency.

    Attributes:
        harmonic: index of the harmonic.
        frequency: of the mode, rad/s.
    """

    harmonic: int
    frequency: float


@dataclass(frozen=True, slots=True, eq=False)
class UnseenMotion:
    """A motion that moves no contact, so that no event depends on it.

    Attributes:
        decay: real part of its eigenvalue, 1/s; 0 for a rigid-body mode.
        frequency: imaginary part, rad/s; 0 for one that does not oscillate.
        shape: of the coordinates, at the phase of the largest, which is 1; shape (n,).
    """

    decay: float
    frequency: float
    shape: Vector


@dataclass(frozen=True, slots=True, eq=False)
class ModelCheck:
    """The result of a model check.

    Attributes:
        system: the model.
        undamped: eigenfrequencies without the damping, shape (n,), rad/s, ascending.
        modes: oscillating modes with the damping, the slowest first.
        rates: real eigenvalues, ascending, 1/s; without those of rigid-body positions.
        rigid: directions of rigid-body modes, shape (r, n), in coordinates.
        resonances: harmonics that make an amplitude grow without bound.
        unseen: motions that move no contact.
        effective_mass: ``1 / (w^T M^-1 w)`` of each contact, shape (m,), kg.
        feasible: whether some position is outside all stops.
        has_clearance: whether some position is clear of all stops.
        redundant: contacts that are linearly dependent and can close together.
        expansive: sets that can close together where an impact can raise ``V``.
        growths: by how much, for each of these sets.
    """

    system: System
    undamped: Vector
    modes: tuple[Mode, ...]
    rates: Vector
    rigid: Matrix
    resonances: tuple[Resonance, ...]
    unseen: tuple[UnseenMotion, ...]
    effective_mass: Vector
    feasible: bool
    has_clearance: bool
    redundant: SearchResult
    expansive: SearchResult
    growths: tuple[Growth, ...]

    @property
    def nonexpansive(self) -> bool | None:
        """Whether no impact ever raises ``V``; None where that is not decided."""
        return self.expansive.is_empty

    @property
    def damped(self) -> bool:
        """Whether damping alone brings every motion to rest."""
        return all(mode.decay < 0 for mode in self.modes) and bool(np.all(self.rates < 0))


def check_model(system: System) -> ModelCheck:
    """Check a model; it takes seconds for some hundred coordinates and contacts."""
    spectrum = _Spectrum(system)
    closing = ClosingSets(system)
    raising = expansive(closing)
    return ModelCheck(
        system=system,
        undamped=frozen(spectrum.undamped),
        modes=spectrum.modes(),
        rates=spectrum.rates(),
        rigid=_readable(spectrum.rigid).T,
        resonances=spectrum.resonances(),
        unseen=spectrum.unseen(closing.lengths),
        effective_mass=frozen(closing.lengths**-2.0),
        feasible=closing.feasible,
        has_clearance=closing.has_clearance,
        redundant=redundant(ClosingSets(system)),
        expansive=raising,
        growths=tuple(growth(closing, contacts) for contacts in raising.sets),
    )


class _Spectrum:
    """Eigenvalues and eigenvectors of a system without contacts."""

    def __init__(self, system: System) -> None:
        self._system = system
        stiffness, self._shapes = linalg.eigh(system.K, system.M)
        self._r = int(np.sum(stiffness <= _RIGID * max(float(stiffness[-1]), 0.0)))
        stiffness[: self._r] = 0.0
        self.undamped: Vector = np.sqrt(stiffness)
        self.rigid: Matrix = self._shapes[:, : self._r]
        values, self._vectors = linalg.eig(self._matrix())
        zero = _ROUNDING * len(values) * float(np.max(np.abs(values)))
        real = np.where(np.abs(values.real) <= zero, 0.0, np.minimum(values.real, 0.0))
        self._values: ComplexVector = real + 1j * np.where(
            np.abs(values.imag) <= zero, 0.0, values.imag
        )

    def _matrix(self) -> Matrix:
        """``A`` in ``(a', Omega b, b')``, shape (2n - r, 2n - r)."""
        n, r = self._system.n, self._r
        damping = self._shapes.T @ self._system.C @ self._shapes
        speeds = np.r_[0:r, n : 2 * n - r]
        matrix = np.zeros((2 * n - r, 2 * n - r))
        matrix[np.ix_(speeds, speeds)] = -damping
        elastic = np.diag(self.undamped[r:])
        matrix[r:n, n:] = elastic
        matrix[n:, r:n] = -elastic
        return matrix

    def _speeds(self, vectors: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Speeds of the ``M``-orthonormal shapes in states, shape (n, ...)."""
        return np.concatenate([vectors[: self._r], vectors[self._system.n :]])

    def modes(self) -> tuple[Mode, ...]:
        """The oscillating pairs, the slowest first."""
        upper = self._values[self._values.imag > 0]
        order = np.argsort(np.abs(upper), kind="stable")
        return tuple(Mode(float(value.real), float(value.imag)) for value in upper[order])

    def rates(self) -> Vector:
        """The real eigenvalues, ascending."""
        return frozen(np.sort(self._values[self._values.imag == 0].real))

    def resonances(self) -> tuple[Resonance, ...]:
        """Harmonics at the frequency of an undamped mode, with a force along it.

        An undamped mode is orthogonal to the others, so the force along it drives it alone.
        """
        forcing = self._system.forcing
        forces = self._shapes.T @ (forcing.cosine - 1j * forcing.sine).T
        found = set()
        for i in np.flatnonzero((self._values.real == 0) & (self._values.imag > 0)):
            frequency = float(self._values[i].imag)
            shape = self._speeds(self._vectors[:, i])
            for k in np.flatnonzero(abs(forcing.frequency - frequency) <= _RESONANCE * frequency):
                if abs(shape.conj() @ forces[:, k]) > _UNSEEN * np.linalg.norm(forces[:, k]):
                    found.add((int(k), float(forcing.frequency[k])))
        return tuple(Resonance(*each) for each in sorted(found))

    def unseen(self, lengths: Vector) -> tuple[UnseenMotion, ...]:
        """The Popov-Belevitch-Hautus test, with gaps and contact speeds as outputs."""
        seen = self._shapes.T @ self._system.W / lengths
        found = [
            UnseenMotion(0.0, 0.0, shape)
            for shape in _readable(self.rigid @ _null(seen[: self._r].T)).T
        ]
        scale = float(np.max(np.abs(self._values)))
        at = np.flatnonzero((self._values.imag >= 0) & (self._values != 0))
        for group in _groups(self._values[at], _EQUAL * scale):
            members = at[group]
            speeds, size, _ = linalg.svd(
                self._speeds(self._vectors[:, members]), full_matrices=False
            )
            speeds = speeds[:, size > _SAME_SHAPE * size[0]]
            value = complex(np.mean(self._values[members]))
            hidden = self._shapes @ speeds @ _null(seen.T @ speeds)
            found.extend(
                UnseenMotion(value.real, value.imag, shape) for shape in _readable(hidden).T
            )
        return tuple(sorted(found, key=lambda each: np.hypot(each.decay, each.frequency)))


def _null(seen: Basis) -> Basis:
    """An orthonormal basis of the null space."""
    rows, columns = seen.shape
    if rows == 0 or columns == 0:
        return np.eye(columns)
    _, singular, right = linalg.svd(seen, full_matrices=rows < columns)
    rank = int(np.sum(singular > _UNSEEN))
    return np.asarray(right[rank:].conj().T)


def _groups(values: ComplexVector, tolerance: float) -> list[list[int]]:
    """Indices of values that are equal, directly or through a chain of others."""
    groups: list[list[int]] = []
    for i in np.argsort(values.imag, kind="stable").tolist():
        near = [
            group
            for group in groups
            if min(abs(values[k] - values[i]) for k in group) <= tolerance
        ]
        merged = [i, *(k for group in near for k in group)]
        groups = [*(group for group in groups if group not in near), merged]
    return groups


def _readable(directions: Basis) -> Matrix:
    """A basis of the columns' span in which each column has a 1 where the others have a 0.

    Of complex columns the real part is returned, at the phase of that 1.
    """
    n, r = directions.shape
    if r == 0:
        return np.zeros((n, 0))
    _, _, pivots = linalg.qr(directions.T, mode="economic", pivoting=True)
    chosen = sorted(pivots[:r].tolist())
    basis = linalg.solve(directions[chosen].T, directions.T).T.real
    return frozen(np.where(np.abs(basis) <= _CLEAN, 0.0, basis))
