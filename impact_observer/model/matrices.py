# SPDX-License-Identifier: Apache-2.0
"""The matrix form of a model, and the forcing that it shares with robots."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from impact_observer.errors import ModelError
from impact_observer.model.document import Value, matrix, vector
from impact_observer.model.forcing import Forcing
from impact_observer.model.ground_keys import GroundMotions, live_names, read_grounds
from impact_observer.model.matrix_files import load_matrix
from impact_observer.model.rebounds import read_rebound
from impact_observer.model.sampled_files import read_samples, written_samples
from impact_observer.model.schema import (
    ForcingKeys,
    MatrixContact,
    MatrixModel,
    SmoothForcing,
)
from impact_observer.model.square_waves import SquareWaves
from impact_observer.model.system import Contact, System, moving_system
from impact_observer.states import Matrix, Vector


def system_of_matrices(model: MatrixModel, folder: Path | None) -> System:
    """The system in a model file of matrices; ``folder`` is where its other files lie.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    names, n = tuple(model.coordinates), len(model.coordinates)
    motions, given = read_grounds(model.grounds, (), folder), model.forcing

    def read(key: str) -> Matrix:
        value: Sequence[Sequence[float]] | str = getattr(model, key)
        if isinstance(value, str):
            return load_matrix(key, value, folder)
        return matrix(key, value, (n, n))

    forcing = replace(smooth_forcing(given, names, folder), squares=_squares(given, n))
    M, C, K = (read(key) for key in ("mass", "damping", "stiffness"))
    contacts = tuple(_contact(f"contacts[{i}]", c, n) for i, c in enumerate(model.contacts))
    system = System(model.name, names, M, C, K, forcing, contacts)
    if motions.names:
        stiffness, damping = np.zeros((2, n, len(motions.names)))
        for i, ground in enumerate(given.grounds):
            key = f"forcing.grounds[{i}]"
            k = _index(f"{key}.name", ground.name, motions)
            stiffness[:, k] += vector(f"{key}.stiffness", ground.stiffness, n)
            damping[:, k] += vector(f"{key}.damping", ground.damping, n)
        factors = np.array(
            [_factors(f"contacts[{i}]", c, motions) for i, c in enumerate(model.contacts)]
        )
        factors = factors.reshape(-1, len(motions.names))
        system = moving_system(system, motions.grounds(stiffness, damping, factors))
    elif given.grounds or any(each.motion for each in model.contacts):
        raise ModelError("grounds", "is missing or empty; expected the grounds that are named")
    inputs = [
        (each.name, vector(f"forcing.inputs[{i}].direction", each.direction, n))
        for i, each in enumerate(given.inputs)
    ]
    return replace(system, live=live_names(inputs, n))


def smooth_forcing(
    given: SmoothForcing, coordinates: Sequence[str], folder: Path | None, meaning: str = ""
) -> Forcing:
    """Constants, harmonics and samples of the forcing of ``coordinates``.

    CSV files lie in ``folder``; ``meaning`` is that of ``vector``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    n, key = len(coordinates), "forcing.harmonics"
    waves = list(enumerate(given.harmonics))
    cosine = [vector(f"{key}[{i}].cosine", each.cosine, n, meaning) for i, each in waves]
    sine = [vector(f"{key}[{i}].sine", each.sine, n, meaning) for i, each in waves]
    return Forcing(
        constant=vector("forcing.constant", given.constant, n, meaning),
        frequency=np.array([each.omega(f"{key}[{i}]") for i, each in waves]),
        cosine=np.reshape(cosine, (len(waves), n)),
        sine=np.reshape(sine, (len(waves), n)),
        sampled=read_samples(given, coordinates, folder),
    )


def _squares(forcing: ForcingKeys, n: int) -> SquareWaves | None:
    """The square waves on ``n`` coordinates; None without any."""
    rows = [
        (each.omega(key), each.phase, vector(f"{key}.amplitude", each.amplitude, n))
        for key, each in ((f"forcing.squares[{i}]", e) for i, e in enumerate(forcing.squares))
    ]
    return SquareWaves.of_rows(rows) if rows else None


def _index(key: str, name: str, motions: GroundMotions) -> int:
    """The index of the ground of this ``name``."""
    if name not in motions.names:
        raise ModelError(key, f"{name!r} is not a ground; expected {', '.join(motions.names)}")
    return motions.names.index(name)


def _contact(key: str, contact: MatrixContact, n: int) -> Contact:
    law = read_rebound(f"{key}.restitution", contact.restitution)
    direction = vector(f"{key}.direction", contact.direction, n)
    return Contact(contact.name, direction, contact.gap, law.nominal, law)


def _factors(key: str, contact: MatrixContact, motions: GroundMotions) -> Vector:
    """Factors of ground displacements in the gap of a contact, shape (k,)."""
    factors = np.zeros(len(motions.names))
    for i, part in enumerate(contact.motion):
        factors[_index(f"{key}.motion[{i}].ground", part.ground, motions)] += part.factor
    return factors


def matrix_form(system: System) -> dict[str, Value]:
    """The keys of a model file from which ``system_of_matrices`` makes ``system``."""
    s, grounds = system, None if system.frame is None else system.frame.grounds
    contacts = list[dict[str, Value]]()
    for i, contact in enumerate(s.contacts):
        named: dict[str, Value] = {"name": contact.name, "direction": contact.direction.tolist()}
        contacts.append({**named, "gap": contact.gap, **s.rebounds[i].document})
        if grounds is not None:
            moving = zip(grounds.names, grounds.factors[i].tolist(), strict=True)
            contacts[-1]["motion"] = [{"ground": g, "factor": f} for g, f in moving if f]
    form: dict[str, Value] = {
        "coordinates": list(s.coordinates),
        "mass": s.M.tolist(),
        "damping": s.C.tolist(),
        "stiffness": s.K.tolist(),
        "forcing": _written_forcing(s),
        "contacts": contacts,
    }
    return form if grounds is None else {**form, "grounds": list(grounds.written)}


def _rows(names: Sequence[str], *columns: Sequence[Value]) -> list[dict[str, Value]]:
    return [dict(zip(names, each, strict=True)) for each in zip(*columns, strict=True)]


def _written_forcing(system: System) -> dict[str, Value]:
    own, waves = system.own_forcing, system.own_forcing.squares
    columns: Sequence[Sequence[Value]]
    columns = own.frequency.tolist(), own.cosine.tolist(), own.sine.tolist()
    document: dict[str, Value] = {
        "constant": own.constant.tolist(),
        "harmonics": _rows(("frequency", "cosine", "sine"), *columns),
        **written_samples(own.sampled, system.coordinates),
    }
    if waves is not None:
        columns = waves.frequency.tolist(), waves.phase.tolist(), waves.force.tolist()
        document["squares"] = _rows(("frequency", "phase", "amplitude"), *columns)
    if system.frame is not None:
        grounds = system.frame.grounds
        columns = grounds.names, grounds.stiffness.T.tolist(), grounds.damping.T.tolist()
        document["grounds"] = _rows(("name", "stiffness", "damping"), *columns)
    if system.live is not None:
        columns = system.live.inputs, system.live.directions.T.tolist()
        document["inputs"] = _rows(("name", "direction"), *columns)
    return document
