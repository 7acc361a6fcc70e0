# SPDX-License-Identifier: Apache-2.0
"""Restitution that depends on the speed of approach: its numbers, its file, its slope."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.model import parse_model
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.model.rebounds.constant_restitution import ConstantRestitution
from impact_observer.model.rebounds.power_law import PowerLaw

TEXT = """
name: ball
bodies: [{name: z, mass: 1}]
stops: [{name: floor, body: z, limit: 0, side: below, restitution: CURVE}]
"""
POWER = "{value: 0.7, speed: 2, exponent: -0.25}"


def test_power_law_has_its_value_at_its_speed_and_its_limit_below() -> None:
    """The closed form, and 0.95 for slow impacts where no limit is given."""
    contact = parse_model(TEXT.replace("CURVE", POWER), "ball").system.contacts[0]
    assert isinstance(contact.rebound, PowerLaw)
    found = contact.rebound.restitution_at(np.array([0.0, 1e-300, 2.0, 32.0]))
    np.testing.assert_allclose(found, [0.95, 0.95, 0.7, 0.35], rtol=1e-15)
    assert contact.restitution == 0.7


def test_power_law_survives_the_text_of_its_model() -> None:
    """In elements and in matrices."""
    model = parse_model(TEXT.replace("CURVE", POWER), "ball")
    assert parse_model(model.text(), "again").text() == model.text()
    matrices = type(model)(model.system)
    again = parse_model(matrices.text(), "again").system.contacts[0].rebound
    assert again is not None
    speeds = np.linspace(0, 5, 40)
    own = model.system.contacts[0].rebound
    assert own is not None
    np.testing.assert_array_equal(again.restitution_at(speeds), own.restitution_at(speeds))


@examples(100)
@given(st.floats(0, 1), st.floats(0.01, 10), st.floats(-0.999, 0), st.floats(0, 0.99), st.data())
def test_impact_by_a_power_law_does_not_raise_the_difference_of_two_speeds(
    value: float, speed: float, exponent: float, limit: float, data: st.DataObject
) -> None:
    """``|eps(v) v - eps(w) w| <= |v - w|``: what is proved of one contact."""
    law = PowerLaw(value, speed, exponent, limit)
    v, w = np.array(data.draw(st.tuples(st.floats(0, 20), st.floats(0, 20))))
    after = abs(float(law.restitution_at(v) * v - law.restitution_at(w) * w))
    assert after <= abs(v - w) * (1 + 1e-12) + 1e-14


@pytest.mark.parametrize("law", [ConstantRestitution(0.7), PowerLaw(0.7, 1.0, -0.25, 0.9)])
@pytest.mark.parametrize("gamma", [-8.0, -1.7, -0.3, -0.05, 0.3])
def test_slope_and_sensitivity_of_a_rebound_are_those_of_finite_differences(
    law: ReboundLaw, gamma: float
) -> None:
    """Of ``r`` by the speed and by each parameter."""
    h, at = 1e-6, np.array(gamma)
    found = float(np.diff(law.rebound(gamma + np.array([-h, h])))[0]) / (2 * h)
    assert law.slope(at) == pytest.approx(found, abs=1e-8)
    values = np.array([each.value for each in law.parameters])
    by = [
        float(law.with_values((values + step).tolist()).rebound(at) - law.rebound(at)) / h
        for step in h * np.eye(values.size)
    ]
    assert law.sensitivity(at) == pytest.approx(by, abs=1e-4)
