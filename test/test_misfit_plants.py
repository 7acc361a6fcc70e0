# SPDX-License-Identifier: Apache-2.0
"""The plants of ``./dev bench misfit``, against the package's own plant and free flights."""

import sys
from collections.abc import Sequence

import numpy as np
import pytest
import systems
from numpy.typing import NDArray

from benchmarks.harness import SkippedError
from benchmarks.misfit_motion import EPOCH, AccumulationError, Motion, Recording, Truth
from benchmarks.misfit_plants import KINDS, WrongPlant, plants
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, seconds_between

EXACT = [each for each in plants() if each.kind == "exact"]
RNG = np.random.default_rng(0)


def named(name: str) -> WrongPlant:
    """One of the plants."""
    return next(each for each in plants() if each.name == name)


def thrown(
    truth: Truth, position: Sequence[float], velocity: Sequence[float], seconds: float
) -> Recording:
    """A run from a given state."""
    return Motion(truth, np.array([*position, *velocity], float), seconds, RNG).run()


@pytest.mark.slow
@pytest.mark.parametrize("plant", EXACT, ids=[each.name for each in EXACT])
def test_exact_plant_is_the_packages_own(plant: WrongPlant) -> None:
    """Two integrators that share nothing agree on impacts and states over 12 s."""
    found = plant.run(0, 12.0)
    start = np.split(found.states[0], 2)
    own = simulate(Plant(plant.model, *start, epoch=EPOCH), found.sample_stamps)
    order = {name: i for i, name in enumerate(plant.model.contact_names)}
    contacts = [order[each.switches[0].contact] for each in own.events]
    assert len(contacts) > 5
    assert found.contacts.tolist() == contacts
    errors = [seconds_between(a.stamp, b) for a, b in zip(own.events, found.stamps, strict=True)]
    assert np.max(np.abs(errors)) <= 1e-9
    assert np.max(np.abs(own.states - found.states)[found.away()]) < 1e-9


@pytest.mark.parametrize("eps", [0.3, 0.9])
@pytest.mark.parametrize("duration", [1e-3, 4e-3])
def test_finite_contact_has_its_duration_and_the_restitution(eps: float, duration: float) -> None:
    """A free mass hits the stop at 2 m/s after 0.1 s."""
    model = systems.system(1.7, 0, 0, contacts=[([1.0], 0.0, eps)])
    found = thrown(Truth(model, contact_time=duration), [0.2], [-2.0], 0.2)
    (stamp,), (end,) = found.stamps, found.ends
    assert seconds_between(EPOCH, stamp) == pytest.approx(0.1, abs=1e-8)
    assert seconds_between(stamp, end) == pytest.approx(duration, rel=1e-5)
    assert found.states[-1, 1] == pytest.approx(2.0 * eps, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("contact_time", [0.0, 1e-3])
def test_a_mass_that_comes_to_rest_on_its_stop_ends_the_run(contact_time: float) -> None:
    """Its impacts accumulate, or the contact does not end."""
    model = systems.system(
        1.0, 0, 0, contacts=[([1.0], 0.0, 0.2)], force=systems.forcing(1, [-9.81])
    )
    with pytest.raises(AccumulationError, match="c1"):
        thrown(Truth(model, contact_time=contact_time), [0.1], [0.0], 2.0)


def test_impacts_within_a_step_are_found() -> None:
    """A fast mass between close stops hits every 2 ms."""
    model = systems.system(1.0, 0, 0, contacts=[([1.0], 0.01, 1.0), ([-1.0], 0.01, 1.0)])
    found = thrown(Truth(model), [0.0], [10.0], 0.2)
    expected = EPOCH + np.arange(1_000_000, NS_PER_S // 5, 2_000_000)
    assert np.max(np.abs(found.stamps - expected)) < 10
    assert found.contacts.tolist() == [1, 0] * 50


def test_every_kind_and_model_is_in_both_groups() -> None:
    """What is held back is no repetition of what is tuned."""
    names = [each.name for each in plants()]
    assert len(set(names)) == len(names)
    assert not any(" " in name for name in names)
    by_group: dict[str, tuple[set[str], set[str]]] = {}
    for group in ("tuned", "held back"):
        members = [each for each in plants() if each.group == group]
        by_group[group] = ({e.kind for e in members}, {e.model.name for e in members})
    assert by_group["tuned"] == by_group["held back"]
    assert all(tuned != held_back for kind in KINDS for _, tuned, held_back in kind.rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    "plant",
    [each for each in plants() if each.kind not in {"exact", "mujoco"}],
    ids=lambda each: each.name,
)
def test_wrong_plant_starts_as_the_exact_one_and_departs_from_it(plant: WrongPlant) -> None:
    """In the coordinates of the model, within the first seconds with impacts."""
    found = plant.run(3, 3.0)
    (exact,) = (each for each in EXACT if each.model is plant.model)
    states: NDArray[np.float64] = exact.run(3, 3.0).states
    assert found.states.shape == (151, 2 * plant.model.n)
    np.testing.assert_array_equal(found.states[0], states[0])
    assert np.max(np.abs(found.states - states)) > 1e-6


def test_a_run_is_a_function_of_its_seed() -> None:
    """Random restitution is drawn from it, too."""
    plant = named("two_mass-random-restitution-0.03")
    first, again, other = (plant.run(seed, 5.0) for seed in (1, 1, 2))
    assert first.stamps.tolist() == again.stamps.tolist()
    assert first.stamps.tolist() != other.stamps.tolist()


def test_samples_away_from_contacts_are_selected() -> None:
    """From the margin before the onset to the margin after the end."""
    found = Recording(
        np.array([100, 104]) * 10**6,
        np.array([0, 1]),
        np.array([110, 105]) * 10**6,
        np.array([94, 96, 102, 107, 112, 114, 116]) * 10**6,
        np.zeros((7, 2)),
    )
    assert found.away(0.005).tolist() == [True, False, False, False, False, False, True]


def test_without_mujoco_its_plants_are_skipped_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The others go on."""
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(SkippedError, match="mujoco is not installed"):
        named("two_mass-mujoco-0.001").run(0, 1.0)
