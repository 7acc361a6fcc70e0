# SPDX-License-Identifier: Apache-2.0
"""Where the observer of a robot starts: at the first sample of each encoder."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from impact_observer.errors import UsageError
from impact_observer.model.measurement import Measurement
from impact_observer.model.robot_description import RobotDescription
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options

_SHARE = 0.1
"""Deviation of a velocity whose deviation is not declared, over its limit in the URDF."""
_UNLIMITED = 1.0
"""The same without a limit, rad/s or m/s."""
_LEARNED = 0.01
"""Deviation of a first sample whose sensor declares none, rad or m."""


def started(
    options: Options,
    robot: RobotDescription,
    sensors: Sequence[Measurement],
    samples: Iterable[SensorSample],
) -> Options:
    """``options`` whose initial state is at rest at the first sample of each joint's encoder.

    Positions have the deviations of the ``sensors``, velocities those of the options, or a tenth
    of the limits of the URDF. Options with an initial state of their own stay as they are.

    Raises:
        UsageError: a joint has no sample of an encoder, or deviations are not as expected.
    """
    if options.initial_state != Options.initial_state:
        return options
    encoders = {
        each.position[0][0]: i
        for i, each in enumerate(sensors)
        if len(each.position) == 1 and each.position[0][1] == 1.0 and not each.velocity
    }
    first: dict[int, float] = {}
    for sample in samples:
        first.setdefault(sample.sensor, sample.value)
        if len(first) == len(sensors):
            break
    position, deviation = list[float](), list[float]()
    for joint in robot.joints:
        if (i := encoders.get(joint)) is None or i not in first:
            raise UsageError(
                f"initial state: no sample of an encoder of the joint {joint!r} found; expected"
                " one in measurements and bag, or an initial state"
            )
        position.append(first[i] - sensors[i].offset)
        known = sensors[i].deviation
        deviation.append(_LEARNED if known is None else known)
    if options.initial_deviation == Options.initial_deviation:
        limits = (each.velocity for each in robot.urdf_joints)
        deviation += [_SHARE * each if math.isfinite(each) else _UNLIMITED for each in limits]
    else:
        deviation += [float(options.initial_deviation)] * robot.n
    return replace(
        options,
        initial_state=",".join(map(repr, [*position, *[0.0] * robot.n])),
        initial_deviation=",".join(map(repr, deviation)),
    )
