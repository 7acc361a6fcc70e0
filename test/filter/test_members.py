# SPDX-License-Identifier: Apache-2.0
"""Sensitivities to parameters, against finite differences between other systems."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import PRESSED, sample

from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.filter.members import Members
from impact_observer.filter.saltation import Measured, Mirror
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.model import System

Array = NDArray[np.float64]
EVERYTHING = (
    "mass-scale",
    "stiffness-scale",
    "damping-scale",
    "forcing-amplitude",
    "forcing-phase",
    "restitution",
    "gap",
)
STEP = 1e-5


def members(model: System, *wanted: str) -> Members:
    """The family with ``wanted`` parameters."""
    return Members(UnknownParameters.named(model, wanted or EVERYTHING).family)


def slopes(all_: Members, of: Callable[[Array], Array]) -> Array:
    """Central differences with each parameter, shape (k, p)."""
    given = np.array(all_.family.nominal)
    steps = STEP * np.eye(given.size)
    return np.column_stack([(of(given + s) - of(given - s)) / (2 * STEP) for s in steps])


@pytest.mark.parametrize("closed", [(), (0,), (0, 1)])
def test_accelerations_and_loads_change_as_those_of_other_systems(closed: tuple[int, ...]) -> None:
    """With every kind of parameter, whatever is held."""
    all_, t = members(PRESSED), 0.7
    x = np.array([0.3, -0.2, 0.5, 0.4])

    def rate(theta: Array) -> Array:
        member = all_.at(theta)
        return member.moving.rates(closed).along(x, member.moving.forces(t))[0]

    def loads(theta: Array) -> Array:
        moving = all_.at(theta).moving
        return Measured.loads(moving.phase(closed), closed).value(x, moving.forces(t)[0])

    found = all_.rate_sensitivity(all_.given, closed, x, t)
    np.testing.assert_allclose(found, slopes(all_, rate), atol=1e-7)
    if closed:
        found = all_.load_sensitivity(all_.given, closed, closed, x, t)
        np.testing.assert_allclose(found, slopes(all_, loads), atol=1e-6)


def test_gaps_are_sensitive_to_their_own_parameters() -> None:
    """And by nothing else."""
    all_ = members(PRESSED)
    rows = all_.gap_sensitivity((1, 0))
    names = all_.family.names
    assert rows.shape == (2, len(names))
    for name, column in zip(names, rows.T, strict=True):
        wanted = {"gap.c1": [0.0, 1.0], "gap.c2": [1.0, 0.0]}.get(name, [0.0, 0.0])
        assert column.tolist() == wanted, name


@pytest.mark.parametrize("pressed", [(0,), (1,), (0, 1)])
def test_an_impact_is_that_of_the_system_with_these_parameters(pressed: tuple[int, ...]) -> None:
    """Positions and velocities are mirrored alike."""
    all_ = members(PRESSED)
    theta = all_.family.nominal + 0.01 * np.arange(1, all_.family.size + 1)
    x = np.array([0.3, -0.2, 0.5, 0.4])
    value, linear = all_.impact(theta, x, pressed)
    model = all_.family.system_at(theta)
    mirror = Mirror.of(model, ImpactLaw(model).jump(pressed), pressed)
    np.testing.assert_allclose(linear, mirror.J, atol=1e-13)
    np.testing.assert_allclose(value, mirror.J @ x + mirror.offset, atol=1e-13)


def test_members_that_differ_in_impacts_only_share_their_motion() -> None:
    """Phases are prepared once for all restitutions and gaps."""
    all_ = members(PRESSED, "gap", "restitution", "stiffness-scale")
    assert all_.family.names[0] == "stiffness-scale"
    given = np.array(all_.family.nominal)
    other = all_.at(given + np.array([0.0, 0.01, 0.02, 0.03, 0.04]))
    assert other.moving is all_.given.moving
    assert other.system.eps.tolist() != PRESSED.eps.tolist()
    assert all_.with_given_restitution(other).system.q_r.tolist() == other.system.q_r.tolist()
    assert all_.with_given_restitution(other).system.eps.tolist() == PRESSED.eps.tolist()
    assert all_.at(given + 0.1 * np.eye(5)[0]).moving is not all_.given.moving


def test_parameters_beyond_their_bounds_are_corrected_with_the_state() -> None:
    """By the conditional mean of a normal vector; what is inside stays."""
    all_ = members(PRESSED, "restitution")
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    P, x = root @ root.T, rng.normal(size=4)

    def bounded(*theta: float) -> tuple[Array, Array]:
        z = np.append(x, theta)
        return z, all_.parameters.bounded(z, root, 4)

    np.testing.assert_array_equal(*bounded(0.2, 0.9))
    before, after = bounded(0.5, 1.3)
    assert after[5] == 1.0
    np.testing.assert_allclose(after, before + P[:, 5] / P[5, 5] * -0.3)
    theta = bounded(-0.4, 1.3)[1][4:]
    assert np.all((theta >= 0.0) & (theta <= 1.0))


def test_steps_are_about_the_deviations_and_stay_within_bounds() -> None:
    """Powers of two; not so small that differences would be rounding."""
    model = sample("three_mass")
    unknowns = UnknownParameters.named(model.system, ["stiffness.ground-x1"], model.elements)
    all_ = Members(unknowns.family)
    for deviation in (1e-12, 1e-3, 1.0, 1e3):
        for theta in (0.1, 25.0, 500.0):
            (step,) = all_.parameters.steps(
                np.array([theta]), np.array([[deviation]]), np.zeros((1, 0))
            )
            assert np.log2(step) == np.round(np.log2(step))
            assert theta - 1.5 * step > 0.0
            wanted = max(deviation, 1e-6 * 25.0)
            assert step <= wanted
            assert step > min(wanted, theta / 2) / 2


def test_a_member_moves_and_jumps_as_its_system_does() -> None:
    """Without contact and at an impact, forward and back: unchecked members take shortcuts."""
    model, t = sample("three_mass").system, 0.7
    wanted = ("stiffness-scale", "damping-scale", "restitution", "gap")
    all_ = members(model, *wanted)
    values = all_.family.nominal + 0.01 * np.arange(1, len(all_.family.nominal) + 1)
    other, found = all_.family.system_at(values), all_.at(values)
    for name in ("M", "C", "K", "W", "q_r", "eps"):
        np.testing.assert_array_equal(getattr(found.system, name), getattr(other, name))
    x = np.arange(2.0 * model.n) / model.n
    for s in (0.5, -0.5):
        for mine, checked in zip(
            found.moving.moved(t, x, s, ()), Phases(other).phase().moved(t, x, s), strict=True
        ):
            np.testing.assert_allclose(mine, checked, rtol=1e-11, atol=1e-12)
    mirror, w = found.mirror((0,)), model.W[:, 0]
    u = -x[model.n :] * np.sign(w @ x[model.n :])  # it approaches
    jumped = mirror.J @ np.concatenate([x[: model.n], u]) + mirror.offset
    np.testing.assert_allclose(jumped[model.n :], ImpactLaw(other).velocity_after(u, (0,)))
    gap, eps = w @ x[: model.n] + other.q_r[0], other.eps[0]
    assert w @ jumped[: model.n] + other.q_r[0] == pytest.approx(-eps * gap)
