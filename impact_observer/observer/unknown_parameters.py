# SPDX-License-Identifier: Apache-2.0
"""The uncertain parameters of the model: estimated with the state, or considered."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.free_parameters import OFFSET, is_observed, parametric_family
from impact_observer.model.parameter_uncertainty import ParameterUncertainty, root_in_own_units
from impact_observer.model.parametric_family import ModelParameter, ParametricFamily
from impact_observer.model.system import Element
from impact_observer.states import Matrix, Vector, frozen

_RESTITUTION_DEVIATION = 0.1
"""Prior deviation of a restitution that is estimated, where none is declared."""
_DEVIATION = 0.05
"""The same of any other parameter, relative to its size."""


@dataclass(frozen=True, slots=True, eq=False)
class UnknownParameters:
    """Parameters of the model whose values are uncertain.

    Attributes:
        family: the system and these parameters; first those that change the motion between
            impacts.
        covariance: of the model's values, shape (p, p), in their units.
        considered: which of the parameters are considered (Schmidt), not estimated; none by
            default.
    """

    family: ParametricFamily
    covariance: Matrix
    considered: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        """Raise UsageError where a deviation cannot be used."""
        object.__setattr__(self, "covariance", frozen(self.covariance))
        object.__setattr__(self, "considered", self.considered or (False,) * self.family.size)
        for each, deviation in zip(self.family.parameters, self.deviations.tolist(), strict=True):
            least, most = each.deviation_range
            if not least <= deviation <= most:
                raise UsageError(
                    f"deviation of {each.name}: {deviation:g} found; expected {least:g} to"
                    f" {most:g}"
                )

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the model's values, shape (p,), in their units."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def root(self) -> Matrix:
        """A square root of ``covariance``, shape (p, p)."""
        return root_in_own_units(self.covariance)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        each = zip(self.family.names, self.considered, strict=True)
        return tuple(name for name, considered in each if not considered)

    @classmethod
    def named(
        cls,
        system: System,
        wanted: Sequence[str],
        elements: Sequence[Element] = (),
        uncertainty: ParameterUncertainty | None = None,
    ) -> "UnknownParameters":
        """The parameters that users name are estimated, others that are uncertain considered.

        ``wanted`` are names as of ``identify --free``, such as ``restitution`` or ``gap.stop``,
        each perhaps with a standard deviation, as in ``restitution=0.05``. Without one the
        deviation is that of the model's ``uncertainty``, or the usual one. Parameters that only
        ``identify`` learns are left out, see ``Model.doubts``.

        Raises:
            UsageError: an unknown name, a name that comes twice or excludes another, or a
                deviation that is no number or cannot be used.
        """
        given = dict[str, float]()
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
                given[name] = _number(text, number)
        estimated = parametric_family(system, names, elements, observed=True).names
        declared = {} if uncertainty is None else uncertainty.deviation_by_name
        considered = [
            n for n, d in declared.items() if d and n not in estimated and is_observed(n)
        ]
        family = parametric_family(system, [*estimated, *considered], elements, observed=True)
        ordered = sorted(family.parameters, key=lambda each: not each.moves)
        family = ParametricFamily(family.system, tuple(ordered))
        deviations = np.array([_deviation(each, given, declared) for each in ordered])
        covariance = np.diag(deviations) ** 2
        if uncertainty is not None:
            covariance = uncertainty.correlation(family.names) * np.outer(deviations, deviations)
        return cls(family, covariance, tuple(name in considered for name in family.names))


def _deviation(
    parameter: ModelParameter, given: dict[str, float], declared: dict[str, float]
) -> float:
    """The prior deviation: as a user has given it by name or kind, declared, or usual."""
    name = parameter.name
    kind = name.partition(".")[0]
    usual = _RESTITUTION_DEVIATION if kind == "restitution" else _DEVIATION * parameter.size
    return given.get(name, given.get(kind, declared.get(name) or usual))


def _number(text: str, number: str) -> float:
    try:
        return float(number)
    except ValueError:
        raise UsageError(
            f"estimate_parameters {text!r}: {number or 'nothing'} found after =; expected a"
            " standard deviation, as in restitution=0.05"
        ) from None
