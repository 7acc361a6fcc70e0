# SPDX-License-Identifier: Apache-2.0
"""The uncertain parameters of the model: estimated with the state, or considered."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.free_parameters import OFFSET, is_observed, parametric_family
from impact_observer.model.parameter_uncertainty import ParameterUncertainty, root_in_own_units
from impact_observer.model.parametric_family import ParametricFamily
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
        """Check that the numbers can be used.

        Raises:
            UsageError: naming what was found.
        """
        object.__setattr__(self, "covariance", frozen(self.covariance))
        size = self.family.size
        object.__setattr__(self, "considered", self.considered or (False,) * size)
        if self.covariance.shape != (size, size):
            found = self.covariance.shape
            raise UsageError(f"covariance: shape {found} found; expected {(size, size)}")
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
        deviation is that of the model's ``uncertainty``.

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
        found = cls.of(family, declared, uncertainty)
        return found if uncertainty is None else found.considering(uncertainty, elements)

    @classmethod
    def of(
        cls,
        family: ParametricFamily,
        declared: Mapping[str, float],
        uncertainty: ParameterUncertainty | None = None,
    ) -> "UnknownParameters":
        """The parameters of a ``family``, all estimated.

        Deviations are ``declared`` by name or kind, or those of the model's ``uncertainty``, or
        the usual ones.

        Raises:
            UsageError: a deviation cannot be used.
        """
        family = _motion_first(family)
        known = {} if uncertainty is None else uncertainty.deviation_by_name
        deviations = []
        for each in family.parameters:
            kind = each.name.partition(".")[0]
            usual = _DEVIATION * each.size
            usual = _RESTITUTION_DEVIATION if kind == "restitution" else usual
            usual = known.get(each.name) or usual
            deviations.append(declared.get(each.name, declared.get(kind, usual)))
        return cls(family, np.diag(deviations) ** 2)

    def considering(
        self, uncertainty: ParameterUncertainty, elements: Sequence[Element] = ()
    ) -> "UnknownParameters":
        """These, and beside them the others with a deviation in ``uncertainty``: considered.

        Parameters that only ``identify`` learns are left out, see ``Model.doubts``.

        Raises:
            UsageError: a deviation cannot be used, or a parameter excludes an estimated one.
        """
        own, known = self.family, uncertainty.deviation_by_name
        others = [n for n, d in known.items() if d and n not in own.names and is_observed(n)]
        if not others:
            return self
        names = [*own.names, *others]
        whole = _motion_first(parametric_family(own.system, names, elements, observed=True))
        deviation = known | dict(zip(own.names, self.deviations.tolist(), strict=True))
        scale = np.array([deviation[name] for name in whole.names])
        covariance = uncertainty.correlation(whole.names) * np.outer(scale, scale)
        considered = tuple(name in others for name in whole.names)
        return UnknownParameters(whole, covariance, considered)


def _motion_first(family: ParametricFamily) -> ParametricFamily:
    """The ``family`` with the parameters first that change the motion between impacts."""
    parameters = sorted(family.parameters, key=lambda each: not each.moves)
    return ParametricFamily(family.system, tuple(parameters))


def _number(text: str, number: str) -> float:
    try:
        return float(number)
    except ValueError:
        raise UsageError(
            f"estimate_parameters {text!r}: {number or 'nothing'} found after =; expected a"
            " standard deviation, as in restitution=0.05"
        ) from None
