# SPDX-License-Identifier: Apache-2.0
"""Event location: the first closing gap is found, and found once."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from scipy import optimize
from systems import Harmonic, examples, forcing, numbers, sample, system, systems, vectors

from impact_observer.dynamics import Phase, PhaseMotion, Phases, RootSearch, Watch, watch
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples

Array = NDArray[np.float64]


@cache
def phase_of(model: System) -> Phase:
    """The phase in which no contact is held."""
    return Phases(model).phase()


def under_samples(model: System) -> Phase:
    """The same, moving as under a sampled force, which is zero, at uneven instants."""
    steps = np.random.default_rng(model.n).exponential(0.7, 40)
    knots = np.concatenate([[-1.0], np.cumsum(steps) - 1.0])
    samples = Samples(knots, np.zeros((41, model.n)), "linear")
    return phase_of(replace(model, forcing=Forcing.of_samples(samples)))


WAYS = (phase_of, under_samples)


class Crossing(NamedTuple):
    """Where functions vanish: seconds since the start of the motion, and which of them."""

    s: float
    which: tuple[int, ...]


def first_crossing(
    watched: Watch, motion: PhaseMotion, horizon: float, start: float = 0.0
) -> Crossing | None:
    """The first crossing of the functions along ``motion`` in [start, horizon]."""
    found = RootSearch(watched.guards, motion, start).first(horizon)
    return None if found is None or found[0] > horizon else Crossing(*found)


def search(
    model: System,
    x: Array,
    horizon: float,
    t: float = 0.0,
    way: Callable[[System], Phase] = phase_of,
) -> Crossing | None:
    """The first closing along the motion through ``x`` at ``t``."""
    return first_closing(way(model), model, x, horizon, t)


def first_closing(
    phase: Phase, model: System, x: Array, horizon: float, t: float = 0.0
) -> Crossing | None:
    """The same, in a phase of a system that may have other gaps: they do not change the motion."""
    return first_crossing(watch(model, phase, range(model.m)), phase.start(t, x), horizon)


def assert_closing(found: Crossing | None, s: float, *contacts: int) -> None:
    """The closing is that of ``contacts`` at ``s``."""
    assert found is not None
    assert found.s == pytest.approx(s, abs=2e-14)
    assert found.which == contacts


def sampled(model: System, x: Array, horizon: float, t: float) -> float | None:
    """The first closing of a gap by looking at 4001 samples and refining the first sign."""
    motion = phase_of(model).start(t, x)
    s = np.linspace(0.0, horizon, 4_001)
    g = motion.states(s)[:, : model.n] @ model.W + model.q_r
    roots = []
    for i in range(model.m):
        below = np.flatnonzero((g[:-1, i] > 0) & (g[1:, i] <= 0))
        if below.size:
            low, high = s[below[0]], s[below[0] + 1]
            roots.append(
                optimize.brentq(
                    lambda at, i=i: float(model.gap(motion.state(at)[: model.n])[i]), low, high
                )
            )
    return min(roots, default=None)


@pytest.mark.slow
@examples(200)
@given(st.data())
def test_first_closing_is_the_one_that_dense_sampling_finds(data: st.DataObject) -> None:
    """Or an earlier one between two samples, with all gaps open before it."""
    assert_first_closing(data, data.draw(systems(contacts=(1, 3), gaps=(0.0, 2.0))))


@pytest.mark.long
@examples(10_000)
@given(st.data())
def test_no_closing_of_ten_thousand_systems_is_skipped(data: st.DataObject) -> None:
    """Of up to six coordinates, with and without stiffness, harmonics and damping."""
    rigid = data.draw(st.booleans())
    model = data.draw(systems(max_n=6, contacts=(1, 3), gaps=(0.0, 2.0), rigid=rigid))
    assert_first_closing(data, model)


def assert_first_closing(data: st.DataObject, model: System) -> None:
    """The search from a random state finds what dense sampling finds, or an earlier dip."""
    x = np.concatenate([data.draw(vectors(model.n, -1, 1)), data.draw(vectors(model.n, -4, 4))])
    assume(np.all(model.gap(x[: model.n]) > 0.01))
    t, horizon = data.draw(numbers(0, 4)), 4.0
    found = search(model, x, horizon, t)
    expected = sampled(model, x, horizon, t)
    if found is None:
        assert expected is None
        return
    motion = phase_of(model).start(t, x)
    before = motion.states(np.linspace(0.0, found.s, 2001))[:, : model.n]
    assert np.min(before @ model.W + model.q_r) > -1e-11
    assert np.max(np.abs(model.gap(before[-1])[list(found.which)])) < 1e-11
    if expected is None or found.s < expected - 1e-9:
        assert found.which  # a true dip, shorter than the sampling interval
        assert model.gap(motion.state(found.s + 1e-7)[: model.n])[found.which[0]] < 0
    else:
        assert found.s == pytest.approx(expected, abs=1e-9)


def test_short_dip_between_two_samples_is_found() -> None:
    """A dip of a millisecond in a motion that is sampled every tenth of a second."""
    # x = cos t against a stop just below its peak: closed for about 2 sqrt(2 d).
    for depth in (1e-3, 1e-7, 1e-10):
        model = system(1, 0, 1, contacts=[([-1], 1 - depth, 0.5)])
        found = search(model, np.array([np.cos(-2.0), -np.sin(-2.0)]), 5.0)
        assert found is not None
        assert found.s == pytest.approx(2.0 - np.arccos(1 - depth), abs=1e-11 / np.sqrt(depth))


def test_deepest_graze_passed_over_is_as_deep_as_rounding() -> None:
    """A graze below rounding is none; one of a picometre is found."""
    start = np.array([np.cos(-2.0), -np.sin(-2.0)])
    shallow = system(1, 0, 1, contacts=[([-1], 1 + 1e-12, 0.5)])
    assert search(shallow, start, 5.0) is None
    deep = system(1, 0, 1, contacts=[([-1], 1 - 1e-12, 0.5)])
    assert search(deep, start, 5.0) is not None


def test_earlier_of_two_crossings_in_one_window_is_found() -> None:
    """Two contacts, and one contact twice."""
    both = system(1, 0, 1, contacts=[([-1], 0.9, 0.5), ([-1], 0.8, 0.5)])
    found = search(both, np.array([0.0, 1.0]), 10.0)
    assert_closing(found, np.arcsin(0.8), 1)
    # Fast and slow together: the first of many crossings.
    beats = system(
        np.eye(2), np.zeros((2, 2)), np.diag([1.0, 2500.0]), contacts=[([1, 1], 0.0, 1)]
    )
    x = np.array([1.0, 1.5, 0.0, 0.0])
    found = search(beats, x, 3.0)
    assert found is not None
    first = optimize.brentq(lambda s: np.cos(s) + 1.5 * np.cos(50 * s), 0.0, np.pi / 50)
    assert found.s == pytest.approx(first, abs=1e-13)


def test_contacts_that_close_together_are_found_together() -> None:
    """A symmetric motion hits both walls at one instant."""
    model = system(
        np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=[([1, 0], 0.5, 1), ([0, -1], 0.5, 1)]
    )
    found = search(model, np.array([0.0, 0.0, -1.0, 1.0]), 5.0)
    assert_closing(found, np.pi / 6, 0, 1)


def test_nothing_closes_beyond_the_horizon() -> None:
    """The horizon itself belongs to the search, later instants do not."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    x = np.array([1.0, -1.0])
    assert search(model, x, 0.999) is None
    found = search(model, x, 1.001)
    assert_closing(found, 1.0, 0)


def test_a_dip_before_the_start_in_the_same_step_does_not_count() -> None:
    """``x = cos(t - 0.15)`` is beyond the stop for t in (0.05, 0.25), and a period later."""
    model = system(1, 0, 1, contacts=[([-1], np.cos(0.1), 0.5)])
    phase, x = phase_of(model), np.array([np.cos(0.15), np.sin(0.15)])
    gaps, motion = watch(model, phase, [0]), phase.start(0.0, x)
    assert_closing(first_crossing(gaps, motion, 10.0), 0.05, 0)
    assert_closing(first_crossing(gaps, motion, 10.0, 0.3), 0.05 + 2 * np.pi, 0)


def test_contact_that_just_separated_is_not_found_again() -> None:
    """A gap that rounding leaves below zero opens without a second impact."""
    model = sample("bouncing_ball").system
    for rounding in (0.0, -1e-16, -1e-14):
        found = search(model, np.array([rounding, 1.0]), 1.0)
        assert found is not None
        assert found.s == pytest.approx(2 / 9.81, abs=1e-12)


def test_length_of_the_search_window_does_not_change_the_closing() -> None:
    """Several short searches find the closing of one long search."""
    model = sample("three_mass").system
    x = np.array([0.1, -0.1, 0.05, 0.5, 0.0, -0.5])
    phase = phase_of(model)
    gaps = watch(model, phase, range(model.m))
    motion = phase.start(0.0, x)
    once = first_crossing(gaps, motion, 10.0)
    assert once is not None
    pieces, start, found = np.linspace(0.0, 10.0, 97)[1:], 0.0, None
    for stop in pieces:
        found = first_crossing(gaps, motion, stop, start)
        if found is not None:
            break
        start = stop
    assert found is not None
    assert found.s == pytest.approx(once.s, abs=2e-14)


AT_REST = {
    "in equilibrium": system(1, 0.1, 2, contacts=[([-1], 0.3, 0.8)], force=forcing(1, 0.6)),
    "beside one that moves": system(
        np.eye(2),
        np.zeros((2, 2)),
        np.diag([2.0, 9.0]),
        contacts=[([-1, 0], 0.3, 0.8)],
        force=forcing(2, [0.6, 0.0]),
    ),
    "beside one that is shaken": system(
        np.eye(2),
        np.zeros((2, 2)),
        np.diag([2.0, 9.0]),
        contacts=[([-1, 0], 0.3, 0.8)],
        force=forcing(2, [0.6, 0.0], [Harmonic(40.0, [0, 1], [0, 0])]),
    ),
    "in the node of a mode": system(
        np.eye(3),
        np.zeros((3, 3)),
        10 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)),
        contacts=[([0, -1, 0], 0.0, 0.5), ([0, 1, 0], 0.0, 0.5)],
    ),
}


@pytest.mark.parametrize("model", AT_REST.values(), ids=list(AT_REST))
def test_body_at_rest_against_its_stop_does_not_hit_it(model: System) -> None:
    """A gap that stays zero has no root, and the search ends."""
    x = np.zeros(2 * model.n)
    x[0] = -model.q_r[0] / model.W[0, 0] if model.W[0, 0] else 1.0
    x[model.n - 1] += -1.0 if model.n == 3 else float(model.n == 2)
    phase = phase_of(model)
    assert first_crossing(watch(model, phase, [0]), phase.start(0.0, x), 10.0) is None


class Superposed:
    """``h(t) = sum a_i y_i(t)`` of independent modes ``y'' + c y' + k y = 0``, in closed form."""

    def __init__(self, rng: np.random.Generator, modes: int) -> None:
        """Draw stiffness over eight decades, damping up to overdamped, and amplitudes."""
        self.k = 10.0 ** np.sort(rng.uniform(0, 8 if modes > 1 else 2, modes))
        if modes > 1 and rng.random() < 0.3:
            self.k[1] = self.k[0] * (1 + rng.uniform(0.01, 0.1))  # a beat
        self.k[0] = rng.uniform(0.5, 4)
        damping = rng.choice([0.0, 0.01, 0.3, 2.5], modes)
        self.c = np.minimum(damping * 2 * np.sqrt(self.k), 50.0)
        self.a = rng.uniform(0.5, 2, modes) / np.maximum(1, np.sqrt(self.k) / 10)
        self.x = np.concatenate([rng.normal(size=modes), rng.normal(size=modes) * np.sqrt(self.k)])

    def __call__(self, t: ArrayLike) -> Array:
        """Values at ``t`` s."""
        t, n = np.atleast_1d(np.asarray(t, float))[:, None], self.k.size
        one, two = (-self.c / 2 + sign * np.emath.sqrt(self.c**2 / 4 - self.k) for sign in (1, -1))
        later = (self.x[n:] - one * self.x[:n]) / (two - one)
        y = (self.x[:n] - later) * np.exp(one * t) + later * np.exp(two * t)
        return np.asarray(np.real(y) @ self.a)

    def model(self, gap: float) -> System:
        """The system whose one gap is ``h + gap``."""
        return system(
            np.eye(self.k.size), np.diag(self.c), np.diag(self.k), contacts=[(self.a, gap, 0.5)]
        )

    def dip(self, end: float) -> tuple[float, float]:
        """Where ``h`` is least in [0, end] and its value there."""
        t = np.arange(0.0, end, 0.05 / np.sqrt(self.k[-1]) / (1 + np.max(self.c) / 10))
        j = int(np.argmin(self(t)))
        width = t[1] - t[0]
        found = optimize.minimize_scalar(
            lambda s: float(self(s)[0]),
            bounds=(max(t[j] - width, 0.0), t[j] + width),
            method="bounded",
            options={"xatol": 1e-12},
        )
        return float(found.x), float(found.fun)


@pytest.mark.parametrize("modes", [1, 2, 3])
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 26))]
)
def test_dip_deeper_than_rounding_is_found_at_any_instant(modes: int, seed: int) -> None:
    """Dips down to 2e-13 of the gap's scale; a gap that stays positive has no event."""
    rng = np.random.default_rng(10 * seed + modes)
    motion = Superposed(rng, modes)
    end = 40 / np.sqrt(motion.k[-1]) if modes > 1 else 6.0
    at, least = motion.dip(end)
    # The scale of rounding in the search: the gap's constant and the whole motion.
    largest = np.sqrt(motion.x @ motion.x)
    scale = abs(least) + np.linalg.norm(motion.a) * largest
    phases = [way(motion.model(-least)) for way in WAYS]
    for depth in (2.5e-13 * scale, 1e-12 * scale, 1e-9 * scale, 1e-5 * scale, 1e-3 * scale):
        model = motion.model(-least - depth)
        if model.gap(motion.x[:modes])[0] <= 0:
            continue
        first = 0.0
        for phase in phases:
            found = first_closing(phase, model, motion.x, end * 1.01)
            assert found is not None
            assert found.s <= at + 1e-9
            assert abs(motion(found.s)[0] - least - depth) < 1e-13 * scale
            first = max(first, found.s)
        before = motion(np.linspace(0, first, 5_000, endpoint=False)) - least - depth
        assert np.min(before) > -1e-13 * scale
    open_gap = motion.model(-least + 1e-11 * scale)
    for phase in phases:
        assert first_closing(phase, open_gap, motion.x, at) is None


@pytest.mark.parametrize("differences", [1e-2, 1e-4, 1e-6])
def test_first_of_two_crossings_close_to_each_other_is_found(differences: float) -> None:
    """Two dips of different contacts in one interval, either of them first."""
    for first, second in ((0, 1), (1, 0)):
        # Two equal modes pass their peaks at 2 s and a little later; each is met 1e-9 below.
        late = np.zeros(2)
        late[second] = differences
        x = np.concatenate([np.cos(2.0 + late), np.sin(2.0 + late)])
        stops = [([-1, 0], 1 - 1e-9, 0.5), ([0, -1], 1 - 1e-9, 0.5)]
        found = search(system(np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=stops), x, 3.0)
        assert found is not None
        assert found.s == pytest.approx(2.0 - np.arccos(1 - 1e-9), abs=1e-9)
        if differences > 1e-5:
            assert found.which == (first,)


@pytest.mark.parametrize("at", [1e-5, 1e-3, 0.5])
def test_dip_near_the_start_or_the_end_of_a_window_is_found(at: float) -> None:
    """A peak just after the start, and just before and after each place a window ends."""
    window = 4 * np.pi
    for middle in (at, window - at, window + at):
        depth = min(1e-10, at**2 / 4)
        model = system(1, 0, 1, contacts=[([-1], 1 - depth, 0.5)])
        start = np.array([np.cos(middle), np.sin(middle)])
        if model.gap(start[:1])[0] <= 0:
            continue
        found = search(model, start, 30.0)
        assert found is not None
        expected = (middle - np.arccos(1 - depth)) % (2 * np.pi)
        assert found.s == pytest.approx(expected, abs=1e-15 / np.sqrt(depth) + 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["previous", "linear"])
@examples(60)
@given(st.data())
def test_search_across_knots_of_a_sampled_force_finds_the_first_closing(
    hold: str, data: st.DataObject
) -> None:
    """As dense sampling does: the force is not smooth where it is sampled."""
    plain = data.draw(systems(contacts=(1, 2), gaps=(0.0, 2.0), forced=False, max_n=3))
    knots = np.linspace(0.0, 2.5, data.draw(st.integers(2, 40)))
    rows = np.random.default_rng(data.draw(st.integers(0, 99))).normal(size=(knots.size, plain.n))
    model = replace(plain, forcing=Forcing.of_samples(Samples(knots, 8 * rows, hold)))
    x = np.concatenate([data.draw(vectors(model.n, -1, 1)), data.draw(vectors(model.n, -4, 4))])
    assume(np.all(model.gap(x[: model.n]) > 0.01))
    found, expected = search(model, x, 2.0), sampled(model, x, 2.0, 0.0)
    assert (found is None) == (expected is None)
    if found is not None and expected is not None:
        assert found.s == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("hold", "expected"), [("previous", 2 / 3), ("linear", 0.5)])
def test_load_that_vanishes_at_a_knot_or_on_a_ramp_is_found(hold: str, expected: float) -> None:
    """A step takes it below zero without a root, a ramp through one."""
    times, force = np.array([0.0, 1 / 3, 2 / 3, 3.0]), np.array([[-1.0], [-1.0], [1.0], [1.0]])
    model = system(
        1,
        0.3,
        2,
        contacts=[([1], 0.0, 0.5)],
        force=Forcing.of_samples(Samples(times, force, hold)),
    )
    phase = Phases(model).phase((0,))
    found = first_crossing(watch(model, phase), phase.start(0.0, np.zeros(2)), 2.0)
    assert_closing(found, expected, 0)
