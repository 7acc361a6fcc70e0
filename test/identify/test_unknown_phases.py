# SPDX-License-Identifier: Apache-2.0
"""Phases that nobody knows, of drives and of grounds, on plants that share no code with it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate, optimize
from systems import EPOCH

from impact_observer.events import ImpactEvent, Switch
from impact_observer.identify import fit_report
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.growing import grown
from impact_observer.identify.identification import Identification, identify
from impact_observer.identify.recorded_impacts import Recording
from impact_observer.model import parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.observer.episode import last_episode
from impact_observer.stamps import from_seconds

Array = NDArray[np.float64]
DRIVEN = """\
name: driven
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 10, damping: 0.1}
forces: [{body: x2, amplitude: 4, frequency: 2.5}]
stops: [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.65}]
"""
ON_TABLE = """\
name: on_table
bodies: [{name: height, mass: 1}]
grounds: [{name: table, motion: {harmonics: [{amplitude: 0.003, frequency: 62.8}]}}]
forces: [{body: height, constant: -9.81}]
stops: [{name: plate, between: [table, height], gap: 0, restitution: 0.75}]
"""
DRILL = """\
name: drill
bodies: [{name: bit, mass: 1}]
springs: [{between: [ground, bit], stiffness: 1000, damping: 2}]
forces: [{body: bit, amplitude: 60, frequency: 80}]
stops: [{name: rock, body: bit, limit: 0.0021, side: above, restitution: 0.55}]
"""


def driven(phase: float) -> Array:
    """Impact times in 30 s of the two masses with a restitution of 0.7, by DOP853, s."""

    def slope(t: float, x: Array) -> Array:
        near, far = 10 * x[0] + 0.1 * x[2], 10 * (x[1] - x[0]) + 0.1 * (x[3] - x[2])
        return np.array([x[2], x[3], far - near, 4 * np.cos(2.5 * t + phase) - far])

    return bounced(slope, lambda x: float(0.5 - x[1]), [0.1, -0.2, 0.5, 0.0], 0.7, 30.0)


def drilling(phase: float) -> Array:
    """Impact times in 4 s of the drill with a stop at 2 mm and a restitution of 0.5, s."""

    def slope(t: float, x: Array) -> Array:
        return np.array([x[1], 60 * np.cos(80 * t + phase) - 2 * x[1] - 1000 * x[0]])

    return bounced(slope, lambda x: float(0.002 - x[0]), [-0.01, 0.0], 0.5, 4.0)


def bounced(
    slope: Callable[[float, Array], Array],
    gap: Callable[[Array], float],
    start: list[float],
    restitution: float,
    end: float,
) -> Array:
    """Impact times of a motion whose last coordinate hits a stop, s."""

    def closed(t: float, x: Array) -> float:
        del t
        return gap(x)

    closed.terminal, closed.direction = True, -1  # type: ignore[attr-defined]
    t, x, hits = 0.0, np.array(start), list[float]()
    while True:
        exact = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12, "events": closed}
        part = integrate.solve_ivp(slope, (t, end), x, **exact)
        if part.status == 0:
            return np.array(hits)
        t, x = float(part.t[-1]), part.y[:, -1].copy()
        hits.append(t)
        x[-1] *= -restitution
        assert x[-1] < -1e-3  # no row of bounces


def dropped_on_table(phase: float) -> Array:
    """Impact times in 3 s of a ball with a restitution of 0.8 on a shaken table, s."""

    def above(t: float) -> float:
        fallen = height + speed * (t - left) - 9.81 / 2 * (t - left) ** 2
        return fallen - 0.003 * float(np.cos(62.8 * t + phase))

    left, height, speed, hits = 0.0, 0.05, 0.0, list[float]()
    while left < 3.0:
        grid = (left + np.arange(1, 4000) * 1e-4).tolist()
        k = next(k for k, t in enumerate(grid) if above(t) < 0)
        if k < 100:  # 10 ms: a row of bounces that settles begins
            break
        t = float(optimize.brentq(above, grid[k - 1], grid[k], xtol=1e-14))
        hits.append(t)
        moved = -0.003 * 62.8 * np.sin(62.8 * t + phase)
        speed = moved - 0.8 * (speed - 9.81 * (t - left) - moved)
        left, height = t, 0.003 * np.cos(62.8 * t + phase)
    return np.array(hits)


def events_of(times: Array, contact: str) -> list[ImpactEvent]:
    """Impacts of a contact at some times after the epoch, s."""
    return [
        ImpactEvent(EPOCH + from_seconds(t), (Switch(contact),), k + 1, 1, EPOCH)
        for k, t in enumerate(times.tolist())
    ]


def fitted(text: str, times: Array, free: str, clock: float, seed: int) -> Identification:
    """A fit to times with normal errors."""
    late = clock * np.random.default_rng(seed).normal(size=times.size)
    model = parse_model(text, "rig")
    family = parametric_family(model.system, free.split())
    events = events_of(times + late, model.system.contact_names[0])
    return identify(family, events, clock=clock)


@pytest.mark.slow
@pytest.mark.parametrize("phase", [0.9, 2.4, 4.0, 5.3])
@pytest.mark.parametrize(
    ("rig", "clock", "true"),
    [
        ((DRIVEN, driven, "forcing-phase restitution"), 1e-3, (0.7,)),
        ((DRILL, drilling, "forcing-phase restitution gap"), 2e-5, (0.5, 0.002)),
        ((ON_TABLE, dropped_on_table, "ground-phase restitution"), 1e-4, (0.8,)),
    ],
)
def test_an_unknown_phase_is_found_all_around_the_circle(
    rig: tuple[str, Callable[[float], Array], str],
    clock: float,
    true: tuple[float, ...],
    phase: float,
) -> None:
    """From a phase of zero, beside a restitution and a gap that are off, within its errors."""
    text, plant, free = rig
    found = fitted(text, plant(phase), free, clock, round(10 * phase))
    assert check_fit(found).fits
    assert found.converged
    turned, *others = found.values  # in the order of the names
    assert abs(np.angle(np.exp(1j * (turned - phase)))) < 4 * found.errors[0] < 0.4
    assert np.all(np.abs(np.subtract(others, true)) < 4 * found.errors[1:])


@pytest.mark.slow
def test_a_recording_of_which_the_first_part_fits_is_answered_with_its_length(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The drive slipped by 0.4 s towards the end: the part that is named has the values."""
    times = driven(3.5)
    events = events_of(np.where(times > 23.0, times + 0.4, times), "stop")
    system, said = parse_model(DRIVEN, "rig").system, list[str]()
    family = parametric_family(system, ["forcing-phase", "restitution"])
    problem = Recording(last_episode(system, events)).problem(family)
    reached = grown(problem, lambda _, found: found.converged and found.rms < 1e-4, said.append)
    assert reached is not None
    assert 12 <= reached.moments < times.size
    assert any("start 2 of 4" in each for each in said)
    part = identify(family, events[: reached.moments], clock=1e-4)
    assert part.converged
    assert part.values[0] % (2 * np.pi) == pytest.approx(3.5, abs=0.01)
    failed = replace(part, converged=False, reached=reached)
    fit_report.print_parameters(failed, check_fit(failed))
    printed = " ".join(capsys.readouterr().out.split())
    assert f"first {reached.moments} impacts, which take " in printed


def test_a_drop_height_above_a_shaken_table_is_measured_from_the_table(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A ball falls from 5 cm at the epoch; one that flies down already was not dropped then."""
    phase, clock = 2.4, 1e-5
    times = dropped_on_table(phase)
    found = fitted(ON_TABLE, times, "ground-phase restitution", clock, 1)
    turn: Any = fit_report.for_json(found, check_fit(found))["turning_point"]
    value, error = turn
    assert abs(value - (0.05 - 0.003 * np.cos(phase))) < 4 * error < 1e-3
    fit_report.print_parameters(found, check_fit(found))
    assert "gap of plate where it turns" in " ".join(capsys.readouterr().out.split())
    rising = replace(found, start=found.start - np.array([0.0, 1.0]))
    assert fit_report.for_json(rising, check_fit(rising))["turning_point"] is None
