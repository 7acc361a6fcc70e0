# SPDX-License-Identifier: Apache-2.0
"""A linear multibody system with rigid stops, as values that check themselves.

Equation (1) of Baumann and Leine (ENOC 2014), for ``n`` coordinates and ``m`` contacts::

    M du = (-C u - K q + f(t)) dt + W dP,    g = W^T q + q_r,    gamma = W^T u

If stops move, the coordinates belong to a frame in which no stop moves (``grounds.py``).
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import LARGEST, check_names, finite, symmetric
from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import Grounds, LiveNames, MovingFrame
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.model.rebounds.constant_restitution import ConstantRestitution
from impact_observer.states import Matrix, Vector, frozen

UNITS = ("m", "rad")
"""Units of coordinates."""
UNKNOWN_UNIT = " or ".join(UNITS)
_OF_ANGLES = {
    "m": "rad",
    "m/s": "rad/s",
    "m/s^2": "rad/s^2",
    "m/s^1.5": "rad/s^1.5",
    "N": "N m",
    "N/m": "N m/rad",
    "Ns/m": "N m s/rad",
    "kg": "kg m^2",
}
"""The units that quantities of angles have, by those of the same quantities of lengths."""
LARGEST_STATE = 1e9
"""Largest accepted magnitude of a coordinate or velocity."""
_INSIDE = 1e-12
"""Largest gap that counts as rounding, relative to the terms of the gap."""
_SYMMETRY = 1e-9
"""Largest asymmetry accepted, relative to the largest entry, as from printed digits."""
_SEMIDEFINITE = 1e-10
"""Most negative eigenvalue accepted as zero, relative to the largest."""
_RIGID = 1e-12
"""Stiffness that is none, relative to the largest."""
_SINGULAR = 1e-14
"""Least eigenvalue of a mass matrix accepted, relative to the largest."""


def per_second(unit: str) -> str:
    """The unit of velocities of coordinates in ``unit``."""
    return " or ".join(f"{each}/s" for each in unit.split(" or "))


def unit_of(quantity: str, unit: str) -> str:
    """The unit of a quantity whose unit is ``quantity`` where coordinates are in m.

    Args:
        quantity: such as ``N/m``; units without a length stay.
        unit: of the coordinates; other units than ``rad`` count as m.
    """
    return _OF_ANGLES.get(quantity, quantity) if unit == "rad" else quantity


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """A rigid stop, open while ``g = direction . q + gap > 0``.

    Attributes:
        name: name of the contact in events.
        direction: a column of W, shape (n,).
        gap: ``q_r``, gap in the rest position, m or rad.
        restitution: Newton's coefficient ``eps``, in [0, 1]; the nominal one of another law.
        rebound: how the contact rebounds; None for Newton's law with ``restitution``.
    """

    name: str
    direction: Vector
    gap: float
    restitution: float
    rebound: ReboundLaw | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """A mass, a spring or a damper of a system on one line.

    Attributes:
        kind: ``mass``, ``stiffness`` or ``damping``.
        label: the body, or the two ends of a spring, such as ``ground-x1``; a second spring
            between the same ends is ``ground-x1#2``.
        value: kg, N/m or Ns/m.
        row: of the coordinates in its displacement, shape (n,).
    """

    kind: str
    label: str
    value: float
    row: Vector

    @property
    def matrix(self) -> Matrix:
        """What its ``value`` is multiplied with in the matrix of its kind, shape (n, n)."""
        return np.outer(self.row, self.row)


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """A linear system with stops: the model that the plant and its replicas share.

    Attributes:
        name: name of the model.
        coordinates: names of the coordinates, as in ``JointState``.
        M: mass matrix, shape (n, n), symmetric positive definite, kg or kg m^2.
        C: damping matrix, shape (n, n), symmetric part positive semidefinite, Ns/m or
            N m s/rad.
        K: stiffness matrix, shape (n, n), symmetric positive semidefinite, N/m or N m/rad.
        forcing: ``f(t)``, in the frame in which no stop moves.
        contacts: the stops.
        frame: the frame in which no stop moves, and the moving grounds; None without grounds.
        live: names of the live signals; None without any.
        unit: unit of the coordinates, ``m`` or ``rad``; ``m or rad`` if unknown.
        W: directions of the contacts, shape (n, m). Derived.
        q_r: gaps in the rest position, shape (m,), m or rad. Derived.
        rebounds: how each contact rebounds. Derived.
        special: indices of the contacts whose law is not a constant coefficient. Derived.
        eps: restitution coefficients, shape (m,); nominal ones of special contacts. Derived.

    Raises:
        ModelError: a value is wrong; the error names the key of the model file.
    """

    name: str
    coordinates: tuple[str, ...]
    M: Matrix
    C: Matrix
    K: Matrix
    forcing: Forcing
    contacts: tuple[Contact, ...]
    frame: MovingFrame | None = None
    live: LiveNames | None = None
    unit: str = UNKNOWN_UNIT
    W: Matrix = field(init=False)
    q_r: Vector = field(init=False)
    rebounds: tuple[ReboundLaw, ...] = field(init=False)
    special: frozenset[int] = field(init=False)
    eps: Vector = field(init=False)

    def __post_init__(self) -> None:
        """Copy, freeze and check all fields, and derive the others."""
        check_names("coordinates", self.coordinates, "at least one coordinate")
        n = self.n
        square = f"{n} x {n}, one row and one column a coordinate"
        M = finite("mass", self.M, (n, n), square)
        C = finite("damping", self.C, (n, n), square)
        K = finite("stiffness", self.K, (n, n), square)
        M = symmetric("mass", M, _SYMMETRY * np.max(np.abs(M)))
        K = symmetric("stiffness", K, _SYMMETRY * np.max(np.abs(K)))
        _check_definite("mass", M, strictly=True)
        _check_definite("stiffness", K, strictly=False)
        _check_definite("damping", (C + C.T) / 2, strictly=False)
        contacts = tuple(_checked_contact(i, c, n) for i, c in enumerate(self.contacts))
        check_names("contacts", [c.name for c in contacts])
        W = np.reshape([c.direction for c in contacts], (-1, n)).T
        derived = {
            "M": M,
            "C": C,
            "K": K,
            "forcing": self.forcing.checked(n),
            "contacts": contacts,
            "W": frozen(W),
            "q_r": frozen([c.gap for c in contacts]),
            "eps": frozen([c.restitution for c in contacts]),
            "rebounds": tuple(c.rebound or ConstantRestitution(c.restitution) for c in contacts),
            "special": frozenset(i for i, c in enumerate(contacts) if c.rebound),
        }
        for key, value in derived.items():
            object.__setattr__(self, key, value)

    def unchecked(self, **changes: object) -> "System":
        """A copy with other values of fields, also of derived ones; nothing is checked."""
        system = object.__new__(System)
        for name in self.__slots__:
            object.__setattr__(system, name, changes.get(name, getattr(self, name)))
        return system

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of (q, u): coordinates, then their velocities."""
        return (*self.coordinates, *(f"d{name}/dt" for name in self.coordinates))

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of (q, u)."""
        return (self.unit,) * self.n + (per_second(self.unit),) * self.n

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def depends_on_time(self) -> bool:
        """Whether the forcing or the motion of grounds depends on time."""
        moves = self.frame is not None and self.frame.grounds.motion.depends_on_time
        return moves or self.live is not None or self.forcing.depends_on_time

    @property
    def own_forcing(self) -> Forcing:
        """``f(t)`` without the effects of grounds."""
        return self.forcing if self.frame is None else self.frame.forcing

    @property
    def gap_unit(self) -> str:
        """Unit of the gaps: that of the coordinates, where they are lengths or angles."""
        return unit_of("m", self.unit)

    @property
    def has_encoders(self) -> bool:
        """Whether an observer of it needs its measured positions: no."""
        return False

    @property
    def remark_on_distance(self) -> str:
        """What a user should know of its V: whether it is zero for some displacement."""
        eigenvalues = np.linalg.eigvalsh(self.K)
        is_seminorm = eigenvalues[0] <= _RIGID * max(float(eigenvalues[-1]), 0.0)
        text = "has a rigid-body mode: V does not see an error of its position"
        return text if is_seminorm else ""

    @property
    def plant_inputs(self) -> LiveNames | None:
        """Signals known only live, for which a plant waits; None without any."""
        return self.live

    @property
    def turns(self) -> NDArray[np.bool_]:
        """Which coordinates are known modulo a turn, shape (n,): none."""
        return np.zeros(self.n, dtype=np.bool_)

    def held_force(self, t: float) -> str:
        """A warning if ``t``, s since the epoch, is after the last sample; otherwise empty."""
        return self.own_forcing.held(t)

    def remarks(self, states: Matrix) -> list[str]:
        """What a user should know of a run through these states: nothing."""
        del states
        return []

    @property
    def m(self) -> int:
        """Number of contacts."""
        return len(self.contacts)

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of the contacts, in the order of W's columns."""
        return tuple(c.name for c in self.contacts)

    def from_frame(self, ns: NDArray[np.int64], x: Matrix) -> Matrix:
        """States (q, u) from states in the frame at ``ns`` since the epoch, (samples, 2n)."""
        return x if self.frame is None else x + self.frame.states(ns)

    def to_frame(self, ns: NDArray[np.int64], x: Matrix) -> Matrix:
        """The inverse of ``from_frame``."""
        return x if self.frame is None else x - self.frame.states(ns)

    def gap_motion(self, ns: NDArray[np.int64]) -> Matrix:
        """Parts of gaps by moving grounds at ``ns`` since the epoch, m, shape (samples, m)."""
        if self.frame is None:
            return np.zeros((ns.size, self.m))
        return np.asarray(self.frame.displacements(ns)[0] @ self.frame.grounds.factors.T)

    def gap(self, q: Vector) -> Vector:
        """Contact distances ``g = W^T q + q_r``, shape (m,), paper's equation (2)."""
        return np.asarray(self.W.T @ q + self.q_r)

    def contact_speed(self, u: Vector) -> Vector:
        """Contact speeds ``gamma = W^T u``, shape (m,), paper's equation (3)."""
        return np.asarray(self.W.T @ u)

    def contact_speeds(self, x: Vector) -> Vector:
        """Contact speeds in a state ``x`` = (q, u), shape (m,)."""
        return self.contact_speed(x[self.n :])

    def gaps_at(self, ns: NDArray[np.int64], states: Matrix) -> Matrix:
        """Gaps in ``states`` (q, u), (samples, 2n), at ``ns`` since the epoch, (samples, m)."""
        return np.asarray(states[:, : self.n] @ self.W + self.q_r + self.gap_motion(ns))

    def is_plain(self, contacts: Collection[int]) -> bool:
        """Whether all ``contacts`` rebound by a constant coefficient."""
        return self.special.isdisjoint(contacts)

    def penetrated(self, q: Vector) -> tuple[int, ...]:
        """Indices of the contacts with ``g < 0`` at ``q``, shape (n,)."""
        return tuple(np.flatnonzero(self.gap(q) < -self._gap_rounding(q)).tolist())

    def closed_at(self, q: Vector) -> tuple[int, ...]:
        """Indices of the contacts with ``g <= 0`` at ``q``, shape (n,)."""
        return tuple(np.flatnonzero(self.gap(q) <= self._gap_rounding(q)).tolist())

    def parts(self) -> NDArray[np.intp]:
        """Number of the uncoupled part of the system of each coordinate, shape (n,).

        No mass, damper, spring or contact couples coordinates of different parts.
        """
        from scipy.sparse.csgraph import connected_components  # noqa: PLC0415 (30 ms)

        touched = np.abs(self.W)
        coupled = np.abs(self.M) + np.abs(self.C) + np.abs(self.K) + touched @ touched.T
        return np.asarray(connected_components(coupled, directed=False)[1], dtype=np.intp)

    def _gap_rounding(self, q: Vector) -> Vector:
        moved = 0.0 if self.frame is None else self.frame.gap_reach[: self.m]
        return np.asarray(_INSIDE * (np.abs(self.q_r) + np.abs(self.W).T @ np.abs(q) + moved))

    def checked_start(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """The initial state of a plant in the frame at the epoch, checked by ``checked_state``.

        The position must not be inside a stop.

        Raises:
            UsageError: a wrong number of values, one that is not finite, or a stop penetrated.
        """
        x = np.concatenate(self.checked_state(position, velocity))
        q, u = np.split(self.to_frame(np.zeros(1, dtype=np.int64), x[None])[0], 2)
        for i in self.penetrated(q):
            raise ModelError(
                "position",
                f"is inside the stop {self.contact_names[i]!r} (gap {self.gap(q)[i]:g}); expected"
                " gap >= 0: check side, the order of between or the sign of direction, and the"
                " units of gap, limit and amplitudes of grounds",
            )
        return q, u

    def checked_state(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """``position`` and ``velocity`` as read-only arrays of shape (n,).

        Raises:
            UsageError: a wrong number of values, or one that is not finite.
        """
        return checked_parts(self.n, position, velocity)


def refuse_squares(system: System, what: str) -> None:
    """Raise UsageError where a ``system`` has square forces, which ``what`` cannot use."""
    if system.forcing.squares is not None:
        raise UsageError(
            f"{system.name}: a force with shape: square, which {what} cannot use; expected forces"
            " that are constant, harmonic or sampled"
        )


def moving_system(system: System, grounds: Grounds) -> System:
    """The ``system``, which has no grounds yet, on moving ``grounds``.

    Raises:
        ModelError: stops of the same body move against each other.
    """
    frame = MovingFrame(grounds, system.forcing, grounds.shift(system.W))
    return replace(system, forcing=frame.total(system.M, system.C, system.K), frame=frame)


def checked_parts(n: int, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
    """``position`` and ``velocity`` as read-only arrays of shape (n,).

    Raises:
        ModelError: a wrong number of values, or one that is not finite or too large.
    """
    wanted = f"{n} numbers, one a coordinate"
    return (
        finite("position", position, (n,), wanted, LARGEST_STATE),
        finite("velocity", velocity, (n,), wanted, LARGEST_STATE),
    )


def _check_definite(key: str, symmetric: Matrix, *, strictly: bool) -> None:
    eigenvalues = np.linalg.eigvalsh(symmetric)
    smallest, largest = float(eigenvalues[0]), float(np.max(np.abs(eigenvalues)))
    least = max(_SINGULAR * largest, 1 / LARGEST) if strictly else -_SEMIDEFINITE * largest
    if smallest < least:
        kind = "definite" if strictly else "semidefinite"
        part = "the symmetric part of it " if key == "damping" else ""
        wanted = f"expected at least {least:.2g}, smallest eigenvalue {smallest:g}"
        raise ModelError(key, f"{part}is not positive {kind}: {wanted}")


def _checked_contact(i: int, contact: Contact, n: int) -> Contact:
    key = f"contacts[{i}]"
    direction = finite(f"{key}.direction", contact.direction, (n,), f"{n} numbers")
    if not np.any(direction):
        raise ModelError(f"{key}.direction", "is zero; a contact must involve some coordinate")
    gap = float(finite(f"{key}.gap", contact.gap, (), "a number, m"))
    law = (contact.rebound or ConstantRestitution(contact.restitution)).checked(key)
    own = None if law.is_plain else law
    return Contact(contact.name, direction, gap, law.nominal, own)
