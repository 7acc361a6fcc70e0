# SPDX-License-Identifier: Apache-2.0
"""Families of systems: what each parameter changes, against differences of two systems."""

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.dynamics import Phases
from impact_observer.dynamics.tangent import Tangent
from impact_observer.model import parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parametric_family import ParametricFamily

SHAKEN = """
name: shaken
bodies: [{name: a, mass: 2}, {name: b, mass: 1}]
grounds:
  - {name: table, motion: {harmonics: [{amplitude: 0.01, frequency: 6, phase: 0.4},
                                       {amplitude: 0.003, frequency: 11}]}}
springs:
  - {between: [table, a], stiffness: 50, damping: 0.7}
  - {between: [a, b], stiffness: 40, damping: 0.3}
forces: [{body: b, amplitude: 4, frequency: 2.5, phase: 0.2}, {body: a, constant: 1.5}]
stops: [{name: stop, between: [table, b], gap: 0.1, restitution: 0.6}]
"""
Array = NDArray[np.float64]
OF_FORCES = ("constant-force", "forcing-amplitude", "forcing-phase", "forcing-frequency")
OF_GROUNDS = ("ground-amplitude", "ground-phase", "ground-frequency")


def force_changes(family: ParametricFamily, values: Array, t: float) -> Array:
    """Derivative of the force at ``t``, s since the epoch, by each parameter, shape (p, n)."""
    coefficients = family.coefficients_at(values)
    amplitudes, by_parameter = family.harmonics(coefficients)
    wave = np.exp(1j * coefficients.frequency * t)
    changes = [
        (wave @ by + (wave * (1j * t * each.effect.frequency)) @ amplitudes).real
        + each.effect.constant
        for by, each in zip(by_parameter, family.parameters, strict=True)
    ]
    return np.array(changes)


def assert_forces_change_as_systems_beside(family: ParametricFamily, share: float) -> None:
    """Central differences, at values off the model's by a ``share`` of their sizes."""
    values = family.nominal + share * family.sizes
    for t in (0.0, 3.7):
        exact = force_changes(family, values, t)
        for j, size in enumerate(family.sizes.tolist()):
            step = 1e-5 * size * np.eye(family.size)[j]
            more, less = (family.system_at(values + each).forcing(t) for each in (step, -step))
            slope = (more - less) / (2e-5 * size)
            np.testing.assert_allclose(exact[j], slope, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("kind", [*OF_FORCES, *OF_GROUNDS])
@pytest.mark.parametrize("share", [0.0, 0.02])
def test_the_force_changes_as_that_of_systems_beside(kind: str, share: float) -> None:
    """Central differences, at the model's values and at others, with a ground that moves."""
    system = parse_model(SHAKEN, "shaken").system
    assert_forces_change_as_systems_beside(parametric_family(system, [kind]), share)


def test_the_parameters_of_a_ground_change_a_flight_as_systems_beside() -> None:
    """The derivative of a motion of three seconds, late after the epoch, by differences."""
    family = parametric_family(parse_model(SHAKEN, "shaken").system, OF_GROUNDS)
    x, t, s = np.array([0.02, -0.01, 0.1, 0.3]), 20.0, 3.0
    exact = Tangent(family).flights([t], np.array([s]), ()).Gamma(x)[0]
    for j, size in enumerate(family.sizes.tolist()):
        step, ends = 1e-6 * size, []
        for sign in (1, -1):
            other = family.system_at(family.nominal + sign * step * np.eye(family.size)[j])
            ends.append(Phases(other).phase(()).flow.start(t, x).state(s))
        slope = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(exact[:, j], slope, rtol=1e-6, atol=1e-8)


def test_a_ground_of_another_frequency_is_that_of_another_model() -> None:
    """The system that the family makes, and the file with the other number."""
    text = SHAKEN.replace("frequency: 6,", "frequency: 6.3,")
    family = parametric_family(parse_model(SHAKEN, "shaken").system, ["ground-frequency.table.1"])
    made, wanted = family.system_at(np.array([6.3])), parse_model(text, "other").system
    ns = np.array([0, 1_700_000_000])
    np.testing.assert_allclose(made.forcing(1.7), wanted.forcing(1.7), rtol=1e-12)
    np.testing.assert_allclose(
        made.from_frame(ns, np.zeros((2, 4))), wanted.from_frame(ns, np.zeros((2, 4))), rtol=1e-12
    )
