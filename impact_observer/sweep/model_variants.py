# SPDX-License-Identifier: Apache-2.0
"""The models of the observers: the plant's own, or variants with other parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from impact_observer.errors import ModelError, UsageError
from impact_observer.model import Model
from impact_observer.model.free_parameters import parametric_family


class ParameterValue(NamedTuple):
    """A swept parameter of an observer's model.

    Attributes:
        name: as in ``identify``.
        value: SI units.
        unit: empty for a ratio.
    """

    name: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class ModelVariant:
    """The model of an observer.

    Attributes:
        text: a model file in matrix form, without an initial state.
        parameters: the swept parameters.
    """

    text: str
    parameters: tuple[ParameterValue, ...] = ()


def model_variants(model: Model, off: Mapping[str, Sequence[float]]) -> tuple[ModelVariant, ...]:
    """A variant for every combination of the values in ``off``; the true model without values.

    Args:
        model: of the plant.
        off: values by the names of parameters as in ``identify``, such as ``gap.stop``; a name
            without a point sets all parameters of its kind.

    Raises:
        UsageError: the model has no such parameter, or the parameter cannot have the value.
        ModelError: the values make no valid model.
    """
    if not off:
        return (ModelVariant(Model(model.system).text()),)
    try:
        family = parametric_family(model.system, [*off], model.elements)
    except UsageError as error:
        raise UsageError(f"off: {error}") from None
    # The name in ``off`` of each parameter: its own, or its kind.
    kind = {name: name if name in off else name.partition(".")[0] for name in family.names}
    units = {kind[each.name]: each.unit for each in family.parameters}
    for each in family.parameters:
        for value in off[kind[each.name]]:
            if not each.low <= value <= each.high:
                raise UsageError(
                    f"off: {each.name} {value:g} found; expected {each.low:g} to {each.high:g}"
                )
    variants = []
    for values in product(*off.values()):
        chosen = dict(zip(off, map(float, values), strict=True))
        try:
            system = family.system_at(np.array([chosen[kind[name]] for name in family.names]))
        except ModelError as error:
            values_set = ", ".join(f"{name} {value:g}" for name, value in chosen.items())
            raise ModelError("", f"off: {values_set}: {error}") from None
        swept = (ParameterValue(name, value, units[name]) for name, value in chosen.items())
        variants.append(ModelVariant(Model(system).text(), tuple(swept)))
    return tuple(variants)
