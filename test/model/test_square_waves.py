# SPDX-License-Identifier: Apache-2.0
"""Square forces: their instants, and how model files have them."""

import math
from decimal import Decimal, getcontext

import numpy as np
import pytest

from impact_observer.errors import ModelError
from impact_observer.model import Forcing, parse_model
from impact_observer.model.square_waves import SquareWaves
from impact_observer.stamps import NS_PER_S, Elapsed

PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
ELEMENTS = """
name: valve
bodies: [{name: x1, mass: 1}, {name: x2, mass: 2}]
springs: [{between: [ground, x1], stiffness: 10}, {between: [x1, x2], stiffness: 10}]
forces:
  - {body: x1, shape: square, amplitude: 50, hertz: 19, phase: 0.3}
  - {body: x2, amplitude: 4, frequency: 2.5}
stops: [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.7}]
"""
MATRICES = """
name: valve
coordinates: [x1, x2]
mass: [[1, 0], [0, 2]]
damping: [[0, 0], [0, 0]]
stiffness: [[20, -10], [-10, 10]]
forcing:
  harmonics: [{frequency: 2.5, cosine: [0, 4]}]
  squares: [{hertz: 19, phase: 0.3, amplitude: [50, 0]}]
contacts: [{name: stop, direction: [0, -1], gap: 0.5, restitution: 0.7}]
"""


def waves(*rows: tuple[float, float, float]) -> SquareWaves:
    """Waves of frequency, phase and force of one coordinate."""
    return SquareWaves.of_rows([(omega, phase, np.array([size])) for omega, phase, size in rows])


def switch(omega: float, phase: float, k: int) -> Decimal:
    """The switch number ``k``, s since the epoch, to 50 digits."""
    getcontext().prec = 50
    return (PI / 2 + k * PI - Decimal(phase)) / Decimal(omega)


@pytest.mark.parametrize("phase", [0.0, -2.0, 1.2, 50.0])
@pytest.mark.parametrize("omega", [0.7, 2 * math.pi * 19, 31_415.9])
def test_switches_are_exact_after_a_day(omega: float, phase: float) -> None:
    """To a thousandth of a nanosecond, relative to a time that is itself exact."""
    day = Elapsed(86_400 * NS_PER_S + 17, 3e-10)
    exact = Decimal(day.ns) / NS_PER_S + Decimal(day.remainder)
    found = waves((omega, phase, 1.0)).switches(day, 20 / omega)
    first = math.ceil((exact * Decimal(omega) + Decimal(phase)) / PI - Decimal("0.5"))
    expected = [float(switch(omega, phase, first + j) - exact) for j in range(found.size)]
    assert found.size in (6, 7)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_a_square_wave_is_the_sign_of_the_cosine() -> None:
    """Between its switches; two waves add up, and derivatives are zero."""
    rows = [(3.0, 0.4, 2.0), (7.0, -1.0, 0.5)]
    force = Forcing(
        np.array([1.0]), np.zeros(0), np.zeros((0, 1)), np.zeros((0, 1)), squares=waves(*rows)
    )
    t = np.linspace(-5.0, 20.0, 997)
    expected = 1.0 + sum(size * np.sign(np.cos(w * t + phase)) for w, phase, size in rows)
    found = force.derivatives(t, 2)
    np.testing.assert_array_equal(found[0, :, 0], expected)
    assert not np.any(found[1:])
    assert force.depends_on_time
    bound = force.bound(np.eye(1))
    assert bound(0, t[:1]) == pytest.approx(3.5)
    assert bound(1, t[:1]) == 0.0


def test_at_a_switch_the_force_is_that_after_it() -> None:
    """Also where the instant was rounded; the knots are the switches inside."""
    none = np.zeros((0, 1))
    force = Forcing(np.zeros(1), np.zeros(0), none, none, squares=waves((2.0, 0.0, 1.0)))
    first = math.pi / 4
    for t in (first, np.nextafter(first, 0), np.nextafter(first, 1)):
        assert force(float(t)).tolist() == [-1.0]
        assert force.knots(float(t), 5.0) == pytest.approx([3 * first, 5 * first])
    assert force(first - 1e-11).tolist() == [1.0]


def test_both_forms_have_the_same_wave() -> None:
    """With ``hertz`` or ``frequency``, beside harmonics; written models read back the same."""
    for text in (ELEMENTS, MATRICES, ELEMENTS.replace("hertz: 19", f"frequency: {math.tau * 19}")):
        model = parse_model(text, "model")
        for each in (model, parse_model(model.text(), "written")):
            forcing = each.system.forcing
            assert forcing.squares is not None
            assert forcing.squares.frequency.tolist() == [math.tau * 19]
            assert forcing.squares.phase.tolist() == [0.3]
            assert forcing.squares.force.tolist() == [[50, 0]]
            assert forcing.frequency.tolist() == [2.5]
            assert forcing.cosine.tolist() == [[0, 4]]


def test_a_deviation_of_another_force_stays_with_it() -> None:
    """Numbers of harmonics do not count square forces."""
    text = ELEMENTS.replace("amplitude: 4", "amplitude: {value: 4, deviation: 0.1}")
    known = parse_model(text, "model").uncertainty
    assert known is not None
    assert known.names == ("forcing-amplitude.1",)


def test_waves_of_a_system_of_another_size_are_refused() -> None:
    """The forcing has a force of each coordinate."""
    zero = np.zeros((0, 2))
    with pytest.raises(ModelError, match=r"forcing.squares.amplitude: .*expected 2"):
        Forcing(np.zeros(2), np.zeros(0), zero, zero, squares=waves((1.0, 0.0, 1.0))).checked(2)
