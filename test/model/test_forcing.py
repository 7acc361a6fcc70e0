# SPDX-License-Identifier: Apache-2.0
"""A forcing: its derivatives, bounds, knots and end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import Harmonic, examples, forcing, forcings, matrices, numbers, vectors

from impact_observer.errors import DynamicsError, ModelError
from impact_observer.model import Forcing
from impact_observer.model.force_samples import Samples

TIME = np.array([-1.0, 0.0, 0.5, 2.0])
FORCE = np.array([[1.0, 0.0], [2.0, -3.0], [0.0, 1.0], [4.0, 4.0]])


def sampled(hold: str) -> Forcing:
    """Four samples of two forces."""
    return Forcing.of_samples(Samples(TIME, FORCE, hold))


@st.composite
def any_forcing(draw: st.DrawFn, n: int) -> Forcing:
    """All parts at once."""
    smooth = draw(forcings(n))
    steps = draw(st.lists(numbers(1 / 64, 2.0), min_size=3, max_size=6))
    time = np.concatenate([[-1.0], -1.0 + np.cumsum(steps)])
    force = np.array([draw(vectors(n)) for _ in time])
    samples = Samples(time, force, draw(st.sampled_from(["previous", "linear"])))
    return Forcing(smooth.constant, smooth.frequency, smooth.cosine, smooth.sine, samples)


def test_derivatives_of_harmonics_are_those_of_sine_and_cosine() -> None:
    """Written out for one harmonic beside a constant."""
    f = forcing(2, [5.0, 6.0], [Harmonic(2.0, [3.0, 0.0], [0.0, 7.0])])
    t = np.array([0.0, 0.4, 1.3])
    c, s = np.cos(2 * t), np.sin(2 * t)
    first = [5 + 3 * c, -6 * s, -12 * c, 24 * s]
    second = [6 + 7 * s, 14 * c, -28 * s, -56 * c]
    found = f.derivatives(t, 3)
    np.testing.assert_allclose(found, np.stack([first, second], axis=-1), atol=1e-13)
    np.testing.assert_allclose(f(0.4), found[0, 1], rtol=1e-15)


def test_samples_are_held_or_joined_by_lines() -> None:
    """At a sample the value and the slope are those from there on."""
    t = np.array([-1.0, -0.5, 0.0, 0.25, 0.5, 1.0, 2.0])
    held, joined = sampled("previous"), sampled("linear")
    rows = [0, 0, 1, 1, 2, 2, 3]
    np.testing.assert_array_equal(held.derivatives(t, 2)[0], FORCE[rows])
    assert not np.any(held.derivatives(t, 2)[1:])
    expected = np.stack([np.interp(t, TIME, column) for column in FORCE.T], axis=1)
    slopes = np.diff(FORCE, axis=0) / np.diff(TIME)[:, None]
    np.testing.assert_allclose(joined.derivatives(t, 2)[0], expected, rtol=1e-15)
    np.testing.assert_allclose(
        joined.derivatives(t, 2)[1], [*slopes[[0, 0, 1, 1, 2, 2]], [0.0, 0.0]]
    )
    assert not np.any(joined.derivatives(t, 2)[2])
    assert joined(0.25).tolist() == [1.0, -1.0]


@pytest.mark.parametrize("hold", ["previous", "linear"])
def test_knot_that_was_rounded_is_the_knot(hold: str) -> None:
    """A phase's start plus the seconds to a sample may be just below it: the sample counts."""
    f = sampled(hold)
    t = np.array([np.nextafter(0.5, 0.0)])
    np.testing.assert_allclose(f(float(t[0])), f(0.5), rtol=1e-14, atol=1e-15)
    assert f.derivatives(t, 1)[1].tolist() == f.derivatives(np.array([0.5]), 1)[1].tolist()
    bound = f.bound(np.eye(2))
    assert bound(1, t) == bound(1, np.array([0.5]))
    assert f.knots(float(t[0]), 3.0).tolist() == [2.0]


def test_knots_are_the_samples_strictly_inside() -> None:
    """A smooth forcing has none and never ends."""
    f = sampled("linear")
    assert f.knots(-1.0, 2.0).tolist() == [0.0, 0.5]
    assert f.knots(0.0, 0.5).tolist() == []
    assert f.knots(0.1, 7.0).tolist() == [0.5, 2.0]
    assert f.end == 2.0
    assert f.depends_on_time
    smooth = forcing(2, 1.0, [Harmonic(2.0, [1, 0], [0, 1])])
    assert smooth.knots(0.0, 10.0).size == 0
    assert smooth.end == np.inf


@examples(40)
@given(st.data())
def test_bound_holds_up_to_the_next_knot(data: st.DataObject) -> None:
    """For every derivative, in any seminorm, from any instant."""
    n = data.draw(st.integers(1, 3))
    f = data.draw(any_forcing(n))
    root = data.draw(matrices(2, n))
    X = root.T @ root
    t = data.draw(numbers(0.0, 1.0)) * (f.end + 1.0) - 1.0
    stop = min([*f.knots(t, f.end), f.end])
    fine = np.linspace(t, stop, 50)[:-1]
    derivatives = f.derivatives(fine, 4)
    sizes = np.sqrt(np.maximum(np.einsum("ksi,ij,ksj->ks", derivatives, X, derivatives), 0.0))
    bound = f.bound(X)
    for k in range(5):
        assert np.max(sizes[k]) <= bound(k, np.array([t]))[0] * (1 + 1e-12) + 1e-12
        assert bound(k, fine).shape == fine.shape


def test_last_sample_is_held_and_nothing_is_before_the_first() -> None:
    """An error in one line names the instant and where the samples begin."""
    for hold in ("previous", "linear"):
        f = sampled(hold)
        assert f(2.0 + 5e-10).tolist() == f(70.0).tolist() == [4.0, 4.0]
        assert not np.any(f.derivatives(np.array([2.0, 9.0]), 3)[1:])
        with pytest.raises(DynamicsError, match=r"the samples begin at t = -1 s, .* = -1.5 s"):
            f.derivatives(np.array([0.0, -1.5]), 1)


@pytest.mark.slow
@examples(30)
@given(st.data())
def test_sum_of_two_forcings_is_the_sum_at_every_instant(data: st.DataObject) -> None:
    """With samples at any instants, held or linear; derivatives too, from the right."""
    n = data.draw(st.integers(1, 3))
    one, other = data.draw(any_forcing(n)), data.draw(any_forcing(n))
    t = np.sort(np.concatenate([np.linspace(-1.0, 9.0, 31), one.knots(-1, 9), [one.end]]))
    found = one.added(other).derivatives(t, 3)
    expected = one.derivatives(t, 3) + other.derivatives(t, 3)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@examples(30)
@given(st.data())
def test_response_is_made_of_a_forcing_and_its_derivatives(data: st.DataObject) -> None:
    """``P f + Q df/dt + R d2f/dt2``, for cubics as well."""
    n, r = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 3))
    f = data.draw(any_forcing(n))
    P, Q, R = (data.draw(matrices(r, n)) for _ in range(3))
    t = np.linspace(-1.0, f.end + 1.0, 23)
    jets = f.derivatives(t, 2)
    expected = jets[0] @ P.T + jets[1] @ Q.T + jets[2] @ R.T
    size = 1.0 + np.max(np.abs(jets))
    np.testing.assert_allclose(
        f.responded(P, Q, R).derivatives(t, 0)[0], expected, atol=1e-12 * size
    )


def test_spacing_that_is_even_but_for_rounding_is_even() -> None:
    """Printed times differ in their last bits; one step then serves all."""
    time = np.array([float(f"{k * 1e-3:.3f}") for k in range(2000)])
    assert np.unique(np.diff(time)).size > 1
    assert np.unique(Samples(time, np.zeros((2000, 1)), "linear").steps).size == 1
    assert np.unique(Samples(TIME, FORCE, "linear").steps).size == 3


@pytest.mark.parametrize(
    ("time", "force", "hold", "message"),
    [
        ([0.0], [[1.0]], "linear", "forcing.sampled.time"),
        ([0, 2, 1], [[1]] * 3, "linear", "forcing.sampled.time"),
        ([0, 1, 1], [[1]] * 3, "linear", "forcing.sampled.time"),
        ([0.5, 1], [[1]] * 2, "linear", "forcing.sampled.time"),
        ([0, np.nan], [[1]] * 2, "linear", r"forcing.sampled.time\[1\]: is not finite"),
        ([0, 1], [[1], [np.inf]], "linear", r"forcing.sampled.force\[1\]\[0\]: is not finite"),
        ([0, 1], [[1]] * 3, "linear", "forcing.sampled.force"),
        ([0, 1], [1, 2], "linear", "forcing.sampled.force"),
        ([0, 1], [[1]] * 2, "cubic", "forcing.hold"),
    ],
)
def test_invalid_samples_are_named_by_their_key(
    time: list[float], force: list[list[float]], hold: str, message: str
) -> None:
    """The same checks hold for samples that no file describes."""
    with pytest.raises(ModelError, match=message):
        Samples(np.array(time), np.array(force), hold)


def test_samples_have_a_column_for_each_coordinate() -> None:
    """A system refuses others, and takes them beside constants and harmonics."""
    samples = Samples(TIME, FORCE, "linear")
    assert Forcing.of_samples(samples).plus(np.ones(2)).checked(2).sampled is samples
    with pytest.raises(ModelError, match=r"forcing.sampled.force"):
        Forcing(np.zeros(3), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), samples).checked(3)
