# SPDX-License-Identifier: Apache-2.0
"""Deviations that stand beside the numbers of a model file: ``{value: 0.7, deviation: 0.01}``."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import Value, number
from impact_observer.model.elements import Element
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parameter_places import Place, key_of, parameter_places
from impact_observer.model.parameter_uncertainty import KEY, ParameterUncertainty
from impact_observer.model.system import System

_DEVIATION = "deviation"
_BESIDE = ("provenance", KEY)
"""Keys of a model file that hold no numbers of the physics."""


class PlainDocument(NamedTuple):
    """A model file without the deviations beside its numbers.

    Attributes:
        document: the file with plain numbers.
        deviations: standard deviations by the path of their number, in its unit.
    """

    document: Mapping[str, Any]
    deviations: dict[Place, float]


def without_deviations(document: Mapping[str, Value]) -> PlainDocument:
    """The ``document`` of a model file with each ``{value, deviation}`` replaced by its value.

    Raises:
        ModelError: a deviation without a value, or one that is no number >= 0.
    """
    deviations: dict[Place, float] = {}
    plain = {
        key: value if key in _BESIDE else _plain(value, (key,), deviations)
        for key, value in document.items()
    }
    return PlainDocument(plain, deviations)


def _plain(value: Value, path: Place, deviations: dict[Place, float]) -> Value:
    if isinstance(value, list):
        return [_plain(each, (*path, i), deviations) for i, each in enumerate(value)]
    if not isinstance(value, Mapping):
        return value
    if _DEVIATION not in value:
        return {key: _plain(each, (*path, key), deviations) for key, each in value.items()}
    key, rest = key_of(path), {name: each for name, each in value.items() if name != _DEVIATION}
    if "value" not in rest:
        raise ModelError(f"{key}.value", f"is missing beside {_DEVIATION}")
    deviation = number(f"{key}.{_DEVIATION}", value[_DEVIATION])
    if deviation < 0:
        raise ModelError(
            f"{key}.{_DEVIATION}", f"is {deviation:g}; expected a standard deviation, >= 0"
        )
    alone = len(rest) == 1
    deviations[path if alone else (*path, "value")] = deviation
    return rest["value"] if alone else _plain(rest, path, deviations)


def with_deviations(
    known: ParameterUncertainty | None,
    plain: PlainDocument,
    system: System,
    elements: tuple[Element, ...],
) -> ParameterUncertainty | None:
    """What the key ``uncertainty`` has, ``known``, and the deviations beside numbers.

    Raises:
        ModelError: a deviation of what is no parameter, or of one that has a deviation already.
    """
    before, variances = known.names if known else (), list[float]()
    keys: dict[str, str] = {}
    for key, name, deviation in _named(plain, system):
        if name in keys or name in before:
            where = f"in {KEY}" if name in before else f"at {keys[name]}"
            raise ModelError(
                key, f"has a deviation, and {name} has one {where}; expected one of the two"
            )
        keys[name] = key
        variances.append(deviation**2)
    if not keys:
        return known
    try:
        parametric_family(system, [*before, *keys], elements)
    except UsageError as error:
        named = (key for name, key in keys.items() if repr(name) in str(error))
        raise ModelError(next(named, KEY), str(error)) from None
    own = np.diag(variances)
    covariance = linalg.block_diag(known.covariance, own) if known else own
    fitted_to = known.fitted_to if known else None
    return ParameterUncertainty((*before, *keys), covariance, fitted_to)


def _named(plain: PlainDocument, system: System) -> Iterator[tuple[str, str, float]]:
    """Key, parameter and deviation of each number that has one, in SI units of the parameter."""
    if not plain.deviations:
        return
    places = {each.path: each for each in parameter_places(plain.document, system)}
    for path, deviation in plain.deviations.items():
        key = key_of(path)
        if path not in places:
            raise ModelError(key, f"has a deviation; expected {_instead(path)}")
        place = places[path]
        if not place.slope:
            raise ModelError(
                key,
                "is 0 with a deviation; expected another value: an amplitude has relative ones",
            )
        yield key, place.name, deviation / abs(place.slope)


def _instead(path: Place) -> str:
    """Where a deviation belongs that cannot stand at ``path``."""
    if path[0] in ("mass", "stiffness", "damping"):
        return f"a plain number in a matrix, and {path[0]}-scale in {KEY}"
    if path[:2] == ("forcing", "harmonics") and path[-2:-1] in (("cosine",), ("sine",)):
        k = int(path[2]) + 1
        return f"a plain number, and forcing-amplitude.{k} or forcing-phase.{k} in {KEY}"
    return f"a plain number, as this is no parameter of the model: {KEY} takes those of identify"
