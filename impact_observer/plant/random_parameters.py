# SPDX-License-Identifier: Apache-2.0
"""A plant whose parameters differ from those of its model by random errors."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model import Model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.multibody import Multibody, multibody_of
from impact_observer.model.parameter_uncertainty import root_in_own_units
from impact_observer.states import Vector

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
    nominal, made = _family(model, known.names)
    root, rng = root_in_own_units(known.covariance), np.random.default_rng(seed)
    for _ in range(_MOST_DRAWS):
        drawn = nominal + root @ rng.normal(size=len(root))
        try:
            system = made(drawn)
            if model.position is not None:
                system.checked_start(*model.initial_state())
        except UsageError:
            continue
        return RandomPlant(system, dict(zip(known.names, drawn.tolist(), strict=True)))
    raise UsageError(
        f"{name}: none of {_MOST_DRAWS} draws of its parameters makes a plant; expected smaller"
        " deviations, or a start farther from the stops"
    )


def _family(model: Model, names: tuple[str, ...]) -> tuple[Vector, Callable[[Vector], Multibody]]:
    """Declared values of parameters, shape (p,), and a function of values that makes a plant.

    The function raises UsageError for impossible values.
    """
    if (robot := model.robot) is not None:
        values = np.array([robot.parameters[name] for name in names])

        def described(drawn: Vector) -> Multibody:
            own = robot.with_parameters(dict(zip(names, drawn.tolist(), strict=True)))
            return multibody_of(replace(model, robot=own))

        return values, described
    family = parametric_family(model.system, names, model.elements)
    low, high = family.bounds

    def linear(drawn: Vector) -> Multibody:
        if np.any((drawn < low) | (drawn > high)):
            raise UsageError("a parameter is out of its bounds")
        return family.system_at(drawn)

    return family.nominal, linear
