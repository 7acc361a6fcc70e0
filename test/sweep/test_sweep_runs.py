# SPDX-License-Identifier: Apache-2.0
"""Sweeps: cases that are values, one run of a case, groups of outcomes."""

import json
import math
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.compare import comparison
from impact_observer.errors import DynamicsError, UsageError
from impact_observer.model import Model, parse_model, read_model
from impact_observer.observer import Observer, Options, initial_state, law_named, replay_batches
from impact_observer.plant import Plant, SensorModel, simulate, simulate_sensor
from impact_observer.stamps import grid
from impact_observer.sweep import plan
from impact_observer.sweep.case_runs import Outcome, run_case
from impact_observer.sweep.model_variants import ParameterValue, model_variants
from impact_observer.sweep.plan import PlantSetup, Sweep, sensors_of
from impact_observer.sweep.summary import groups_of, quartiles

EPOCH = 2_000_000_000
NOTHING: Mapping[str, Sequence[float]] = {}
ELEMENTS = """
name: two_stops
bodies: [{name: a, mass: 1}, {name: b, mass: 2}]
springs:
  - {between: [ground, a], stiffness: 10, damping: 0.1}
  - {between: [a, b], stiffness: 20, damping: 0.1}
forces: [{body: b, amplitude: 4, frequency: 2.5}]
stops:
  - {name: right, body: b, limit: 0.5, side: above, restitution: 0.7}
  - {name: left, body: a, limit: -0.3, side: below, restitution: 0.6}
initial_state: {position: [0, 0], velocity: [0, 1]}
"""


def swept(
    *laws: str,
    faults: Mapping[str, Sequence[float]] = NOTHING,
    off: Mapping[str, Sequence[float]] = NOTHING,
    runs: int = 2,
    seconds: float = 6.0,
) -> Sweep:
    """A short sweep of two masses."""
    model = read_model("two_mass")
    return Sweep(
        PlantSetup(model.text(), seconds, 20.0, EPOCH),
        laws or ("geometric",),
        sensors_of(faults),
        model_variants(model, off),
        runs=runs,
    )


def test_cases_are_every_combination_and_share_the_seeds_of_their_runs() -> None:
    """Laws, faults and models are compared on equal starts and equal draws."""
    sweep = swept("geometric", "kinematic", faults={"jitter": [0.0, 1e-3]}, runs=3)
    cases = [*sweep.cases()]
    assert len(cases) == sweep.size == 2 * 2 * 3
    assert [case.number for case in cases] == [*range(12)]
    assert {(case.run, case.seed, case.options.initial_state) for case in cases} == {
        (0, 0, "random:0"),
        (1, 1, "random:1"),
        (2, 2, "random:2"),
    }
    assert len({(c.options.law, c.sensor.jitter, c.run) for c in cases}) == 12
    whole = swept(faults={"jitter": [0, 1], "impacts_only": [True]})
    kinds = [(type(v), v) for c in whole.cases() for k, v in c.labels.items() if "sensor_" in k]
    assert {kind for kind, value in kinds if value is not True} == {float}
    fixed = replace(sweep, seed=7, options=Options(initial_state="zero"))
    assert {(c.seed, c.options.initial_state) for c in fixed.cases()} == {
        (s, "zero") for s in (7, 8, 9)
    }


def test_a_case_is_a_value_that_can_be_sent_elsewhere() -> None:
    """Equal cases are equal, and what is unpickled has the same outcome."""
    sweep = swept(faults={"missed": [0.3]}, off={"stiffness-scale": [1.01]})
    case = next(sweep.cases())
    sent = pickle.loads(pickle.dumps(case))
    assert sent == case
    assert hash(sent) == hash(case)
    plan.plant_run.cache_clear()
    assert run_case(sent) == run_case(case)


@pytest.mark.slow
def test_outcomes_do_not_depend_on_the_order_of_the_cases() -> None:
    """Forwards, backwards, alone: the same bits."""
    laws, faults = ("geometric", "minimum-variance"), {"jitter": [0.0, 1e-3]}
    sweep = swept(*laws, faults=faults, seconds=2.0)
    forwards = [run_case(case) for case in sweep.cases()]
    backwards = [run_case(case) for case in reversed([*sweep.cases()])]
    assert backwards[::-1] == forwards
    assert len(set(forwards)) == sweep.size


@pytest.mark.parametrize("stiffness", [1.0, 1.02])
def test_metrics_are_those_of_a_single_run(stiffness: float) -> None:
    """Plant, sensor and observer put together by hand; V is by the energy of the plant."""
    model = read_model("two_mass")
    system = model.system
    sweep = swept(faults={"missed": [0.4]}, off={"stiffness-scale": [stiffness]}, seconds=9)
    case = [*replace(sweep, settled=0.5).cases()][1]
    stamps = grid(EPOCH, EPOCH + 9_000_000_000, 20.0)
    run = simulate(Plant(system, *model.initial_state(), epoch=EPOCH), stamps)
    sensor = SensorModel(missed=0.4)
    sensed = simulate_sensor(
        sensor, system, run.switchings, epoch=EPOCH, last=int(stamps[-1]), seed=1
    )
    assert 0 < len(sensed) < len(run.events)
    wrong = replace(system, K=stiffness * system.K)
    start = initial_state("random:1", system)
    observer = Observer(wrong, law_named("geometric")(wrong), *start, epoch=EPOCH, ensemble=1)
    for each in sensed:
        observer.receive(each.event)
    V = []
    for stamp, x in zip(stamps.tolist(), run.states, strict=True):
        now = observer.estimate(stamp)
        dq, du = now.q - x[:2], now.u - x[2:]
        V.append(float(du @ system.M @ du + dq @ system.K @ dq) / 2)
    above = np.flatnonzero(np.array(V) > 0.5 * V[0])[-1]
    found = run_case(case)
    assert found.error == ""
    assert found.events == len(sensed)
    assert found.settling_time == (above + 1) / 20 < 9
    assert found.V_start == pytest.approx(V[0], rel=1e-12)
    assert found.V_end == pytest.approx(V[-1], rel=1e-12)
    assert found.V_ratio == pytest.approx(V[-1] / V[0], rel=1e-12)


def test_a_case_that_fails_is_an_outcome_of_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any exception is an outcome; the other cases still run."""
    whole = replay_batches
    problems: list[Exception] = [DynamicsError("no solution"), TypeError("a mistake\nin a law")]

    def broken(*arguments: object, **options: object) -> object:
        if problems:
            raise problems.pop(0)
        return whole(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(comparison, "replay_batches", broken)
    sweep = swept(runs=4)
    outcomes = [run_case(case) for case in sweep.cases()]
    assert outcomes[0] == Outcome(0, error="no solution")
    assert outcomes[1] == Outcome(1, error="TypeError: a mistake in a law")
    (group,) = groups_of(sweep, outcomes)
    assert (group.runs, group.failed) == (4, 2)
    (alone,) = groups_of(sweep, outcomes[2:])
    assert (group.settling_time, group.V_ratio) == (alone.settling_time, alone.V_ratio)
    (nothing,) = groups_of(sweep, outcomes[:2])
    assert nothing.settling_time is None
    assert nothing.not_settled is None


def test_groups_differ_in_law_and_in_what_is_swept() -> None:
    """Groups are in the order of the sweep, whatever the order of the outcomes."""
    sweep = swept("geometric", "kinematic", faults={"jitter": [0.0, 1e-3], "missed": [0.1]})
    outcomes = [
        Outcome(k, settling_time=None if k % 2 else float(k), V_ratio=0.5**k) for k in range(8)
    ]
    groups = groups_of(sweep, outcomes[::-1])
    assert [(group.law, dict(group.labels)) for group in groups] == [
        (law, {"sensor_jitter": jitter})
        for law in ("geometric", "kinematic")
        for jitter in (0.0, 1e-3)
    ]
    assert [group.not_settled for group in groups] == [0.5] * 4
    ratio, time = groups[1].V_ratio, groups[1].settling_time
    assert ratio is not None
    assert ratio.median == (0.5**2 + 0.5**3) / 2
    assert time is not None
    assert time.median == math.inf


@examples(100)
@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=30), st.integers(0, 30))
def test_quartiles_of_runs_that_never_settle_are_infinite(times: list[float], never: int) -> None:
    """Quartiles of finite values are those of numpy; the others are infinite."""
    found = quartiles(times)
    assert found is not None
    np.testing.assert_allclose(found, np.quantile(times, [0.25, 0.5, 0.75]), rtol=1e-12)
    mixed = quartiles([*times, *[math.inf] * never])
    assert mixed is not None
    last = len(times) - 1
    for share, value in zip((0.25, 0.5, 0.75), mixed, strict=True):
        place = share * (len(times) + never - 1)
        assert math.isfinite(value) == (math.ceil(place) <= last)
    assert quartiles([]) is None


def replicas(off: Mapping[str, Sequence[float]]) -> list[Model]:
    """Models of the observers, for two stops."""
    model = parse_model(ELEMENTS, "elements")
    return [parse_model(each.text, "replica") for each in model_variants(model, off)]


def test_model_variants_differ_in_the_given_parameters_only() -> None:
    """A parameter is of all elements of a kind or of one; no variant has an initial state."""
    true = parse_model(ELEMENTS, "elements").system
    (plain,) = replicas({})
    assert plain.position is None
    np.testing.assert_array_equal(plain.system.K, true.K)
    found = replicas({"restitution": [0.5, 0.6], "stiffness.ground-a": [11.0]})
    assert [each.system.eps.tolist() for each in found] == [[0.5, 0.5], [0.6, 0.6]]
    for each in found:
        np.testing.assert_allclose(each.system.K - true.K, [[1, 0], [0, 0]], atol=1e-14)
        np.testing.assert_array_equal(each.system.M, true.M)
        np.testing.assert_array_equal(each.system.q_r, true.q_r)
    model = read_model("two_mass")
    (replica,) = model_variants(model, {"gap": [0.4]})
    assert replica.parameters == (ParameterValue("gap", 0.4, "m"),)


@pytest.mark.parametrize(
    ("off", "problem"),
    [
        ({"colour": [1.0]}, "off: .*'colour': this model has none; expected some of"),
        ({"restitution.right": [0.5, 1.5]}, r"off: restitution.right 1.5 found; expected 0 to 1"),
        ({"stiffness-scale": [math.nan]}, "off: stiffness-scale nan found"),
        ({"stiffness-scale": [1.0], "stiffness.a-b": [1.0]}, "stands beside stiffness"),
    ],
)
def test_values_that_a_model_cannot_have_are_refused(
    off: Mapping[str, Sequence[float]], problem: str
) -> None:
    """The error is one line that names the parameter."""
    with pytest.raises(UsageError, match=problem):
        replicas(off)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"laws": ("magic",)}, "law 'magic': not installed"),
        ({"laws": ()}, "0 cases found"),
        ({"runs": 10**9}, "cases found; expected 1 to"),
        ({"sensors": (SensorModel(mislabelled=0.1),)}, "sensor mislabelled"),
        ({"sensors": (SensorModel(clock_offset=-3.0),)}, "sensor clock_offset"),
        ({"options": Options(initial_deviation="-1")}, "deviation '-1'"),
        ({"plant": PlantSetup(read_model("two_mass").text(), 0.01, 20.0)}, "one sample found"),
    ],
)
def test_what_no_case_could_run_is_refused_at_once(
    change: dict[str, object], problem: str
) -> None:
    """The sweep is refused before anything runs."""
    with pytest.raises(UsageError, match=problem):
        replace(swept(), **change)  # type: ignore[arg-type]


def test_the_description_distinguishes_sweeps() -> None:
    """JSON keeps the description, which has everything that outcomes depend on."""
    sweep = swept(faults={"jitter": [0.0, 1e-3]}, off={"stiffness-scale": [1.0, 1.02]})
    changed = [
        replace(sweep, laws=("kinematic",)),
        replace(sweep, sensors=sweep.sensors[:1]),
        replace(sweep, variants=sweep.variants[::-1]),
        replace(sweep, runs=3),
        replace(sweep, seed=3),
        replace(sweep, settled=0.1),
        replace(sweep, options=Options(initial_state="zero")),
        replace(sweep, options=replace(sweep.options, missed=0.2)),
        *(
            replace(sweep, plant=plant)
            for plant in (
                replace(sweep.plant, duration=5.0),
                replace(sweep.plant, rate=10.0),
                replace(sweep.plant, epoch=3_000_000_000),
            )
        ),
    ]
    described = [json.dumps(each.description()) for each in (sweep, *changed)]
    assert len(set(described)) == 1 + len(changed)
    again = swept(faults={"jitter": [0.0, 1e-3]}, off={"stiffness-scale": [1.0, 1.02]})
    assert again.description() == json.loads(described[0])
