# SPDX-License-Identifier: Apache-2.0
"""Shapes of a scene in a plane: metres along the line, heights of a body across the line."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.draw.scene.scene import Frame, Scene, SceneJoint
from impact_observer.states import Matrix

SPRING_HEIGHT, ROD_HEIGHT, STOP_HEIGHT = 0.72, 0.24, 0.46
"""Heights of springs between faces, of a bumper's rod, of a wall's top, over a body's height."""
ROWS = 2.2
"""Distance between rows of bodies, over a body's height."""
_HAND = 0.9
"""Length of a hand, over half a body's height."""
_PAD, _PIN, _WIDE = 0.14, 0.11, 0.1
"""Half the heights of a bumper's pad, of a bar's pin, and of a spring's teeth, over a body's."""
_LANE, _FIRST_LANE = 0.3, 1.26
"""Distance between lanes of couplings, and height of the first lane, over a body's height."""
_BAR, _FIRST_BAR = 0.34, -0.36
"""Distance between bars, and height of the first bar, over a body's height."""
_TEETH = 11
"""Number of teeth of a spring."""
_ENDS = 0.1
"""Straight part of a spring at each end, over the length."""
_CUP = 0.55
"""Beginning of a damper's cup, over the length."""


class Box(NamedTuple):
    """An upright rectangle.

    Attributes:
        left: m.
        bottom: heights of a body.
        width: m.
        height: heights of a body.
    """

    left: float
    bottom: float
    width: float
    height: float


def lane_height(lane: int) -> float:
    """The height of the couplings of a lane, over a body's."""
    return _FIRST_LANE + _LANE * (lane - 1) if lane else SPRING_HEIGHT


def bar_height(lane: int) -> float:
    """The height of the middle of a bar, over a body's."""
    return _FIRST_BAR - _BAR * lane


def plates(scene: Scene, frame: Frame) -> Iterator[tuple[int, Box]]:
    """Index and stop of each contact: a wall, a bumper's pad, the plate of a bar."""
    thickness = scene.thickness
    for each, face in zip(scene.walls, frame.walls.tolist(), strict=True):
        left = face - (thickness if each.side < 0 else 0.0)
        yield each.contact, Box(left, 0.0, thickness, STOP_HEIGHT)
    yield from pads(scene, frame)
    for bar in scene.bars:
        bottom = bar_height(bar.lane) - _PIN
        yield bar.contact, Box(bar.plate - thickness, bottom, thickness, 2 * _PIN)


def pads(scene: Scene, frame: Frame) -> Iterator[tuple[int, Box]]:
    """Index of the contact and pad of each bumper."""
    width = scene.thickness / 2
    for each, (_, end) in zip(scene.bumpers, frame.bumpers.tolist(), strict=True):
        yield each.contact, Box(end - width, ROD_HEIGHT - _PAD, width, 2 * _PAD)


def hands(scene: Scene, frame: Frame, stretch: float) -> Iterator[Matrix]:
    """The hand of each body of what turns, from its middle, upright at zero, shape (2, 2).

    ``stretch`` is the length along the line, m, that is drawn as long as a body is high.
    """
    if scene.system.unit != "rad":
        return
    for middle, angle in zip(frame.bodies.tolist(), frame.bodies - scene.homes, strict=True):
        along, across = _HAND / 2 * stretch * np.sin(angle), _HAND / 2 * np.cos(angle)
        yield np.array([[middle, 0.5], [middle + along, 0.5 + across]])


def pins(scene: Scene, frame: Frame) -> Iterator[tuple[int, Box]]:
    """Index of the contact and pin of each bar; the gap ends at the left face of the pin."""
    for bar, pin in zip(scene.bars, frame.pins.tolist(), strict=True):
        yield bar.contact, Box(pin, bar_height(bar.lane) - _PIN, scene.thickness, 2 * _PIN)


def grounds(scene: Scene) -> Iterator[Box]:
    """The blocks at the ends of springs to the ground."""
    for each in scene.couplings:
        if each.left is None or each.right is None:
            left = each.ground - (scene.thickness if each.left is None else 0.0)
            if each.lane:
                yield Box(left, lane_height(each.lane) - _PIN, scene.thickness, 2 * _PIN)
            else:
                yield Box(left, 0.0, scene.thickness, 1.0)


def rails(scene: Scene) -> Matrix:
    """The lines along which pins of bars move, as pairs of points, shape (strokes, 2, 2)."""
    ends = [
        [[x, bar_height(bar.lane) - _PIN] for x in (bar.plate, bar.plate + bar.span)]
        for bar in scene.bars
    ]
    return np.reshape(ends, (-1, 2, 2))


def rods(frame: Frame) -> Matrix:
    """The rods of bumpers as pairs of points, shape (strokes, 2, 2)."""
    ends = [[[x, ROD_HEIGHT], [end, ROD_HEIGHT]] for x, end in frame.bumpers.tolist()]
    return np.reshape(ends, (-1, 2, 2))


def couplings(scene: Scene, frame: Frame) -> Matrix:
    """All couplings as pairs of points, with posts below couplings above the bodies.

    Returns:
        Shape (strokes, 2, 2).
    """
    drawn: list[Matrix] = [np.empty((0, 2, 2))]
    for each, (left, right) in zip(scene.couplings, frame.couplings.tolist(), strict=True):
        height = lane_height(each.lane)
        drawn.append(strokes(each.joint, left, right, height, _WIDE))
        for slot, x in ((each.left, left), (each.right, right)):
            if each.lane and slot is not None:
                drawn.append(np.array([[[x, 1.0], [x, height]]]))
    return np.concatenate(drawn)


def strokes(joint: SceneJoint, start: float, end: float, height: float, width: float) -> Matrix:
    """One coupling as pairs of points (along, across), shape (strokes, 2, 2).

    Args:
        joint: a spring is a zigzag, a damper a dashpot, a link a line, a guide a rod between pads.
        start: left end, m.
        end: right end, m.
        height: of the coupling's middle.
        width: of teeth or cup, from the middle to each side.
    """
    if joint is SceneJoint.SPRING:
        shape = _path(_zigzag())
    elif joint is SceneJoint.DAMPER:
        shape = _dashpot()
    elif joint is SceneJoint.GUIDE:
        shape = _rubbed_rod()
    else:
        shape = _path(np.array([[0.0, 0.0], [1.0, 0.0]]))
    return np.asarray(shape * [end - start, width] + [start, height])


def _zigzag() -> NDArray[np.float64]:
    """Corners of a spring of length and width 1, shape (corners, 2)."""
    along = np.linspace(_ENDS, 1 - _ENDS, 2 * _TEETH + 1)[1::2]
    across = np.where(np.arange(_TEETH) % 2, -1.0, 1.0)
    teeth = np.column_stack([along, across])
    return np.vstack([[0.0, 0.0], [_ENDS, 0.0], teeth, [1 - _ENDS, 0.0], [1.0, 0.0]])


def _dashpot() -> NDArray[np.float64]:
    """A cup on the right rod, and a piston in the cup on the left rod."""
    piston = (_CUP + 1 - _ENDS) / 2
    cup = [[_CUP, 1.0], [1 - _ENDS, 1.0], [1 - _ENDS, -1.0], [_CUP, -1.0]]
    return np.vstack(
        [
            _path(np.array([[0.0, 0.0], [piston, 0.0]])),
            _path(np.array([[piston, 0.7], [piston, -0.7]])),
            _path(np.array(cup)),
            _path(np.array([[1 - _ENDS, 0.0], [1.0, 0.0]])),
        ]
    )


def _rubbed_rod() -> NDArray[np.float64]:
    """A rod on the left end, and a holder on the right end whose pads press on the rod."""
    begin, end, pad = _CUP - 0.2, _CUP + 0.1, 0.4
    middle, last = (begin + end) / 2, 1 - _ENDS
    holder = [[middle, pad], [middle, 1.0], [last, 1.0], [last, -1.0], [middle, -1.0]]
    return np.vstack(
        [
            _path(np.array([[0.0, 0.0], [_CUP + 0.2, 0.0]])),
            _path(np.array([[begin, pad], [end, pad]])),
            _path(np.array([[begin, -pad], [end, -pad]])),
            _path(np.array([*holder, [middle, -pad]])),
            _path(np.array([[last, 0.0], [1.0, 0.0]])),
        ]
    )


def _path(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Strokes from corner to corner, shape (corners - 1, 2, 2)."""
    return np.stack([corners[:-1], corners[1:]], axis=1)
