# SPDX-License-Identifier: Apache-2.0
"""Dry friction of prescribed load: sticking and slipping guides in plant and replicas."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import optimize
from scipy.integrate import solve_ivp
from systems import (
    EPOCH,
    Harmonic,
    chain,
    crossed,
    distance,
    estimates,
    event,
    examples,
    forcing,
    largest_rise,
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

from impact_observer.check.model_check import check_model, largest_kept
from impact_observer.check.model_findings import findings
from impact_observer.dynamics import Clutches, Phases, Piecewise
from impact_observer.errors import ModelError, UsageError
from impact_observer.events import Kind
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.model import System, parse_model
from impact_observer.model.system import Guide
from impact_observer.observability.rank import observability
from impact_observer.observer import ReplicaLaw
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.observer.laws.open_loop import OpenLoop
from impact_observer.observer.laws.unilateral import Unilateral
from impact_observer.plant import Plant, Switching
from impact_observer.plant.time_stepping import TimeSteppingPlant
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
LAWS = pytest.mark.parametrize("law", [Kinematic, Geometric, Unilateral], ids=lambda law: law.name)


def rubbing(model: System, *guides: tuple[Sequence[float], float]) -> System:
    """The same system with guides ``(direction, force)``."""
    rubs = tuple(
        Guide(f"g{i + 1}", np.array(direction, float), force)
        for i, (direction, force) in enumerate(guides)
    )
    return replace(model, guides=rubs)


def begun(model: System, x: Array) -> Plant:
    """A plant with the state ``x`` at ``EPOCH``."""
    return Plant(model, *np.split(x, 2), epoch=EPOCH)


def seconds_of(switching: Switching) -> float:
    """Its instant, s since the epoch."""
    return -switching.instant.until(EPOCH)


def test_free_oscillator_loses_4a_over_k_of_amplitude_a_cycle() -> None:
    """Half a cycle after the other, until it sticks where the spring is weaker than friction."""
    model = rubbing(system(2, 0, 50), ([1], 0.5))
    found = crossed(begun(model, np.array([0.205, 0.0])), 10.0)
    turns = np.array([0.205 - 0.02 * k for k in range(1, 11)]) * (-1.0) ** np.arange(1, 11)
    np.testing.assert_allclose([each.after[0] for each in found], turns, atol=1e-13)
    half = np.pi / 5 * np.arange(1, 11)
    np.testing.assert_allclose([seconds_of(each) for each in found], half, rtol=0, atol=1e-12)
    assert found[-1].held == (0,)  # the guide, as there is no contact
    assert all(not each.switches for each in found)


class Rubbed:
    """The same motion by an integrator of scipy and trying all kinds of motion of the guides."""

    def __init__(self, model: System) -> None:
        self.model = model

    def acceleration(self, t: float, x: Array, signs: Sequence[int]) -> tuple[Array, Array]:
        """Of guides that slip with ``signs`` or stick where it is 0; and the loads of these."""
        model, (q, u) = self.model, np.split(x, 2)
        a, W, s = model.friction, model.W_T, np.array(signs)
        force = model.forcing(t) - model.C @ u - model.K @ q - W @ (s * a)
        stuck = W[:, s == 0]
        G = stuck.T @ np.linalg.solve(model.M, stuck)
        loads = -np.linalg.lstsq(G, stuck.T @ np.linalg.solve(model.M, force), rcond=None)[0]
        return np.linalg.solve(model.M, force + stuck @ loads), loads

    def rate(self, signs: Sequence[int]) -> Callable[[float, Array], Array]:
        """``dx/dt`` of one kind of motion."""
        n = self.model.n
        return lambda t, x: np.concatenate([x[n:], self.acceleration(t, x, signs)[0]])

    def moved(self, t: float, x: Array, signs: Sequence[int], h: float) -> Array:
        """The state a short time ``h`` later, s."""
        path = solve_ivp(self.rate(signs), (t, t + h), x, rtol=1e-12, atol=1e-14)
        return np.asarray(path.y[:, -1])

    def kind(self, t: float, x: Array, still: Sequence[bool]) -> tuple[int, ...]:
        """The one that is consistent a moment later."""
        model, n = self.model, self.model.n
        slip = model.W_T.T @ x[n:]
        choices = [
            (-1, 0, 1) if r else (int(np.sign(v)),) for r, v in zip(still, slip, strict=True)
        ]
        found = []
        for signs in product(*choices):
            later, s = self.moved(t, x, signs, 1e-4), np.array(signs)
            turned = (s != 0) & np.array(still) & (s * (model.W_T.T @ later[n:]) <= 0)
            _, loads = self.acceleration(t + 1e-4, later, signs)
            if not np.any(turned) and np.all(np.abs(loads) < model.friction[s == 0]):
                found.append(signs)
        assert len(found) == 1, (t, found)
        return found[0]

    def ends(self, signs: Sequence[int]) -> list[Callable[[float, Array], float]]:
        """What ends a kind of motion: slips that vanish, loads that reach a bound."""
        model, stuck = self.model, [j for j, sign in enumerate(signs) if not sign]

        def vanishing(j: int) -> Callable[[float, Array], float]:
            return lambda _, x: float(signs[j] * model.W_T[:, j] @ x[model.n :])

        def reaching(j: int, side: int) -> Callable[[float, Array], float]:
            k, most = stuck.index(j), float(model.friction[j])
            return lambda t, x: most - side * float(self.acceleration(t, x, signs)[1][k])

        found = [vanishing(j) for j, sign in enumerate(signs) if sign]
        found += [reaching(j, side) for j in stuck for side in (1, -1)]
        for each in found:
            each.terminal, each.direction = True, -1  # type: ignore[attr-defined]
        return found

    def instants(self, x: Array, seconds: float) -> tuple[list[float], Array]:
        """When the kind of motion changes, s, and the state at the end."""
        model, n, t = self.model, self.model.n, 0.0
        found: list[float] = []
        still = [bool(abs(v) < 1e-12) for v in model.W_T.T @ x[n:]]
        while True:
            signs = self.kind(t, x, still)
            path = solve_ivp(
                self.rate(signs),
                (t, seconds),
                x,
                method="DOP853",
                rtol=1e-13,
                atol=1e-14,
                events=self.ends(signs),
                max_step=0.05,
            )
            t, x = float(path.t[-1]), path.y[:, -1]
            if path.status == 0:
                return found, x
            found.append(t)
            speeds = model.W_T.T @ x[n:]
            still = [not s or bool(abs(v) < 1e-11) for s, v in zip(signs, speeds, strict=True)]


@pytest.mark.long
def test_chain_under_dry_friction_moves_as_by_an_independent_integrator() -> None:
    """Every stick, slip and turn of three guides, to a nanosecond."""
    model = rubbing(
        chain(
            3,
            stiffness=30.0,
            damping=0.2,
            force=forcing(3, 0.0, [Harmonic(3.1, [0, 0, 6.0], [2.0, 0, 0])]),
        ),
        ([1, 0, 0], 1.0),
        ([-1, 1, 0], 0.7),
        ([0, -1, 1], 0.5),
    )
    x = np.array([0.05, -0.1, 0.2, 0.5, 0.0, -0.5])
    found = crossed(plant := begun(model, x), 6.0)
    instants, end = Rubbed(model).instants(x, 6.0)
    assert len(found) == len(instants) >= 20
    assert any(each.held for each in found)
    np.testing.assert_allclose([seconds_of(s) for s in found], instants, rtol=0, atol=1e-9)
    last = np.array([EPOCH + 6 * NS_PER_S])
    np.testing.assert_allclose(plant.states(last)[0], end, atol=1e-9)


def test_guides_that_depend_on_each_other_hold_together() -> None:
    """A growing pull on one of two bodies: both guides to the ground hold it until all slip."""
    pull = 5.0  # N, times sin t
    model = rubbing(
        system(np.eye(2), np.zeros((2, 2)), np.zeros((2, 2))),
        ([1, 0], 1.0),
        ([0, 1], 0.5),
        ([-1, 1], 0.8),
    )
    model = replace(model, forcing=forcing(2, 0.0, [Harmonic(1.0, [0, 0], [pull, 0])]))
    found = crossed(begun(model, np.zeros(4)), 0.5)
    slips = [each for each in found if each.held != found[0].held or not each.held]
    moving = [each for each in found if len(each.held) < 2]
    assert slips
    assert seconds_of(moving[0]) == pytest.approx(np.arcsin(1.5 / pull), abs=1e-9)


def test_contact_with_a_guide_on_the_same_body_opens_when_the_guide_slips() -> None:
    """The stop's load vanishes first; friction holds the body a while longer."""
    model = rubbing(
        system(1, 0.5, 0, contacts=[([1], 0.0, 0.5)], force=forcing(1, -3.0)), ([1], 1.0)
    )
    model = replace(model, forcing=forcing(1, 0.0, [Harmonic(1.0, [-3.0], [0.0])]))
    found = crossed(begun(model, np.array([0.0, 0.0])), 3.0)
    opened = [each for each in found if each.switches]
    assert [each.switches[0].kind for each in opened] == [Kind.CLOSE, Kind.OPEN]
    assert seconds_of(opened[-1]) == pytest.approx(np.arccos(-1 / 3), abs=1e-9)


@st.composite
def guided(draw: st.DrawFn, gaps: tuple[float, float] = (-1.0, 2.0)) -> System:
    """Systems with one to three guides in any direction."""
    model = draw(systems(contacts=(1, 2), max_n=3, gaps=gaps))
    guides = []
    for i in range(draw(st.integers(1, 3))):
        w = draw(vectors(model.n))
        w = w if np.any(w) else np.eye(model.n)[i % model.n]
        guides.append((w.tolist(), draw(st.integers(1, 24)) / 8))
    return rubbing(model, *guides)


@pytest.mark.slow
@LAWS
@examples(10)
@given(st.data())
def test_distance_of_two_replicas_never_rises(law: type[ReplicaLaw], data: st.DataObject) -> None:
    """Under any switching of contacts, each replica sticking and slipping by itself."""
    model = data.draw(guided())
    assume(passes_eigenvalue_test(model))
    replica = law(model)
    states = [replica.admissible(data.draw(vectors(2 * model.n))) for _ in range(2)]
    first = last = distance(model, *states)
    size = 0.0
    for found, jumped in switched(replica, states, data.draw(switchings(model.m, most=5))):
        if not jumped:
            size = 1e-9 * (1 + first) + 1e-12 * float(np.max(np.abs(found))) ** 2
        now = distance(model, *found)
        assert now <= last + size
        last = now


@pytest.mark.slow
@LAWS
@examples(10)
@given(st.data())
def test_distance_of_a_replica_to_its_plant_never_rises(
    law: type[ReplicaLaw], data: st.DataObject
) -> None:
    """Under the true switching; where only guides switch the replica knows nothing of it."""
    model = data.draw(guided(gaps=(0.0, 1.0)))
    assume(passes_eigenvalue_test(model))
    x = np.concatenate([data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))])
    assume(np.all(model.gap(x[: model.n]) >= 0))
    assert largest_rise(law(model), x, data.draw(vectors(2 * model.n))) <= 0


def test_replica_at_the_plants_state_stays_with_it() -> None:
    """Through sticking, slipping, impacts and turns; open loop where there are no impacts."""
    model = rubbing(
        chain(
            2,
            damping=0.2,
            contacts=[([0, -1], 0.4, 0.6)],
            force=forcing(2, 0.0, [Harmonic(2.5, [0, 6.0], [0, 0])]),
        ),
        ([-1, 1], 1.0),
    )
    x = np.array([0.1, -0.2, 0.5, 0.0])
    plant, replica, t, y = Plant(model, *np.split(x, 2), epoch=EPOCH), Geometric(model), 0.0, x
    motion, hits = OpenLoop(model).motion(0.0, x, ()), 0
    while (switching := plant.next_switching(EPOCH + 20 * NS_PER_S)) is not None:
        plant.cross(switching)
        if switching.contacts:
            now = seconds_of(switching)
            y = motion.state(now - t)
            np.testing.assert_allclose(y, switching.before, atol=1e-10)
            y, t, hits = replica.impact(y, switching.contacts, ()), now, hits + 1
            motion = replica.motion(t, y, switching.closed)
    assert hits >= 5


def test_guide_that_sticks_beside_a_fixed_gap_is_in_balance() -> None:
    """A replica whose contact slips while its gap is fixed: its motion obeys its equations."""
    model = rubbing(
        system(np.eye(3) / 2, np.zeros((3, 3)), np.eye(3) / 2, contacts=[([-1, 2, 0], 0.3, 0.0)]),
        ([0.5, 1, 1], 0.8),
    )
    phases = Phases(model)
    q, u = phases.projection.position_after(np.array([0.2, -0.4, 0.7]), (0,)), np.zeros(3)
    u = np.array([1.0, 1.5, -2.0])  # the guide is at rest, the contact slips
    phase, h = phases.phase((1,), (0,), (0.0,)), 1e-4
    motion = phase.start(0.0, np.concatenate([q, u]))
    states = motion.states(np.array([0.3 - h, 0.3, 0.3 + h]))
    Q = np.eye(3) - phases.projection.jump((0,)) @ model.W.T
    rate = (states[2] - states[0]) / (2 * h)
    np.testing.assert_allclose(rate[:3], Q @ states[1, 3:], atol=1e-7)
    force = -model.K @ states[1, :3]
    w = model.W_T[:, 0]
    load = -float(w @ np.linalg.solve(model.M, force)) / float(w @ np.linalg.solve(model.M, w))
    np.testing.assert_allclose(rate[3:], np.linalg.solve(model.M, force + w * load), atol=1e-6)
    np.testing.assert_allclose(model.gap(states[:, :3].T[:, 1]), 0, atol=1e-12)


def test_stuck_replicas_keep_their_distance() -> None:
    """Friction is no attraction: ``1/2 dq' K dq`` stays where both stick."""
    model = rubbing(system(1, 0.1, 10, contacts=[([-1], 5.0, 0.5)]), ([1], 2.0))
    states = [np.array([0.15, 0.0]), np.array([-0.1, 0.0])]
    law = Geometric(model)
    later = [law.motion(0.0, x, ()).state(100.0) for x in states]
    np.testing.assert_allclose(later, states, atol=1e-15)


MODEL = """
name: rub
bodies: [{name: a, mass: 1}, {name: b, mass: 1}]
stops: [{name: s, body: b, limit: 1, side: above, restitution: 0.5}]
friction: [{name: guide, between: [a, b], force: 0.2}]
"""


def test_friction_is_read_in_both_forms_and_survives_the_text() -> None:
    """The guide's direction is that of a spring between the same bodies."""
    model = parse_model(MODEL, "rub.yaml")
    (guide,) = model.system.guides
    assert (guide.name, guide.force, guide.direction.tolist()) == ("guide", 0.2, [-1, 1])
    assert parse_model(model.text(), "again").text() == model.text()
    matrices = type(model)(model.system).text()
    again = parse_model(matrices, "again").system
    np.testing.assert_array_equal(again.W_T, model.system.W_T)
    assert parse_model(matrices, "again").text() == matrices


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("force: 0.2", "force: 0", "friction[0].force: is 0; expected a positive number"),
        ("force: 0.2", "coefficient: 0.3", "friction[0].coefficient: is Coulomb friction at a co"),
        ("between: [a, b]", "contact: s", "friction[0].contact: is Coulomb friction at a contact"),
        ("[a, b]", "[a, c]", "friction[0].between[1]: 'c' is not a body"),
        ("limit: 1", "limit: 1, friction: 0.3", "stops[0].friction: is Coulomb friction at a con"),
        (", force: 0.2", "", "friction[0].force: is missing"),
        ("0.2}", "0.2}, {name: guide, between: [ground, a], force: 1}", "friction[1]: 'guide' is"),
    ],
)
def test_mistake_in_friction_is_one_line(old: str, new: str, line: str) -> None:
    """Coulomb friction at a contact is refused, with the reason."""
    with pytest.raises(ModelError) as caught:
        parse_model(MODEL.replace(old, new), "my.yaml")
    text = str(caught.value)
    assert text.startswith(f"my.yaml: {line}")
    assert "\n" not in text
    if "Coulomb" in line:
        assert "an impact can raise the distance of two replicas" in text


def test_time_stepping_refuses_friction_by_name() -> None:
    """One line that names the guide and what computes it."""
    model = parse_model(MODEL, "rub.yaml").system
    with pytest.raises(UsageError, match=r"guide 'guide' rubs.*expected the integrator event-dr"):
        TimeSteppingPlant(model, np.zeros(2), np.zeros(2), epoch=EPOCH, step=1e-3)


def test_observability_refuses_friction_by_name() -> None:
    """One line, which names the guide."""
    model = parse_model(MODEL, "rub.yaml").system
    events = [event(0.5, "s"), event(1.0, "s")]
    with pytest.raises(UsageError, match=r"guide 'guide' rubs, so what impacts determine"):
        observability(model, events)


def test_guide_on_a_moving_ground_carries_the_body_until_it_slips() -> None:
    """A block on a shaken table: it moves with it up to the acceleration ``a/m``."""
    text = """
name: shaken
bodies: [{name: x, mass: 2}]
grounds: [{name: table, motion: {harmonics: [{amplitude: 0.1, frequency: 5, phase: 0}]}}]
friction: [{name: guide, between: [table, x], force: FORCE}]
stops: [{name: far, between: [table, x], gap: 9, restitution: 0.5}]
"""
    carried = parse_model(text.replace("FORCE", "5.1"), "shaken").system
    slipping = parse_model(text.replace("FORCE", "3"), "shaken").system
    start = np.array([0.1, 0.0])
    assert not crossed(begun(carried, start), 5.0)
    found = crossed(begun(slipping, start), 5.0)
    caught = optimize.brentq(lambda t: np.sin(5 * t) - 3 * t, 0.2, 0.5)  # -0.5 sin 5t = -1.5 t
    slips = np.arccos(-0.6) / 5  # where the table needs more than a/m = 1.5
    times = [seconds_of(each) for each in found[:2]]
    np.testing.assert_allclose(times, [caught, slips], rtol=0, atol=1e-9)
    assert [each.held for each in found[:2]] == [(1,), ()]


STICKING = rubbing(
    chain(2, damping=0.2, force=forcing(2, 0.0, [Harmonic(2.6, [8.0, 0], [0, 0])])),
    ([-1, 1], 1.5),
    ([1, 0], 0.4),
)


@pytest.mark.parametrize("seed", range(4))
def test_derivative_of_a_rubbing_motion_has_saltation_at_every_turn(seed: int) -> None:
    """Against differences of exact motions that stick, slip and turn at other instants."""
    clutches, rng, h = Clutches(STICKING), np.random.default_rng(seed), 1e-6
    x = np.concatenate([0.3 * rng.normal(size=2), rng.normal(size=2)])

    def after(y: Array) -> Array:
        return np.asarray(clutches.motion(0.3, y, (), fix=False).state(6.0))

    motion = clutches.motion(0.3, x, (), fix=False)
    assert isinstance(motion, Piecewise)
    expected = [(after(x + h * e) - after(x - h * e)) / (2 * h) for e in np.eye(4)]
    np.testing.assert_allclose(motion.transition(6.0).T, expected, atol=2e-6)


@pytest.mark.long
def test_minimum_variance_finds_the_state_and_learns_the_friction() -> None:
    """V falls to 1e-14 of V0 with exact events; a force that is 8 % off is found."""
    model = sample("rubbing_guide")
    made = run(model.system, *model.initial_state(), seconds=60.0, rate=1.0)
    start = np.concatenate(model.initial_state()) + np.array([0.3, -0.2, 0.4, -0.6])
    watcher = observer(model.system, "minimum-variance", start)
    for each in made.events:
        watcher.receive(each)
    error = estimates(watcher, made.stamps[-1:])[0] - made.states[-1]
    first = distance(model.system, start, made.states[0])
    assert distance(model.system, error, np.zeros(4)) <= 1e-14 * first
    (guide,) = model.system.guides
    wrong = replace(model.system, guides=(replace(guide, force=1.1),))
    unknowns = UnknownParameters.named(wrong, ["friction.guide=0.2"])
    watcher = observer(
        wrong,
        "minimum-variance",
        np.concatenate(model.initial_state()),
        uncertainty=without_faults(unknowns=unknowns, deviation=0.1),
    )
    for each in made.events:
        watcher.receive(each)
    ((name, value, deviation),) = watcher.estimate(int(made.stamps[-1])).parameters
    assert name == "friction.guide"
    assert value == pytest.approx(1.2, abs=max(5 * deviation, 1e-6))
    assert value == pytest.approx(1.2, rel=1e-3)


def test_check_model_says_what_stuck_replicas_keep() -> None:
    """``1/2 (2a)^2 / k`` of one guide on one spring, in the note."""
    model = rubbing(system(1, 0.1, 10, contacts=[([-1], 5.0, 0.5)]), ([1], 2.0))
    assert largest_kept(model) == pytest.approx(0.8)
    texts = [each.text for each in findings(check_model(model))]
    assert any("keep 1/2 dq' K dq, here up to 0.8 J" in text for text in texts)
    free = rubbing(system(1, 0.1, 0, contacts=[([-1], 5.0, 0.5)]), ([1], 2.0))
    assert largest_kept(free) is None
