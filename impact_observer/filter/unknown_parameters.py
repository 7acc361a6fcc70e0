# SPDX-License-Identifier: Apache-2.0
"""The parameters of the model that an observer estimates with the state, as users name them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.filter.tuning import TUNING
from impact_observer.model import System
from impact_observer.model.elements import Element
from impact_observer.model.free_parameters import OFFSET, parametric_family
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.options import highest
from impact_observer.states import Vector, frozen

_DEVIATION_RANGE = (1e-12, 1.0)
"""Least and largest standard deviation of a parameter, relative to its size."""
_GAP_FACTOR = 100.0
"""Largest standard deviation of a gap over the gap, which may be small beside the motion."""


@dataclass(frozen=True, slots=True, eq=False)
class UnknownParameters:
    """Parameters of the model that are estimated with the state.

    Attributes:
        family: the system and these parameters; first those that change the motion between
            impacts.
        deviations: standard deviations of the model's values, shape (p,), in their units.
        drift: of the random walk of the parameters in a minute, as a share of ``deviations``; 0
            for constants.
    """

    family: ParametricFamily
    deviations: Vector
    drift: float = 0.0

    def __post_init__(self) -> None:
        """Check that the numbers can be used.

        Raises:
            UsageError: naming what was found.
        """
        object.__setattr__(self, "deviations", frozen(self.deviations))
        most = highest("parameter_drift")
        if not 0 <= self.drift <= most:
            raise UsageError(f"parameter_drift: {self.drift:g} found; expected 0 to {most:g}")
        if self.deviations.shape != (self.family.size,):
            found, size = self.deviations.size, self.family.size
            raise UsageError(f"deviations: {found} found; expected {size}, one a parameter")
        for each, deviation in zip(self.family.parameters, self.deviations.tolist(), strict=True):
            least, most = (each.size * share for share in _DEVIATION_RANGE)
            most *= _GAP_FACTOR if np.any(each.effect.gap) else 1.0
            if not least <= deviation <= most:
                raise UsageError(
                    f"deviation of {each.name}: {deviation:g} found; expected {least:g} to"
                    f" {most:g}"
                )

    @classmethod
    def named(
        cls,
        system: System,
        wanted: Sequence[str],
        elements: Sequence[Element] = (),
        drift: float = 0.0,
    ) -> "UnknownParameters":
        """The parameters that users name.

        ``wanted`` are names as of ``identify --free``, such as ``restitution`` or ``gap.stop``,
        each perhaps with a standard deviation, as in ``restitution=0.05``.

        Raises:
            UsageError: an unknown name, a name that comes twice, or a deviation that is no number.
        """
        declared: dict[str, float] = {}
        names = []
        for text in wanted:
            name, sign, number = (part.strip() for part in text.partition("="))
            if name == OFFSET:
                raise UsageError(
                    f"estimate_parameters {name!r}: a clock's offset is no parameter of the model;"
                    " declare clock_offset_error instead"
                )
            names.append(name)
            if sign:
                declared[name] = _number(text, number)
        family = parametric_family(system, names, elements, observed=True)
        return cls.of(family, declared, drift)

    @classmethod
    def of(
        cls, family: ParametricFamily, declared: Mapping[str, float], drift: float = 0.0
    ) -> "UnknownParameters":
        """Those of a family; deviations are ``declared`` by name or kind, others are the usual.

        Raises:
            UsageError: a deviation cannot be used.
        """
        parameters = tuple(sorted(family.parameters, key=lambda each: not each.moves))
        deviations = []
        for each in parameters:
            kind = each.name.partition(".")[0]
            usual = TUNING.parameter_deviation * each.size
            usual = TUNING.restitution_deviation if kind == "restitution" else usual
            deviations.append(declared.get(each.name, declared.get(kind, usual)))
        return cls(ParametricFamily(family.system, parameters), np.array(deviations), drift)


def _number(text: str, number: str) -> float:
    try:
        return float(number)
    except ValueError:
        raise UsageError(
            f"estimate_parameters {text!r}: {number or 'nothing'} found after =; expected a"
            " standard deviation, as in restitution=0.05"
        ) from None
