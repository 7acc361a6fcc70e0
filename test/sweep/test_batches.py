# SPDX-License-Identifier: Apache-2.0
"""Cases that differ in their start only are computed at once, with the outcomes of each alone."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from systems import LAPLACIAN, PRESSED, Harmonic, chain, forcing, sample, system

from impact_observer.errors import ImpactLawError
from impact_observer.events import Contacts
from impact_observer.model import Model, System
from impact_observer.model.force_samples import Samples
from impact_observer.observer import Options, ReplicaLaw, make_observer
from impact_observer.observer.laws import BUILT_IN, Geometric
from impact_observer.states import Vector
from impact_observer.sweep import case_runs, plan
from impact_observer.sweep.case_runs import Outcome, run_batch, run_case
from impact_observer.sweep.model_variants import model_variants
from impact_observer.sweep.plan import PlantSetup, Sweep, plant_run, sensors_of

LAWS = ("open-loop", "kinematic", "geometric")
COUNTED = ("case", "events", "impacts_used", "switches_rejected", "impacts_inserted", "error")
METRICS = (
    "V_start",
    "V_end",
    "V_ratio",
    "V_largest_rise",
    "rate_per_second",
    "rate_per_impact",
)
Values = Mapping[str, Sequence[float | bool]]
NOTHING: Values = {}


def swept(
    model: Model,
    *laws: str,
    faults: Values = NOTHING,
    off: Mapping[str, Sequence[float]] = {},
    runs: int = 7,
    seconds: float = 12.0,
    rate: float = 50.0,
) -> Sweep:
    """A short sweep."""
    setup = PlantSetup(model.text(), seconds, rate, 3_000_000_000)
    variants = model_variants(model, off)
    return Sweep(setup, laws or LAWS, sensors_of(faults), variants, runs, seed=5)


def driven(n: int) -> System:
    """A chain whose damping couples its modes, with two contacts at different bodies."""
    force = forcing(n, 0.5, [Harmonic(2.1, [3.0] * n, [1.0] * n)])
    contacts = [(np.eye(n)[0], 0.4, 0.8), (-np.eye(n)[-1], 0.3, 0.5)]
    damped = chain(n, contacts=contacts, force=force)
    return replace(damped, C=damped.C + np.diag(np.linspace(0.0, 0.4, n)))


def model_of(found: System) -> Model:
    """A model whose plant starts at rest."""
    return Model(found, np.zeros(found.n), np.zeros(found.n))


def shaken(hold: str) -> Model:
    """A model of two masses under a sampled force."""
    found = sample("two_mass").system
    time = np.linspace(0.0, 20.0, 81)
    force = np.stack([np.zeros(81), 4 * np.sin(2.5 * time)], axis=1)
    return model_of(
        replace(found, forcing=replace(forcing(2), sampled=Samples(time, force, hold)))
    )


FREE = system(
    np.eye(3),
    0.1 * LAPLACIAN,
    20 * LAPLACIAN,
    contacts=[([-1, 0, 0], 0.4, 0.9), ([0, 0, 1], 0.6, 0.7)],
    force=forcing(3, 0.0, [Harmonic(1.7, [0, 0, 5], [0, 0, 0])]),
)
"""K is singular: V does not see where the three masses are."""
RESONANT = system(
    [[1.0]], [[0.0]], [[4.0]],
    contacts=[([-1.0], 0.5, 0.6)],
    force=forcing(1, 0.0, [Harmonic(2.0, [1.0], [0.0])]),
)  # fmt: skip


def assert_same_outcomes(sweep: Sweep) -> list[Outcome]:
    """Check the outcomes of all batches against those of each case alone."""
    found: list[Outcome] = []
    for batch in sweep.batches():
        assert len(batch) == sweep.runs
        # Not ``run_batch``, which would run each alone if that fails.
        outcomes = case_runs.outcomes_together(batch)
        for case, outcome in zip(batch, outcomes, strict=True):
            assert_same_outcome(outcome, run_case(case))
        found += outcomes
    assert [each.case for each in found] == [*range(sweep.size)]
    return found


def assert_same_outcome(outcome: Outcome, alone: Outcome) -> None:
    """Check all metrics; V is rounded by its largest terms, those of the states."""
    for name in COUNTED:
        assert getattr(outcome, name) == getattr(alone, name), name
    assert outcome.settling_time == alone.settling_time
    if alone.error:
        return
    small = {"V_end": 1e-28 * (alone.V_start or 1.0), "V_ratio": 1e-28, "V_largest_rise": 1e-13}
    for name in METRICS:
        found, expected = getattr(outcome, name), getattr(alone, name)
        assert (found is None) == (expected is None), name
        assert found is None or abs(found - expected) <= 1e-8 * expected + small.get(name, 0), name


@pytest.mark.parametrize("name", ["two_mass", "three_mass"])
def test_a_batch_has_the_outcomes_of_its_cases(name: str) -> None:
    """Counts and times are equal; the plant hits, and starts settle at different times."""
    found = assert_same_outcomes(swept(sample(name), runs=4, seconds=20.0, rate=20.0))
    assert len({each.settling_time for each in found}) >= 4
    assert not any(each.error for each in found)


@pytest.mark.slow
@pytest.mark.parametrize(
    "model",
    [
        pytest.param(model_of(driven(4)), id="coupled modes"),
        pytest.param(model_of(FREE), id="K singular"),
        pytest.param(model_of(RESONANT), id="resonance"),
        pytest.param(shaken("previous"), id="steps of force"),
        pytest.param(shaken("linear"), id="ramps of force"),
        pytest.param(model_of(PRESSED), id="persistent contact"),
        pytest.param(sample("bouncing_ball"), id="accumulation"),
        pytest.param(sample("ball_on_table"), id="moving stops"),
    ],
)
def test_a_batch_has_the_outcomes_of_its_cases_for_any_model(model: Model) -> None:
    """Outcomes are equal also if contacts close and open, or impacts accumulate."""
    sweep = swept(model, runs=3, seconds=10.0)
    assert len(plant_run(sweep.plant).events) > 2
    assert_same_outcomes(sweep)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "value", "rate"),
    [
        ("delay", 0.05, 3.0),
        ("delay", 0.05, 333.0),
        ("clock_offset", -0.07, 20.0),
        ("quantisation", 0.1, 50.0),
        ("dead_time", 2.0, 50.0),
    ],
)
def test_samples_between_the_jumps_are_left_out_of_each_start(
    fault: str, value: float, rate: float
) -> None:
    """If stamps are wrong, each start has other samples between the jumps."""
    assert_same_outcomes(swept(sample("two_mass"), faults={fault: [value]}, rate=rate))


@pytest.mark.slow
def test_models_of_other_parameters_have_batches_of_their_own() -> None:
    """V is that of the plant's energy."""
    off = {"stiffness-scale": [0.97, 1.0, 1.05], "restitution": [0.6]}
    faults: Values = {"threshold": [0.0, 0.8], "impacts_only": [False, True]}
    assert_same_outcomes(
        swept(sample("three_mass"), "geometric", faults=faults, off=off, runs=3, seconds=6.0)
    )


def test_random_events_and_laws_that_move_each_replica_have_no_batches() -> None:
    """Their cases have events, or motions, of their own."""
    model = sample("two_mass")
    for fault in ("jitter", "missed", "spurious", "mislabelled"):
        model = sample("three_mass")
        assert {len(each) for each in swept(model, faults={fault: [0.01]}).batches()} == {1}
    assert {len(each) for each in swept(model, "unilateral", "minimum-variance").batches()} == {1}
    contact = replace(model.system.contacts[0], contact_time=2e-3)
    soft = replace(model, linear=replace(model.system, contacts=(contact,)))
    assert {len(each) for each in swept(soft).batches()} == {1}


def test_batches_are_the_same_whatever_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bits of outcomes do not depend on the point of interruption of a sweep."""
    monkeypatch.setattr(plan, "BATCH", 3)
    sweep = swept(sample("two_mass"), "geometric", "unilateral", faults={"delay": [0.0, 0.1]})
    every = [*sweep.batches()]
    assert [len(each) for each in every] == [3, 3, 1, 3, 3, 1] + [1] * 14
    assert [case for batch in every for case in batch] == [*sweep.cases()]
    assert [*sweep.batches({0, 1, 2, 4, 13, 15})] == [*every[1:5], every[6], *every[8:]]
    assert [*sweep.batches(range(sweep.size))] == []


def test_batches_are_small_where_contacts_stay_closed() -> None:
    """A replica in contact moves by itself, so that a whole batch would take minutes."""
    faults: Values = {"impacts_only": [False, True]}
    model = sample("bouncing_ball")
    sweep = swept(model, "geometric", faults=faults, runs=20)
    assert [len(each) for each in sweep.batches()] == [8, 8, 4, 20]


class Picky(Geometric):
    """A law without a solution for some states."""

    name = "picky"
    impacts = ReplicaLaw.impacts
    impact_ensemble = ReplicaLaw.impact_ensemble
    energy_removed = ReplicaLaw.energy_removed

    def impact(self, x: Vector, active: Contacts, closed: Contacts) -> Vector:
        """State after an impact, as of ``Geometric``, if the law has a solution."""
        if abs(x[0]) > 1.2:
            raise ImpactLawError("no solution")
        return super().impact(x, active, closed)


def test_a_start_without_a_solution_fails_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others of its batch have their outcomes."""
    monkeypatch.setitem(BUILT_IN, "picky", Picky)
    (batch,) = swept(sample("two_mass"), "picky", runs=6).batches()
    outcomes = run_batch(batch)
    assert outcomes == [run_case(case) for case in batch]
    failed = [each.error for each in outcomes if each.error]
    assert 0 < len(failed) < 6
    assert all(error.endswith("s: no solution") for error in failed)


def test_an_observer_runs_the_replicas_that_it_is_given() -> None:
    """The states of each replica are those of an observer with the same start."""
    model = sample("two_mass").system
    starts = np.random.default_rng(3).normal(size=(4, 4))
    epoch = 3_000_000_000
    options = Options(initial_state=",".join(map(str, starts[0])), epoch=epoch, ensemble=4)
    together = make_observer(model, options, others=starts[1:])
    stamps = np.array([epoch, epoch + 1, epoch + 700_000_000])
    x, maps, columns = together.replicas(stamps)
    assert columns is not None, "they move in one phase"
    assert (x.shape, maps.shape[::2], columns.shape[1]) == ((3, 4), (4, 3), 3)
    others = np.einsum("irk,rj->kij", maps, columns) + x[..., None]
    found = np.concatenate([x[..., None], others], axis=2)
    for i, start in enumerate(starts):
        text = ",".join(map(str, start))
        alone = make_observer(model, replace(options, initial_state=text, ensemble=1))
        for k, stamp in enumerate(stamps.tolist()):
            now = alone.estimate(stamp)
            expected = np.concatenate([now.q, now.u])
            np.testing.assert_allclose(found[k, :, i], expected, rtol=0, atol=1e-14)
