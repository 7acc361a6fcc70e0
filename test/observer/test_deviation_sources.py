# SPDX-License-Identifier: Apache-2.0
"""What the deviations come from: where there is one source, it has them all."""

from dataclasses import replace

import numpy as np
import pytest

from impact_observer.model import Model, ParameterUncertainty, read_model
from impact_observer.observer import Observer, Options, make_observer
from impact_observer.observer.deviation_sources import DeviationSources
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, grid

EPOCH = NS_PER_S
EXACT = Options(
    "minimum-variance",
    "0.1,-0.2,0.5,0",
    epoch=EPOCH,
    clock_error=0.0,
    model_error=0.0,
    missed=0.0,
    spurious=0.0,
    mislabelled=0.0,
)
CERTAIN = replace(EXACT, initial_deviation="0")


def known(names: tuple[str, ...], *deviations: float) -> Model:
    """two_mass with these deviations of its parameters."""
    uncertainty = ParameterUncertainty(names, np.diag(deviations) ** 2)
    return replace(read_model("two_mass"), uncertainty=uncertainty)


def observed(model: Model, impacts: int, options: Options) -> Observer:
    """An observer of an ideal recording of two_mass, after so many impacts."""
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, grid(EPOCH, EPOCH + 30 * NS_PER_S, 10.0))
    observer = make_observer(model, options)
    for each in run.events[:impacts]:
        observer.receive(each)
    return observer


def shares(observer: Observer) -> dict[str, list[float]]:
    """The shares of each source; they add up to one."""
    found = observer.deviation_sources()
    assert found is not None
    np.testing.assert_allclose(np.sum([*found.shares.values()], axis=0), 1.0)
    return {name: each.tolist() for name, each in found.shares.items()}


@pytest.mark.parametrize(
    ("source", "deviations", "impacts", "options"),
    [
        ("initial state", (0.0, 0.0), 3, EXACT),
        ("stamps", (0.0, 0.0), 30, replace(EXACT, clock_error=1e-3)),
        ("restitution.stop", (0.02, 0.0), 3, CERTAIN),
        ("gap.stop", (0.0, 0.001), 3, CERTAIN),
    ],
)
def test_the_only_source_has_all_of_the_deviation(
    source: str, deviations: tuple[float, float], impacts: int, options: Options
) -> None:
    """After many impacts the start is forgotten, after a few it is all that is uncertain."""
    model = known(("restitution.stop", "gap.stop"), *deviations)
    found = shares(observed(model, impacts, options))
    assert min(found[source]) > 0.99


def test_independent_sources_share_the_variance() -> None:
    """The parts of two parameters are those of each alone where there are no corrections."""
    deviations, names = (0.02, 0.001), ("restitution.stop", "gap.stop")
    options = replace(CERTAIN, clock_error=0.1)
    observers = [
        observed(known(names, *own), 4, options)
        for own in (deviations, (deviations[0], 0.0), (0.0, deviations[1]))
    ]
    both, *alone = (each.deviation_sources() for each in observers)
    assert both is not None
    for name, own in zip(names, alone, strict=True):
        assert own is not None
        variance = own.shares[name] * own.deviations**2
        np.testing.assert_allclose(both.shares[name] * both.deviations**2, variance, rtol=0.05)


def test_a_file_without_deviations_has_undeclared_errors() -> None:
    """After many exact impacts these are all that is published."""
    found = shares(observed(read_model("two_mass"), 30, EXACT))
    assert min(found["undeclared errors of the model"]) > 0.99


def test_laws_without_a_covariance_and_few_events_have_no_sources() -> None:
    """None is said, not a guess."""
    assert (
        observed(read_model("two_mass"), 5, replace(EXACT, law="geometric")).deviation_sources()
        is None
    )
    assert observed(read_model("two_mass"), 0, EXACT).deviation_sources() is None


def test_a_source_that_takes_from_another_has_no_share() -> None:
    """Parts of 2, 1 and -1 are shares of two thirds, a third and none."""
    parts = [("gap", np.array([2.0])), ("stamps", np.array([1.0])), ("force", np.array([-1.0]))]
    found = DeviationSources.of_parts(2, parts)
    shares = {name: share.item() for name, share in found.shares.items()}
    assert shares == pytest.approx({"gap": 2 / 3, "stamps": 1 / 3, "force": 0.0})
    assert found.deviations == pytest.approx([1.0])
