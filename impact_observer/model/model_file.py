# SPDX-License-Identifier: Apache-2.0
"""A model file: a linear system or a robot, and the initial state of the plant."""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.representer import SafeRepresenter

from impact_observer.errors import ModelError, NotLinearError
from impact_observer.model import elements, sampled_files
from impact_observer.model.contact_sensors import KEY as SENSORS
from impact_observer.model.contact_sensors import (
    NO_SENSORS,
    ContactSensors,
    read_contact_sensors,
)
from impact_observer.model.declared_deviations import (
    read_robot_uncertainty,
    with_deviations,
    without_deviations,
)
from impact_observer.model.document import Section, Value
from impact_observer.model.elements import Element
from impact_observer.model.forcing import Forcing
from impact_observer.model.forcing_keys import KEYS as FORCING_KEYS
from impact_observer.model.forcing_keys import read_forcing, written_forcing
from impact_observer.model.free_parameters import is_observed
from impact_observer.model.gone_keys import problem_with_unit, without_gone
from impact_observer.model.ground_keys import (
    GroundMotions,
    live_names,
    read_grounds,
)
from impact_observer.model.hertz import HERTZ, convert
from impact_observer.model.parameter_uncertainty import ParameterUncertainty, read_uncertainty
from impact_observer.model.rebounds import REBOUND_KEYS, read_rebound
from impact_observer.model.robot_description import RobotDescription, one_of_each
from impact_observer.model.robot_file import ROBOT_KEYS, read_robot
from impact_observer.model.square_waves import SquareWaves
from impact_observer.model.system import (
    LARGEST_STATE,
    UNITS,
    UNKNOWN_UNIT,
    Contact,
    System,
    moving_system,
)
from impact_observer.model.time_shift import NO_SHIFT, TimeShift
from impact_observer.resources import MOST_BYTES, read_file_or_sample
from impact_observer.states import Matrix, Vector, frozen

_MATRIX_KEYS = ("coordinates", "mass", "damping", "stiffness", "grounds", "forcing", "contacts")
_NOT_YAML = (YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Exceptions of ruamel: its own errors, and others for values such as ``2020-13-45``."""
VERDICT = FITS, RESIDUAL, SHIFT, INTERVAL = ("fits", "residual", "shift", "interval")
"""Keys of the provenance by which ``identify`` says whether a model fits, and what is left: the
rms of the shifts, s, and where these are no errors of the clock a ``TimeShift``.
"""
_COMMON_KEYS = ("name", "unit", "initial_state", "uncertainty", "provenance", SENSORS)


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
        left = self._verdict.number(RESIDUAL, 0.0)
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
        return TimeShift(*map(self._verdict.number, (SHIFT, INTERVAL), NO_SHIFT))

    @property
    def _verdict(self) -> Section:
        return _verdict(self.provenance)

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
            verdict = {key: self._verdict.value(key) for key in VERDICT if key in self._verdict}
            document["provenance"] = {**(provenance or self.provenance), **verdict}
        stream = io.StringIO()
        yaml = YAML(typ="safe", pure=True)
        yaml.Representer = _Representer
        yaml.default_flow_style = None
        yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
        yaml.width = 99
        yaml.dump(document, stream)
        return stream.getvalue()

    def _form(self) -> dict[str, Value]:
        """The keys of a linear system."""
        form = dict(self.element_form or _matrix_form(self.system))
        if self.system.unit != _unit_of(elements=bool(self.element_form)):
            form["unit"] = self.system.unit
        if self.element_form and "forcing" in form:  # the form may name a file
            samples = self.system.own_forcing.sampled
            form["forcing"] = sampled_files.written_samples(samples, self.system.coordinates)
        if self.system.frame is not None:
            form["grounds"] = list(self.system.frame.grounds.written)
        return form


def _unit_of(*, elements: bool) -> str:
    """The unit of coordinates for a file of this form without the key ``unit``."""
    return UNITS[0] if elements else UNKNOWN_UNIT


class _Representer(SafeRepresenter):
    """Writes text of several lines as a block."""

    def represent_str(self, data: str) -> Value:
        """A block scalar for text with a line end, otherwise the default."""
        style = "|" if "\n" in data else None
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Representer.add_representer(str, _Representer.represent_str)


def _matrix_form(s: System) -> dict[str, Value]:
    moving = [] if s.frame is None else s.frame.grounds.factors.tolist()
    return {
        "coordinates": list(s.coordinates),
        "mass": s.M.tolist(),
        "damping": s.C.tolist(),
        "stiffness": s.K.tolist(),
        "forcing": _forcing_of(s),
        "contacts": [
            {
                "name": c.name,
                "direction": c.direction.tolist(),
                "gap": c.gap,
                **s.rebounds[i].document,
                **({"motion": _motion_of(s, moving[i])} if moving else {}),
            }
            for i, c in enumerate(s.contacts)
        ],
    }


def _motion_of(s: System, factors: Sequence[float]) -> Value:
    names = s.frame.grounds.names if s.frame is not None else ()
    return [
        {"ground": name, "factor": factor}
        for name, factor in zip(names, factors, strict=True)
        if factor
    ]


def _forcing_of(system: System) -> Value:
    forcing = system.own_forcing
    document = written_forcing(forcing, system.coordinates)
    if (waves := forcing.squares) is not None:
        parts = (waves.frequency.tolist(), waves.phase.tolist(), waves.force.tolist())
        document["squares"] = [
            {"frequency": frequency, "phase": phase, "amplitude": amplitude}
            for frequency, phase, amplitude in zip(*parts, strict=True)
        ]
    if system.frame is not None:
        grounds = system.frame.grounds
        document["grounds"] = [
            {"name": name, "stiffness": one.tolist(), "damping": other.tolist()}
            for name, one, other in zip(
                grounds.names, grounds.stiffness.T, grounds.damping.T, strict=True
            )
        ]
    if system.live is not None:
        inputs = zip(system.live.inputs, system.live.directions.T.tolist(), strict=True)
        document["inputs"] = [{"name": name, "direction": each} for name, each in inputs]
    return document


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
    return ModelText(_in_rad_per_s(text, str(path)), str(path), path.parent)


def _in_rad_per_s(text: str, source: str) -> str:
    """The ``text`` of a model file without frequencies in Hz; errors name the ``source``."""
    if not _HERTZ.search(text):
        return text
    try:
        load_yaml(text)  # which names what is no YAML
        yaml, document = _round_trip(text)
        convert(document)
    except ModelError as error:
        raise error.in_file(source) from None
    return _dumped(yaml, document)


_HERTZ = re.compile(rf"\b{HERTZ}\b")
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


def parse_model(
    text: str, source: str, folder: Path | None = None, *, comparing: bool = False
) -> Model:
    """Read a model from its ``text``; the arguments are those of ``ModelText``.

    Keys that went in 0.4.0 do not count if the model serves only for ``comparing`` states.

    Raises:
        ModelError: one line that names ``source``, the key and the expected value.
    """
    try:
        if (count := len(_MASSES.findall(text))) > _MOST_BODIES:
            raise ModelError("bodies", f"{count} found; expected at most {_MOST_BODIES}")
        document = load_yaml(_in_rad_per_s(text, source))
        document = without_gone(document) if comparing else document
        return replace(_model(document, folder), source=source)
    except ModelError as error:
        raise error.in_file(source) from None


def load_yaml(text: str) -> Value:
    """The document in a YAML text.

    Raises:
        ModelError: ``text`` is not YAML, or too long, also with its aliases written out; the error
            has no key.
    """
    if len(text) > MOST_BYTES:
        raise ModelError("", f"{len(text)} characters found; expected at most {MOST_BYTES}")
    try:
        document: Value = YAML(typ="safe", pure=True).load(text)
    except _NOT_YAML as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = str(getattr(error, "problem", None) or error).splitlines()[0]
        raise ModelError("", f"is not YAML{where}: {problem}") from None
    if (count := _written_out(document, {})) > len(text) + _MOST_REPEATED:
        problem = f"{count:.3g} values with its aliases written out; expected fewer"
        raise ModelError("", problem)
    return document


def _written_out(value: Value, counts: dict[int, int]) -> int:
    """Number of values in a document, aliases written out; ``counts`` has lists and mappings.

    Raises:
        ModelError: a value contains itself.
    """
    if not isinstance(value, (list, Mapping)):
        return 1
    if id(value) not in counts:
        counts[id(value)] = -1  # until all that it contains is counted
        members = value if isinstance(value, list) else [*value, *value.values()]
        counts[id(value)] = 1 + sum(_written_out(each, counts) for each in members)
    if (count := counts[id(value)]) < 0:
        raise ModelError("", "a value contains itself by its alias; write it out")
    return count


_MOST_REPEATED = 100_000
"""Most values that aliases may add, beside one for each character."""


def edited(text: str, changes: Mapping[tuple[str | int, ...], Value]) -> str:
    """The ``text`` of a model file with changed values; comments and layout stay.

    The keys of ``changes`` are paths in the file, such as ``("stops", 0, "limit")``. The index
    behind the last member of a list appends one. A deviation beside a changed value goes.
    """
    yaml, document = _round_trip(text)
    for (*path, last), found in changes.items():
        place, value = document, _with_rows(found)
        for part in path:
            place = place[part]
        if isinstance(place, list) and last == len(place):
            place.append(value)
            continue
        place[last] = value
        if last == "value":
            place.pop("deviation", None)
    return _dumped(yaml, document)


def _round_trip(text: str) -> tuple[YAML, Any]:
    """A YAML text with its comments and layout, and what writes them again."""
    yaml = YAML()
    yaml.width = 1_000_000  # ruamel breaks longer lines
    yaml.preserve_quotes = True
    if re.search(r"^ +- ", text, re.MULTILINE):
        yaml.indent(sequence=4, offset=2)
    return yaml, yaml.load(text)


def _dumped(yaml: YAML, document: Value) -> str:
    stream = io.StringIO()
    yaml.dump(document, stream)
    return stream.getvalue()


def _with_rows(value: Value) -> Value:
    """``value`` with each list of numbers in one line."""
    if isinstance(value, Mapping):
        return {key: _with_rows(each) for key, each in value.items()}
    if not isinstance(value, list):
        return value
    row = CommentedSeq(map(_with_rows, value))
    if not any(isinstance(each, list | Mapping) for each in value):
        row.fa.set_flow_style()
    return row


def _model(document: Value, folder: Path | None) -> Model:
    if not isinstance(document, Mapping):
        raise ModelError("", "is not a model: expected a YAML mapping with name, mass, ...")
    if "urdf" in document:
        return _robot_model(document, folder)
    form = elements.KEYS if "bodies" in document else _MATRIX_KEYS
    other = [k for k in (*elements.KEYS, *_MATRIX_KEYS) if k in document and k not in form]
    if other and any(k in document for k in form):
        raise ModelError(
            other[0], f"does not go with {form[0]}; write matrices or elements, not both"
        )
    plain = without_deviations(document)
    section = Section("", plain.document, (*_COMMON_KEYS, *form))
    name = section.text("name")
    parts: tuple[Element, ...] = ()
    written: dict[str, Value] = {}
    if form is elements.KEYS:
        system, parts = elements.assembled_system(name, section, folder)
        written = {key: plain.document[key] for key in form if key in document}
        written.pop("grounds", None)
    else:
        system = _system_of_matrices(name, section, folder)
    unit = _unit_of(elements=form is elements.KEYS)
    if "unit" in section and (unit := section.text("unit")) not in UNITS:
        wanted = f"{' or '.join(UNITS)}, of the coordinates"
        raise ModelError("unit", problem_with_unit(unit, wanted))
    system = replace(system, unit=unit)
    position, velocity = _initial_state(section, system)
    known = read_uncertainty(section, system, parts)
    return Model(
        system,
        position,
        velocity,
        _provenance(section),
        elements=parts,
        element_form=written,
        uncertainty=with_deviations(known, plain, system, parts),
        sensors=read_contact_sensors(section, system.contact_names),
    )


def _robot_model(document: Mapping[str, Value], folder: Path | None) -> Model:
    """A model with the key ``urdf``."""
    plain = without_deviations(document)
    section = Section("", plain.document, ("name", *ROBOT_KEYS, *_COMMON_KEYS[2:]))
    robot = read_robot(section.text("name"), section, folder)
    return Model(
        None,
        *_state_parts(section, robot.n, one_of_each(robot.joints, robot.urdf)),
        _provenance(section),
        uncertainty=read_robot_uncertainty(section, plain, robot),
        robot=robot,
        sensors=read_contact_sensors(section, robot.contact_names),
    )


def _provenance(section: Section) -> dict[str, Value]:
    provenance = section.value("provenance") if "provenance" in section else {}
    if not isinstance(provenance, Mapping):
        raise ModelError("provenance", f"{provenance!r} found; expected keys and values")
    if not isinstance(fits := provenance.get(FITS, True), bool):
        raise ModelError(f"provenance.{FITS}", f"{fits!r} found; expected true or false")
    verdict = _verdict(provenance)
    for key in (each for each in VERDICT[1:] if each in verdict):
        verdict.positive(key, or_zero=key != INTERVAL)
    return {str(key): value for key, value in provenance.items()}


def _verdict(provenance: Mapping[str, Value]) -> Section:
    """The verdict of ``identify`` in a provenance; without ``fits`` no key is one of a verdict."""
    return Section("provenance", provenance if FITS in provenance else {}, [*provenance])


def _system_of_matrices(name: str, section: Section, folder: Path | None) -> System:
    coordinates = section.items("coordinates")
    if not coordinates:
        raise ModelError("coordinates", "is missing or empty; expected a list of names")
    for key, value in coordinates:
        if not isinstance(value, str):
            raise ModelError(key, f"{value!r} is not a name; give a string")
    names = tuple(str(value) for _, value in coordinates)
    n = len(names)
    section.value("contacts")
    motions = read_grounds(section, (), folder)
    keys = ("name", "direction", "gap", *REBOUND_KEYS, "motion")
    contacts = [Section(key, value, keys) for key, value in section.items("contacts")]
    forcing, pushed, inputs = _forcing(section, names, motions, folder)
    system = System(
        name=name,
        coordinates=names,
        M=section.matrix("mass", n, folder),
        C=section.matrix("damping", n, folder),
        K=section.matrix("stiffness", n, folder),
        forcing=forcing,
        contacts=tuple(_contact(contact, n) for contact in contacts),
    )
    factors = [_factors(each, motions) for each in contacts]
    if motions.names:
        moving = np.reshape(factors, (-1, len(motions.names)))
        system = moving_system(system, motions.grounds(*pushed, moving))
    return replace(system, live=live_names(inputs, n))


def _forcing(
    section: Section, coordinates: Sequence[str], motions: GroundMotions, folder: Path | None
) -> tuple[Forcing, tuple[Matrix, Matrix], list[tuple[str, Vector]]]:
    """``f(t)``, forces by grounds, and live forces.

    The forces by unit displacements and by unit speeds of grounds have shape (n, k) each. A live
    force is a name and a direction, shape (n,).
    """
    n, pushed = len(coordinates), np.zeros((2, len(motions.names), len(coordinates)))
    if "forcing" not in section:
        return Forcing.none(n), (pushed[0].T, pushed[1].T), []
    keys = (*FORCING_KEYS, "squares", "grounds", "inputs")
    forcing = Section("forcing", section.value("forcing"), keys)
    for key, value in forcing.items("grounds"):
        ground = Section(key, value, ("name", "stiffness", "damping"))
        which = _known(ground, "name", motions)
        for each, kind in zip(pushed, ("stiffness", "damping"), strict=True):
            each[which] += ground.vector(kind, n, optional=True)
    own = replace(read_forcing(forcing, coordinates, folder), squares=_squares(forcing, n))
    items = [Section(*item, ("name", "direction")) for item in forcing.items("inputs")]
    inputs = [(each.text("name"), each.vector("direction", n)) for each in items]
    return own, (pushed[0].T, pushed[1].T), inputs


def _squares(forcing: Section, n: int) -> SquareWaves | None:
    """The square waves on ``n`` coordinates; None without any."""
    waves = [
        Section(key, value, ("frequency", "phase", "amplitude"))
        for key, value in forcing.items("squares")
    ]
    rows = [
        (each.positive("frequency"), each.number("phase", 0.0), each.vector("amplitude", n))
        for each in waves
    ]
    return SquareWaves.of_rows(rows) if rows else None


def _known(section: Section, key: str, motions: GroundMotions) -> int:
    """The index of the ground that a section names."""
    name = section.text(key)
    if name not in motions.names:
        expected = ", ".join(motions.names) or "none, as the model has no grounds"
        raise ModelError(section.key(key), f"{name!r} is not a ground; expected {expected}")
    return motions.names.index(name)


def _contact(contact: Section, n: int) -> Contact:
    law = read_rebound(contact)
    return Contact(
        contact.text("name"),
        contact.vector("direction", n),
        contact.number("gap"),
        law.nominal,
        law,
    )


def _factors(contact: Section, motions: GroundMotions) -> Vector:
    """Factors of ground displacements in the gap of a contact, shape (k,)."""
    factors = np.zeros(len(motions.names))
    for key, value in contact.items("motion"):
        part = Section(key, value, ("ground", "factor"))
        factors[_known(part, "ground", motions)] += part.number("factor")
    return factors


def _state_parts(
    section: Section, n: int, meaning: str = ""
) -> tuple[Vector | None, Vector | None]:
    """Positions and velocities at the epoch of ``n`` coordinates, shape (n,) each, if any."""
    if "initial_state" not in section:
        return None, None
    state = Section("initial_state", section.value("initial_state"), ("position", "velocity"))
    position = frozen(state.vector("position", n, meaning=meaning))
    velocity = frozen(state.vector("velocity", n, meaning=meaning))
    for name, values in (("position", position), ("velocity", velocity)):
        for i in np.flatnonzero(np.abs(values) > LARGEST_STATE):
            raise ModelError(
                f"initial_state.{name}[{i}]", f"is too large; expected at most {LARGEST_STATE:g}"
            )
    return position, velocity


def _initial_state(section: Section, system: System) -> tuple[Vector | None, Vector | None]:
    """The plant's initial state, which must not be inside a stop."""
    position, velocity = _state_parts(section, system.n)
    if position is None or velocity is None:
        return None, None
    at_epoch = system.to_frame(np.zeros(1, dtype=np.int64), np.append(position, velocity)[None])
    start = at_epoch[0, : system.n]
    for contact in system.penetrated(start):
        name, gap = system.contact_names[contact], system.gap(start)[contact]
        key = "side, or the order of between," if "stops" in section else "the sign of direction"
        raise ModelError(
            "initial_state.position",
            f"is inside the stop {name!r} (gap {gap:g}); expected gap >= 0: check {key} and the"
            " units of gap, limit and the amplitude of a ground",
        )
    return position, velocity
