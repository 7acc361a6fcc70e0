# SPDX-License-Identifier: Apache-2.0
"""Flow under sampled forcing, against arithmetic that shares nothing with it."""

import numpy as np
import precise
import pytest
from numpy.typing import ArrayLike, NDArray
from systems import LAPLACIAN, chain, flow_of, forcing, sample, system

from impact_observer.errors import DynamicsError
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples

Array = NDArray[np.float64]

HOLDS = ("previous", "linear")
UNEVEN = np.array([-0.5, -0.2, 0.3, 0.35, 1.1, 3.0])
EVEN = np.linspace(-0.3, 2.7, 11)
FINE = np.linspace(-0.05, 1.95, 41)
WITHOUT = {
    "three_mass": sample("three_mass").system,
    "ball": sample("bouncing_ball").system,
    "not proportional": system(
        np.diag([1, 2, 3]), np.diag([0.3, 0, 0.7]), 9 * LAPLACIAN + np.eye(3)
    ),
    "not proportional, overdamped": system(np.eye(2), [[9, 1], [1, 3]], [[2, 0.5], [0.5, 1]]),
    "rigid": system(np.diag([1, 2, 3]), 0.1 * LAPLACIAN, 4 * LAPLACIAN),
    "no stiffness": system(np.eye(2), np.diag([0, 3.0]), np.zeros((2, 2))),
    "critical": system(np.eye(2), np.diag([2.0, 4]), np.diag([1.0, 4])),
    "overdamped": system(1, 20, 1),
    "stiff": system(np.eye(2), np.zeros((2, 2)), np.diag([1.0, 1e4])),
    "defective": system(np.eye(2), np.diag([1.0, 0.0]), [[1.25, 0.5], [0.5, 1.0]]),
}


def forced(base: System, time: ArrayLike, force: ArrayLike, hold: str) -> System:
    """``base`` under samples instead of its own forcing."""
    samples = Samples(np.asarray(time, float), np.asarray(force, float), hold)
    return system(base.M, base.C, base.K, force=Forcing.of_samples(samples))


def noise(n: int, time: Array) -> Array:
    """Random forces."""
    return np.random.default_rng(n).normal(size=(time.size, n))


def energy(model: System, x: Array) -> Array:
    """Square root of twice the energy of states, shape (samples, 2n)."""
    q, u = x[:, : model.n], x[:, model.n :]
    twice = np.einsum("si,ij,sj->s", u, model.M, u) + np.einsum("si,ij,sj->s", q, model.K, q)
    return np.asarray(np.sqrt(twice))


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize(
    "time",
    [UNEVEN, pytest.param(EVEN, marks=pytest.mark.slow), FINE],
    ids=["uneven", "even", "fine"],
)
@pytest.mark.parametrize(
    "base",
    [
        pytest.param(base, marks=pytest.mark.slow if k % 3 else (), id=name)
        for k, (name, base) in enumerate(WITHOUT.items())
    ],
)
def test_flow_is_exact_between_samples_and_across_them(
    base: System, time: Array, hold: str
) -> None:
    """Against the power series in 90 digits, begun between two samples and at one."""
    model = forced(base, time, noise(base.n, time), hold)
    x = np.linspace(1.0, -0.7, 2 * base.n)
    seconds = np.array([0.0, 1e-9, 0.07, 0.3, 1.5])
    for t in (0.11, float(time[2])):
        expected = precise.flow(model, t, x, seconds.tolist())
        found = flow_of(model).start(t, x).states(seconds)
        scale = max(1.0, *energy(model, expected))
        assert np.max(energy(model, found - expected)) < 3e-14 * scale
        assert np.max(np.abs(found - expected)) < 1e-13 * scale


@pytest.mark.parametrize("omega", [1e-4, 1.0, 1e6])
@pytest.mark.parametrize("hold", HOLDS)
def test_undamped_mode_under_a_step_and_under_a_ramp(omega: float, hold: str) -> None:
    """``(1 - cos ws) / w^2`` and ``(ws - sin ws) / w^3``, at any rate."""
    end = 40.0 / omega
    force = [[0.0], [0.0]] if hold == "linear" else [[1.0], [1.0]]
    force[-1][0] = end if hold == "linear" else 7.0
    model = forced(system(1, 0, omega**2), [0.0, end], force, hold)
    angle = np.array([1e-3, 0.05, 2.0, 11.0, 40.0])
    found = flow_of(model).start(0.0, np.zeros(2)).states(angle / omega)
    if hold == "linear":
        # For small angles by their series; the difference itself would cancel.
        exact = np.where(
            angle < 0.5,
            angle**3 / 6 * (1 - angle**2 / 20 * (1 - angle**2 / 42 * (1 - angle**2 / 72))),
            angle - np.sin(angle),
        )
        np.testing.assert_allclose(found[:, 0], exact / omega**3, rtol=1e-13)
        velocity = 2 * np.sin(angle / 2) ** 2 / omega**2
    else:
        np.testing.assert_allclose(found[:, 0], 2 * np.sin(angle / 2) ** 2 / omega**2, rtol=1e-13)
        velocity = np.sin(angle) / omega
    np.testing.assert_allclose(found[:, 1], velocity, rtol=2e-13)


@pytest.mark.parametrize("hold", HOLDS)
def test_many_short_steps_do_not_drift(hold: str) -> None:
    """A held constant and a straight line do not depend on how finely they are sampled."""
    base = chain(3, damping=0.0)
    ends, constant = np.array([0.0, 60.0]), np.array([1.0, -2.0, 0.5])
    force = np.outer([1.0, 1.0] if hold == "previous" else [0.0, 60.0], constant)
    coarse = forced(base, ends, force, hold)
    many = np.linspace(0.0, 60.0, 3_001)
    per_sample = np.ones(many.size) if hold == "previous" else many
    fine = forced(base, many, np.outer(per_sample, constant), hold)
    x, s = np.arange(6.0), np.linspace(0.0, 60.0, 31)
    once, often = (flow_of(model).start(0.0, x).states(s) for model in (coarse, fine))
    assert np.max(energy(base, once - often)) < 1e-12 * np.max(energy(base, once))


def test_samples_add_to_harmonics_and_a_constant() -> None:
    """The flow is linear in them."""
    base = sample("three_mass").system
    samples = Samples(EVEN, noise(3, EVEN), "linear")
    both = forcing(3, [1, 2, 3]).plus(np.ones(3))
    mixed = Forcing(both.constant, both.frequency, both.cosine, both.sine, samples)
    s, rest = np.linspace(0.0, 2.0, 5), np.zeros(6)

    parts = [
        system(base.M, base.C, base.K, force=force)
        for force in (both, Forcing.of_samples(samples))
    ]
    summed = sum(flow_of(part).start(0.2, rest).states(s) for part in parts)
    whole = system(base.M, base.C, base.K, force=mixed)
    found = flow_of(whole).start(0.2, rest).states(s)
    np.testing.assert_allclose(found, summed, atol=1e-14)


@pytest.mark.parametrize("base", [WITHOUT[name] for name in ("three_mass", "defective")])
def test_requested_instants_do_not_change_a_bit(base: System) -> None:
    """States do not depend on what was asked before, in which order or how much of it."""
    time = np.linspace(0.0, 3.0, 1001)
    flow = flow_of(forced(base, time, noise(base.n, time), "linear"))
    x, s = np.ones(2 * base.n), np.linspace(0.0, 2.5, 50)
    at_once = flow.start(0.3, x)
    backwards, forwards = flow.start(0.3, x), flow.start(0.3, x)
    early = [forwards.state(float(at)) for at in s]
    late = [backwards.state(float(at)) for at in s[::-1]][::-1]
    assert np.array_equal(early, late)
    again = at_once.states(s)
    assert np.array_equal(at_once.states(s), again)
    assert np.array_equal([at_once.state(float(at)) for at in s], early)


@pytest.mark.parametrize("hold", HOLDS)
def test_motion_goes_on_beyond_the_samples(hold: str) -> None:
    """Under the last force, as under a constant; before the first sample is an error."""
    base = chain(2)
    model = forced(base, [0.0, 1.0, 2.0], np.array([[1, 2], [2, -1], [3, 4]]), hold)
    x = np.array([1.0, 0.5, -1, 2])
    motion, s = flow_of(model).start(0.5, x), np.array([1.5, 1.5 + 1e-10, 3.0, 40.0])
    constant = system(base.M, base.C, base.K, force=forcing(2, [3.0, 4.0]))
    after = flow_of(constant).start(2.0, motion.state(1.5)).states(s - 1.5)
    np.testing.assert_allclose(motion.states(s), after, atol=1e-12)
    beyond = flow_of(model).start(2.5, x).states(s)
    np.testing.assert_allclose(beyond, flow_of(constant).start(2.5, x).states(s), atol=1e-12)
    with pytest.raises(DynamicsError, match="the samples begin at t = "):
        flow_of(model).start(-0.1, x)


def test_cubics_are_integrated_exactly() -> None:
    """A free body under ``a + b t + c t^2 + d t^3`` moves with a polynomial of order five."""
    time = np.array([0.0, 2.0, 3.0])
    a, b, c, d = 1.0, -2.0, 3.0, 0.5
    jets = np.zeros((4, 3, 1))
    for k, t in enumerate(time):
        whole = np.polynomial.Polynomial([a, b, c, d])
        jets[:, k, 0] = [whole.deriv(order)(t) if order else whole(t) for order in range(4)]
    force = Forcing.of_samples(Samples.of_jets(time, jets))
    free = system(1, 0, 0, force=force)
    s = np.array([0.3, 1.7, 2.4, 3.0])
    exact = a * s**2 / 2 + b * s**3 / 6 + c * s**4 / 12 + d * s**5 / 20
    found = flow_of(free).start(0.0, np.zeros(2)).states(s)
    np.testing.assert_allclose(found[:, 0], exact, rtol=1e-14)
