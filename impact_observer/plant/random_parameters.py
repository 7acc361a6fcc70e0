# SPDX-License-Identifier: Apache-2.0
"""A plant whose parameters differ from those of its model by random errors."""

from typing import NamedTuple

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model import Model
from impact_observer.model.multibody import Multibody, family_of_model
from impact_observer.model.parameter_uncertainty import root_in_own_units

_MOST_DRAWS = 1000
"""Draws until one must be possible."""


class RandomPlant(NamedTuple):
    """A plant that was drawn.

    Attributes:
        system: with the drawn values.
        values: of the parameters by name, SI units.
    """

    system: Multibody
    values: dict[str, float]


def random_plant(model: Model, seed: int) -> RandomPlant:
    """A plant drawn from the deviations of a ``model``.

    A draw that no plant can have is drawn again: a restitution above 1, a start inside a stop.

    Raises:
        UsageError: the model has no deviations, or hardly any draw is possible.
    """
    known, name = model.uncertainty, model.source or model.subject.name
    if known is None:
        raise UsageError(
            f"{name}: no deviations of parameters found; expected some, such as restitution:"
            " {value: 0.7, deviation: 0.01}"
        )
    family = family_of_model(model, known.names)
    low, high = family.bounds
    order = [known.names.index(each) for each in family.names]
    nominal = family.nominal[np.argsort(order)]
    root, rng = root_in_own_units(known.covariance), np.random.default_rng(seed)
    for _ in range(_MOST_DRAWS):
        drawn = nominal + root @ rng.normal(size=len(root))
        values = drawn[order]
        if np.any((values < low) | (values > high)):
            continue
        try:
            system: Multibody = family.system_at(values)
            if model.position is not None:
                system.checked_start(*model.initial_state())
        except UsageError:
            continue
        return RandomPlant(system, dict(zip(known.names, drawn.tolist(), strict=True)))
    raise UsageError(
        f"{name}: none of {_MOST_DRAWS} draws of its parameters makes a plant; expected smaller"
        " deviations, or a start farther from the stops"
    )
