# SPDX-License-Identifier: Apache-2.0
"""Flights of a robot: a mass on a rail that falls in closed form."""

import numpy as np
import pytest
from arms import SLIDER, model_of, wall

pytest.importorskip("pinocchio", reason="not installed: extra robots")

from impact_observer.dynamics.mechanism import Grip
from impact_observer.robots import Robot
from impact_observer.robots.robot_flight import RobotFlight

FREE = Grip((), ())
PLANES = ", ".join(
    wall(name=name, normal=normal)[1:-1]
    for name, normal in (("floor", "[0, 0, 1]"), ("glass", "[1, 0, 0]"))
)
"""A floor, and a pane along which the mass falls at a gap of zero."""


def test_a_fall_has_its_closed_form_whatever_was_asked_before() -> None:
    """``z = 1 + t/2 - g t^2 / 2``, also after states that are later than the end."""
    robot, g = Robot(model_of(SLIDER, "rail", contacts=f"[{PLANES}]")), 9.81
    flight = RobotFlight(robot, 0.0, np.array([1.0, 0.5]), FREE)
    assert flight.states(np.zeros(0)).shape == (0, 2)
    for t in (0.0, 2.0, 0.1):
        assert flight.state(t) == pytest.approx([1 + t / 2 - g * t**2 / 2, 0.5 - g * t])
    assert flight.end(0.1) is None
    end = flight.end(1.0)
    assert end is not None
    assert end.gaps == frozenset({0})
    assert not end.loads
    assert end.s == pytest.approx((0.5 + np.sqrt(0.25 + 2 * g)) / g, rel=1e-12)
    times = np.array([0.0, 0.3, 2.5])
    again = RobotFlight(robot, 0.0, np.array([1.0, 0.5]), FREE)
    assert again.states(times)[:, 1] == pytest.approx(0.5 - g * times)
