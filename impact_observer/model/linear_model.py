# SPDX-License-Identifier: Apache-2.0
"""A linear model in its file: elements or matrices to a ``System``, and a ``System`` to matrices.

Bodies and moving grounds are the axes of one space, in which each spring and each stop is a row.
Where a number of a parameter is read, its place in the file is noted.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import msgspec
import numpy as np
import scipy

from impact_observer.errors import ModelError
from impact_observer.model.document import Value, check_names, finite, vector
from impact_observer.model.files_beside import (
    TIME,
    load_matrix,
    read_table,
    table_in,
    table_text,
)
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import Grounds, LiveNames
from impact_observer.model.parameters_in_file import ParameterPlace, Place, key_of
from impact_observer.model.rebounds import read_rebound
from impact_observer.model.schema import (
    ElementModel,
    Force,
    Ground,
    MatrixContact,
    MatrixModel,
    Rate,
    SampledForces,
    SmoothForcing,
    StopKeys,
    TableKeys,
    Wave,
)
from impact_observer.model.square_waves import SquareWaves
from impact_observer.model.system import (
    UNITS,
    UNKNOWN_UNIT,
    Contact,
    Element,
    System,
    moving_system,
)
from impact_observer.states import Matrix, Vector, frozen

GROUND = "ground"
"""The name of what is at rest, in springs and stops."""
T = TypeVar("T")
_DISPLACEMENT = "displacement"
"""The column of a ground's table."""
_Axes: TypeAlias = Mapping[str, Vector]
"""Rows by the names of bodies or grounds."""
_ByKind: TypeAlias = Mapping[str, Matrix]
"""Matrices of masses, springs and dampers by ``mass``, ``stiffness`` and ``damping``."""
_Waves: TypeAlias = list[tuple[float, Vector, Vector]]
"""Frequency, cosine and sine, shape (n,) each, of harmonics."""
_Rows: TypeAlias = list[tuple[float, float, Vector]]
"""Frequency, phase and force, shape (n,), of square waves."""


class LinearFile:
    """A linear model as its file has it, in either form.

    Attributes:
        system: the system.
        elements: masses, springs and dampers; empty for matrices.
        places: of the parameters that are single numbers in the file.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """

    system: System

    def __init__(self, model: ElementModel | MatrixModel, folder: Path | None) -> None:
        """Read a ``model``; ``folder`` is where its other files lie."""
        self.elements, self.places = list[Element](), list[ParameterPlace]()
        self._model, self._folder = model, folder
        self._contacts, self._moved = list[Contact](), list[Vector]()
        self._inputs = dict[str, Vector]()
        if isinstance(model, MatrixModel):
            self._read_matrices(model)
            return
        try:
            self._read_elements(model)
        except ModelError as error:
            raise ModelError(error.key.replace("contacts[", "stops["), error.problem) from None

    def _read_matrices(self, model: MatrixModel) -> None:
        names, n, given = model.coordinates, len(model.coordinates), model.forcing
        matrices = {
            key: load_matrix(key, value, self._folder, (n, n))
            if isinstance(value := getattr(model, key), str)
            else finite(key, value, (n, n), f"{n} rows of {n} numbers")
            for key in ("mass", "damping", "stiffness")
        }
        if given.constant is not None:
            for i, name in enumerate(names):
                self._note(f"constant-force.{name}", ("forcing", "constant", i))
        for k, wave in enumerate(given.harmonics):
            self._note_frequency(f"forcing-frequency.{k + 1}", ("forcing", "harmonics", k), wave)
        squares = [
            (each.omega, each.phase, vector(f"{key}.amplitude", each.amplitude, n))
            for key, each in _keyed("forcing.squares", given.squares)
        ]
        forcing = replace(
            smooth_forcing(given, names, self._folder),
            squares=SquareWaves.of_rows(squares) if squares else None,
        )
        axes = _axes([ground.name for ground in model.grounds])
        by_ground = {kind: np.zeros((n, len(axes))) for kind in ("stiffness", "damping")}
        for key, each in _keyed("forcing.grounds", given.grounds):
            axis = _row(axes, f"{key}.name", each.name)
            for kind in by_ground:
                of_kind = vector(f"{key}.{kind}", getattr(each, kind), n)
                by_ground[kind] += np.outer(of_kind, axis)
        for i, (key, contact) in enumerate(_keyed("contacts", model.contacts)):
            moved = np.zeros(len(axes))
            for part_key, part in _keyed(f"{key}.motion", contact.motion):
                moved += part.factor * _row(axes, f"{part_key}.ground", part.ground)
            direction = vector(f"{key}.direction", contact.direction, n)
            self._add_contact(("contacts", i), contact, direction, contact.gap, moved)
            self._note(f"gap.{contact.name}", ("contacts", i, "gap"))
        for key, live in _keyed("forcing.inputs", given.inputs):
            self._add_input(live.name, vector(f"{key}.direction", live.direction, n))
        self._assemble(names, matrices, forcing, by_ground)

    def _read_elements(self, model: ElementModel) -> None:
        names, moving = ([each.name for each in given] for given in (model.bodies, model.grounds))
        check_names("bodies", names, member=".name", taken=(GROUND,))
        check_names("grounds", moving, member=".name", taken=(*names, GROUND))
        n, bodies = len(names), _axes([*names, *moving])
        grounds = {GROUND: np.zeros(len(bodies)), **{name: bodies.pop(name) for name in moving}}
        axes = {**bodies, **grounds}
        by_ground = {kind: np.zeros((n, len(moving))) for kind in ("stiffness", "damping")}
        for i, (body, row) in enumerate(zip(model.bodies, np.eye(n), strict=True)):
            self._add_element("mass", body.name, body.mass, row, ("bodies", i))
        labels = _labels(spring.between for spring in model.springs)
        for i, (label, spring) in enumerate(zip(labels, model.springs, strict=True)):
            row = _across(axes, f"springs[{i}].between", spring.between)
            for kind in by_ground:
                if (value := getattr(spring, kind)) is not None:
                    self._add_element(kind, label, value, row[:n], ("springs", i))
                    by_ground[kind] -= value * np.outer(row[:n], row[n:])
        for i, (key, stop) in enumerate(_keyed("stops", model.stops)):
            if stop.between is not None:
                row, number, slope = _across(axes, f"{key}.between", stop.between), "gap", 1.0
            else:
                own = _row(bodies, f"{key}.body", str(stop.body))
                ground = _row(grounds, f"{key}.ground", stop.ground or GROUND)
                number, slope = "limit", 1.0 if stop.side == "above" else -1.0
                row = slope * (ground - own)
            gap = slope * getattr(stop, number)
            self._add_contact(("stops", i), stop, row[:n], gap, row[n:])
            self._note(f"gap.{stop.name}", ("stops", i, number), slope)
        total = {kind: np.zeros((n, n)) for kind in ("mass", "damping", "stiffness")}
        for each in self.elements:
            total[each.kind] += each.value * each.matrix
        self.elements = [each for each in self.elements if each.value]
        forcing = self._sum_of_forces(model, {name: axis[:n] for name, axis in bodies.items()})
        self._assemble(names, total, forcing, by_ground)

    def _sum_of_forces(self, model: ElementModel, bodies: _Axes) -> Forcing:
        """The sum of all forces on the bodies, live ones apart."""
        constant, waves, squares = np.zeros(len(bodies)), _Waves(), _Rows()
        constants = list[tuple[Place, str, float]]()
        for i, (key, force) in enumerate(_keyed("forces", model.forces)):
            path: Place = ("forces", i)
            e, phase = _row(bodies, f"{key}.body", force.body), force.phase or 0.0
            if force.input is not None:
                self._add_input(force.input, e)
            elif force.constant is not None:
                constant += force.constant * e
                constants.append(((*path, "constant"), force.body, force.constant))
            else:
                size, omega = force.amplitude or 0.0, force.omega
                if force.shape is not None:
                    squares.append((omega, phase, size * e))
                    continue
                waves.append(_wave(omega, size, phase, e))
                self._note_wave(f"forcing.{len(waves)}", path, force)
        total = dict(zip(bodies, constant.tolist(), strict=True))
        for path, name, value in constants:  # the others on the same body stay
            self._note(f"constant-force.{name}", path, 1.0, value - total[name])
        sampled = _read_samples(model.forcing, [*bodies], self._folder)
        return replace(
            _forcing(constant, waves, sampled),
            squares=SquareWaves.of_rows(squares) if squares else None,
        )

    def _note(self, name: str, path: Place, slope: float = 1.0, offset: float = 0.0) -> None:
        """Note where the number of a parameter stands."""
        self.places.append(ParameterPlace(name, path, slope, offset))

    def _note_frequency(self, name: str, path: Place, wave: Rate) -> None:
        """Note a frequency in rad/s, which may stand there in Hz."""
        is_hertz = wave.hertz is not None
        key, slope = ("hertz", 1.0 / math.tau) if is_hertz else ("frequency", 1.0)
        self._note(name, (*path, key), slope)

    def _note_wave(self, name: str, path: Place, wave: Force | Wave) -> None:
        """Note the three numbers of a ``wave`` with a ``name`` such as ``forcing.1``."""
        kind, _, label = name.partition(".")
        self._note(f"{kind}-amplitude.{label}", (*path, "amplitude"), wave.amplitude or 0.0)
        self._note(f"{kind}-phase.{label}", (*path, "phase"), 1.0, wave.phase or 0.0)
        self._note_frequency(f"{kind}-frequency.{label}", path, wave)

    def _add_element(self, kind: str, label: str, value: float, row: Vector, path: Place) -> None:
        self.elements.append(Element(kind, label, value, row))
        self._note(f"{kind}.{label}", (*path, kind), 1.0 if value else 0.0)  # 0 is no parameter

    def _add_input(self, name: str, direction: Vector) -> None:
        self._inputs[name] = self._inputs.get(name, 0.0) + direction

    def _add_contact(
        self,
        path: Place,
        contact: StopKeys | MatrixContact,
        direction: Vector,
        gap: float,
        moved: Vector,
    ) -> None:
        """Add a contact, which the displacements of grounds move by the factors ``moved``."""
        law = read_rebound(f"{key_of(path)}.restitution", contact.restitution)
        self._contacts.append(Contact(contact.name, direction, gap, law.nominal, law))
        self._moved.append(moved)
        for each in law.parameters:
            self._note(f"{each.kind}.{contact.name}", (*path, *each.place))

    def _assemble(
        self, names: Sequence[str], matrices: _ByKind, forcing: Forcing, by_ground: _ByKind
    ) -> None:
        """Make the system of all parts.

        Args:
            names: of the coordinates.
            matrices: of masses, dampers and springs, shape (n, n).
            forcing: without the effects of grounds and live forces.
            by_ground: dampers and springs on grounds, shape (n, k).
        """
        inputs, model = self._inputs, self._model
        usual = UNITS[0] if isinstance(model, ElementModel) else UNKNOWN_UNIT
        self.system = System(
            name=model.name,
            coordinates=tuple(names),
            M=matrices["mass"],
            C=matrices["damping"],
            K=matrices["stiffness"],
            forcing=forcing,
            contacts=tuple(self._contacts),
            live=LiveNames(tuple(inputs), np.column_stack([*inputs.values()])) if inputs else None,
            unit=model.unit or usual,
        )
        if model.grounds:
            self.system = moving_system(self.system, self._grounds(model.grounds, by_ground))

    def _grounds(self, given: Sequence[Ground], by_ground: _ByKind) -> Grounds:
        """The moving grounds, and what they do to bodies and contacts."""
        names = tuple(each.name for each in given)
        check_names("grounds", names, member=".name")
        waves, owner, written = _Waves(), list[int](), list[dict[str, Any]]()
        sampled: Samples | None = None
        for k, (key, ground) in enumerate(_keyed("grounds", given)):
            axis, table = np.eye(len(names))[k], ground.motion.sampled
            written.append(msgspec.to_builtins(ground))
            for i, wave in enumerate(ground.motion.harmonics or ()):
                waves.append(_wave(wave.omega, wave.amplitude, wave.phase, axis))
                owner.append(k)
                path = ("grounds", k, "motion", "harmonics", i)
                self._note_wave(f"ground.{ground.name}.{i + 1}", path, wave)
            if table is not None:
                rows = read_table(f"{key}.motion.sampled", table, (_DISPLACEMENT,), self._folder)
                spline = _clamped(f"{key}.motion.sampled", rows, axis)
                sampled = spline if sampled is None else sampled.plus(spline)
                written[k]["motion"]["sampled"] = table_text(rows, (_DISPLACEMENT,))
        return Grounds(
            names=names,
            motion=_forcing(np.zeros(len(names)), waves, sampled),
            owner=tuple(owner),
            stiffness=by_ground["stiffness"],
            damping=by_ground["damping"],
            factors=frozen(np.reshape(self._moved, (len(self._contacts), len(names)))),
            written=tuple(written),
        )


def _keyed(key: str, members: Sequence[T]) -> Iterator[tuple[str, T]]:
    """Each of the ``members`` of a list in a model file, with its key."""
    return ((f"{key}[{i}]", each) for i, each in enumerate(members))


def _axes(names: Sequence[str]) -> dict[str, Vector]:
    """The axis of each name, shape (names,)."""
    return dict(zip(names, np.eye(len(names)), strict=True))


def _row(axes: _Axes, key: str, name: str) -> Vector:
    """The row of a ``name`` at a ``key`` of the file."""
    if name not in axes:
        raise ModelError(key, f"{name!r} found; expected one of {', '.join(axes) or 'none'}")
    return axes[name]


def _across(axes: _Axes, key: str, ends: tuple[str, str]) -> Vector:
    """``q_b - q_a`` of two ends [a, b] as a row, shape (n + k,)."""
    if ends[0] == ends[1]:
        raise ModelError(key, f"{list(ends)} found; expected two different bodies [a, b]")
    return _row(axes, f"{key}[1]", ends[1]) - _row(axes, f"{key}[0]", ends[0])


def _labels(pairs: Iterable[Sequence[str]]) -> Iterator[str]:
    """Names of springs by their two ends; a second spring between the same ends ends in ``#2``."""
    counts = Counter[str]()
    for label in map("-".join, pairs):
        counts[label] += 1
        yield label if counts[label] == 1 else f"{label}#{counts[label]}"


def smooth_forcing(
    given: SmoothForcing, coordinates: Sequence[str], folder: Path | None
) -> Forcing:
    """Constants, harmonics and samples of the forcing of ``coordinates``.

    CSV files lie in ``folder``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    n = len(coordinates)
    waves = [
        (
            each.omega,
            vector(f"{key}.cosine", each.cosine, n),
            vector(f"{key}.sine", each.sine, n),
        )
        for key, each in _keyed("forcing.harmonics", given.harmonics)
    ]
    constant = vector("forcing.constant", given.constant, n)
    return _forcing(constant, waves, _read_samples(given, coordinates, folder))


def _wave(omega: float, amplitude: float, phase: float, e: Vector) -> tuple[float, Vector, Vector]:
    """The wave ``amplitude cos(omega t + phase)`` along ``e``, shape (n,)."""
    return omega, amplitude * np.cos(phase) * e, -amplitude * np.sin(phase) * e


def _forcing(constant: Vector, waves: _Waves, sampled: Samples | None) -> Forcing:
    shape = len(waves), constant.size
    return Forcing(
        constant=constant,
        frequency=np.array([omega for omega, _, _ in waves]),
        cosine=np.reshape([cosine for _, cosine, _ in waves], shape),
        sine=np.reshape([sine for _, _, sine in waves], shape),
        sampled=sampled,
    )


def _read_samples(
    forcing: SampledForces, coordinates: Sequence[str], folder: Path | None
) -> Samples | None:
    """The samples of the key ``forcing``, in the order of ``coordinates``; None without any."""
    given, hold, key = forcing.sampled, forcing.hold, "forcing.sampled"
    if given is None:
        return None
    assert hold is not None, "checked by the schema"
    if isinstance(given, TableKeys):
        shape = rows, columns = len(given.time), len(coordinates)
        wanted = f"{rows} rows, one an instant, of {columns} numbers"
        force = finite(f"{key}.force", given.force, shape, wanted)
        return Samples(np.array(given.time), force, hold)
    table = read_table(key, given, coordinates, folder)
    try:
        return Samples(table[:, 0], table[:, 1:], hold)
    except ModelError as error:
        raise ModelError(key, f"{table_in(given)}: {error.problem}") from None


def _clamped(key: str, table: Matrix, axis: Vector) -> Samples:
    """The C2 cubic spline through a ``table`` of instants and displacements, at rest at its ends.

    The displacements are along the ``axis``, shape (k,).

    Raises:
        ModelError: fewer than two instants, or instants that do not ascend.
    """
    try:
        time = Samples(table[:, 0], table[:, 1:], "linear").time
    except ModelError as error:
        raise ModelError(key, error.problem) from None
    parts = scipy.interpolate.CubicSpline(time, table[:, 1:], bc_type="clamped").c[::-1]
    jets = np.zeros((JETS, *table[:, 1:].shape))
    jets[:, :-1] = parts * np.array([1.0, 1.0, 2.0, 6.0])[:, None, None]
    jets[0] = table[:, 1:]
    return Samples.of_jets(time, jets * axis)


def matrix_form(system: System) -> dict[str, Value]:
    """The keys of a model file from which a ``LinearFile`` makes ``system``."""
    grounds = None if system.frame is None else system.frame.grounds
    contacts = _rows(system.contact_names, direction=system.W.T, gap=system.q_r)
    for i, contact in enumerate(contacts):
        contact["restitution"] = system.rebounds[i].written
        if grounds is not None:
            moving = zip(grounds.names, grounds.factors[i].tolist(), strict=True)
            contact["motion"] = [{"ground": g, "factor": f} for g, f in moving if f]
    form: dict[str, Value] = {
        "coordinates": list(system.coordinates),
        "mass": system.M.tolist(),
        "damping": system.C.tolist(),
        "stiffness": system.K.tolist(),
        "forcing": _forcing_form(system),
        "contacts": contacts,
    }
    if system.unit != UNKNOWN_UNIT:
        form["unit"] = system.unit
    return form if grounds is None else {**form, "grounds": list(grounds.written)}


def _forcing_form(system: System) -> dict[str, Value]:
    own, squares, live = system.own_forcing, system.own_forcing.squares, system.live
    form: dict[str, Value] = {
        "constant": own.constant.tolist(),
        "harmonics": _rows(frequency=own.frequency, cosine=own.cosine, sine=own.sine),
        **written_samples(own.sampled, system.coordinates),
    }
    if squares is not None:
        frequency, phase, amplitude = squares.frequency, squares.phase, squares.force
        form["squares"] = _rows(frequency=frequency, phase=phase, amplitude=amplitude)
    if system.frame is not None:
        grounds = system.frame.grounds
        stiffness, damping = grounds.stiffness.T, grounds.damping.T
        form["grounds"] = _rows(grounds.names, stiffness=stiffness, damping=damping)
    if live is not None:
        form["inputs"] = _rows(live.inputs, direction=live.directions.T)
    return form


def _rows(names: Sequence[str] = (), **columns: Matrix) -> list[dict[str, Value]]:
    """Mappings by the rows of ``columns``, after their names, if any."""
    rows = zip(*(each.tolist() for each in columns.values()), strict=True)
    members = [dict(zip(columns, row, strict=True)) for row in rows]
    return [{"name": n, **m} for n, m in zip(names, members, strict=True)] if names else members


def written_samples(samples: Samples | None, coordinates: Sequence[str]) -> dict[str, Value]:
    """The keys by which a model file has ``samples``: CSV text, or lists for odd names."""
    if samples is None:
        return {}
    plain = all(name.isprintable() and name == name.strip() for name in coordinates)
    table: Value = {"time": samples.time.tolist(), "force": samples.force.tolist()}
    if plain and TIME not in coordinates:
        table = table_text(np.column_stack([samples.time, samples.force]), coordinates)
    return {"sampled": table, "hold": samples.hold}
