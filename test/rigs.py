# SPDX-License-Identifier: Apache-2.0
"""Rigs for tests: a contact switch and an accelerometer at a sample model, and a drive."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import cast

import numpy as np

from impact_observer.io import BagWriter, JointState, Quality, interfaces
from impact_observer.io.messages import bag_messages
from impact_observer.io.recordings import published_model
from impact_observer.io.typestores import typestore
from impact_observer.model import Model, read_model
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, grid
from impact_observer.states import Vector

EPOCH = 1_000_000_000
DURATION = 30
BOOL, IMU = "std_msgs/msg/Bool", "sensor_msgs/msg/Imu"

_US = 1_000
_LATE = 2_000 * _US
"""From an instant to its message."""
_CHATTER = ((0, True), (300 * _US, False), (800 * _US, True), (5_000 * _US, False))
"""Values of a switch at an impact, with their times after the impact, ns."""
_PULSE = 0.008
"""Duration of the half-sine that an accelerometer measures at an impact, s."""
_SAMPLE, _WINDOW = 1_000 * _US, 10
"""Sampling interval of an accelerometer, ns, and samples recorded before and after an impact."""
_NOISE = 1.0
"""Standard deviation of an acceleration, m/s^2."""
_GRAVITY = np.array([0.0, 3.0, -9.34])
_TYPES = cast("dict[str, Callable[..., object]]", typestore().types)
_Messages = Iterator[tuple[int, str, object]]


def switch_bag(path: Path) -> Path:
    """A switch on two_mass: it chatters, is closed for 5 ms, and publishes 2 ms late."""
    model, run = _run()
    hits = [event.stamp for event in run.events]
    messages = (
        (hit + after + _LATE, "/switch", _TYPES[BOOL](data=closed))
        for hit in hits
        for after, closed in _CHATTER
    )
    return _written(path, {"/switch": BOOL}, messages, model, run)


def accelerometer_bag(path: Path) -> Path:
    """An accelerometer on the impacting mass of two_mass, at 1 kHz, 10 ms around each impact."""
    model, run = _run()
    return _written(path, {"/imu": IMU}, _accelerations(model, run), model, run)


def pulses() -> list[int]:
    """Stamps of the pulses of a drive of 9 rad/s, ns; the first is a turn before the epoch."""
    period = 2 * np.pi / 9
    return [EPOCH + round(k * period * NS_PER_S) for k in range(-1, int(DURATION / period) + 2)]


def hammer_bag(path: Path) -> Path:
    """The hammer with the pulses of its drive."""
    model, stamps = read_model("hammer"), pulses()
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, grid(EPOCH, EPOCH * (1 + DURATION), 100.0))
    make, header = bag_messages(), _TYPES[interfaces.HEADER]
    text = published_model(model, seed=0)
    messages: list[tuple[int, str, object]] = [
        (EPOCH, interfaces.PLANT_MODEL.topic, make.model(text)),
        *((each.stamp, interfaces.IMPACTS.topic, make.event(each)) for each in run.events),
        *((at, interfaces.PHASE_REFERENCE.topic, header(make.time(at), "")) for at in stamps),
    ]
    return _written(path, {}, messages, model, run)


def _run() -> tuple[Model, Run]:
    """Half a minute of two_mass."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    return model, simulate(plant, grid(EPOCH, EPOCH * (1 + DURATION), 2.0))


def _accelerations(model: Model, run: Run) -> _Messages:
    """The signal of an accelerometer: gravity, noise, and a pulse at each impact."""
    system, rng = model.system, np.random.default_rng(1)
    for switching in run.switchings:
        hit = switching.instant.stamp
        change = (switching.after - switching.before)[system.n :]
        height = np.pi / (2 * _PULSE) * float(np.abs(change).max())
        first = (hit // _SAMPLE - _WINDOW) * _SAMPLE
        for stamp in range(first, first + (2 * _WINDOW + 1) * _SAMPLE, _SAMPLE):
            since = (stamp - hit) * 1e-9
            pulse = height * np.cos(np.pi * since / _PULSE) if abs(since) < _PULSE / 2 else 0.0
            felt = _GRAVITY + np.array([pulse, 0.0, 0.0]) + rng.normal(scale=_NOISE, size=3)
            yield stamp + _LATE, "/imu", _imu(stamp, felt)


def _imu(stamp: int, acceleration: Vector) -> object:
    """An Imu with an acceleration only, shape (3,), m/s^2."""
    zero, vector = np.zeros(9), _TYPES["geometry_msgs/msg/Vector3"]
    return _TYPES[IMU](
        header=_TYPES["std_msgs/msg/Header"](stamp=bag_messages().time(stamp), frame_id="mass"),
        orientation=_TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=zero,
        angular_velocity=vector(x=0.0, y=0.0, z=0.0),
        angular_velocity_covariance=zero,
        linear_acceleration=vector(*acceleration.tolist()),
        linear_acceleration_covariance=zero,
    )


def _written(
    path: Path,
    types: dict[str, str],
    messages: Iterable[tuple[int, str, object]],
    model: Model,
    run: Run,
) -> Path:
    """Write messages and truth in the order of time."""
    make, names, n = bag_messages(), model.system.coordinates, model.system.n
    states = (
        (stamp, "/plant/joint_states", make.joint_state(JointState(stamp, names, x[:n], x[n:])))
        for stamp, x in zip(run.stamps.tolist(), run.states, strict=True)
    )
    with BagWriter(path) as writer:
        for topic, type_name in types.items():
            writer.declare(topic, type_name=type_name, quality=Quality(reliable=False))
        for log_time, topic, message in sorted([*messages, *states], key=lambda each: each[:2]):
            writer.write(topic, log_time, message)
    return path
