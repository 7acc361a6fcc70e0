# SPDX-License-Identifier: Apache-2.0
"""Flows of ill-conditioned systems over periods of the slowest mode.

Errors are measured in the energy norm, relative to the larger of the state now and at the start.
No method that rounds its matrices can do better than ``eps omega t`` for the fastest mode that
moves.
"""

import numpy as np
import precise
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse.linalg import expm_multiply
from systems import (
    Harmonic,
    chain,
    examples,
    flow_of,
    forcing,
    numbers,
    state_matrix,
    system,
    systems,
    vectors,
)

from impact_observer.model import Forcing, System

Array = NDArray[np.float64]

PERIOD = 2 * np.pi
SECONDS = np.array([1e-6, 0.3, PERIOD, 10 * PERIOD, 100 * PERIOD])
DISTANCES = [sign * 10.0**-k for k in (1, 4, 8, 14) for sign in (1, -1)]
WAVE = Harmonic(0.7, [1.0, 0.0], [0.0, 1.0])


def energy(model: System, x: Array) -> Array:
    """Square root of twice the energy of states, shape (..., 2n)."""
    q, u = x[..., : model.n], x[..., model.n :]
    kinetic = np.einsum("...i,ij,...j->...", u, model.M, u)
    return np.asarray(np.sqrt(kinetic + np.einsum("...i,ij,...j->...", q, model.K, q)))


def error(model: System, x: Array, seconds: Array, t: float = 0.0) -> float:
    """Largest relative error in the energy norm, against ninety digits."""
    expected = precise.flow(model, t, x, seconds.tolist())
    found = flow_of(model).start(t, x).states(seconds)
    scale = np.maximum(energy(model, expected), energy(model, x))
    return float(np.max(energy(model, found - expected) / scale))


@pytest.mark.parametrize("distance", DISTANCES)
def test_nearly_critical_mode_stays_exact(distance: float) -> None:
    """Both eigenvalues meet like the root of the distance."""
    force = forcing(1, 1.0, [Harmonic(0.7, [1.0], [0.5])])
    model = system(1, 2 * (1 + distance), 1, force=force)
    assert error(model, np.array([1.0, -0.7]), SECONDS) < 1e-13


@pytest.mark.parametrize(
    "distance",
    [
        pytest.param(each, marks=pytest.mark.slow if k % 3 else ())
        for k, each in enumerate(DISTANCES)
    ],
)
def test_nearly_defective_system_stays_exact(distance: float) -> None:
    """At distance 0 two pairs share one eigenvector."""
    model = system(
        np.eye(2),
        np.diag([1 + distance, 0.0]),
        [[1.25, 0.5], [0.5, 1.0]],
        force=forcing(2, 1.0, [WAVE]),
    )
    assert error(model, np.array([1.0, 0.5, -0.3, 0.2]), SECONDS) < 3e-12


@pytest.mark.parametrize("distance", [0.0, *DISTANCES])
def test_resonance_with_an_undamped_mode_stays_exact(distance: float) -> None:
    """Driven at its own frequency or beside it, with a constant load on top."""
    force = forcing(1, 1.0, [Harmonic(1 + distance, [1.0], [0.5])])
    assert error(system(1, 0, 1, force=force), np.array([1.0, -0.7]), SECONDS, 0.4) < 1e-11


@pytest.mark.parametrize("stiffness", [1e-14, 1e-8, 1e-4, 1e-2, 0.3])
def test_load_on_a_soft_spring_stays_exact_while_the_motion_is_young(stiffness: float) -> None:
    """The deflection it will reach is far larger than the motion, and must not matter yet."""
    force = forcing(1, 1.0, [Harmonic(0.01, [1.0], [0.5])])
    model = system(1, 0, stiffness, force=force)
    seconds, x = np.array([1e-6, 1e-3, 0.1, 1.0, 5.0]), np.array([0.1, -0.2])
    expected = precise.flow(model, 0.3, x, seconds.tolist())
    found = flow_of(model).start(0.3, x).states(seconds)
    scale = np.maximum(np.max(np.abs(expected), axis=1), 0.1)
    assert np.max(np.abs(found - expected) / scale[:, None]) < 3e-14


TURN = np.array([[0.6, 0.8], [-0.8, 0.6]])
STIFF = {
    "in a chain": np.array([[1.0 + 1e8, -1e8], [-1e8, 1e8]]),
    "turned": TURN @ np.diag([1.0, 1e8]) @ TURN.T,
}
DAMPERS = {
    "undamped": np.zeros((2, 2)),
    "not proportional": np.diag([0.1, 0.0]),
    "overdamped": np.diag([0.1, 1e4]),
}


@pytest.mark.slow
@pytest.mark.parametrize("C", DAMPERS.values(), ids=list(DAMPERS))
@pytest.mark.parametrize("K", STIFF.values(), ids=list(STIFF))
def test_stiffness_ratio_of_a_hundred_million(K: Array, C: Array) -> None:
    """The fast mode turns 6e4 rad meanwhile."""
    model = system(np.eye(2), C, (K + K.T) / 2, force=forcing(2, 1.0, [WAVE]))
    x = np.array([1.0, 0.5, -0.3, 0.2])
    assert error(model, x, SECONDS[:3]) < 1e-10


@pytest.mark.parametrize("C", [np.zeros((2, 2)), [[1e-3, 0.0], [0.0, 0.0]]], ids=["C=0", "damped"])
@pytest.mark.parametrize("ratio", [1e2, 1e4, 1e6])
def test_slow_motion_beside_a_stiff_spring_keeps_its_digits(ratio: float, C: Array) -> None:
    """Two masses that move together on a soft spring: the stiff one takes few digits away."""
    model = system(np.eye(2), C, [[1.0 + ratio, -ratio], [-ratio, ratio]])
    assert error(model, np.array([1.0, 1.0, -0.3, -0.3]), 1.4 * SECONDS[:3]) < 1e-9


@pytest.mark.parametrize("n", [1, 2, 40, 300])
def test_chain_of_any_length_moves_as_in_its_closed_form_modes(n: int) -> None:
    """``sin(i k pi / (n+1))`` with ``omega_k = 2 sqrt(k/m) sin(k pi / (2n+2))``, each damped."""
    model = chain(n, stiffness=10.0, damping=0.05)
    k = np.arange(1, n + 1)
    shapes = np.sqrt(2 / (n + 1)) * np.sin(np.outer(k, k) * np.pi / (n + 1))
    square = 4 * np.sin(k * np.pi / (2 * n + 2)) ** 2
    a, omega = -0.05 * square / 2, np.sqrt(10 * square - (0.05 * square / 2) ** 2)
    x = np.random.default_rng(n).normal(size=2 * n)
    seconds = np.array([0.0, 0.1, 3.0, min(100 * PERIOD / omega[0], 1e4 / n)])
    found = flow_of(model).start(1.0, x).states(seconds)
    q, u = shapes @ x[:n], shapes @ x[n:]
    for s, state in zip(seconds, found, strict=True):
        c, sine, decay = np.cos(omega * s), np.sin(omega * s), np.exp(a * s)
        position = decay * (q * c + (u - a * q) / omega * sine)
        velocity = decay * (u * c + (a * u - (a**2 + omega**2) * q) / omega * sine)
        expected = np.concatenate([shapes @ position, shapes @ velocity])
        assert energy(model, state - expected) < 2e-12 * energy(model, x)


@pytest.mark.slow
def test_flow_of_three_hundred_coordinates_not_proportionally_damped() -> None:
    """Against a Taylor method that multiplies with the state matrix only."""
    n = 300
    C = np.diag(np.random.default_rng(1).uniform(0.0, 0.2, size=n))
    bare = chain(n, stiffness=10.0)
    model = system(bare.M, C, bare.K, force=forcing(n, 0.5))
    augmented = np.zeros((2 * n + 1, 2 * n + 1))
    augmented[: 2 * n, : 2 * n] = state_matrix(model)
    augmented[n : 2 * n, -1] = 0.5
    x = np.random.default_rng(2).normal(size=2 * n)
    expected = expm_multiply(5.0 * augmented, np.concatenate([x, [1.0]]))[: 2 * n]
    found = flow_of(model).start(0.0, x).state(5.0)
    assert energy(model, found - expected) < 1e-11 * energy(model, x)


def faster(model: System, factor: float) -> System:
    """``model`` with all rates times ``factor``."""
    f = model.forcing
    square = factor * factor
    scaled = Forcing(f.constant * square, f.frequency * factor, f.cosine * square, f.sine * square)
    return system(model.M, model.C * factor, model.K * square, force=scaled)


@pytest.mark.parametrize("factor", [1e6, pytest.param(1e-4, marks=pytest.mark.slow)])
@examples(30)
@given(data=st.data())
def test_unit_of_time_does_not_change_the_motion(factor: float, data: st.DataObject) -> None:
    """Rates of 1e6 1/s or 1e-4 1/s are as good as those of 1 1/s: there is no unit of time."""
    model = data.draw(systems(contacts=(0, 0)))
    x, t = data.draw(vectors(2 * model.n)), data.draw(numbers(0.0, 4.0))
    quick = faster(model, factor)
    unit = np.repeat([1.0, factor], model.n)
    s = np.array([0.0, 1e-6, 0.1, 1.0, 7.0])
    slow_states = flow_of(model).start(t, x).states(s)
    quick_states = flow_of(quick).start(t / factor, x * unit).states(s / factor) / unit
    scale = max(1.0, float(np.max(np.abs(slow_states))))
    assert np.max(np.abs(quick_states - slow_states)) < 3e-12 * scale


def test_free_bodies_with_coupled_damping_keep_their_digits() -> None:
    """No springs, weak dampers of very different size between all: any frame is a rigid one."""
    rng = np.random.default_rng(1)
    mass, dampers = rng.normal(size=(4, 4)), rng.normal(size=(4, 4)) * [1.0, 1e-2, 1e-3, 0.0]
    C = 1e-2 * dampers @ dampers.T
    model = system(mass @ mass.T + np.eye(4), C, np.zeros((4, 4)))
    x = rng.normal(size=8)
    moving = flow_of(model).start(0.0, x)
    np.testing.assert_allclose(moving.state(0.0), x, rtol=0, atol=1e-14)
    # Impulse: M du = -C dq holds over any time.
    later = moving.state(50.0)
    np.testing.assert_allclose(
        model.M @ (later[4:] - x[4:]), -C @ (later[:4] - x[:4]), rtol=0, atol=1e-12
    )
