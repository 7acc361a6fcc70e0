# SPDX-License-Identifier: Apache-2.0
"""Where the observer of a robot starts: at the first sample of each encoder."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model.measurement import Measurement
from impact_observer.observer.event_order import EventKey
from impact_observer.observer.uncertainty import deviation_of
from impact_observer.options import Options
from impact_observer.robots.robot import Robot
from impact_observer.states import Vector

_SHARE = 0.1
"""Deviation of a velocity whose deviation is not declared, over its limit in the URDF."""
_UNLIMITED = 1.0
"""The same without a limit, rad/s or m/s."""


class EncoderStart:
    """The first sample of the encoder of each joint, at which a robot is taken to be at rest."""

    def __init__(self, robot: Robot, sensors: Sequence[Measurement]) -> None:
        """Find the encoders of a ``robot`` among its ``sensors``; no sample has come yet.

        Raises:
            UsageError: a joint has no encoder.
        """
        found = {
            each.encoded[0]: i
            for i, each in enumerate(sensors)
            if each.encoded and each.encoded[1] == 1.0
        }
        for joint in robot.coordinates:
            if joint not in found:
                raise UsageError(
                    f"initial state: no encoder of the joint {joint!r} found; expected one in"
                    " measurements, or an initial state"
                )
        self._robot = robot
        self._encoders = [found[joint] for joint in robot.coordinates]
        self._sensors = [sensors[i] for i in self._encoders]
        self._first: dict[int, EventKey] = {}

    def note(self, samples: Iterable[EventKey]) -> bool:
        """Take note of received ``samples``; returns whether the first ones have changed."""
        before = dict(self._first)
        for key in samples:
            if key.sensor in self._encoders:
                self._first[key.sensor] = min(key, self._first.get(key.sensor, key))
        return self._first != before

    def forget(self) -> None:
        """Forget all samples."""
        self._first.clear()

    @property
    def lacking(self) -> tuple[str, ...]:
        """Names of the joints whose encoders have had no sample."""
        pairs = zip(self._robot.coordinates, self._encoders, strict=True)
        return tuple(joint for joint, i in pairs if i not in self._first)

    @property
    def stamp(self) -> int:
        """The earliest stamp of the first samples, ns."""
        return min(self._first[i].stamp for i in self._encoders)

    @property
    def state(self) -> Vector:
        """The robot at rest at the first samples, shape (2n,)."""
        values = [self._first[i].sample[0] for i in self._encoders]
        q = np.subtract(values, [each.offset for each in self._sensors])
        return np.concatenate([q, np.zeros_like(q)])

    def deviation(self, options: Options) -> Vector:
        """Deviations of this state, shape (2n,).

        Positions have the deviations of the encoders, velocities those of ``options``, or a tenth
        of the limits of the URDF.

        Raises:
            UsageError: the deviations of ``options`` are not as expected.
        """
        q = [each.deviation for each in self._sensors]
        u = deviation_of(options.initial_deviation, self._robot)[self._robot.n :].tolist()
        if options.initial_deviation == Options.initial_deviation:
            limits = self._robot.fastest.tolist()
            u = [_SHARE * each if math.isfinite(each) else _UNLIMITED for each in limits]
        return np.array([*q, *u])
