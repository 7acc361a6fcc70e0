"""The parameters that can be free, by the names that users write."""

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
"""What can be free, of contacts, springs, bodies and harmonics one by one or all; its unit."""
_SCALES = {"stiffness": "K", "damping": "C", "mass": "M"}
_LARGEST_RATIO = 1e3
"""Most by which a scale may be wrong, up or down."""
_LONGEST = 0.1
"""Most that a clock may be off, s."""


def parametric_family(
    system: System,
    wanted: Sequence[str],
    elements: Sequence[Element] = (),
    *,
    clock: bool = True,
) -> ParametricFamily:
    """The family of ``system`` whose members differ in the ``wanted`` parameters.

    Args:
        system: as the model says.
        wanted: names such as ``restitution``, which is that of every contact, or ``gap.stop``.
        elements: what it was assembled of: these can be free one by one.
        clock: whether the offset of the sensor's clock can be free, too.

    Raises:
        UsageError: a name that there is not, that comes twice, or whose model cannot have it.
    """
    known = {each.name: each for each in _all(system, elements) if clock or each.name != OFFSET}
    names: list[str] = []
    for name in wanted:
        found = [each for each in known if each == name or each.startswith(f"{name}.")]
        if not found:
            raise UsageError(
                f"parameter {name!r}: this model has none; expected some of"
                f" {', '.join(known)}; or all of a kind, such as restitution"
            )
        names.extend(found)
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"parameter {name!r}: found twice; name it once")
    for one, other in combinations(sorted({name.partition(".")[0] for name in names}), 2):
        if other == f"{one}-scale":
            raise UsageError(f"parameter {other!r}: stands beside {one}; free one of them")
    return ParametricFamily(system, tuple(known[name] for name in names))


def with_unit(name: str) -> str:
    """The name in words, with the unit, of something that is learnt: a parameter, or a clock's."""
    unit = UNITS.get(name.partition(".")[0], "s")
    words = name.replace("_", " ")
    return f"{words} [{unit}]" if unit else words


def _all(system: System, elements: Sequence[Element]) -> Iterator[ModelParameter]:
    """Every parameter that ``system`` has."""
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
    """Those of the harmonics, and of the clock by which they are told."""
    h = system.forcing.frequency.size
    for k in range(h):
        unit = np.eye(h)[k]
        effect = Coefficients.change(system, amplitude=unit)
        low, high = 1 / _LARGEST_RATIO, _LARGEST_RATIO
        yield ModelParameter(f"forcing-amplitude.{k + 1}", 1.0, low, high, 1.0, "", effect)
        effect = Coefficients.change(system, phase=unit)
        yield ModelParameter(f"forcing-phase.{k + 1}", 0.0, -np.inf, np.inf, np.pi, "rad", effect)
    # Stamps that are late by an offset tell of a forcing that is behind by it.
    effect = Coefficients.change(system, phase=-system.forcing.frequency)
    yield ModelParameter(OFFSET, 0.0, -_LONGEST, _LONGEST, _LONGEST, "s", effect)
