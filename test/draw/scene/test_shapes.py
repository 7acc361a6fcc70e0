# SPDX-License-Identifier: Apache-2.0
"""Shapes: springs reach from end to end, plates stand where contacts are."""

import numpy as np
import pytest
from systems import chain, sample, system

from impact_observer.draw.scene.scene import Scene, SceneJoint
from impact_observer.draw.scene.shapes import (
    STOP_HEIGHT,
    couplings,
    grounds,
    pads,
    pins,
    plates,
    rails,
    rods,
    strokes,
)


@pytest.mark.parametrize("joint", list(SceneJoint))
@pytest.mark.parametrize("end", [3.0, 1.0, 0.5])
def test_coupling_goes_from_end_to_end(joint: SceneJoint, end: float) -> None:
    """A coupling stays within its width, also if the ends meet or cross."""
    shape = strokes(joint, 1.0, end, 0.7, 0.1)
    assert shape.shape[1:] == (2, 2)
    assert shape[0, 0].tolist() == [1.0, 0.7]
    assert shape[-1, 1].tolist() == pytest.approx([end, 0.7])
    assert shape[..., 0].min() >= min(1.0, end) - 1e-12
    assert shape[..., 0].max() <= max(1.0, end) + 1e-12
    assert np.abs(shape[..., 1] - 0.7).max() <= 0.1 + 1e-12


def test_spring_is_one_line_and_a_damper_is_not() -> None:
    """A zigzag ends where the next stroke begins; piston and cup are separate."""
    spring = strokes(SceneJoint.SPRING, 0.0, 1.0, 0.0, 0.1)
    np.testing.assert_array_equal(spring[:-1, 1], spring[1:, 0])
    assert {round(float(y), 3) for y in spring[..., 1].flat} == {-0.1, 0.0, 0.1}
    damper = strokes(SceneJoint.DAMPER, 0.0, 1.0, 0.0, 0.1)
    assert not np.array_equal(damper[:-1, 1], damper[1:, 0])


def test_plates_stand_at_the_stops() -> None:
    """The face of a wall is an edge of its plate; the grounds are outside of both stops."""
    scene = Scene.of_system(sample("three_mass").system)
    boxes = dict(plates(scene, scene.frame(np.zeros(3))))
    right, left = boxes[0], boxes[1]
    assert right.left == pytest.approx(scene.face(scene.walls[0]))
    assert left.left + left.width == pytest.approx(scene.face(scene.walls[1]))
    assert right.height == STOP_HEIGHT
    edges = sorted(box.left for box in grounds(scene))
    assert edges[0] < left.left
    assert edges[1] > right.left + right.width


def test_lanes_are_above_and_bars_below_the_bodies() -> None:
    """Springs over other bodies have posts; pins slide on rails."""
    contacts = [([1.0, 1.0, 1.0], 0.2, 0.5), ([0.0, -1.0, 1.0], 0.1, 0.5)]
    K = 3 * np.eye(3) - np.ones((3, 3)) + np.eye(3)
    scene = Scene.of_system(system(np.eye(3), np.zeros((3, 3)), K, contacts=contacts))
    frame = scene.frame(np.array([0.1, 0.0, -0.05]))
    assert couplings(scene, frame)[..., 1].max() > 1.2
    ((contact, pin),) = pins(scene, frame)
    assert contact == 0
    assert pin.bottom + pin.height < 0
    assert pin.left == pytest.approx(scene.bars[0].plate + 0.25)
    (rail,) = rails(scene)
    assert rail[0, 0] <= pin.left <= rail[1, 0]
    ((contact, pad),) = pads(scene, frame)
    assert contact == 1
    assert pad.left + pad.width == pytest.approx(rods(frame)[0, 1, 0])


def test_scene_without_springs_has_no_strokes() -> None:
    """Strokes of a scene without springs are empty arrays of the right shape."""
    scene = Scene.of_system(sample("bouncing_ball").system)
    frame = scene.frame(np.zeros(1))
    for empty in (couplings(scene, frame), rods(frame), rails(scene)):
        assert empty.shape == (0, 2, 2)
    assert len(list(grounds(Scene.of_system(chain(2))))) == 2
