# SPDX-License-Identifier: Apache-2.0
"""Stops that drive the contact point at a prescribed speed: file, law, plant, filter, fit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from saltation_oracle import saltation_error
from systems import (
    EPOCH,
    chain,
    crossed,
    delassus,
    distance,
    estimates,
    examples,
    largest_rise,
    moving_systems,
    observer,
    passes_eigenvalue_test,
    run,
    sample,
    switched,
    switchings,
    system,
    systems,
    vectors,
    without_faults,
)

from impact_observer.check.model_check import check_model
from impact_observer.check.model_findings import findings
from impact_observer.dynamics import ImpactLaw
from impact_observer.errors import ModelError
from impact_observer.events import Kind
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.identify.identification import identify
from impact_observer.identify.model_edit import changes
from impact_observer.model import Model, System, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.model_file import edited, load_yaml
from impact_observer.model.rebounds.velocity_offset import VelocityOffset
from impact_observer.observer import ReplicaLaw
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.observer.laws.unilateral import Unilateral
from impact_observer.plant import Plant, Run
from impact_observer.plant.time_stepping import TimeSteppingPlant
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
LAWS = pytest.mark.parametrize("law", [Kinematic, Geometric, Unilateral], ids=lambda law: law.name)
G, EPS, V = 9.81, 0.6, 0.2
BALL = f"""
name: ball
bodies: [{{name: z, mass: 1}}]
forces: [{{body: z, constant: -{G}}}]
stops: [{{name: belt, body: z, limit: 0, side: below, restitution: {EPS}, velocity_offset: {V}}}]
initial_state: {{position: [1], velocity: [0]}}
"""


def driven(model: System, *offsets: float) -> System:
    """The same system whose stops drive at these speeds."""
    contacts = zip(model.contacts, offsets, strict=True)
    laws = [replace(c, rebound=VelocityOffset(c.restitution, v)) for c, v in contacts]
    return replace(model, contacts=tuple(laws))


def rig() -> Model:
    """``two_mass`` on a stop that drives."""
    model = sample("two_mass")
    return replace(model, linear=driven(model.system, V))


def driven_systems(most: int) -> st.SearchStrategy[System]:
    """Systems on stops that drive, at rest or on moving grounds, in which no impact raises V."""
    kinds = [each(contacts=(1, most), gaps=(0.0, 1.0)) for each in (systems, moving_systems)]
    offsets = st.lists(st.integers(0, 8), min_size=most, max_size=most)
    pairs = st.tuples(st.one_of(*kinds).filter(passes_eigenvalue_test), offsets)
    return pairs.map(lambda pair: driven(pair[0], *(v / 8 for v in pair[1][: pair[0].m])))


def test_stop_that_drives_survives_the_text_of_its_model() -> None:
    """In elements and in matrices."""
    model = parse_model(BALL, "ball")
    assert model.system.contacts[0].rebound == VelocityOffset(EPS, V)
    for written in (model, replace(model, element_form={})):
        again = parse_model(written.text(), "again")
        assert again.text() == written.text()
        assert again.system.contacts[0].rebound == VelocityOffset(EPS, V)


@pytest.mark.parametrize(
    ("found", "line"),
    [
        ("velocity_offset: -0.1", "velocity_offset: is -0.1; expected a number not below zero"),
        ("velocity_offset: up", "velocity_offset: 'up' found; expected a number"),
        ("velocity_offset: .inf", "velocity_offset: is not finite"),
        ("velocity_offset: 0.2, contact_time: 0.01", "contact_time: is 0.01; expected none"),
    ],
)
def test_mistake_in_a_stop_that_drives_is_one_line(found: str, line: str) -> None:
    """The line names the file, the key and what is expected."""
    with pytest.raises(ModelError) as caught:
        parse_model(BALL.replace(f"velocity_offset: {V}", found), "my.yaml")
    text = str(caught.value)
    assert text.startswith(f"my.yaml: stops[0].{line}")
    assert "\n" not in text


def test_a_restitution_by_speed_beside_the_offset_is_refused_by_name() -> None:
    """The line names the restitution and the offset."""
    by_speed = "{value: 0.7, speed: 1, exponent: -0.1}"
    with pytest.raises(ModelError, match=r"restitution: depends .* beside velocity_offset"):
        parse_model(BALL.replace(f"restitution: {EPS}", f"restitution: {by_speed}"), "my.yaml")


def test_single_contact_rebounds_about_the_speed_of_its_stop() -> None:
    """``gamma+ - v = -eps (gamma- - v)`` in closed form, one by one and many at once."""
    model = system([[2, 0.5], [0.5, 1]], np.eye(2), np.eye(2), contacts=[([1, -3], 0.0, EPS)])
    law = ImpactLaw(driven(model, V))
    U = np.array([[-1.0, 0.5], [-0.1, 0.0], [0.0, 0.0], [0.1, 0.0], [0.3, 0.0]])
    after = np.array([law.velocity_after(u, (0,)) for u in U])
    before = U @ model.W[:, 0]
    expected = np.where(before < V, V - EPS * (before - V), before)
    np.testing.assert_allclose(after @ model.W[:, 0], expected, rtol=1e-13)
    np.testing.assert_allclose(law.velocities_held(U, (0,), ()), after, rtol=1e-15, atol=1e-15)


@examples(50)
@given(st.data())
def test_several_contacts_have_complementary_impulses_about_the_speeds_of_their_stops(
    data: st.DataObject,
) -> None:
    """``0 <= (gamma+ - v) + eps (gamma- - v)  _|_  Lambda >= 0``, put back into the law."""
    model = data.draw(systems(contacts=(2, 2), max_n=4))
    assume(np.linalg.matrix_rank(model.W) == 2)
    v = data.draw(vectors(2, 0.0, 1.0))
    law, u = ImpactLaw(driven(model, *v)), data.draw(vectors(model.n))
    impulses = law.impulses(u, (0, 1))
    relative = model.contact_speed(u) - v
    xi = delassus(model) @ impulses + relative + model.eps * relative
    size = 1e-9 * (1 + float(np.max(np.abs(relative))))
    assert np.all(impulses >= 0)
    assert np.all(xi >= -size)
    assert float(np.max(np.abs(impulses * xi))) <= size * (1 + float(np.max(impulses)))


@LAWS
@examples(20)
@given(st.data())
def test_distance_of_two_replicas_never_rises_whatever_the_stops_drive(
    law: type[ReplicaLaw], data: st.DataObject
) -> None:
    """Without a plant: random instants and contacts, pulses and intervals, K singular or not."""
    model = data.draw(driven_systems(3))
    replica = law(model)
    states = [replica.admissible(data.draw(vectors(2 * model.n))) for _ in range(2)]
    last = distance(model, *states)
    tolerance = 1e-10 * (1 + last)
    for found, _ in switched(replica, states, data.draw(switchings(model.m))):
        now = distance(model, *found)
        rounding = 1e-13 * max(float(np.max(np.abs(x))) for x in found) ** 2
        assert now <= last + tolerance + rounding
        last = now


@pytest.mark.slow
@LAWS
@examples(10)
@given(st.data())
def test_distance_of_a_replica_to_a_plant_on_driving_stops_never_rises(
    law: type[ReplicaLaw], data: st.DataObject
) -> None:
    """Under the true switching, at the true instants."""
    model = data.draw(driven_systems(2))
    x = np.concatenate([data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))])
    assume(np.all(model.gap(x[: model.n]) >= 0))
    x = model.from_frame(np.zeros(1, dtype=np.int64), x[None])[0]
    assert largest_rise(law(model), x, data.draw(vectors(2 * model.n))) <= 0


def ball_run(position: float, seconds: float) -> tuple[Run, Array]:
    """A run of the ball from rest at a height, and its impact times, s."""
    made = run(parse_model(BALL, "ball").system, [position], [0.0], seconds=seconds, rate=10.0)
    return made, np.array([(e.stamp - EPOCH) / NS_PER_S for e in made.events])


@pytest.mark.parametrize("height", [0.0, 1.0])
def test_ball_on_a_stop_that_drives_ends_in_the_flight_of_the_closed_form(height: float) -> None:
    """``gamma+ = -gamma- = v (1 + eps) / (1 - eps)``: one flight takes ``2 gamma+ / g``.

    A ball that lies on the stop is hit at once, and none ever comes to rest.
    """
    made, times = ball_run(height, 20.0)
    steady = V * (1 + EPS) / (1 - EPS)
    np.testing.assert_allclose(np.diff(times)[-20:], 2 * steady / G, rtol=0, atol=2e-9)
    assert {s.kind for e in made.events for s in e.switches} == {Kind.IMPACT}
    speed, expected = np.sqrt(2 * G * height), [np.sqrt(2 * height / G)]
    for _ in range(20):
        speed = V + EPS * (speed + V)
        expected.append(expected[-1] + 2 * speed / G)
    np.testing.assert_allclose(times[:21], expected, rtol=0, atol=2e-9)


def test_body_that_leaves_a_stop_that_drives_is_not_hit_at_the_start() -> None:
    """A gap that opens is no impact, however slowly it opens."""
    made = run(parse_model(BALL, "ball").system, [0.0], [V / 2], seconds=0.1, rate=1000.0)
    assert made.events[0].stamp - EPOCH == pytest.approx(V / G * NS_PER_S, abs=2)
    assert made.states[0, 1] == V / 2


@pytest.mark.long
def test_time_stepping_drives_by_the_same_law() -> None:
    """Its first impacts are those of the event-driven plant, up to a few steps."""
    model = rig()
    q, u = model.initial_state()
    plants = (
        Plant(model.system, q, u, epoch=EPOCH),
        TimeSteppingPlant(model.system, q, u, epoch=EPOCH, step=2e-4),
    )
    runs = [crossed(plant, 12.0) for plant in plants]
    assert not any(each.closed for found in runs for each in found)
    times = [[each.instant.stamp for each in found] for found in runs]
    assert len(times[0]) == len(times[1]) >= 4
    np.testing.assert_allclose(times[0], times[1], rtol=0, atol=3e-3 * NS_PER_S)


@pytest.mark.parametrize("seed", range(4))
def test_saltation_at_a_stop_that_drives_has_the_derivative_of_the_jump(seed: int) -> None:
    """The oracle is the map of an impact at the own root, with its finite differences."""
    model = driven(chain(2, damping=0.3, contacts=[([0, -1], 0.3, 0.7)]), 0.4)
    assert saltation_error(model, np.random.default_rng(seed)) < 1e-7


def test_minimum_variance_synchronizes_on_a_stop_that_drives() -> None:
    """V falls to 1e-14 of V0 with exact events."""
    model = rig()
    made = run(model.system, *model.initial_state(), seconds=30.0, rate=10.0)
    start = np.concatenate(model.initial_state()) + np.array([0.5, -0.3, 0.4, -0.6])
    watcher = observer(model.system, "minimum-variance", start, ensemble=10)
    for each in made.events:
        watcher.receive(each)
    last = estimates(watcher, made.stamps[-1:])[0]
    initial = distance(model.system, start, made.states[0])
    assert distance(model.system, last, made.states[-1]) <= 1e-14 * initial
    assert watcher.estimate(int(made.stamps[-1])).synchronized


@pytest.mark.long
def test_covariance_is_honest_at_a_stop_that_drives() -> None:
    """Mean of the normalised error squared over 30 runs whose stamps jitter by 1 ms."""
    model, jitter, squares = rig(), 1e-3, []
    made = run(model.system, *model.initial_state(), seconds=30.0, rate=25.0)
    at = next(k for k, s in enumerate(made.stamps) if s > made.events[14].stamp + 10_000_000)
    assert made.stamps[at] < made.events[15].stamp - 10_000_000
    for seed in range(30):
        rng = np.random.default_rng(seed)
        start = np.concatenate(model.initial_state()) + rng.normal(size=4)
        declared = without_faults(clock_error=jitter)
        watcher = observer(model.system, "minimum-variance", start, uncertainty=declared)
        for each in made.events[:15]:
            wrong = round(rng.normal(0.0, jitter * NS_PER_S))
            watcher.receive(replace(each, stamp=max(each.stamp + wrong, EPOCH + 1)))
        found = watcher.estimate(int(made.stamps[at]))
        error = np.concatenate([found.q, found.u]) - made.states[at]
        squares.append(error @ np.linalg.solve(found.covariance, error) / error.size)
    assert 0.6 <= np.mean(squares) <= 1.4
    assert np.max(squares) < 6


@pytest.mark.slow
def test_missed_impacts_of_a_ball_are_inserted_and_never_taken_for_a_rest() -> None:
    """Every third impact is missed; the clock hardly resolves a flight of 0.16 s."""
    model = parse_model(BALL, "ball")
    made = run(model.system, *model.initial_state(), seconds=20.0, rate=25.0)
    declared = without_faults(clock_error=0.05, missed=0.4)
    start = np.concatenate(model.initial_state()) + np.array([0.05, 0.1])
    watcher = observer(model.system, "minimum-variance", start, uncertainty=declared)
    for k, each in enumerate(made.events):
        if k % 3:
            watcher.receive(each)
    found = watcher.estimate(int(made.stamps[-1]))
    assert found.closed == ()
    error = np.concatenate([found.q, found.u]) - made.states[-1]
    assert np.all(np.abs(error) <= 6 * np.sqrt(np.diag(found.covariance)))


@pytest.mark.slow
def test_restitution_and_offset_are_identified_and_written_back() -> None:
    """From 60 s of exact times, to 1e-4; the model file gets them in their places."""
    model = rig()
    made = run(model.system, *model.initial_state(), seconds=60.0, rate=1.0)
    stop = model.system.contacts[0]
    wrong = replace(model.system, contacts=(replace(stop, rebound=VelocityOffset(0.65, 0.15)),))
    family = parametric_family(wrong, ["restitution", "velocity-offset"])
    found = identify(family, list(made.events))
    assert found.converged
    np.testing.assert_allclose(found.values, [stop.restitution, V], rtol=1e-4)
    for own in (parse_model(BALL, "ball"), replace(parse_model(BALL, "ball"), element_form={})):
        fitted = parametric_family(own.system, ["restitution", "velocity-offset"])
        entries = changes(load_yaml(own.text()), fitted, np.array([0.5, 0.3]))  # type: ignore[arg-type]
        again = parse_model(edited(own.text(), entries), "fitted")
        assert again.system.contacts[0].rebound == VelocityOffset(0.5, 0.3)


def test_offset_is_learned_on_line() -> None:
    """With the state, from exact times."""
    model = rig()
    made = run(model.system, *model.initial_state(), seconds=30.0, rate=1.0)
    stop = model.system.contacts[0]
    wrong = replace(stop, rebound=VelocityOffset(stop.restitution, 0.15))
    wanted = UnknownParameters.named(
        replace(model.system, contacts=(wrong,)), ["velocity-offset=0.1"]
    )
    declared = without_faults(unknowns=wanted)
    start = np.concatenate(model.initial_state()) + np.array([0.1, -0.1, 0.1, -0.1])
    watcher = observer(wanted.family.system, "minimum-variance", start, uncertainty=declared)
    for each in made.events:
        watcher.receive(each)
    ((name, value, _),) = watcher.estimate(int(made.stamps[-1])).parameters
    assert name == f"velocity-offset.{stop.name}"
    assert value == pytest.approx(V, abs=1e-6)


def test_check_model_says_that_the_stop_adds_energy_and_raises_no_v() -> None:
    """One line for the stop; the proof of V holds, that of the kinetic energy does not."""
    checked = check_model(parse_model(BALL, "ball").system)
    assert checked.nonexpansive
    texts = [each.text for each in findings(checked)]
    assert any("belt drives what it hits at 0.2 m/s: impacts add energy" in t for t in texts)
    assert not any("adds kinetic energy" in t or "never leaves" in t for t in texts)


def test_rise_of_v_is_shown_by_two_solutions_that_hit_the_driving_stops() -> None:
    """In a corner of stops with restitutions 1 and 0: both speeds put into the impact law."""
    corner = system(
        np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=[([1, 0], 0.0, 1.0), ([1, 1], 0.0, 0.0)]
    )
    model = driven(corner, 0.3, 0.7)
    (found,) = check_model(model).growths
    law, directions = ImpactLaw(model), model.W.T
    one, two = (np.linalg.solve(directions, each) for each in (found.one, found.two))
    after = law.velocity_after(one, (0, 1)) - law.velocity_after(two, (0, 1))
    assert np.all(law.impulses(one, (0, 1)) > 0)
    assert after @ after == pytest.approx(found.factor * (one - two) @ (one - two))
