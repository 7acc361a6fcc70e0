# SPDX-License-Identifier: Apache-2.0
"""Process noise: the covariance that white accelerations add to a phase."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import integrate
from systems import chain, examples, numbers, system, systems

from impact_observer.dynamics import Phase, Phases
from impact_observer.dynamics.equations import state_matrix
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.process_noise import diffusion, fastest_rate

Array = NDArray[np.float64]


def integrated_noise(phase: Phase, s: float, intensity: float) -> Array:
    """``Q(s)`` by adaptive quadrature of its definition."""
    n = phase.equations.n

    def rate(r: float) -> Array:
        B = phase.transition(r)[:, n:]
        return np.asarray(intensity**2 * B @ B.T)

    return np.asarray(integrate.quad_vec(rate, 0.0, s, epsabs=1e-13, epsrel=1e-12)[0])


@examples(15)
@given(st.data())
def test_noise_is_the_integral_of_its_definition(data: st.DataObject) -> None:
    """Damped, gyroscopic, rigid or not, free and with a contact held."""
    model = data.draw(systems(max_n=3, contacts=(1, 1)))
    phase = Phases(model).phase(data.draw(st.sampled_from([(), (0,)])))
    s = data.draw(numbers(0.0, 4.0))
    found = 0.3 * diffusion(phase, s, fastest_rate(state_matrix(phase.equations)))
    expected = integrated_noise(phase, s, 0.3)
    np.testing.assert_allclose(found @ found.T, expected, atol=1e-10 * (1 + expected.max()))


@examples(15)
@given(st.data())
def test_noise_by_the_kernel_is_the_integral_of_its_definition(data: st.DataObject) -> None:
    """Damped, gyroscopic, rigid or not; forces add nothing."""
    moving = MovingSystem(data.draw(systems(max_n=3, contacts=(1, 1))))
    s = data.draw(numbers(0.0, 4.0))
    found = moving.diffusion(0.0, np.zeros(2 * moving.system.n), (), s)
    assert not np.any(np.triu(found, 1))
    expected = integrated_noise(moving.phase(()), s, 1.0)
    np.testing.assert_allclose(found @ found.T, expected, atol=1e-10 * (1 + expected.max()))


def test_noise_of_a_rigid_body_is_the_textbook_one() -> None:
    """``[[s^3/3, s^2/2], [s^2/2, s]]``, over a nanosecond as over a day."""
    phase = Phases(system(2.0, 0, 0)).phase()
    for s in (1e-9, 1.0, 86400.0):
        found = diffusion(phase, s, fastest_rate(state_matrix(phase.equations)))
        scale = np.array([s, 1.0])
        P = found @ found.T / np.outer(scale, scale) / s
        np.testing.assert_allclose(P, [[1 / 3, 1 / 2], [1 / 2, 1]], rtol=1e-12)


def test_noise_of_stiff_damping_neither_overflows_nor_takes_long() -> None:
    """``c / m = 1e9``: velocities are lost at once, ``E u^2 = w^2 m / (2 c)``."""
    phase = Phases(system(1.0, 1e9, 1.0)).phase()
    found = diffusion(phase, 100.0, fastest_rate(state_matrix(phase.equations)))
    assert np.all(np.isfinite(found))
    assert found[1] @ found[1] == pytest.approx(0.5e-9, rel=1e-6)


def test_no_noise_and_no_time_add_nothing() -> None:
    """The noise is exactly zero."""
    phase = Phases(chain(2)).phase()
    assert not diffusion(phase, 0.0, fastest_rate(state_matrix(phase.equations))).any()
