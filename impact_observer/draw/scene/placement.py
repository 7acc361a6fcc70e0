# SPDX-License-Identifier: Apache-2.0
"""Places and scale of the tracks of a film in its pictures.

Tracks lie in rows above each other. The tracks of a single coordinate that falls stand upright,
beside each other.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D, Transform

from impact_observer.draw.scene.scene import Scene
from impact_observer.draw.scene.shapes import bar_height, lane_height

WIDTH = 9.6
"""Width of the pictures, inches."""
SIDE = 0.25
"""Margin beside the scene, inches."""
_UPRIGHT = 3.6
"""Length of an upright scene, inches."""
_HEIGHT, _CLOSEST = 0.75, 0.36
"""Largest and least size of a body across the line, inches."""
_LABEL, _BELOW_FLOOR = 0.36, 0.22
"""Room for the label of a track, and for the names of stops beside the floor, inches."""


@dataclass(frozen=True)
class Placement:
    """The place of a scene in its axes: along the line in m, across the line in sizes of a body.

    Attributes:
        scene: positions of bodies and stops.
        tracks: number of tracks.
    """

    scene: Scene
    tracks: int

    @property
    def up(self) -> int:
        """Sign of the coordinate's upward direction; 0 for a scene that lies."""
        return self.scene.up

    @cached_property
    def length(self) -> float:
        """Length of the scene along the line, inches."""
        return _UPRIGHT if self.up else WIDTH - 2 * SIDE

    @cached_property
    def body(self) -> float:
        """Size of a body across the line, inches: about the size along the line, within limits."""
        start, end = self.scene.extent
        return min(max(2 * self.scene.half / (end - start) * self.length, _CLOSEST), _HEIGHT)

    @property
    def top(self) -> float:
        """Upper end of a lying row, in sizes of a body."""
        scene = self.scene
        drawn = lane_height(scene.lanes) + 0.15 if scene.lanes else 1.0
        return drawn + _LABEL / self.body

    @property
    def bottom(self) -> float:
        """Lower end of a lying row, in sizes of a body."""
        scene = self.scene
        drawn = bar_height(scene.bar_lanes - 1) - 0.15 if scene.bar_lanes else 0.0
        return drawn - _BELOW_FLOOR / self.body

    @property
    def height(self) -> float:
        """Height of all tracks, inches."""
        if self.up:
            return self.length + 2 * SIDE + _LABEL
        return self.tracks * self.body * (self.top - self.bottom)

    def box(self, track: int) -> tuple[float, float, float, float]:
        """Left, distance from the top, width and height of a track's axes, inches."""
        if self.up:
            return track * WIDTH / self.tracks, 0.0, WIDTH / self.tracks, self.height
        height = self.height / self.tracks
        return 0.0, track * height, WIDTH, height

    def prepare(self, axes: Axes) -> Transform:
        """Set limits of the same scale in every track, hide the axes.

        Returns:
            From (along, across) to the picture.
        """
        start, end = self.scene.extent
        margin = (end - start) * SIDE / self.length
        axes.set_axis_off()
        if not self.up:
            axes.set_xlim(start - margin, end + margin)
            axes.set_ylim(self.bottom, self.top)
            return axes.transData
        across = WIDTH / self.tracks / self.body
        axes.set_xlim(0.5 - across / 2, 0.5 + across / 2)
        low, high = sorted((self.up * start, self.up * end))
        axes.set_ylim(low - margin, high + margin * (1 + _LABEL / SIDE))
        swap = Affine2D(np.array([[0.0, 1.0, 0.0], [self.up, 0.0, 0.0], [0.0, 0.0, 1.0]]))
        return swap + axes.transData
