# SPDX-License-Identifier: Apache-2.0
"""A model file: a linear system or a robot, and the initial state of the plant."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import UnsetType

from impact_observer.errors import ModelError, NotLinearError
from impact_observer.model.contact_sensors import KEY as SENSORS
from impact_observer.model.contact_sensors import NO_SENSORS, ContactSensors, contact_sensors
from impact_observer.model.declared_deviations import (
    PlainDocument,
    with_deviations,
    with_robot_deviations,
    without_deviations,
)
from impact_observer.model.document import (
    Keys,
    NotNegative,
    Positive,
    Value,
    converted,
    vector,
)
from impact_observer.model.elements import Element, assembled_system
from impact_observer.model.free_parameters import is_observed
from impact_observer.model.matrices import matrix_form, system_of_matrices
from impact_observer.model.parameter_uncertainty import ParameterUncertainty, read_uncertainty
from impact_observer.model.robot_description import RobotDescription, one_of_each
from impact_observer.model.robot_file import read_robot
from impact_observer.model.sampled_files import written_samples
from impact_observer.model.schema import Common, ElementModel, MatrixModel, RobotModel, State
from impact_observer.model.system import (
    LARGEST_STATE,
    UNITS,
    UNKNOWN_UNIT,
    System,
)
from impact_observer.model.time_shift import NO_SHIFT, TimeShift
from impact_observer.model.yaml_text import load_yaml, yaml_text
from impact_observer.resources import read_file_or_sample
from impact_observer.states import Vector, frozen

VERDICT = FITS, RESIDUAL, SHIFT, INTERVAL = ("fits", "residual", "shift", "interval")
"""Keys of the provenance by which ``identify`` says whether a model fits, and what is left: the
rms of the shifts, s, and where these are no errors of the clock a ``TimeShift``.
"""


class _Verdict(Keys, frozen=True):
    """The verdict of ``identify`` in a provenance."""

    fits: bool = True
    residual: NotNegative = 0.0
    shift: NotNegative = NO_SHIFT.largest
    interval: Positive = NO_SHIFT.interval


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The contents of a model file.

    Attributes:
        linear: the system that plant and replica share; None for a robot.
        position: the plant's coordinates at the epoch, shape (n,); None if the file has none.
        velocity: the plant's velocities at the epoch, shape (n,); None if the file has none.
        provenance: origin of the file, and the verdict of ``identify``; without effect on the
            dynamics.
        source: name of the file in errors.
        elements: the elements of the system; empty for a file with matrices.
        element_form: the bodies, springs and so on of the file, by key; empty for a file with
            matrices.
        uncertainty: how well the parameters are known; None if the file says nothing.
        robot: the robot; None for a linear system.
        sensors: errors of the sensors of single contacts.
    """

    linear: System | None
    position: Vector | None = None
    velocity: Vector | None = None
    provenance: Mapping[str, Value] = field(default_factory=dict)
    source: str = ""
    elements: tuple[Element, ...] = ()
    element_form: Mapping[str, Value] = field(default_factory=dict)
    uncertainty: ParameterUncertainty | None = None
    robot: RobotDescription | None = None
    sensors: ContactSensors = NO_SENSORS

    def __repr__(self) -> str:
        about = self.linear if self.robot is None else self.robot
        name, contacts = ("", ()) if about is None else (about.name, about.contact_names)
        return f"<Model {name}: contacts {', '.join(contacts) or 'none'}>"

    @property
    def system(self) -> System:
        """The linear system.

        Raises:
            NotLinearError: the model is a robot.
        """
        if self.linear is None:
            assert self.robot is not None, "one of the two"
            raise NotLinearError(f"{self.robot.name}: a robot (urdf: {self.robot.origin})")
        return self.linear

    @property
    def subject(self) -> System | RobotDescription:
        """The linear system, or the robot."""
        return self.system if self.robot is None else self.robot

    @property
    def has_exact_numbers(self) -> bool:
        """Whether the file declares some number to be exact, by a deviation of 0."""
        return self.uncertainty is not None and not self.uncertainty.deviations.all()

    @property
    def misfit(self) -> str:
        """The warning that the model does not fit its impacts; empty if ``identify`` said none."""
        if self.provenance.get(FITS, True):
            return ""
        name = f"{self.source or self.subject.name} does not fit the impacts"
        if RESIDUAL not in self.provenance:
            return f"{name} to which it was fitted: no motion explains these; see docs/troubles.md"
        left = _verdict(self.provenance).residual
        return (
            f"{name} from which it was identified: shifts of {left:.2g} s rms are left, and"
            f" deviations contain one of {self.shift.largest:.2g} s; see docs/troubles.md"
        )

    @property
    def doubts(self) -> Iterator[str]:
        """Warnings of what makes the deviations of every estimate with the model wrong."""
        if self.misfit:
            yield self.misfit
        if self.uncertainty is None or self.robot is not None:
            return
        known = self.uncertainty.deviation_by_name
        if names := ",".join(n for n, each in known.items() if each and not is_observed(n)):
            yield (
                f"taken for exact, as no observer considers them: {names.replace(',', ', ')};"
                f" identify --free {names} on this recording makes their errors small,"
                " --model-error counts what remains"
            )

    @property
    def shift(self) -> TimeShift:
        """By how much the motion may be early or late, as the fit of the model has shown."""
        verdict = _verdict(self.provenance)
        return TimeShift(verdict.shift, verdict.interval)

    def initial_state(self) -> tuple[Vector, Vector]:
        """The plant's state at the epoch.

        Raises:
            ModelError: the file has no initial state.
        """
        if self.position is None or self.velocity is None:
            key = f"{self.source}: initial_state" if self.source else "initial_state"
            zeros = ", ".join(["0"] * self.subject.n)
            form = f"initial_state: {{position: [{zeros}], velocity: [{zeros}]}}"
            raise ModelError(key, f"is missing; a plant needs one, such as {form}")
        return self.position, self.velocity

    def text(self, provenance: Mapping[str, Value] | None = None) -> str:
        """The text of a model file of this model, with elements or with matrices as read.

        Reading the text gives equal numbers. Matrices and samples from other files are in the
        text. ``provenance`` is the origin of the text, such as package, version and seed; a
        verdict of ``identify`` on the model is kept beside it.
        """
        document = self._form() if self.robot is None else dict(self.robot.document)
        document = {"name": self.subject.name, **document}
        if self.position is not None and self.velocity is not None:
            document["initial_state"] = {
                "position": self.position.tolist(),
                "velocity": self.velocity.tolist(),
            }
        if self.uncertainty is not None:
            document["uncertainty"] = self.uncertainty.document
        if self.sensors.by_contact:
            document[SENSORS] = self.sensors.document
        if provenance or self.provenance:
            own = VERDICT if FITS in self.provenance else ()
            verdict = {key: self.provenance[key] for key in own if key in self.provenance}
            document["provenance"] = {**(provenance or self.provenance), **verdict}
        return yaml_text(document)

    def _form(self) -> dict[str, Value]:
        """The keys of a linear system."""
        form = dict(self.element_form or matrix_form(self.system))
        if self.system.unit != _unit_of(elements=bool(self.element_form)):
            form["unit"] = self.system.unit
        if self.element_form and self.system.frame is not None:
            form["grounds"] = list(self.system.frame.grounds.written)
        return form


def _unit_of(*, elements: bool) -> str:
    """The unit of coordinates for a file of this form without the key ``unit``."""
    return UNITS[0] if elements else UNKNOWN_UNIT


class ModelText(NamedTuple):
    """The arguments of ``parse_model``.

    Attributes:
        text: the YAML.
        source: name of the text in errors, such as the path of the file.
        folder: folder of matrix files; without a folder a model must not name a file.
    """

    text: str
    source: str
    folder: Path | None = None


def model_text(source: str | Path) -> ModelText:
    """The text of a model file, or of a sample model by its name, such as ``two_mass``.

    Raises:
        UsageError: the file does not exist.
    """
    path, text = read_file_or_sample(source, "config", "a model file, or a sample model")
    return ModelText(text, str(path), path.parent)


_MASSES = re.compile(r"\bmass *:")
"""What each body of a model file has, to be counted before the file is read as YAML."""
_MOST_BODIES = 10_000
"""As many have matrices of 100 million numbers; YAML takes a minute for ten times as many."""


def read_model(source: str | Path) -> Model:
    """Read a model file, or a sample model by its name, such as ``two_mass``.

    Raises:
        ModelError: one line that names the file, the key and the expected value.
        UsageError: the file does not exist.
    """
    return parse_model(*model_text(source))


def parse_model(text: str, source: str, folder: Path | None = None) -> Model:
    """Read a model from its ``text``; the arguments are those of ``ModelText``.

    Raises:
        ModelError: one line that names ``source``, the key and the expected value.
    """
    try:
        if (count := len(_MASSES.findall(text))) > _MOST_BODIES:
            raise ModelError("bodies", f"{count} found; expected at most {_MOST_BODIES}")
        return replace(_model(load_yaml(text), folder), source=source)
    except ModelError as error:
        raise error.in_file(source) from None


def _model(document: Value, folder: Path | None) -> Model:
    if not isinstance(document, Mapping):
        raise ModelError("", "is not a model: expected a YAML mapping with name, bodies, ...")
    plain = without_deviations(document)
    if "urdf" in document:
        return _robot_model(plain, folder)
    kind: type[ElementModel | MatrixModel] = ElementModel if "bodies" in document else MatrixModel
    other = MatrixModel if "bodies" in document else ElementModel
    for key in document:
        if key in other.__struct_fields__ and key not in kind.__struct_fields__:
            raise ModelError(str(key), "does not go with the other keys: matrices or elements")
    given = converted(plain.document, kind)
    parts: tuple[Element, ...] = ()
    form: dict[str, Value] = {}
    if isinstance(given, ElementModel):
        system, parts = assembled_system(given, folder)
        form = _own_keys(plain.document)
        if not isinstance(given.forcing, UnsetType):
            form["forcing"] = written_samples(system.own_forcing.sampled, system.coordinates)
    else:
        system = system_of_matrices(given, folder)
    unit = _unit_of(elements=bool(form)) if isinstance(given.unit, UnsetType) else given.unit
    system = replace(system, unit=unit)
    uncertainty = with_deviations(read_uncertainty(given.uncertainty), plain, system, parts)
    return Model(
        system,
        *_start(given.initial_state, system),
        _provenance(given.provenance),
        elements=parts,
        element_form=form,
        uncertainty=uncertainty,
        sensors=contact_sensors(given.sensors, system.contact_names),
    )


def _robot_model(plain: PlainDocument, folder: Path | None) -> Model:
    """A model with the key ``urdf``."""
    given = converted(plain.document, RobotModel)
    robot = read_robot(given, _own_keys(plain.document), folder)
    meaning = one_of_each(robot.joints, robot.urdf)
    return Model(
        None,
        *_state(given.initial_state, robot.n, meaning),
        _provenance(given.provenance),
        uncertainty=with_robot_deviations(read_uncertainty(given.uncertainty), plain, robot),
        robot=robot,
        sensors=contact_sensors(given.sensors, robot.contact_names),
    )


def _own_keys(document: Mapping[str, Value]) -> dict[str, Value]:
    """The keys of the system itself, without grounds, as they stand in a file."""
    beside = (*Common.__struct_fields__, "unit", "grounds")
    return {key: value for key, value in document.items() if key not in beside}


def _provenance(given: Mapping[str, Value]) -> Mapping[str, Value]:
    """The provenance, of which a verdict is checked."""
    _verdict(given)
    return given


def _verdict(provenance: Mapping[str, Value]) -> _Verdict:
    """The verdict of ``identify`` in a provenance; without ``fits`` no key is one of a verdict."""
    if FITS not in provenance:
        return _Verdict()
    own = {key: provenance[key] for key in VERDICT if key in provenance}
    return converted(own, _Verdict, "provenance")


def _state(
    given: State | UnsetType, n: int, meaning: str = ""
) -> tuple[Vector | None, Vector | None]:
    """Positions and velocities at the epoch of ``n`` coordinates, shape (n,) each, if any."""
    if isinstance(given, UnsetType):
        return None, None
    position, velocity = (
        frozen(vector(f"initial_state.{name}", getattr(given, name), n, meaning))
        for name in ("position", "velocity")
    )
    for name, values in (("position", position), ("velocity", velocity)):
        for i in np.flatnonzero(np.abs(values) > LARGEST_STATE):
            raise ModelError(
                f"initial_state.{name}[{i}]", f"is too large; expected at most {LARGEST_STATE:g}"
            )
    return position, velocity


def _start(given: State | UnsetType, system: System) -> tuple[Vector | None, Vector | None]:
    """The plant's initial state, which must not be inside a stop."""
    position, velocity = _state(given, system.n)
    if position is None or velocity is None:
        return None, None
    at_epoch = system.to_frame(np.zeros(1, dtype=np.int64), np.append(position, velocity)[None])
    start = at_epoch[0, : system.n]
    for contact in system.penetrated(start):
        name, gap = system.contact_names[contact], system.gap(start)[contact]
        raise ModelError(
            "initial_state.position",
            f"is inside the stop {name!r} (gap {gap:g}); expected gap >= 0: check side, the order"
            " of between or the sign of direction, and the units of gap, limit and amplitudes of"
            " grounds",
        )
    return position, velocity
