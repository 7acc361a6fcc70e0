"""Systems that differ by a few parameters, with their exact derivatives."""

from dataclasses import dataclass, field, replace

import numpy as np

from impact_observer.model.forcing import Forcing
from impact_observer.model.system import Contact, System
from impact_observer.states import Matrix, Vector, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """All numbers of a system that can be learnt, or their change with a parameter.

    Attributes:
        M: mass matrix, shape (n, n), kg.
        C: damping matrix, shape (n, n), Ns/m.
        K: stiffness matrix, shape (n, n), N/m.
        gap: gaps in the rest position, shape (m,), m.
        eps: restitution, shape (m,).
        amplitude: of the harmonics over what the model says, shape (h,).
        phase: by which the harmonics are ahead of what the model says, shape (h,), rad.
    """

    M: Matrix
    C: Matrix
    K: Matrix
    gap: Vector
    eps: Vector
    amplitude: Vector
    phase: Vector

    @classmethod
    def of(cls, system: System) -> "Coefficients":
        """Those of ``system``."""
        h = system.forcing.frequency.size
        return cls(system.M, system.C, system.K, system.q_r, system.eps, np.ones(h), np.zeros(h))

    @classmethod
    def change(cls, system: System, **parts: Matrix) -> "Coefficients":
        """Nothing but ``parts``, by name."""
        zero = {name: np.zeros_like(getattr(cls.of(system), name)) for name in cls.__slots__}
        return cls(**{**zero, **parts})

    def plus(self, factor: float, other: "Coefficients") -> "Coefficients":
        """These and ``factor`` times the others."""
        return Coefficients(
            *(getattr(self, name) + factor * getattr(other, name) for name in self.__slots__)
        )


@dataclass(frozen=True, slots=True, eq=False)
class ModelParameter:
    """A number of a model that is to be learnt; the model is linear in it.

    Attributes:
        name: such as ``restitution.stop``.
        value: what the model says.
        low: least that it may be.
        high: most that it may be.
        size: an error of so much means that nothing is known of it.
        unit: in words; empty for a ratio.
        effect: how the numbers of the system change with it.
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
        motion = ("M", "C", "K", "amplitude", "phase")
        return any(np.any(getattr(self.effect, name)) for name in motion)


@dataclass(frozen=True, slots=True, eq=False)
class ParametricFamily:
    """A system and the parameters in which it may be wrong.

    Attributes:
        system: as the model says.
        parameters: free ones.
        numbers: of the system. Derived.
    """

    system: System
    parameters: tuple[ModelParameter, ...]
    numbers: Coefficients = field(init=False)

    def __post_init__(self) -> None:
        """Take the system's numbers."""
        object.__setattr__(self, "numbers", Coefficients.of(self.system))

    @property
    def size(self) -> int:
        """How many parameters there are."""
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(each.name for each in self.parameters)

    @property
    def nominal(self) -> Vector:
        """What the model says, shape (p,)."""
        return frozen([each.value for each in self.parameters])

    @property
    def sizes(self) -> Vector:
        """See ``ModelParameter``, shape (p,)."""
        return frozen([each.size for each in self.parameters])

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Least and most that each may be, shape (p,) each."""
        return (
            frozen([each.low for each in self.parameters]),
            frozen([each.high for each in self.parameters]),
        )

    def at(self, values: Vector) -> Coefficients:
        """The numbers where the parameters have ``values``, shape (p,)."""
        found = self.numbers
        for each, value in zip(self.parameters, values, strict=True):
            found = found.plus(float(value) - each.value, each.effect)
        return found

    def force_changes(self, values: Vector, t: float) -> Matrix:
        """How the force at ``t`` (s since the epoch) changes with each parameter, shape (p, n).

        Args:
            values: of the parameters, shape (p,).
            t: s since the epoch.
        """
        numbers, forcing = self.at(values), self.system.forcing
        wave = np.exp(1j * (forcing.frequency * t + numbers.phase))
        found = np.zeros((self.size, self.system.n))
        for j, each in enumerate(self.parameters):
            turn = (each.effect.amplitude + 1j * numbers.amplitude * each.effect.phase) * wave
            found[j] = turn.real @ forcing.cosine + turn.imag @ forcing.sine
        return found

    def system_at(self, values: Vector) -> System:
        """The system where the parameters have ``values``, shape (p,).

        Raises:
            ModelError: it is none.
        """
        return system_with(self.system, self.at(values))


def system_with(system: System, numbers: Coefficients) -> System:
    """``system`` with other ``numbers``."""
    cosine, sine = rotated_harmonics(system.forcing, numbers)
    return replace(
        system,
        M=numbers.M,
        C=numbers.C,
        K=numbers.K,
        forcing=replace(system.forcing, cosine=cosine, sine=sine),
        contacts=tuple(
            Contact(each.name, each.direction, gap, eps)
            for each, gap, eps in zip(
                system.contacts, numbers.gap.tolist(), numbers.eps.tolist(), strict=True
            )
        ),
    )


def rotated_harmonics(forcing: Forcing, numbers: Coefficients) -> tuple[Matrix, Matrix]:
    """Cosine and sine parts of harmonics that are ahead by a phase, shape (h, n) each, N."""
    cos = (numbers.amplitude * np.cos(numbers.phase))[:, None]
    sin = (numbers.amplitude * np.sin(numbers.phase))[:, None]
    return forcing.cosine * cos + forcing.sine * sin, forcing.sine * cos - forcing.cosine * sin
