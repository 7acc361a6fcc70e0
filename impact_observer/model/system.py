"""A linear multibody system with rigid stops, as values that check themselves.

Equation (1) of Baumann and Leine (ENOC 2014), for ``n`` coordinates and ``m`` contacts::

    M du = (-C u - K q + f(t)) dt + W dP,    g = W^T q + q_r,    gamma = W^T u
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from impact_observer.errors import ModelError, UsageError
from impact_observer.states import Matrix, Vector, frozen

LARGEST = 1e15
"""Largest magnitude of any number of a model, SI units; beyond it products overflow."""
LARGEST_STATE = 1e9
"""Largest magnitude of a coordinate or velocity that somebody can mean."""
_INSIDE = 1e-12
"""Depth inside a stop that is rounding, relative to what the gap is the sum of."""
_SYMMETRY = 1e-9
"""Largest asymmetry accepted, relative to the largest entry: what printing digits costs."""
_SEMIDEFINITE = 1e-10
"""Most negative eigenvalue accepted as zero, relative to the largest."""
_SINGULAR = 1e-14
"""Least eigenvalue of a mass matrix, relative to the largest: below it is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """A rigid stop, open while ``g = direction . q + gap > 0``.

    Attributes:
        name: what events call it.
        direction: a column of W, shape (n,).
        gap: ``q_r``, gap in the rest position, m or rad.
        restitution: Newton's coefficient ``eps``, in [0, 1].
    """

    name: str
    direction: Vector
    gap: float
    restitution: float


@dataclass(frozen=True, slots=True, eq=False)
class Forcing:
    """``f(t) = constant + sum_k cosine_k cos(omega_k t) + sine_k sin(omega_k t)``.

    Attributes:
        constant: shape (n,), N or Nm.
        frequency: angular frequencies ``omega``, shape (h,), rad/s, each positive.
        cosine: shape (h, n), N or Nm.
        sine: shape (h, n), N or Nm.
    """

    constant: Vector
    frequency: Vector
    cosine: Matrix
    sine: Matrix

    @classmethod
    def none(cls, n: int) -> "Forcing":
        """No forcing of ``n`` coordinates."""
        return cls(np.zeros(n), np.zeros(0), np.zeros((0, n)), np.zeros((0, n)))

    @property
    def depends_on_time(self) -> bool:
        """Whether the epoch matters: some harmonic has an amplitude."""
        return bool(np.any(self.cosine) or np.any(self.sine))

    def __call__(self, t: float) -> Vector:
        """``f(t)``, shape (n,), at ``t`` seconds since the epoch."""
        angle = self.frequency * t
        return self.constant + np.cos(angle) @ self.cosine + np.sin(angle) @ self.sine


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """A linear system with stops: all that the plant and its replica have in common.

    Attributes:
        name: of the model.
        coordinates: names of the coordinates, as in ``JointState``.
        M: mass matrix, shape (n, n), symmetric positive definite, kg or kg m2.
        C: damping matrix, shape (n, n), symmetric part positive semidefinite, Ns/m.
        K: stiffness matrix, shape (n, n), symmetric positive semidefinite, N/m.
        forcing: ``f(t)``.
        contacts: the stops.
        W: directions of the contacts, shape (n, m). Derived.
        q_r: gaps in the rest position, shape (m,), m or rad. Derived.
        eps: restitution coefficients, shape (m,). Derived.

    Raises:
        ModelError: naming the key of the model file and what is wrong with it.
    """

    name: str
    coordinates: tuple[str, ...]
    M: Matrix
    C: Matrix
    K: Matrix
    forcing: Forcing
    contacts: tuple[Contact, ...]
    W: Matrix = field(init=False)
    q_r: Vector = field(init=False)
    eps: Vector = field(init=False)

    def __post_init__(self) -> None:
        """Copy, freeze and check everything."""
        _check_names("coordinates", self.coordinates)
        n = self.n
        M = _square("mass", self.M, n)
        C = _square("damping", self.C, n)
        K = _square("stiffness", self.K, n)
        _check_symmetric("mass", M)
        _check_symmetric("stiffness", K)
        _check_definite("mass", M, strictly=True)
        _check_definite("stiffness", K, strictly=False)
        _check_definite("damping", (C + C.T) / 2, strictly=False)
        contacts = tuple(_checked_contact(i, c, n) for i, c in enumerate(self.contacts))
        _check_names("contacts", [c.name for c in contacts])
        derived = {
            "M": frozen((M + M.T) / 2),
            "C": C,
            "K": frozen((K + K.T) / 2),
            "forcing": _checked_forcing(self.forcing, n),
            "contacts": contacts,
            "W": frozen(np.reshape([c.direction for c in contacts], (-1, n)).T),
            "q_r": frozen([c.gap for c in contacts]),
            "eps": frozen([c.restitution for c in contacts]),
        }
        for key, value in derived.items():
            object.__setattr__(self, key, value)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def m(self) -> int:
        """Number of contacts."""
        return len(self.contacts)

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of the contacts, in the order of W's columns."""
        return tuple(c.name for c in self.contacts)

    def gap(self, q: Vector) -> Vector:
        """Contact distances ``g = W^T q + q_r``, shape (m,), paper's equation (2)."""
        return np.asarray(self.W.T @ q + self.q_r)

    def contact_speed(self, u: Vector) -> Vector:
        """Contact speeds ``gamma = W^T u``, shape (m,), paper's equation (3)."""
        return np.asarray(self.W.T @ u)

    def penetrated(self, q: Vector) -> tuple[int, ...]:
        """Indices of the contacts whose stop ``q``, shape (n,), is inside of."""
        scale = np.abs(self.q_r) + np.abs(self.W).T @ np.abs(q)
        return tuple(np.flatnonzero(self.gap(q) < -_INSIDE * scale).tolist())

    def checked_state(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """``position`` and ``velocity`` as read-only arrays of shape (n,).

        Raises:
            UsageError: a wrong number of values, or one that is not finite.
        """
        return (
            _state_part("position", position, self.n),
            _state_part("velocity", velocity, self.n),
        )


def _state_part(name: str, values: ArrayLike, n: int) -> Vector:
    try:
        array = frozen(values)
    except (TypeError, ValueError):
        raise UsageError(f"{name}: is not made of numbers only; expected {n} numbers") from None
    if array.shape != (n,):
        raise UsageError(f"{name}: {array.size} values, expected {n}, one a coordinate")
    if not np.all(np.isfinite(array)):
        raise UsageError(f"{name}: {array.tolist()} is not finite; every value must be a number")
    if np.any(np.abs(array) > LARGEST_STATE):
        found = np.max(np.abs(array))
        raise UsageError(f"{name}: {found:g} is too large; expected at most {LARGEST_STATE:g}")
    return array


def _check_names(key: str, names: Sequence[object]) -> None:
    for i, name in enumerate(names):
        if not isinstance(name, str) or not name:
            raise ModelError(f"{key}[{i}]", f"{name!r} is not a name; give a non-empty string")
        if name in names[:i]:
            raise ModelError(f"{key}[{i}]", f"{name!r} is taken already; names must differ")
    if key == "coordinates" and not names:
        raise ModelError(key, "is empty; a system needs at least one coordinate")


def _finite(key: str, values: ArrayLike, shape: tuple[int, ...], what: str) -> Vector:
    """``values`` as a frozen array of ``shape``; ``what`` says it in words."""
    try:
        array = frozen(values)
    except (TypeError, ValueError):
        raise ModelError(key, f"is not made of numbers only; expected {what}") from None
    if array.shape != shape:
        found = " x ".join(map(str, array.shape)) or "a single number"
        raise ModelError(key, f"has shape {found}; expected {what}")
    if not np.all(np.isfinite(array)):
        at = "".join(f"[{i}]" for i in np.argwhere(~np.isfinite(array))[0])
        raise ModelError(f"{key}{at}", "is not finite; expected a number")
    if np.any(np.abs(array) > LARGEST):
        at = "".join(f"[{i}]" for i in np.argwhere(np.abs(array) > LARGEST)[0])
        raise ModelError(f"{key}{at}", f"is too large; expected at most {LARGEST:g}")
    return array


def _square(key: str, values: ArrayLike, n: int) -> Matrix:
    return _finite(key, values, (n, n), f"{n} x {n}, one row and one column a coordinate")


def _check_symmetric(key: str, matrix: Matrix) -> None:
    difference = np.abs(matrix - matrix.T)
    if np.max(difference) <= _SYMMETRY * np.max(np.abs(matrix)):
        return
    i, j = sorted(map(int, np.unravel_index(np.argmax(difference), matrix.shape)))
    raise ModelError(
        key,
        f"is not symmetric: [{i}][{j}] is {matrix[i, j]:g} but [{j}][{i}] is {matrix[j, i]:g};"
        " make them equal",
    )


def _check_definite(key: str, symmetric: Matrix, *, strictly: bool) -> None:
    eigenvalues = linalg.eigvalsh(symmetric)
    smallest, largest = eigenvalues[0], np.max(np.abs(eigenvalues))
    if strictly and smallest <= _SINGULAR * largest:
        raise ModelError(key, f"is not positive definite: smallest eigenvalue {smallest:g}")
    if strictly and smallest < 1 / LARGEST:
        least = 1 / LARGEST
        raise ModelError(
            key, f"is too small: smallest eigenvalue {smallest:g}; expected at least {least:g}"
        )
    if not strictly and smallest < -_SEMIDEFINITE * largest:
        part = "the symmetric part of " if key == "damping" else ""
        raise ModelError(
            key, f"{part}it is not positive semidefinite: smallest eigenvalue {smallest:g}"
        )


def _checked_contact(i: int, contact: Contact, n: int) -> Contact:
    key = f"contacts[{i}]"
    direction = _finite(f"{key}.direction", contact.direction, (n,), f"{n} numbers")
    if not np.any(direction):
        raise ModelError(f"{key}.direction", "is zero; a contact must touch some coordinate")
    gap = float(_finite(f"{key}.gap", contact.gap, (), "a number, m"))
    eps = float(_finite(f"{key}.restitution", contact.restitution, (), "a number in [0, 1]"))
    if not 0.0 <= eps <= 1.0:
        raise ModelError(f"{key}.restitution", f"is {eps:g}; expected a number in [0, 1]")
    return Contact(contact.name, direction, gap, eps)


def _checked_forcing(forcing: Forcing, n: int) -> Forcing:
    h = np.size(forcing.frequency)
    frequency = _finite("forcing.harmonics.frequency", forcing.frequency, (h,), "a list")
    for k in np.flatnonzero(frequency <= 0):
        raise ModelError(
            f"forcing.harmonics[{k}].frequency",
            f"is {frequency[k]:g}; expected a positive number, rad/s",
        )
    return Forcing(
        _finite("forcing.constant", forcing.constant, (n,), f"{n} numbers, one a coordinate"),
        frequency,
        _amplitudes("cosine", forcing.cosine, h, n),
        _amplitudes("sine", forcing.sine, h, n),
    )


def _amplitudes(part: str, rows: Iterable[ArrayLike], h: int, n: int) -> Matrix:
    checked = [
        _finite(f"forcing.harmonics[{k}].{part}", row, (n,), f"{n} numbers, one a coordinate")
        for k, row in enumerate(rows)
    ]
    if len(checked) != h:
        raise ModelError("forcing.harmonics", f"{len(checked)} rows of {part} for {h} frequencies")
    return frozen(np.reshape(checked, (h, n)))
