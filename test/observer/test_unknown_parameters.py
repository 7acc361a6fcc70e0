# SPDX-License-Identifier: Apache-2.0
"""Parameters of the model that are estimated with the state, and their deviations."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, PRESSED, run, sample, system, without_faults

from impact_observer.dynamics.lyapunov import distance
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.model import System
from impact_observer.observer import Observer, Options, law_named, make_observer, options_of_laws
from impact_observer.observer.unknown_parameters import UnknownParameters
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S, from_seconds

Array = NDArray[np.float64]
TRUSTING = {"missed": 0.0, "spurious": 0.0, "mislabelled": 0.0}


@cache
def truth(name: str, seconds: float = 60.0) -> Run:
    """A run of a sample."""
    model = sample(name)
    q, u = model.initial_state()
    return run(model.system, q, u, seconds=seconds, rate=2.0)


def watching(
    model: System, x: Array, free: Sequence[str] = (), clock: float = 0.0, **declared: object
) -> Observer:
    """A minimum-variance observer that trusts every event and estimates ``free``."""
    unknowns = UnknownParameters.named(model, free) if free else None
    uncertainty = without_faults(clock_error=clock, unknowns=unknowns, **{**TRUSTING, **declared})
    law = law_named("minimum-variance")(model, uncertainty)
    n = model.n
    return Observer(model, law, x[:n], x[n:], epoch=EPOCH, history=1e4, ensemble=4)


def fed(watcher: Observer, events: Sequence[ImpactEvent]) -> Observer:
    """The observer after it has received ``events``."""
    for each in events:
        watcher.receive(each)
    return watcher


def distances(watcher: Observer, model: System, true: Run) -> Array:
    """V of the estimate at the samples of a run, by the energy of the true model, J."""
    seen = [watcher.estimate(int(stamp)) for stamp in true.stamps]
    differences = np.array([np.concatenate([x.q, x.u]) for x in seen]) - true.states
    return np.asarray(distance(model, differences[:, : model.n], differences[:, model.n :]))


def stiffer(model: System, ratio: float) -> System:
    """The model with other springs."""
    return replace(model, K=ratio * model.K)


def bouncier(model: System, by: float) -> System:
    """The model with other restitutions."""
    contacts = tuple(replace(each, restitution=each.restitution + by) for each in model.contacts)
    return replace(model, contacts=contacts)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_mass", pytest.param("three_mass", marks=pytest.mark.long)])
def test_wrong_stiffness_is_estimated_and_v_falls_below_its_floor(name: str) -> None:
    """Without the parameter, V stays at the floor of a stiffness error of 2 %."""
    model, true = sample(name).system, truth(name)
    wrong, start = stiffer(model, 1.02), np.array([0.4, -0.3, 0.2, 0.5, -0.6, 0.1])[: 2 * model.n]
    late = true.stamps > EPOCH + 40 * NS_PER_S
    plain = fed(watching(wrong, start), true.events)
    learning = fed(watching(wrong, start, ["stiffness-scale=0.03"]), true.events)
    floor = np.median(distances(plain, model, true)[late])
    assert floor > 1e-3
    assert np.median(distances(learning, model, true)[late]) < 1e-6 * floor
    ((name_, value, deviation),) = learning.estimate(int(true.stamps[-1])).parameters
    assert name_ == "stiffness-scale"
    assert abs(value - 1 / 1.02) < 4 * deviation < 1e-3


@pytest.mark.parametrize("wrong", [pytest.param(0.0, marks=pytest.mark.slow), 0.1])
def test_restitution_is_estimated_whether_it_is_wrong_or_right(wrong: float) -> None:
    """V falls to the rounding of stamps, as with a known restitution."""
    model, true = sample("two_mass").system, truth("two_mass", 30.0)
    start = np.array([0.4, -0.3, 0.5, -0.6])
    watcher = fed(watching(bouncier(model, wrong), start, ["restitution"]), true.events)
    V = distances(watcher, model, true)
    assert np.median(V[-10:]) < 1e-15 * V[0]
    ((_, value, deviation),) = watcher.estimate(int(true.stamps[-1])).parameters
    assert abs(value - 0.7) < 4 * deviation < 1e-8
    assert watcher.estimate(int(true.stamps[-1])).synchronized


@pytest.mark.slow
def test_stiffness_restitution_and_gap_are_estimated_together() -> None:
    """Each within its deviation."""
    model, true = sample("two_mass").system, truth("two_mass")
    contacts = tuple(replace(c, gap=1.01 * c.gap) for c in model.contacts)
    wrong = bouncier(stiffer(replace(model, contacts=contacts), 1.03), 0.1)
    free = ["restitution=0.15", "gap=0.02", "stiffness-scale=0.05"]
    watcher = fed(watching(wrong, np.array([0.4, -0.3, 0.5, -0.6]), free), true.events)
    estimated = watcher.estimate(int(true.stamps[-1])).parameters
    right = {"stiffness-scale": 1 / 1.03, "restitution.stop": 0.7, "gap.stop": 0.5}
    assert [name for name, _, _ in estimated] == [
        "stiffness-scale",
        "restitution.stop",
        "gap.stop",
    ]
    for name, value, deviation in estimated:
        assert abs(value - right[name]) < 4 * deviation < 1e-3


@pytest.mark.slow
def test_gaps_are_estimated_where_contacts_rest() -> None:
    """A body at rest on a stop shares the stop's error and its deviation."""
    contacts = tuple(replace(c, gap=c.gap + 0.015) for c in PRESSED.contacts)
    true = run(PRESSED, np.zeros(2), np.zeros(2), seconds=12.0, rate=10.0)
    wrong = replace(PRESSED, contacts=contacts)
    watcher = watching(wrong, np.array([0.1, -0.1, 0.2, 0.1]), ["gap=0.02"], deviation=0.3)
    fed(watcher, true.events)
    at = 100
    late = watcher.estimate(int(true.stamps[at]))
    assert late.closed == ("c1", "c2")
    for (_, value, deviation), right in zip(late.parameters, PRESSED.q_r.tolist(), strict=True):
        assert abs(value - right) < 4 * deviation < 1e-9
    np.testing.assert_allclose(late.q, true.states[at][:2], atol=1e-9)
    spread = np.sqrt(np.diag(late.covariance))[:2]
    assert np.all(spread > 0.2 * late.parameters[0][2])


@pytest.mark.long
@pytest.mark.parametrize("free", ["restitution=0.1", "stiffness-scale=0.03"])
def test_errors_of_parameters_agree_with_their_deviations(free: str) -> None:
    """The mean of the squared normalised errors over many starts is near one."""
    model, true = sample("two_mass").system, truth("two_mass", 20.0)
    name, _, deviation = free.partition("=")
    family = UnknownParameters.named(model, [free]).family
    squares = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        value = float(family.nominal[0]) + float(deviation) * np.clip(rng.normal(), -2, 2)
        wrong = family.system_at(np.array([value]))
        right = 1 / value if name == "stiffness-scale" else float(family.nominal[0])
        late = [from_seconds(each) for each in 1e-3 * rng.normal(size=len(true.events))]
        events = [replace(e, stamp=e.stamp + s) for e, s in zip(true.events, late, strict=True)]
        start = true.states[0] + 0.5 * rng.normal(size=4)
        watcher = watching(wrong, start, [free], 1e-3, deviation=0.5)
        ((_, found, claimed),) = fed(watcher, events).estimate(int(true.stamps[-1])).parameters
        squares.append(((found - right) / claimed) ** 2)
    assert 0.3 < np.mean(squares) < 2.0


def test_estimated_restitutions_stay_within_their_bounds() -> None:
    """Published restitutions are between 0 and 1, however large the errors of stamps."""
    model = system(1.0, 0.0, 4.0, contacts=[([1.0], 0.2, 0.95)])
    true = run(model, np.array([0.5]), np.array([0.0]), seconds=20.0)
    rng = np.random.default_rng(1)
    watcher = watching(bouncier(model, -0.3), np.array([0.3, 0.2]), ["restitution=0.5"], 0.05)
    for each in true.events[:12]:
        watcher.receive(replace(each, stamp=each.stamp + from_seconds(0.05 * rng.normal())))
        ((_, value, _),) = watcher.estimate(each.stamp + NS_PER_S // 10).parameters
        assert 0.0 <= value <= 1.0


def test_names_and_deviations_are_read_as_users_write_them() -> None:
    """A kind is all of its members; a deviation of one beats that of its kind."""
    model = sample("three_mass")
    unknowns = UnknownParameters.named(model.system, ["gap = 0.01", "restitution"])
    assert unknowns.family.names == (
        "gap.right",
        "gap.left",
        "restitution.right",
        "restitution.left",
    )
    assert unknowns.deviations.tolist() == [0.01, 0.01, 0.1, 0.1]
    unknowns = UnknownParameters.named(
        model.system, ["gap.left=0.02", "stiffness.x1-x2", "mass.x2=0.3"], model.elements
    )
    assert unknowns.family.names == ("stiffness.x1-x2", "mass.x2", "gap.left")
    np.testing.assert_allclose(unknowns.deviations, [0.05 * 25, 0.3, 0.02])


@pytest.mark.parametrize(
    ("wanted", "error"),
    [
        (("clock-offset",), "declare clock_offset_error instead"),
        (("latency",), "identify it first .*, and give the model that this writes"),
        (("restitution=",), "nothing found after ="),
        (("restitution=much",), "much found after ="),
        (("restitution=0",), "deviation of restitution.stop: 0 found"),
        (("restitution=nan",), "deviation of restitution.stop: nan found"),
        (("restitution=1e5",), "100000 found; expected 1e-12 to 1"),
        (("stiffness-scale=1e-130",), "1e-130 found; expected 1e-12 to 1"),
        (("elasticity",), "parameter 'elasticity'"),
        (("restituton",), "'restituton'"),
        (("gap.stopp",), "'gap.stopp'"),
        (("mass.x1",), "'mass.x1'"),
        (("restitution", "restitution.stop"), "found twice"),
    ],
)
def test_parameters_that_cannot_be_estimated_are_refused_by_name(
    wanted: tuple[str, ...], error: str
) -> None:
    """In one line."""
    options = Options("minimum-variance", estimate_parameters=wanted)
    with pytest.raises(UsageError, match=error):
        make_observer(sample("two_mass").system, options)


def test_a_law_that_estimates_no_parameters_refuses_them() -> None:
    """Rather than ignore them."""
    options = Options("geometric", estimate_parameters=("restitution",))
    with pytest.raises(UsageError, match="the law geometric estimates none"):
        make_observer(sample("two_mass").system, options)


def test_of_several_laws_those_that_estimate_no_parameters_have_none() -> None:
    """Others keep them."""
    both = options_of_laws(
        Options(estimate_parameters=("restitution",)), ["geometric", "minimum-variance"]
    )
    assert [each.estimate_parameters for each in both] == [(), ("restitution",)]
