# SPDX-License-Identifier: Apache-2.0
"""A family of systems that differ by a few parameters, with exact derivatives."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_observer.model.angles import Angles
from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import MovingFrame
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.model.system import Contact, System
from impact_observer.states import Matrix, Vector, frozen

Array = NDArray[np.float64]
_OF_MOTION = ("M", "C", "K", "amplitude", "phase", "frequency", "constant")
"""Coefficients on which the motion between impacts depends."""
_DEVIATION_RANGE = (1e-12, 1.0)
"""Least and largest standard deviation of a parameter, relative to its size."""
_GAP_FACTOR = 100.0
"""Largest standard deviation of a gap over the gap, which may be small beside the motion."""


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """The coefficients of a system that can be estimated, or a change of these coefficients.

    Attributes:
        M: mass matrix, shape (n, n), kg.
        C: damping matrix, shape (n, n), Ns/m.
        K: stiffness matrix, shape (n, n), N/m.
        gap: gaps in the rest position, shape (m,), m.
        rebound: parameters of the rebound laws, one row a contact, zeros beyond its own, shape
            (m, most), at least one column.
        amplitude: amplitudes of the harmonics relative to those of the model, shape (h,).
        phase: lead of the harmonics over those of the model, shape (h,), rad.
        frequency: angular frequencies of the harmonics, shape (h,), rad/s.
        constant: constant force, shape (n,), N.
    """

    M: Matrix
    C: Matrix
    K: Matrix
    gap: Vector
    rebound: Matrix
    amplitude: Vector
    phase: Vector
    frequency: Vector
    constant: Vector

    @classmethod
    def of_system(cls, system: System) -> "Coefficients":
        """The coefficients of ``system``."""
        forcing, count = system.forcing, system.forcing.frequency.size
        numbers = [[each.value for each in law.parameters] for law in system.rebounds]
        rebound = np.zeros((system.m, max((1, *map(len, numbers)))))
        for row, own in zip(rebound, numbers, strict=True):
            row[: len(own)] = own
        harmonics = np.ones(count), np.zeros(count), forcing.frequency
        matrices = system.M, system.C, system.K
        return cls(*matrices, system.q_r, rebound, *harmonics, forcing.constant)

    @property
    def parts(self) -> dict[str, Matrix]:
        """The coefficients that are not all zero, by name."""
        named = {name: getattr(self, name) for name in self.__slots__}
        return {name: part for name, part in named.items() if np.any(part)}

    @classmethod
    def change(cls, system: System, **parts: Matrix) -> "Coefficients":
        """A change of the coefficients ``parts``, by name; all other changes are zero."""
        given = cls.of_system(system)
        zero = {name: np.zeros_like(getattr(given, name)) for name in cls.__slots__}
        return cls(**{**zero, **parts})

    def laws(self, system: System) -> tuple[ReboundLaw, ...]:
        """How all contacts of a ``system`` of the family rebound."""
        rows = zip(system.rebounds, self.rebound.tolist(), strict=True)
        return tuple(law.with_values(row[: len(law.units)]) for law, row in rows)


@dataclass(frozen=True, slots=True, eq=False)
class ModelParameter:
    """A parameter of a model that may be estimated; coefficients are linear in each parameter.

    Attributes:
        name: such as ``restitution.stop``.
        value: nominal value, as in the model.
        low: least value allowed.
        high: largest value allowed.
        size: scale of the parameter: an error that makes the model useless.
        unit: SI unit; empty for a ratio.
        effect: change of the system's coefficients per unit of the parameter.
    """

    name: str
    value: float
    low: float
    high: float
    size: float
    unit: str
    effect: Coefficients

    @property
    def moves(self) -> bool:
        """Whether the motion between impacts depends on the parameter."""
        return not self.effect.parts.keys().isdisjoint(_OF_MOTION)

    @property
    def deviation_range(self) -> tuple[float, float]:
        """Least and largest standard deviation with which the value is of use, in its unit."""
        least, most = (self.size * share for share in _DEVIATION_RANGE)
        return least, most * (_GAP_FACTOR if np.any(self.effect.gap) else 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class ParametricFamily:
    """A system and its uncertain parameters.

    Attributes:
        system: the nominal system.
        parameters: the free parameters.
        coefficients: coefficients of the nominal system. Derived.
    """

    system: System
    parameters: tuple[ModelParameter, ...]
    coefficients: Coefficients = field(init=False)
    _effects: tuple[tuple[float, dict[str, Matrix]], ...] = field(init=False)

    def __post_init__(self) -> None:
        """Derive the coefficients of the system and the effects of the parameters."""
        effects = tuple((each.value, each.effect.parts) for each in self.parameters)
        object.__setattr__(self, "coefficients", Coefficients.of_system(self.system))
        object.__setattr__(self, "_effects", effects)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(each.name for each in self.parameters)

    @property
    def nominal(self) -> Vector:
        """Nominal values, shape (p,)."""
        return frozen([each.value for each in self.parameters])

    @property
    def sizes(self) -> Vector:
        """Scales of the parameters, see ``ModelParameter``, shape (p,)."""
        return frozen([each.size for each in self.parameters])

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Least and largest values allowed, shape (p,) each."""
        return (
            frozen([each.low for each in self.parameters]),
            frozen([each.high for each in self.parameters]),
        )

    def extended(self, others: Iterable[ModelParameter]) -> "ParametricFamily":
        """The family with ``others`` free, too."""
        return ParametricFamily(self.system, (*self.parameters, *others))

    @property
    def gap_changes(self) -> Matrix:
        """What a unit of each parameter adds to the gaps, shape (p, m), m."""
        changes = [each.effect.gap for each in self.parameters]
        return np.reshape(changes, (self.size, self.system.m))

    def coefficients_at(self, values: Vector) -> Coefficients:
        """The coefficients for parameter ``values``, shape (p,)."""
        changed = {name: getattr(self.coefficients, name) for name in Coefficients.__slots__}
        for (nominal, parts), value in zip(self._effects, values.tolist(), strict=True):
            if value != nominal:
                by = value - nominal
                changed |= {name: changed[name] + by * part for name, part in parts.items()}
        return Coefficients(**changed)

    def harmonics(
        self, coefficients: Coefficients
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """``A`` of the harmonic force ``Re sum_k A_k exp(i w_k t)``, and its derivatives, N.

        Returns:
            ``A``, shape (h, n), and its derivatives by the parameters, shape (p, h, n).
        """
        forcing, frame = self._unturned(coefficients)
        given = forcing.cosine - 1j * forcing.sine
        turn = np.exp(1j * coefficients.phase)[:, None]
        factor = coefficients.amplitude[:, None] * turn
        by_frequency = np.zeros_like(given)
        if frame is not None:
            own = frame.forcing.frequency.size
            by_frequency[own:] = frame.by_frequency(coefficients.M, coefficients.C)
        changes = np.zeros((self.size, *given.shape), dtype=np.complex128)
        for j, effect in enumerate(each.effect for each in self.parameters):
            ahead = 1j * effect.phase[:, None] * given + effect.frequency[:, None] * by_frequency
            changes[j] = effect.amplitude[:, None] * turn * given + factor * ahead
        return factor * given, changes

    @property
    def moves_grounds(self) -> bool:
        """Whether the motion of a ground depends on a parameter."""
        return any(name.startswith("ground-") for name in self.names)

    def ground_motion(self, values: Vector, ns: int) -> tuple[Array, Array]:
        """What the grounds add to (q, u, du/dt) in the frame, and its derivatives.

        Args:
            values: of the parameters, shape (p,).
            ns: nanoseconds since the epoch.

        Returns:
            Shapes (3, n) and (p, 3, n).
        """
        frame, coefficients = self.system.frame, self.coefficients_at(values)
        assert frame is not None, "grounds move"
        motion, own = frame.grounds.motion, frame.forcing.frequency.size
        amplitude, omega = coefficients.amplitude[own:], coefficients.frequency[own:]
        angle = Angles(omega).at_stamps(np.array([ns]))[0] + coefficients.phase[own:]
        unit = (motion.cosine - 1j * motion.sine) * np.exp(1j * angle)[:, None]
        jets, order = (1j * omega) ** np.arange(3)[:, None], np.arange(3)[:, None]
        found = ((amplitude * jets) @ unit).real
        if motion.sampled is not None:
            found += motion.sampled.derivatives(np.array([ns * 1e-9]))[:3, 0]
        by_omega = amplitude * jets * (order / omega + 1j * ns * 1e-9)
        changes = np.zeros((self.size, *found.shape))
        for j, effect in enumerate(each.effect for each in self.parameters):
            turned = effect.amplitude[own:] + 1j * amplitude * effect.phase[own:]
            changes[j] = ((turned * jets + effect.frequency[own:] * by_omega) @ unit).real
        return found @ frame.shift.T, changes @ frame.shift.T

    def system_at(self, values: Vector) -> System:
        """The system for parameter ``values``, shape (p,).

        Raises:
            ModelError: the values give no valid system.
        """
        coefficients = self.coefficients_at(values)
        return replace(self.system, **self._changed(coefficients, coefficients.laws(self.system)))

    def near(self, values: Vector) -> System:
        """The unchecked system for parameter ``values`` within the bounds, shape (p,)."""
        coefficients = self.coefficients_at(values)
        laws = coefficients.laws(self.system)
        return self.system.unchecked(
            q_r=coefficients.gap,
            rebounds=laws,
            eps=frozen([each.nominal for each in laws]),
            **self._changed(coefficients, laws),
        )

    def _changed(self, coefficients: Coefficients, laws: tuple[ReboundLaw, ...]) -> dict[str, Any]:
        """The fields of the system with these ``coefficients``, among them rebound ``laws``."""
        gaps = coefficients.gap.tolist()
        contacts = tuple(
            Contact(c.name, c.direction, gap, law.nominal, None if law.is_plain else law)
            for c, law, gap in zip(self.system.contacts, laws, gaps, strict=True)
        )
        forcing, frame = self._unturned(coefficients)
        amplitude, phase = coefficients.amplitude, coefficients.phase
        if frame is not None:
            own, grounds = frame.forcing.frequency.size, frame.grounds
            motion = _turned(grounds.motion, amplitude[own:], phase[own:])
            frame = replace(
                frame,
                grounds=replace(grounds, motion=motion),
                forcing=_turned(frame.forcing, amplitude[:own], phase[:own]),
            )
        return {
            "M": coefficients.M,
            "C": coefficients.C,
            "K": coefficients.K,
            "forcing": _turned(forcing, amplitude, phase),
            "contacts": contacts,
            "frame": frame,
        }

    def _unturned(self, coefficients: Coefficients) -> tuple[Forcing, MovingFrame | None]:
        """The forcing and the moving frame with these constants and frequencies.

        Amplitudes and phases are those of the model. Harmonics of the forcing come before those
        of the grounds.
        """
        given, frame = self.system.forcing, self.system.frame
        constant, frequency = coefficients.constant, coefficients.frequency
        if np.array_equal(constant, given.constant) and np.array_equal(frequency, given.frequency):
            return given, frame
        if frame is None:
            return replace(given, constant=constant, frequency=frequency), None
        own, grounds = frame.forcing.frequency.size, frame.grounds
        motion = replace(grounds.motion, frequency=frequency[own:])
        forcing = replace(frame.forcing, constant=constant, frequency=frequency[:own])
        frame = replace(frame, grounds=replace(grounds, motion=motion), forcing=forcing)
        total = frame.total(coefficients.M, coefficients.C, coefficients.K)
        return replace(total, sampled=given.sampled), frame


def _turned(forcing: Forcing, amplitude: Vector, phase: Vector) -> Forcing:
    """The forcing with harmonics of relative ``amplitude`` that lead by ``phase``, rad."""
    if np.all(amplitude == 1.0) and not np.any(phase):
        return forcing
    cos, sin = (amplitude * np.cos(phase))[:, None], (amplitude * np.sin(phase))[:, None]
    return replace(
        forcing,
        cosine=forcing.cosine * cos + forcing.sine * sin,
        sine=forcing.sine * cos - forcing.cosine * sin,
    )
