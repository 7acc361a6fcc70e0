# SPDX-License-Identifier: Apache-2.0
"""A model file: a linear system or a robot, and the initial state of the plant.

Reading takes four steps: the YAML (``yaml_text``); deviations are set apart by the path of their
number (``parameters_in_file``); keys and values are those of the ``schema``; a ``LinearFile`` or
a ``RobotDescription`` is made, with the places of all parameters, to which deviations belong.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from numpy.typing import ArrayLike

from impact_observer.errors import ModelError, NotLinearError, UsageError
from impact_observer.model.contact_sensors import KEY as SENSORS
from impact_observer.model.contact_sensors import (
    ContactSensors,
    contact_sensors,
    written_sensors,
)
from impact_observer.model.document import Value, converted
from impact_observer.model.fit_verdict import TimeShift, WrittenVerdict, verdict_keys
from impact_observer.model.free_parameters import LATENCY, is_observed
from impact_observer.model.linear_model import (
    LinearFile,
    matrix_form,
    written_samples,
)
from impact_observer.model.parameter_uncertainty import ParameterUncertainty, read_uncertainty
from impact_observer.model.parameters_in_file import (
    ParameterPlace,
    PlainDocument,
    declared_deviations,
    of_use,
    without_deviations,
)
from impact_observer.model.robot_description import (
    RobotDescription,
    places_in_robot,
    read_robot,
)
from impact_observer.model.schema import Common, ElementModel, MatrixModel, RobotModel, State
from impact_observer.model.system import Element, System, checked_parts
from impact_observer.model.yaml_text import load_yaml, yaml_text
from impact_observer.resources import read_file_or_sample
from impact_observer.states import Vector


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
        form: the keys of the file for elements or a robot itself, with what other files hold;
            empty for a file with matrices.
        uncertainty: how well the parameters are known; None if the file says nothing.
        robot: the robot; None for a linear system.
        sensors: errors of the sensors of single contacts.
        places: where the numbers of parameters stand in the file.
    """

    linear: System | None
    position: Vector | None = None
    velocity: Vector | None = None
    provenance: Mapping[str, Value] = field(default_factory=dict)
    source: str = ""
    elements: tuple[Element, ...] = ()
    form: Mapping[str, Value] = field(default_factory=dict)
    uncertainty: ParameterUncertainty | None = None
    robot: RobotDescription | None = None
    sensors: ContactSensors = field(default_factory=dict)
    places: tuple[ParameterPlace, ...] = ()

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
    def noticed(self) -> tuple[str, ...]:
        """Names of the contacts that have a sensor."""
        names = self.subject.contact_names
        return tuple(each for each in names if self.sensors.get(each, True) is not None)

    @property
    def has_exact_numbers(self) -> bool:
        """Whether the file declares some number to be exact, by a deviation of 0."""
        return self.uncertainty is not None and not self.uncertainty.deviations.all()

    @property
    def misfit(self) -> str:
        """The warning that the model does not fit its impacts; empty if ``identify`` said none."""
        verdict = WrittenVerdict.of(self.provenance)
        if verdict.fits:
            return ""
        name = f"{self.source or self.subject.name} does not fit the impacts"
        if not verdict.residual:
            return f"{name} to which it was fitted: no motion explains these; see docs/troubles.md"
        return (
            f"{name} from which it was identified: shifts of {verdict.residual:.2g} s rms are"
            f" left, and deviations contain one of {verdict.shift:.2g} s; see docs/troubles.md"
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
        return WrittenVerdict.of(self.provenance).time_shift

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

    def with_urdf(self, text: str) -> "Model":
        """The model of a robot with the ``text`` of the URDF that came from its topic.

        Raises:
            ModelError: the URDF does not fit the model file.
        """
        assert self.robot is not None, "the model is a robot"
        return replace(self, robot=self.robot.with_urdf(text), form={**self.form, "urdf": text})

    def text(self, provenance: Mapping[str, Value] | None = None) -> str:
        """The text of a model file of this model, with elements or with matrices as read.

        Reading the text gives equal numbers. Matrices and samples from other files are in the
        text. ``provenance`` is the origin of the text, such as package, version and seed; a
        verdict of ``identify`` on the model is kept beside it.
        """
        form = matrix_form(self.system) if self.robot is None and not self.form else self.form
        document: dict[str, Value] = {"name": self.subject.name, **form}
        if self.position is not None and self.velocity is not None:
            document["initial_state"] = {
                "position": self.position.tolist(),
                "velocity": self.velocity.tolist(),
            }
        if self.uncertainty is not None:
            document["uncertainty"] = self.uncertainty.document
        if self.sensors:
            document[SENSORS] = written_sensors(self.sensors)
        if origin := provenance or self.provenance:
            document["provenance"] = {**origin, **verdict_keys(self.provenance)}
        return yaml_text(document)


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


def read_model(source: str | Path) -> Model:
    """Read a model file, or a sample model by its name, such as ``two_mass``.

    Raises:
        ModelError: one line that names the file, the key and the expected value.
        UsageError: the file does not exist.
    """
    return parse_model(*model_text(source))


ModelSource: TypeAlias = Model | System | str | Path
"""A model, a bare system, or the path of a model file or the name of a sample model."""


def model_of(source: object, asking: str) -> Model:
    """The model that ``source`` is or names; errors begin with ``asking``, who wants the model.

    Raises:
        ModelError: one line that names the file, the key and the expected value.
        UsageError: ``source`` is something else, or the file does not exist.
    """
    if isinstance(source, Model):
        return source
    if isinstance(source, System):
        return Model(source)
    if not isinstance(source, str | Path) or "\n" in str(source):
        found = type(source).__name__ if not isinstance(source, str) else "a text of several lines"
        raise UsageError(
            f"{asking}: {found} found; expected a Model, a System, or the path of a model file;"
            " parse_model(TEXT, NAME) reads a text"
        )
    return read_model(source)


def parse_model(text: str, source: str, folder: Path | None = None) -> Model:
    """Read a model from its ``text``; the arguments are those of ``ModelText``.

    Raises:
        ModelError: one line that names ``source``, the key and the expected value.
    """
    try:
        document = load_yaml(text)
        if not isinstance(document, Mapping):
            raise ModelError("", "is not a model: expected a YAML mapping with name, bodies, ...")
        plain = without_deviations(document)
        model = (_read_robot if "urdf" in document else _read_linear)(plain, folder)
        WrittenVerdict.of(model.provenance)
        return replace(model, source=source)
    except ModelError as error:
        raise error.in_file(source) from None


def _read_linear(plain: PlainDocument, folder: Path | None) -> Model:
    """A model with elements or matrices."""
    document, form = plain.document, dict[str, Any]()
    is_of_elements = "bodies" in document
    given: ElementModel | MatrixModel
    given = (
        converted(document, ElementModel) if is_of_elements else converted(document, MatrixModel)
    )
    file = LinearFile(given, folder)
    system, elements = file.system, tuple(file.elements)
    if is_of_elements:
        form = _own_keys(document)
        if system.own_forcing.sampled is not None:
            form["forcing"] = written_samples(system.own_forcing.sampled, system.coordinates)
        if system.frame is not None:
            form["grounds"] = list(system.frame.grounds.written)
    places = (
        *file.places,
        *(
            ParameterPlace(f"{LATENCY}.{name}", (SENSORS, name, LATENCY), offset=each.latency)
            for name, each in given.sensors.items()
            if each != "none" and each.latency is not None
        ),
    )
    declared = read_uncertainty(given.uncertainty)
    errors = declared_deviations(declared, plain.deviations, places)
    return Model(
        system,
        *_start(given.initial_state, partial(_outside_stops, system)),
        given.provenance,
        elements=elements,
        form=form,
        places=places,
        uncertainty=None if errors is None else of_use(errors, system, elements),
        sensors=contact_sensors(given.sensors, system.contact_names),
    )


def _read_robot(plain: PlainDocument, folder: Path | None) -> Model:
    """A model with the key ``urdf``."""
    given, form = converted(plain.document, RobotModel), _own_keys(plain.document)
    robot = read_robot(given, folder)
    if robot.urdf is not None:
        form["urdf"] = robot.urdf.text
    if robot.forcing.sampled is not None:
        samples = written_samples(robot.forcing.sampled, robot.joints)
        form["forcing"] = {**form["forcing"], **samples}
    places, declared = tuple(places_in_robot(given, robot)), read_uncertainty(given.uncertainty)
    errors = declared_deviations(declared, plain.deviations, places)
    for name, key in errors.keys.items() if errors else ():
        if name not in robot.parameters:
            wanted = ", ".join(robot.parameters)
            raise ModelError(key, f"{name!r} is no parameter; expected some of {wanted}")
    return Model(
        None,
        *_start(given.initial_state, partial(checked_parts, robot.n)),
        given.provenance,
        form=form,
        places=places,
        uncertainty=errors and errors.known,
        robot=robot,
        sensors=contact_sensors(given.sensors, robot.contact_names),
    )


def _own_keys(document: Mapping[str, Value]) -> dict[str, Any]:
    """The keys of the system or the robot itself, as they stand in a file."""
    return {k: value for k, value in document.items() if k not in Common.__struct_fields__}


def _start(
    given: State | None, checked: Callable[[ArrayLike, ArrayLike], tuple[Vector, Vector]]
) -> tuple[Vector | None, Vector | None]:
    """Positions and velocities at the epoch, shape (n,) each, as ``checked``, if any."""
    if given is None:
        return None, None
    try:
        return checked(given.position, given.velocity)
    except ModelError as error:
        raise ModelError(f"initial_state.{error.key}", error.problem) from None


def _outside_stops(
    system: System, position: ArrayLike, velocity: ArrayLike
) -> tuple[Vector, Vector]:
    """The checked state of a plant, which must not be inside a stop."""
    system.checked_start(position, velocity)
    return system.checked_state(position, velocity)
