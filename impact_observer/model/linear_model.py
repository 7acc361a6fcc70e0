# SPDX-License-Identifier: Apache-2.0
"""A linear model in its file: elements to matrices, matrices to a ``System``, and back.

Bodies and moving grounds are the axes of one space, in which each spring and each stop is a row.
``matrices_of`` assembles the elements to the keys of the matrix form, so that ``system_of`` is
the only place where a system is made.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import scipy
from msgspec import UnsetType

from impact_observer.errors import ModelError
from impact_observer.model.document import Value, check_names, matrix, vector
from impact_observer.model.files_beside import (
    TIME,
    load_matrix,
    read_table,
    table_in,
    table_text,
)
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import Grounds, LiveNames, motion_of
from impact_observer.model.rebounds import read_rebound
from impact_observer.model.schema import (
    ElementModel,
    Force,
    ForcingKeys,
    GroundFactor,
    GroundForces,
    Harmonic,
    LiveForce,
    MatrixContact,
    MatrixModel,
    Row,
    SampledForces,
    SmoothForcing,
    Square,
    StopKeys,
    TableKeys,
)
from impact_observer.model.square_waves import SquareWaves
from impact_observer.model.system import (
    UNKNOWN_UNIT,
    Contact,
    Element,
    System,
    moving_system,
)
from impact_observer.states import Matrix, Vector

GROUND = "ground"
"""The name of what is at rest, in springs and stops."""
_DISPLACEMENT = "displacement"
"""The column of a ground's table."""


def system_of(model: MatrixModel, folder: Path | None) -> System:
    """The system in a model file of matrices; ``folder`` is where its other files lie.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    names, n, given = tuple(model.coordinates), len(model.coordinates), model.forcing

    def read(key: str) -> Matrix:
        value: Sequence[Sequence[float]] | str = getattr(model, key)
        return (
            load_matrix(key, value, folder)
            if isinstance(value, str)
            else matrix(key, value, (n, n))
        )

    M, C, K = (read(key) for key in ("mass", "damping", "stiffness"))
    squares = [
        (each.omega(key), each.phase, vector(f"{key}.amplitude", each.amplitude, n))
        for key, each in _keyed("forcing.squares", given.squares)
    ]
    forcing = replace(
        smooth_forcing(given, names, folder),
        squares=SquareWaves.of_rows(squares) if squares else None,
    )
    contacts = tuple(_contact(key, each, n) for key, each in _keyed("contacts", model.contacts))
    system = System(model.name, names, M, C, K, forcing, contacts)
    if model.grounds:
        system = moving_system(system, _grounds(model, n, folder))
    elif given.grounds or any(each.motion for each in model.contacts):
        raise ModelError("grounds", "is missing or empty; expected the grounds that are named")
    inputs = {each.name: np.zeros(n) for each in given.inputs}
    for key, force in _keyed("forcing.inputs", given.inputs):
        inputs[force.name] += vector(f"{key}.direction", force.direction, n)
    live = LiveNames(tuple(inputs), np.column_stack([*inputs.values()])) if inputs else None
    return replace(system, live=live)


def _keyed(key: str, members: Sequence[Any]) -> Iterator[tuple[str, Any]]:
    """Each of the ``members`` of a list in a model file, with its key."""
    return ((f"{key}[{i}]", each) for i, each in enumerate(members))


def _contact(key: str, contact: MatrixContact, n: int) -> Contact:
    law = read_rebound(f"{key}.restitution", contact.restitution)
    direction = vector(f"{key}.direction", contact.direction, n)
    return Contact(contact.name, direction, contact.gap, law.nominal, law)


def smooth_forcing(
    given: SmoothForcing, coordinates: Sequence[str], folder: Path | None, meaning: str = ""
) -> Forcing:
    """Constants, harmonics and samples of the forcing of ``coordinates``.

    CSV files lie in ``folder``; ``meaning`` is that of ``vector``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    n, waves = len(coordinates), [*_keyed("forcing.harmonics", given.harmonics)]
    cosine = [vector(f"{key}.cosine", each.cosine, n, meaning) for key, each in waves]
    sine = [vector(f"{key}.sine", each.sine, n, meaning) for key, each in waves]
    return Forcing(
        constant=vector("forcing.constant", given.constant, n, meaning),
        frequency=np.array([each.omega(key) for key, each in waves]),
        cosine=np.reshape(cosine, (len(waves), n)),
        sine=np.reshape(sine, (len(waves), n)),
        sampled=_read_samples(given, coordinates, folder),
    )


def _read_samples(
    forcing: SampledForces, coordinates: Sequence[str], folder: Path | None
) -> Samples | None:
    """The samples of the key ``forcing``, in the order of ``coordinates``; None without any."""
    given, hold, key = forcing.sampled, forcing.hold, "forcing.sampled"
    if isinstance(given, UnsetType):
        if not isinstance(hold, UnsetType):
            raise ModelError("forcing.hold", "stands without sampled")
        return None
    if isinstance(hold, UnsetType):
        raise ModelError("forcing.hold", "is missing; expected previous or linear")
    if isinstance(given, TableKeys):
        shape = len(given.time), len(coordinates)
        return Samples(np.array(given.time), matrix(f"{key}.force", given.force, shape), hold)
    table = read_table(key, given, coordinates, folder)
    try:
        return Samples(table[:, 0], table[:, 1:], hold)
    except ModelError as error:
        raise ModelError(key, f"{table_in(given)}: {error.problem}") from None


def _grounds(model: MatrixModel, n: int, folder: Path | None) -> Grounds:
    """The moving grounds of a model of ``n`` coordinates, and what they do to it."""
    names = tuple(each.name for each in model.grounds)
    check_names("grounds", names, member=".name")

    def index(key: str, name: str) -> int:
        if name not in names:
            raise ModelError(key, f"{name!r} is not a ground; expected {', '.join(names)}")
        return names.index(name)

    harmonics: list[tuple[int, float, float, float]] = []
    written: list[dict[str, Any]] = []
    motion = Forcing.none(len(names))
    for k, (key, ground) in enumerate(_keyed("grounds", model.grounds)):
        waves, table = ground.motion.harmonics, ground.motion.sampled
        written.append(msgspec.to_builtins(ground))
        if isinstance(waves, UnsetType) == isinstance(table, UnsetType):
            raise ModelError(f"{key}.motion", "expected one of harmonics, sampled")
        if isinstance(table, UnsetType):
            for place, wave in _keyed(f"{key}.motion.harmonics", waves):
                harmonics.append((k, wave.amplitude, wave.omega(place), wave.phase))
        else:
            rows = read_table(f"{key}.motion.sampled", table, (_DISPLACEMENT,), folder)
            spline = _clamped(f"{key}.motion.sampled", rows)
            motion = motion.added(Forcing.of_samples(spline.mapped(np.eye(len(names))[:, [k]])))
            written[k]["motion"]["sampled"] = table_text(rows, (_DISPLACEMENT,))
    stiffness, damping = np.zeros((2, n, len(names)))
    for key, force in _keyed("forcing.grounds", model.forcing.grounds):
        k = index(f"{key}.name", force.name)
        stiffness[:, k] += vector(f"{key}.stiffness", force.stiffness, n)
        damping[:, k] += vector(f"{key}.damping", force.damping, n)
    factors = np.zeros((len(model.contacts), len(names)))
    for i, contact in enumerate(model.contacts):
        for key, part in _keyed(f"contacts[{i}].motion", contact.motion):
            factors[i, index(f"{key}.ground", part.ground)] += part.factor
    return Grounds(
        names=names,
        motion=motion_of(len(names), harmonics).added(motion),
        owner=tuple(each[0] for each in harmonics),
        stiffness=stiffness,
        damping=damping,
        factors=factors,
        written=tuple(written),
    )


def _clamped(key: str, table: Matrix) -> Samples:
    """The C2 cubic spline through a ``table`` of instants and displacements, at rest at its ends.

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
    return Samples.of_jets(time, jets)


class _Line:
    """The axes of n named bodies and k moving grounds; ``ground`` is at rest and has none."""

    def __init__(self, model: ElementModel) -> None:
        """Name the bodies and the grounds of a ``model``."""
        self.bodies = [body.name for body in model.bodies]
        self.moving = [ground.name for ground in model.grounds]
        check_names("bodies", self.bodies, member=".name", taken=(GROUND,))
        check_names("grounds", self.moving, member=".name", taken=(*self.bodies, GROUND))
        self.n, names = len(self.bodies), (*self.bodies, *self.moving)
        self._axes = dict(zip(names, np.eye(len(names)), strict=True))
        self._axes[GROUND] = np.zeros(len(names))

    def axis(self, key: str, name: str) -> Vector:
        """The axis of a body or a ground, shape (n + k,)."""
        if name not in self._axes:
            wanted = ", ".join((*self.bodies, GROUND, *self.moving))
            raise ModelError(key, f"{name!r} is not a body; expected one of {wanted}")
        return self._axes[name]

    def body(self, key: str, name: str) -> Vector:
        """The axis of a body, shape (n + k,)."""
        axis = self.axis(key, name)
        if name not in self.bodies:
            raise ModelError(key, "is the ground, which does not move; expected a body")
        return axis

    def ground(self, key: str, name: str) -> Vector:
        """The axis of a ground, shape (n + k,)."""
        wanted = [GROUND, *self.moving]
        if name not in wanted:
            raise ModelError(key, f"{name!r} is not a ground; expected one of {', '.join(wanted)}")
        return self._axes[name]

    def across(self, key: str, ends: Sequence[str]) -> Vector:
        """``q_b - q_a`` of two ends [a, b] as a row, shape (n + k,)."""
        if ends[0] == ends[1]:
            raise ModelError(key, f"{list(ends)} found; expected two different bodies [a, b]")
        return self.axis(f"{key}[1]", ends[1]) - self.axis(f"{key}[0]", ends[0])


def matrices_of(model: ElementModel) -> tuple[MatrixModel, tuple[Element, ...]]:
    """The matrix form of a model of elements, and its masses, springs and dampers.

    Raises:
        ModelError: naming the element's key.
    """
    line = _Line(model)
    n, k = line.n, len(line.moving)
    elements = [
        Element("mass", body.name, body.mass, axis)
        for body, axis in zip(model.bodies, np.eye(n), strict=True)
    ]
    by_ground = {"stiffness": np.zeros((n, k)), "damping": np.zeros((n, k))}
    springs_by_label = zip(
        labels(spring.between for spring in model.springs),
        _keyed("springs", model.springs),
        strict=True,
    )
    for label, (key, spring) in springs_by_label:
        row = line.across(f"{key}.between", spring.between)
        for kind in by_ground:
            if not isinstance(value := getattr(spring, kind), UnsetType):
                elements.append(Element(kind, label, value, row[:n]))
                by_ground[kind] -= value * np.outer(row[:n], row[n:])
    total = {kind: np.zeros((n, n)) for kind in ("mass", "stiffness", "damping")}
    for each in elements:
        total[each.kind] += each.value * each.matrix
    sampled = SampledForces() if isinstance(model.forcing, UnsetType) else model.forcing
    if sampled is model.forcing and isinstance(sampled.sampled, UnsetType):
        raise ModelError("forcing.sampled", "is missing")
    grounds = tuple(
        GroundForces(name, *(part[:, i].tolist() for part in by_ground.values()))
        for i, name in enumerate(line.moving)
    )
    matrices = MatrixModel(
        name=model.name,
        grounds=model.grounds,
        coordinates=tuple(line.bodies),
        mass=_as_rows(total["mass"]),
        damping=_as_rows(total["damping"]),
        stiffness=_as_rows(total["stiffness"]),
        contacts=tuple(_stop(line, key, stop) for key, stop in _keyed("stops", model.stops)),
        forcing=_summed(line, model.forces, sampled, grounds),
    )
    return matrices, tuple(each for each in elements if each.value)


def _as_rows(values: Matrix) -> tuple[Row, ...]:
    return tuple(map(tuple, values.tolist()))


def labels(pairs: Iterable[Sequence[str]]) -> Iterator[str]:
    """Names of springs by their two ends; a second spring between the same ends ends in ``#2``."""
    counts = dict[str, int]()
    for pair in pairs:
        label = "-".join(pair)
        counts[label] = counts.get(label, 0) + 1
        yield label if counts[label] == 1 else f"{label}#{counts[label]}"


def _summed(
    line: _Line,
    forces: Sequence[Force],
    sampled: SampledForces,
    grounds: tuple[GroundForces, ...],
) -> ForcingKeys:
    """The sum of all forces on the bodies."""
    constant = np.zeros(line.n)
    harmonics, squares, inputs = list[Harmonic](), list[Square](), list[LiveForce]()
    for key, force in _keyed("forces", forces):
        e = line.body(f"{key}.body", force.body)[: line.n]
        phase = 0.0 if isinstance(force.phase, UnsetType) else force.phase
        if not isinstance(force.input, UnsetType):
            _check_alone(key, force, "input")
            inputs.append(LiveForce(force.input, e.tolist()))
        elif not isinstance(force.constant, UnsetType):
            _check_alone(key, force, "constant")
            constant += force.constant * e
        elif isinstance(force.amplitude, UnsetType):
            raise ModelError(f"{key}.amplitude", "is missing; expected it, constant or input")
        elif force.shape == "square":
            amplitude = (force.amplitude * e).tolist()
            squares.append(Square(frequency=force.omega(key), phase=phase, amplitude=amplitude))
        else:
            cosine = (force.amplitude * np.cos(phase) * e).tolist()
            sine = (-force.amplitude * np.sin(phase) * e).tolist()
            harmonics.append(Harmonic(frequency=force.omega(key), cosine=cosine, sine=sine))
    return ForcingKeys(
        sampled=sampled.sampled,
        hold=sampled.hold,
        constant=constant.tolist(),
        harmonics=tuple(harmonics),
        squares=tuple(squares),
        grounds=grounds,
        inputs=tuple(inputs),
    )


def _check_alone(key: str, force: Force, kind: str) -> None:
    """Raise ModelError if other keys of a force stand beside the one of its ``kind``."""
    for name in force.__struct_fields__:
        if name not in ("body", kind) and not isinstance(getattr(force, name), UnsetType):
            raise ModelError(f"{key}.{name}", f"stands beside {kind}; write two forces instead")


def _stop(line: _Line, key: str, stop: StopKeys) -> MatrixContact:
    """A stop as a contact, ``g = row . (q, s) + gap``."""
    if not isinstance(stop.between, UnsetType):
        _check_keys(key, stop, ("between", "gap"))
        row = line.across(f"{key}.between", stop.between)
        assert not isinstance(stop.gap, UnsetType), "checked"
        gap = stop.gap
    else:
        _check_keys(key, stop, ("body", "limit", "side"), optional="ground")
        sign = -1.0 if stop.side == "above" else 1.0
        row = sign * line.body(f"{key}.body", str(stop.body))
        assert not isinstance(stop.limit, UnsetType), "checked"
        gap = -sign * stop.limit
        if not isinstance(stop.ground, UnsetType):
            row = row - sign * line.ground(f"{key}.ground", stop.ground)
    factors = zip(line.moving, row[line.n :].tolist(), strict=True)
    return MatrixContact(
        name=stop.name,
        direction=row[: line.n].tolist(),
        gap=gap,
        restitution=stop.restitution,
        motion=tuple(GroundFactor(ground, factor) for ground, factor in factors if factor),
    )


def _check_keys(key: str, stop: StopKeys, wanted: Sequence[str], optional: str = "") -> None:
    """Raise ModelError unless a stop has the ``wanted`` keys of its form, and none of another."""
    for name in ("body", "limit", "side", "ground", "gap"):
        is_given = not isinstance(getattr(stop, name), UnsetType)
        if name in wanted and not is_given:
            raise ModelError(f"{key}.{name}", "is missing")
        if is_given and name not in (*wanted, optional):
            raise ModelError(f"{key}.{name}", f"does not go with {wanted[0]}")


def matrix_form(system: System) -> dict[str, Value]:
    """The keys of a model file from which ``system_of`` makes ``system``."""
    grounds = None if system.frame is None else system.frame.grounds
    contacts = list[dict[str, Value]]()
    for i, contact in enumerate(system.contacts):
        own = {"name": contact.name, "direction": contact.direction.tolist(), "gap": contact.gap}
        contacts.append({**own, **system.rebounds[i].document})
        if grounds is not None:
            moving = zip(grounds.names, grounds.factors[i].tolist(), strict=True)
            contacts[-1]["motion"] = [{"ground": g, "factor": f} for g, f in moving if f]
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
