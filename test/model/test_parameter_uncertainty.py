# SPDX-License-Identifier: Apache-2.0
"""How well parameters are known: what is read, what is written, and each mistake in one line."""

import numpy as np
import pytest

from impact_observer.errors import ModelError
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


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (
            "restitution.stop,",
            "restitution.wall,",
            "uncertainty.names: parameter 'restitution.wall': this model has none",
        ),
        ("restitution.stop,", "restitution,", "a kind; expected single parameters: restitution."),
        ("restitution.stop,", "clock-offset,", "expected parameters of the model, not of a clock"),
        ("restitution.stop,", "stiffness-scale,", "found twice; name it once"),
        ("restitution.stop,", "stiffness.ground-a,", "stands beside stiffness; free one of them"),
        ("[1.0e-4, 2.0e-6]", "[1.0e-4, 3.0e-6]", "uncertainty.covariance: is not symmetric: [0]"),
        ("[[1.0e-4, 2.0e-6], [2.0e-6,", "[[1.0e-4, 3.0e-5], [3.0e-5,", "positive semidefinite"),
        ("[1.0e-4, 2.0e-6]", "[-1.0e-4, 2.0e-6]", "uncertainty.covariance[0][0]: is -0.0001"),
        ("[1.0e-4, 2.0e-6]", "[0, 2.0e-6]", "is not positive semidefinite"),
        ("[1.0e-4, 2.0e-6], ", "", "uncertainty.covariance: 1 rows found; expected 2 rows"),
        ("1000000000", "1.5", "uncertainty.fitted_to.first: 1.5 found; expected a stamp, whole"),
        ("1000000000", "62000000000", "uncertainty.fitted_to: 62000000000 to 61000000001 found"),
        ("fitted_to", "fitted", "uncertainty.fitted: is not known here"),
    ],
)
def test_each_mistake_in_an_uncertainty_is_one_line(old: str, new: str, line: str) -> None:
    """The line names file, key and what is expected."""
    assert UNCERTAIN.count(old) == 1
    with pytest.raises(ModelError) as caught:
        parse_model(ELEMENTS + UNCERTAIN.replace(old, new), "pair.yaml")
    assert str(caught.value).startswith("pair.yaml: uncertainty")
    assert line in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_rounding_of_printed_digits_is_no_mistake() -> None:
    """A singular covariance of ten digits and very different units is accepted, and symmetric."""
    root = np.array([[1e-9, 0.0], [3e3, 1e-6]])
    printed = [[float(f"{each:.10g}") for each in row] for row in (root @ root.T).tolist()]
    known = ParameterUncertainty(("gap.a", "stiffness.b"), np.array(printed))
    np.testing.assert_array_equal(known.covariance, known.covariance.T)
