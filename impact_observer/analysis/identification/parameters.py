"""The parameters that can be free, by the names that users write."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from impact_observer.analysis.identification.family import Family, Numbers, Parameter
from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.states import Matrix

KINDS = (
    "restitution",
    "gap",
    "stiffness-scale",
    "damping-scale",
    "mass-scale",
    "stiffness",
    "damping",
    "mass",
    "forcing-amplitude",
    "forcing-phase",
    "clock-offset",
)
"""What can be free; of those of contacts, springs, bodies and harmonics one by one, or all."""
_SCALES = {"stiffness": "K", "damping": "C", "mass": "M"}
_UNITS = {"stiffness": "N/m", "damping": "Ns/m", "mass": "kg"}
_LARGEST_RATIO = 1e3
"""Most by which a scale may be wrong, up or down."""
_LONGEST = 0.1
"""Most that a clock may be off, s."""


def family_of(system: System, document: Mapping[str, object], wanted: Sequence[str]) -> Family:
    """The family of ``system`` whose members differ in the ``wanted`` parameters.

    Args:
        system: as the model says.
        document: what the model file says; its elements can be free one by one.
        wanted: names such as ``restitution``, which is that of every contact, or ``gap.stop``.

    Raises:
        UsageError: a name that there is not, that comes twice, or whose model cannot have it.
    """
    if system.forcing.sampled is not None:
        raise UsageError(
            f"{system.name}: its forcing is sampled, which identify cannot take; expected a"
            " constant and harmonics"
        )
    known = {each.name: each for each in _all(system, document)}
    names: list[str] = []
    for name in wanted:
        found = [each for each in known if each == name or each.startswith(f"{name}.")]
        if not found:
            raise UsageError(
                f"free parameter {name!r}: this model has none; expected some of"
                f" {', '.join(known)}; or all of a kind, such as restitution"
            )
        names.extend(found)
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"free parameter {name!r}: found twice; name it once")
    for one, other in combinations(sorted({name.partition(".")[0] for name in names}), 2):
        if other == f"{one}-scale":
            raise UsageError(f"free parameter {other!r}: stands beside {one}; free one of them")
    return Family(system, tuple(known[name] for name in names))


def _all(system: System, document: Mapping[str, object]) -> Iterator[Parameter]:
    """Every parameter that ``system`` has."""
    for i, contact in enumerate(system.contacts):
        unit = np.eye(system.m)[i]
        effect = Numbers.change(system, eps=unit)
        name = f"restitution.{contact.name}"
        yield Parameter(name, contact.restitution, 0.0, 1.0, 1.0, "", effect)
        effect = Numbers.change(system, gap=unit)
        size = abs(contact.gap) or 1.0
        yield Parameter(f"gap.{contact.name}", contact.gap, -np.inf, np.inf, size, "m", effect)
    for kind, part in _SCALES.items():
        if np.any(whole := getattr(system, part)):
            effect = Numbers.change(system, **{part: whole})
            low, high = 1 / _LARGEST_RATIO, _LARGEST_RATIO
            yield Parameter(f"{kind}-scale", 1.0, low, high, 1.0, "", effect)
    for kind, label, value, matrix in elements_of(system, document):
        effect = Numbers.change(system, **{_SCALES[kind]: matrix})
        low, high = (value / _LARGEST_RATIO if kind == "mass" else 0.0), np.inf
        yield Parameter(f"{kind}.{label}", value, low, high, value, _UNITS[kind], effect)
    yield from _of_forcing(system)


def _of_forcing(system: System) -> Iterator[Parameter]:
    """Those of the harmonics, and of the clock by which they are told."""
    h = system.forcing.frequency.size
    for k in range(h):
        unit = np.eye(h)[k]
        effect = Numbers.change(system, amplitude=unit)
        low, high = 1 / _LARGEST_RATIO, _LARGEST_RATIO
        yield Parameter(f"forcing-amplitude.{k + 1}", 1.0, low, high, 1.0, "", effect)
        effect = Numbers.change(system, phase=unit)
        yield Parameter(f"forcing-phase.{k + 1}", 0.0, -np.inf, np.inf, np.pi, "rad", effect)
    # Stamps that are late by an offset tell of a forcing that is behind by it.
    effect = Numbers.change(system, phase=-system.forcing.frequency)
    yield Parameter("clock-offset", 0.0, -_LONGEST, _LONGEST, _LONGEST, "s", effect)


def elements_of(
    system: System, document: Mapping[str, object]
) -> Iterator[tuple[str, str, float, Matrix]]:
    """Masses, springs and dampers of the element form: kind, label, value, and its matrix.

    Args:
        system: what the document says.
        document: a valid model file; one of matrices has no elements.
    """
    axes = dict(zip(system.coordinates, np.eye(system.n), strict=True))
    for body in _items(document, "bodies"):
        name = str(body["name"])
        yield "mass", name, _number(body["mass"]), np.outer(axes[name], axes[name])
    for label, spring in springs_of(document):
        one, other = (axes.get(str(end), np.zeros(system.n)) for end in _pair(spring))
        dyad = np.outer(other - one, other - one)
        for kind in ("stiffness", "damping"):
            if value := _number(spring.get(kind, 0.0)):
                yield kind, label, value, dyad


def springs_of(document: Mapping[str, object]) -> Iterator[tuple[str, Mapping[str, object]]]:
    """Springs with labels such as ``ground-x1``; of several alike the second is ``..#2``."""
    labels: list[str] = []
    for spring in _items(document, "springs"):
        label = "-".join(map(str, _pair(spring)))
        labels.append(label)
        count = labels.count(label)
        yield label if count == 1 else f"{label}#{count}", spring


def _items(document: Mapping[str, object], key: str) -> list[Mapping[str, object]]:
    """The members of a list of a model file, which has been checked."""
    found = document.get(key, [])
    assert isinstance(found, list), "a model that was read has a list there"
    return found


def _pair(spring: Mapping[str, object]) -> list[object]:
    found = spring["between"]
    assert isinstance(found, list), "a model that was read has a pair there"
    return found


def _number(value: object) -> float:
    assert isinstance(value, (int, float)), "a model that was read has a number there"
    return float(value)
