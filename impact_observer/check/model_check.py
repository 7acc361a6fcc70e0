# SPDX-License-Identifier: Apache-2.0
"""Properties of a model that matter to an observer: modes, contacts, the impact law.

The modes are those of ``A`` in ``dx/dt = A x`` without contacts. Rigid-body positions are split
off; the other states are written in energy coordinates ``(a', Omega b, b')``, with
``q = R a + P b`` in ``M``-orthonormal shapes. Then ``A`` has no double eigenvalue 0, and an
undamped mode is
orthogonal to all others, whatever shapes the damping couples.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.sparse import csgraph

from impact_observer.check.closing_sets import ClosingSets, SearchResult, redundant
from impact_observer.check.impact_expansion import (
    Growth,
    expansive,
    expansive_sets,
    growth,
    is_nonexpansive,
)
from impact_observer.check.undamped_modes import UndampedModes
from impact_observer.model import Model, System
from impact_observer.model.free_parameters import is_phase, parametric_family
from impact_observer.model.parameter_places import Place, parameter_places
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.states import Matrix, Vector, frozen

__all__ = ["ModelCheck", "check_model", "expansive_sets", "is_nonexpansive"]

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


class UnseenMotion(NamedTuple):
    """A motion that moves no contact, so that no event depends on the motion.

    Attributes:
        eigenvalue: 1/s; 0 for a rigid-body mode, real for a mode that does not oscillate.
        shape: amplitudes of the coordinates at the phase of the largest one, which is 1; shape
            (n,).
    """

    eigenvalue: complex
    shape: Vector


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
        resonances: harmonics that drive an undamped mode at its own frequency, so that its
            amplitude grows without bound: index and frequency, rad/s.
        unseen: motions that move no contact.
        effective_mass: ``1 / (w^T M^-1 w)`` of each contact, shape (m,), kg.
        feasible: whether some position is outside all stops.
        has_clearance: whether some position is clear of all stops.
        redundant: contacts that are linearly dependent and can close together.
        nonexpansive: whether no impact ever raises ``V``; None if the search did not decide.
        growths: the largest rise of ``V`` for each set of contacts whose impact can raise ``V``.
        declared: parameters whose standard deviations the model declares, with these.
        phases: paths and phases of the harmonics of elements and grounds, rad.
    """

    system: System
    undamped: Vector
    modes: ComplexVector
    rates: Vector
    rigid: Matrix
    resonances: tuple[tuple[int, float], ...]
    unseen: tuple[UnseenMotion, ...]
    effective_mass: Vector
    feasible: bool
    has_clearance: bool
    redundant: SearchResult
    nonexpansive: bool | None
    growths: tuple[Growth, ...]
    declared: tuple[tuple[ModelParameter, float], ...]
    phases: tuple[tuple[Place, float], ...]

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
    closing = ClosingSets(system)
    raising = expansive(closing)
    return ModelCheck(
        system=system,
        undamped=frozen(spectrum.undamped),
        modes=modes[np.argsort(np.abs(modes), kind="stable")],
        rates=frozen(np.sort(values[values.imag == 0].real)),
        rigid=_readable(spectrum.rigid).T,
        resonances=spectrum.resonances(),
        unseen=spectrum.unseen(closing.lengths),
        effective_mass=frozen(closing.lengths**-2.0),
        feasible=closing.feasible,
        has_clearance=closing.has_clearance,
        redundant=redundant(ClosingSets(system)),
        nonexpansive=_nonexpansive(system, raising.is_empty),
        growths=tuple(growth(closing, contacts) for contacts in raising.sets),
        declared=tuple(_declared(model)),
        phases=tuple(_phases(model)),
    )


def _declared(model: Model) -> Iterator[tuple[ModelParameter, float]]:
    if known := model.uncertainty:
        parameters = parametric_family(model.system, known.names, model.elements).parameters
        yield from zip(parameters, known.deviations.tolist(), strict=True)


def _phases(model: Model) -> Iterator[tuple[Place, float]]:
    frame = model.system.frame
    written = {} if frame is None else {"grounds": frame.grounds.written}
    for place in parameter_places({**model.element_form, **written}, model.system):
        if is_phase(place.name):
            yield place.path, place.offset


def _nonexpansive(system: System, constant: bool | None) -> bool | None:
    """Whether no impact raises V.

    Args:
        system: the model.
        constant: the answer if the slope of every rebound law were constant.
    """
    bent = [law for law in system.rebounds if not law.is_affine]
    if not all(law.is_nonexpansive for law in bent):
        return False
    return None if bent and system.m > 1 and constant else constant


class _Spectrum:
    """Eigenvalues and eigenvectors of a system without contacts."""

    def __init__(self, system: System) -> None:
        self._system = system
        modes = UndampedModes.of_system(system)
        self._shapes = np.hstack([modes.rigid, modes.elastic])
        self.rigid: Matrix = modes.rigid
        self._r = modes.rigid.shape[1]
        self.undamped: Vector = np.sqrt(np.append(np.zeros(self._r), modes.squares))
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

    def resonances(self) -> tuple[tuple[int, float], ...]:
        """Harmonics at the frequency of an undamped mode, with a force along it.

        An undamped mode is orthogonal to the others, so the force along it drives it alone.
        """
        forcing = self._system.forcing
        forces = self._shapes.T @ (forcing.cosine - 1j * forcing.sine).T
        resonances = set()
        for i in np.flatnonzero((self.values.real == 0) & (self.values.imag > 0)):
            frequency = float(self.values[i].imag)
            for k in np.flatnonzero(abs(forcing.frequency - frequency) <= _RESONANCE * frequency):
                along = abs(self._speeds[:, i].conj() @ forces[:, k])
                if along > _UNSEEN * np.linalg.norm(forces[:, k]):
                    resonances.add((int(k), float(forcing.frequency[k])))
        return tuple(sorted(resonances))

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
