# SPDX-License-Identifier: Apache-2.0
"""What sensors measure as functions of the state, against motions of the plant."""

import math

import numpy as np
import pytest
from systems import EPOCH, Harmonic, chain, forcing, sample, started, system

from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.members import Members
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.readings import DeclaredSensor, Place, Reading
from impact_observer.filter.sample_update import SampleUpdate
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.kernel._kernel import Parameters, measured
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.plant import Run, simulate
from impact_observer.stamps import NS_PER_S

H = 10_000
"""Half the distance of finite differences, ns."""


def imu(*terms: tuple[str, float], **others: object) -> Measurement:
    """An accelerometer."""
    given = {"field": "a", "deviation": 0.1, **others}
    return Measurement("imu", "/imu", acceleration=terms, **given)  # type: ignore[arg-type]


def states(model: System, start: tuple[object, object], stamps: list[int]) -> Run:
    """Of a plant."""
    return simulate(started(model, *start), np.array(stamps))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["two_mass", "ball_on_table", "yielding_stop"])
def test_an_acceleration_is_that_of_the_plant(name: str) -> None:
    """Differences of its true speeds, under forces, on moving ground."""
    model = sample(name)
    coordinate = model.system.coordinates[-1]
    sensor = DeclaredSensor(imu((coordinate, 2.0), offset=9.81), model.system)
    checked = 0
    for t in (0.02, 0.11, 0.25, 0.4):
        stamp = EPOCH + round(t * NS_PER_S)
        whole = states(model.system, model.initial_state(), [stamp - H, stamp, stamp + H])
        if any(abs(each.instant.stamp - stamp) <= 2 * H for each in whole.switchings):
            continue
        n = model.system.n
        expected = 2 * (whole.states[2] - whole.states[0])[2 * n - 1] / (2e-9 * H) + 9.81
        closed = whole.switchings[-1].closed if whole.switchings else ()
        x = model.system.to_frame(np.array([stamp - EPOCH]), whole.states[1][None])[0]
        at = Place((stamp - EPOCH) / NS_PER_S, stamp - EPOCH, x, closed)
        found = sensor.row(MovingSystem(model.system), at).value(x)
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-5)
        checked += 1
    assert checked >= 3


def test_an_acceleration_contains_the_loads_of_held_contacts() -> None:
    """A mass that rests on a stop beside one that moves: the first does not accelerate."""
    drive = forcing(2, [-9.0, 0.0], [Harmonic(3.0, [0.0, 2.0], [0.0, 0.0])])
    model = system(
        np.eye(2), 0.1 * np.eye(2), [[20.0, -10.0], [-10.0, 20.0]],
        contacts=[([1.0, 0.0], 0.0, 0.0)], force=drive,
    )  # fmt: skip
    moving = MovingSystem(model)
    at = Place(0.3, 3 * NS_PER_S // 10, np.array([0.0, 0.1, 0.0, 0.2]), (0,))
    resting = DeclaredSensor(imu(("x1", 1.0)), model).row(moving, at)
    assert resting.value(at.x) == pytest.approx(0.0, abs=1e-12)
    free = DeclaredSensor(imu(("x2", 1.0)), model).row(moving, at)
    expected = 2 * np.cos(0.9) - 20 * 0.1 - 0.1 * 0.2
    assert free.value(at.x) == pytest.approx(expected, rel=1e-12)


def test_positions_speeds_and_gaps_follow_moving_grounds() -> None:
    """Of a ball on a table: coordinates are absolute, the gap is that to the table."""
    model = sample("ball_on_table")
    (name,) = model.system.coordinates
    stamp = EPOCH + NS_PER_S // 7
    x = states(model.system, model.initial_state(), [stamp]).states[0]
    ns = np.array([stamp - EPOCH])
    framed = model.system.to_frame(ns, x[None])[0]
    at, moving = Place(1 / 7, stamp - EPOCH, framed, ()), MovingSystem(model.system)

    def value(**what: object) -> float:
        declared = Measurement("a", "/a", field="a", deviation=0, **what)  # type: ignore[arg-type]
        return DeclaredSensor(declared, model.system).row(moving, at).value(framed)

    assert value(position=((name, 1.0),)) == pytest.approx(x[0], abs=1e-12)
    assert value(velocity=((name, 3.0),)) == pytest.approx(3 * x[1], abs=1e-12)
    gap = model.system.gap(x[:1])[0] + model.system.gap_motion(ns)[0, 0]
    assert value(gap=model.system.contact_names[0]) == pytest.approx(gap, abs=1e-12)


def test_parameters_that_are_estimated_change_what_is_measured() -> None:
    """Rows of a gap and of an acceleration, against differences over the parameters."""
    model = sample("two_mass").system
    unknowns = UnknownParameters.named(model, ["stiffness-scale=0.05", "gap=0.01"])
    members, nominal = Members(unknowns.family), unknowns.family.nominal
    at = Place(0.7, 7 * NS_PER_S // 10, np.array([0.1, 0.2, -0.3, 0.4]), ())
    for declared in (
        imu(("x1", 1.0), ("x2", -2.0)),
        Measurement("g", "/g", field="a", gap="stop", deviation=1),
    ):
        sensor = DeclaredSensor(declared, model)
        row = sensor.row_of(members, nominal, at)
        for j, step in enumerate(np.eye(nominal.size) * 1e-6):
            values = [sensor.row_of(members, nominal + s, at).value(at.x) for s in (step, -step)]
            slope = (values[0] - values[1]) / 2e-6
            assert row.of_theta[j] == pytest.approx(slope, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("considered", [False, True])
def test_a_square_root_is_updated_like_its_covariance(considered: bool) -> None:
    """Joseph's form, for noise from large to none at all, of state and constants.

    Of a considered parameter the gain is zero.
    """
    parameters = Parameters(np.zeros(1), np.ones(1), np.ones(1), 0, [considered])
    rng = np.random.default_rng(3)
    declared = Measurement("a", "/a", field="a", position=(("x1", 2.0),), deviation=0)
    x = rng.normal(size=4)
    row = DeclaredSensor(declared, chain(2)).row(MovingSystem(chain(2)), Place(0.0, 0, x, ()))
    row = row._replace(of_theta=rng.normal(size=1))
    h = np.append(row.whole, 0.0)
    for noise in (1.0, 1e-6, 1e-24):
        root, constants, others = (rng.normal(size=each) for each in ((6, 8), 2, (6, 3)))
        value = row.value(x) + 0.7
        *state, innovation, normalised, _ = measured(
            x, constants, root, others, row.whole, row.rest, value, noise, 1e300, parameters
        )
        P = root @ root.T
        variance = h @ P @ h + noise
        assert row.variance(root) + noise == pytest.approx(variance)
        gain = P @ h / variance
        gain[4] *= not considered
        left = np.eye(6) - np.outer(gain, h)
        expected = left @ P @ left.T + noise * np.outer(gain, gain)
        np.testing.assert_allclose(state[2] @ state[2].T, expected, atol=1e-11)
        np.testing.assert_allclose(state[0], x + 0.7 * gain[:4], atol=1e-12)
        np.testing.assert_allclose(state[1], constants + 0.7 * gain[4:], atol=1e-12)
        np.testing.assert_allclose(state[3], left @ others, atol=1e-12)
        assert (innovation, normalised) == pytest.approx((0.7, 0.7 / np.sqrt(variance)))


def test_an_estimate_that_has_overflowed_is_too_uncertain_for_a_sample() -> None:
    """It stays as it is."""
    model = sample("two_mass").system
    declared = Measurement("a", "/a", field="a", position=(("x1", 1.0),), deviation=0.1)
    reading = Reading(DeclaredSensor(declared, model), 0.5, 1.0, NS_PER_S)
    update = SampleUpdate(FilterBank(ImpactFilter(model), Uncertainty(), (1e-3,)))
    for large in (math.inf, math.nan, 1e200):
        state = GaussianState.of(np.zeros((1, 4)), np.diag([large, 1.0, 1.0, 1.0]))
        before = Hypothesis(state, 1e-3)
        (after,), outcome = update.after(reading, [before])
        assert after is before
        assert outcome.reason == "the estimate is too uncertain"
