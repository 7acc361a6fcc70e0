# SPDX-License-Identifier: Apache-2.0
"""Declared uncertainty: read, checked, and spread over replicas."""

from typing import Any

import numpy as np
import pytest
from systems import sample

from impact_observer.errors import UsageError
from impact_observer.model import parse_model
from impact_observer.observer import Options, make_observer
from impact_observer.observer.uncertainty import (
    Uncertainty,
    covariance_root,
    deviation_of,
    spread,
    suggested_deviation,
)

SYSTEM = sample("two_mass").system


def test_deviation_is_one_number_or_one_for_each_state() -> None:
    """The same for all, or q1,..,qn,u1,..,un."""
    assert deviation_of("0.5", SYSTEM).tolist() == [0.5] * 4
    assert deviation_of("1,2,3,0", SYSTEM).tolist() == [1.0, 2.0, 3.0, 0.0]


@pytest.mark.parametrize("text", ["", "1,2", "a", "-1", "nan", "inf", "1,2,3,4,5", "1,,2,3"])
def test_wrong_deviation_is_refused_in_one_line(text: str) -> None:
    """Naming what was found and what is expected."""
    with pytest.raises(
        UsageError, match="expected one number from 0 to 1e\\+09, or 4 of them"
    ) as info:
        deviation_of(text, SYSTEM)
    assert repr(text) in str(info.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("deviation", -1.0),
        ("deviation", 1e10),
        ("clock_error", -1e-3),
        ("clock_error", 0.5),
        ("model_error", float("nan")),
        ("model_error", 1e7),
    ],
)
def test_uncertainty_checks_itself(name: str, value: float) -> None:
    """By name, with what was found."""
    wrong: dict[str, Any] = {name: value}
    with pytest.raises(UsageError, match=f"{name}: .* found; expected 0 to "):
        Uncertainty(**wrong)


def test_options_name_what_cannot_be_used() -> None:
    """The law, the initial state, the size of a deviation, an ensemble of none."""
    for options, message in (
        (Options(law="none"), "law 'none': not installed"),
        (Options(initial_state="1,2"), "initial state '1,2'"),
        (Options(initial_deviation="1,2"), "deviation '1,2'"),
    ):
        with pytest.raises(UsageError, match=message):
            make_observer(SYSTEM, options)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("ensemble", 0, "a whole number, 1 to 1000000"),
        ("ensemble", 1.5, "a whole number"),
        ("ensemble", True, "a whole number"),
        ("epoch", -1, "a whole number, 0 to 2147483647999999999 ns"),
        ("clock_error", float("nan"), "-1 to 0.1 s"),
        ("clock_error", "a", "-1 to 0.1 s"),
        ("initial_deviation", 2.0, "a text"),
        ("estimate_parameters", "restitution", "a tuple of texts"),
    ],
)
def test_an_option_of_the_wrong_type_or_out_of_range_is_refused(
    name: str, value: object, expected: str
) -> None:
    """Whoever makes the options."""
    given: dict[str, Any] = {name: value}
    with pytest.raises(UsageError, match=f"^option {name}: .* found; expected ") as error:
        Options(**given)
    assert expected in str(error.value)


def test_covariance_has_a_root() -> None:
    """Also where it is singular, and given row by row."""
    root = np.array([[1.0, 0, 0, 0], [2, 1, 0, 0], [0, 0, 0, 0], [1, 0, 3, 0]])
    found = covariance_root((root @ root.T).ravel(), 2)
    np.testing.assert_allclose(found @ found.T, root @ root.T, atol=1e-14)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        ([1.0] * 9, r"9 numbers; expected 16 of at most 1e\+18, 4 x 4"),
        ([float("inf")] * 16, "expected 16 of at most"),
        (1e307 * np.eye(4), "expected 16 of at most"),
        (np.triu(np.ones((4, 4))).ravel(), "not symmetric"),
        (-np.eye(4).ravel(), "has the eigenvalue -1"),
    ],
)
def test_wrong_covariance_is_refused_in_one_line(covariance: object, message: str) -> None:
    """Of the wrong size, not finite, not symmetric, not semidefinite."""
    with pytest.raises(UsageError, match=message):
        covariance_root(covariance, 2)  # type: ignore[arg-type]


def test_replicas_are_spread_as_declared() -> None:
    """The first is the state itself; mean and covariance of the others are those declared."""
    x, root = np.array([1.0, -2.0]), np.array([[2.0, 0.0], [1.0, 0.5]])
    for count in (4, 10, 2001):
        found = spread(x, root, count)
        np.testing.assert_array_equal(found[0], x)
        np.testing.assert_allclose(found[1:].mean(axis=0), x, atol=1e-13)
        np.testing.assert_allclose(np.cov(found[1:].T, ddof=0), root @ root.T, atol=1e-12)


def test_few_replicas_are_spread_as_far() -> None:
    """Fewer than directions: their mean square distance is that of many."""
    for count in (2, 3, 5):
        found = spread(np.zeros(8), np.eye(8), count)
        assert len({x.tobytes() for x in found}) == count
        if count > 2:
            assert np.mean(np.sum(found[1:] ** 2, axis=1)) == pytest.approx(8.0)
    assert spread(np.zeros(8), np.eye(8), 1).shape == (1, 8)


@pytest.mark.parametrize(
    ("limit", "more", "expected"),
    [
        (0.001, "", "0.003,0.03"),  # sqrt(10 / 0.1) = 10 rad/s
        (-0.001, "", "0.003,0.03"),
        (0.001, "forces: [{body: x, amplitude: 1, frequency: 200}]", "0.003,0.6"),
        (0.2, "", ""),
        (0.2, "forces: [{body: x, amplitude: 1, frequency: 200}]", "0.6,1e+02"),
        (40, "", "1e+02,1e+03"),
        (0, "", ""),
    ],
)
def test_a_deviation_is_suggested_for_a_rig_of_another_size(
    limit: float, more: str, expected: str
) -> None:
    """Three times its gap, at the frequency of what moves it; it can be used as it is."""
    text = f"""
name: rig
bodies: [{{name: x, mass: 0.1}}]
springs: [{{between: [ground, x], stiffness: 10}}]
stops: [{{name: stop, body: x, limit: {limit}, side: above, restitution: 0.5}}]
{more}"""
    system = parse_model(text, "rig.yaml").system
    assert suggested_deviation(system) == expected
    if expected:
        assert deviation_of(expected, system).tolist() == [float(x) for x in expected.split(",")]
    free = parse_model(text.replace("stiffness: 10", "stiffness: 0"), "free.yaml").system
    assert suggested_deviation(free) == (expected if more else "")
