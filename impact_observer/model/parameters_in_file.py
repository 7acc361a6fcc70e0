# SPDX-License-Identifier: Apache-2.0
"""The parameters of a model in its file: where they stand, and deviations beside their numbers."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy import linalg

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import NotNegative, Value, converted
from impact_observer.model.free_parameters import OFFSET, parametric_family
from impact_observer.model.parameter_uncertainty import KEY, ParameterUncertainty
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.model.system import Element, System
from impact_observer.states import Matrix

Place: TypeAlias = tuple[str | int, ...]
"""Path of a value in a model file."""
_DEVIATION = "deviation"
_BESIDE = ("provenance", KEY)
"""Keys of a model file that hold no numbers of the physics."""


class ParameterPlace(NamedTuple):
    """A number of a model file that one parameter sets: ``slope`` times its value, + ``offset``.

    Attributes:
        name: of the parameter, such as ``gap.stop``.
        path: of the number, such as ``("stops", 0, "limit")``.
        slope: unit of the number over that of the parameter.
        offset: of the number.
    """

    name: str
    path: Place
    slope: float = 1.0
    offset: float = 0.0

    def number(self, value: float) -> float:
        """The number in the file for a ``value`` of the parameter."""
        return self.slope * value + self.offset


def key_of(path: Iterable[str | int]) -> str:
    """The key of a value in errors, such as ``stops[0].limit``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


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
        ModelError: a key without a value, a deviation without a value, or one that is no number
            >= 0.
    """
    deviations: dict[Place, float] = {}
    plain = {
        key: value if value and key in _BESIDE else _plain(value, (key,), deviations)
        for key, value in document.items()
    }
    return PlainDocument(plain, deviations)


def _plain(value: Value, path: Place, deviations: dict[Place, float]) -> Value:
    if value is None:
        raise ModelError(key_of(path), "nothing found; expected a value")
    if isinstance(value, list):
        return [_plain(each, (*path, i), deviations) for i, each in enumerate(value)]
    if not isinstance(value, Mapping):
        return value
    rest = {
        key: _plain(each, (*path, key), deviations)
        for key, each in value.items()
        if key != _DEVIATION
    }
    if _DEVIATION not in value:
        return rest
    if "value" not in rest:
        raise ModelError(f"{key_of(path)}.value", f"is missing beside {_DEVIATION}")
    is_alone, key = len(rest) == 1, f"{key_of(path)}.{_DEVIATION}"
    deviation = converted(value[_DEVIATION], NotNegative, key)
    deviations[path if is_alone else (*path, "value")] = deviation
    return rest["value"] if is_alone else rest


class DeclaredDeviations(NamedTuple):
    """What a model file says of the errors of its parameters.

    Attributes:
        known: the covariance under the key ``uncertainty``, and the deviations beside numbers.
        keys: the key of the error of each parameter, by its name.
        slopes: unit of the declared deviation over that of the parameter, by its name.
    """

    known: ParameterUncertainty
    keys: Mapping[str, str]
    slopes: Mapping[str, float]


def declared_deviations(
    given: ParameterUncertainty | None,
    deviations: Mapping[Place, float],
    places: Sequence[ParameterPlace],
) -> DeclaredDeviations | None:
    """The errors in a model file; None where the file says nothing.

    Args:
        given: what the key ``uncertainty`` has.
        deviations: those beside numbers, by the path of their number.
        places: of all parameters that are single numbers.

    Raises:
        ModelError: a deviation of what is no parameter, or of one that has a deviation already.
    """
    if given is None and not deviations:
        return None
    by_path = {each.path: each for each in places}
    keys = {name: f"{KEY}.names[{i}]" for i, name in enumerate(given.names if given else ())}
    slopes, variances = dict.fromkeys(keys, 1.0), list[float]()
    for path, deviation in deviations.items():
        key = key_of(path)
        if (place := by_path.get(path)) is None:
            kinds = ", ".join(dict.fromkeys(each.name.partition(".")[0] for each in places))
            problem = f"has a deviation, and is none of {kinds}"
            wanted = f"expected a plain number, and {KEY} for parameters of many numbers"
            raise ModelError(key, f"{problem}; {wanted}")
        if place.name in keys:
            problem = f"has a deviation, and {place.name} has one at {keys[place.name]}"
            raise ModelError(key, f"{problem}; expected one of the two")
        if not place.slope:
            raise ModelError(key, "is 0 with a deviation; expected another value, or a plain 0")
        keys[place.name], slopes[place.name] = key, abs(place.slope)
        variances.append((deviation / place.slope) ** 2)
    before = given.covariance if given else np.empty((0, 0))
    covariance: Matrix = linalg.block_diag(before, np.diag(variances))
    known = ParameterUncertainty((*keys,), covariance, given.fitted_to if given else None)
    return DeclaredDeviations(known, keys, slopes)


def of_use(
    declared: DeclaredDeviations, system: System, elements: Sequence[Element]
) -> ParameterUncertainty:
    """The ``declared`` errors of a linear system; those below the rounding of motions become 0.

    Raises:
        ModelError: the model has no such parameter, or an error makes its value useless.
    """
    known, keys, slopes = declared
    least = list[float]()
    for i, each in enumerate(_parameters(system, keys, elements)):
        deviation, (low, most) = math.sqrt(known.covariance[i, i]), each.deviation_range
        least.append(low)
        if deviation > most:
            key, slope = keys[each.name], slopes[each.name]
            own = f"{key.removesuffix('.value')}.{_DEVIATION}"
            raise ModelError(
                f"{KEY}.covariance[{i}][{i}]" if key.startswith(KEY) else own,
                f"{deviation * slope:g} found; expected at most {most * slope:g}: find the value"
                " with identify",
            )
    used = np.sqrt(np.diag(known.covariance)) >= least
    return replace(known, covariance=known.covariance * np.outer(used, used))


def _parameters(
    system: System, keys: Mapping[str, str], elements: Sequence[Element]
) -> Sequence[ModelParameter]:
    """The parameters whose names are in ``keys``, each with its key in the file.

    Raises:
        ModelError: a name is none of a parameter of the model.
    """
    if OFFSET in keys:
        raise ModelError(keys[OFFSET], f"{OFFSET} found; expected parameters of the model")
    try:
        found = parametric_family(system, [*keys], elements).parameters
    except UsageError as error:
        key = next((key for name, key in keys.items() if repr(name) in str(error)), KEY)
        raise ModelError(key, str(error)) from None
    for kind in keys.keys() - {each.name for each in found}:
        wanted = ", ".join(each.name for each in found)
        problem = f"{kind} found, a kind; expected single parameters: {wanted}"
        raise ModelError(keys[kind], problem)
    return found
