# SPDX-License-Identifier: Apache-2.0
# mypy: disable-error-code="misc"
"""The keys of a model file: linear systems as elements or as matrices, and robots.

SI units: kg, N/m, Ns/m, N, m, s, rad/s, rad; for coordinates in rad those of angles. Of a robot
Nm s/rad or Ns/m, kg m^2 or kg, Nm or N by the type of the joint. Numbers of parameters may bear
their standard deviation, ``{value: 0.7, deviation: 0.01}`` (``parameters_in_file.py``). A matrix
of a linear system may be the name of a ``.npy`` or Matrix Market file beside the model file,
``sampled`` that of a CSV file, or its text. None stands for a key that is left out.

All classes are frozen as ``Keys`` is; mypy asks each class to say so, hence the line above.
"""

import math
from typing import Annotated, Any, Literal, TypeAlias

from msgspec import Meta, field

from impact_observer.errors import ModelError
from impact_observer.model.contact_sensors import ContactSensor
from impact_observer.model.document import Keys, Name, NotNegative, Number, Positive

Row: TypeAlias = tuple[Number, ...]
File: TypeAlias = str
Pair: TypeAlias = tuple[Name, Name]
MOST_BODIES = 10_000
"""As many have matrices of 100 million numbers."""
Restitution: TypeAlias = Number | dict[str, Number]
"""A coefficient, or the numbers of another rebound law by name (``rebounds/``)."""


class State(Keys):
    """The plant's state at the epoch: coordinates, m or rad, and velocities."""

    position: Row
    velocity: Row


class FittedTo(Keys):
    """First and last stamp of the impacts from which values were fitted, ns."""

    first: int
    last: int


class UncertaintyKeys(Keys):
    """Covariance of parameters by the names that ``identify --free`` has, SI units."""

    names: Annotated[tuple[Name, ...], Meta(min_length=1)]
    covariance: tuple[Row, ...]
    fitted_to: FittedTo | None = None


class Common(Keys):
    """What all models have.

    Attributes:
        provenance: origin of the file, and the verdict of ``identify``.
        sensors: by contact.
    """

    name: Name
    initial_state: State | None = None
    uncertainty: UncertaintyKeys | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    sensors: dict[str, ContactSensor | Literal["none"]] = field(default_factory=dict)


class Rate(Keys):
    """A frequency, in rad/s or in Hz."""

    frequency: Positive | None = None
    hertz: Positive | None = None

    @property
    def omega(self) -> float:
        """The angular frequency, rad/s.

        Raises:
            ModelError: both keys or neither.
        """
        if self.frequency is not None and self.hertz is not None:
            raise ModelError("hertz", "stands beside frequency; write one of them")
        if self.hertz is not None:
            return math.tau * self.hertz
        if self.frequency is None:
            raise ModelError("frequency", "is missing")
        return self.frequency


class Periodic(Rate):
    """What needs a frequency."""

    def __post_init__(self) -> None:
        """Check that there is one frequency."""
        _ = self.omega


class Wave(Periodic, kw_only=True):
    """``amplitude cos(w t + phase)``, m."""

    amplitude: Number
    phase: Number = 0.0


class MotionKeys(Keys):
    """The motion of a ground: a sum of waves, or a table of ``time`` and ``displacement``."""

    harmonics: tuple[Wave, ...] | None = None
    sampled: File | None = None

    def __post_init__(self) -> None:
        """Check that there is one of both."""
        self.check_form(("harmonics",) if self.sampled is None else ("sampled",))


class Ground(Keys):
    """A ground that moves by itself."""

    name: Name
    motion: MotionKeys


class TableKeys(Keys):
    """Forces at instants, s since the epoch, one row of all coordinates an instant."""

    time: Row
    force: tuple[Row, ...]


class SampledForces(Keys):
    """Forces by samples, beside those of other keys."""

    sampled: File | TableKeys | None = None
    hold: Literal["previous", "linear"] | None = None

    def __post_init__(self) -> None:
        """Check that samples have a hold, and a hold samples."""
        if (self.sampled is None) != (self.hold is None):
            missing = "sampled" if self.sampled is None else "hold"
            raise ModelError(missing, "is missing; expected both sampled and hold")


class Linear(Common):
    """What linear systems have in both forms; unit: of the coordinates."""

    unit: Literal["m", "rad"] | None = None
    grounds: tuple[Ground, ...] = ()


class Body(Keys):
    """A mass on the line."""

    name: Name
    mass: Positive


class Spring(Keys):
    """A spring, and a damper, between two bodies or grounds."""

    between: Pair
    stiffness: NotNegative
    damping: NotNegative | None = None


class Force(Rate, kw_only=True):
    """A force on a body: one constant, wave, square wave or live input."""

    body: Name
    constant: Number | None = None
    amplitude: Number | None = None
    phase: Number | None = None
    shape: Literal["square"] | None = None
    input: Name | None = None

    def __post_init__(self) -> None:
        """Check that the keys are those of one form."""
        if self.input is not None:
            self.check_form(("input",))
        elif self.constant is not None:
            self.check_form(("constant",))
        else:
            self.check_form(("amplitude",), ("frequency", "hertz", "phase", "shape"))
            _ = self.omega


class StopKeys(Keys):
    """A stop: ``g = limit - q`` above or ``q - limit`` below, or ``g = q_b - q_a + gap``.

    Attributes:
        ground: on which a stop of a body rests.
    """

    name: Name
    restitution: Restitution
    body: Name | None = None
    limit: Number | None = None
    side: Literal["above", "below"] | None = None
    ground: Name | None = None
    between: Pair | None = None
    gap: Number | None = None

    def __post_init__(self) -> None:
        """Check that the keys are those of one form."""
        if self.between is not None:
            self.check_form(("between", "gap"))
        else:
            self.check_form(("body", "limit", "side"), ("ground",))


class ElementModel(Linear, kw_only=True):
    """A linear system as bodies, springs, forces and stops on one line."""

    bodies: Annotated[tuple[Body, ...], Meta(min_length=1, max_length=MOST_BODIES)]
    springs: tuple[Spring, ...] = ()
    forces: tuple[Force, ...] = ()
    forcing: SampledForces = SampledForces()
    stops: tuple[StopKeys, ...] = ()


class Harmonic(Periodic):
    """``cosine cos(w t) + sine sin(w t)``, a number a coordinate."""

    cosine: Row | None = None
    sine: Row | None = None


class Square(Periodic, kw_only=True):
    """``amplitude sign(cos(w t + phase))``, a number a coordinate."""

    amplitude: Row
    phase: Number = 0.0


class GroundForces(Keys):
    """Forces by unit displacement, and by unit speed, of a ground."""

    name: Name
    stiffness: Row | None = None
    damping: Row | None = None


class LiveForce(Keys):
    """A force that arrives live, by its direction."""

    name: Name
    direction: Row


class SmoothForcing(SampledForces):
    """``f(t)`` by constants, harmonics and samples."""

    constant: Row | None = None
    harmonics: tuple[Harmonic, ...] = ()


class ForcingKeys(SmoothForcing):
    """``f(t)`` of a linear system in matrices."""

    squares: tuple[Square, ...] = ()
    grounds: tuple[GroundForces, ...] = ()
    inputs: tuple[LiveForce, ...] = ()


class GroundFactor(Keys):
    """How much a ground moves a stop: ``g += factor s(t)``."""

    ground: Name
    factor: Number


class MatrixContact(Keys):
    """``g = direction . q + gap``, m."""

    name: Name
    direction: Row
    gap: Number
    restitution: Restitution
    motion: tuple[GroundFactor, ...] = ()


class MatrixModel(Linear, kw_only=True):
    """A linear system as matrices, shape (n, n)."""

    coordinates: Annotated[tuple[Name, ...], Meta(min_length=1)]
    mass: tuple[Row, ...] | File
    damping: tuple[Row, ...] | File
    stiffness: tuple[Row, ...] | File
    contacts: tuple[MatrixContact, ...]
    forcing: ForcingKeys = ForcingKeys()


class TopicKeys(Keys):
    """The latched topic of a URDF."""

    topic: Name


class Effort(Keys):
    """Where measured efforts come from, N m or N."""

    topic: Name
    field: Literal["effort"]


class RobotContact(Keys):
    """``g = normal . p(frame) - offset``, m, in the root frame of the URDF."""

    name: Name
    frame: Name
    normal: Row
    offset: Number
    restitution: Restitution


class RobotModel(Common, kw_only=True):
    """A robot; numbers by joint.

    Attributes:
        urdf: file beside the model file, XML, or topic.
        held: positions of movable joints that are no part of the state.
        torque_deviation: of white torques, N m sqrt(s) or N sqrt(s).
    """

    urdf: str | TopicKeys
    joints: tuple[Name, ...]
    held: dict[str, Number] = field(default_factory=dict)
    damping: dict[str, NotNegative] = field(default_factory=dict)
    rotor_inertia: dict[str, NotNegative] = field(default_factory=dict)
    contacts: tuple[RobotContact, ...] = ()
    forces: Effort | None = None
    torque_deviation: NotNegative | dict[str, NotNegative] | None = None
    gravity: Row = (0.0, 0.0, -9.81)
    forcing: SmoothForcing = SmoothForcing()
