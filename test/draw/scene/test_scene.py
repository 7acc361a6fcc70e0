# SPDX-License-Identifier: Apache-2.0
"""Scenes: bodies meet stops exactly when the gap is zero, and nothing overlaps."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import Array, chain, examples, numbers, sample, system, systems, vectors

from impact_observer.draw.scene.scene import MOST_BODIES, Coupling, Scene, SceneJoint
from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.system import Guide


def free(n: int, *contacts: tuple[list[float], float]) -> System:
    """``n`` bodies without couplings, with contacts ``(direction, gap)``."""
    none = np.zeros((n, n))
    return system(np.eye(n), none, none, contacts=[(w, gap, 0.5) for w, gap in contacts])


def joints(scene: Scene) -> set[tuple[SceneJoint, int | None, int | None, int]]:
    """Joints with their places and lanes, without the position of the ground."""
    return {(each.joint, each.left, each.right, each.lane) for each in scene.couplings}


@st.composite
def chains_with_stops(draw: st.DrawFn) -> tuple[System, Array]:
    """A chain with walls and bumpers, and states of the chain."""
    n = draw(st.integers(1, 5))
    contacts: list[tuple[Array, float, float]] = []
    for _ in range(draw(st.integers(1, 4))):
        i, factor = draw(st.integers(0, n - 1)), draw(numbers(0.25, 2.0))
        w = np.zeros(n)
        w[i] = factor * draw(st.sampled_from([1.0, -1.0]))
        if i and draw(st.booleans()):
            w[i], w[i - 1] = factor, -factor
        contacts.append((w, draw(numbers(0.0, 1.0)), 0.5))
    states = draw(st.lists(vectors(n), min_size=1, max_size=5))
    return chain(n, contacts=contacts), np.array(states)


@examples(40)
@given(chains_with_stops(), st.data())
def test_a_body_is_as_far_from_its_stop_as_the_gap_says(
    case: tuple[System, Array], data: st.DataObject
) -> None:
    """Body and stop meet exactly at a gap of zero; grounds may move."""
    model, states = case
    scene = Scene.of_system(model, states)
    for q in states:
        moved = data.draw(st.just(np.zeros(model.m)) | vectors(model.m))
        frame, gaps = scene.frame(q, moved), model.gap(q) + moved
        rounding = 1e-11 * (1.0 + float(np.sum(np.abs(q)) + np.sum(np.abs(moved))))
        np.testing.assert_allclose(frame.gaps, gaps, rtol=1e-7, atol=rounding)
        for wall, at in zip(scene.walls, frame.walls.tolist(), strict=True):
            face = frame.bodies[wall.slot] + wall.side * scene.half
            factor = abs(model.W[scene.order[wall.slot], wall.contact])
            distance = wall.side * (at - face) * factor
            assert distance == pytest.approx(gaps[wall.contact], abs=rounding)
        for bumper, (start, end) in zip(scene.bumpers, frame.bumpers, strict=True):
            room = frame.bodies[bumper.slot + 1] - scene.half - end
            factor = model.W[scene.order[bumper.slot + 1], bumper.contact]
            assert start == pytest.approx(frame.bodies[bumper.slot] + scene.half)
            assert room * factor == pytest.approx(gaps[bumper.contact], abs=rounding)
            assert end >= start - rounding or moved.any()  # the scene has room for still stops


@examples(40)
@given(chains_with_stops())
def test_nothing_overlaps_while_stops_are_obeyed(case: tuple[System, Array]) -> None:
    """Bodies and walls have room between them, and are inside the picture."""
    model, states = case
    scene = Scene.of_system(model, states)
    for q in states:
        if model.penetrated(q):
            continue
        bodies = scene.frame(q).bodies
        things = [(x - scene.half, x + scene.half) for x in bodies]
        assert all(a[1] < b[0] for a, b in pairwise(things))
        for wall in scene.walls:
            left = scene.face(wall) - (scene.thickness if wall.side < 0 else 0.0)
            right = left + scene.thickness
            assert all(right <= a + 1e-12 or b <= left + 1e-12 for a, b in things)
            assert scene.extent[0] <= left < right <= scene.extent[1]
        assert scene.extent[0] < things[0][0]
        assert things[-1][1] < scene.extent[1]


@examples(40)
@given(systems(max_n=6, contacts=(0, 5)), st.data())
def test_any_model_has_a_scene(model: System, data: st.DataObject) -> None:
    """With full matrices and any directions every contact is drawn once, every number finite."""
    q = data.draw(vectors(model.n))
    for positions in ([], [q], [q, -q], [np.zeros(model.n)] * 2):
        scene = Scene.of_system(model, positions)
        drawn = [each.contact for each in scene.walls]
        drawn += [each.contact for each in scene.bumpers]
        drawn += [each.contact for each in scene.bars]
        assert sorted(drawn) == list(range(model.m))
        frame = scene.frame(q)
        for array in (frame.bodies, frame.couplings, frame.bumpers, frame.pins, frame.gaps):
            assert np.isfinite(array).all()
        assert scene.half > 0
        assert sorted(scene.order) == list(range(model.n))


@examples(40)
@given(systems(max_n=5, contacts=(1, 5)), st.data())
def test_pin_of_a_bar_is_as_far_from_its_plate_as_the_gap_says(
    model: System, data: st.DataObject
) -> None:
    """The pin stops at the end of the bar."""
    q = data.draw(vectors(model.n))
    scene = Scene.of_system(model, [q, -q])
    frame = scene.frame(q)
    for bar, pin in zip(scene.bars, frame.pins, strict=True):
        gap = frame.gaps[bar.contact]
        assert pin - bar.plate == pytest.approx(np.clip(gap, -bar.span, bar.span))
        assert bar.plate + bar.span + scene.thickness <= scene.extent[1] + 1e-12
        assert bar.plate >= scene.extent[0]


def test_chain_between_walls_has_springs_to_both() -> None:
    """The drawing of three_mass has four springs in a line, and stops at their limits."""
    scene = Scene.of_system(sample("three_mass").system)
    assert joints(scene) == {
        (SceneJoint.SPRING, None, 0, 0),
        (SceneJoint.SPRING, 0, 1, 0),
        (SceneJoint.SPRING, 1, 2, 0),
        (SceneJoint.SPRING, 2, None, 0),
    }
    assert [(each.slot, each.side) for each in scene.walls] == [(2, 1), (0, -1)]
    right, left = scene.walls
    assert scene.face(right) == pytest.approx(scene.homes[2] + scene.half + 0.3)
    assert scene.face(left) == pytest.approx(scene.homes[0] - scene.half - 0.25)
    grounds = sorted(each.ground for each in scene.couplings if None in (each.left, each.right))
    assert grounds[0] < scene.face(left) - scene.thickness
    assert grounds[1] > scene.face(right) + scene.thickness
    assert not scene.omitted


def test_matrix_model_shows_the_springs_that_its_elements_would() -> None:
    """two_mass is written as matrices: ground, x1, x2, and nothing beyond."""
    scene = Scene.of_system(sample("two_mass").system)
    assert joints(scene) == {(SceneJoint.SPRING, None, 0, 0), (SceneJoint.SPRING, 0, 1, 0)}
    (wall,) = scene.walls
    assert scene.extent[1] == pytest.approx(scene.face(wall) + 2 * scene.thickness)


def test_ball_is_free() -> None:
    """A model without stiffness has no spring; the floor is on the side of smaller coordinates."""
    scene = Scene.of_system(sample("bouncing_ball").system, [[1.0]])
    assert scene.couplings == ()
    (floor,) = scene.walls
    assert (floor.side, scene.face(floor)) == (-1, scene.homes[0] - scene.half)


def test_couplings_are_what_their_signs_say() -> None:
    """Damping alone is a dashpot; stiffness of the opposite sign is a line."""
    K = np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    C = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 1.0]])
    scene = Scene.of_system(system(np.eye(3), C, K))
    assert joints(scene) == {
        (SceneJoint.SPRING, None, 0, 0),
        (SceneJoint.SPRING, None, 1, 1),
        (SceneJoint.LINK, 0, 1, 0),
        (SceneJoint.DAMPER, 1, 2, 0),
    }


def test_couplings_over_other_bodies_never_share_a_lane() -> None:
    """Couplings without a lane are counted, not drawn over each other."""
    n = 8
    K = (n + 1) * np.eye(n) - np.ones((n, n))
    scene = Scene.of_system(system(np.eye(n), np.zeros((n, n)), K))
    above: dict[int, list[tuple[float, float]]] = {}
    ends = scene.frame(np.zeros(n)).couplings.tolist()
    for each, (left, right) in zip(scene.couplings, ends, strict=True):
        if each.lane:
            above.setdefault(each.lane, []).append((left, right))
    for spans in above.values():
        ordered = sorted(spans)
        assert all(a[1] <= b[0] + 1e-12 for a, b in pairwise(ordered))
    left_out = n * (n - 1) // 2 + n - len(scene.couplings)
    assert scene.omitted == (f"without {left_out} couplings",)


def test_bumper_puts_its_bodies_in_order() -> None:
    """The left body of a contact stands on the left, whatever its number is."""
    scene = Scene.of_system(free(3, ([1.0, 0.0, -1.0], 0.5)))
    assert scene.order == (1, 2, 0)
    (bumper,) = scene.bumpers
    assert bumper.slot == 1
    assert scene.names == ("x2", "x3", "x1")


def test_contradicting_bumpers_leave_the_order_alone() -> None:
    """The second of two contacts that contradict each other is a bar."""
    scene = Scene.of_system(free(2, ([-1.0, 1.0], 0.5), ([1.0, -1.0], 0.5)))
    assert scene.order == (0, 1)
    assert [each.contact for each in scene.bumpers] == [0]
    assert [each.contact for each in scene.bars] == [1]


def test_distant_stop_is_drawn_as_a_bar() -> None:
    """The pin is at the end of the bar, so the motion stays visible."""
    motion = 0.1 * np.sin(np.arange(50.0))[:, None]
    scene = Scene.of_system(free(1, ([-1.0], 100.0)), motion)
    assert scene.walls == ()
    (bar,) = scene.bars
    assert scene.extent[1] - scene.extent[0] < 2.0
    assert scene.frame(motion[3]).pins[0] == pytest.approx(bar.plate + bar.span)


@pytest.mark.slow
def test_very_long_chain_shows_its_first_bodies_and_says_so() -> None:
    """A thousand bodies would be lines."""
    n = 1000
    last = np.eye(n)[-1]
    model = chain(n, contacts=[(-last, 0.5, 0.5), (np.eye(n)[0], 0.5, 0.5)])
    scene = Scene.of_system(model, 0.1 * np.ones((2, n)) * [[1.0], [-1.0]])
    assert len(scene.homes) == MOST_BODIES
    assert scene.omitted == (
        f"the first {MOST_BODIES} of 1000 bodies",
        "without 1 of 2 contacts",
    )
    assert scene.frame(np.ones(n)).gaps.shape == (2,)


def test_the_amplitude_sets_the_distance_of_bodies() -> None:
    """A viewer begins before any body has moved."""
    model = sample("three_mass").system
    near, far = Scene.of_system(model, amplitude=0.5), Scene.of_system(model, amplitude=5.0)
    assert far.homes[-1] == pytest.approx(10 * near.homes[-1], rel=0.1)
    swing = 5.0 * np.array([1.0, -1.0, 1.0])
    bodies = far.frame(swing).bodies
    assert np.all(np.diff(bodies) > 2 * far.half)


def test_scene_cannot_be_changed() -> None:
    """Arrays of scenes and of frames are read-only."""
    scene = Scene.of_system(sample("two_mass").system)
    for array in (scene.homes, scene.frame(np.zeros(2)).bodies):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert isinstance(scene.couplings[0], Coupling)


@pytest.mark.parametrize("positions", [np.zeros((3, 3)), np.array([[np.nan, 0.0]]), np.zeros(2)])
def test_positions_that_fit_no_model_are_refused(positions: Array) -> None:
    """The error has the expected shape."""
    with pytest.raises(UsageError, match=r"expected \(samples, 2\), all finite"):
        Scene.of_system(sample("two_mass").system, positions)


def test_guides_that_rub_are_above_the_bodies_that_they_join() -> None:
    """A spring may join the same bodies; a guide with other factors is left out, with a line."""
    model = sample("rubbing_guide").system
    drawn = joints(Scene.of_system(model))
    assert (SceneJoint.GUIDE, 0, 1, 1) in drawn
    assert (SceneJoint.SPRING, 0, 1, 0) in drawn
    base = replace(model, guides=(Guide("rail", np.array([0.0, 2.0]), 1.0),))
    assert (SceneJoint.GUIDE, None, 1, 1) in joints(Scene.of_system(base))
    uneven = replace(model, guides=(Guide("odd", np.array([1.0, -2.0]), 1.0),))
    assert Scene.of_system(uneven).omitted == ("without 1 couplings",)
