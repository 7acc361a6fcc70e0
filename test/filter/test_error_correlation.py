# SPDX-License-Identifier: Apache-2.0
"""Correlated errors of samples: by how much an estimate of what scales the motion is wider."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from impact_observer.filter.error_correlation import ErrorCorrelation

Array = NDArray[np.float64]
PERIOD = 0.005
COUNT = 2 * np.pi / 2000


def instants(count: int) -> Array:
    """Instants of so many samples, s."""
    return np.asarray(PERIOD * np.arange(count), dtype=np.float64)


def motion(t: Array) -> Array:
    """A periodic motion of 1.5 Hz with a harmonic."""
    return np.asarray(0.5 * np.sin(3 * np.pi * t) + 0.2 * np.sin(6 * np.pi * t + 1.0))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(50, 12000), st.floats(0.0, 0.4))
def test_white_errors_are_not_widened(seed: int, size: int, left_out: float) -> None:
    """Of whatever distribution and number, with gaps in the recording."""
    rng = np.random.default_rng(seed)
    kept = rng.random(size) >= left_out
    t = instants(size)[kept]
    for errors in (rng.normal(size=t.size), rng.uniform(-1, 1, t.size)):
        assert ErrorCorrelation.of_errors(t, errors, motion(t)).factor < 1.03


@pytest.mark.parametrize("alike", [0.5, 0.9, -0.5])
def test_correlated_errors_are_widened_as_the_scatter_of_estimates_is(alike: float) -> None:
    """The oracle: least squares of size and mean of the motion, over many draws of the errors."""
    rng, t = np.random.default_rng(5), instants(4000)
    weights = np.column_stack(
        [motion(t) / np.linalg.norm(motion(t)), np.full(t.size, t.size**-0.5)]
    )
    draws = lfilter([1.0], [1.0, -alike], rng.normal(size=(400, t.size + 200)))[:, 200:]
    true = max(*np.std(draws @ weights, axis=0) / np.std(draws), 1.0)
    found = [ErrorCorrelation.of_errors(t, each, motion(t)).factor for each in draws[:20]]
    assert np.median(found) == pytest.approx(true, rel=0.15)


@pytest.mark.parametrize("repetitions", [5, 30])
def test_errors_that_repeat_with_the_motion_do_not_average_out(repetitions: int) -> None:
    """Sampled at 400 instants of three periods, an encoder says no more when these come again."""
    t = instants(400 * repetitions)
    values = COUNT * np.rint(motion(t) / COUNT)
    found = ErrorCorrelation.of_errors(t, values - motion(t), values)
    assert found.factor == pytest.approx(np.sqrt(repetitions), rel=0.2)
    assert found.lag == pytest.approx(400 * PERIOD)
    assert found.count == pytest.approx(COUNT)
    assert "coarse encoder" in found.warning("encoder")


def test_the_error_of_a_coarse_encoder_is_within_the_widened_deviations() -> None:
    """At rates at which samples hardly ever repeat, errors of counts do not average out either."""
    ratios = []
    for rate in np.linspace(0.91, 1.09, 12).tolist():
        t = rate * instants(6000)
        values = COUNT * np.rint(motion(t) / COUNT)
        errors, weights = values - motion(t), motion(t) / np.linalg.norm(motion(t))
        wide = ErrorCorrelation.of_errors(t, errors, values).factor * np.std(errors)
        ratios.append(abs(weights @ errors) / wide)
    assert np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_errors_that_are_larger_than_counts_are_not_those_of_an_encoder() -> None:
    """An error of the model beside the quantisation is no count."""
    t = instants(4000)
    values = COUNT * np.rint(motion(t) / COUNT)
    errors = values - motion(t) + 0.01 * np.sin(6 * np.pi * t)
    found = ErrorCorrelation.of_errors(t, errors, values)
    assert found.count == 0.0
    assert found.factor > 3.0
    assert "are correlated" in found.warning("encoder")
