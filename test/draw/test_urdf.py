# SPDX-License-Identifier: Apache-2.0
"""URDF: joints have the names of coordinates and put bodies to their places in the scene."""

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from systems import system

from impact_observer.draw.scene.scene import Scene
from impact_observer.draw.urdf_text import urdf_text
from impact_observer.model import parse_model, read_model


def numbers(element: ET.Element | None, key: str) -> list[float]:
    """Numbers in an attribute."""
    assert element is not None
    return [float(word) for word in element.attrib[key].split()]


def places(robot: ET.Element, joints: dict[str, float], root: str = "world") -> dict[str, float]:
    """Positions of the links along the line, as robot_state_publisher computes them."""
    found = {root: 0.0}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        assert parent is not None
        assert child is not None
        x = found[parent.attrib["link"]] + numbers(joint.find("origin"), "xyz")[0]
        if joint.attrib["type"] == "prismatic":
            x += numbers(joint.find("axis"), "xyz")[0] * joints[joint.attrib["name"]]
        found[child.attrib["link"]] = x
    return found


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball"])
def test_joint_states_move_bodies_as_in_the_scene(name: str) -> None:
    """Bodies are where the viewer has them, and reach their stops when gaps are zero."""
    model = read_model(name)
    scene = Scene.of_system(model.system, [model.initial_state()[0]])
    robot = ET.fromstring(urdf_text(scene))
    moving = [j.attrib["name"] for j in robot.findall("joint") if j.attrib["type"] == "prismatic"]
    assert sorted(moving) == sorted(model.system.coordinates)
    rng = np.random.default_rng(1)
    for q in rng.normal(size=(5, model.system.n)):
        found = places(robot, dict(zip(model.system.coordinates, q, strict=True)))
        bodies = [found[each] for each in scene.names]
        np.testing.assert_allclose(bodies, scene.frame(q).bodies, atol=1e-12)
        for wall in scene.walls:
            stop = model.system.contact_names[wall.contact]
            face = bodies[wall.slot] + wall.side * scene.half
            gap = wall.side * (found[stop] - face)
            assert gap == pytest.approx(model.system.gap(q)[wall.contact], abs=1e-12)


def test_it_is_a_valid_urdf() -> None:
    """Every joint has a parent, a child and limits; every link but the first is a child of one."""
    scene = Scene.of_system(read_model("three_mass").system)
    robot = ET.fromstring(urdf_text(scene))
    assert (robot.tag, robot.attrib["name"]) == ("robot", "three_mass")
    links = [link.attrib["name"] for link in robot.findall("link")]
    assert len(set(links)) == len(links)
    children = []
    for joint in robot.findall("joint"):
        child = joint.find("child")
        assert child is not None
        children.append(child.attrib["link"])
        if joint.attrib["type"] == "prismatic":
            limit = joint.find("limit")
            assert numbers(limit, "lower")[0] < 0 < numbers(limit, "upper")[0]
            assert {"effort", "velocity"} <= set(limit.attrib if limit is not None else ())
    assert sorted(children) == sorted(links[1:])
    for visual in robot.iter("visual"):
        assert min(numbers(visual.find("geometry/box"), "size")) > 0


def test_rod_of_a_bumper_moves_with_its_body() -> None:
    """The rod ends at the next body's face if the gap is zero."""
    contacts = [([-1.0, 1.0], 0.3, 0.5)]
    model = system(np.eye(2), np.zeros((2, 2)), np.eye(2), contacts=contacts)
    scene = Scene.of_system(model)
    robot = ET.fromstring(urdf_text(scene))
    left = next(link for link in robot.findall("link") if link.attrib["name"] == "x1")
    right_end = max(
        numbers(visual.find("origin"), "xyz")[0]
        + numbers(visual.find("geometry/box"), "size")[0] / 2
        for visual in left.findall("visual")
    )
    q = {"x1": 0.2, "x2": -0.1}
    found = places(robot, q)
    assert model.gap(np.array([0.2, -0.1]))[0] == pytest.approx(0.0)
    assert found["x1"] + right_end == pytest.approx(found["x2"] - scene.half)


def test_prefix_row_and_frame_let_plant_and_estimate_stand_side_by_side() -> None:
    """Joints keep the names of the joint states."""
    scene = Scene.of_system(read_model("two_mass").system)
    robot = ET.fromstring(urdf_text(scene, prefix="estimate_", frame="map", row=1))
    links = [link.attrib["name"] for link in robot.findall("link")]
    assert links == ["map", "estimate_x1", "estimate_x2", "estimate_stop"]
    joints = robot.findall("joint")
    assert [each.attrib["name"] for each in joints][:2] == ["x1", "x2"]
    aside = {numbers(each.find("origin"), "xyz")[1] for each in joints}
    assert len(aside) == 1
    assert aside.pop() < -2 * scene.half


def test_stop_with_the_name_of_a_body_gets_another() -> None:
    """Links of a URDF have one name each."""
    model = system([[1.0]], [[0.0]], [[1.0]], contacts=[([-1.0], 0.5, 0.5)])
    (contact,) = model.contacts
    twin = type(contact)("x1", contact.direction, contact.gap, contact.restitution)
    both = type(model)(
        model.name, model.coordinates, model.M, model.C, model.K, model.forcing, (twin,)
    )
    robot = ET.fromstring(urdf_text(Scene.of_system(both)))
    links = [link.attrib["name"] for link in robot.findall("link")]
    assert links == ["world", "x1", "x1_stop"]


def test_what_turns_has_revolute_joints_and_posts_where_its_stops_are() -> None:
    """An arm that stands upright at zero touches a post exactly at the angle of its stop."""
    model = parse_model(
        """name: pendulum
unit: rad
bodies: [{name: arm, mass: 0.02}, {name: hand, mass: 0.01}]
springs: [{between: [ground, arm], stiffness: 1}, {between: [arm, hand], stiffness: 1}]
stops:
  - {name: right, body: arm, limit: 0.5, side: above, restitution: 0.7}
  - {name: left, body: arm, limit: -0.3, side: below, restitution: 0.7}
""",
        "pendulum",
    )
    robot = ET.fromstring(urdf_text(Scene.of_system(model.system), length=2.0))
    joints = {each.attrib["name"]: each for each in robot.findall("joint")}
    for name in ("arm", "hand"):
        assert joints[name].attrib["type"] == "revolute"
        assert numbers(joints[name].find("axis"), "xyz") == [0.0, 1.0, 0.0]
    apart = [numbers(joints[name].find("origin"), "xyz")[0] for name in ("arm", "hand")]
    assert apart[1] - apart[0] > 2 * 2.0
    links = {each.attrib["name"]: each for each in robot.findall("link")}
    arm = numbers(links["arm"].find("visual/geometry/box"), "size")
    middle = numbers(links["arm"].find("visual/origin"), "xyz")
    assert (middle[2] - arm[2] / 2, middle[2] + arm[2] / 2) == (0.0, 2.0)
    for name, angle, side in (("right", 0.5, 1.0), ("left", -0.3, -1.0)):
        origin = joints[f"{name}_fixed"].find("origin")
        assert numbers(origin, "rpy") == pytest.approx([0.0, angle, 0.0])
        assert numbers(origin, "xyz")[0] == apart[0]
        post = numbers(links[name].find("visual/geometry/box"), "size")
        at = numbers(links[name].find("visual/origin"), "xyz")
        face = at[0] - side * post[0] / 2
        assert face == pytest.approx(side * arm[0] / 2)  # in the frame of an arm at that angle
