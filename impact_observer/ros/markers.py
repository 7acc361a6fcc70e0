# SPDX-License-Identifier: Apache-2.0
"""Markers of a scene for RViz: x is along the line, rows follow each other along -y."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import TypeAlias

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from impact_observer.draw.scene.scene import Frame, Scene
from impact_observer.draw.scene.shapes import (
    ROWS,
    Box,
    couplings,
    grounds,
    pins,
    plates,
    rails,
    rods,
)
from impact_observer.states import Matrix, Vector

Colour: TypeAlias = tuple[float, float, float]
PLANT: Colour = (0.40, 0.61, 0.78)
ESTIMATE: Colour = (0.93, 0.93, 0.93)
_STOP: Colour = (0.45, 0.45, 0.45)
_LIT: Colour = (0.84, 0.37, 0.0)
_LINE: Colour = (0.15, 0.15, 0.15)
_THICK, _THIN, _LETTER = 0.07, 0.03, 0.3
"""Widths of rods and of springs, height of letters, in heights of a body."""


@dataclass(frozen=True, slots=True)
class MarkerRow:
    """A plant or an estimate among the rows.

    Attributes:
        name: of the row; namespaces of its markers begin with it.
        place: number of the row, from 0.
        colour: of its bodies.
    """

    name: str
    place: int
    colour: Colour


class Painter:
    """Makes the markers of a scene, always with the same ids."""

    def __init__(self, scene: Scene, frame: str) -> None:
        """Draw ``scene`` in the coordinate frame ``frame``."""
        self._scene, self._frame = scene, frame
        self._unit = 2 * scene.half

    def clear(self, time: Time) -> MarkerArray:
        """A message that deletes all earlier markers."""
        return MarkerArray(markers=[self._marker("", 0, Marker.DELETEALL, time)])

    def markers(
        self,
        row: MarkerRow,
        q: Vector,
        lit: Collection[int],
        time: Time,
        moved: Vector | None = None,
    ) -> list[Marker]:
        """The markers of a row.

        Args:
            row: the row.
            q: coordinates, shape (n,), m.
            lit: indices of contacts that are closed or had an impact just before.
            time: stamp of the state.
            moved: part of the gaps by moving grounds, shape (m,), m; None without such.
        """
        frame = self._scene.frame(q, moved)
        boxes, lines = self._boxes(row, frame, lit), self._lines(row, frame)
        markers = [*boxes, *lines, *self._texts(row, frame)]
        for marker in markers:
            marker.header.stamp = time
        return markers

    def _boxes(self, row: MarkerRow, frame: Frame, lit: Collection[int]) -> Iterator[Marker]:
        """Boxes of bodies, stops, pins of bars, and grounds of springs."""
        scene = self._scene
        for slot, x in enumerate(frame.bodies.tolist()):
            box = Box(x - scene.half, 0.0, 2 * scene.half, 1.0)
            yield self._cube(row, ("bodies", slot), box, row.colour)
        for contact, box in plates(scene, frame):
            yield self._cube(row, ("stops", contact), box, _LIT if contact in lit else _STOP)
        for contact, box in pins(scene, frame):
            yield self._cube(row, ("pins", contact), box, row.colour)
        for i, box in enumerate(grounds(scene)):
            yield self._cube(row, ("grounds", i), box, _STOP)

    def _lines(self, row: MarkerRow, frame: Frame) -> Iterator[Marker]:
        """Lines of springs, dampers and links, of rods of bumpers, and of rails of bars."""
        scene = self._scene
        for name, strokes, width in (
            ("springs", couplings(scene, frame), _THIN),
            ("rods", rods(frame), _THICK),
            ("rails", rails(scene), _THIN),
        ):
            if len(strokes):
                yield self._list(row, name, strokes, width)

    def _texts(self, row: MarkerRow, frame: Frame) -> Iterator[Marker]:
        """Texts with the names of bodies and stops, and of the row."""
        scene = self._scene
        for slot, (name, x) in enumerate(zip(scene.names, frame.bodies.tolist(), strict=True)):
            yield self._text(row, ("names", slot), (x, 1.25), name)
        for contact, box in plates(scene, frame):
            name = scene.system.contact_names[contact]
            above = (box.left + box.width / 2, box.bottom + box.height + 0.2)
            yield self._text(row, ("stop names", contact), above, name)
        yield self._text(row, ("label", 0), (scene.extent[0] - 2 * scene.half, 0.5), row.name)

    def _cube(self, row: MarkerRow, key: tuple[str, int], box: Box, colour: Colour) -> Marker:
        """A box as deep as a body."""
        marker = self._marker(f"{row.name}/{key[0]}", key[1], Marker.ADD)
        marker.type = Marker.CUBE
        middle = box.bottom + box.height / 2
        marker.pose.position = self._point(row, box.left + box.width / 2, middle)
        marker.scale = Vector3(x=box.width, y=self._unit, z=box.height * self._unit)
        marker.color = _colour(colour)
        return marker

    def _list(self, row: MarkerRow, name: str, strokes: Matrix, width: float) -> Marker:
        """Lines, in the middle plane of the bodies."""
        marker = self._marker(f"{row.name}/{name}", 0, Marker.ADD)
        marker.type = Marker.LINE_LIST
        marker.points = [self._point(row, x, z) for x, z in strokes.reshape(-1, 2).tolist()]
        marker.scale.x = width * self._unit
        marker.color = _colour(_LINE)
        return marker

    def _text(
        self, row: MarkerRow, key: tuple[str, int], at: tuple[float, float], text: str
    ) -> Marker:
        """A text that faces the viewer."""
        marker = self._marker(f"{row.name}/{key[0]}", key[1], Marker.ADD)
        marker.type, marker.text = Marker.TEXT_VIEW_FACING, text
        marker.pose.position = self._point(row, *at)
        marker.scale.z = _LETTER * self._unit
        marker.color = _colour(_LINE)
        return marker

    def _marker(
        self, namespace: str, number: int, action: int, time: Time | None = None
    ) -> Marker:
        """A marker without a shape."""
        marker = Marker(ns=namespace, id=number, action=action)
        marker.header.frame_id = self._frame
        marker.header.stamp = Time() if time is None else time
        marker.pose.orientation.w = 1.0
        return marker

    def _point(self, row: MarkerRow, x: float, height: float) -> Point:
        """A point in the middle plane of a row."""
        return Point(x=x, y=-row.place * ROWS * self._unit, z=height * self._unit)


def _colour(colour: Colour) -> ColorRGBA:
    """An opaque colour."""
    red, green, blue = colour
    return ColorRGBA(r=red, g=green, b=blue, a=1.0)
