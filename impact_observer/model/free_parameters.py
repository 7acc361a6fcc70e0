# SPDX-License-Identifier: Apache-2.0
"""The parameters of a model that can be estimated, and their names in commands."""

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from itertools import combinations

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model.parametric_family import Coefficients, ModelParameter, ParametricFamily
from impact_observer.model.rebounds import REBOUND_UNITS
from impact_observer.model.system import Element, System, unit_of
from impact_observer.states import Matrix

OFFSET, LATENCY = "clock-offset", "latency"
UNITS = {
    **REBOUND_UNITS,
    "gap": "m",
    "stiffness-scale": "",
    "damping-scale": "",
    "mass-scale": "",
    "stiffness": "N/m",
    "damping": "Ns/m",
    "mass": "kg",
    "forcing-amplitude": "",
    "forcing-phase": "rad",
    "forcing-frequency": "rad/s",
    "constant-force": "N",
    "ground-amplitude": "",
    "ground-phase": "rad",
    "ground-frequency": "rad/s",
    OFFSET: "s",
    LATENCY: "s",
}
"""Kinds of free parameters and their SI units, with coordinates in m; empty for a ratio."""
_OTHER_UNITS = {"clock_error": "s", "clock_offset": "s", "model error": "m/s^1.5"}
"""SI units of other learned quantities of an observer; no entry for a ratio."""
_ONLY_IDENTIFIED = {OFFSET, LATENCY}
"""Kinds that only ``identify`` learns: an observer takes the clock from the model."""
_SCALES = {"stiffness": "K", "damping": "C", "mass": "M"}
_LARGEST_RATIO = 1e3
"""Largest value of a scale; the least value is the inverse."""
_LONGEST = 0.1
"""Largest offset of a clock, s."""
_WRONG_FREQUENCY = 0.1
"""Error that makes a frequency useless, relative to the frequency."""


def is_observed(name: str) -> bool:
    """Whether an observer can learn the parameter of this name."""
    return name.partition(".")[0] not in _ONLY_IDENTIFIED


def is_phase(name: str) -> bool:
    """Whether the parameter of this name is a phase: any number of turns is the same."""
    return name.partition(".")[0].endswith("-phase")


def parametric_family(
    system: System,
    wanted: Sequence[str],
    elements: Sequence[Element] = (),
    *,
    observed: bool = False,
) -> ParametricFamily:
    """The family of systems that differ from ``system`` in the ``wanted`` parameters.

    A name such as ``restitution`` means the restitution of every contact, and ``gap.stop`` means
    the gap of the contact ``stop``. The values of ``elements`` can be free, too. With ``observed``
    only parameters that an observer can learn are known.

    Raises:
        UsageError: a name is unknown or given twice, or two names exclude each other.
    """
    available = {
        each.name: each
        for each in _all(system, elements)
        if not observed or is_observed(each.name)
    }
    names: list[str] = []
    for name in wanted:
        matches = [each for each in available if each == name or each.startswith(f"{name}.")]
        if not matches:
            raise UsageError(_unknown(name, available, elements, observed=observed))
        names.extend(matches)
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"parameter {name!r}: found twice; name it once")
    if system.frame is not None:
        for name in names:
            if name.partition("-")[0].partition(".")[0] in _SCALES:
                raise UsageError(
                    f"parameter {name!r}: changes what moving grounds do to the bodies, too;"
                    " expected restitution, gap, ground-amplitude or another that does not"
                )
    for one, other in combinations(sorted({name.partition(".")[0] for name in names}), 2):
        if other == f"{one}-scale":
            raise UsageError(f"parameter {other!r}: stands beside {one}; name one of them")
    return ParametricFamily(system, tuple(available[name] for name in names))


def parameters_beside(family: ParametricFamily) -> tuple[ModelParameter, ...]:
    """What could be free beside the parameters of ``family``, elements apart.

    A scale does not stand beside the parts of its matrix.
    """
    kinds = {name.partition(".")[0] for name in family.names}
    is_framed, is_sampled = family.system.frame is not None, family.system.forcing.sampled
    return tuple(
        each
        for each in _all(family.system, ())
        if each.name not in family.names
        and not (each.name.endswith("-scale") and (is_framed or each.name[:-6] in kinds))
        and not (each.name == OFFSET and is_sampled is not None)
        and not (each.name.startswith(LATENCY) and family.system.m == 1)  # as the offset
    )


def _unknown(
    name: str, available: Collection[str], elements: Sequence[Element], *, observed: bool
) -> str:
    """The error text for a ``name`` that no parameter of the model has, or none ``observed``."""
    if observed and not is_observed(name):
        return (
            f"parameter {name!r}: an observer takes clocks as the model has them; identify it"
            " first (identify --free), and give the model that this writes"
        )
    meant = ""
    if not elements and name.partition(".")[0] in _SCALES:
        meant = "of a model with bodies and springs give elements=model.elements, too; "
    return (
        f"parameter {name!r}: this model has none; {meant}expected some of"
        f" {', '.join(available)}; or all of a kind, such as restitution"
    )


def with_unit(name: str, coordinates: str) -> str:
    """The name of an estimated parameter in words, with its unit.

    Args:
        name: of the parameter.
        coordinates: unit of the coordinates, as ``System.unit``.
    """
    unit = UNITS.get(name.partition(".")[0], _OTHER_UNITS.get(name, ""))
    unit = unit_of(unit, coordinates)
    words = name.replace("_", " ")
    return f"{words} [{unit}]" if unit else words


_RATIO, _FREE = (1 / _LARGEST_RATIO, _LARGEST_RATIO), (-np.inf, np.inf)
"""Bounds of a ratio, and of a number of any size."""


def _parameter(
    system: System,
    name: str,
    value: float,
    bounds: tuple[float, float],
    size: float,
    **change: Matrix,
) -> ModelParameter:
    unit = unit_of(UNITS[name.partition(".")[0]], system.unit)
    effect = Coefficients.change(system, **change)
    return ModelParameter(name, value, *bounds, size, unit, effect)


def _all(system: System, elements: Sequence[Element]) -> Iterator[ModelParameter]:
    parameter = partial(_parameter, system)
    columns = np.eye(Coefficients.of_system(system).rebound.shape[1])
    for contact, law, one in zip(system.contacts, system.rebounds, np.eye(system.m), strict=True):
        name, gap = contact.name, contact.gap
        for each, column in zip(law.parameters, columns, strict=False):
            own, bounds = f"{each.kind}.{name}", (each.low, each.high)
            change = np.outer(one, column)
            yield parameter(own, each.value, bounds, each.size, rebound=change)
        yield parameter(f"gap.{name}", gap, _FREE, abs(gap) or 1.0, gap=one)
    for kind, part in _SCALES.items():
        if np.any(whole := getattr(system, part)):
            yield parameter(f"{kind}-scale", 1.0, _RATIO, 1.0, **{part: whole})
    for element in elements:
        kind, value = element.kind, element.value
        least = value / _LARGEST_RATIO if kind == "mass" else 0.0
        effect = {_SCALES[kind]: element.matrix}
        yield parameter(f"{kind}.{element.label}", value, (least, np.inf), value, **effect)
    yield from _of_forcing(system)
    # Stamps that are late by an offset have the effect of a forcing that lags by the offset.
    lag = -system.forcing.frequency
    yield parameter(OFFSET, 0.0, (-_LONGEST, _LONGEST), _LONGEST, phase=lag)
    for name in system.contact_names:  # beyond the latency that a model declares
        yield parameter(f"{LATENCY}.{name}", 0.0, (-_LONGEST, _LONGEST), _LONGEST)


def _of_forcing(system: System) -> Iterator[ModelParameter]:
    """The constant force on each coordinate, and what changes each harmonic."""
    force, parameter = _usual_force(system), partial(_parameter, system)
    for name, value, one in zip(
        system.coordinates, system.forcing.constant.tolist(), np.eye(system.n), strict=True
    ):
        yield parameter(f"constant-force.{name}", value, _FREE, force, constant=one)
    frequencies = system.forcing.frequency.tolist()
    ones = np.eye(len(frequencies))
    for label, one, omega in zip(_harmonics(system), ones, frequencies, strict=True):
        kind, _, number = label.partition(".")
        yield parameter(f"{kind}-amplitude.{number}", 1.0, _RATIO, 1.0, amplitude=one)
        yield parameter(f"{kind}-phase.{number}", 0.0, _FREE, np.pi, phase=one)
        own = f"{kind}-frequency.{number}"
        bounds = omega * _RATIO[0], omega * _RATIO[1]
        yield parameter(own, omega, bounds, _WRONG_FREQUENCY * omega, frequency=one)


def _usual_force(system: System) -> float:
    """The largest force of the forcing, or of springs that reach a stop, N; 1 without any."""
    forcing, W = system.forcing, system.W
    swing = np.sum(np.abs(forcing.cosine) + np.abs(forcing.sine), axis=0)
    at_stops = system.K @ (W * system.q_r / np.sum(W**2, axis=0))
    sizes = np.concatenate([np.abs(forcing.constant), swing, np.abs(at_stops).ravel()])
    return float(np.max(sizes)) or 1.0


def _harmonics(system: System) -> Iterator[str]:
    """Names of the harmonics: ``forcing.1`` and so on, then ``ground.table.1`` and so on."""
    frame = system.frame
    own = system.forcing.frequency.size if frame is None else frame.forcing.frequency.size
    yield from (f"forcing.{k + 1}" for k in range(own))
    if frame is not None:
        owner, names = frame.grounds.owner, frame.grounds.names
        for k, ground in enumerate(owner):
            yield f"ground.{names[ground]}.{owner[: k + 1].count(ground)}"
