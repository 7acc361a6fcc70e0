# SPDX-License-Identifier: Apache-2.0
"""The linearisation of flights and jumps, against differences, quadrature and exact motions."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate

from impact_observer.dynamics import Phases
from impact_observer.dynamics.tangent import Tangent
from impact_observer.model import parse_model, read_model
from impact_observer.model.free_parameters import parameters_beside, parametric_family
from impact_observer.model.parametric_family import ParametricFamily

_STEP = 3e-6
_MASS = """
name: t
bodies: [{name: x, mass: 0.2}]
springs: [{between: [ground, x], stiffness: 30, damping: 0.1}]
"""
_SHAKEN = f"""{_MASS}
forces: [{{body: x, amplitude: 1.0, frequency: 7.0}}]
grounds: [{{name: table, motion: {{harmonics: [{{amplitude: 0.003, frequency: 62.8}}]}}}}]
stops: [{{name: s, between: [table, x], gap: 0.01, restitution: 0.5}}]
"""
_SQUARE = f"""{_MASS}
forces: [{{body: x, shape: square, amplitude: 5.0, frequency: 9.0}}]
stops: [{{name: s, body: x, limit: 0.1, side: above, restitution: 0.5}}]
"""
_T, _S = np.array([0.0, 0.7, 1.9, 40.0]), np.array([0.31, 0.0, -0.05, 2.4])


def _family(name: str) -> ParametricFamily:
    model = read_model(name)
    none = parametric_family(model.system, (), model.elements)
    return none.extended(parameters_beside(none))


def _states(n: int, count: int = 4) -> NDArray[np.float64]:
    return np.random.default_rng(1).normal(size=(count, 2 * n))


@pytest.fixture(params=["two_mass", "three_mass", "bouncing_ball", "shaken_table"])
def family(request: pytest.FixtureRequest) -> ParametricFamily:
    """Return a family in which all that can be free is free."""
    if request.param != "shaken_table":
        return _family(request.param)
    model = parse_model(_SHAKEN, "shaken")
    none = parametric_family(model.system, ())
    scales = "mass", "stiffness", "damping"  # these change the effect of a ground, too
    return none.extended(
        each for each in parameters_beside(none) if not each.name.startswith(scales)
    )


def test_flights_are_those_of_the_phase(family: ParametricFamily) -> None:
    """Flights of any sign are those of the exact flow."""
    tangent, x = Tangent(family), _states(family.system.n)
    phase = Phases(family.system).phase()
    moved = tangent.flights(_T.tolist(), _S, ()).of(x)
    for k, (t, s) in enumerate(zip(_T.tolist(), _S.tolist(), strict=True)):
        begin, end = (x[k], moved[k]) if s >= 0 else (moved[k], x[k])
        found, Phi = phase.flow.start(min(t, t + s), begin).state(abs(s)), phase.transition(s)
        np.testing.assert_allclose(found, end, rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(
            tangent.flights([t], np.array([s]), ()).Phi[0], Phi, rtol=1e-11, atol=1e-12
        )


def test_derivatives_by_all_parameters_are_differences(family: ParametricFamily) -> None:
    """Flights, impacts and rates have the derivatives of central differences."""
    tangent, x = Tangent(family), _states(family.system.n)
    own = tangent.flights(_T.tolist(), _S, ()).Gamma(x)
    hit = tangent.impact(x, (0,))
    rates = tangent.by_rates([40.0], x, ())
    for j, each in enumerate(family.parameters):
        beside = []
        for sign in (1, -1):
            theta = family.nominal.copy()
            theta[j] += sign * _STEP * each.size
            other = Tangent(family, theta)
            beside.append(
                (
                    other.flights(_T.tolist(), _S, ()).of(x),
                    other.impact(x, (0,)).x,
                    other.rates([40.0], x, ())[0],
                )
            )
        for mine, more, less in zip((own, hit.Gamma, rates), *beside, strict=True):
            expected = (more - less) / (2 * _STEP * each.size)
            size = max(np.abs(expected).max(), 1e-3 * np.abs(more).max() / each.size)
            np.testing.assert_allclose(mine[..., j], expected, atol=1e-6 * size, err_msg=each.name)


def test_impact_and_rest_have_the_derivatives_of_differences(family: ParametricFamily) -> None:
    """Jumps have the derivatives by states of central differences."""
    tangent, x = Tangent(family), _states(family.system.n)
    d = x.shape[-1]
    for jump in (tangent.impact, tangent.rest):
        own = jump(x, (0,))
        for i, one in enumerate(np.eye(d)):
            change = (jump(x + 1e-6 * one, (0,)).x - jump(x - 1e-6 * one, (0,)).x) / 2e-6
            np.testing.assert_allclose(own.Phi[..., i], change, atol=1e-8)


def test_held_flights_keep_gap_and_rest() -> None:
    """Contacts that are held keep their gaps and have no speed."""
    family = _family("three_mass")
    tangent, held = Tangent(family), (0,)
    x = tangent.rest(_states(3), held).x
    W = family.system.W[:, 0]
    moved = tangent.flights(_T.tolist(), _S, held).of(x)
    np.testing.assert_allclose(moved[:, :3] @ W, x[:, :3] @ W, atol=1e-12)
    np.testing.assert_allclose(moved[:, 3:] @ W, 0.0, atol=1e-12)


def test_noise_is_the_integral_of_the_transitions() -> None:
    """Roots of process noise are those of a quadrature of the transitions."""
    family = _family("two_mass")
    tangent, intensity = Tangent(family), (0.3, 1.7)
    for s in (0.013, 1.9, 14.0):

        def rate(r: float) -> NDArray[np.float64]:
            by = tangent.flights([0.0], np.array([r]), ()).Phi[0][:, 2:] * np.array(intensity)
            return np.asarray((by @ by.T).ravel())

        expected = integrate.quad_vec(rate, 0.0, s, epsabs=1e-12)[0].reshape(4, 4)
        root = tangent.noise(np.array([s]), (), intensity)[0]
        np.testing.assert_allclose(root @ root.T, expected, rtol=1e-7, atol=1e-11)


def test_flights_through_square_waves_are_those_of_the_phase() -> None:
    """Flights are composed at the switches of a square wave."""
    system = parse_model(_SQUARE, "square").system
    family = parametric_family(system, ("stiffness-scale",))
    tangent, x = Tangent(family), _states(1, 1)[0]
    s = np.array([0.1, 0.5, 3.0])  # before a switch, beyond one, beyond many
    maps = tangent.flights([0.2], s, ())
    expected = Phases(system).phase().start(0.2, x).states(s)
    np.testing.assert_allclose(maps.of(x), expected, rtol=1e-11)
    more, less = (
        Tangent(family, np.array([1 + e])).flights([0.2], s, ()).of(x) for e in (1e-5, -1e-5)
    )
    np.testing.assert_allclose(maps.Gamma(x)[..., 0], (more - less) / 2e-5, rtol=1e-6)
