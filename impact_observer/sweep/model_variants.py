"""The models that observers believe in: the plant's own, or ones that are wrong by so much."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from impact_observer.errors import ModelError, UsageError
from impact_observer.model import Model
from impact_observer.model.free_parameters import parametric_family


class Off(NamedTuple):
    """A parameter of a replica that is not, or need not be, as in the plant.

    Attributes:
        name: as ``identify`` has it.
        value: SI units.
        unit: in words; empty for a ratio.
    """

    name: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class Replica:
    """What an observer takes the plant for.

    Attributes:
        text: a model file in matrix form, without an initial state.
        off: what may be wrong in it.
    """

    text: str
    off: tuple[Off, ...] = ()


def replicas_of(model: Model, off: Mapping[str, Sequence[float]]) -> tuple[Replica, ...]:
    """A replica for every combination of the values in ``off``; the true one where it is empty.

    Args:
        model: of the plant.
        off: values by the names that ``identify`` has for parameters, such as ``gap.stop``; a
            name without a point is all of its kind, each with the value.

    Raises:
        UsageError: a name that this model has not, or a value that the parameter cannot have.
        ModelError: with such values the model is none.
    """
    if not off:
        return (Replica(Model(model.system).text()),)
    return tuple(_replicas(model, off))


def _replicas(model: Model, off: Mapping[str, Sequence[float]]) -> Iterator[Replica]:
    """At least one parameter may be off."""
    try:
        family = parametric_family(model.system, [*off], model.elements)
    except UsageError as error:
        raise UsageError(f"off: {error}") from None
    # Of a kind all members have the value that is given for the kind.
    kind = {name: name if name in off else name.partition(".")[0] for name in family.names}
    units = {kind[each.name]: each.unit for each in family.parameters}
    for each in family.parameters:
        for value in off[kind[each.name]]:
            if not each.low <= value <= each.high:
                raise UsageError(
                    f"off: {each.name} {value:g} found; expected {each.low:g} to {each.high:g}"
                )
    for values in product(*off.values()):
        chosen = dict(zip(off, map(float, values), strict=True))
        try:
            system = family.system_at(np.array([chosen[kind[name]] for name in family.names]))
        except ModelError as error:
            told = ", ".join(f"{name} {value:g}" for name, value in chosen.items())
            raise ModelError("", f"off: {told}: {error}") from None
        off_by = [Off(name, value, units[name]) for name, value in chosen.items()]
        yield Replica(Model(system).text(), tuple(off_by))
