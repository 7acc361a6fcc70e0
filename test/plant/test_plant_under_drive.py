# SPDX-License-Identifier: Apache-2.0
"""The plant under a drive whose speed varies, against an independent integrator."""

from itertools import pairwise

import numpy as np
import pytest
from rigs import EPOCH, pulses
from scipy import integrate

from impact_observer.model import read_model
from impact_observer.model.live_signals import connected
from impact_observer.plant import Plant, make_plant, simulate
from impact_observer.stamps import NS_PER_S, grid


@pytest.mark.slow
def test_impacts_under_a_drive_are_those_of_another_integrator() -> None:
    """DOP853 from pulse to pulse, each a constant frequency: to 2 ns."""
    model, stamps = read_model("hammer"), pulses()
    system, live = connected(model.system)
    assert live is not None
    for stamp in stamps:
        live.add_pulse(stamp)
    plant = Plant(system, *model.initial_state(), epoch=EPOCH, live=live)
    end = EPOCH + 8 * NS_PER_S
    found = [each.instant.stamp for each in simulate(plant, grid(EPOCH, end, 1.0)).switchings]
    assert len(found) > 8

    inverse, gap = np.linalg.inv(system.M), float(system.q_r[0])
    x, t, expected = np.concatenate(model.initial_state()), 0.0, list[float]()
    knots = (np.array(stamps) - EPOCH) / NS_PER_S
    for start, stop in pairwise(knots):
        if stop <= 0 or start > 8:
            continue
        rate = 2 * np.pi / (stop - start)

        def motion(
            t: float, x: np.ndarray, start: float = start, rate: float = rate
        ) -> np.ndarray:
            phase = rate * (t - start)
            force = np.array([20 * np.cos(phase) + 4 * np.cos(2 * phase + 0.7), 0.0])
            return np.append(x[2:], inverse @ (force - system.C @ x[2:] - system.K @ x[:2]))

        def gap_of(_: float, x: np.ndarray) -> float:
            return gap - float(x[1])

        gap_of.terminal, gap_of.direction = True, -1  # type: ignore[attr-defined]
        while t < stop:
            solved = integrate.solve_ivp(
                motion, (t, stop), x, "DOP853", events=gap_of, rtol=1e-13, atol=1e-14
            )
            t, x = float(solved.t[-1]), solved.y[:, -1]
            if solved.status == 1:
                expected.append(t)
                x[3] *= -0.6
                x[1] = min(x[1], gap - 1e-16)
    wanted = EPOCH + np.round(np.array(expected[: len(found)]) * NS_PER_S)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2)


def test_without_a_drive_it_turns_with_its_nominal_speed() -> None:
    """In a plant without signals, and for the integrator moreau."""
    model = read_model("hammer")
    first = [
        next(
            iter(
                simulate(
                    make_plant(
                        model.system,
                        *model.initial_state(),
                        epoch=EPOCH,
                        integrator=integrator,
                        step=1e-4,
                    ),
                    grid(EPOCH, EPOCH + NS_PER_S, 1.0),
                ).switchings
            )
        ).instant.stamp
        for integrator in ("event-driven", "moreau")
    ]
    assert abs(first[0] - first[1]) < 2_000_000
