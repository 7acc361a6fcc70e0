# SPDX-License-Identifier: Apache-2.0
"""Considered parameters (Schmidt): their errors are in every covariance, their values stay."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, sample

from impact_observer import Options, make_observer
from impact_observer.errors import UsageError
from impact_observer.model import Model, System
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.parameter_uncertainty import ParameterUncertainty
from impact_observer.observer import Observer
from impact_observer.observer.unknown_parameters import UnknownParameters
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, from_seconds, grid

Array = NDArray[np.float64]


def declared(model: Model, **deviations: float) -> Model:
    """The model with independent deviations of parameters; ``_`` in names is ``-``, ``__`` ``.``.

    So ``stiffness_scale=0.01`` and ``restitution__stop=0.02``.
    """
    names = tuple(name.replace("__", ".").replace("_", "-") for name in deviations)
    covariance = np.diag([*deviations.values()]) ** 2
    return replace(model, uncertainty=ParameterUncertainty(names, covariance))


def plant_of(system: System, x: Array, seconds: float) -> Run:
    """A run of a plant."""
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), 4.0)
    return simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps)


def watched(model: Model, run: Run, start: Array, jitter: float, seed: int) -> Observer:
    """An observer after the impacts of a run with normal errors of their stamps, s."""
    text = ",".join(f"{each:.17g}" for each in start)
    options = Options(
        "minimum-variance",
        text,
        epoch=EPOCH,
        clock_error=jitter,
        model_error=0.0,
        initial_deviation="0.1",
        history=1e4,
        missed=0.0,
        spurious=0.0,
        mislabelled=0.0,
    )
    observer, rng = make_observer(model, options), np.random.default_rng(seed)
    for event in run.events:
        late = round(jitter * NS_PER_S * rng.normal())
        observer.receive(replace(event, stamp=max(event.stamp + late, EPOCH)))
    return observer


@pytest.mark.long
@pytest.mark.parametrize(
    "deviations",
    [
        {"restitution__stop": 0.02},
        {"stiffness_scale": 0.005, "gap__stop": 0.002},
        {"mass_scale": 0.005, "forcing_amplitude__1": 0.01},
    ],
)
def test_errors_agree_with_the_covariance_for_plants_with_drawn_parameters(
    deviations: dict[str, float],
) -> None:
    """Each plant has its own parameters, the observer has the mean; NEES over 2n is near one."""
    jitter, seconds = 1e-3, 12.0
    model = declared(sample("two_mass"), **deviations)
    assert model.uncertainty is not None
    names, sizes = model.uncertainty.names, model.uncertainty.deviations
    family = parametric_family(model.system, names)
    exact = replace(model, uncertainty=None)
    consistent, sure = list[float](), list[float]()
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        theta = family.nominal + sizes * rng.normal(size=sizes.size)
        x = np.concatenate([[0.1, -0.2], [0.5, 0.0]])
        run = plant_of(family.system_at(theta), x, seconds)
        start = x + 0.1 * rng.normal(size=4)
        for each, squares in ((model, consistent), (exact, sure)):
            observer = watched(each, run, start, jitter, seed)
            for stamp, true in zip(run.stamps[16:], run.states[16:], strict=True):
                if min(abs(e.stamp - stamp) for e in run.events) < 5 * jitter * NS_PER_S:
                    continue
                estimate = observer.estimate(int(stamp))
                assert estimate.covariance is not None
                error = np.concatenate([estimate.q, estimate.u]) - true
                squares.append(error @ np.linalg.solve(estimate.covariance, error) / 4)
    assert 0.4 < np.mean(consistent) < 1.6
    assert np.mean(sure) > 2 * np.mean(consistent)


def test_considered_parameters_are_not_reported_as_estimated() -> None:
    """Those that are named beside them are, and both have the declared deviations."""
    model = declared(sample("two_mass"), restitution__stop=0.02, stiffness_scale=0.01)
    run = plant_of(model.system, np.array([0.1, -0.2, 0.5, 0.0]), 6.0)
    options = Options("minimum-variance", epoch=EPOCH, estimate_parameters=("restitution",))
    observer = make_observer(model, options)
    assert observer.law.uncertainty.unknowns is not None
    unknowns = observer.law.uncertainty.unknowns
    assert unknowns.family.names == ("stiffness-scale", "restitution.stop")
    assert unknowns.estimated == ("restitution.stop",)
    np.testing.assert_allclose(unknowns.deviations, [0.01, 0.02])
    for each in run.events:
        observer.receive(each)
    names = [name for name, *_ in observer.estimate(run.events[-1].stamp).parameters]
    assert "restitution.stop" in names
    assert "stiffness-scale" not in names


def test_correlations_hold_between_estimated_and_considered_parameters() -> None:
    """A deviation that the user gives scales them."""
    covariance = np.array([[4e-4, 1e-4], [1e-4, 1e-4]])
    names = ("restitution.stop", "stiffness-scale")
    model = replace(sample("two_mass"), uncertainty=ParameterUncertainty(names, covariance))
    unknowns = UnknownParameters.named(
        model.system, ["restitution=0.1"], uncertainty=model.uncertainty
    )
    assert unknowns.family.names == ("stiffness-scale", "restitution.stop")
    expected = [[1e-4, 1e-4 * 5], [1e-4 * 5, 0.01]]
    np.testing.assert_allclose(unknowns.covariance, expected)
    np.testing.assert_allclose(unknowns.root @ unknowns.root.T, expected)


def test_a_deviation_of_zero_means_exact() -> None:
    """The estimate is that of a model without deviations, to the bit, and of a bare system.

    Only a file that declares nothing has a published deviation for small errors of all numbers.
    """
    silent = sample("two_mass")
    exact = declared(silent, restitution__stop=0.0)
    run = plant_of(silent.system, np.array([0.1, -0.2, 0.5, 0.0]), 6.0)
    options = Options("minimum-variance", epoch=EPOCH)
    found = []
    for model in (silent, exact, silent.system):
        observer = make_observer(model, options)
        for each in run.events:
            observer.receive(each)
        found.append(observer.estimate(run.events[-1].stamp))
    for estimate in found:
        np.testing.assert_array_equal(estimate.q, found[0].q)
        np.testing.assert_array_equal(estimate.u, found[0].u)
    np.testing.assert_array_equal(found[1].covariance, found[2].covariance)
    added = found[0].covariance - found[1].covariance
    np.testing.assert_array_equal(added, np.diag(np.diag(added)))
    motion = np.sqrt(np.mean(run.states**2, axis=0))
    deviations = np.sqrt(np.diag(added)) / motion
    assert np.all((deviations > 1e-6) & (deviations < 1e-4))


def test_a_scale_is_not_estimated_beside_a_considered_part() -> None:
    """The error names both."""
    model = sample("two_mass")
    names = ("stiffness.ground-x1",)
    own = replace(model, uncertainty=ParameterUncertainty(names, np.array([[0.01]])))
    with pytest.raises(UsageError, match="stiffness-scale"):
        make_observer(own, Options("minimum-variance", estimate_parameters=("stiffness-scale",)))
