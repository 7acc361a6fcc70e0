# SPDX-License-Identifier: Apache-2.0
"""How well parameters are known: what is read and written."""

import numpy as np
import pytest

from impact_observer.model import parse_model
from impact_observer.model.parameter_uncertainty import ParameterUncertainty

ELEMENTS = """\
name: pair
bodies:  [{name: a, mass: 1}, {name: b, mass: 1}]
springs: [{between: [ground, a], stiffness: 10, damping: 0.1}]
forces:  [{body: b, amplitude: 4, frequency: 2.5, phase: 0}, {body: a, constant: 1}]
stops:   [{name: stop, body: b, limit: 0.5, side: above, restitution: 0.7}]
"""
UNCERTAIN = """\
uncertainty:
  names: [restitution.stop, stiffness-scale]
  covariance: [[1.0e-4, 2.0e-6], [2.0e-6, 4.0e-6]]
  fitted_to: {first: 1000000000, last: 61000000001}
"""


def test_a_covariance_is_read_and_written() -> None:
    """A model and its own text have the same covariance, and stamps to the nanosecond."""
    model = parse_model(ELEMENTS + UNCERTAIN, "pair")
    again = parse_model(model.text(), "again")
    for known in (model.uncertainty, again.uncertainty):
        assert known is not None
        assert known.names == ("restitution.stop", "stiffness-scale")
        np.testing.assert_array_equal(known.covariance, [[1e-4, 2e-6], [2e-6, 4e-6]])
        np.testing.assert_allclose(known.deviations, [0.01, 0.002], rtol=1e-15)
        assert known.fitted_to == (1_000_000_000, 61_000_000_001)


def test_a_model_that_says_nothing_has_no_uncertainty_and_exact_values_have_a_zero_one() -> None:
    """Nothing declared is another thing than a declared zero."""
    assert parse_model(ELEMENTS, "pair").uncertainty is None
    exact = ELEMENTS + "uncertainty: {names: [gap.stop], covariance: [[0]]}\n"
    known = parse_model(exact, "pair").uncertainty
    assert known is not None
    assert known.names == ("gap.stop",)
    assert known.deviations.tolist() == [0.0]
    assert known.fitted_to is None


def test_a_deviation_below_the_rounding_of_motions_counts_as_exact() -> None:
    """In either form, and with it the covariances."""
    tiny = ELEMENTS.replace("limit: 0.5", "limit: {value: 0.5, deviation: 1e-30}")
    covariance = "[[1.0e-4, 1.0e-18], [1.0e-18, 4.0e-32]]"
    given = "[[1.0e-4, 2.0e-6], [2.0e-6, 4.0e-6]]"
    known = parse_model(tiny + UNCERTAIN.replace(given, covariance), "pair").uncertainty
    assert known is not None
    assert known.names == ("restitution.stop", "stiffness-scale", "gap.stop")
    np.testing.assert_array_equal(known.covariance, np.diag([1e-4, 0.0, 0.0]))


def test_rounding_of_printed_digits_is_no_mistake() -> None:
    """A singular covariance of ten digits and very different units is accepted, and symmetric."""
    root = np.array([[1e-9, 0.0], [3e3, 1e-6]])
    printed = [[float(f"{each:.10g}") for each in row] for row in (root @ root.T).tolist()]
    known = ParameterUncertainty(("gap.a", "stiffness.b"), np.array(printed))
    np.testing.assert_array_equal(known.covariance, known.covariance.T)


EVERY_NUMBER = """\
name: every_number
bodies: [{name: a, mass: MASS}, {name: b, mass: 1}]
grounds: [{name: table, motion: {harmonics: [{amplitude: GROUND, frequency: 9, phase: 0.1}]}}]
springs: [{between: [ground, a], stiffness: SPRING, damping: DAMPER}]
forces:
  - {body: b, input: motor}
  - {body: b, amplitude: FORCE, frequency: FREQUENCY, phase: PHASE}
  - {body: a, constant: CONSTANT}
stops:
  - {name: up, body: b, limit: LIMIT, side: above, restitution: RESTITUTION}
  - {name: low, body: b, limit: -0.4, side: below, restitution: LOW}
"""
NUMBERS = {
    "MASS": ("mass.a", 2.0, 0.1, 0.1),
    "GROUND": ("ground-amplitude.table.1", 0.004, 0.001, 0.25),
    "SPRING": ("stiffness.ground-a", 30.0, 0.5, 0.5),
    "DAMPER": ("damping.ground-a", 0.2, 0.01, 0.01),
    "FORCE": ("forcing-amplitude.1", -4.0, 0.2, 0.05),
    "FREQUENCY": ("forcing-frequency.1", 2.5, 0.02, 0.02),
    "PHASE": ("forcing-phase.1", 0.3, 0.05, 0.05),
    "CONSTANT": ("constant-force.a", -1.5, 0.3, 0.3),
    "LIMIT": ("gap.up", 0.5, 0.002, 0.002),
    "RESTITUTION": ("restitution.up", 0.7, 0.01, 0.01),
}
"""By the word that stands for it: parameter, number, its deviation, that of the parameter."""
LOW = "{value: 0.6, speed: 1, exponent: -0.1}"


def with_numbers(text: str, uncertain: str = "") -> str:
    """The text with its numbers, the one of the word ``uncertain`` with a deviation."""
    for word, (_, value, deviation, _) in NUMBERS.items():
        given = f"{{value: {value}, deviation: {deviation}}}" if word == uncertain else str(value)
        text = text.replace(word, given)
    return text.replace("LOW", LOW)


@pytest.mark.parametrize("word", NUMBERS)
def test_a_deviation_may_stand_beside_any_number(word: str) -> None:
    """The system is that of the number alone, and the parameter of its name has the deviation."""
    name, _, _, deviation = NUMBERS[word]
    text = EVERY_NUMBER if word == "GROUND" else EVERY_NUMBER.replace("grounds:", "# grounds:")
    model, plain = (parse_model(with_numbers(text, each), "m") for each in (word, ""))
    assert plain.uncertainty is None
    known = model.uncertainty
    assert known is not None
    assert known.names == (name,)
    np.testing.assert_allclose(known.deviations, [deviation], rtol=1e-12)
    assert model.text().startswith(plain.text())
    again = parse_model(model.text(), "again").uncertainty
    assert again is not None
    assert again.names == known.names
    np.testing.assert_array_equal(again.covariance, known.covariance)


@pytest.mark.parametrize(
    ("restitution", "names"),
    [
        ("{value: 0.6, deviation: 0.02, speed: 1, exponent: -0.1}", ["restitution.low"]),
        (
            "{value: 0.6, deviation: 0.02, speed: 1, exponent: {value: -0.1, deviation: 0.02}}",
            ["restitution.low", "restitution-exponent.low"],
        ),
        ("{value: {value: 0.6, deviation: 0.02}, speed: 1, exponent: -0.1}", ["restitution.low"]),
    ],
)
def test_a_restitution_by_speed_takes_a_deviation_as_a_further_key(
    restitution: str, names: list[str]
) -> None:
    """Also the exponent has one."""
    text = EVERY_NUMBER.replace("grounds:", "# grounds:").replace("LOW", restitution)
    model = parse_model(with_numbers(text), "m")
    assert model.uncertainty is not None
    assert sorted(model.uncertainty.names) == sorted(names)
    np.testing.assert_allclose(model.uncertainty.deviations, 0.02, rtol=1e-12)
    law = model.system.rebounds[1]
    assert [each.value for each in law.parameters] == [0.6, -0.1]


MATRICES = """\
name: matrices
coordinates: [x1, x2]
mass:      [[1, 0], [0, 1]]
damping:   [[0.2, -0.1], [-0.1, 0.1]]
stiffness: [[20, -10], [-10, 10]]
forcing:
  constant: [0, {value: 1.5, deviation: 0.2}]
  harmonics: [{frequency: {value: 2.5, deviation: 0.01}, cosine: [0, 4], sine: [0, 0]}]
contacts: [{name: stop, direction: [0, -1], gap: {value: 0.5, deviation: 0.003}, restitution: 0.7}]
uncertainty: {names: [mass-scale], covariance: [[0.0001]]}
"""


def test_both_forms_go_together() -> None:
    """In matrices, with a covariance of another parameter; errors are independent."""
    model = parse_model(MATRICES, "matrices")
    known = model.uncertainty
    assert known is not None
    deviations = dict(zip(known.names, known.deviations.tolist(), strict=True))
    assert deviations == pytest.approx(
        {
            "mass-scale": 0.01,
            "gap.stop": 0.003,
            "constant-force.x2": 0.2,
            "forcing-frequency.1": 0.01,
        }
    )
    assert np.count_nonzero(known.covariance) == 4
    again = parse_model(model.text(), "again")
    assert again.uncertainty is not None
    np.testing.assert_array_equal(again.uncertainty.covariance, known.covariance)
    np.testing.assert_array_equal(again.system.forcing.constant, [0, 1.5])
