# SPDX-License-Identifier: Apache-2.0
"""Derivatives of a motion with its impacts, against differences of runs of the plant."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from systems import EPOCH, Harmonic, forcing, run, sample, system

from impact_observer.dynamics import Phases
from impact_observer.events import Kind
from impact_observer.model import System, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S, seconds_between
from impact_observer.trajectory.linearised_system import (
    FlightEnd,
    LinearisedSystem,
)

Array = NDArray[np.float64]
LINEAR = ("restitution", "gap", "stiffness-scale", "damping-scale", "mass-scale")
OF_FORCES = ("forcing-amplitude", "forcing-phase", "forcing-frequency", "constant-force")
CURVED = """
name: curved
bodies: [{name: x1, mass: 1}, {name: x2, mass: 2}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 20, damping: 0.2}
forces: [{body: x2, amplitude: 4, frequency: 2.5}]
stops:
  - {name: above, body: x2, limit: 0.2, side: above,
     restitution: {value: 0.7, speed: 1.0, exponent: -0.1}}
initial_state: {position: [0.1, -0.2], velocity: [0.5, 0]}
"""
PUSHED = system(
    np.diag([1.0, 2.0]),
    [[0.6, -0.1], [-0.1, 0.3]],
    [[30.0, -10.0], [-10.0, 20.0]],
    contacts=[([-1.0, 0.0], 0.1, 0.0), ([0.0, -1.0], 0.25, 0.6)],
    force=forcing(2, [0.0, 0.5], [Harmonic(2.0, [9.0, 3.0], [0.0, 1.0])]),
)
"""A mass that rests on its stop now and then, and another that bounces meanwhile."""


def ends_of(made: Run, model: System) -> list[FlightEnd]:
    """The switchings of a run of the plant; contacts that only open are no impacts."""
    names, phases, ends = list(model.contact_names), Phases(model), list[FlightEnd]()
    for each in made.switchings:
        if each.switches:
            hit = [names.index(s.contact) for s in each.switches if s.kind is not Kind.OPEN]
            t = seconds_between(EPOCH, each.instant.stamp) + each.instant.remainder
            held = phases.independent(each.closed)
            ends.append(FlightEnd(t, tuple(hit), each.contacts, held))
    return ends


def own_motion(linear: LinearisedSystem, x: Array, ends: list[FlightEnd], until: float) -> Array:
    """Derivatives of instants and of the state at ``until`` of a motion that finds its instants.

    Rows are the instants, then the state. The instant of an impact is where the gap vanishes, that
    of a release where the load does.
    """
    at, rows = linear.begin(0.0, x), list[Array]()
    for end in ends:
        at = linear.flight(at, end.t)
        opened = tuple(i for i in at.closed if i not in end.held)
        guard = linear.guard(at, end.hit or opened, hit=bool(end.hit))
        np.testing.assert_allclose(guard.value, 0.0, atol=1e-6)
        rows.append(-guard.rows[0] / guard.rate[0])
        at, sooner = linear.switch(at, end)
        at = at._replace(X=at.X - np.outer(sooner, rows[-1]))
    return np.vstack([*rows, linear.flight(at, until).X])


def of_plant(model: System, x: Array, until: float) -> tuple[Array, list[tuple[int, ...]], Array]:
    """Instants, closed contacts after each, and the state at ``until`` of the plant itself."""
    made = run(model, *np.split(x, 2), seconds=until, rate=1 / until)
    ends = ends_of(made, model)
    return np.array([each.t for each in ends]), [each.held for each in ends], made.states[-1]


CASES: dict[str, tuple[Callable[[], ParametricFamily], Array, float]] = {
    "impacts": (
        lambda: parametric_family(sample("three_mass").system, (*LINEAR, *OF_FORCES)),
        np.array([0.1, -0.1, 0.05, 0.5, 0.0, -0.5]),
        6.0,
    ),
    "clock": (
        lambda: parametric_family(sample("three_mass").system, ("clock-offset",)),
        np.array([0.1, -0.1, 0.05, 0.5, 0.0, -0.5]),
        4.0,
    ),
    "elements": (
        lambda: parametric_family(
            parse_model(CURVED, "curved").system,
            ("mass.x2", "stiffness.x1-x2", "damping.x1-x2"),
            parse_model(CURVED, "curved").elements,
        ),
        np.array([0.1, -0.2, 0.5, 0.0]),
        8.0,
    ),
    "curved impacts": (
        lambda: parametric_family(
            parse_model(CURVED, "curved").system,
            ("restitution", "restitution-exponent", "gap"),
        ),
        np.array([0.1, -0.2, 0.5, 0.0]),
        8.0,
    ),
    "lasting contact and release": (
        lambda: parametric_family(PUSHED, ("gap", *LINEAR[2:], *OF_FORCES)),
        np.array([0.0, 0.0, 0.5, 0.2]),
        5.0,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_the_plant(name: str) -> None:
    """By start and parameters, of all instants and of the last state."""
    make, x, until = CASES[name]
    family = make()
    until = round(until * NS_PER_S) / NS_PER_S
    y = np.concatenate([x, family.nominal])
    made = run(family.system, *np.split(x, 2), seconds=until, rate=1 / until)
    ends = ends_of(made, family.system)
    assert len(ends) > 2
    if "release" in name:
        assert any(not each.hit for each in ends)
        assert any(each.hit and each.held for each in ends)
    exact = own_motion(LinearisedSystem(family, family.nominal), x, ends, until)
    sizes = np.concatenate([np.ones(x.size), family.sizes])
    for j, size in enumerate(sizes.tolist()):
        found, step = [], 3e-6 * size
        for sign in (1, -1):
            moved = y.copy()
            moved[j] += sign * step
            other = family.system_at(moved[x.size :])
            t, held, last = of_plant(other, moved[: x.size], until)
            assert held == [each.held for each in ends]
            found.append(np.concatenate([t, last]))
        slopes = (found[0] - found[1]) / (2 * step)
        scale = 1 + np.max(np.abs(exact[:, j]))
        np.testing.assert_allclose(exact[:, j], slopes, atol=1e-6 * scale, err_msg=str(j))


@pytest.mark.parametrize("closed", [(), (0,)])
def test_sensitivities_of_a_flight_obey_their_differential_equation(
    closed: tuple[int, ...],
) -> None:
    """Integrated by DOP853, whether a contact is closed or none."""
    kinds = ("stiffness-scale", "damping-scale", "mass-scale", *OF_FORCES)
    family = parametric_family(sample("three_mass").system, kinds)
    model, n, p = family.system, family.system.n, family.size
    x, t, s = np.array([0.3, -0.1, 0.05, 0.5, 0.0, -0.5]), 1.3, 2.7
    W = model.W[:, list(closed)]
    whole = np.block([[model.M, -W], [W.T, np.zeros((len(closed), len(closed)))]])
    inverse = np.linalg.inv(whole)[:n, :n]
    if closed:
        x[n:] -= W[:, 0] * (W[:, 0] @ x[n:]) / (W[:, 0] @ W[:, 0])

    def rates(at: float, z: Array) -> Array:
        q, u, S = z[:n], z[n : 2 * n], z[2 * n :].reshape(2 * n, p)
        a = inverse @ (model.forcing(at) - model.C @ u - model.K @ q)
        pulled = family.force_changes(family.nominal, at).T - model.K @ S[:n] - model.C @ S[n:]
        for j, effect in enumerate(each.effect for each in family.parameters):
            pulled[:, j] -= effect.K @ q + effect.C @ u + effect.M @ a
        return np.concatenate([u, a, S[n:].ravel(), (inverse @ pulled).ravel()])

    begin = np.concatenate([x, np.zeros(2 * n * p)])
    solved = solve_ivp(rates, (t, t + s), begin, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    map_ = LinearisedSystem(family, family.nominal).flow(t, x, s, closed)
    np.testing.assert_allclose(map_.x, solved[: 2 * n], atol=1e-11)
    np.testing.assert_allclose(map_.Gamma, solved[2 * n :].reshape(2 * n, p), atol=1e-10)


def test_a_state_at_rest_is_the_nearest_one_on_its_stop() -> None:
    """Projections in the metrics of K and M by closed forms; by parameters as differences."""
    family = parametric_family(PUSHED, ("gap", "mass-scale"))
    linear, x = LinearisedSystem(family, family.nominal), np.array([0.3, 0.1, -0.4, 0.2])
    w, K, M = PUSHED.W[:, 0], PUSHED.K, PUSHED.M
    placed, still = linear.on_stops(x, (0,)), linear.at_rest(x, (0,))
    for map_, metric, part, rest in ((placed, K, slice(2), 0.1), (still, M, slice(2, 4), 0.0)):
        pushed = np.linalg.solve(metric, w)
        wanted = x[part] - pushed * (w @ x[part] + rest) / (w @ pushed)
        np.testing.assert_allclose(map_.x[part], wanted, atol=1e-14)
        whole = np.eye(2) - np.outer(pushed, w) / (w @ pushed)
        np.testing.assert_allclose(map_.Phi[part, part], whole, atol=1e-12)
    for j, step in enumerate(1e-5 * family.sizes):
        ends = []
        for sign in (1, -1):
            theta = family.nominal.copy()
            theta[j] += sign * step
            aside = LinearisedSystem(family, theta)
            ends.append([aside.on_stops(x, (0,)).x, aside.at_rest(x, (0,)).x])
        slopes = (np.array(ends[0]) - np.array(ends[1])) / (2 * step)
        np.testing.assert_allclose(placed.Gamma[:, j], slopes[0], atol=1e-8)
        np.testing.assert_allclose(still.Gamma[:, j], slopes[1], atol=1e-8)
