# SPDX-License-Identifier: Apache-2.0
"""Exact sensitivities of a motion that is switched at given instants."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import EPOCH, Harmonic, chain, examples, forcing, run, sample, system, systems

from impact_observer.dynamics import Phases
from impact_observer.errors import UsageError
from impact_observer.identify.shooting import shoot
from impact_observer.model import System
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parametric_family import (
    Coefficients,
    ModelParameter,
    ParametricFamily,
)
from impact_observer.stamps import seconds_between
from impact_observer.trajectory.linearised_system import FlightEnd

Array = NDArray[np.float64]
SCALES = ("stiffness-scale", "damping-scale", "mass-scale")
EVERYTHING = ("restitution", "gap", *SCALES)
OF_FORCING = ("forcing-amplitude", "forcing-phase", "forcing-frequency", "clock-offset")


def moments_of(model: System, x: Array, seconds: float) -> list[FlightEnd]:
    """The switchings of a plant that starts at ``x``."""
    n, phases = model.n, Phases(model)
    made = run(model, x[:n], x[n:], seconds=seconds, rate=10.0)
    return [
        FlightEnd(
            seconds_between(EPOCH, each.instant.stamp) + each.instant.remainder,
            each.contacts,
            each.contacts,
            phases.independent(each.closed),
        )
        for each in made.switchings
    ]


def assert_derivatives(
    family: ParametricFamily, start: Array, moments: list[FlightEnd], t: Array
) -> None:
    """Differences of 1e-6 agree with the derivatives."""
    shot, step = shoot(family, start, moments, t, 0.0), 1e-6

    def gaps(dy: Array, dt: Array) -> Array:
        return shoot(family, start + dy, moments, t + dt, 0.0).gaps

    still, fixed = np.zeros(t.size), np.zeros(start.size)
    for j, unit in enumerate(np.eye(start.size) * step):
        found = (gaps(unit, still) - gaps(-unit, still)) / (2 * step)
        scale = 1.0 + np.max(np.abs(shot.by_start[:, j]))
        np.testing.assert_allclose(found, shot.by_start[:, j], atol=2e-7 * scale)
    for k, unit in enumerate(np.eye(t.size) * step):
        found = (gaps(fixed, unit) - gaps(fixed, -unit)) / (2 * step)
        scale = 1.0 + np.max(np.abs(shot.by_instant[:, k]))
        np.testing.assert_allclose(found, shot.by_instant[:, k], atol=2e-7 * scale)


@pytest.mark.slow
@examples(10)
@given(
    model=systems(max_n=3, contacts=(1, 2)),
    data=st.data(),
)
def test_derivatives_are_those_of_differences(model: System, data: st.DataObject) -> None:
    """Of any system with any parameters, switched anyhow, also with contacts that stay closed."""
    kinds = [k for k in EVERYTHING if k != "damping-scale" or np.any(model.C)]
    kinds = [k for k in kinds if k != "stiffness-scale" or np.any(model.K)]
    kinds += ["constant-force", *(OF_FORCING[:3] if model.forcing.frequency.size else ())]
    family = parametric_family(model, kinds)
    m, phases = model.m, Phases(model)
    some = st.sets(st.integers(0, m - 1)).map(lambda found: tuple(sorted(found)))
    moments, t = [], 0.0
    for k in range(3):
        t += data.draw(st.integers(4, 32)) / 64
        hit = data.draw(some) if k < 2 else tuple(range(m))
        pressed = phases.independent(hit)
        held = phases.independent(data.draw(some))
        moments.append(FlightEnd(t, hit, pressed, held))
    start = np.concatenate([np.linspace(-0.5, 0.5, 2 * model.n), family.nominal])
    assert_derivatives(family, start, moments, np.array([each.t for each in moments]))


def test_clock_offset_is_a_phase_of_every_harmonic() -> None:
    """Its derivative too."""
    family = parametric_family(sample("three_mass").system, ["clock-offset"])
    moments = moments_of(family.system, np.zeros(6), 5.0)
    t = np.array([each.t for each in moments])
    assert t.size > 2
    assert_derivatives(family, np.append(np.full(6, 0.1), 0.02), moments, t)


def test_gaps_of_a_motion_with_persistent_contact_vanish() -> None:
    """A mass that is pressed against its stop again and again."""
    push = forcing(1, 0.0, [Harmonic(2.0, [6.0], [0.0])])
    model = system(1.0, 0.5, 4.0, contacts=[([-1.0], 0.5, 0.0)], force=push)
    x = np.array([0.0, 0.5])
    moments = moments_of(model, x, 20.0)
    assert any(each.held for each in moments)
    t = np.array([each.t for each in moments])
    shot = shoot(ParametricFamily(model, ()), x, moments, t, 0.0)
    np.testing.assert_allclose(shot.gaps, 0.0, atol=1e-10)


def test_bouncing_ball_answers_as_the_closed_form() -> None:
    """``g`` at the second impact of a ball from height ``h``, and its slope with restitution."""
    h, e, a = 1.0, 0.9, 9.81
    ball = system(1.0, 0.0, 0.0, contacts=[([1.0], 0.0, e)], force=forcing(1, -a))
    first = np.sqrt(2 * h / a)
    second = first * (1 + 2 * e)
    family = parametric_family(ball, ["restitution"])
    moments = [FlightEnd(t, (0,), (0,)) for t in (first, second)]
    shot = shoot(family, np.array([h, 0.0, e]), moments, np.array([first, second]), 0.0)
    np.testing.assert_allclose(shot.gaps, 0.0, atol=1e-14)
    np.testing.assert_allclose(shot.speeds, [-a * first, -e * a * first], rtol=1e-13)
    flight = second - first
    np.testing.assert_allclose(shot.by_start[1, 2], a * first * flight, rtol=1e-12)
    # A first impact that is later by dt throws the ball up from lower, and faster.
    np.testing.assert_allclose(
        shot.by_instant[1],
        [-(1 + e) * a * first + (1 + e) * a * flight, -e * a * first],
        rtol=1e-9,
    )


def test_a_family_has_the_given_system_and_others() -> None:
    """Each parameter changes the quantity of its name."""
    model = sample("three_mass").system
    family = parametric_family(model, [*EVERYTHING, *OF_FORCING[:2]])
    same = family.system_at(family.nominal)
    for part in ("M", "C", "K", "q_r", "eps"):
        np.testing.assert_array_equal(getattr(same, part), getattr(model, part))
    moved = dict(zip(family.names, family.nominal, strict=True))
    moved.update({"stiffness-scale": 1.1, "gap.left": 0.3, "forcing-phase.1": 0.2})
    other = family.system_at(np.array(list(moved.values())))
    np.testing.assert_allclose(other.K, 1.1 * model.K)
    np.testing.assert_allclose(other.q_r, [0.3, 0.3])
    t = 1.7
    ahead = model.forcing(t + 0.2 / 2.7)[0]
    np.testing.assert_allclose(other.forcing(t)[0], ahead, rtol=1e-12)
    np.testing.assert_allclose(other.forcing(t)[2], model.forcing(t)[2], rtol=1e-12)


def test_what_cannot_be_free_is_refused_by_name() -> None:
    """Unknown, twice, or beside its scale."""
    model = sample("two_mass")
    for wanted, found in (
        (["stifness"], "stifness"),
        (["gap", "gap.stop"], "twice"),
        (["stiffness.ground-x1"], "has none"),
    ):
        with pytest.raises(UsageError, match=found):
            parametric_family(model.system, wanted)


def test_an_effect_has_the_shapes_of_the_system() -> None:
    """It is nonzero for the named parameter only."""
    model = replace(chain(2), name="chain")
    change = Coefficients.change(model, K=np.eye(2))
    assert change.M.shape == (2, 2)
    assert not np.any(change.M)
    stiffer = ModelParameter("stiffer", 1.0, 0.0, 9.0, 1.0, "", change)
    found = ParametricFamily(model, (stiffer,)).coefficients_at(np.array([3.0]))
    np.testing.assert_array_equal(found.K, model.K + 2 * np.eye(2))
