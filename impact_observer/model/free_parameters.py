"""The parameters of a model that can be estimated, by the names that users write."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model.elements import Element
from impact_observer.model.parametric_family import Coefficients, ModelParameter, ParametricFamily
from impact_observer.model.system import System

OFFSET = "clock-offset"
UNITS = {
    "restitution": "",
    "gap": "m",
    "stiffness-scale": "",
    "damping-scale": "",
    "mass-scale": "",
    "stiffness": "N/m",
    "damping": "Ns/m",
    "mass": "kg",
    "forcing-amplitude": "",
    "forcing-phase": "rad",
    OFFSET: "s",
}
"""Kinds of free parameters and their SI units; empty for a ratio."""
_SCALES = {"stiffness": "K", "damping": "C", "mass": "M"}
_LARGEST_RATIO = 1e3
"""Largest value of a scale, and the inverse of its least."""
_LONGEST = 0.1
"""Largest offset of a clock, s."""


def parametric_family(
    system: System,
    wanted: Sequence[str],
    elements: Sequence[Element] = (),
    *,
    clock: bool = True,
) -> ParametricFamily:
    """The family of systems that differ from ``system`` in the ``wanted`` parameters.

    A name such as ``restitution`` is that of every contact, ``gap.stop`` that of one. The values
    of ``elements`` can be free, too, and with ``clock`` the offset of the sensor's clock.

    Raises:
        UsageError: a name is unknown, given twice, or does not go with another.
    """
    available = {
        each.name: each for each in _all(system, elements) if clock or each.name != OFFSET
    }
    names: list[str] = []
    for name in wanted:
        found = [each for each in available if each == name or each.startswith(f"{name}.")]
        if not found:
            raise UsageError(
                f"parameter {name!r}: this model has none; expected some of"
                f" {', '.join(available)}; or all of a kind, such as restitution"
            )
        names.extend(found)
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"parameter {name!r}: found twice; name it once")
    for one, other in combinations(sorted({name.partition(".")[0] for name in names}), 2):
        if other == f"{one}-scale":
            raise UsageError(f"parameter {other!r}: stands beside {one}; free one of them")
    return ParametricFamily(system, tuple(available[name] for name in names))


def with_unit(name: str) -> str:
    """The name of an estimated parameter in words, with its unit."""
    unit = UNITS.get(name.partition(".")[0], "s")
    words = name.replace("_", " ")
    return f"{words} [{unit}]" if unit else words


def _all(system: System, elements: Sequence[Element]) -> Iterator[ModelParameter]:
    for i, contact in enumerate(system.contacts):
        unit = np.eye(system.m)[i]
        effect = Coefficients.change(system, eps=unit)
        name = f"restitution.{contact.name}"
        yield ModelParameter(name, contact.restitution, 0.0, 1.0, 1.0, "", effect)
        effect = Coefficients.change(system, gap=unit)
        size = abs(contact.gap) or 1.0
        yield ModelParameter(
            f"gap.{contact.name}", contact.gap, -np.inf, np.inf, size, "m", effect
        )
    for kind, part in _SCALES.items():
        if np.any(whole := getattr(system, part)):
            effect = Coefficients.change(system, **{part: whole})
            low, high = 1 / _LARGEST_RATIO, _LARGEST_RATIO
            yield ModelParameter(f"{kind}-scale", 1.0, low, high, 1.0, "", effect)
    for each in elements:
        effect = Coefficients.change(system, **{_SCALES[each.kind]: each.matrix})
        low, high = (each.value / _LARGEST_RATIO if each.kind == "mass" else 0.0), np.inf
        name, unit = f"{each.kind}.{each.label}", UNITS[each.kind]
        yield ModelParameter(name, each.value, low, high, each.value, unit, effect)
    yield from _of_forcing(system)


def _of_forcing(system: System) -> Iterator[ModelParameter]:
    h = system.forcing.frequency.size
    for k in range(h):
        unit = np.eye(h)[k]
        effect = Coefficients.change(system, amplitude=unit)
        low, high = 1 / _LARGEST_RATIO, _LARGEST_RATIO
        yield ModelParameter(f"forcing-amplitude.{k + 1}", 1.0, low, high, 1.0, "", effect)
        effect = Coefficients.change(system, phase=unit)
        yield ModelParameter(f"forcing-phase.{k + 1}", 0.0, -np.inf, np.inf, np.pi, "rad", effect)
    # Stamps that are late by an offset are those of a forcing that lags by it.
    effect = Coefficients.change(system, phase=-system.forcing.frequency)
    yield ModelParameter(OFFSET, 0.0, -_LONGEST, _LONGEST, _LONGEST, "s", effect)
