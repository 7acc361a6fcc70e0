# SPDX-License-Identifier: Apache-2.0
"""Times since the epoch that keep what a float rounds."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer import (
    ImpactEvent,
    Plant,
    Switch,
    grid,
    make_observer,
    read_model,
    replay,
    simulate,
)
from impact_observer.errors import UsageError
from impact_observer.stamps import NS_PER_S, Elapsed, from_seconds

DAY = 86_400 * NS_PER_S


@given(ns=st.integers(0, 10**4 * DAY), seconds=st.floats(-10.0, 10.0))
@examples(100)
def test_elapsed_times_keep_what_a_float_rounds(ns: int, seconds: float) -> None:
    """Sums and differences are as accurate as the seconds that are added."""
    begin = Elapsed(ns, 1e-10)
    later = begin + seconds
    assert isinstance(later, Elapsed)
    assert math.isclose(later - begin, seconds, rel_tol=1e-15, abs_tol=1e-24)
    assert math.isclose(begin - (begin - seconds), seconds, rel_tol=1e-15, abs_tol=1e-24)


def test_elapsed_times_are_numbers_of_seconds() -> None:
    """To all that needs no more digits."""
    begin: float = Elapsed(3 * NS_PER_S // 2)
    assert begin == 1.5
    assert hash(begin) == hash(1.5)
    assert 2 * begin == 3.0
    assert (begin + np.array([0.0, 1.0])).tolist() == [1.5, 2.5]
    assert (begin - np.array([0.0, 1.0])).tolist() == [1.5, 0.5]


def test_elapsed_times_that_differ_by_less_than_a_float_shows_are_not_equal() -> None:
    """So nothing that is kept for one is taken for the other."""
    one, other = Elapsed(DAY), Elapsed(DAY, 1e-13)
    assert float(one) == float(other)
    assert one != other


def test_seconds_given_as_stamps_are_one_line_that_says_what_is_expected() -> None:
    """In events, epochs, estimates, grids and runs; integers of numpy are stamps."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=NS_PER_S)
    observer = make_observer(model.system)
    stop = (Switch("stop"),)
    for wrong in (
        lambda: ImpactEvent(1.5, stop),  # type: ignore[arg-type]
        lambda: ImpactEvent(NS_PER_S, stop, epoch=1.0),  # type: ignore[arg-type]
        lambda: observer.estimate(1.5),  # type: ignore[arg-type]
        lambda: grid(0.0, 1.0, 10.0),  # type: ignore[arg-type]
        lambda: Plant(model.system, *model.initial_state(), epoch=1.0),  # type: ignore[arg-type]
        lambda: simulate(plant, np.array([1.5])),
        lambda: list(replay(observer, [], np.array([1.5]))),
    ):
        with pytest.raises(
            UsageError, match=r"expected whole nanoseconds, an int, such as"
        ) as why:
            wrong()
        assert "\n" not in str(why.value)
    with pytest.raises(UsageError, match=r"expected a tuple of Switch"):
        ImpactEvent(NS_PER_S, ("stop",))  # type: ignore[arg-type]
    assert type(ImpactEvent(np.int64(NS_PER_S), stop).stamp) is int
    with pytest.raises(UsageError, match="kind"):
        Switch("stop", "CLOSE")  # type: ignore[arg-type]


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan, math.inf])
def test_a_grid_needs_a_rate(rate: float) -> None:
    """Above zero, and finite."""
    with pytest.raises(UsageError, match="rate"):
        grid(0, NS_PER_S, rate)


def test_a_grid_of_a_rate_near_zero_has_its_start() -> None:
    """The period is no number of nanoseconds."""
    for rate in (1e-308, 5e-324, 1e-12):
        assert grid(7, 10 * NS_PER_S, rate).tolist() == [7]


def test_a_length_without_nanoseconds_is_one_line() -> None:
    """Such as --duration 1e308."""
    with pytest.raises(UsageError, match=r"1e\+308 s"):
        from_seconds(1e308)


def test_stamps_of_a_run_ascend() -> None:
    """A plant does not go back; two may be equal."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=NS_PER_S)
    with pytest.raises(UsageError, match="stamps"):
        simulate(plant, grid(NS_PER_S, 2 * NS_PER_S, 10.0)[::-1])
    first = NS_PER_S + 1_000_000
    states = simulate(plant, np.array([first, first, 2 * NS_PER_S])).states
    np.testing.assert_array_equal(states[0], states[1])
