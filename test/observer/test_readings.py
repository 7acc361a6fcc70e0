# SPDX-License-Identifier: Apache-2.0
"""What sensors measure as functions of the state, against motions of the plant."""

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, Harmonic, forcing, sample, started, system

from impact_observer.bank.impact_bank import DeclaredErrors, ImpactBank
from impact_observer.bank.sample_correction import Function
from impact_observer.model import System
from impact_observer.model.measurement import Measurement
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.samples import DeclaredSensor
from impact_observer.observer.unknown_parameters import UnknownParameters
from impact_observer.plant import Run, simulate
from impact_observer.stamps import NS_PER_S, Elapsed

Array = NDArray[np.float64]
H = 10_000
"""Half the distance of finite differences, ns."""


def imu(*terms: tuple[str, float], **others: object) -> Measurement:
    """An accelerometer."""
    given = {"field": "a", "deviation": 0.1, **others}
    return Measurement("imu", "/imu", acceleration=dict(terms), **given)  # type: ignore[arg-type]


def states(model: System, start: tuple[object, object], stamps: list[int]) -> Run:
    """Of a plant."""
    return simulate(started(model, *start), np.array(stamps))  # type: ignore[arg-type]


def value(
    declared: Measurement, model: System, ns: int, x: Array, closed: tuple[int, ...] = ()
) -> float:
    """What is measured in a state of the frame, (q, u), at ``ns`` since the epoch."""
    sensor, bank = DeclaredSensor(declared, model), ImpactBank(ParametricFamily(model, ()))
    flights = bank.flights(bank.nominal)
    found, _ = Function(*sensor.function).at(x[None], Elapsed(ns), closed, flights)
    return float(found[0] + sensor.shifts(np.array([ns]))[0])


@pytest.mark.parametrize("name", ["two_mass", "ball_on_table", "yielding_stop"])
def test_an_acceleration_is_that_of_the_plant(name: str) -> None:
    """Differences of its true speeds, under forces, on moving ground."""
    model = sample(name)
    declared = imu((model.system.coordinates[-1], 2.0), offset=9.81)
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
        found = value(declared, model.system, stamp - EPOCH, x, closed)
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
    ns, x = 3 * NS_PER_S // 10, np.array([0.0, 0.1, 0.0, 0.2])
    assert value(imu(("x1", 1.0)), model, ns, x, (0,)) == pytest.approx(0.0, abs=1e-12)
    expected = 2 * np.cos(0.9) - 20 * 0.1 - 0.1 * 0.2
    assert value(imu(("x2", 1.0)), model, ns, x, (0,)) == pytest.approx(expected, rel=1e-12)


def test_positions_speeds_and_gaps_follow_moving_grounds() -> None:
    """Of a ball on a table: coordinates are absolute, the gap is that to the table."""
    model = sample("ball_on_table")
    (name,) = model.system.coordinates
    stamp = EPOCH + NS_PER_S // 7
    x = states(model.system, model.initial_state(), [stamp]).states[0]
    ns = np.array([stamp - EPOCH])
    framed = model.system.to_frame(ns, x[None])[0]

    def measured(**what: object) -> float:
        declared = Measurement("a", "/a", field="a", deviation=0, **what)  # type: ignore[arg-type]
        return value(declared, model.system, stamp - EPOCH, framed)

    assert measured(position={name: 1.0}) == pytest.approx(x[0], abs=1e-12)
    assert measured(velocity={name: 3.0}) == pytest.approx(3 * x[1], abs=1e-12)
    gap = model.system.gap(x[:1])[0] + model.system.gap_motion(ns)[0, 0]
    assert measured(gap=model.system.contact_names[0]) == pytest.approx(gap, abs=1e-12)


def test_parameters_that_are_estimated_change_what_is_measured() -> None:
    """Rows of a gap and of an acceleration, against differences over the parameters."""
    model = sample("two_mass").system
    unknowns = UnknownParameters.named(model, ["stiffness-scale=0.05", "gap=0.01"])
    bank = ImpactBank(unknowns.family, DeclaredErrors(constants=unknowns.root))
    nominal = unknowns.family.nominal
    x, t = np.array([0.1, 0.2, -0.3, 0.4]), Elapsed(7 * NS_PER_S // 10)
    for declared in (
        imu(("x1", 1.0), ("x2", -2.0)),
        Measurement("g", "/g", field="a", gap="stop", deviation=1),
    ):
        function = Function(*DeclaredSensor(declared, model).function)

        def at(theta: Array, function: Function = function) -> tuple[float, Array]:
            z = np.concatenate([x, theta])[None]
            found, by = function.at(z, t, (), bank.flights(theta))
            return float(found[0]), by[0]

        _, row = at(nominal)
        for j, step in enumerate(np.eye(nominal.size) * 1e-6):
            slope = (at(nominal + step)[0] - at(nominal - step)[0]) / 2e-6
            assert row[4 + j] == pytest.approx(slope, rel=1e-5, abs=1e-9)
