# SPDX-License-Identifier: Apache-2.0
"""A family of systems that differ by a few parameters, with exact derivatives."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import MovingFrame
from impact_observer.model.restitution import Curve, PowerLaw
from impact_observer.model.system import Contact, Guide, System
from impact_observer.states import Matrix, Vector, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """All coefficients of a system that can be estimated, or their change with a parameter.

    Attributes:
        M: mass matrix, shape (n, n), kg.
        C: damping matrix, shape (n, n), Ns/m.
        K: stiffness matrix, shape (n, n), N/m.
        gap: gaps in the rest position, shape (m,), m.
        eps: restitution, shape (m,); of a power law its ``value``.
        exponent: of power laws of the speed, shape (m,); 0 for other contacts.
        amplitude: of the harmonics, relative to the model's, shape (h,).
        phase: by which the harmonics lead the model's, shape (h,), rad.
        friction: largest forces of the guides, shape (guides,), N.
        contact_time: how long an impact lasts, shape (m,), s.
    """

    M: Matrix
    C: Matrix
    K: Matrix
    gap: Vector
    eps: Vector
    exponent: Vector
    amplitude: Vector
    phase: Vector
    friction: Vector
    contact_time: Vector

    @classmethod
    def of(cls, system: System) -> "Coefficients":
        """Those of ``system``."""
        h, lasts = system.forcing.frequency.size, system.contact_time
        harmonics = np.ones(h), np.zeros(h)
        curves = [each.curve for each in system.contacts]
        exponent = np.array([c.exponent if isinstance(c, PowerLaw) else 0.0 for c in curves])
        rebound = system.eps, exponent
        return cls(
            system.M, system.C, system.K, system.q_r, *rebound, *harmonics, system.friction, lasts
        )

    @property
    def parts(self) -> dict[str, Matrix]:
        """Those of a change that are not zero, by name."""
        named = {name: getattr(self, name) for name in self.__slots__}
        return {name: part for name, part in named.items() if np.any(part)}

    @classmethod
    def change(cls, system: System, **parts: Matrix) -> "Coefficients":
        """A change of ``parts``, by name, and of nothing else."""
        zero = {name: np.zeros_like(getattr(cls.of(system), name)) for name in cls.__slots__}
        return cls(**{**zero, **parts})

    def curve(self, system: System, contact: int) -> Curve | None:
        """How the restitution of a contact of ``system`` depends on the speed, if it does."""
        curve = system.contacts[contact].curve
        if not isinstance(curve, PowerLaw):
            return curve
        value, exponent = float(self.eps[contact]), float(self.exponent[contact])
        return replace(curve, value=value, exponent=exponent)


@dataclass(frozen=True, slots=True, eq=False)
class ModelParameter:
    """A parameter of a model that may be estimated; the coefficients are linear in it.

    Attributes:
        name: such as ``restitution.stop``.
        value: nominal value, that of the model.
        low: least value allowed.
        high: largest value allowed.
        size: error that makes the model useless, the scale of the parameter.
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
        """Whether the motion between impacts depends on it."""
        motion = {"M", "C", "K", "amplitude", "phase", "friction"}
        return not motion.isdisjoint(self.effect.parts)


@dataclass(frozen=True, slots=True, eq=False)
class ParametricFamily:
    """A system and the parameters in which it may be wrong.

    Attributes:
        system: the nominal one.
        parameters: the free ones.
        coefficients: of the nominal system. Derived.
    """

    system: System
    parameters: tuple[ModelParameter, ...]
    coefficients: Coefficients = field(init=False)
    _effects: tuple[tuple[float, dict[str, Matrix]], ...] = field(init=False)

    def __post_init__(self) -> None:
        """Take the system's coefficients, and what each parameter changes of them."""
        effects = tuple((each.value, each.effect.parts) for each in self.parameters)
        object.__setattr__(self, "coefficients", Coefficients.of(self.system))
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

    def at(self, values: Vector) -> Coefficients:
        """The coefficients for parameter ``values``, shape (p,)."""
        found = {name: getattr(self.coefficients, name) for name in Coefficients.__slots__}
        for (nominal, parts), value in zip(self._effects, values.tolist(), strict=True):
            if value != nominal:
                by = value - nominal
                found |= {name: found[name] + by * part for name, part in parts.items()}
        return Coefficients(**found)

    def force_changes(self, values: Vector, t: float) -> Matrix:
        """Derivative of the force at ``t``, s since the epoch, by each parameter, shape (p, n)."""
        found = np.zeros((self.size, self.system.n))
        if all(parts.keys().isdisjoint({"amplitude", "phase"}) for _, parts in self._effects):
            return found
        coefficients, forcing = self.at(values), self.system.forcing
        wave = np.exp(1j * (forcing.frequency * t + coefficients.phase))
        for j, each in enumerate(self.parameters):
            turn = (each.effect.amplitude + 1j * coefficients.amplitude * each.effect.phase) * wave
            found[j] = turn.real @ forcing.cosine + turn.imag @ forcing.sine
        return found

    def system_at(self, values: Vector) -> System:
        """The system for parameter ``values``, shape (p,).

        Raises:
            ModelError: that is not a valid system.
        """
        return replace(self.system, **self._changed(self.at(values)))

    def near(self, values: Vector) -> System:
        """The system for parameter ``values``, shape (p,), within their bounds; not checked."""
        found = self.at(values)
        changed = self._changed(found)
        changed["eps"] = frozen([each.restitution for each in changed["contacts"]])
        return self.system.unchecked(q_r=found.gap, contact_time=found.contact_time, **changed)

    def _changed(self, found: Coefficients) -> dict[str, Any]:
        """The fields of the system with the coefficients ``found``."""
        numbers = (found.gap, found.eps, found.contact_time)
        stops = zip(self.system.contacts, *(each.tolist() for each in numbers), strict=True)
        curves = [found.curve(self.system, i) for i in range(self.system.m)]
        contacts = tuple(
            Contact(each.name, each.direction, gap, c.nominal if c else eps, c, lasts)
            for (each, gap, eps, lasts), c in zip(stops, curves, strict=True)
        )
        guides = tuple(
            Guide(each.name, each.direction, force)
            for each, force in zip(self.system.guides, found.friction.tolist(), strict=True)
        )
        return {
            "M": found.M,
            "C": found.C,
            "K": found.K,
            "forcing": _turned(self.system.forcing, found.amplitude, found.phase),
            "contacts": contacts,
            "frame": self._frame_at(found),
            "guides": guides,
        }

    def _frame_at(self, found: Coefficients) -> MovingFrame | None:
        """The frame whose own harmonics, the first, and those of grounds have changed."""
        frame = self.system.frame
        if frame is None:
            return None
        own = frame.forcing.frequency.size
        motion = _turned(frame.grounds.motion, found.amplitude[own:], found.phase[own:])
        return replace(
            frame,
            grounds=replace(frame.grounds, motion=motion),
            forcing=_turned(frame.forcing, found.amplitude[:own], found.phase[:own]),
        )


def _turned(forcing: Forcing, amplitude: Vector, phase: Vector) -> Forcing:
    """Harmonics of other amplitudes, relative to their own, that lead them by ``phase``, rad."""
    if np.all(amplitude == 1.0) and not np.any(phase):
        return forcing
    cos, sin = (amplitude * np.cos(phase))[:, None], (amplitude * np.sin(phase))[:, None]
    return replace(
        forcing,
        cosine=forcing.cosine * cos + forcing.sine * sin,
        sine=forcing.sine * cos - forcing.cosine * sin,
    )
