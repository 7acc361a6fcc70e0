"""A model file: a system, and where the plant starts."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.representer import SafeRepresenter

from impact_observer.errors import ModelError
from impact_observer.model import elements, sampled_files
from impact_observer.model.document import Section, Value
from impact_observer.model.elements import Element
from impact_observer.model.forcing import Forcing
from impact_observer.model.system import LARGEST_STATE, Contact, System
from impact_observer.resources import MOST_BYTES, read_file_or_sample
from impact_observer.states import Matrix, Vector, frozen

_MATRIX_KEYS = ("coordinates", "mass", "damping", "stiffness", "forcing", "contacts")
_NOT_YAML = (YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What ruamel raises: its own errors, and others for values such as ``2020-13-45``."""
_COMMON_KEYS = ("name", "initial_state", "provenance")


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The contents of a model file.

    Attributes:
        system: the system that plant and replica share.
        position: the plant's coordinates at the epoch, shape (n,); None when not given.
        velocity: the plant's velocities at the epoch, shape (n,); None when not given.
        provenance: who wrote the file; without effect on the dynamics.
        source: what errors call the file.
        elements: from which the system was assembled; empty where the file gives matrices.
        element_form: the file's bodies, springs and so on, by key; empty for matrices too.
    """

    system: System
    position: Vector | None = None
    velocity: Vector | None = None
    provenance: Mapping[str, Value] = field(default_factory=dict)
    source: str = ""
    elements: tuple[Element, ...] = ()
    element_form: Mapping[str, Value] = field(default_factory=dict)

    def initial_state(self) -> tuple[Vector, Vector]:
        """The plant's state at the epoch.

        Raises:
            ModelError: the file gives none.
        """
        if self.position is None or self.velocity is None:
            key = f"{self.source}: initial_state" if self.source else "initial_state"
            raise ModelError(key, "is missing; a plant needs one")
        return self.position, self.velocity

    def text(self, provenance: Mapping[str, Value] | None = None) -> str:
        """The model as a file that reads back to equal numbers, in elements or matrices as it was.

        Matrices and samples that were in files of their own are in it.

        ``provenance`` says who makes it, such as package, version and seed.
        """
        form = self.element_form or _matrix_form(self.system)
        document: dict[str, Value] = {"name": self.system.name, **form}
        if "forcing" in form:  # in elements too it may name a file
            document["forcing"] = _forcing_of(self.system)
        if self.position is not None and self.velocity is not None:
            document["initial_state"] = {
                "position": self.position.tolist(),
                "velocity": self.velocity.tolist(),
            }
        if provenance or self.provenance:
            document["provenance"] = dict(provenance or self.provenance)
        stream = io.StringIO()
        yaml = YAML(typ="safe", pure=True)
        yaml.Representer = _Representer
        yaml.default_flow_style = None
        yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
        yaml.width = 99
        yaml.dump(document, stream)
        return stream.getvalue()


class _Representer(SafeRepresenter):
    """Writes text of several lines as a block."""

    def represent_str(self, data: str) -> Value:
        """A block scalar where there is a line end, otherwise the default."""
        style = "|" if "\n" in data else None
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Representer.add_representer(str, _Representer.represent_str)


def _matrix_form(s: System) -> dict[str, Value]:
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
                "restitution": c.restitution,
            }
            for c in s.contacts
        ],
    }


def _forcing_of(system: System) -> Value:
    forcing, samples = system.forcing, system.forcing.sampled
    if samples is not None:
        table = sampled_files.table_of(samples, system.coordinates)
        return {"sampled": table, "hold": samples.hold}
    names = ("frequency", "cosine", "sine")
    harmonics = zip(*(getattr(forcing, name).tolist() for name in names), strict=True)
    return {
        "constant": forcing.constant.tolist(),
        "harmonics": [dict(zip(names, each, strict=True)) for each in harmonics],
    }


class ModelText(NamedTuple):
    """The arguments of ``parse_model``.

    Attributes:
        text: the YAML.
        source: what to call it in errors, such as the file's path.
        folder: where matrix files lie; without it a model may not name any.
    """

    text: str
    source: str
    folder: Path | None = None


def model_text(source: str | Path) -> ModelText:
    """The text of a model file, or of a sample model by its name, such as ``two_mass``.

    Raises:
        UsageError: there is no such file.
    """
    path, text = read_file_or_sample(source, "config", "a model file, or a sample model")
    return ModelText(text, str(path), path.parent)


def read_model(source: str | Path) -> Model:
    """Read a model file, or a sample model by its name, such as ``two_mass``.

    Raises:
        ModelError: one line that names the file, the key and what is wanted.
        UsageError: there is no such file.
    """
    return parse_model(*model_text(source))


def parse_model(text: str, source: str, folder: Path | None = None) -> Model:
    """Read a model from its ``text``; the arguments are those of ``ModelText``.

    Raises:
        ModelError: one line that names ``source``, the key and what is wanted.
    """
    try:
        return replace(_model(load_yaml(text), folder), source=source)
    except ModelError as error:
        key = f"{source}: {error.key}" if error.key else source
        raise ModelError(key, error.problem) from None


def load_yaml(text: str) -> Value:
    """The document in a YAML text.

    Raises:
        ModelError: it is not YAML, or too long; without a key.
    """
    if len(text) > MOST_BYTES:
        raise ModelError("", f"{len(text)} characters found; expected at most {MOST_BYTES}")
    try:
        return YAML(typ="safe", pure=True).load(text)
    except _NOT_YAML as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = str(getattr(error, "problem", None) or error).splitlines()[0]
        raise ModelError("", f"is not YAML{where}: {problem}") from None


def edited(text: str, changes: Mapping[tuple[str | int, ...], Value]) -> str:
    """A model file with ``changes`` of values, and all else kept, comments too.

    Values are found by their path in the file, such as ``("stops", 0, "limit")``.
    """
    yaml = YAML()
    yaml.width = 1_000_000  # or ruamel breaks lines
    yaml.preserve_quotes = True
    if re.search(r"^ +- ", text, re.MULTILINE):
        yaml.indent(sequence=4, offset=2)
    document = yaml.load(text)
    for (*path, last), value in changes.items():
        place = document
        for part in path:
            place = place[part]
        place[last] = value
    stream = io.StringIO()
    yaml.dump(document, stream)
    return stream.getvalue()


def _model(document: Value, folder: Path | None) -> Model:
    if not isinstance(document, Mapping):
        raise ModelError("", "is not a model: expected a YAML mapping with name, mass, ...")
    form = elements.KEYS if "bodies" in document else _MATRIX_KEYS
    other = [k for k in (*elements.KEYS, *_MATRIX_KEYS) if k in document and k not in form]
    if other and any(k in document for k in form):
        raise ModelError(
            other[0], f"does not go with {form[0]}; write matrices or elements, not both"
        )
    section = Section("", document, (*_COMMON_KEYS, *form))
    name = section.text("name")
    parts: tuple[Element, ...] = ()
    written: dict[str, Value] = {}
    if form is elements.KEYS:
        system, parts = elements.assembled_system(name, section, folder)
        written = {key: document[key] for key in form if key in document}
    else:
        system = _system_of_matrices(name, section, folder)
    position, velocity = _initial_state(section, system)
    provenance = section.value("provenance") if "provenance" in section else {}
    if not isinstance(provenance, Mapping):
        raise ModelError("provenance", f"{provenance!r} found; expected keys and values")
    provenance = {str(key): value for key, value in provenance.items()}
    return Model(system, position, velocity, provenance, elements=parts, element_form=written)


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
    return System(
        name=name,
        coordinates=names,
        M=section.matrix("mass", n, folder),
        C=section.matrix("damping", n, folder),
        K=section.matrix("stiffness", n, folder),
        forcing=_forcing(section, names, folder),
        contacts=tuple(_contact(key, value, n) for key, value in section.items("contacts")),
    )


def _forcing(section: Section, coordinates: Sequence[str], folder: Path | None) -> Forcing:
    n = len(coordinates)
    if "forcing" not in section:
        return Forcing.none(n)
    keys = ("constant", "harmonics", *sampled_files.KEYS)
    forcing = Section("forcing", section.value("forcing"), keys)
    sampled = sampled_files.sampled_forcing(forcing, coordinates, folder)
    if sampled is not None:
        return sampled
    harmonics = [
        Section(key, value, ("frequency", "cosine", "sine"))
        for key, value in forcing.items("harmonics")
    ]

    def part(name: str) -> Matrix:
        rows = [harmonic.vector(name, n, optional=True) for harmonic in harmonics]
        return np.reshape(rows, (len(harmonics), n))

    return Forcing(
        constant=forcing.vector("constant", n, optional=True),
        frequency=np.array([harmonic.number("frequency") for harmonic in harmonics]),
        cosine=part("cosine"),
        sine=part("sine"),
    )


def _contact(key: str, value: Value, n: int) -> Contact:
    contact = Section(key, value, ("name", "direction", "gap", "restitution"))
    return Contact(
        contact.text("name"),
        contact.vector("direction", n),
        contact.number("gap"),
        contact.number("restitution"),
    )


def _initial_state(section: Section, system: System) -> tuple[Vector | None, Vector | None]:
    """The plant's initial state, which must not be inside a stop."""
    if "initial_state" not in section:
        return None, None
    state = Section("initial_state", section.value("initial_state"), ("position", "velocity"))
    position = frozen(state.vector("position", system.n))
    velocity = frozen(state.vector("velocity", system.n))
    for name, values in (("position", position), ("velocity", velocity)):
        for i in np.flatnonzero(np.abs(values) > LARGEST_STATE):
            raise ModelError(
                f"initial_state.{name}[{i}]", f"is too large; expected at most {LARGEST_STATE:g}"
            )
    for contact in system.penetrated(position):
        name, gap = system.contact_names[contact], system.gap(position)[contact]
        problem = f"is inside the stop {name!r} (gap {gap:g}); expected gap >= 0"
        raise ModelError("initial_state.position", problem)
    return position, velocity
