# SPDX-License-Identifier: Apache-2.0
"""Predicted penetrations, and missed impacts."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import linalg
from systems import (
    Harmonic,
    chain,
    examples,
    forcing,
    system,
    systems,
    vectors,
    without_faults,
)

from impact_observer.events import Kind
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.forecast import Dip, Forecast
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.kernel import falls_at
from impact_observer.model import System

Array = NDArray[np.float64]
SECONDS = 6.0
SAMPLES = 6000
DEEP = 1e-4
"""Least depth of a dip that must be found, relative to the largest value of its function."""
COARSE = 1 / 288
"""By which the lowest of 38 samples a period may miss the minimum, relative to an amplitude."""

SWINGING = system(
    np.eye(2),
    np.zeros((2, 2)),
    np.diag([1.0, 4.0]),
    contacts=[([1, 0], 0.9, 0.5), ([0, 1], 5.0, 0.5)],
)
"""Two oscillators of 1 and 2 rad/s, a stop for each."""


def forecast(model: System, t: float, x: Array, root: Array, closed: tuple[int, ...]) -> Forecast:
    """The forecast from ``x`` at ``t`` on."""
    bank = FilterBank(ImpactFilter(model), without_faults())
    return bank.between.forecast(t, GaussianState.of(x[None], root, closed))


class GuardValues(NamedTuple):
    """Values of a gap or a load on a fine grid, by an oracle."""

    contact: int
    kind: Kind
    values: Array


def oracle(
    model: System, t: float, x: Array, closed: int | None
) -> tuple[Array, list[GuardValues], Array]:
    """Instants, guard functions, and the transition of one sample: one matrix exponential.

    The closed contact's load is eliminated by hand: ``G lambda = -W^T M^-1 (f - C u - K q)``.
    """
    n, h, force = model.n, SECONDS / SAMPLES, model.forcing
    inverse = np.linalg.inv(model.M)
    W = model.W[:, [] if closed is None else [closed]]
    G = W.T @ inverse @ W
    taken = np.linalg.solve(G, W.T @ inverse) if W.size else np.zeros((0, n))
    push = inverse - inverse @ W @ taken
    k, count = force.frequency, 2 * n + 1 + 2 * force.frequency.size
    loads = np.hstack([-model.K, -model.C, force.constant[:, None], force.cosine.T, force.sine.T])
    A = np.zeros((count, count))
    A[:n, n : 2 * n], A[n : 2 * n] = np.eye(n), push @ loads
    for j, w in enumerate(k.tolist()):
        cosine, sine = 2 * n + 1 + j, 2 * n + 1 + k.size + j
        A[cosine, sine], A[sine, cosine] = -w, w
    y = np.concatenate([x, [1.0], np.cos(k * t), np.sin(k * t)])
    step = linalg.expm(h * A)
    path, on = y[None], step
    while len(path) <= SAMPLES:
        path, on = np.vstack([path, path @ on.T]), on @ on
    path = path[: SAMPLES + 1]
    watched = [
        GuardValues(i, Kind.IMPACT, path[:, :n] @ model.W[:, i] + model.q_r[i])
        for i in range(model.m)
        if i != closed
    ]
    if closed is not None:
        watched.append(GuardValues(closed, Kind.OPEN, -path @ (taken @ loads)[0]))
    return np.linspace(0.0, SECONDS, SAMPLES + 1), watched, np.asarray(step)


def stretches(values: Array) -> list[tuple[int, int]]:
    """First and last index of each run below zero."""
    below = np.flatnonzero(values < 0)
    runs = np.split(below, np.flatnonzero(np.diff(below) > 1) + 1) if below.size else []
    return [(int(run[0]), int(run[-1])) for run in runs]


def check(dips: list[Dip], found: Forecast, s: Array, each: GuardValues) -> None:
    """Every run below zero that is deep enough is a dip, with its root and its depth."""
    mine = [dip for dip in dips if (dip.contact, dip.kind) == (each.contact, each.kind)]
    size, h = float(np.max(np.abs(each.values))), float(s[1])
    for first, last in stretches(each.values):
        depth = -float(np.min(each.values[first : last + 1]))
        if depth < DEEP * size or first == 0 or last - first < 2:
            continue
        near = [dip for dip in mine if abs(dip.began - s[first] + h / 2) <= h]
        assert len(near) == 1
        (dip,) = near
        assert dip.above < dip.below <= dip.deepest
        deviation = found.deviation(dip.which, dip.deepest)
        assert depth - COARSE * size <= dip.depth * deviation <= 1.001 * depth + 1e-6 * size
        if last < SAMPLES - 2:
            assert dip.over
        elif last == SAMPLES:
            assert not dip.over
    for dip in mine:  # and there is no other
        at = np.interp(dip.deepest, s, each.values)
        assert at <= 1e-5 * size


@given(data=st.data())
@examples(20)
def test_every_dip_of_a_gap_is_found(data: st.DataObject) -> None:
    """Random systems and motions, against a matrix exponential on a grid 30 times finer."""
    model = data.draw(systems(max_n=3, gaps=(0.25, 2.0)))
    x = data.draw(vectors(2 * model.n))
    found = forecast(model, 0.5, x, np.eye(2 * model.n), ())
    s, watched, _ = oracle(model, 0.5, x, None)
    dips = found.dips(SECONDS)
    assert dips == sorted(dips, key=lambda dip: dip.below)
    for each in watched:
        check(dips, found, s, each)


@given(data=st.data())
@examples(12)
def test_every_dip_of_a_load_is_found(data: st.DataObject) -> None:
    """One contact rests: its guard is its load instead of its gap."""
    model = data.draw(systems(max_n=3, contacts=(1, 2), gaps=(0.0, 2.0)))
    n, w = model.n, model.W[:, 0]
    x = data.draw(vectors(2 * n))
    x[:n] -= w * float(model.gap(x[:n])[0]) / (w @ w)
    x[n:] -= w * float(w @ x[n:]) / (w @ w)
    s, watched, _ = oracle(model, 0.5, x, 0)
    found = forecast(model, 0.5, x, np.eye(2 * n), (0,))
    dips = found.dips(SECONDS)
    assert {dip.contact for dip in dips} <= {0, *range(model.m)}
    for each in watched:
        check(dips, found, s, each)


@given(data=st.data())
@examples(8)
def test_depth_is_in_deviations_of_the_function_then(data: st.DataObject) -> None:
    """By the covariance that the oracle's transition propagates, any root of it."""
    model = data.draw(systems(max_n=3, gaps=(0.25, 2.0)))
    n = model.n
    x, values = data.draw(vectors(2 * n)), data.draw(vectors(4 * n * n))
    root = np.reshape(values, (2 * n, 2 * n)) + 3 * np.eye(2 * n)
    found = forecast(model, 0.5, x, root, ())
    s, watched, step = oracle(model, 0.5, x, None)
    values_of = {each.contact: each.values for each in watched}
    for dip in found.dips(SECONDS):
        w = np.concatenate([model.W[:, dip.contact], np.zeros(n)])
        k = round(dip.deepest / s[1])
        carried = np.linalg.matrix_power(step, k)[: 2 * n, : 2 * n]
        deviation = float(np.linalg.norm(w @ carried @ root))
        value = float(np.interp(dip.deepest, s, values_of[dip.contact]))
        size = float(np.max(np.abs(values_of[dip.contact])))
        expected = -value / deviation
        assert dip.depth == pytest.approx(expected, rel=0.02, abs=1e-4 * size / deviation)
        assert dip.unlikely == pytest.approx(math.log(math.erfc(dip.depth / math.sqrt(2)) / 2))


@pytest.mark.parametrize("depth", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("phase", np.linspace(0.0, 0.1, 5).tolist())
def test_shallow_dips_between_samples_are_found(depth: float, phase: float) -> None:
    """``cos`` falls slightly below ``-0.9``, between any samples; or stays above: no dip."""
    for amplitude, count in ((0.9 + depth, 2), (0.9 - depth, 0)):
        x = amplitude * np.array([np.cos(phase), 0.0, -np.sin(phase), 0.0])
        found = forecast(SWINGING, 0.0, x, 0.1 * np.eye(4), ())
        dips = found.dips(4 * np.pi)
        assert len(dips) == count
        for k, dip in enumerate(dips):
            half = math.acos(0.9 / (0.9 + depth))
            first = (2 * k + 1) * np.pi - phase - half
            assert dip.began == pytest.approx(first, abs=1e-9)
            assert 0 < dip.depth <= 1.001 * depth / 0.1
            assert dip.over


def test_confident_from_is_where_the_dip_is_deep_enough() -> None:
    """There the gap over its deviation has the given value; a shallower dip never reaches it."""
    found = forecast(SWINGING, 0.0, np.array([1.5, 0.0, 0.0, 0.0]), 0.01 * np.eye(4), ())
    dip = found.dips(4.0)[0]
    at = found.confident_from(dip, 3.0)
    assert at > dip.began
    assert 1.5 * math.cos(at) + 0.9 == pytest.approx(-0.03, abs=1e-12)
    shallow = forecast(SWINGING, 0.0, np.array([1.5, 0.0, 0.0, 0.0]), np.eye(4), ()).dips(4.0)[0]
    assert shallow.depth < 3


def test_there_is_no_dip_where_none_can_be() -> None:
    """Without contacts, without time, without coming near."""
    free = chain(2, force=forcing(2, 1.0, [Harmonic(2.0, [1, 0], [0, 1])]))
    assert forecast(free, 0.0, np.ones(4), np.eye(4), ()).dips(10.0) == []
    x = np.array([0.5, 0.1, 0.0, 0.0])
    assert forecast(SWINGING, 0.0, x, np.eye(4), ()).dips(100.0) == []
    assert forecast(SWINGING, 0.0, 4 * x, np.eye(4), ()).dips(0.0) == []


def test_a_gap_that_rests_below_zero_has_been_there_from_the_start() -> None:
    """Beside a closed contact, flat but for rounding, so that its minima are anywhere."""
    rng = np.random.default_rng(1)
    for _ in range(60):
        stiffness, load = 10 ** rng.uniform(-1, 3), rng.normal()
        damping, depth = rng.uniform(0, 1), 10 ** rng.uniform(-9, -1)
        q = load / stiffness
        model = system(
            np.eye(2),
            np.diag([1.0, stiffness]),
            np.diag([0.1, damping]),
            contacts=[([1, 0], 0.0, 0.5), ([0, 1], -q - depth, 0.5)],
            force=forcing(2, [-1.0, load]),
        )
        x = np.array([0.0, q * (1 + 1e-16 * rng.integers(-2, 3)), 0.0, 0.0])
        found = forecast(model, 0.0, x, 1e-6 * np.eye(4), (0,)).dips(10 ** rng.uniform(-3, 1))
        assert all((dip.contact, dip.below, dip.over) == (1, 0.0, False) for dip in found)


@given(
    root=st.floats(-5.0, 5.0),
    ends=st.tuples(st.floats(1e-6, 3.0), st.floats(1e-6, 3.0)),
    power=st.sampled_from([1, 3, 9]),
    back=st.booleans(),
)
@examples(60)
def test_a_fall_through_zero_is_found_where_it_is(
    root: float, ends: tuple[float, float], power: int, *, back: bool
) -> None:
    """Forwards and back in time, straight or flat, to the last digits."""
    sign = -1.0 if back else 1.0
    found = falls_at(
        lambda s: sign * math.expm1(root - s) ** power,
        root - sign * ends[0],
        root + sign * ends[1],
    )
    assert found == pytest.approx(root, rel=1e-15, abs=1e-14)


def test_dips_do_not_depend_on_the_members_that_were_asked_for_before() -> None:
    """Members and their motions are kept for a while, each as long as it is used."""
    unknowns = UnknownParameters.named(SWINGING, ["stiffness-scale=0.05"])

    def dips(others: int) -> list[Dip]:
        filter_ = ImpactFilter(SWINGING, 0.0, unknowns)
        bank = FilterBank(filter_, without_faults(unknowns=unknowns))
        root, x = 0.01 * np.eye(5), np.array([-0.9, 0.0, 0.0, 12.0])
        state = GaussianState(x, np.array([1.01]), root, np.zeros((5, 0)), (0,), 1)
        assert filter_.member(state).values == [1.01]
        for k in range(others):
            filter_.members.motion(np.array([1.0 + 1e-3 * k]))
        return bank.between.forecast(0.0, state).dips(4.0)

    found = dips(0)
    assert found
    assert dips(500) == found
