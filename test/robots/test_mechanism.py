# SPDX-License-Identifier: Apache-2.0
"""What a mechanism answers, of a linear system and of a robot alike, by differences and sums."""

from collections.abc import Callable

import numpy as np
import pytest
from arms import DOUBLE, model_of, wall
from numpy.typing import NDArray

from impact_observer.dynamics import LinearMechanism, Mechanism, mechanism_of
from impact_observer.dynamics.tangent import Tangent
from impact_observer.errors import UsageError
from impact_observer.events import Contacts
from impact_observer.model import read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.multibody import Multibody, multibody_of

pytest.importorskip("pinocchio", reason="not installed: extra robots")
from impact_observer.robots import Robot, RobotMechanism

Array = NDArray[np.float64]
T, S = 0.3, np.array([0.2])
STEP = 3e-6
NAMES = {
    "three_mass": ("stiffness.x1-x2", "damping.x2-x3", "restitution.left"),
    "arm": ("damping.shoulder", "rotor-inertia.elbow", "restitution.wall"),
}


def changed(kind: str, change: Array) -> Mechanism:
    """A mechanism whose parameters differ by ``change``, shape (3,)."""
    if kind == "three_mass":
        model = read_model("three_mass")
        family = parametric_family(model.system, NAMES[kind], model.elements)
        tangent = Tangent(family, family.nominal + change)
        return LinearMechanism(tangent.system, tangent)
    contacts = wall(restitution=0.5, offset=0.25)
    drags = "{shoulder: 0.4, elbow: 0.4}"
    model = model_of(
        DOUBLE, "shoulder, elbow", contacts=contacts, damping=drags, rotor_inertia=drags
    )
    assert model.robot is not None
    values = {
        name: model.robot.parameters[name] + each
        for name, each in zip(NAMES[kind], change.tolist(), strict=True)
    }
    return RobotMechanism(Robot(model.robot.with_parameters(values)), NAMES[kind])


@pytest.fixture(params=[*NAMES])
def kind(request: pytest.FixtureRequest) -> str:
    """Return a linear system or a robot."""
    return str(request.param)


def states(mechanism: Mechanism, held: Contacts = ()) -> Array:
    """Three states in which the contacts ``held`` are closed."""
    x = np.random.default_rng(7).normal(size=(3, 2 * mechanism.system.n)) / 2
    return np.array([mechanism.stopped(each, held) for each in x]) if held else x


def slopes(function: Callable[[Array], Array], size: int) -> Array:
    """Derivatives by central differences at zero, along a last axis."""
    steps = STEP * np.eye(size)
    return np.stack([(function(h) - function(-h)) / (2 * STEP) for h in steps], axis=-1)


@pytest.mark.parametrize("held", [(), (0,)])
def test_flights_have_the_derivatives_of_differences(kind: str, held: Contacts) -> None:
    """By states and by parameters, while contacts are open and while one is closed."""
    mechanism = changed(kind, np.zeros(3))
    x = states(mechanism, held)
    found = mechanism.flown([T], x, S, held)
    by_x = slopes(lambda h: mechanism.flown([T], x + h, S, held).x, x.shape[1])
    by_theta = slopes(lambda h: changed(kind, h).flown([T], x, S, held).x, 3)
    assert np.allclose(np.broadcast_to(found.Phi, by_x.shape), by_x, rtol=1e-6, atol=1e-6)
    assert np.allclose(found.Gamma, by_theta, rtol=1e-6, atol=1e-6)


def test_impacts_have_the_derivatives_of_differences(kind: str) -> None:
    """By states and by parameters; positions stay, and the contact speed turns by its share."""
    mechanism = changed(kind, np.zeros(3))
    x = states(mechanism)
    found = mechanism.impact(x, (0,))
    by_x = slopes(lambda h: mechanism.impact(x + h, (0,)).x, x.shape[1])
    by_theta = slopes(lambda h: changed(kind, h).impact(x, (0,)).x, 3)
    assert np.allclose(found.Phi, by_x, rtol=1e-6, atol=1e-6)
    assert np.allclose(found.Gamma, by_theta, rtol=1e-6, atol=1e-6)
    before, after = mechanism.gaps(x).gamma[:, 0], mechanism.gaps(found.x).gamma[:, 0]
    eps = mechanism.system.rebounds[0].nominal
    assert np.allclose(after, -eps * before)


def test_impact_rates_and_gaps_make_the_derivative_of_a_flow_through_an_impact(kind: str) -> None:
    """Saltation: each state has its own impact and is followed to the same instant."""
    mechanism = changed(kind, np.zeros(3))
    n = mechanism.system.n
    x = mechanism.struck(states(mechanism)[0], (0,), plastic=True)  # on the stop
    W = mechanism.gaps(x).W[0]
    x[n:] -= W * (W @ x[n:] + 1.0) / (W @ W)  # it hits with 1 m/s

    def through(change: Array) -> Array:
        start, s = (x + change)[None], np.zeros(1)
        for _ in range(20):
            before = mechanism.flown([T], start, s, ()).x
            gaps = mechanism.gaps(before)
            s = s - gaps.g[:, 0] / gaps.gamma[:, 0]
        after = mechanism.impact(mechanism.flown([T], start, s, ()).x, (0,)).x
        return np.asarray(mechanism.flown([T + float(s[0])], after, -s, ()).x[0])

    jump = mechanism.impact(x[None], (0,))
    before, after = (mechanism.rates([T], each, ())[0] for each in (x[None], jump.x))
    J, gradient = jump.Phi[0], np.concatenate([W, np.zeros(n)])
    Xi = J + np.outer(after - J @ before, gradient) / mechanism.gaps(x).gamma[0]
    assert np.allclose(slopes(through, 2 * n), Xi, rtol=1e-5, atol=1e-5)


def test_gaps_and_speeds_belong_together(kind: str) -> None:
    """Speeds of contacts are the derivatives of gaps along the motion."""
    mechanism = changed(kind, np.zeros(3))
    x = states(mechanism)
    found = mechanism.gaps(x)
    rates = mechanism.rates([T], x, ())
    rising = (mechanism.gaps(x + STEP * rates).g - mechanism.gaps(x - STEP * rates).g) / 2 / STEP
    assert np.allclose(found.gamma, rising, atol=1e-8)


def test_noise_is_the_sum_of_the_kicks_along_a_flight(kind: str) -> None:
    """The covariance of white accelerations, by a sum over many short parts of the flight."""
    mechanism, parts = changed(kind, np.zeros(3)), 400
    n, x = mechanism.system.n, states(mechanism)[:1]
    intensity = np.linspace(0.5, 1.0, n)
    root = mechanism.noise([T], x, S, (), tuple(intensity.tolist()))[0]
    h, total = S / parts, np.zeros((2 * n, 2 * n))
    kicked = np.zeros((2 * n, 2 * n))
    kicked[n:, n:] = float(h[0]) * np.diag(intensity**2)
    for k in range(parts):
        flight = mechanism.flown([T + k * h[0]], x, h, ())
        half = mechanism.flown([T + k * h[0]], x, h / 2, ()).Phi[0]
        total = flight.Phi[0] @ total @ flight.Phi[0].T + half @ kicked @ half.T
        x = flight.x
    assert np.allclose(root @ root.T, total, rtol=1e-2, atol=1e-5)


def test_loads_hold_a_contact_where_it_is(kind: str) -> None:
    """The accelerations with and without the contact differ by their ``M^-1 W lambda``."""
    mechanism, held = changed(kind, np.zeros(3)), (0,)
    x = states(mechanism, held)
    found, ends = mechanism.loads_along([T], x, np.repeat(S, len(x)), held)
    assert np.all(ends[-1] == S)
    after, n = mechanism.flown([T], x, S, held).x, mechanism.system.n
    stuck, free = (mechanism.rates([T + S[0]], after, each)[:, n:] for each in (held, ()))
    for k, W in enumerate(mechanism.gaps(after).W):
        arm, linear = mechanism.system, read_model("three_mass").system
        M = arm.mass(after[k, :n]) if isinstance(arm, Robot) else linear.M
        assert W[0] * found[-1, 0, k] == pytest.approx(M @ (stuck - free)[k], abs=1e-5)


def test_a_thing_that_is_no_system_has_no_mechanism() -> None:
    """The error names its type."""
    with pytest.raises(UsageError, match="Thing"):
        mechanism_of(type("Thing", (), {})())


@pytest.mark.parametrize("name", ["two_mass", "hammer_arm"])
def test_both_kinds_of_systems_answer_alike(name: str) -> None:
    """Whatever its equations, a system answers in the same shapes."""
    system: Multibody = multibody_of(read_model(name))
    x = np.zeros(2 * system.n)
    assert len(system.state_names) == len(system.state_units) == 2 * system.n
    assert system.contact_speeds(x).shape == (system.m,)
    assert np.array_equal(system.from_frame(np.zeros(1, dtype=np.int64), x[None])[0], x)
    assert isinstance(system.remarks(x[None]), list)
