# SPDX-License-Identifier: Apache-2.0
"""The equations of a robot against equations by hand and differences."""

import copy
import pickle
import re
import sys
from collections.abc import Callable

import numpy as np
import pytest
from arms import DOUBLE, PENDULUM, SLIDER, joint, link, model_of, random_arm, urdf, wall

from impact_observer.errors import ImpactLawError, ModelError, UsageError
from impact_observer.model import Model
from impact_observer.model.robot_description import RobotDescription
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

pytest.importorskip("pinocchio", reason="not installed: extra robots")
SEEDS = range(4)


def described(model: Model) -> RobotDescription:
    """The description in a model of a robot."""
    assert model.robot is not None
    return model.robot


def arm(seed: int, n: int = 0) -> Robot:
    """A random arm with two contacts."""
    return Robot(described(random_arm(seed, n=n, contacts=2)))


def state(robot: Robot, seed: int) -> tuple[Vector, Vector, Vector]:
    """Random coordinates, velocities and torques."""
    rng = np.random.default_rng(seed)
    q, u, tau = rng.normal(size=(3, robot.n))
    return q, u, tau


def slope(function: Callable[[Vector], Vector], at: Vector, step: float = 1e-6) -> Matrix:
    """Central differences, shape (values, arguments)."""
    steps = step * np.eye(at.size)
    changes = [(function(at + s) - function(at - s)) / (2 * step) for s in steps]
    return np.asarray(np.transpose(changes))


def test_a_double_pendulum_accelerates_as_lagranges_equations_say() -> None:
    """The mass matrix, gravity, damping and rotors of a double pendulum, by hand."""
    model = model_of(
        DOUBLE,
        "shoulder, elbow",
        damping="{shoulder: 0.3, elbow: 0.2}",
        rotor_inertia="{shoulder: 0.1, elbow: 0.05}",
    )
    robot = Robot(described(model))
    q, u, tau = np.array([0.4, -0.9]), np.array([1.3, -2.1]), np.array([0.5, -0.7])
    (a, b), m1, m2, length, c1, c2, g = q, 1.5, 0.8, 0.7, 0.4, 0.3, 9.81
    coupled = m2 * length * c2 * np.cos(b)
    own = m2 * c2**2 + 0.02
    M = np.array(
        [
            [m1 * c1**2 + 0.05 + m2 * length**2 + own + 2 * coupled + 0.1, own + coupled],
            [own + coupled, own + 0.05],
        ]
    )
    s = m2 * length * c2 * np.sin(b)
    forces = np.array([-s * u[1] * (2 * u[0] + u[1]), s * u[0] ** 2])
    low = m2 * g * c2 * np.sin(a + b)
    weight = np.array([(m1 * c1 + m2 * length) * g * np.sin(a) + low, low])
    expected = np.linalg.solve(M, tau - [0.3, 0.2] * u - forces - weight)
    assert np.allclose(robot.mass(q), M, rtol=1e-14)
    assert np.allclose(robot.rest_torque(q), weight, rtol=1e-13)
    assert np.allclose(robot.acceleration(q, u, tau), expected, rtol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_directions_are_the_gradients_of_gaps(seed: int) -> None:
    """W, the acceleration bias and the gradients of contact speeds are those of differences."""
    robot = arm(seed)
    q, u, _ = state(robot, seed)
    W = robot.directions(q)
    assert np.allclose(W.T, slope(robot.gaps, q), atol=1e-8)
    along = slope(lambda s: robot.directions(q + s[0] * u).T @ u, np.zeros(1))[:, 0]
    assert np.allclose(robot.bias(q, u), along, atol=1e-7)
    speeds = slope(lambda p: robot.directions(p).T @ u, q)
    assert np.allclose(robot.speed_gradients(q, u).T, speeds, atol=1e-7)


@pytest.mark.parametrize("closed", [(), (0,), (0, 1)])
@pytest.mark.parametrize("seed", SEEDS)
def test_derivatives_of_accelerations_are_those_of_differences(
    seed: int, closed: tuple[int, ...]
) -> None:
    """By coordinates, velocities and torques, with and without closed contacts."""
    robot = arm(seed, n=4)
    q, u, tau = state(robot, seed)
    by_q, by_u, by_tau = robot.acceleration_derivatives(q, u, tau, closed)
    size = 1.0 + np.abs(robot.acceleration(q, u, tau, closed)).max()
    near = {"rtol": 1e-6, "atol": 1e-6 * size}
    assert np.allclose(by_q, slope(lambda p: robot.acceleration(p, u, tau, closed), q), **near)
    assert np.allclose(by_u, slope(lambda p: robot.acceleration(q, p, tau, closed), u), **near)
    assert np.allclose(by_tau, slope(lambda p: robot.acceleration(q, u, p, closed), tau), **near)


@pytest.mark.parametrize("seed", SEEDS)
def test_closed_contacts_do_not_accelerate_and_their_loads_do_it(seed: int) -> None:
    """Gaps of closed contacts have no second derivative; M times the change are the loads."""
    robot = arm(seed, n=4)
    q, u, tau = state(robot, seed)
    held = robot.acceleration(q, u, tau, (0, 1))
    rising = robot.directions(q, (0, 1)).T @ held + robot.bias(q, u, (0, 1))
    assert np.allclose(rising, 0.0, atol=1e-9)
    loads = robot.loads(q, u, tau, (0, 1))
    change = held - robot.acceleration(q, u, tau)
    assert np.allclose(robot.mass(q) @ change, robot.directions(q) @ loads, atol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_coriolis_is_christoffels(seed: int) -> None:
    """C is linear in velocities, symmetric in two of them, and dM/dt - 2 C is skew."""
    robot = arm(seed)
    q, u, v = state(robot, seed)
    C = robot.coriolis(q, u)
    assert np.allclose(C @ v, robot.coriolis(q, v) @ u, atol=1e-12)
    moved = slope(lambda s: robot.mass(q + s[0] * u).ravel(), np.zeros(1)).reshape(C.shape)
    skew = moved - 2 * C
    assert np.allclose(skew, -skew.T, atol=1e-7)
    bent = C @ u + robot.rest_torque(q)
    free = robot.acceleration(q, u, bent + robot.damping * u)
    assert np.allclose(free, 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_has_the_derivatives_of_differences(seed: int) -> None:
    """The Runge-Kutta step and its derivatives by state and torques."""
    robot = arm(seed)
    q, u, tau = state(robot, seed)
    x = np.concatenate([q, u])
    after, by_x, by_tau = robot.advanced_with_derivatives(x, tau, 2e-3)
    assert np.allclose(after, robot.advanced(x, tau, 2e-3), rtol=1e-14)
    assert np.allclose(by_x, slope(lambda y: robot.advanced(y, tau, 2e-3), x), atol=1e-7)
    assert np.allclose(by_tau, slope(lambda y: robot.advanced(x, y, 2e-3), tau), atol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_one_contact_rebounds_and_the_rest_of_the_energy_stays(seed: int) -> None:
    """gamma+ = -eps gamma-; the loss is (1 - eps^2) gamma-^2 / 2G; impulses act along W."""
    robot = arm(seed)
    q, u, _ = state(robot, seed)
    u = u if (robot.directions(q).T @ u)[0] < 0 else -u
    W, eps = robot.directions(q)[:, 0], float(robot.eps[0])
    after = robot.velocity_after(q, u, (0,))
    gamma, G = W @ u, W @ np.linalg.solve(robot.mass(q), W)
    assert W @ after == pytest.approx(-eps * gamma, rel=1e-12)
    lost = robot.kinetic_energy(q, u) - robot.kinetic_energy(q, after)
    assert lost == pytest.approx((1 - eps**2) * gamma**2 / (2 * G), rel=1e-9)
    assert np.allclose(np.linalg.solve(robot.mass(q), W * -(1 + eps) * gamma / G), after - u)
    assert robot.pushed(q, u, (0,)) == (0,)
    assert np.array_equal(robot.velocity_after(q, after, (0,)), after)


@pytest.mark.parametrize("seed", range(20))
def test_several_contacts_obey_the_complementarity_law(seed: int) -> None:
    """0 <= gamma+ + eps gamma- _|_ Lambda >= 0, with the impulses of the pushed contacts."""
    robot = Robot(described(random_arm(seed, 4, contacts=3)))
    q, u, _ = state(robot, seed)
    W, active = robot.directions(q), (0, 1, 2)
    after = robot.velocity_after(q, u, active)
    left = W.T @ after + robot.eps * (W.T @ u)
    pushed = robot.pushed(q, u, active)
    impulse = robot.mass(q) @ (after - u)
    share = np.linalg.lstsq(W[:, list(pushed)], impulse, rcond=None)[0]
    assert np.all(left >= -1e-9)
    assert np.all(share >= 0)
    assert np.allclose(left[list(pushed)], 0.0, atol=1e-9)
    assert np.allclose(W[:, list(pushed)] @ share, impulse, atol=1e-9)
    x = np.concatenate([q, u])
    assert np.allclose(robot.jumped(x, pushed)[robot.n :], after, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_derivatives_of_a_jump_are_those_of_differences(seed: int) -> None:
    """By the state, and by the coefficient of restitution."""
    description = described(random_arm(seed, contacts=2))
    robot = Robot(description)
    q, u, _ = state(robot, seed)
    x, pushed = np.concatenate([q, u]), (1,)
    found = slope(lambda y: robot.jumped(y, pushed), x, 1e-5)
    assert np.allclose(robot.jump_derivatives(x, pushed), found, atol=1e-6)
    name = "restitution.plane1"
    value = description.parameters[name]

    def with_restitution(eps: Vector) -> Vector:
        other = Robot(description.with_parameters({name: float(eps[0])}))
        return other.jumped(x, pushed)

    by_eps = slope(with_restitution, np.array([value]), 1e-4)
    assert np.allclose(robot.jump_by_restitution(x, pushed), by_eps, atol=1e-9)


def test_the_order_of_joints_is_that_of_the_model_file() -> None:
    """Exchanged joints exchange rows and columns, whatever pinocchio's order."""
    one = Robot(described(model_of(DOUBLE, "shoulder, elbow", contacts=wall())))
    two = Robot(described(model_of(DOUBLE, "elbow, shoulder", contacts=wall())))
    q, u, tau = np.array([[0.3, -0.8], [1.0, 2.0], [0.2, -0.4]])
    assert np.allclose(one.mass(q)[::-1, ::-1], two.mass(q[::-1]), rtol=1e-14)
    assert np.allclose(
        one.acceleration(q, u, tau)[::-1], two.acceleration(q[::-1], u[::-1], tau[::-1])
    )
    assert np.allclose(one.directions(q)[::-1], two.directions(q[::-1]))
    for mine, theirs in zip(
        one.acceleration_derivatives(q, u, tau),
        two.acceleration_derivatives(q[::-1], u[::-1], tau[::-1]),
        strict=True,
    ):
        assert np.allclose(mine[::-1, ::-1], theirs, rtol=1e-12)


def test_a_single_joint_has_matrices_and_vectors_too() -> None:
    """A pendulum of 1 kg and 1 m: its mass, its gap and the gradients of gap and speed."""
    robot, q, u = Robot(described(model_of(PENDULUM, "hinge", contacts=wall()))), 0.3, 2.0
    at, speed = np.array([q]), np.array([u])
    assert robot.mass(at).tolist() == [[pytest.approx(1.0)]]
    assert robot.gaps(at).tolist() == [pytest.approx(np.sin(q))]
    assert robot.directions(at).tolist() == [[pytest.approx(np.cos(q))]]
    assert robot.speed_gradients(at, speed).tolist() == [[pytest.approx(-np.sin(q) * u)]]
    assert robot.bias(at, speed).tolist() == [pytest.approx(-np.sin(q) * u * u)]
    by_q, by_u, by_tau = robot.acceleration_derivatives(at, speed, speed)
    found = [by_q.tolist(), by_u.tolist(), by_tau.tolist()]
    assert found == [[[pytest.approx(-9.81 * np.cos(q))]], [[0.0]], [[pytest.approx(1.0)]]]


def test_held_joints_stay_where_they_are_held() -> None:
    """An elbow held at 0.7 rad makes a rigid arm of the two links."""
    held = Robot(described(model_of(DOUBLE, "shoulder", held="{elbow: 0.7}", contacts=wall())))
    whole = Robot(described(model_of(DOUBLE, "shoulder, elbow", contacts=wall())))
    q = np.array([0.4, 0.7])
    assert held.gaps(q[:1])[0] == pytest.approx(whole.gaps(q)[0], rel=1e-14)
    assert held.mass(q[:1])[0, 0] == pytest.approx(whole.mass(q)[0, 0], rel=1e-14)


def test_copies_are_whole_and_their_own() -> None:
    """A robot can be copied and pickled, as for other processes."""
    robot, q = arm(1), np.full(3, 0.1)[: arm(1).n]
    for other in (copy.deepcopy(robot), pickle.loads(pickle.dumps(robot))):
        assert np.array_equal(other.gaps(q), robot.gaps(q))


def test_a_link_without_mass_is_an_error_that_names_its_joint() -> None:
    """The line says what is missing."""
    text = urdf(
        link("a", 1.0, "0 0 1") + '<link name="b"/>',
        joint("one", "base", "a") + joint("two", "a", "b"),
    )
    with pytest.raises(ModelError, match="joint 'two' moves no mass; expected an inertial"):
        Robot(described(model_of(text, "one, two")))


def test_two_joints_that_move_the_same_mass_alike_are_an_error() -> None:
    """Two sliders along one axis, of which only the second one has mass."""
    first, second = (
        joint(name, parent, child, kind="prismatic")
        for name, parent, child in (("one", "base", "a"), ("two", "a", "b"))
    )
    text = urdf('<link name="a"/>' + link("b", 2.0, "0 0 0"), first + second)
    with pytest.raises(ModelError, match="the mass matrix is singular"):
        Robot(described(model_of(text, "one, two")))


def plane(name: str, side: int, restitution: object) -> str:
    """A plane at z = 0 that holds the slider above (1) or below (-1) it."""
    return wall(name=name, normal=f"[0, 0, {side}]", restitution=restitution)[1:-1]


def slider(*planes: str) -> Robot:
    """A mass of 2 kg on a rail between planes."""
    return Robot(described(model_of(SLIDER, "rail", contacts=f"[{', '.join(planes)}]")))


def test_of_two_pads_the_more_elastic_one_decides_by_its_law() -> None:
    """At 16 m/s a rebound of 0.8 v^-0.25 is one of 0.4, and that of the other pad 0.3."""
    by_speed = plane("steel", 1, "{value: 0.8, speed: 1, exponent: -0.25}")
    robot = slider(by_speed, plane("wood", 1, 0.3))
    q, u = np.zeros(1), np.full(1, -16.0)
    for active, speed in (((0, 1), 6.4), ((0,), 6.4), ((1,), 4.8)):
        assert robot.velocity_after(q, u, active) == pytest.approx(speed)
    assert not robot.is_nonexpansive(q, (0, 1))


def test_planes_that_face_each_other_without_play_are_an_error_by_name() -> None:
    """The rebound from the floor would go into the ceiling."""
    jammed = slider(plane("floor", 1, 0.8), plane("ceiling", -1, 0.5))
    with pytest.raises(ImpactLawError, match=r"'floor', 'ceiling'.*no solution"):
        jammed.velocity_after(np.zeros(1), np.full(1, -1.0), (0, 1))


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('ixx="', 'ixx="q', "inertia element ixx is not a valid double"),
        ('xyz="', 'xyz="1 ', "Parser found 4 elements but 3 expected"),
    ],
)
def test_what_the_parser_of_a_urdf_prints_is_the_error(
    old: str, new: str, fault: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """One line, nothing of its own beside; the parser would go on without the inertia."""
    model = model_of(PENDULUM.replace(old, new, 1), "hinge")
    with pytest.raises(ModelError, match=f"pinocchio cannot read it: .*{fault}") as found:
        Robot(described(model))
    assert "\n" not in str(found.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('<mass value="', '<mass value="q', r"link '\w+': value='q[\d.]+'"),
        ('<mass value="', '<mass value="-', r"link '\w+' has a mass of -[\d.]+ kg"),
        ('<axis xyz="[^"]*"', '<axis xyz="0 0 0.0"', r"joint 'hinge' has the axis '0 0 0.0'"),
        ('<axis xyz="[^"]*"', '<axis xyz="1e200 0 0"', r"joint 'hinge' has the axis '1e200 0 0'"),
    ],
)
def test_a_mass_or_an_axis_that_no_robot_has_is_named(old: str, new: str, fault: str) -> None:
    """The line has the link or joint, what was found and what was expected."""
    text = re.sub(old, new, PENDULUM, count=1)
    with pytest.raises(ModelError, match=f"{fault}.*expected"):
        model_of(text, "hinge")


def test_links_in_a_cycle_are_named() -> None:
    """Two links that are each other's parents are no part of the tree of the root."""
    links = '<link name="one"/><link name="two"/>'
    joints = "".join(
        f'<joint name="{a}{b}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>'
        for a, b in (("one", "two"), ("two", "one"))
    )
    with pytest.raises(ModelError, match="'one'"):
        model_of(PENDULUM.replace("</robot>", f"{links}{joints}</robot>"), "hinge")


def test_a_link_that_pinocchio_cannot_name_is_an_error_of_the_urdf() -> None:
    """The world of the library has the name ``universe``."""
    first = re.findall('<link name="([^"]*)"', PENDULUM)[0]
    model = model_of(PENDULUM.replace(f'"{first}"', '"universe"'), "hinge")
    with pytest.raises(ModelError, match="universe"):
        Robot(described(model))


def test_joints_that_pass_their_limits_are_named() -> None:
    """Nothing stops a joint at a limit."""
    limit = '<limit lower="-0.5" upper="0.5" velocity="5" effort="10"/>'
    revolute = PENDULUM.replace('"continuous"', '"revolute"', 1)
    text = revolute.replace('<axis xyz="0 -1 0"/>', f'<axis xyz="0 -1 0"/>{limit}', 1)
    robot = Robot(described(model_of(text, "hinge")))
    inside = np.array([[0.4, 9.0], [-0.5, 0.0]])
    assert robot.passed_limits(inside) == []
    assert robot.passed_limits(np.vstack([inside, [0.51, 0.0]])) == ["hinge"]


def test_a_start_inside_a_plane_is_an_error() -> None:
    """The line names the contact and the gap."""
    robot = Robot(described(model_of(PENDULUM, "hinge", contacts=wall())))
    with pytest.raises(UsageError, match=r"inside the plane of 'wall' \(gap -0\.\d+ m\)"):
        robot.checked_start([-0.5], [0.0])


def test_a_robot_is_made_of_a_model_file_or_of_a_sample() -> None:
    """The sample by its name; a linear model is an error that says what is expected."""
    assert Robot("hammer_arm").coordinates == ("shoulder", "elbow")
    with pytest.raises(UsageError, match="Robot"):
        Robot("two_mass")


def test_a_missing_pinocchio_is_one_line_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line names the extra and rosdep's key."""
    description = described(model_of(PENDULUM, "hinge"))
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(UsageError, match=r"pip install impact_observer\[robots\].* rosdep"):
        Robot(description)
