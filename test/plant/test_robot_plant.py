# SPDX-License-Identifier: Apache-2.0
"""The plant of a robot against elliptic integrals, equations by hand, and Newton's law."""

import numpy as np
import pytest
from arms import DOUBLE, PENDULUM, SLIDER, model_of, random_arm, wall
from scipy import integrate, special

from impact_observer.errors import UsageError
from impact_observer.model import Model, read_model
from impact_observer.plant import Run, simulate
from impact_observer.plant.event_driven import Plant
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S, grid
from impact_observer.states import Vector

pytest.importorskip("pinocchio", reason="not installed: extra robots")
EPOCH = 5 * NS_PER_S


def robot_of(model: Model) -> Robot:
    """The robot of a model."""
    assert model.robot is not None
    return Robot(model.robot)


def run_of(model: Model, q: list[float], u: list[float], seconds: float, rate: float = 50) -> Run:
    """A run from the epoch on."""
    plant = Plant(robot_of(model), np.array(q), np.array(u), epoch=EPOCH)
    return simulate(plant, grid(EPOCH, EPOCH + round(seconds * NS_PER_S), rate))


def times(run: Run) -> Vector:
    """Impact times since the epoch, s, with their remainders."""
    instants = [each.instant for each in run.impacts]
    return np.array([(i.stamp - run.epoch) * 1e-9 + i.remainder for i in instants])


def swing(height: float, low: float, g: float = 9.81) -> float:
    """The time, s, of a pendulum of 1 m from rest at the angle ``height`` to the angle ``low``.

    With ``sin(phi) = sin(theta / 2) / k``, ``k = sin(height / 2)``, the time is
    ``(K(k) - F(phi, k)) / sqrt(g)``.
    """
    m = np.sin(height / 2) ** 2
    phi = np.arcsin(np.clip(np.sin(low / 2) / np.sqrt(m), -1, 1))
    return float((special.ellipk(m) - special.ellipkinc(phi, m)) / np.sqrt(g))


@pytest.mark.parametrize("low", [0.0, -0.4, 0.3])
def test_a_pendulum_hits_a_stop_at_the_times_of_elliptic_integrals(low: float) -> None:
    """Ten impacts from rest at 2.2 rad, each to 1e-10 s, at a stop below, beyond and before."""
    eps = 0.8
    model = model_of(PENDULUM, "hinge", contacts=wall(offset=float(np.sin(low)), restitution=eps))
    run = run_of(model, [1.4], [0.0], 9.0)
    expected, height = [swing(1.4, low)], 1.4
    while len(expected) < 8:
        speed = 2 * 9.81 * (np.cos(low) - np.cos(height))  # squared, before the impact
        height = float(np.arccos(np.cos(low) - eps**2 * speed / (2 * 9.81)))
        if low > 0 or height > -low:
            up = swing(height, low)
            expected.append(expected[-1] + 2 * up)
    found = times(run)[: len(expected)]
    assert np.max(np.abs(found - expected[: found.size])) < 1e-10
    assert found.size >= 5


def by_hand(q: Vector, u: Vector) -> Vector:
    """Accelerations of the double pendulum with absolute angles of both rods."""
    m1, m2, length, c1, c2, g = 1.5, 0.8, 0.7, 0.4, 0.3, 9.81
    a, b = q[0], q[0] + q[1]
    va, vb = u[0], u[0] + u[1]
    coupled = m2 * length * c2
    M = np.array(
        [
            [m1 * c1**2 + 0.05 + m2 * length**2, coupled * np.cos(a - b)],
            [coupled * np.cos(a - b), m2 * c2**2 + 0.02],
        ]
    )
    forces = [
        -coupled * np.sin(a - b) * vb**2 - (m1 * c1 + m2 * length) * g * np.sin(a),
        coupled * np.sin(a - b) * va**2 - m2 * c2 * g * np.sin(b),
    ]
    one, two = np.linalg.solve(M, forces)
    return np.array([one, two - one])


def test_a_double_pendulum_moves_as_equations_by_hand_say() -> None:
    """To 1e-9 over 5 s, by another integrator."""
    run = run_of(model_of(DOUBLE, "shoulder, elbow"), [0.9, -0.5], [0.3, -0.2], 5.0)
    found = integrate.solve_ivp(
        lambda _, x: np.concatenate([x[2:], by_hand(x[:2], x[2:])]),
        (0.0, 5.0),
        run.states[0],
        method="LSODA",
        rtol=1e-12,
        atol=1e-13,
        t_eval=(run.stamps - EPOCH) * 1e-9,
    )
    assert np.max(np.abs(run.states - found.y.T)) < 1e-9


def test_energy_stays_between_impacts_and_falls_by_newtons_share() -> None:
    """A double pendulum without damping: (1 - eps^2) gamma-^2 / 2G is lost at each impact."""
    model = model_of(DOUBLE, "shoulder, elbow", contacts=wall(restitution=0.7, offset=-0.2))
    robot, run = robot_of(model), run_of(model, [1.4, 0.5], [0.0, 0.0], 4.0)
    assert len(run.impacts) >= 4

    def energy(x: Vector) -> float:
        return robot.kinetic_energy(x[:2], x[2:]) + robot.potential_energy(x[:2])

    before = energy(run.states[0])
    for each in run.impacts:
        assert energy(each.before) == pytest.approx(before, abs=1e-10)
        W = robot.directions(each.before[:2])[:, 0]
        gamma, G = W @ each.before[2:], W @ robot.inverse_mass(each.before[:2]) @ W
        before = energy(each.after)
        lost = (1 - 0.49) * gamma**2 / (2 * G)
        assert energy(each.before) - before == pytest.approx(lost, abs=1e-10)


def test_a_ball_bounces_to_rest_where_its_impacts_accumulate() -> None:
    """A mass on a rail: times 2 eps^k v / g apart, CLOSE near their limit, at rest after."""
    eps, height, g = 0.6, 0.5, 9.81
    contacts = wall(normal="[0, 0, 1]", restitution=eps)
    run = run_of(model_of(SLIDER, "rail", contacts=contacts), [height], [0.0], 2.0)
    first = np.sqrt(2 * height / g)
    counted = times(run)[:12]
    expected = first + 2 * first * np.cumsum(eps ** np.arange(1, 12))
    assert np.max(np.abs(counted - np.append(first, expected))) < 1e-10
    closing = [each for each in run.events if each.switches[0].kind.name == "CLOSE"]
    limit = first * (1 + eps) / (1 - eps)
    assert len(closing) == 1
    assert (closing[0].stamp - EPOCH) * 1e-9 == pytest.approx(limit, abs=2e-6)
    assert np.all(np.abs(run.states[run.stamps > closing[0].stamp]) < 1e-12)


def test_a_lasting_contact_stays_closed_and_opens_by_the_sign_of_its_load() -> None:
    """A pressed tip slides along a wall without drift; it leaves where its load vanishes."""
    model = model_of(
        DOUBLE,
        "shoulder, elbow",
        contacts=wall(restitution=0, offset=0.25),
        forcing="{harmonics: [{frequency: 2.0, cosine: [-9, -4]}]}",
        damping="{shoulder: 0.4, elbow: 0.4}",
    )
    robot = robot_of(model)
    plant = Plant(robot, np.array([0.5, 0.3]), np.zeros(2), epoch=EPOCH)
    run = simulate(plant, grid(EPOCH, EPOCH + 6 * NS_PER_S, 1000))
    gaps = np.array([robot.gaps(x[:2])[0] for x in run.states])
    assert np.min(gaps) > -1e-10
    kinds = [each.switches[0].kind.name for each in run.events]
    assert kinds.count("CLOSE") >= 2
    assert kinds.count("OPEN") >= 2
    held = np.zeros(len(gaps), dtype=bool)
    for one, two in zip(run.switchings, [*run.switchings[1:], None], strict=True):
        if one.closed:
            end = run.stamps[-1] if two is None else two.instant.stamp
            held |= (run.stamps >= one.instant.stamp) & (run.stamps < end)
    assert held.sum() > 500
    assert np.max(np.abs(gaps[held])) < 1e-10
    for each in run.switchings:
        if not each.contacts:
            tau = robot.torques((each.instant.stamp - EPOCH) * 1e-9)
            load = robot.loads(each.before[:2], each.before[2:], tau, (0,))
            assert load[0] == pytest.approx(0.0, abs=1e-6)


def test_two_dips_within_one_step_are_not_missed() -> None:
    """A fast rod whose tip grazes a plane within a thousandth of its height hits it."""
    contacts = wall(normal="[0, 0, 1]", offset=-0.9999999)
    run = run_of(model_of(PENDULUM, "hinge", contacts=contacts), [-0.3], [3.0], 1.0)
    assert len(run.impacts) >= 1
    deep = float(np.arccos(0.9999999))
    hit = run.impacts[0].before
    assert hit[0] == pytest.approx(-deep, abs=1e-9)


def test_equal_seconds_after_any_epoch_are_equal_runs() -> None:
    """Harmonics count from the epoch; stamps are whole nanoseconds."""
    model = read_model("hammer_arm")
    runs = []
    for epoch in (NS_PER_S, 1_700_000_000 * NS_PER_S):
        plant = Plant(robot_of(model), *model.initial_state(), epoch=epoch)
        runs.append(simulate(plant, grid(epoch, epoch + 3 * NS_PER_S, 20)))
    assert len(runs[0].events) >= 2
    assert [each.stamp - NS_PER_S for each in runs[0].events] == [
        each.stamp - runs[1].epoch for each in runs[1].events
    ]
    assert np.array_equal(runs[0].states, runs[1].states)


def test_several_planes_close_together() -> None:
    """A random arm between three planes never enters one, and its energy never rises."""
    model = random_arm(11, 3, contacts=3)
    robot, rng = robot_of(model), np.random.default_rng(0)
    starts = [q for q in rng.normal(size=(200, 3)) if np.all(robot.gaps(q) > 0.02)]
    plant = Plant(robot, starts[0], rng.normal(size=3), epoch=EPOCH)
    run = simulate(plant, grid(EPOCH, EPOCH + 3 * NS_PER_S, 100))
    assert len(run.impacts) >= 2
    gaps = np.array([robot.gaps(x[:3]) for x in run.states])
    assert np.min(gaps) > -1e-10
    q, u = run.states[:, :3], run.states[:, 3:]
    energy = [
        robot.kinetic_energy(*each) + robot.potential_energy(each[0])
        for each in zip(q, u, strict=True)
    ]
    assert np.max(np.diff(energy)) < 1e-9


def test_a_robot_at_rest_on_two_planes_stays_there() -> None:
    """A corner: the tip is pressed against a floor and a wall at once."""
    contacts = (
        "[{name: floor, frame: tip, normal: [0, 0, 1], offset: -0.8, restitution: 0.5},"
        " {name: wall, frame: tip, normal: [1, 0, 0], offset: 0, restitution: 0.5}]"
    )
    model = model_of(DOUBLE, "shoulder, elbow", contacts=contacts)
    robot = robot_of(model)
    q = robot.projected(np.array([-0.6, 1.5]), (0, 1))
    run = run_of(model, q.tolist(), [0.0, 0.0], 1.0)
    closed = run.switchings[0].closed if run.switchings else ()
    assert 0 in closed or 1 in closed or run.impacts
    gaps = np.array([robot.gaps(x[:2]) for x in run.states])
    assert np.min(gaps) > -1e-10


def test_a_start_inside_a_plane_is_refused() -> None:
    """As a start inside a stop is."""
    model = model_of(PENDULUM, "hinge", contacts=wall())
    with pytest.raises(UsageError, match="inside the plane of 'wall'"):
        Plant(robot_of(model), np.array([-0.5]), np.zeros(1), epoch=EPOCH)


def test_sampled_torques_act_from_sample_to_sample() -> None:
    """Steps of a table, held: a mass on a rail without gravity has the speeds of sums."""
    model = model_of(
        SLIDER,
        "rail",
        gravity="[0, 0, 0]",
        forcing="{hold: previous, sampled: {time: [0, 0.3, 0.55], force: [[2], [-6], [0]]}}",
    )
    run = run_of(model, [0.0], [0.0], 1.0, rate=100)
    t = (run.stamps - EPOCH) * 1e-9
    expected = np.minimum(t, 0.3) - 3 * np.clip(t - 0.3, 0, 0.25)
    assert np.max(np.abs(run.states[:, 1] - expected)) < 1e-12
