# SPDX-License-Identifier: Apache-2.0
"""The Kalman step of the kernel: against the general methods, exact numbers and the true map."""

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import integrate
from systems import Harmonic, chain, corrected, examples, forcing, system, systems

from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.likelihood import Likelihood
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.model import System

Array = NDArray[np.float64]
STAMP = 1e-9 / math.sqrt(12)
"""Standard deviation of the rounding of a stamp to 1 ns, s."""
DOUBTED = ("stiffness-scale", "damping-scale", "restitution", "gap")


class Case(NamedTuple):
    """An impact of one contact, and the prior."""

    filter: ImpactFilter
    change: ContactChange
    state: GaussianState
    clock: float

    def in_general(self) -> tuple[Likelihood, GaussianState]:
        """Likelihood and posterior by the general methods."""
        general, about = self.filter.conditioning, (self.change, self.state, self.clock)
        return general.likelihood(*about), general.posterior(*about)

    def in_kernel(self) -> tuple[Likelihood, GaussianState]:
        """The same by the kernel."""
        return corrected(self.filter, self.change, self.state, self.clock)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Any system, contact and instant; a prior that is wrong by what it says; any clock."""
    model = draw(systems(max_n=4, contacts=(1, 3)))
    contact, size = draw(st.integers(0, model.m - 1)), 2 * model.n
    random = np.random.default_rng(draw(st.integers(0, 999)))
    late = 1e-3 * draw(st.integers(0, 1)) if model.forcing.depends_on_time else 0.0
    root = random.normal(size=(size, draw(st.sampled_from([1, size, size + 3]))))
    root *= 10.0 ** -draw(st.integers(0, 10))
    x, w = random.normal(size=size), model.W[:, contact]
    x[: model.n] -= w * (w @ x[: model.n] + model.q_r[contact]) / (w @ w)
    speed = w @ x[model.n :]
    x[model.n :] += w * (-1 - abs(speed) - speed) / (w @ w)  # towards the stop
    x += root @ random.normal(size=root.shape[1])
    constants, differences = np.zeros(0), random.normal(size=(size, draw(st.integers(0, 3))))
    if late:  # an offset of the clock, that is not known yet
        constants, row = np.array([late]), late * random.normal(size=root.shape[1])
        root, differences = np.vstack([root, row]), np.vstack([differences, 0 * differences[:1]])
    change = ContactChange(
        draw(st.integers(0, 640)) / 64, (), (contact,), (), flown=draw(st.sampled_from([0.0, 3.0]))
    )
    clock = draw(st.sampled_from([STAMP, 1e-8, 1e-5, 1e-3]))
    state = GaussianState(x, constants, root, differences)
    return Case(ImpactFilter(model), change, state, clock)


@st.composite
def parametric_cases(draw: st.DrawFn) -> Case:
    """The same with parameters of motion and impacts, of which one is at its bound."""
    case = draw(cases())
    model, (clock, size) = case.filter.system, (case.clock, case.state.x.size)
    filter_ = ImpactFilter(model, 0.0, UnknownParameters.named(model, DOUBTED))
    family, random = filter_.members.family, np.random.default_rng(draw(st.integers(0, 999)))
    p, d = family.size, size + family.size
    spread = np.concatenate([np.ones(size), UnknownParameters.named(model, DOUBTED).deviations])
    root = 10.0 ** -draw(st.integers(2, 9)) * spread[:, None] * random.normal(size=(d, d + 1))
    theta = family.nominal + 0.3 * spread[size:] * random.normal(size=p)
    theta = np.where(np.arange(p) == p - 1, 0.0, theta)
    theta = filter_.members.parameters.bounded(theta, np.zeros((p, 0)), 0)
    x = case.state.x + root[:size] @ random.normal(size=d + 1)
    differences = root @ random.normal(size=(d + 1, 2))
    offset = case.state.constants
    if offset.size:
        root = np.vstack([root, offset * random.normal(size=d + 1)])
        differences = np.vstack([differences, np.zeros(2)])
    state = GaussianState(x, np.append(theta, offset), root, differences, (), p)
    return Case(filter_, case.change, state, min(clock, 1e-5))


def assert_near(found: Array, wanted: Array, error: float) -> None:
    """Equal within ``error`` of the largest."""
    most = float(np.max(np.abs(wanted), initial=0.0))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=error * most + 1e-12)


@pytest.mark.slow
@given(case=cases())
@examples(40)
def test_it_agrees_with_the_general_methods(case: Case) -> None:
    """They carry the joint covariance of instant and state from instant to instant."""
    fit, after = case.in_kernel()
    likelihood, wanted = case.in_general()
    assert fit.innovations.keys() == likelihood.innovations.keys()
    if abs(likelihood.normalised) > 10:
        assert abs(fit.normalised) > 9
        return
    assert fit.density == pytest.approx(likelihood.density, rel=1e-6, abs=1e-6)
    assert fit.normalised == pytest.approx(likelihood.normalised, rel=1e-6, abs=1e-6)
    assert fit.deviation == pytest.approx(likelihood.deviation, rel=1e-6)
    assert_near(after.x, wanted.x, 1e-8)
    assert_near(after.constants, wanted.constants, 1e-8)
    assert_near(after.differences, wanted.differences, 1e-7)
    assert_near(after.root @ after.root.T, wanted.root @ wanted.root.T, 1e-6)


@pytest.mark.long
@given(case=parametric_cases())
@examples(80)
def test_with_parameters_it_agrees_with_the_general_methods(case: Case) -> None:
    """Each hypothesis is a system of its own: impacts, and flights to the next one."""
    (wanted_likelihood, wanted), (likelihood, found) = case.in_general(), case.in_kernel()
    if abs(wanted_likelihood.normalised) > 10:
        assert abs(likelihood.normalised) > 9
        return
    assert likelihood.density == pytest.approx(wanted_likelihood.density, rel=1e-6, abs=1e-6)
    assert likelihood.normalised == pytest.approx(wanted_likelihood.normalised, rel=1e-6, abs=1e-6)
    before, s = case.state, 0.1
    flown = case.filter.priors(case.change.t, s, [before], [0.2])[0]
    predicted = case.filter.predict(case.change.t, before, 0.2).prior(s)
    for one, other, error in ((found, wanted, 1e-4), (flown, predicted, 1e-8)):
        scale = np.linalg.norm(other.root, axis=1)
        # What a plastic impact sets to zero is of second order, and differs by as much.
        scale = scale + 1e-2 * np.max(scale) + 1e-12
        assert one.parameters == other.parameters
        assert_near(one.x, other.x, error)
        np.testing.assert_allclose(one.constants, other.constants, atol=1e-3 * error)
        assert_near(one.differences / scale[:, None], other.differences / scale[:, None], error)
        P, Q = one.root @ one.root.T, other.root @ other.root.T
        assert_near(P / np.outer(scale, scale), Q / np.outer(scale, scale), error)


@pytest.mark.parametrize("deviation", [1.0, 1e-6, 1e-12])
def test_a_sharp_measurement_keeps_its_digits(deviation: float) -> None:
    """A mass of known speed: the posterior variance by fractions."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    state = GaussianState(
        np.array([0.0, -2.0]), np.zeros(0), np.diag([deviation, 0.0]), np.zeros((2, 0))
    )
    case = Case(ImpactFilter(model), ContactChange(1.0, (), (0,), ()), state, STAMP)
    _, after = case.in_kernel()
    # The impact was e earlier, q + 2 e = 0, and it has moved on with a speed of 1 since.
    P, R = Fraction(deviation) ** 2, Fraction(STAMP) ** 2
    wanted = math.sqrt(P * R / (P + 4 * R))
    rounded = 8 * float(np.finfo(float).eps)
    assert math.hypot(*after.root[0]) == pytest.approx(wanted, rel=1e-7, abs=rounded)
    assert math.hypot(*after.root[1]) <= rounded


def flowed(model: System, t: float, x: Array, s: float) -> Array:
    """The motion without contact, by DOP853."""
    n = model.n

    def rates(at: float, y: Array) -> Array:
        force = model.forcing(at) - model.C @ y[n:] - model.K @ y[:n]
        return np.concatenate([y[n:], np.linalg.solve(model.M, force)])

    found = integrate.solve_ivp(rates, (t, t + s), x, method="DOP853", rtol=1e-13, atol=1e-14)
    return np.asarray(found.y[:, -1])


def bounced(model: System, t: float, y: Array, e: float) -> Array:
    """Back by ``e``, Newton's law, and on again."""
    n, w = model.n, model.W[:, 0]
    x = flowed(model, t, y, -e)
    push = np.linalg.solve(model.M, w)
    x[n:] -= (1 + model.eps[0]) * push * (w @ x[n:]) / (w @ push)
    return flowed(model, t - e, x, e)


def own_root(model: System, t: float, y: Array) -> float:
    """How long before ``t`` the gap is zero."""
    e = 0.0
    for _ in range(20):
        x = flowed(model, t, y, -e)
        w = model.W[:, 0]
        e += float((w @ x[: model.n] + model.q_r[0]) / (w @ x[model.n :]))
    return e


SWAYING = chain(
    3,
    contacts=[([0, 0, -1], 0.2, 0.6)],
    force=forcing(3, [0.3, -0.2, 0.1], [Harmonic(2.7, [3.0, 0, 0], [0, 1.0, 2.0])]),
)
Y = np.array([0.1, -0.1, 0.2 - 1e-3, 0.5, 0.2, 1.5])
"""Just before its stop."""


def test_a_missed_impact_is_the_true_map() -> None:
    """State and covariance: against an integrator and its finite differences."""
    filter_, t = ImpactFilter(SWAYING), 3.25
    impact = filter_.members.free_impact(0)
    late = own_root(SWAYING, t, Y)
    at = flowed(SWAYING, t, Y, -late)  # exactly at its root
    root = 1e-7 * np.random.default_rng(0).normal(size=(6, 6))
    state = GaussianState(at, np.zeros(0), root, root[:, :2])
    x, _, found, differences = impact.missed(np.array([t - late]), [state])[0]
    np.testing.assert_allclose(x, bounced(SWAYING, t - late, at, 0.0), atol=1e-12)

    def after(dx: Array) -> Array:
        y = at + dx
        return bounced(SWAYING, t - late, y, own_root(SWAYING, t - late, y))

    h = 1e-5
    columns = np.array([(after(h * each) - after(-h * each)) / (2 * h) for each in np.eye(6)]).T
    assert_near(found @ found.T, columns @ root @ root.T @ columns.T, 1e-6)
    assert_near(differences, columns @ root[:, :2], 1e-6)


def test_a_missed_impact_with_parameters_is_the_true_map() -> None:
    """Each parameter changes instant, jump or motion: finite differences of other systems."""
    t, names = 3.25, ("stiffness-scale", "restitution.c1", "gap.c1")
    filter_ = ImpactFilter(SWAYING, 0.0, UnknownParameters.named(SWAYING, names))
    family = filter_.members.family
    theta = family.nominal + np.array([0.02, 0.01, 3e-3])
    model = family.system_at(theta)
    t -= (late := own_root(model, t, Y))
    at = flowed(model, t + late, Y, -late)  # exactly at its root

    def after(z: Array) -> Array:
        other = family.system_at(z[6:])
        return bounced(other, t, z[:6], own_root(other, t, z[:6]))

    root = 1e-8 * np.random.default_rng(0).normal(size=(9, 9))
    state = GaussianState(at, theta, root, root[:, :2], (), 3)
    x, constants, found, differences = filter_.members.free_impact(0).missed(
        np.array([t]), [state]
    )[0]
    z, h = np.concatenate([at, theta]), 1e-5
    np.testing.assert_allclose(x, after(z), atol=1e-12)
    np.testing.assert_array_equal(constants, theta)
    columns = np.array([(after(z + h * e) - after(z - h * e)) / (2 * h) for e in np.eye(9)]).T
    columns = np.vstack([columns, np.eye(9)[6:]])
    assert_near(found @ found.T, columns @ root @ root.T @ columns.T, 1e-3)
    assert_near(differences, columns @ root[:, :2], 1e-3)


@pytest.mark.long
def test_the_covariance_is_that_of_many_draws() -> None:
    """A stamp that is off by 3 ms and a prior of a centimetre: weighted draws of the true map."""
    random, clock, t = np.random.default_rng(5), 3e-3, 3.25
    root = np.diag([0.01, 0.01, 0.01, 0.02, 0.02, 0.02])
    filter_ = ImpactFilter(SWAYING)
    state = GaussianState(Y, np.zeros(0), root, np.zeros((6, 0)))
    likelihood, found = corrected(filter_, ContactChange(t, (), (0,), ()), state, clock)
    motion = filter_.members.given.moving.free
    w, n = SWAYING.W[:, 0], SWAYING.n
    draws, weights = [], []
    for y in Y + random.normal(size=(40_000, 6)) @ root.T:
        e, x = 0.0, y
        for _ in range(6):
            x = motion.moved(t, y, -e)[0]
            e += float((w @ x[:n] + SWAYING.q_r[0]) / (w @ x[n:]))
        if abs(e) > 8 * clock:
            continue
        x[n:] -= 1.6 * w * (w @ x[n:]) / (w @ w)
        draws.append(motion.moved(t - e, x, e)[0])
        weights.append(math.exp(-((e / clock) ** 2) / 2))
    density = sum(weights) / 40_000 / (clock * math.sqrt(2 * math.pi))
    mean = np.average(draws, axis=0, weights=weights)
    P = np.cov(np.array(draws).T, aweights=weights)
    assert likelihood.density == pytest.approx(math.log(density), abs=0.05)
    deviations = np.sqrt(np.diag(P))
    np.testing.assert_allclose((found.x - mean) / deviations, 0.0, atol=0.1)
    own = found.root @ found.root.T
    scale = np.outer(deviations, deviations)
    np.testing.assert_allclose(own / scale, P / scale, atol=0.1)


@pytest.mark.parametrize("slope", [-40.0, -19.0, -21.0, -3.0, 0.5])
def test_an_impact_from_below_is_unlikely(slope: float) -> None:
    """The density has the mean of the closing speed, where that is positive, far into its tail."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)])
    state = GaussianState(
        np.array([0.0, -slope]), np.zeros(0), np.diag([1e-3, 1.0]), np.zeros((2, 0))
    )
    likelihood = corrected(ImpactFilter(model), ContactChange(0.0, (), (0,), ()), state, 1e-9)[0]
    mean, _ = integrate.quad(lambda c: c * math.exp(slope * c - c * c / 2), 0.0, 60.0, points=[1])
    wanted = math.log(mean) - slope * slope / 2 - math.log(2 * math.pi * likelihood.deviation)
    assert likelihood.density == pytest.approx(wanted, rel=1e-7, abs=1e-7)


def test_a_large_root_is_triangular_only_now_and_then() -> None:
    """It grows by a few columns at an impact, and has the covariance of the general methods."""
    model = chain(20, contacts=[(np.eye(20)[7], 0.0, 0.5)])
    random = np.random.default_rng(2)
    x, w = random.normal(size=40), model.W[:, 0]
    x[:20] -= w * x[7]
    x[27] = -3.0
    root = np.tril(1e-4 * random.normal(size=(40, 40)))
    state = GaussianState(x, np.zeros(0), root, np.zeros((40, 1)))
    case = Case(ImpactFilter(model), ContactChange(0.5, (), (0,), ()), state, 1e-5)
    columns = []
    for _ in range(5):
        _, after = case.in_kernel()
        columns.append(after.root.shape[1])
        wanted = case.in_general()[1]
        assert_near(after.root @ after.root.T, wanted.root @ wanted.root.T, 1e-9)
        case = case._replace(state=case.state._replace(root=after.root))
    assert columns == [45, 50, 55, 60, 40]


@pytest.mark.parametrize(
    ("x", "root", "expected"),
    [
        (np.zeros(3), np.eye(2), r"x: shape \(3,\); expected \(2,\)"),
        (np.zeros((2, 1)), np.eye(2), r"x: shape"),
        (np.array([0.0, np.nan]), np.eye(2), "x: not finite"),
        (np.zeros(2), np.eye(3), "root"),
        (np.zeros(2), np.full((2, 2), np.inf), "root: not finite"),
        (np.array(["a", "b"]), np.eye(2), "x: expected an array of numbers"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(x: Array, root: Array, expected: str) -> None:
    """By name, and nothing is read beyond them."""
    impact = ImpactFilter(system(1, 0, 0, contacts=[([1], 0.0, 0.5)])).members.free_impact(0)
    state = (x, np.zeros(0), root, np.zeros((2, 0)))
    with pytest.raises(ValueError, match=expected):
        impact.fits(0.0, [state], np.array([1e-9]))
    with pytest.raises(ValueError, match=expected):
        impact.missed(np.zeros(1), [state])


def test_arrays_of_any_order_are_the_same() -> None:
    """Of columns, strided, or of single precision numbers that are exact."""
    impact = ImpactFilter(SWAYING).members.free_impact(0)
    root = np.tril(np.arange(36.0).reshape(6, 6)) / 64
    wanted = None
    for each in (
        root,
        np.asfortranarray(root),
        np.repeat(root, 2, axis=1)[:, ::2],
        root.astype("f4"),
    ):
        state = (Y, np.zeros(0), each, np.zeros((6, 0)))
        found = impact.posteriors(1.0, 0.1, [state], np.array([1e-6]))[0][2]
        wanted = found if wanted is None else wanted
        np.testing.assert_array_equal(found, wanted)


def test_instants_and_clocks_that_do_not_fit_are_refused() -> None:
    """No NaN comes in."""
    impact = ImpactFilter(SWAYING).members.free_impact(0)
    state = (Y, np.zeros(0), np.eye(6), np.zeros((6, 0)))
    for t, clocks in ((np.nan, [1e-9]), (0.0, [-1.0]), (0.0, [np.nan]), (0.0, [1e-9, 1e-9])):
        with pytest.raises(ValueError, match=r"t: not finite|clocks"):
            impact.fits(t, [state], np.array(clocks))


def test_gaps_that_do_not_fit_are_refused() -> None:
    """As states of an impact are; nor is a flight of too many periods followed step by step."""
    gaps = ImpactFilter(SWAYING).members.free_gaps
    state = (Y, np.zeros(0), np.eye(6), np.zeros((6, 0)))
    assert len(gaps.dips(np.zeros(1), np.full(1, 9.0), [state], np.zeros(1))[0]) > 0
    wrong = ((-1.0, 0.0, "duration"), (1e9, 0.0, "duration"), (1.0, np.nan, "levels"))
    for s, level, expected in wrong:
        with pytest.raises(ValueError, match=expected):
            gaps.dips(np.zeros(1), np.array([s]), [state], np.array([level]))
    with pytest.raises(ValueError, match="contact"):
        gaps.root(0.0, state, 0.0, 1, 0.0, 1.0)
    with pytest.raises(ValueError, match="in order"):
        gaps.root(0.0, state, 0.0, 0, 1.0, 0.5)


def test_rates_are_those_of_the_equations_of_motion() -> None:
    """Also of the forces: against the model."""
    model, n = SWAYING, SWAYING.n
    found = ImpactFilter(model).members.given.moving.free.rates(3.25, Y)
    force = model.forcing(3.25) - model.C @ Y[n:] - model.K @ Y[:n]
    wanted = np.concatenate([Y[n:], np.linalg.solve(model.M, force)])
    np.testing.assert_allclose(found, wanted, atol=1e-14)
